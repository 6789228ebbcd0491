"""Solved paths: free, ending where they should, not longer for having been cut short."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError, StorageError, UnknownNameError
from guided_gym.storage.path_file import PathDatabase
from guided_gym.train.evaluation import evaluate
from guided_gym.train.paths import SEED_OFFSET, build_path_database, solve_path
from guided_gym.train.specs import EvaluationSettings, GuidanceSpec, fingerprint, settings_content
from guided_gym.trajectories import shortcut

ENVIRONMENT = "RandomSimplePassage"


def length(space: object, path: np.ndarray) -> float:
    return float(space.distance(path[:-1], path[1:]).sum())  # type: ignore[attr-defined]


@pytest.mark.parametrize("seed", range(3))
def test_path__is_free_and_solves_its_problem(seed: int) -> None:
    path = solve_path(ENVIRONMENT, SEED_OFFSET, (), seed)
    problem = make_distribution(ENVIRONMENT).problem(SEED_OFFSET + seed)
    assert path is not None
    np.testing.assert_array_equal(path[0], problem.task.start)
    np.testing.assert_array_equal(path[-1], problem.task.goal)
    assert all(problem.space.motion_free(a, b) for a, b in itertools.pairwise(path))
    np.testing.assert_array_equal(path, solve_path(ENVIRONMENT, SEED_OFFSET, (), seed))


def test_shortcut__straightens_a_detour_and_keeps_the_ends() -> None:
    problem = make_distribution("SimplePassage").problem(0)
    path = np.array([[1.0, 1.0, 0.0], [1.0, 4.0, 0.0], [3.0, 4.0, 0.0], [3.0, 1.0, 0.0]])
    cut = shortcut(problem.space, path, np.random.default_rng(0), 200)
    np.testing.assert_array_equal(cut, path[[0, -1]])
    assert length(problem.space, cut) < length(problem.space, path)
    np.testing.assert_array_equal(shortcut(problem.space, path, np.random.default_rng(0), 0), path)


def test_database__grows_and_guides(tmp_path: Path) -> None:
    file = tmp_path / "new" / "paths.sqlite"
    assert build_path_database(ENVIRONMENT, file, 2).solved == 2
    assert build_path_database(ENVIRONMENT, file, 5).solved == 3
    with PathDatabase.open(file, readonly=True) as database:
        assert database.seeds() == list(range(5))
    settings = EvaluationSettings(max_samples=40)
    results = evaluate(ENVIRONMENT, "path_database", seeds=2, database=file, settings=settings)
    assert results.guidances(ENVIRONMENT) == ["path_database"]


def test_fingerprint__follows_the_paths_that_are_used_not_the_file(tmp_path: Path) -> None:
    def of(file: Path, paths: int) -> str:
        spec = GuidanceSpec.of("path_database", database=str(file), paths=paths)
        return fingerprint(settings_content(ENVIRONMENT, spec, EvaluationSettings()))

    file, copy = tmp_path / "a.sqlite", tmp_path / "b.sqlite"
    build_path_database(ENVIRONMENT, file, 3)
    copy.write_bytes(file.read_bytes())
    assert of(file, 2) == of(copy, 2)
    assert of(file, 2) != of(file, 3)
    used = of(file, 2)
    build_path_database(ENVIRONMENT, file, 4)
    assert of(file, 2) == used


def test_bad_input(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'RandomSimplePassage'"):
        build_path_database("RandomSimplePassages", tmp_path / "a.sqlite", 1)
    with pytest.raises(InvalidInputError, match="seed"):
        build_path_database(ENVIRONMENT, tmp_path / "a.sqlite", 1, offset=-1)
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="folder"):
        build_path_database(ENVIRONMENT, tmp_path / "file" / "a.sqlite", 1)
