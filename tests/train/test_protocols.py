"""Protocols: what is common to all is the same for all, and expansions are judged as the paper says."""

from __future__ import annotations

import math

import numpy as np
import pytest

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.registry import make_guidance
from guided_gym.measure.target import Measure, suboptimality, target
from guided_gym.options import SearchOptions, TargetParameters
from guided_gym.planning import guided_search
from guided_gym.search.search import NO_NODE
from guided_gym.train.protocols import (
    ENTROPY_BINS,
    PROTOCOLS,
    expansion_efficiency,
    sample_entropy,
    sample_targets,
    search_once,
)
from guided_gym.train.specs import EvaluationSettings

PROBLEM = make_distribution("SimplePassage").problem(0)


def searched(name: str, protocol: str, seed: int = 0, **settings: object):
    chosen = EvaluationSettings(max_samples=80, protocol=protocol, **settings)  # type: ignore[arg-type]
    return search_once(PROBLEM, make_guidance(name), chosen, seed)


def test_whole__is_the_search_as_it_is() -> None:
    result, plain = searched("lazy_prm", "whole"), guided_search(PROBLEM, "lazy_prm", seed=0, max_samples=80)
    np.testing.assert_array_equal(result.record.efficiency, plain.record.efficiency)


def test_selection__everybody_expands_alike() -> None:
    result = searched("lazy_prm", "selection")
    plain = guided_search(PROBLEM, "lazy_prm", seed=0, max_samples=80, expansion="uniform")
    np.testing.assert_array_equal(result.tree.configurations, plain.tree.configurations)
    np.testing.assert_array_equal(result.record.efficiency, plain.record.efficiency)


def test_expansion__everybody_selects_by_the_exact_cost_to_go() -> None:
    result = searched("lazy_prm", "expansion")
    plain = guided_search(PROBLEM, "oracle", seed=0, max_samples=80, expansion=make_guidance("lazy_prm"))
    np.testing.assert_array_equal(result.record.selected, plain.record.selected)
    assert not np.allclose(result.record.efficiency, plain.record.efficiency)
    assert (result.record.best <= result.record.efficiency + 1e-12).all()


@pytest.mark.parametrize("normalisation", ["start", "tree"])
def test_expansion__is_the_target_over_the_tree_and_the_children(normalisation: str) -> None:
    parameters = TargetParameters(0.2, 0.3, 1e-3, normalisation)
    result = guided_search(PROBLEM, "rrt", seed=1, max_samples=40, options=SearchOptions(target=parameters))
    measure, tree, space = Measure(result), result.tree, PROBLEM.space
    node, size = 5, 12
    rng = np.random.default_rng(0)
    q = np.array(tree.configurations[node])
    children = q + 0.3 * rng.standard_normal((6, 3))
    children[2] = [q[0] + 50.0, 0, 0]  # no free motion leads there
    free = [space.motion_free(q, child) for child in children]
    assert not free[2] and any(free)
    lengths = space.distance(children, q)
    tau = np.where(
        free, np.minimum(measure.oracle.cost_to_go(children), measure.work_remaining[node] + lengths), np.inf
    )
    delta = suboptimality(tree.cost_to_come[node] + lengths, tau, measure.optimum)
    whole = target(
        np.concatenate([measure.suboptimality[:size], delta]),
        np.concatenate([measure.work_remaining[:size], tau]),
        measure.optimum,
        parameters,
    )
    for chosen in (0, 2, 5):
        own, best = measure.expansion(node, children, chosen, size)
        assert own == pytest.approx(-math.log(whole[size + chosen]))
        assert best == pytest.approx(-math.log(whole[size:].max()))
    assert measure.expansion(node, children, 2, size)[0] == pytest.approx(-math.log(1e-3))
    for wrong in [(-1, 0, size), (node, 6, size), (size, 0, size), (node, 0, 10**6)]:
        with pytest.raises(InvalidInputError, match="expected a node"):
            measure.expansion(wrong[0], children, wrong[1], wrong[2])


def test_expansion__tells_who_aims_from_who_does_not() -> None:
    means = {}
    for name in ("oracle", "uninformed"):
        results = [searched(name, "expansion", seed) for seed in range(3)]
        excess = [(r.record.efficiency - r.record.best).mean() for r in results]
        means[name] = np.mean(excess)
    assert means["oracle"] < 0.5 * means["uninformed"]


def test_expansion__of_a_failed_motion_has_the_ceiling() -> None:
    result = guided_search(PROBLEM, "uninformed", seed=3, max_samples=150)
    failed = result.record.child == NO_NODE
    efficiency, best = expansion_efficiency(result, 3, children=8)
    assert failed.any()
    assert efficiency[failed] == pytest.approx(-math.log(1e-4))
    assert (best <= -math.log(1e-4) + 1e-9).all()
    again = expansion_efficiency(result, 3, children=8)
    np.testing.assert_array_equal(efficiency, again[0])


def test_samples__are_what_was_proposed_in_order() -> None:
    result = guided_search(PROBLEM, "uninformed", seed=3, max_samples=60)
    targets, record = sample_targets(result), result.record
    failures = 0
    for target_, node, child in zip(targets, record.selected, record.child, strict=True):
        if child == NO_NODE:
            assert result.tree.failed_nodes[failures] == node
            np.testing.assert_array_equal(target_, result.tree.failed_targets[failures])
            failures += 1
        else:
            np.testing.assert_array_equal(target_, result.tree.configurations[child])
    assert 0 < sample_entropy(result) <= math.log(min(60, ENTROPY_BINS**3))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"protocol": "both"}, "protocol: expected one of whole, selection, expansion"),
        ({"protocol": "expansion", "expansion": "rrt"}, "expansion: expected none"),
        ({"protocol": "expansion", "rewire": True}, "rewire: expected False"),
    ],
)
def test_settings__that_leave_nothing_to_compare(settings: dict, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        EvaluationSettings(**settings)


def test_rewired_trees__cannot_be_told_in_hindsight() -> None:
    result = guided_search(PROBLEM, "rrt", seed=0, max_samples=60, options=SearchOptions(rewire=True))
    assert result.tree.rewirings
    with pytest.raises(InvalidInputError, match="rewir"):
        expansion_efficiency(result, 0)


def test_protocols__are_three() -> None:
    assert PROTOCOLS == ("whole", "selection", "expansion")
