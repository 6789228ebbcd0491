"""The grid of poses and the wave through it, against exact geometry and the exact cost-to-go."""

from __future__ import annotations

import pickle
from collections.abc import Callable

import numpy as np
import pytest
import shapely

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.linkages import Linkage
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.solvers.base import Query
from guided_gym.guidance.solvers.wave import Arrivals, PoseGrid, Wave, WaveModel, body_discs, obstacle_edges
from guided_gym.kernels import fields
from guided_gym.measure.oracle import oracle_for
from guided_gym.problems import Problem, Task

FORK = Robot.polygon([(-2, -2), (2, -2), (2, 2), (1.2, 2), (1.2, -1.2), (-1.2, -1.2), (-1.2, 2), (-2, 2)])


def with_gap(width: float) -> Problem:
    """A point on the left of a wall, and a gap in the middle of it on the edge between two rows of cells."""
    halves = [(0.45, 0.0, 0.55, 0.5 - width / 2), (0.45, 0.5 + width / 2, 0.55, 1.0)]
    environment = Environment((0, 0, 1, 1), tuple(shapely.box(*half) for half in halves))
    return Problem(Robot.point(), environment, Task((0.2, 0.6), (0.8, 0.6)))


def poses(problem: Problem, count: int, seed: int = 0) -> np.ndarray:
    return problem.space.sample(np.random.default_rng(seed), count)


@pytest.mark.parametrize(
    "robot",
    [
        Robot.rectangle(0.8, 0.3),
        Robot.segment(0.4),
        Robot.polygon([(0, 0), (1, 0), (1, 0.2), (0.2, 0.2), (0.2, 1), (0, 1)]),
        FORK,
    ],
    ids=["rectangle", "segment", "non-convex", "fork"],
)
def test_body_discs__lie_in_the_robot_and_fill_it(robot: Robot) -> None:
    discs = body_discs(robot, robot.radius)
    union = shapely.union_all([shapely.Point(x, y).buffer(r + 1e-4) for x, y, r in discs])
    assert union.difference(robot.outline.buffer(1e-3)).area < 1e-9
    assert shapely.hausdorff_distance(union, robot.outline, densify=0.05) < 0.3 * robot.radius


def test_body_discs__of_a_point_are_the_point() -> None:
    assert body_discs(Robot.point(), 1.0).tolist() == [[0.0, 0.0, 0.0]]


def test_the_room_of_a_robot_says_where_it_is_free() -> None:
    problem = make_distribution("TrapCup").problem(0)
    grid = PoseGrid.of(problem.space, 56, 16)
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


def test_the_room_of_a_fork_astride_a_post() -> None:
    """Its reference point lies deep in the post, and it is free."""
    environment = Environment((0, 0, 10, 10), (shapely.box(4.3, 0, 5.7, 6),))
    problem = Problem(FORK, environment, Task((5, 6, np.pi), (5, 7.5, np.pi)))
    grid = PoseGrid.of(problem.space, 56, 16)
    assert grid.room[30, 27, 8] > 1.0 > -1.0 > grid.room[30, 27, 0]


@pytest.mark.parametrize("name", ["SimplePassage", "walled point"])
def test_the_wave_is_near_the_true_distance(name: str, walled: Callable[[str], Problem]) -> None:
    problem = walled("point") if name == "walled point" else make_distribution(name).problem(0)
    model = WaveModel(24, 8)
    field = model.evaluate(PoseGrid.of(problem.space, 24, 8), problem.task.goal)
    q = poses(problem, 2000)
    q = q[problem.space.valid(q)]
    truth = np.asarray(oracle_for(problem.space, problem.task.goal).cost_to_go(q))
    found = field.cost_to_go(q)
    assert np.median(np.abs(found - truth) / np.maximum(truth, 0.1 * truth.max())) < 0.1
    assert (found >= problem.space.distance(q, problem.task.goal) - 1e-6).all()


def test_the_wave_does_not_begin_behind_a_thin_wall() -> None:
    environment = Environment((0, 0, 1, 1), (shapely.box(0.474, 0.0, 0.494, 0.9),))
    problem = Problem(Robot.point(), environment, Task((0.3, 0.5), (0.505, 0.5)))
    grid = PoseGrid.of(problem.space, 32, 8)
    frame = grid.towards(problem.task.goal)
    places, distances, _ = grid.beginnings(frame)
    x = frame[fields.ORIGIN_X] + places % 32 * frame[fields.CELL]
    y = frame[fields.ORIGIN_Y] + places // 32 * frame[fields.CELL]
    assert (x > 0.48).all()
    assert distances == pytest.approx(np.hypot(x - 0.505, y - 0.5))
    over_it = WaveModel(32, 8).evaluate(grid, problem.task.goal).cost_to_go(np.array([[0.44, 0.5]]))[0]
    assert over_it == pytest.approx(0.8, rel=0.2)


