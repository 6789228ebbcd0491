"""Training of agents that believe in motions, end to end on a tiny budget: it learns, resumes and refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from guided_gym.catalogue.table import make_distribution  # noqa: E402
from guided_gym.errors import InvalidInputError, StorageError  # noqa: E402
from guided_gym.guidance.learned import weights  # noqa: E402
from guided_gym.guidance.learned.motion_agent import load_motion_agent, load_motion_card  # noqa: E402
from guided_gym.guidance.registry import make_guidance  # noqa: E402
from guided_gym.train import motions  # noqa: E402
from guided_gym.train.checkpoints import AGENT_FOLDER  # noqa: E402
from guided_gym.train.motions import MotionConfig, random_motions, train_motions  # noqa: E402
from guided_gym.train.validation import rank  # noqa: E402

TINY = MotionConfig(
    environments=("RandomPlanarArm4",),
    problems=2,
    motions=64,
    validation=1,
    belief_steps=150,
    estimate_steps=20,
    rounds=1,
    searches=1,
    scorer_steps=5,
    max_samples=60,
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run") / "tiny"
    train_motions(TINY, out)
    return out


def test_the_agent_guides_and_its_card_says_how_it_came_about(finished: Path) -> None:
    make_guidance(f"learned:{finished / AGENT_FOLDER}")
    card = load_motion_card(finished / AGENT_FOLDER)
    assert card["robot"] == "arm of 4 links"
    assert card["training"]["problems"] == 2
    assert {"belief", "estimate", "scorer"} <= {row["what"] for row in card["metrics"]["history"]}


def test_scorers_are_drawn_from_and_compared_with_each_other(finished: Path) -> None:
    metrics = load_motion_card(finished / AGENT_FOLDER)["metrics"]
    rows = {row["what"]: row for row in metrics["history"]}
    tried = [rows[f"validation after {stage}"] for stage in ("no round of the scorer", "the scorer, round 1")]
    best = min(tried, key=rank)
    assert all(metrics["scored"][name] == best[name] for name in best.keys() - {"what"})
    assert metrics["validation"]["stage"] == "the cost-to-go"  # without a scorer
    assert motions._Run(TINY, finished, None).searcher().scored


def test_the_belief_has_learned_what_is_free(finished: Path) -> None:
    space = make_distribution("RandomPlanarArm4@validation").problem(0).space
    starts, ends = random_motions(space, 400, np.random.default_rng(0))
    p = load_motion_agent(str(finished / AGENT_FOLDER)).belief.on(space).motions(starts, ends)
    assert ((p > 0.5) == np.asarray(space.motions_free(starts, ends))).mean() > 0.9


class StopError(Exception):
    pass


def test_a_run_that_was_stopped_ends_with_the_same_weights(finished: Path, tmp_path: Path) -> None:
    def progress(done: int, total: int, what: str) -> None:
        if done >= TINY.problems + 1:
            raise StopError

    with pytest.raises(StopError):
        train_motions(TINY, tmp_path / "run", progress)
    train_motions(TINY, tmp_path / "run")
    first, second = (
        (out / AGENT_FOLDER / weights.WEIGHTS_FILE).read_bytes() for out in (finished, tmp_path / "run")
    )
    assert first == second


def test_motions_are_of_all_lengths_and_in_bounds() -> None:
    space = make_distribution("RandomPlanarArm4@validation").problem(0).space
    starts, ends = random_motions(space, 800, np.random.default_rng(0))
    lengths = np.asarray(space.distance(starts, ends))
    assert (lengths == 0.0).sum() == 100
    assert lengths.max() > 4.0 * space.scale
    assert ((ends >= space.lower) & (ends <= space.upper)).all()


def test_robots_that_differ_are_refused(tmp_path: Path) -> None:
    mixed = MotionConfig(environments=("RandomPlanarArm4", "RandomPlanarArm7"), problems=2, motions=16)
    with pytest.raises(InvalidInputError, match="problems of one robot"):
        train_motions(mixed, tmp_path / "run")


def test_another_run_in_the_folder_is_refused(finished: Path) -> None:
    with pytest.raises(StorageError, match="another run's"):
        train_motions(MotionConfig(motions=32), finished)


@pytest.mark.parametrize(
    "options", [{"environments": ()}, {"motions": 1}, {"cells": 2}, {"hidden": 0}, {"learning_rate": 0.0}]
)
def test_options_out_of_range_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError):
        MotionConfig(**options)  # type: ignore[arg-type]
