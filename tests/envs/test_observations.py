"""The observation: every column by its meaning, the enum against the array, memory by the formula."""

from __future__ import annotations

import math

import numpy as np
import pytest
from shapely.geometry import box

from guided_gym import (
    ConfigurationSpace,
    Environment,
    InvalidInputError,
    Linkage,
    NodeColumn,
    Problem,
    Robot,
    Search,
    SearchOptions,
    Task,
    TreeObservation,
    node_table,
    rollout_bytes,
    valid_nodes,
)
from guided_gym.randomness import spawn

MAX_NODES, MAX_SAMPLES = 40, 38
PROBLEM = Problem(
    Robot.rectangle(0.4, 0.2),
    Environment((0.0, 0.0, 8.0, 4.0), (box(3.9, 0.0, 4.1, 2.8),)),
    Task((1.0, 1.0, 0.5), (7.0, 1.0, -3.0)),
)


def grown(problem=PROBLEM, samples=0, **options):
    """A search after some samples of the newest node, its observer, and the observation."""
    _, expansion_rng, guidance_rng = spawn(np.random.default_rng(1))
    search = Search(problem, expansion_rng, guidance_rng, SearchOptions(**options))
    observer = TreeObservation(raster=36)
    space = observer.build(MAX_NODES, MAX_SAMPLES)
    observer.reset(search)
    for k in range(samples):
        node = 0 if k % 3 else len(search.tree) - 1
        q = search.tree.configurations[node]
        observer.update(search, search.expand(node, search.planner.uniform(q)))
    observation = observer.extract(search)
    assert observation in space
    return search, observer, observation


def table(observation):
    nodes = node_table(observation)
    assert nodes.shape == (MAX_NODES, len(NodeColumn))
    return nodes


def test_the_enum_names_every_column_in_order():
    assert [int(column) for column in NodeColumn] == list(range(len(NodeColumn)))
    _, _, observation = grown()
    assert observation["nodes"].size == MAX_NODES * len(NodeColumn)


def test_the_root_by_hand():
    _, _, observation = grown()
    unit = math.hypot(8.0, 4.0, math.pi * PROBLEM.robot.radius)
    turn = 2 * math.pi - 3.5
    clearance = float(PROBLEM.space.clearance(PROBLEM.task.start))
    expected = {
        NodeColumn.X: -0.75,
        NodeColumn.Y: -0.5,
        NodeColumn.COS: math.cos(0.5),
        NodeColumn.SIN: math.sin(0.5),
        NodeColumn.GOAL_X: 6.0 / 8.0,
        NodeColumn.GOAL_Y: 0.0,
        NodeColumn.GOAL_COS: math.cos(-3.5),
        NodeColumn.GOAL_SIN: math.sin(-3.5),
        NodeColumn.GOAL_DISTANCE: math.hypot(6.0, PROBLEM.robot.radius * turn) / unit,
        NodeColumn.COST_TO_COME: 0.0,
        NodeColumn.DEPTH: 0.0,
        NodeColumn.CHILDREN: 0.0,
        NodeColumn.FAILURES: 0.0,
        NodeColumn.CLEARANCE: clearance / 2.0,
    }
    row = table(observation)[0]
    for column in NodeColumn:
        assert row[column] == pytest.approx(expected[column], abs=1e-6), column.name
    assert observation["start"] == pytest.approx([-0.75, -0.5, math.cos(0.5), math.sin(0.5)])
    assert observation["goal"] == pytest.approx([0.75, -0.5, math.cos(-3), math.sin(-3)])


@pytest.mark.parametrize("rewire", [False, True])
def test_growing_one_node_at_a_time_equals_observing_the_tree_afresh(rewire):
    search, _, incremental = grown(samples=37, rewire=rewire, step=1.5)
    assert search.tree.failure_count and len(search.tree) > 5
    assert (search.tree.rewirings > 0) == rewire
    fresh = TreeObservation(raster=36)
    fresh.build(MAX_NODES, MAX_SAMPLES)
    fresh.reset(search)
    for key, value in fresh.extract(search).items():
        assert np.array_equal(value, incremental[key]), key


def test_places_in_the_tree_are_those_of_the_tree():
    search, _, observation = grown(samples=37)
    tree, n = search.tree, len(search.tree)
    nodes, scale = table(observation), math.log1p(MAX_SAMPLES)
    unit = math.hypot(8.0, 4.0, math.pi * PROBLEM.robot.radius)
    assert nodes[:n, NodeColumn.COST_TO_COME] == pytest.approx(tree.cost_to_come / unit, abs=1e-6)
    for column, counts in (
        (NodeColumn.DEPTH, tree.depths),
        (NodeColumn.CHILDREN, tree.children),
        (NodeColumn.FAILURES, tree.failures),
    ):
        assert nodes[:n, column] == pytest.approx(np.log1p(counts) / scale, abs=1e-6)
    assert np.array_equal(observation["parents"][:n], tree.parents)


def test_padding_is_zeros_and_minus_one_and_masked():
    search, _, observation = grown(samples=20)
    n = len(search.tree)
    assert not table(observation)[n:].any()
    assert (observation["parents"][n:] == -1).all()
    assert observation["action_mask"].dtype == np.int8
    assert np.array_equal(observation["action_mask"], valid_nodes(search, MAX_NODES))
    assert observation["action_mask"].sum() == n


def test_the_raster_is_the_workspace_bottom_up():
    _, _, observation = grown()
    raster = observation["raster"]
    assert raster.shape == (1, 36, 36)
    # The wall from x = 3.9 to 4.1 covers the right half of column 17 (3.78 to 4) and the left half of 18, up
    # to y = 2.8: 25.2 rows. Points at a quarter and three quarters of a cell see half of those cells covered.
    expected = np.zeros((36, 36), np.uint8)
    expected[:25, 17:19] = 127
    assert np.array_equal(raster[0], expected)


def test_arrays_are_fresh_each_time():
    search, observer, first = grown(samples=3)
    second = observer.extract(search)
    for key in first:
        assert not np.shares_memory(first[key], second[key])
        first[key][...] = 1
    assert np.array_equal(observer.extract(search)["nodes"], second["nodes"])


def test_a_point_robot_has_heading_zero():
    problem = Problem(Robot.point(), Environment((-1.0, -1.0, 1.0, 1.0)), Task((-0.5, 0.0), (0.5, 0.5)))
    _, _, observation = grown(problem)
    row = table(observation)[0]
    assert row[[NodeColumn.COS, NodeColumn.SIN, NodeColumn.GOAL_COS, NodeColumn.GOAL_SIN]].tolist() == [
        1,
        0,
        1,
        0,
    ]
    assert row[NodeColumn.GOAL_DISTANCE] == pytest.approx(math.hypot(1, 0.5) / math.hypot(2, 2))


def test_robots_that_the_columns_cannot_describe_are_refused():
    search, observer, _ = grown()
    search.space = ConfigurationSpace(Linkage.snake([0.2] * 2), PROBLEM.environment)
    with pytest.raises(InvalidInputError, match=r"at most 1 angles, .*, got one with 2"):
        observer.reset(search)


def test_node_table_takes_batches():
    _, _, observation = grown()
    batch = {"nodes": np.stack([observation["nodes"]] * 3)}
    assert node_table(batch).shape == (3, MAX_NODES, len(NodeColumn))


def test_a_ppo_buffer_at_the_defaults_is_far_below_2_gib():
    assert rollout_bytes() == 8 * 2048 * (256 * 65 + 64 * 64 + 64) == 340_787_200
    assert rollout_bytes() < 2 * 1024**3