def test_the_wave_of_a_goal_without_room_begins_at_the_best_pose_near_it() -> None:
    tight = (shapely.box(0.3, 0.0, 0.499, 1.0), shapely.box(0.501, 0.0, 0.7, 1.0))
    problem = Problem(
        Robot.rectangle(0.2, 0.001),
        Environment((0, 0, 1, 1), tight),
        Task((0.15, 0.5, 0), (0.5, 0.5, np.pi / 2)),
    )
    grid = PoseGrid.of(problem.space, 24, 8)
    places, distances, _ = grid.beginnings(grid.towards(problem.task.goal))
    assert len(places) >= 1
    assert np.isfinite(WaveModel(24, 8).evaluate(grid, problem.task.goal).values).all()
    assert distances.max() < 3 / 24 * np.sqrt(2) + problem.space.weights[2] * 2 * np.pi / 8


def test_workspaces_that_are_not_square_lie_in_the_middle_of_one() -> None:
    space = Problem(Robot.point(), Environment((0, 0, 2, 1)), Task((0.2, 0.5), (1.8, 0.5))).space
    grid = PoseGrid.of(space, 24, 8)
    assert grid.side == 2.0
    assert (grid.workspace[0] < 0).all()
    assert (grid.workspace[12] > 0).all()


def test_a_robot_that_cannot_turn_has_one_heading_and_the_room_of_a_point(
    walled: Callable[[str], Problem],
) -> None:
    grid = PoseGrid.of(walled("point").space, 24, 8)
    assert grid.room.shape == (24, 24, 1)
    some = np.abs(grid.workspace) < 1.5
    assert some.any()
    assert grid.room[..., 0][some] == pytest.approx(grid.workspace[some], abs=0.1)


def test_robots_that_are_not_planar_and_rigid_are_refused() -> None:
    environment = Environment((0.0, 0.0, 1.0, 1.0))
    for arm in (Linkage.arm([0.1] * 2, base=(0.5, 0.5)), Linkage.snake([0.1] * 2)):
        with pytest.raises(
            InvalidInputError, match=r"expected a rigid planar robot, got .* of [24] coordinates"
        ):
            PoseGrid.of(ConfigurationSpace(arm, environment), 24, 8)


def solved(model: WaveModel, problem: Problem) -> Arrivals:
    return model.solve(problem.space, problem.task.start, problem.task.goal)


def told(found: Arrivals, q: np.ndarray) -> np.ndarray:
    return found.at(found.join(q))


@pytest.mark.parametrize(("gap", "cells"), [(0.06, 24), (0.04, 32), (0.03, 48), (0.0, 48)])
def test_solve__looks_for_a_way_in_a_finer_grid(gap: float, cells: int) -> None:
    problem = with_gap(gap)
    found = solved(WaveModel(24, 8), problem)
    assert found.grid.room.shape == (cells, cells, 1)
    assert found.frame[fields.CELL] == pytest.approx(1 / cells)
    way = told(found, problem.task.start[None])[0]
    direct = 2 * np.hypot(0.3, 0.1)
    assert way > 10 if gap == 0 else way == pytest.approx(direct, rel=0.15)


def test_solve__keeps_the_last_problems() -> None:
    model = WaveModel(8, 4)
    problems = [with_gap(0.3 + 0.01 * i) for i in range(9)]
    first = solved(model, problems[0])
    assert solved(model, with_gap(0.3)) is first  # the same content
    for problem in problems[1:8]:
        solved(model, problem)
    assert solved(model, problems[0]) is first
    second = solved(model, problems[1])
    solved(model, problems[8])
    assert solved(model, problems[1]) is second
    assert len(model._kept) == 8
    assert solved(model, problems[2]) is not None


