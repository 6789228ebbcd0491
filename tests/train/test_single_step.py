"""Single-step evaluation: the same trees for all, known to whoever is judged as if it had grown them."""

from __future__ import annotations

import numpy as np
import pytest

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.guidance.registry import make_guidance
from guided_gym.planning import guided_search
from guided_gym.train.single_step import Harvest, single_step, steps
from guided_gym.train.specs import EvaluationSettings

PROBLEM = make_distribution("SimplePassage").problem(0)
SHORT = EvaluationSettings(max_samples=60)


def test_harvest__moments_lie_in_the_middle_of_equal_parts() -> None:
    result = guided_search(PROBLEM, "uninformed", seed=0, max_samples=40)
    assert Harvest.of(result, 4).moments.tolist() == [5, 15, 25, 35]
    short = guided_search(PROBLEM, "uninformed", seed=0, max_samples=2)
    assert Harvest.of(short, 4).moments.tolist() == [0, 1]


@pytest.mark.parametrize("name", ["lazy_prm", "medial_axis", "goal_distance", "lazy_prm+medial_axis"])
def test_steps__on_a_guidances_own_trees_are_its_own_choices(name: str) -> None:
    # Deterministic selection, attached to a search that repeats its own: P is what it did choose.
    result = guided_search(PROBLEM, name, seed=4, max_samples=60)
    harvest = Harvest.of(result, 6)
    found = list(steps(harvest, make_guidance(name), 4))
    np.testing.assert_allclose(
        [step.efficiency for step in found], result.record.efficiency[harvest.moments], rtol=1e-9
    )
    np.testing.assert_allclose([step.best for step in found], result.record.best[harvest.moments], rtol=1e-9)
    np.testing.assert_allclose(
        [step.divergence for step in found], [step.efficiency for step in found], rtol=1e-6, atol=1e-9
    )


def test_steps__of_a_stochastic_guidance_are_expectations() -> None:
    harvest = Harvest.of(guided_search(PROBLEM, "rrt", seed=1, max_samples=40), 2)
    for step in steps(harvest, make_guidance("rrt"), 1):
        assert step.best <= step.divergence + np.log(40)
        assert step.divergence <= step.efficiency  # the entropy of P lies between them
        assert step.best < step.efficiency


def test_single_step__judges_all_on_the_same_trees() -> None:
    rows = single_step("SimplePassage", ["oracle", "uninformed"], harvesters=["rrt"], seeds=3, settings=SHORT)
    oracle, uninformed = rows
    assert oracle.trees == uninformed.trees == 12
    assert oracle.efficiency.estimate < uninformed.efficiency.estimate
    # The same trees have the same best.
    assert oracle.efficiency.estimate - oracle.excess.estimate == pytest.approx(
        uninformed.efficiency.estimate - uninformed.excess.estimate
    )
    again = single_step("SimplePassage", ["oracle"], harvesters=["rrt"], seeds=3, settings=SHORT, workers=2)
    assert again[0].efficiency == oracle.efficiency


def test_single_step__refuses_what_cannot_work() -> None:
    with pytest.raises(InvalidInputError, match="moments"):
        single_step("Cup", ["rrt"], moments=0)
    with pytest.raises(UnknownNameError):
        single_step("Cup", ["rrt"], harvesters=["rtt"])
