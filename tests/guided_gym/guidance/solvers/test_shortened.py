"""A roadmap's way, its detours cut off: what is cut, what is asked, and when the way ends."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from guided_gym.catalogue.table import make_distribution
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.solvers.base import Query
from guided_gym.guidance.solvers.roadmap import Roadmap
from guided_gym.guidance.solvers.shortened import Shortened
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task

STEP = 0.5
START, GOAL = np.array([1.0, 2.0]), np.array([9.0, 2.0])


def world(*obstacles: shapely.Polygon) -> ConfigurationSpace:
    """A point among boxes."""
    return ConfigurationSpace(Robot.point(), Environment((0.0, 0.0, 10.0, 10.0), obstacles))


WALL = shapely.box(4.0, 0.0, 6.0, 7.0)
AROUND = float(np.hypot(3.0, 5.0) + 2.0 + np.hypot(3.0, 5.0))  # over both upper corners of the wall


def begun(kind: type[Roadmap] = Shortened, seed: int = 0, vertices: int = 150) -> Roadmap:
    """A solver at work on the way over the wall."""
    solver = kind(vertices=vertices, neighbours=8)
    solver.begin(Query(world(WALL), START, GOAL), np.random.default_rng(seed), STEP)
    return solver


def laid(seed: int = 0) -> Shortened:
    """One whose way from the start is laid."""
    solver = begun(seed=seed)
    assert isinstance(solver, Shortened)
    solver.follow(START[None])
    return solver


@pytest.mark.parametrize("seed", range(6))
def test_the_way_is_nearly_the_shortest_and_the_roadmaps_is_not(seed: int) -> None:
    long, short = (float(begun(kind, seed).follow(START[None])[0]) for kind in (Roadmap, Shortened))
    assert AROUND - 1e-9 <= short < 1.04 * AROUND
    assert short < long
    assert long > 1.04 * AROUND


def test_the_way_is_free_and_what_is_left_is_its_length() -> None:
    solver = laid()
    way = solver._way
    assert way is not None
    space, parts = solver.query.space, solver.query.space.distance(way.points[:-1], way.points[1:])
    assert space.motions_free(way.points[:-1], way.points[1:]).all()
    assert (parts <= 0.25 * STEP + 1e-9).all()
    assert way.left[:-1] - way.left[1:] == pytest.approx(parts)
    assert (way.points[0] == START).all() and (way.points[-1] == GOAL).all() and way.left[-1] == 0.0


def test_corners_in_the_open_are_cut_to_a_straight_line() -> None:
    solver = Shortened(vertices=30)
    solver.begin(Query(world(shapely.box(4, 8, 5, 9)), START, GOAL), np.random.default_rng(0), STEP)
    corners = np.array([START, [2.0, 5.0], [5.0, 6.0], [8.0, 1.0], GOAL])
    costs = solver.query.space.distance(corners[:-1], corners[1:])
    cut, left = solver._cut(corners, costs)
    assert cut[[0, -1]] == pytest.approx(corners[[0, -1]])
    assert left.sum() == pytest.approx(8.0)


def test_costs_of_what_is_left_standing_stay_what_they_were() -> None:
    """Parts that cost three times their length are worth cutting; parts of a straight line are not."""
    solver = Shortened(vertices=30)
    solver.begin(Query(world(WALL), START, GOAL), np.random.default_rng(3), STEP)
    corners = np.array([START, [2.0, 2.0], [3.0, 2.0], [3.5, 2.0]])
    costs = np.array([1.0, 3.0, 0.5])
    cut, left = solver._cut(corners, costs)
    lengths = solver.query.space.distance(cut[:-1], cut[1:])
    assert lengths.sum() == pytest.approx(2.5)
    assert 2.5 - 1e-9 <= left.sum() < 2.6  # of 4.5
    assert (left >= lengths - 1e-9).all()


def test_a_state_beside_the_way_joins_it_by_a_free_motion() -> None:
    solver = laid()
    over, behind = np.array([[5.0, 8.0]]), np.array([[6.5, 1.0]])
    h = float(solver(over)[0])
    straight = np.hypot(1.0, 1.0) + np.hypot(3.0, 5.0)  # by the far corner
    assert straight - 1e-9 <= h < 1.1 * straight
    assert float(solver(behind)[0]) < 1.5 * np.hypot(2.5, 1.0)


def test_a_failure_near_the_way_ends_it_and_one_far_away_does_not() -> None:
    solver = laid()
    before, way = float(solver.follow(START[None])[0]), solver._way
    solver.raise_near(np.array([1.0, 9.5]), 0.2, np.inf)
    assert solver._way is way
    assert float(solver.follow(START[None])[0]) == before
    solver.raise_near(np.array([5.0, 7.2]), 0.5, np.inf)
    assert solver._way is None
    after = float(solver.follow(START[None])[0])
    assert solver._way is not None
    assert after > before
    apart = solver.query.space.distance(solver._way.points, np.array([5.0, 7.2]))
    assert apart.min() > 0.4  # chords, too, keep away from it


def test_a_joint_near_a_failure_is_given_up() -> None:
    solver = laid()
    nodes = np.array([START, [1.0, 0.3]])
    before = np.array(solver.follow(nodes))
    joint = solver._joints[1]
    solver.raise_near(0.5 * (nodes[1] + joint), 0.2, np.inf)
    assert solver._way is not None
    assert solver._along[1] == np.inf
    after = np.array(solver.follow(nodes))
    assert after[0] == before[0] and after[1] >= before[1]  # by the roadmap, if at all


def test_chords_are_looked_at_where_failures_have_had_vertices_looked_at() -> None:
    """E' is without the wall: what has been looked at in E forbids chords through it."""
    solver = Shortened(vertices=300, neighbours=8)
    query = Query(world(shapely.box(0.0, 0.0, 0.5, 0.5)), START, GOAL)
    solver.begin(query, np.random.default_rng(0), STEP)
    assert float(solver.follow(START[None])[0]) == pytest.approx(8.0)
    truth = world(WALL)
    contact = np.array([4.0, 2.0])
    solver.raise_near(contact, 0.2, np.inf)
    solver.inspect(contact, 20.0, truth.valid)
    after = float(solver.follow(START[None])[0])
    assert solver._way is not None
    assert truth.valid(solver._way.points).mean() > 0.95
    assert 0.98 * AROUND < after < 1.3 * AROUND