def test_solve__another_goal_is_another_problem() -> None:
    model, problem = WaveModel(8, 4), with_gap(0.3)
    turned = Problem(problem.robot, problem.environment, Task(problem.task.goal, problem.task.start))
    there, back = (solved(model, each) for each in (problem, turned))
    ends = np.stack([problem.task.start, problem.task.goal])
    assert told(there, ends)[1] < 1 / 8 < 0.6 < told(there, ends)[0]
    assert told(back, ends)[0] < 1 / 8 < 0.6 < told(back, ends)[1]


def test_pickling__leaves_the_fields_behind() -> None:
    model, problem = WaveModel(24, 8, blocked=50.0), with_gap(0.2)
    before, q = len(pickle.dumps(model)), problem.task.start[None]
    found = solved(model, problem)
    assert len(pickle.dumps(model)) == before
    twin = pickle.loads(pickle.dumps(model))
    assert twin.blocked == 50.0
    assert np.array_equal(told(solved(twin, problem), q), told(found, q))


def disc(radius: float) -> Robot:
    """A 16-gon that cannot turn."""
    angles = 2 * np.pi * np.arange(16) / 16
    return Robot(shapely.Polygon(radius * np.column_stack([np.cos(angles), np.sin(angles)])), dimension=2)


SEEN_BY = {"point": Robot.point(), "disc": disc(0.15), "rectangle": None, "rod": Robot.segment(0.8)}


def query(name: str = "TrapCup", robot: Robot | None = None) -> Query:
    """A problem of the catalogue as another robot sees it."""
    problem = make_distribution(name).problem(0)
    space = ConfigurationSpace(robot or problem.robot, problem.environment)
    d = space.dimension
    return Query(space, problem.task.start[:d].copy(), problem.task.goal[:d].copy())


def begun(asked: Query, **options: float) -> Wave:
    solver = Wave(**options)
    solver.begin(asked, np.random.default_rng(0), 0.7)
    return solver


@pytest.mark.parametrize("robot", SEEN_BY)
def test_wave__is_near_the_true_distance_and_infinite_in_collision(robot: str) -> None:
    asked = query(robot=SEEN_BY[robot])
    solver, space = begun(asked, cells=40, headings=16), asked.space
    q = space.sample(np.random.default_rng(0), 1500)
    found, free = solver(q), np.asarray(space.valid(q))
    assert np.array_equal(np.isfinite(found), free)
    truth = np.asarray(oracle_for(space, asked.goal).cost_to_go(q[free]))
    assert np.median(np.abs(found[free] - truth) / np.maximum(truth, 0.1 * truth.max())) < 0.1
    assert (found >= space.distance(q, asked.goal) - 1e-6).all()


@pytest.mark.parametrize("robot", SEEN_BY)
def test_wave__costs_only_rise_and_nodes_follow(robot: str) -> None:
    asked = query(robot=SEEN_BY[robot])
    solver, rng = begun(asked, cells=24, headings=8), np.random.default_rng(0)
    nodes = asked.space.sample(rng, 300)
    before = solver.follow(nodes[:100]).copy()
    for k in range(40):
        solver.raise_near(nodes[k], rng.choice([0.0, 0.1, 0.5]), rng.choice([2.0, 10.0, np.inf]))
        count = 100 + 5 * k
        values = solver.follow(nodes[:count])
        assert np.array_equal(values, solver(nodes[:count]))
        assert (values[: len(before)] >= before - 1e-6).all()
        before = values.copy()
    with pytest.raises(ValueError, match="read-only"):
        values[0] = 0.0


def test_wave__what_is_forbidden_on_all_ways_is_out_of_reach(walled: Callable[[str], Problem]) -> None:
    problem = walled("point")
    solver = begun(Query(problem.space, problem.task.start, problem.task.goal))
    q = np.array([[1.5, 5.0], [4.0, 9.0], [8.0, 1.0]])
    first = solver(q)
    solver.raise_near(np.array([5.0, 9.0]), 2.0, np.inf)
    second = solver(q)
    assert first[0] < second[0] < np.inf  # below the wall
    assert second[2] == pytest.approx(first[2])
    solver.raise_near(np.array([5.0, 1.0]), 2.0, np.inf)
    third = solver(q)
    assert third[0] < np.inf  # slowly, through the wall
    solver.raise_near(np.array([5.0, 5.0]), 6.0, np.inf)
    assert solver(q).tolist()[:2] == [np.inf, np.inf]
    solver.begin(Query(problem.space, problem.task.start, problem.task.goal), np.random.default_rng(1), 0.7)
    assert np.array_equal(solver(q), first)  # a new search has forgotten


