"""Problems are checked at the door, and are the same for the same content."""

from __future__ import annotations

import copy
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
import shapely

from guided_gym.catalogue.distributions import FixedProblem, SampledProblems
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.problems import Problem, Task

E = Environment((0.0, 0.0, 10.0, 10.0), (shapely.box(4, 4, 6, 6),))
R = Robot.rectangle(0.8, 0.3)


def problem(start: tuple = (1, 5, 0), goal: tuple = (9, 5, 0), **changes: object) -> Problem:
    return Problem(R, E, Task(start, goal), **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("bad", [(math.nan, 0), (math.inf, 0), "ab", [[1, 2]], [[1], [1, 2]], None, 3.0])
def test_task__refuses_what_is_no_configuration(bad: object) -> None:
    with pytest.raises(InvalidInputError, match="start"):
        Task(bad, (1, 2))  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match="goal"):
        Task((1, 2), bad)  # type: ignore[arg-type]


def test_task__refuses_two_dimensions() -> None:
    with pytest.raises(InvalidInputError, match="2 coordinates but goal has 3"):
        Task((1, 2), (1, 2, 3))


def test_task__is_a_read_only_copy() -> None:
    start = np.array([1.0, 2.0])
    task = Task(start, (3, 4))
    start[0] = 9
    assert task.start.tolist() == [1, 2]
    with pytest.raises(ValueError, match="read-only"):
        task.start[0] = 5


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ((1, 5), "start needs 3 coordinates"),
        ((-1, 5, 0), "out of bounds"),
        ((5, 5, 0), "in collision"),
        ((0.1, 5, 0), "touching or crossing the bounds"),  # the robot sticks out of the bounds
        ((3.7, 5, 0), "in collision"),
    ],
)
def test_problem__refuses_a_start_that_cannot_be(start: tuple, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        problem(start, (9, 5, 0) if len(start) == 3 else (9, 5))
    if len(start) == 3:
        with pytest.raises(InvalidInputError, match=message.replace("start", "goal")):
            problem(goal=start)


def test_problem__names_the_bound_or_the_obstacle_and_the_tolerance() -> None:
    room = Environment((0, 0, 10, 10), (shapely.box(2, 2, 3, 3), shapely.box(6, 6, 7, 7)))
    for start, message in [
        (
            (1e-6, 5),
            r"touching the bounds .*: xmin = 0 is 1e-06 away, nearer than the collision tolerance 1.41e-05",
        ),
        ((5, 10 - 1e-6), r"ymax = 10 is 1e-06 away, nearer than the collision tolerance"),
        ((0, 5), r"touching or crossing the bounds \(.*\) at xmin = 0"),
        ((6.5, 6.5), "in collision with obstacle 1"),
        (
            (3 + 1e-6, 2.5),
            "in collision: obstacle 0 is 1e-06 away, nearer than the collision tolerance 1.41e-05",
        ),
    ]:
        with pytest.raises(InvalidInputError, match=message):
            Problem(Robot.point(), room, Task(start, (9, 9)))


def test_problem__takes_headings_of_many_turns() -> None:
    posed = problem((1, 5, 0.3 + 2 * math.pi * 10_000), (9, 5, -2 * math.pi * 10**9))
    assert posed.task.start == pytest.approx([1, 5, 0.3], abs=1e-8)
    assert posed.task.goal == pytest.approx([9, 5, 0.0], abs=1e-5)
    with pytest.raises(InvalidInputError, match=r"start has the heading 1e\+13; expected one below 1e\+12"):
        problem((1, 5, 1e13))


def test_problem__brings_angles_into_range() -> None:
    posed = problem((1, 5, 7.0), (9, 5, -math.pi))
    assert posed.task.start == pytest.approx([1, 5, 7.0 - 2 * math.pi])
    assert posed.task.goal[2] == -math.pi
    assert problem((1, 5, 0.3)).task.start.tolist() == [1, 5, 0.3]


def test_fingerprint__follows_the_content() -> None:
    base = problem()
    assert base.fingerprint == problem().fingerprint
    assert base.fingerprint == problem(name="another name").fingerprint
    others = [
        problem((1, 5.001, 0)),
        problem(goal=(9, 5, 0.001)),
        problem(rotation_weight=1.0),
        replace(base, robot=Robot.rectangle(0.8, 0.31)),
        replace(base, environment=Environment((0.0, 0.0, 10.0, 10.0), (shapely.box(4, 4, 6, 6.001),))),
    ]
    assert len({p.fingerprint for p in (base, *others)}) == 6


def test_problem__survives_pickling_and_copying() -> None:
    base = problem(regions={"left": shapely.box(0, 0, 4, 10)})
    _ = base.space
    for twin in (pickle.loads(pickle.dumps(base)), copy.deepcopy(base)):
        assert twin.fingerprint == base.fingerprint
        assert twin.regions["left"].equals(base.regions["left"])
        assert twin.space.motion_free(twin.task.start, twin.task.start)


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((3, E, Task((1, 5, 0), (9, 5, 0))), "robot: expected a Mechanism, got 3"),
        ((R, (0, 0, 1, 1), Task((1, 5, 0), (9, 5, 0))), "environment: expected an Environment, got"),
        ((R, E, ((1, 5, 0), (9, 5, 0))), "task: expected a Task, got"),
        ((R, E, Task((1, 5, 0), (9, 5, 0)), "p", {"left": (0, 4)}), "regions: expected names with shapely"),
        ((R, E, Task((1, 5, 0), (9, 5, 0)), "p", ["left"]), "regions: expected names with shapely"),
        ((R, E, Task((1, 5, 0), (9, 5, 0)), "p", {}, "one"), "rotation_weight: expected a positive number"),
    ],
)
def test_problem__refuses_parts_of_another_type(parts: tuple, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        Problem(*parts)


@pytest.mark.parametrize("seed", [-1, 1.5, "one", None])
def test_distributions__refuse_what_is_no_seed(seed: object) -> None:
    drawn = SampledProblems("D", lambda rng: problem((1, rng.uniform(1, 9), 0)), "many")
    with pytest.raises(InvalidInputError, match="seed: expected an integer"):
        drawn.problem(seed)  # type: ignore[arg-type]


def test_distributions__give_one_problem_per_seed() -> None:
    fixed = FixedProblem(problem(), "one")
    assert fixed.fixed
    assert fixed.problem(1) is fixed.problem(2)
    drawn = SampledProblems("D", lambda rng: problem((1, rng.uniform(1, 9), 0)), "many")
    assert not drawn.fixed
    assert drawn.problem(3).fingerprint == drawn.problem(3).fingerprint
    assert drawn.problem(3).fingerprint != drawn.problem(4).fingerprint