def test_ahead_is_on_the_way_within_a_step() -> None:
    solver = laid()
    states = solver.ahead(START)
    assert (solver.query.space.distance(states, START) <= STEP + 1e-9).all()
    h = solver(np.ascontiguousarray(states))
    assert h.min() < float(solver.follow(START[None])[0]) - 0.7 * STEP
    assert solver.ahead(GOAL) == pytest.approx(np.tile(GOAL, (4, 1)))
    away = begun()
    assert isinstance(away, Shortened)
    assert away.ahead(START).shape == (0, 2)  # there is no way yet


def test_where_nobody_can_be_asked_it_is_a_roadmap(walled_problem: Problem) -> None:
    trees = [
        guided_search(walled_problem, f"{name}(environment=nothing)", seed=2, max_samples=60, measure=False)
        for name in ("roadmap", "shortened")
    ]
    assert np.array_equal(trees[0].tree.configurations, trees[1].tree.configurations)


@pytest.fixture
def walled_problem() -> Problem:
    return Problem(Robot.rectangle(0.8, 0.3), world(WALL).environment, Task((1, 2, 0.0), (9, 2, 1.0)))


def test_arms_need_fewer_samples_along_a_way_that_is_believed_free() -> None:
    distribution, samples = make_distribution("RandomPlanarArm7@validation"), []
    for options in ("shortened=false", "shortened=true"):
        name = f"learned:planar-arm-7(vertices=1500, checked=1500, {options})"
        samples.append(
            sum(
                guided_search(distribution.problem(k), name, seed=k, max_samples=200, measure=False).samples
                for k in (0, 2, 6, 9)
            )
        )
    assert samples[1] < 0.7 * samples[0]
