"""Golden trees: the topology that each guiding space grows on one problem with one seed.

A change here is a change of behaviour. If it is meant, write the files anew and say why in the commit:

    python tests/guided_gym/guidance/test_golden.py
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import shapely

from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.registry import guidance_names, make_guidance
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task
from guided_gym.storage.path_library import PathLibrary

FOLDER = Path(__file__).parent / "golden"
NODES, SAMPLES, SEED = 60, 120, 7
NAMES = [
    "uninformed",
    "rrt",
    "goal_distance",
    "oracle",
    "prm",
    "lazy_prm",
    "medial_axis",
    "path_database",
    "wavefront",
    "hybrid",
    "straight",
    "exact",
    "roadmap",
    "shortened",
    "skeleton",
    "wave",
    "paths",
    "searched",
]
# What the solvers do not do by default.
OPTIONS = {"skeleton": {"robot": "point"}, "searched": {"guidance": "goal_distance"}}


def problem() -> Problem:
    """A wall with a gap near its top, and a block beyond."""
    obstacles = (shapely.box(4, 0, 5, 7.6), shapely.box(4, 8.8, 5, 10), shapely.box(6.2, 2.5, 7, 9.2))
    environment = Environment((0.0, 0.0, 10.0, 10.0), obstacles)
    return Problem(Robot.rectangle(0.8, 0.3), environment, Task((1.5, 3.0, 0.0), (8.7, 6.0, 1.0)), "Golden")


def guidance(name: str, posed: Problem) -> GuidingSpace:
    """The guiding space, with stored paths of which one is blocked."""
    if name not in ("path_database", "paths"):
        return make_guidance(name, **OPTIONS.get(name, {}))
    turns = [[1.5, 3, 0], [3.5, 8.2, 0], [5.6, 8.2, 0], [5.6, 1.5, 0], [8, 1.5, 1], [8.7, 6, 1]]
    straight = [[1.5, 3, 0], [8.7, 6, 1]]
    space = posed.space
    return make_guidance(
        name, database=PathLibrary.from_paths([straight, turns], space.weights, space.periods)
    )


def topology(name: str) -> dict[str, list[int]]:
    """Integers only: parents of the first nodes, and the nodes of the first failures."""
    posed = problem()
    tree = guided_search(posed, guidance(name, posed), seed=SEED, max_samples=SAMPLES, measure=False).tree
    return {
        "parents": np.asarray(tree.parents[:NODES]).tolist(),
        "failed_nodes": np.asarray(tree.failed_nodes[:NODES]).tolist(),
    }


def test_golden_trees__are_kept_for_every_guiding_space() -> None:
    assert guidance_names() == NAMES
    assert sorted(path.stem for path in FOLDER.glob("*.json")) == sorted(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_golden_tree__is_grown_again(name: str) -> None:
    assert topology(name) == json.loads((FOLDER / f"{name}.json").read_text())


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for each in NAMES:
        (FOLDER / f"{each}.json").write_text(json.dumps(topology(each)) + "\n")
