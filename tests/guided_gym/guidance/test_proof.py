"""Where a guiding space proves that there is no path, the search ends and says why; it never does wrongly."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
import shapely

import guided_gym as gg
from guided_gym.guidance.proof import largest_disc, parted_cells, parted_workspace

WALL = [[(4.9, 0), (5.1, 0), (5.1, 10), (4.9, 10)]]
HAIR = [[(4.999, 0), (5.001, 0), (5.001, 10), (4.999, 10)]]
BEND = [[(0, 0), (4, 0), (4, 9.2), (0, 9.2)], [(4.8, 0), (10, 0), (10, 9.2), (4.8, 9.2)]]  # 0.8 wide


def _problem(robot, rings, start, goal, **task):
    room = gg.Environment.from_polygons((0, 0, 10, 10), rings)
    return gg.Problem(robot, room, gg.Task(start, goal, **task))


def _gap(width):
    low, high = 5 - width / 2, 5 + width / 2
    return [[(4.9, 0), (5.1, 0), (5.1, low), (4.9, low)], [(4.9, high), (5.1, high), (5.1, 10), (4.9, 10)]]


@pytest.mark.parametrize(
    ("robot", "start", "goal"),
    [
        (gg.Robot.point(), (1, 1), (9, 1)),
        (gg.Robot.segment(1.0), (1, 1, 0), (9, 1, 0)),
        (gg.Robot.rectangle(0.8, 0.3), (1, 1, 0), (9, 1, 0)),
        (gg.Robot.polygon([(1, 1), (2, 1), (1, 2)]), (1, 1, 0), (7, 1, 0)),  # beside its reference point
    ],
)
def test_a_wall_however_thin_parts_every_robot(robot, start, goal):
    for rings in (WALL, HAIR):
        problem = _problem(robot, rings, start, goal)
        assert parted_workspace(problem.space, problem.task)


def test_an_arm_cannot_reach_through_a_wall_around_it():
    ring = [
        [(4, 4), (6, 4), (6, 4.1), (4, 4.1)], [(4, 5.9), (6, 5.9), (6, 6), (4, 6)],
        [(4, 4.1), (4.1, 4.1), (4.1, 5.9), (4, 5.9)], [(5.9, 4.1), (6, 4.1), (6, 5.9), (5.9, 5.9)],
    ]  # fmt: skip
    snake = gg.Linkage.snake([0.4, 0.4])
    room = gg.Environment.from_polygons((0, 0, 10, 10), ring)
    inside, outside = [5.0, 5.0, 0.0, 0.0], [8.0, 8.0, 0.0, 0.0]
    space = gg.ConfigurationSpace(snake, room)
    assert parted_workspace(space, gg.Task(inside, outside))
    assert parted_workspace(space, gg.Task(inside, [5.0, 5.2, 0.1, 0.2])) is None


@pytest.mark.parametrize("width", [0.25, 0.299, 0.301, 0.4])
def test_a_gap_is_closed_when_it_is_narrower_than_the_disc_inside(width):
    """A rectangle 0.3 wide: what is said of gaps nearer to that than 2 % is left open."""
    problem = _problem(gg.Robot.rectangle(0.8, 0.3), _gap(width), (1, 1, 0), (9, 1, 0))
    assert (parted_workspace(problem.space, problem.task) is not None) == (width < 0.29)


def test_cells_prove_that_a_long_robot_cannot_turn_in_a_bend():
    there = (4.4, 2, math.pi / 2), (8, 9.6, 0)
    long, short = (_problem(gg.Robot.rectangle(length, 0.5), BEND, *there) for length in (3.0, 0.6))
    assert parted_workspace(long.space, long.task) is None  # its disc goes round
    assert parted_cells(long.space, long.task)
    assert parted_cells(short.space, short.task) is None


def test_no_problem_with_a_path_is_called_one_without():
    for name in ("Cup", "TrapCup", "HardPointMaze"):
        problem = gg.make_distribution(name).problem(3)
        assert parted_workspace(problem.space, problem.task) is None
        assert parted_cells(problem.space, problem.task) is None


def test_a_goal_region_that_reaches_through_the_wall_is_no_goal_behind_it():
    near = _problem(gg.Robot.point(), HAIR, (1, 1), (5.5, 1), tolerance=1.0)
    far = _problem(gg.Robot.point(), HAIR, (1, 1), (9, 1), tolerance=1.0)
    assert parted_workspace(near.space, near.task) is None
    assert parted_workspace(far.space, far.task)
    near = _problem(gg.Robot.rectangle(0.8, 0.3), WALL, (1, 1, 0), (5.7, 1, 0), tolerance=2.0)
    assert parted_cells(near.space, near.task) is None


@pytest.mark.parametrize("guidance", ["lazy_prm", "wavefront", "medial_axis", "hybrid"])
def test_the_search_ends_with_its_record(guidance):
    problem = _problem(gg.Robot.rectangle(0.8, 0.3), WALL, (1, 1, 0), (9, 1, 0))
    with pytest.raises(gg.NoPathError, match="parts") as caught:
        gg.guided_search(problem, guidance, seed=0, max_samples=20_000, measure=False)
    result = caught.value.result
    assert result.samples < 1000
    assert not result.solved
    assert len(result.record.selected) == result.samples
    assert pickle.loads(pickle.dumps(caught.value)).args == caught.value.args


def test_planning_says_why_there_is_no_plan():
    problem = _problem(gg.Robot.point(), HAIR, (1, 1), (9, 1))
    answer = gg.Planner(problem, "wavefront").plan()
    assert answer.path is None
    assert answer.samples == 0
    assert "point of the robot" in answer.no_path


def test_the_disc_lies_inside():
    for robot in (gg.Robot.rectangle(0.8, 0.3), gg.Robot.polygon([(0, 0), (2, 0), (2, 0.2), (0.3, 0.3)])):
        x, y, radius = largest_disc(robot.outline)
        angles = np.linspace(0, 2 * math.pi, 100)
        rim = np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)])
        assert shapely.distance(robot.outline, shapely.points(rim)).max() < 1e-9
