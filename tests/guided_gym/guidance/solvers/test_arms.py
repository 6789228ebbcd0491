"""Every solver with every modification on an arm: it works, or says clearly that it does not."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.linkages import Linkage
from guided_gym.guidance import modifications, recipes
from guided_gym.guidance.registry import make_guidance
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task
from guided_gym.storage.path_library import PathLibrary

SOLVERS = {
    "straight": "straight",
    "exact": "exact",
    "roadmap": "roadmap(vertices=300)",
    "shortened": "shortened(vertices=300)",
    "skeleton": "skeleton",
    "wave": "wave(cells=32, headings=8)",
    "paths": "paths",
    "searched": "searched(guidance=rrt, samples=200)",
}
ROBOTS = ("same", "point", "disc", "inner", "outer", "links", "subset", "principal")
FLAT = ("skeleton", "wave")  # take the tool in the workspace, and nothing else
REFUSED = {
    **{(solver, robot): "a guiding space of 2 dim|of 2 or 3 dim|rigid planar robot|a plane of 2 dim"
       for solver in FLAT for robot in ROBOTS if robot not in ("point", "disc")},
    **{(solver, robot): "a plane of 2 dimensions" for solver in ("exact", "searched", "paths", *FLAT)
       for robot in ("subset", "principal")},
    **{("paths", robot): "expected paths of dimension 2" for robot in ("point", "links")},
    **{(solver, "disc"): "disc: expected a rigid planar robot" for solver in SOLVERS},
}  # fmt: skip


@pytest.fixture(scope="module")
def problem() -> Problem:
    """Out of one window, round, and out of another."""
    obstacles = (shapely.box(6.2, 5.4, 7.6, 6.4), shapely.box(6.2, 3.2, 7.6, 4.4), shapely.box(3, 6, 4, 7))
    arm = Linkage.arm([0.8] * 4, 0.1, base=(5.0, 5.0), limits=(-3.0, 3.0))
    task = Task([1.3, 0.1, 0.1, 0.1], [-1.3, -0.1, -0.1, -0.1])
    return Problem(arm, Environment((0.0, 0.0, 10.0, 10.0), obstacles), task)


@pytest.fixture(scope="module")
def library(problem: Problem) -> PathLibrary:
    solved = [guided_search(problem, "rrt", seed=k, max_samples=2000, measure=False).path for k in range(3)]
    paths = [path for path in solved if path is not None]
    assert len(paths) == 3
    return PathLibrary.from_paths(paths, problem.space.weights, problem.space.periods)


def test_tables__have_a_row_here() -> None:
    assert list(SOLVERS) == list(recipes.SOLVERS)
    assert set(ROBOTS) == set(modifications.ROBOTS)


CASES = [(s, r) for s in SOLVERS for r in ROBOTS if (s, r) not in (("exact", "inner"), ("exact", "outer"))]


@pytest.mark.parametrize(("solver", "robot"), CASES)  # an oracle of 4 joints takes a second: one is enough
def test_arm__is_guided_or_refused(problem: Problem, library: PathLibrary, solver: str, robot: str) -> None:
    robots = {
        "outer": modifications.Outer(0.05),
        "principal": modifications.Principal(library),
    }
    options = {"robot": robots.get(robot, robot)}
    if solver == "paths":
        options["database"] = library
    guidance = make_guidance(SOLVERS[solver], **options)
    message = REFUSED.get((solver, robot))
    if message is not None:
        with pytest.raises(InvalidInputError, match=message):
            guided_search(problem, guidance, seed=0, max_samples=5, measure=False)
        return
    results = [
        guided_search(
            problem, make_guidance(SOLVERS[solver], **options), seed=3, max_samples=40, measure=False
        )
        for _ in range(2)
    ]
    assert results[0].solved or results[0].samples == 40
    np.testing.assert_array_equal(*(result.tree.configurations for result in results))
    edges = results[0].tree.configurations[results[0].tree.parents[1:]], results[0].tree.configurations[1:]
    assert problem.space.motions_free(*map(np.ascontiguousarray, edges)).all()


@pytest.mark.parametrize("environment", ["nothing", "without(0)", "shrunk", "hulls", "boxes", "revealed"])
def test_environments__are_modified_for_arms_too(problem: Problem, environment: str) -> None:
    for solver in (
        "roadmap(vertices=300",
        "searched(guidance=rrt, samples=200",
        "wave(robot=point, cells=32",
    ):
        result = guided_search(
            problem, f"{solver}, environment={environment})", seed=0, max_samples=60, measure=False
        )
        assert result.solved or result.samples == 60


@pytest.mark.parametrize("by", ["task", "occupancy", "dtw"])
def test_stored_paths__of_an_arm_are_found_and_followed(
    problem: Problem, library: PathLibrary, by: str
) -> None:
    if by == "dtw":
        pytest.importorskip("dtaidistance", reason="dynamic time warping is an extra")
    guidance = make_guidance("path_database", database=library, by=by)
    result = guided_search(problem, guidance, seed=5, max_samples=300, measure=False)
    assert result.solved


def test_knowing_more_of_an_arm__costs_fewer_samples(problem: Problem) -> None:
    """The exact cost-to-go of the first three links guides better than the distance to the goal."""
    samples = {}
    for guidance in ("exact(robot=links(3))", "goal_distance"):
        results = [guided_search(problem, guidance, seed=k, max_samples=400, measure=False) for k in range(3)]
        samples[guidance] = np.mean([result.samples for result in results])
    assert samples["exact(robot=links(3))"] < samples["goal_distance"]
