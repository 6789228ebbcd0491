"""The oracle over a roadmap: against grids, exact distances, and itself."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import GuidedGymWarning, InvalidInputError, NoPathError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.linkages import Linkage
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.kernels.cost_query import cost_to_go_many
from guided_gym.measure import roadmap, solution
from guided_gym.measure.oracle import Oracle, oracle_for
from guided_gym.options import OracleOptions, SearchOptions
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task

BOUNDS = (0.0, 0.0, 10.0, 10.0)
pytestmark = pytest.mark.usefixtures("own_cache")
ROADMAP = OracleOptions(method="roadmap", resolution=(3000,))


def space_of(*obstacles, robot=None):
    return ConfigurationSpace(robot or Robot.rectangle(0.8, 0.3), Environment(BOUNDS, tuple(obstacles)))


def free_poses(space, n, seed=0):
    q = space.sample(np.random.default_rng(seed), n)
    return q[space.valid(q)]


@pytest.mark.parametrize("name", ["RandomClutter", "RandomMaze", "RandomTrapCup", "HardStickMaze"])
def test_the_mean_error_against_a_grid_is_below_two_percent(name):
    problem = make_distribution(name).problem(1)
    space, task = problem.space, problem.task
    q = free_poses(space, 400)
    grid = Oracle(space, task.goal).cost_to_go(q)
    oracle = Oracle(space, task.goal, options=OracleOptions(method="roadmap", resolution=(10_000,)))
    cost = oracle.cost_to_go(q)
    known = np.isfinite(grid) & (grid > 0)
    assert np.isfinite(cost[known]).all()
    assert np.mean(np.abs(cost[known] / grid[known] - 1.0)) < 0.02
    assert 0.0 < oracle.error.mean < 0.03


@pytest.mark.parametrize("seed", range(3))
def test_no_distance_is_shorter_than_the_shortest_path(seed, reference):
    rng = np.random.default_rng(seed)
    obstacles = [shapely.box(x, y, x + 1, y + 1) for x, y in rng.uniform(1, 8, (7, 2))]
    obstacles = list(shapely.get_parts(shapely.unary_union(obstacles)))
    space = space_of(*obstacles, robot=Robot.point())
    q = free_poses(space, 300, seed)
    goal, q = q[0], q[1:]
    exact = reference("visibility_graph").visibility_distances(obstacles, BOUNDS, goal, q)
    cost = Oracle(space, goal, options=ROADMAP).cost_to_go(q)
    # Motions keep the tolerance away from obstacles, so none is as short as the exact path.
    assert (cost >= exact * (1.0 - 1e-9)).all()
    assert np.mean(cost / exact - 1.0) < 0.01


def test_an_open_way_is_a_straight_line():
    space = space_of()
    q = free_poses(space, 200)
    cost = Oracle(space, (3.0, 4.0, 1.0), options=ROADMAP).cost_to_go(q)
    np.testing.assert_allclose(cost, space.distance(q, (3.0, 4.0, 1.0)), rtol=1e-12)


def test_free_motions_hardly_change_the_cost_by_more_than_their_length():
    space = space_of(shapely.box(3, 2, 4, 8), shapely.box(6, 0, 7, 5))
    oracle = Oracle(space, (9.0, 1.0, 0.0), options=ROADMAP)
    a = free_poses(space, 400)
    b = np.ascontiguousarray(a + np.random.default_rng(1).normal(size=a.shape) * 0.3)
    free = space.motions_free(a, b)
    a, b = a[free], b[free]
    over = np.abs(oracle.cost_to_go(a) - oracle.cost_to_go(b)) - space.distance(a, b)
    assert np.mean(over > 0.02 * oracle.cost_to_go(a)) < 0.02


def test_it_does_not_matter_who_asks_first():
    space = space_of(shapely.box(3, 2, 4, 8), shapely.box(6, 0, 7, 5))
    q = free_poses(space, 100)
    first, second = (Oracle(space, (9.0, 1.0, 0.0), options=ROADMAP, cache=False) for _ in range(2))
    np.testing.assert_array_equal(first.cost_to_go(q), second.cost_to_go(q[::-1])[::-1])
    assert first.cost_to_go(q[3]) == second.cost_to_go(q)[3]
    again = pickle.loads(pickle.dumps(first))
    np.testing.assert_array_equal(again.cost_to_go(q), first.cost_to_go(q))
    assert again.error == first.error


def test_one_roadmap_serves_all_tasks_and_processes(monkeypatch, tmp_path):
    space = space_of(shapely.box(3, 2, 4, 8))
    q = free_poses(space, 50)
    first = Oracle(space, (9.0, 1.0, 0.0), options=ROADMAP)
    assert len(list((tmp_path / "cache").rglob("*.field"))) == 1
    monkeypatch.setattr(roadmap.Roadmap, "of", None)  # no other is made
    assert np.isfinite(
        Oracle(space, (1.0, 1.0, 0.0), start=(9.0, 9.0, 0.0), options=ROADMAP).cost_to_go(q)
    ).all()
    roadmap._worlds.clear()  # as in another process
    other = Oracle(space, (9.0, 1.0, 0.0), options=ROADMAP)
    np.testing.assert_array_equal(other.cost_to_go(q), first.cost_to_go(q))


@pytest.mark.parametrize("damage", [lambda b: b[:-9], lambda b: b[:40], lambda b: b[:300] + b"\1" + b[301:]])
def test_a_damaged_roadmap_is_made_anew(tmp_path, damage):
    space = space_of(shapely.box(3, 2, 4, 8))
    q = free_poses(space, 50)
    first = Oracle(space, (9.0, 1.0, 0.0), options=ROADMAP)
    (file,) = (tmp_path / "cache").rglob("*.field")
    file.write_bytes(damage(file.read_bytes()))
    roadmap._worlds.clear()
    np.testing.assert_array_equal(
        Oracle(space, (9.0, 1.0, 0.0), options=ROADMAP).cost_to_go(q), first.cost_to_go(q)
    )


def test_poses_in_collision_and_numbers_that_are_none_are_infinitely_far():
    oracle = Oracle(space_of(shapely.box(3, 2, 4, 8)), (9.0, 1.0, 0.0), options=ROADMAP)
    q = np.array([[3.5, 5.0, 0.0], [-3.0, 5.0, 0.0], [np.nan, 5.0, 0.0], [2.0, 5.0, np.inf]])
    assert np.isinf(oracle.cost_to_go(q)).all()


@pytest.mark.parametrize("inside", ["goal", "start"])
def test_a_pocket_that_no_vertex_sees_is_left_by_a_tree(inside, monkeypatch):
    monkeypatch.setattr(roadmap, "_NARROW", 0.0)
    # A corridor with a bend that opens at the top: whoever stands at its end sees nothing outside.
    walls = [(3, 3, 6, 4), (3, 4.5, 5.5, 6), (6, 3, 7, 6), (2, 3, 3, 6)]
    robot = Robot(shapely.box(-0.15, -0.15, 0.15, 0.15), dimension=2)
    space = space_of(*(shapely.box(*wall) for wall in walls), robot=robot)
    poses = {inside: (3.3, 4.25), "goal" if inside == "start" else "start": (9.0, 1.0)}
    few = OracleOptions(method="roadmap", resolution=(60,))
    oracle = Oracle(space, poses["goal"], start=poses["start"], options=few)
    # Along the corridor, up, and around the outer corner; no tree is the shortest way.
    assert 9.5 < oracle.cost_to_go(poses["start"]) < 14.0


def test_a_start_that_cannot_reach_the_goal_is_refused():
    space = space_of(shapely.box(4, -1, 5, 11))
    with pytest.raises(NoPathError, match=r"over a roadmap of 3,000 configurations.*raise the budget"):
        Oracle(space, (8.0, 5.0, 0.0), start=(2.0, 5.0, 0.0), options=ROADMAP)


def test_a_spent_budget_is_said_once_and_errors_shrink_with_it():
    space = space_of(shapely.box(2, 2, 8, 2.4), shapely.box(2, 2, 2.4, 8), shapely.box(7.6, 2, 8, 8))
    solution._warned.clear()
    with pytest.warns(GuidedGymWarning, match="over a roadmap of .* configurations: its budget of 1,200,000"):
        oracle = Oracle(
            space, (5.0, 5.0, 0.0), options=OracleOptions(mean=1e-5, budget=1_200_000, method="roadmap")
        )
    assert oracle.resolution == (6000,)


@pytest.mark.parametrize("resolution", [(64, 64, 28), (64, 64)])
def test_a_resolution_that_is_no_number_of_vertices_is_refused(resolution):
    with pytest.raises(InvalidInputError, match="number of vertices as a roadmap"):
        Oracle(space_of(), (5.0, 5.0, 0.0), options=OracleOptions(method="roadmap", resolution=resolution))


def test_compiled_callers_are_told_to_ask_and_there_is_no_field():
    space = space_of(shapely.box(3, 2, 4, 8))
    oracle = Oracle(space, (9.0, 1.0, 0.0), options=ROADMAP)
    assert np.isinf(cost_to_go_many(free_poses(space, 20), oracle.state)).all()
    with pytest.raises(InvalidInputError, match="over a grid, got one over a roadmap of 3,000"):
        _ = oracle.field


def test_a_search_is_measured_alike():
    problem = make_distribution("TrapCup").problem(0)
    options = SearchOptions(oracle=OracleOptions(method="roadmap", resolution=(10_000,)))
    grid = guided_search(problem, "wavefront", seed=0, max_samples=150)
    road = guided_search(problem, "wavefront", seed=0, max_samples=150, options=options)
    np.testing.assert_array_equal(grid.record.child, road.record.child)
    assert road.total_efficiency == pytest.approx(grid.total_efficiency, rel=0.1)


def test_oracles_of_both_kinds_are_remembered_apart():
    space = space_of(shapely.box(3, 2, 4, 8))
    goal = (9.0, 1.0, 0.0)
    assert oracle_for(space, goal).resolution != oracle_for(space, goal, options=ROADMAP).resolution
    assert oracle_for(space, goal, options=ROADMAP) is oracle_for(space, goal, options=ROADMAP)
    assert math.prod(oracle_for(space, goal, options=ROADMAP).resolution) == 3000


def two_links() -> ConfigurationSpace:
    boxes = [(6.4, 5.6, 7.2, 6.6), (3.2, 6.2, 4.4, 6.8), (4.6, 2.0, 5.4, 3.4)]
    arm = Linkage.arm([1.6, 1.4], 0.2, base=(5.0, 5.0))
    return ConfigurationSpace(arm, Environment(BOUNDS, tuple(shapely.box(*box) for box in boxes)))


def test_an_arm_of_two_links_agrees_with_a_dense_graph_on_its_torus():
    # 72 x 72 configurations, each joined to 32 around it: its paths are up to 1.3 % too long.
    space, n = two_links(), 72
    turns = -math.pi + 2.0 * math.pi * (np.arange(n) + 0.5) / n
    poses = np.stack(np.meshgrid(turns, turns, indexing="ij"), axis=-1).reshape(-1, 2)
    steps = [(i, j) for i in range(5) for j in range(-4, 5) if math.gcd(i, j) == 1 and (i > 0 or j > 0)]
    number = np.arange(n * n, dtype=np.int32).reshape(n, n)  # scipy 1.14 takes no longer indices
    heads = np.concatenate([np.roll(number, (-i, -j), (0, 1)).ravel() for i, j in steps])
    tails = np.tile(number.ravel(), len(steps))
    free = np.asarray(space.motions_free(poses[tails], poses[heads]))
    tails, heads = tails[free], heads[free]
    graph = coo_array((space.distance(poses[tails], poses[heads]), (tails, heads)), shape=(n * n, n * n))
    goal = int(np.flatnonzero(space.valid(poses))[777])
    dense = dijkstra(graph.tocsr(), directed=False, indices=goal)
    cost = Oracle(space, poses[goal], options=ROADMAP).cost_to_go(poses)
    np.testing.assert_array_equal(np.isfinite(cost), np.isfinite(dense))
    known = np.isfinite(dense) & (dense > 0)
    error = cost[known] / dense[known] - 1.0
    assert -0.012 < error.mean() < 0.005
    assert np.quantile(error, 0.01) > -0.03 and np.quantile(error, 0.99) < 0.03


def test_joints_that_turn_freely_have_two_ways_round():
    space = ConfigurationSpace(Linkage.arm([1.0, 1.0], base=(5.0, 5.0)), Environment(BOUNDS))
    oracle = Oracle(space, (3.0, 0.0))
    assert oracle.cost_to_go((-3.0, 0.0)) == pytest.approx(
        2.0 * (2.0 * math.pi - 6.0)
    )  # reaches 2 from the base


@pytest.mark.parametrize("links", [4, 7])
def test_searches_of_arms_are_measured(links):
    arm = Linkage.arm([3.2 / links] * links, 0.1, base=(5.0, 5.0))
    obstacles = (shapely.box(6.0, 5.5, 7.5, 6.5), shapely.box(6.0, 3.0, 7.5, 4.5))
    task = Task([1.2, *[0.1] * (links - 1)], [-1.2, *[-0.1] * (links - 1)])
    problem = Problem(arm, Environment(BOUNDS, obstacles), task)
    options = SearchOptions(oracle=OracleOptions(resolution=(1500,)))
    result = guided_search(problem, "oracle", seed=0, max_samples=150, options=options)
    other = guided_search(problem, "rrt", seed=0, max_samples=150, options=options)
    assert result.solved
    assert 0.0 < result.efficiency_per_sample < other.efficiency_per_sample
    oracle = oracle_for(problem.space, task.goal, start=task.start, options=options.oracle)
    assert result.length >= 0.98 * oracle.cost_to_go(task.start)


def test_a_grid_for_a_robot_with_joints_is_refused():
    with pytest.raises(InvalidInputError, match="the oracle's grid: expected a rigid planar robot"):
        Oracle(two_links(), (0.0, 0.0), options=OracleOptions(method="grid"))
