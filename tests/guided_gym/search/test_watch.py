"""What a watched planner's questions say about its tree, on motions written down by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from shapely.geometry import box

from guided_gym import Environment, Problem, Robot, Search, Task, streams
from guided_gym.measure.target import Measure
from guided_gym.search.watch import State, Watch

START, GOAL = (1.0, 1.0), (9.0, 1.0)


def watched(limit: int = 100, *, first: bool = True, by_edge: bool = True) -> tuple[Search, Watch]:
    """A point and a wall from below, up to y = 9, between start and goal."""
    environment = Environment((0, 0, 10, 10), (box(4.9, 0, 5.1, 9),))
    task = Task(START, GOAL, 0.0 if by_edge else 0.1, by_edge)
    _, expansion, guidance = streams(0)
    search = Search(Problem(Robot.point(), environment, task), expansion, guidance)

    def configuration(state: State) -> np.ndarray:
        return np.array(state, np.float64)

    check = search.space.motion_free
    return search, Watch(search, limit, (START, GOAL), configuration, check, math.dist, first=first)


def tries(search: Search) -> tuple[int, int, int, int, int]:
    """Samples; motions elsewhere, joining and within T; nodes that joined with others."""
    t = search.tries
    return search.samples, t["elsewhere"], t["joining"], t["within"], t["joined"]


def test_motion__from_a_node_is_a_sample() -> None:
    search, watch = watched()
    assert watch.motion(START, (2, 2))
    assert watch.motion((2, 2), (2, 4))
    assert not watch.motion((2, 2), (8, 2))  # through the wall
    assert tries(search) == (3, 0, 0, 0, 0)
    assert search.tree.parents.tolist() == [-1, 0, 1]
    assert search.tree.failed_nodes.tolist() == [1]
    assert search.tree.contacts[0, 0] == pytest.approx(4.9, abs=0.01)
    assert search.tree.cost_to_come.tolist() == pytest.approx([0, math.sqrt(2), 2 + math.sqrt(2)])


def test_motion__a_state_that_failed_once_is_new_when_it_is_tried_from_another_node() -> None:
    search, watch = watched()
    assert not watch.motion(START, (6, 9.5))
    watch.motion(START, (3, 9.6))
    assert watch.motion((3, 9.6), (6, 9.5))
    assert search.tree.parents.tolist() == [-1, 0, 1]


def test_goal_tree__counts_apart_and_joins() -> None:
    """As RRTConnect does: the goal tree looks at x_new first, and passes (x_new, node)."""
    search, watch = watched()
    watch.motion(START, (3, 9.5))
    watch.look((8, 5))
    assert watch.motion((8, 5), GOAL)
    watch.look((6, 9.5))
    assert watch.motion((6, 9.5), (8, 5))
    assert not search.solved
    assert tries(search) == (1, 2, 0, 0, 0)
    watch.look((3, 9.5))
    assert watch.motion((3, 9.5), (6, 9.5))  # the goal tree reaches for the start tree's node
    assert tries(search)[:4] == (1, 2, 1, 0)
    assert search.solved
    assert watch.over
    assert np.array_equal(search.path(), [START, (3, 9.5), (6, 9.5), GOAL])  # it sees the goal
    assert (8, 5) in map(tuple, search.tree.configurations.tolist())
    assert search.tries["joined"] == 2


def test_start_tree__that_reaches_for_the_goal_tree_is_a_sample() -> None:
    search, watch = watched()
    watch.look((6, 9.5))
    assert not watch.motion((6, 9.5), (2, 2))  # neither is a node
    watch.look((5.5, 9.5))
    watch.motion((5.5, 9.5), (6, 9.2))
    watch.motion(START, (4, 9.5))
    assert watch.motion((4, 9.5), (5.5, 9.5))
    assert tries(search) == (2, 2, 0, 0, 1)
    assert search.solved
    assert (5.5, 9.5) in map(tuple, search.tree.configurations.tolist())


def test_elsewhere__hangs_together_and_joins_as_a_whole() -> None:
    search, watch = watched(by_edge=False)
    for a, b in (((1, 5), (1, 6)), ((1, 6), (2, 6)), ((1, 6), (1, 7)), ((3, 9), (4, 9))):
        assert watch.motion(a, b)
    assert len(search.tree) == 1
    assert watch.motion(START, (1, 5))
    assert tries(search) == (1, 4, 0, 0, 3)
    parents = {
        tuple(q): p for q, p in zip(search.tree.configurations.tolist(), search.tree.parents, strict=True)
    }
    nodes = [tuple(q) for q in search.tree.configurations.tolist()]
    assert nodes[parents[(2.0, 6.0)]] == nodes[parents[(1.0, 7.0)]] == (1.0, 6.0)
    assert (3.0, 9.0) not in nodes


def test_within__rewires_where_that_is_shorter_only() -> None:
    search, watch = watched()
    watch.motion(START, (1, 3))
    watch.motion((1, 3), (2, 1))
    watch.motion((2, 1), (2, 0.5))
    before = search.tree.cost_to_come.copy()
    assert watch.motion(START, (2, 1))
    assert search.tree.parents.tolist() == [-1, 0, 0, 2]
    saved = 2 + math.sqrt(5) - 1
    assert search.tree.cost_to_come.tolist() == pytest.approx((before - [0, 0, saved, saved]).tolist())
    assert watch.motion((1, 3), (2, 1))  # longer: stays as it is
    assert search.tree.parents.tolist() == [-1, 0, 0, 2]
    assert tries(search) == (3, 0, 0, 2, 0)


def test_within__asks_the_planner_s_own_metric() -> None:
    search, watch = watched()
    watch._length = lambda a, b: sum(abs(x - y) for x, y in zip(a, b, strict=True))
    watch.motion(START, (1, 2))
    watch.motion((1, 2), (2, 2))
    assert watch.motion(START, (2, 2))  # as long in that metric, shorter in ours
    assert search.tree.rewirings == 0


def test_end__by_an_edge_to_the_goal() -> None:
    search, watch = watched()
    watch.motion(START, (4, 9.5))
    watch.motion((4, 9.5), (6, 9.5))
    assert watch.over
    assert search.solved
    assert search.path() is not None
    assert not watch.motion((6, 9.5), (7, 9))  # whatever is asked now
    assert len(search.tree) == 3


def test_end__by_the_limit_of_tries() -> None:
    search, watch = watched(limit=3)
    watch.motion(START, (1, 2))
    watch.motion((1, 2), START)  # within: does not count
    watch.motion((8, 8), (8, 9))
    assert not watch.over
    watch.motion(START, (1, 4))
    assert watch.over
    assert not search.solved


def test_first_false__goes_on_and_keeps_the_shortest() -> None:
    search, watch = watched(first=False)
    watch.motion(START, (4, 9.8))
    watch.motion((4, 9.8), (6, 9.8))
    assert search.solved
    assert not watch.over
    watch.motion(START, (4.5, 9.2))
    watch.motion((4.5, 9.2), (5.5, 9.2))
    (one, early, long), (two, late, short) = watch.history
    assert early < late
    assert (one, two) == (2, 4)
    assert short < long
    assert search.cost == pytest.approx(short)


def test_measure__trusts_no_edge_that_is_not_certified() -> None:
    """Beyond a wall that a planner did not see, the way to the goal is the oracle's, not the edge's."""
    search, watch = watched(by_edge=False)
    search.tree.certified = False
    watch._check = lambda a, b: bool(search.space.valid(b))
    watch.motion(START, (5.5, 9))
    watch.motion((5.5, 9), (4.5, 1))  # through the wall, away from the goal
    measure = Measure(search)
    tau = measure.work_remaining
    assert tau[2] == pytest.approx(float(measure.oracle.cost_to_go(np.array([4.5, 1.0]))))


def test_search__path_names_a_goal_that_is_a_node_once() -> None:
    search, watch = watched()
    search.tree.certified = False
    watch._check = lambda a, b: not np.array_equal(b, search.goal) or a[0] > 8
    watch.motion(START, (4.5, 9.5))
    watch.motion((8.9, 1), GOAL)
    watch.motion((4.5, 9.5), (8.9, 1))
    path = search.path()
    assert path is not None
    assert (np.linalg.norm(np.diff(path, axis=0), axis=1) > 0).all()
    assert tuple(path[-1]) == GOAL
