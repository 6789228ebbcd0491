"""The field network in numpy: what it sees, and what it says without any training."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from guided_gym.agents.field import (
    FieldArchitecture,
    FieldModel,
    Grid,
    body_discs,
    decoder_input,
    plain_tensors,
)
from guided_gym.environment import Environment
from guided_gym.envs.catalogue import make_distribution
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.oracle import oracle_for
from guided_gym.problems import Problem, Task
from guided_gym.robots import Robot

ARCHITECTURE = FieldArchitecture(cells=24, headings=8)
WALL = [(0.45, 0.3), (0.55, 0.3), (0.55, 1.0), (0.45, 1.0)]


def point_problem() -> Problem:
    environment = Environment.from_polygons((0, 0, 1, 1), [WALL])
    return Problem(Robot.point(), environment, Task((0.2, 0.8), (0.8, 0.8)))


def model(**changes: object) -> FieldModel:
    return FieldModel(ARCHITECTURE, plain_tensors(ARCHITECTURE), **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "robot",
    [
        Robot.rectangle(0.8, 0.3),
        Robot.segment(0.4),
        Robot.polygon([(0, 0), (1, 0), (1, 0.2), (0.2, 0.2), (0.2, 1), (0, 1)]),
    ],
    ids=["rectangle", "segment", "non-convex"],
)
def test_body_discs__lie_in_the_robot_and_fill_it(robot: Robot) -> None:
    discs = body_discs(robot)
    union = shapely.union_all([shapely.Point(x, y).buffer(r + 1e-4) for x, y, r in discs])
    assert union.difference(robot.outline.buffer(1e-3)).area < 1e-9
    assert shapely.hausdorff_distance(union, robot.outline, densify=0.05) < 0.3 * robot.radius


def test_the_room_of_a_robot_says_where_it_is_free() -> None:
    problem = make_distribution("TrapCup").problem(0)
    grid = Grid.of(problem.space, FieldArchitecture())
    rows, columns, headings = np.indices(grid.room.shape)
    q = np.stack(
        [
            grid.frame[0] + columns * grid.frame[2],
            grid.frame[1] + rows * grid.frame[2],
            2 * np.pi * headings / grid.room.shape[2],
        ],
        axis=-1,
    ).reshape(-1, 3)
    clear = np.abs(grid.room.ravel()) > 0.5
    agree = (grid.room.ravel() > 0) == problem.space.valid(problem.space.wrap(q))
    assert agree[clear].mean() > 0.999
    assert agree.mean() > 0.99


@pytest.mark.parametrize("name", ["SimplePassage", "point"])
def test_the_untrained_field_is_near_the_true_distance(name: str) -> None:
    problem = point_problem() if name == "point" else make_distribution(name).problem(0)
    field = model().evaluate(Grid.of(problem.space, ARCHITECTURE), problem.task.goal)
    q = problem.space.sample(np.random.default_rng(0), 2000)
    q = q[problem.space.valid(q)]
    truth = np.asarray(oracle_for(problem.space, problem.task.goal).cost_to_go(q))
    found = field.cost_to_go(q)
    assert np.median(np.abs(found - truth) / np.maximum(truth, 0.1 * truth.max())) < 0.1
    assert (found >= problem.space.distance(q, problem.task.goal) - 1e-6).all()


def test_without_planning_the_field_starts_from_the_distance() -> None:
    problem = make_distribution("Cup").problem(0)
    architecture = FieldArchitecture(cells=24, headings=8, planning=False)
    field = FieldModel(architecture, plain_tensors(architecture)).evaluate(
        Grid.of(problem.space, architecture), problem.task.goal
    )
    q = problem.task.start[None]
    assert field.cost_to_go(q)[0] == pytest.approx(
        float(problem.space.distance(q, problem.task.goal)[0]), rel=0.02
    )


def test_a_correction_is_added_in_sides_of_the_square() -> None:
    problem = point_problem()
    grid = Grid.of(problem.space, ARCHITECTURE)
    tensors = plain_tensors(ARCHITECTURE)
    tensors["head.bias"][:] = 0.25
    q = problem.task.start[None]
    plain = model().evaluate(grid, problem.task.goal).cost_to_go(q)[0]
    raised = FieldModel(ARCHITECTURE, tensors).evaluate(grid, problem.task.goal).cost_to_go(q)[0]
    assert raised - plain == pytest.approx(0.25 * grid.side, rel=1e-4)
    ignored = FieldModel(ARCHITECTURE, tensors, corrected=False).evaluate(grid, problem.task.goal)
    assert ignored.cost_to_go(q)[0] == pytest.approx(plain)


def test_decoder_input__is_bounded_and_has_its_layers() -> None:
    problem = make_distribution("Trap").problem(0)
    grid = Grid.of(problem.space, ARCHITECTURE)
    frame = grid.towards(problem.task.goal)
    layers = decoder_input(grid, frame, model().arrival(grid, frame)[0])
    assert layers.shape == (24, 24, 3 * 8 + 1)
    assert np.abs(layers).max() <= 4.0


def test_workspaces_that_are_not_square_lie_in_the_middle_of_one() -> None:
    space = Problem(Robot.point(), Environment((0, 0, 2, 1)), Task((0.2, 0.5), (1.8, 0.5))).space
    grid = Grid.of(space, ARCHITECTURE)
    assert grid.side == 2.0
    assert (grid.workspace[0] < 0).all()
    assert (grid.workspace[12] > 0).all()


@pytest.mark.parametrize("sizes", [{"cells": 20}, {"headings": 6}, {"widths": (1, 0, 1)}, {"blocked": -1.0}])
def test_sizes_that_cannot_be_are_refused(sizes: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError, match="field network"):
        FieldArchitecture(**sizes)  # type: ignore[arg-type]
    with pytest.raises(StorageError, match="field network"):
        FieldArchitecture.from_card(sizes)