@pytest.mark.parametrize("robot", SEEN_BY)
def test_wave__forbids_states_within_reach_of_an_infinite_failure(robot: str) -> None:
    """However little that is: no other pose nearby speaks for them."""
    asked = query(robot=SEEN_BY[robot])
    solver, space = begun(asked, cells=24, headings=8), asked.space
    q = space.sample(np.random.default_rng(0), 400)
    q = q[np.isfinite(solver(q))]
    for state in q[:5]:
        solver.raise_near(state, 0.3, np.inf)
    away = np.min([space.distance(q, state) for state in q[:5]], axis=0)
    for values in (solver(q), solver.follow(q)):
        assert np.isinf(values[away <= 0.3]).all()
        assert np.isfinite(values[away > 2.0]).mean() > 0.9


def test_wave__looks_only_where_it_goes_and_tells_what_a_whole_grid_tells() -> None:
    asked = query("RandomClutter")
    solver, whole = begun(asked), begun(asked)
    fields.look_everywhere(whole._now.grid.ground)
    q = np.concatenate([asked.start[None], asked.space.sample(np.random.default_rng(0), 30)])
    first = solver(q[:1])
    assert np.isnan(solver._now.grid.room).mean() > 0.1
    assert np.array_equal(whole(q), solver(q))  # in whichever order one asks
    assert np.array_equal(solver(q[:1]), first)


def test_a_grid__has_as_few_headings_as_a_stout_robot_needs() -> None:
    stout, thin = query("RandomClutter").space, query("RandomClutter", Robot.segment(0.8)).space
    assert PoseGrid.of(stout, 56, 16, whole=False).room.shape == (56, 56, 12)
    assert PoseGrid.of(stout, 56, 16).room.shape == (56, 56, 16)
    assert PoseGrid.of(stout, 56, 8, whole=False).room.shape == (56, 56, 8)
    assert PoseGrid.of(thin, 56, 16, whole=False).room.shape == (56, 56, 16)


def test_wave__a_failure_at_a_state_slows_the_nearest_pose() -> None:
    asked = query(robot=Robot.point())
    solver = begun(asked, cells=24)
    q = asked.start[None]
    before = solver(q)
    solver.raise_near(asked.start, 0.0, 50.0)
    assert solver(q)[0] > before[0] + 0.1


def test_wave__in_three_dimensions_runs_again_less_often_the_more_it_has() -> None:
    asked = query()
    solver = begun(asked, cells=16, headings=8)
    runs = 0
    for k in range(60):
        solver.raise_near(asked.space.sample(np.random.default_rng(k), 1)[0], 0.3, 2.0)
        front = solver._now.front
        solver(asked.start[None])
        runs += solver._now.front is not front
        assert k > 0 or runs == 1  # the first at once
    assert 15 < runs < 30


def test_wave__refuses_other_dimensions_and_sizes() -> None:
    snake = ConfigurationSpace(Linkage.snake([0.1] * 2), Environment((0.0, 0.0, 1.0, 1.0)))
    with pytest.raises(InvalidInputError, match="got 4 dimensions"):
        begun(Query(snake, np.full(4, 0.5), np.full(4, 0.4)))
    for options in ({"cells": 50}, {"headings": 6}, {"blocked": 0.5}):
        with pytest.raises(InvalidInputError, match=next(iter(options))):
            Wave(**options)  # type: ignore[arg-type]


def test_wave__pickles() -> None:
    asked = query(robot=Robot.point())
    solver = begun(asked)
    twin = pickle.loads(pickle.dumps(solver))
    q = asked.space.sample(np.random.default_rng(0), 50)
    solver.raise_near(q[0], 0.5, 10.0)
    twin.raise_near(q[0], 0.5, 10.0)
    assert np.array_equal(solver(q), twin(q))


def test_obstacle_edges__are_those_of_rims_and_holes_and_join_no_two_rings() -> None:
    assert obstacle_edges(Environment((0, 0, 1, 1))).shape == (0, 4)
    frame = shapely.box(1, 1, 9, 9) - shapely.box(3, 3, 5, 5)
    edges = obstacle_edges(Environment((0, 0, 20, 20), [frame, shapely.box(12, 12, 13, 14)]))
    assert edges.shape == (12, 4)
    assert np.hypot(*(edges[:, 2:] - edges[:, :2]).T).sum() == pytest.approx(4 * 8 + 4 * 2 + 6)
