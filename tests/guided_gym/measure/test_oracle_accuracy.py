"""How exact the oracle is, what it says of it, and what it spends on it."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import shapely
import shapely.affinity

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import GuidedGymWarning, InvalidInputError, NoPathError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.measure import grid, solution
from guided_gym.measure.certified import lengths_left, shortest_down
from guided_gym.measure.grid import grid_joins
from guided_gym.measure.oracle import Oracle, oracle_for
from guided_gym.options import OracleOptions, SearchOptions
from guided_gym.planning import guided_search

BOUNDS = (0.0, 0.0, 10.0, 10.0)
pytestmark = pytest.mark.usefixtures("own_cache")


def space_of(*obstacles, robot=None):
    return ConfigurationSpace(robot or Robot.rectangle(0.8, 0.3), Environment(BOUNDS, tuple(obstacles)))


def free_poses(space, n, seed=0):
    q = space.sample(np.random.default_rng(seed), n)
    return q[space.valid(q)]


def slanted_gap(width, angle, centre=(5.0, 3.0)):
    """A wall across the room with a gap of this width near the floor, all turned by an angle (radians)."""
    x, y = centre
    parts = [
        shapely.box(x - 0.2, y + width / 2, x + 0.2, y + 20),
        shapely.box(x - 0.2, y - 20, x + 0.2, y - width / 2),
    ]
    room = shapely.box(-1, -1, 11, 11)
    return [shapely.affinity.rotate(p, math.degrees(angle), origin=centre).intersection(room) for p in parts]


@pytest.mark.parametrize("angle", [0.0, 0.1, 0.37])
def test_a_gap_hardly_wider_than_the_robot_is_seen(angle):
    # A spacing of 0.156, a gap that leaves 0.02: a grid alone meets it by luck, and an open way leads around.
    far = shapely.box(0, 0, 0.01, 0.01)
    space = space_of(*slanted_gap(0.32, angle), far)
    c, s = math.cos(angle), math.sin(angle)
    start, goal = (5 - 2 * c, 3 - 2 * s, angle), (5 + 2 * c, 3 + 2 * s, angle)
    assert space.motion_free(start, goal)  # straight through
    oracle = Oracle(space, goal, start=start)
    assert oracle.cost_to_go(start) == pytest.approx(4.0, rel=0.01)


def test_a_gap_narrower_than_the_robot_stays_shut():
    space = space_of(*slanted_gap(0.29, 0.2))
    oracle = Oracle(space, (8.0, 3.0, 0.0), options=OracleOptions(resolution=(64, 64, 28)))
    assert oracle.cost_to_go((2.0, 3.0, 0.0)) == math.inf


MISSED = pytest.mark.xfail(reason="this path is 1.7 % shorter than the optimum, not 1 %", strict=True)


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        pytest.param("RandomClutter", 2, marks=MISSED),
        ("RandomClutter", 6),
        ("RandomClutter", 26),
        ("RandomClutter", 45),
        ("RandomClutter", 47),
        ("RandomTrapCup@test", 14),
    ],
)
def test_no_certified_path_is_shorter_than_the_optimum(name, seed):
    # A grid of 64 x 64 x 28 overestimates the optimum of the first three by 18, 22 and 18 %. Descents of one
    # stride stuck in the two next ones, and left the last one 1.5 % too long.
    problem = make_distribution(name).problem(seed)
    space, task = problem.space, problem.task
    oracle = Oracle(space, task.goal, start=task.start)
    fine = Oracle(space, task.goal, resolution=(160, 160, 64))
    optimum = oracle.cost_to_go(task.start)
    path = shortest_down(space, fine.state, np.array(task.start), fine.goal, 0.06)
    assert path is not None
    assert space.motions_free(path[:-1], path[1:]).all()
    np.testing.assert_array_equal(path[[0, -1]], [task.start, task.goal])
    assert lengths_left(space, path)[0] >= 0.99 * optimum
    assert optimum == pytest.approx(fine.cost_to_go(task.start), rel=0.015)


@pytest.mark.parametrize("name", ["TrapCup", "RandomClutter", "RandomMaze"])
def test_the_estimated_error_is_about_the_true_one(name):
    problem = make_distribution(name).problem(1)
    space, task = problem.space, problem.task
    oracle = Oracle(space, task.goal, start=task.start)
    q = free_poses(space, 4000, 11)
    exact = Oracle(space, task.goal, resolution=[3 * n for n in oracle.resolution]).cost_to_go(q)
    cost = oracle.cost_to_go(q)
    known = np.isfinite(exact) & np.isfinite(cost) & (exact > 0)
    error = np.abs(cost[known] / exact[known] - 1)
    assert oracle.error.mean <= 0.01
    assert oracle.error.tail <= 0.05
    assert error.mean() <= max(2.0 * oracle.error.mean, 0.01)
    assert np.quantile(error, 0.99) <= max(2.0 * oracle.error.tail, 0.05)


@pytest.mark.parametrize("name", ["RandomClutter", "RandomTrapCup"])
def test_free_edges_change_the_cost_by_their_length_both_ways(name):
    problem = make_distribution(name).problem(3)
    oracle = oracle_for(problem.space, problem.task.goal, problem.task.start)
    tree = guided_search(problem, "rrt", seed=0, max_samples=400, measure=False).tree
    q, parents = tree.nodes.configurations[: len(tree)].copy(), tree.nodes.parents[1 : len(tree)]
    cost, length = oracle.cost_to_go(q), problem.space.distance(q[1:], q[parents])
    excess = (np.abs(cost[1:] - cost[parents]) - length) / np.maximum(cost[1:], cost[parents])
    assert np.isfinite(cost).all()
    assert np.quantile(excess, 0.99) <= 0.01


def test_a_large_workspace_gets_links_that_fit_the_robot():
    problem = make_distribution("Building").problem(0)
    space, task = problem.space, problem.task
    assert len(problem.environment.obstacles) >= 300
    oracle = Oracle(space, task.goal, start=task.start)
    assert (np.array([axis[1] - axis[0] for axis in oracle.axes[:2]]) <= 0.55 * space.robot.radius).all()
    assert oracle.error.mean <= 0.01
    assert oracle.error.tail <= 0.05
    q = free_poses(space, 3000, 2)
    cost = oracle.cost_to_go(q)
    other = Oracle(space, task.goal, resolution=[int(1.6 * n) for n in oracle.resolution]).cost_to_go(q)
    known = np.isfinite(other) & (other > 0)
    assert np.isfinite(cost[known]).mean() >= 0.999
    known &= np.isfinite(cost)
    error = np.abs(cost[known] / other[known] - 1)
    assert error.mean() <= 0.01
    assert np.quantile(error, 0.99) <= 0.05


def test_a_spent_budget_is_said_once():
    space = space_of(shapely.box(2, 2, 8, 2.4), shapely.box(2, 2, 2.4, 8), shapely.box(7.6, 2, 8, 8))
    tight = OracleOptions(mean=1e-5, budget=60_000)
    solution._warned.clear()
    with pytest.warns(GuidedGymWarning, match="budget of 60,000 vertices is spent"):
        oracle = Oracle(space, (5.0, 5.0, 0.0), options=tight)
    assert math.prod(oracle.resolution) <= 60_000
    assert oracle.error.mean > 1e-5
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Oracle(space, (5.0, 6.0, 0.0), options=tight)


def test_a_smaller_error_that_is_asked_for_costs_a_finer_grid():
    space = space_of(shapely.box(2, 2, 8, 2.4), shapely.box(2, 2, 2.4, 8))
    rough = Oracle(space, (5.0, 5.0, 0.0))
    fine = Oracle(space, (5.0, 5.0, 0.0), options=OracleOptions(mean=0.4 * rough.error.mean, tail=1.0))
    assert math.prod(fine.resolution) > math.prod(rough.resolution)
    assert fine.error.mean < rough.error.mean


def test_a_loaded_oracle_has_the_error_of_the_solved_one(monkeypatch):
    space = space_of(shapely.box(4, 2, 5, 8))
    solved = Oracle(space, (8.0, 5.0, 0.0), start=(2.0, 5.0, 0.0))
    q = free_poses(space, 300)
    solved.cost_to_go(q)  # a finer grid is solved where one is needed
    monkeypatch.setattr(grid, "_solved", None)
    loaded = Oracle(space, (8.0, 5.0, 0.0), start=(2.0, 5.0, 0.0))
    assert loaded.error == solved.error
    np.testing.assert_array_equal(loaded.cost_to_go(q), solved.cost_to_go(q))


def test_a_given_resolution_is_kept_and_has_an_error_too():
    space = space_of(shapely.box(4, 2, 5, 8))
    oracle = Oracle(space, (8.0, 5.0, 0.0), options=OracleOptions(resolution=(40, 44, 24)))
    assert oracle.resolution == (40, 44, 24)
    assert 0.0 < oracle.error.mean <= oracle.error.tail < 0.2


def test_options_are_part_of_what_is_remembered():
    space = space_of(shapely.box(4, 2, 5, 8))
    first = oracle_for(space, (8.0, 5.0, 0.0))
    other = oracle_for(space, (8.0, 5.0, 0.0), options=OracleOptions(resolution=(32, 32, 16)))
    assert other is not first
    assert oracle_for(space, (8.0, 5.0, 0.0), options=OracleOptions(resolution=(32, 32, 16))) is other
    assert oracle_for(space, (8.0, 5.0, 0.0), options=OracleOptions()) is first


def test_a_search_is_measured_by_the_oracle_of_its_options():
    problem = make_distribution("SimplePassage").problem(0)
    results = [
        guided_search(problem, "rrt", seed=0, max_samples=20, options=SearchOptions(oracle=options))
        for options in (OracleOptions(), OracleOptions(resolution=(24, 24, 16)))
    ]
    np.testing.assert_array_equal(results[0].record.child, results[1].record.child)
    assert results[0].total_efficiency != results[1].total_efficiency


def test_no_path_says_at_what_spacing_and_what_to_do():
    wall = shapely.box(4, -1, 5, 11)
    with pytest.raises(NoPathError, match=r"none found at spacing 0\.\d+ .* raise the resolution"):
        Oracle(space_of(wall), (8.0, 5.0, 0.0), start=(2.0, 5.0, 0.0))


@pytest.mark.parametrize(
    "options",
    [
        {"resolution": (64, 64, 64, 64)},
        {"method": "wave"},
        {"resolution": 64},
        {"resolution": (64, 64, 2)},
        {"mean": 0.0},
        {"tail": "5 %"},
        {"budget": 100},
    ],
)
def test_unusable_options_are_refused(options):
    with pytest.raises(InvalidInputError, match=next(iter(options))):
        OracleOptions(**options)


def test_a_point_robot_passes_a_hairline_gap():
    space = space_of(*slanted_gap(0.004, 0.3), robot=Robot.point())
    c, s = math.cos(0.3), math.sin(0.3)
    start, goal = (5 - 2 * c, 3 - 2 * s), (5 + 2 * c, 3 + 2 * s)
    assert Oracle(space, goal, start=start).cost_to_go(start) == pytest.approx(4.0, rel=0.01)


def test_a_plain_grid_joins_what_its_links_join():
    space = space_of(shapely.box(4, -1, 5, 8))
    start, goal = np.array([2.0, 5.0, 0.0]), np.array([8.0, 5.0, 0.0])
    assert grid_joins(space, start, goal, (64, 64, 28))
    shut = space_of(shapely.box(4, -1, 5, 9.95))
    assert not grid_joins(shut, start, goal, (64, 64, 28))
