"""Evaluations over numbered problems: test splits and benchmark files, each problem once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from guided_gym.catalogue.next_mazes import ENVIRONMENT_VARIABLE
from guided_gym.catalogue.splits import problem_seed
from guided_gym.catalogue.table import make_distribution, named_distribution
from guided_gym.errors import StorageError
from guided_gym.options import SearchOptions
from guided_gym.planning import guided_search
from guided_gym.train.evaluation import evaluate
from guided_gym.train.specs import EvaluationSettings


def test_a_split__is_evaluated_on_its_own_problems() -> None:
    name = "RandomSimplePassage"
    whole = make_distribution(name)
    runs = evaluate(f"{name}@test", "rrt", seeds=2, settings=EvaluationSettings(max_samples=40)).runs
    for k, run in enumerate(runs):
        problem = make_distribution(f"{name}@test").problem(k)
        assert problem.fingerprint == whole.problem(problem_seed("test", k)).fingerprint
        result = guided_search(problem, "rrt", seed=k, max_samples=40)
        assert run.samples == result.samples


def test_a_benchmark_file__is_evaluated_in_its_order(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    walls = np.ones((3, 15, 15), np.uint8)
    walls[:, 1:-1, 1:-1] = 0
    walls[:, 7, 2:-2] = 1
    starts, goals = np.array([[-0.5, 0.1 * k] for k in range(3)]), np.full((3, 2), 0.5)
    np.savez(tmp_path / "mazes_15_2_train.npz", maps=walls, init_states=starts, goal_states=goals)
    monkeypatch.setenv(ENVIRONMENT_VARIABLE, str(tmp_path))
    named_distribution.cache_clear()
    settings = EvaluationSettings(max_samples=2000, step=0.1)
    runs = evaluate("NextPoint", "rrt", seeds=3, settings=settings).runs
    for k, run in enumerate(runs):
        problem = make_distribution("NextPoint").problem(k)
        assert problem.task.start.tolist() == starts[k].tolist()
        result = guided_search(problem, "rrt", seed=k, max_samples=2000, options=SearchOptions(step=0.1))
        assert run.samples == result.samples > 0
    named_distribution.cache_clear()
    monkeypatch.delenv(ENVIRONMENT_VARIABLE)
    with pytest.raises(StorageError, match=ENVIRONMENT_VARIABLE):
        evaluate("NextStick", "rrt", seeds=1)
