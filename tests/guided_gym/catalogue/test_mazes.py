"""Mazes: never blocked, of the promised kinds, and the same for the same seed."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from guided_gym.catalogue.grids import carved
from guided_gym.catalogue.mazes import (
    MOST_OBSTACLES,
    POINT_ROOMS,
    ROOMS,
    lattice_environment,
    lattice_mazes,
    snake_maze,
)
from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError
from guided_gym.measure.oracle import Oracle

MAZES = {"RandomMaze": 3, "RandomPointMaze": 2, "HardPointMaze": 2, "HardStickMaze": 3}


def free_area(problem):
    return problem.environment.free_space


@pytest.mark.parametrize("name", MAZES)
def test_mazes__have_a_path_and_follow_the_seed(name):
    distribution = make_distribution(name)
    for seed in range(2):
        problem = distribution.problem(seed)
        assert problem.name == name and problem.space.dimension == MAZES[name]
        oracle = Oracle(problem.space, problem.task.goal, start=problem.task.start)
        assert np.isfinite(oracle.cost_to_go(problem.task.start))
        assert distribution.problem(seed).fingerprint == problem.fingerprint
    assert distribution.problem(0).fingerprint != distribution.problem(1).fingerprint


@pytest.mark.parametrize(("name", "rooms"), [("RandomMaze", ROOMS), ("RandomPointMaze", POINT_ROOMS)])
def test_random_mazes__are_connected_and_some_have_loops(name, rooms):
    distribution = make_distribution(name)
    loops = 0
    for seed in range(12):
        free = distribution.problem(seed).environment.free_space
        assert isinstance(free, shapely.Polygon)  # in one piece
        loops += len(free.interiors) > 0  # a wall that one can walk around
    assert 0 < loops < 12


def test_random_mazes__have_windows_that_only_a_point_gets_through():
    windowed = 0
    for seed in range(10):
        problem = make_distribution("RandomMaze").problem(seed)
        # What a disc of 0.25 across does not close is wide enough for the rectangle.
        closed = problem.environment.obstacle_union.buffer(0.126, join_style="mitre")
        pieces = len(shapely.get_parts(problem.environment.obstacle_union))
        windowed += len(shapely.get_parts(closed)) < pieces
    assert 0 < windowed < 10


@pytest.mark.parametrize("name", ["RandomMaze", "RandomPointMaze"])
def test_random_mazes__tell_the_way_from_the_rest(name):
    problem = make_distribution(name).problem(3)
    way, elsewhere = problem.regions["way"], problem.regions["elsewhere"]
    for q in (problem.task.start, problem.task.goal):
        assert way.covers(shapely.Point(q[:2]))
    assert way.intersection(elsewhere).area == pytest.approx(0, abs=1e-9)
    assert way.area + elsewhere.area == pytest.approx(100)
    assert way.intersection(problem.environment.obstacle_union).area == pytest.approx(0, abs=1e-9)


def test_snakes__are_of_the_published_size_and_start_free():
    cell = 2.0 / 15
    for seed in range(4):
        problem = snake_maze(np.random.default_rng(seed))
        space, task = problem.space, problem.task
        assert space.dimension == 7 and len(problem.robot.bodies) == 5
        assert problem.robot.joints[1].offset == pytest.approx((0.8 / 1.4 * cell, 0.0))
        assert space.valid(task.start) and space.valid(task.goal)
        assert not space.motion_free(task.start, task.goal)
        turned = np.array(task.start)
        turned[6] += 0.1
        assert space.distance(task.start, turned) == pytest.approx(0.1 / 1.4 * cell)
        cells = round(problem.environment.obstacle_union.area / cell**2)
        assert 57 <= cells <= MOST_OBSTACLES
        again = snake_maze(np.random.default_rng(seed))
        assert again.fingerprint == problem.fingerprint


@pytest.mark.parametrize("name", ["HardPointMaze", "HardStickMaze"])
def test_hard_mazes__are_nearly_full_and_hide_the_goal(name):
    distribution = make_distribution(name)
    for seed in range(5):
        problem = distribution.problem(seed)
        cells = problem.environment.obstacle_union.area / (2 / 15) ** 2
        assert round(cells) == pytest.approx(cells, abs=1e-6)
        assert 105 <= round(cells) <= 128
        assert not problem.space.motion_free(problem.task.start, problem.task.goal)


def test_lattice_environment__has_exactly_the_cells():
    walls = carved(np.random.default_rng(0), 7, 7, 0.5)
    assert walls.sum() == MOST_OBSTACLES
    environment = lattice_environment(walls)
    assert environment.bounds == (-1, -1, 1, 1)
    assert (walls == environment.raster(15).T).all()  # the raster's rows are y, the map's are x
    assert environment.obstacle_union.area == pytest.approx(128 * (2 / 15) ** 2)


def test_lattice_mazes__have_the_number_of_obstacles_asked_for():
    mazes = lattice_mazes("point", (60, 62), "Open")
    assert mazes.name == "Open"
    for seed in range(3):
        assert 60 <= mazes.problem(seed).environment.raster(15).sum() <= 62


@pytest.mark.parametrize(
    ("robot", "obstacles", "message"),
    [("car", (60, 70), "'car'"), ("point", (70, 60), "obstacles"), ("stick", (60, 129), "56 to 128")],
)
def test_lattice_mazes__refuse_what_cannot_be(robot, obstacles, message):
    with pytest.raises(InvalidInputError, match=message):
        lattice_mazes(robot, obstacles)
