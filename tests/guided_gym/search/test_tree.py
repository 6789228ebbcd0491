"""The search tree: worked by hand, and consistent under any growth and rewiring."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.search.tree import NO_PARENT, SearchTree

SPACE = ConfigurationSpace(Robot.point(), Environment((0.0, 0.0, 10.0, 10.0)))


def grown(capacity: int = 2) -> SearchTree:
    """0 at (1, 1); 1 at (4, 5) and 2 at (1, 2) below it; 3 at (4, 6) below 1."""
    tree = SearchTree(SPACE, np.array([1.0, 1.0]), capacity)
    tree.add(np.array([4.0, 5.0]), 0, 5.0)
    tree.add(np.array([1.0, 2.0]), 0, 1.0)
    tree.add(np.array([4.0, 6.0]), 1, 1.0)
    return tree


def consistent(tree: SearchTree) -> None:
    """Costs are lengths of paths, depths and children are counts."""
    n = len(tree)
    parents = tree.parents
    for v in range(n):
        path = tree.path_to(v)
        assert path[0] == 0
        assert path[-1] == v
        assert (parents[path[1:]] == path[:-1]).all()
        q = tree.configurations[path]
        assert tree.cost_to_come[v] == pytest.approx(float(np.hypot(*np.diff(q, axis=0).T).sum()), abs=1e-9)
        assert tree.depths[v] == len(path) - 1
    assert tree.children.tolist() == np.bincount(parents[1:], minlength=n).tolist()
    assert tree.failures.tolist() == np.bincount(tree.failed_nodes, minlength=n).tolist()


def test_tree__hand_worked() -> None:
    tree = grown()
    assert len(tree) == 4
    assert tree.parents.tolist() == [NO_PARENT, 0, 0, 1]
    assert tree.cost_to_come.tolist() == [0, 5, 1, 6]
    assert tree.depths.tolist() == [0, 1, 1, 2]
    assert tree.children.tolist() == [2, 1, 0, 0]
    assert tree.path_to(3).tolist() == [0, 1, 3]
    assert tree.path_to(0).tolist() == [0]
    assert tree.nearest(np.array([3.0, 7.0])) == 3
    tree.add(np.array([3.0, 7.0]), 3, 2**0.5)
    assert tree.nearest(np.array([3.0, 7.0])) == 4  # the index keeps up
    consistent(tree)


def test_failures__hand_worked() -> None:
    tree = grown()
    for node in (2, 0, 2):
        tree.add_failure(node, np.array([9.0, node]), np.array([8.0, node]))
    assert tree.failure_count == 3
    assert tree.failed_nodes.tolist() == [2, 0, 2]
    assert tree.failed_targets.tolist() == [[9, 2], [9, 0], [9, 2]]
    assert tree.contacts.tolist() == [[8, 2], [8, 0], [8, 2]]
    assert tree.failures.tolist() == [1, 0, 2, 0]
    consistent(tree)


def test_rewire__carries_the_subtree_along() -> None:
    tree = grown()
    tree.rewire(1, 2, float(np.hypot(3, 3)))
    assert tree.parents.tolist() == [NO_PARENT, 2, 0, 1]
    assert tree.depths.tolist() == [0, 2, 1, 3]
    assert tree.children.tolist() == [1, 1, 1, 0]
    assert tree.rewirings == 1
    consistent(tree)


def test_changes__counts_each_of_them() -> None:
    tree = grown()
    assert tree.changes == 4  # the root is the first
    tree.add_failure(2, np.array([9.0, 2.0]), np.array([8.0, 2.0]))
    assert tree.changes == 5
    tree.rewire(1, 2, float(np.hypot(3, 3)))
    assert tree.changes == 6
    tree.reserve(2)
    assert tree.changes == 6
    tree.grown(1, 0)
    assert tree.changes == 7


def test_views__are_read_only() -> None:
    tree = grown()
    tree.add_failure(0, np.zeros(2), np.zeros(2))
    names = ("configurations", "parents", "cost_to_come", "depths", "children", "failures")
    for name in (*names, "failed_nodes", "failed_targets", "contacts"):
        view = getattr(tree, name)
        with pytest.raises(ValueError, match="read-only"):
            view[0] = 0


def test_dtypes__are_as_documented() -> None:
    tree = grown()
    for name in ("parents", "depths", "children", "failures", "failed_nodes"):
        assert getattr(tree, name).dtype == np.int32
    for name in ("configurations", "cost_to_come", "failed_targets", "contacts"):
        assert getattr(tree, name).dtype == np.float64


def test_tree__copies_what_it_is_given() -> None:
    q = np.array([1.0, 1.0])
    tree = SearchTree(SPACE, q)
    q[:] = 7
    assert tree.configurations.tolist() == [[1, 1]]


def test_tree__refuses_no_capacity() -> None:
    with pytest.raises(InvalidInputError, match="capacity"):
        SearchTree(SPACE, np.zeros(2), 0)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 5), st.lists(st.sampled_from("aaafr"), max_size=80))
def test_tree__stays_consistent_beyond_its_capacity(seed: int, capacity: int, steps: list[str]) -> None:
    rng = np.random.default_rng(seed)
    tree = SearchTree(SPACE, rng.uniform(0, 10, 2), capacity)
    for step in steps:
        v = int(rng.integers(len(tree)))
        if step == "a":
            q = rng.uniform(0, 10, 2)
            tree.add(q, v, float(np.hypot(*(q - tree.configurations[v]))))
        elif step == "f":
            tree.add_failure(v, rng.uniform(0, 10, 2), rng.uniform(0, 10, 2))
        elif v > 0:
            allowed = [u for u in range(len(tree)) if v not in tree.path_to(u)]
            u = int(rng.choice(allowed))
            tree.rewire(v, u, float(np.hypot(*(tree.configurations[v] - tree.configurations[u]))))
    consistent(tree)
    q = rng.uniform(0, 10, 2)
    assert tree.nearest(q) == int(np.argmin(np.hypot(*(tree.configurations - q).T)))
