"""Repaired shortest paths against runs from scratch, and roadmap graphs against brute force."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from guided_gym.errors import InvalidInputError
from guided_gym.structures.shortest_paths import ShortestPathTree, graph_from_edges, nearest_graph

SE2 = (np.array([1.0, 1.0, 0.54]), np.array([0.0, 0.0, 2 * np.pi]))


def reference_distances(tree, edges, n):
    kept = np.isfinite(tree.weights)
    matrix = csr_array((tree.weights[kept], (edges[kept, 0], edges[kept, 1])), shape=(n, n))
    return dijkstra(matrix, directed=False, indices=tree.source)


def assert_sound(tree, graph):
    n = len(graph.indptr) - 1
    np.testing.assert_allclose(tree.distance, reference_distances(tree, graph.edges, n), rtol=1e-12)
    for v in range(n):
        if v == tree.source or np.isinf(tree.distance[v]):
            assert tree.parent[v] == tree.parent_edge[v] == -1
            continue
        rows = slice(graph.indptr[v], graph.indptr[v + 1])
        via = tree.distance[graph.neighbours[rows]] + tree.weights[graph.edge_of[rows]]
        assert tree.distance[v] == via.min()
        assert tree.parent[v] == graph.neighbours[rows][via == via.min()].min()
        assert {v, int(tree.parent[v])} == set(graph.edges[tree.parent_edge[v]].tolist())


@st.composite
def graphs(draw):
    """Sparse random graphs, connected or not; integer weights make ties."""
    n = draw(st.integers(1, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    pairs = np.array(list(itertools.combinations(range(n), 2)), dtype=int).reshape(-1, 2)
    edges = pairs[rng.random(len(pairs)) < draw(st.sampled_from([0.05, 0.15, 0.5]))]
    weights = rng.uniform(0.1, 2, len(edges))
    if draw(st.booleans()):
        weights = np.ceil(weights * 2)
    return graph_from_edges(n, edges, weights), rng


@settings(max_examples=60, deadline=None)
@given(graphs(), st.lists(st.sampled_from(["raise", "lengthen", "edges", "vertices", "reset"]), max_size=8))
def test_tree__repairs_to_what_a_fresh_run_gives(drawn, changes):
    graph, rng = drawn
    n, m = len(graph.indptr) - 1, len(graph.edges)
    tree = ShortestPathTree.of(graph, int(rng.integers(n)))
    assert_sound(tree, graph)
    for change in changes:
        before = tree.distance.copy()
        ids = rng.integers(0, m, rng.integers(0, 5)) if m else np.empty(0, int)
        if change == "raise":
            tree.raise_weights(ids, tree.weights[ids] + rng.integers(0, 3, len(ids)))
        elif change == "lengthen":
            lengths, multipliers = tree.weights.copy(), np.ones(m)
            multipliers[ids] = rng.choice([1.0, 2.5, np.inf], len(ids))
            given = tree.lengthen(ids.astype(np.int64), lengths, multipliers)
            np.testing.assert_array_equal(np.sort(given), tree.changed)
        elif change == "edges":
            tree.remove_edges(ids)
        elif change == "vertices":
            tree.remove_vertices(rng.integers(0, n, 2))
        else:
            tree.reset(int(rng.integers(n)))
        assert_sound(tree, graph)
        if change != "reset":
            np.testing.assert_array_equal(tree.changed, np.flatnonzero(tree.distance != before))
        fresh = ShortestPathTree(graph.indptr, graph.neighbours, graph.edge_of, tree.weights, tree.source)
        np.testing.assert_array_equal(fresh.distance, tree.distance)
        np.testing.assert_array_equal(fresh.parent, tree.parent)


def test_tree__by_hand():
    #     1        0 - 1 - 3 is 2 long, 0 - 2 - 3 is 3 long; 4 hangs on 3
    #   0   3 4
    #     2
    graph = graph_from_edges(5, [[0, 1], [1, 3], [0, 2], [2, 3], [3, 4]], [1, 1, 1, 2, 1])
    tree = ShortestPathTree.of(graph, 0)
    np.testing.assert_array_equal(tree.distance, [0, 1, 1, 2, 3])
    np.testing.assert_array_equal(tree.path(4), [4, 3, 1, 0])
    assert tree.remove_edges([1]) == 2
    np.testing.assert_array_equal(tree.changed, [3, 4])
    np.testing.assert_array_equal(tree.distance, [0, 1, 1, 3, 4])
    np.testing.assert_array_equal(tree.path(4), [4, 3, 2, 0])
    assert tree.raise_weights([0, 1], [5, np.inf]) == 1
    np.testing.assert_array_equal(tree.distance, [0, 5, 1, 3, 4])
    assert tree.remove_vertices([2]) == 3
    np.testing.assert_array_equal(tree.distance, [0, 5, np.inf, np.inf, np.inf])
    assert tree.path(4).size == 0
    np.testing.assert_array_equal(tree.path(0), [0])
    assert graph.lengths[0] == 1  # the tree has its own weights


def test_tree__removing_the_source_leaves_only_itself():
    graph = graph_from_edges(3, [[0, 1], [1, 2]], [1, 1])
    tree = ShortestPathTree.of(graph, 1)
    tree.remove_vertices([1, 1])
    np.testing.assert_array_equal(tree.distance, [np.inf, 0, np.inf])


def test_tree__parallel_and_zero_edges():
    graph = graph_from_edges(4, [[0, 1], [0, 1], [1, 2], [2, 3], [1, 3]], [1, 2, 0, 0, 0])
    tree = ShortestPathTree.of(graph, 0)
    np.testing.assert_array_equal(tree.distance, [0, 1, 1, 1])
    tree.remove_edges([0])
    np.testing.assert_array_equal(tree.distance, [0, 2, 2, 2])
    assert tree.parent_edge[1] == 1
    tree.remove_edges([1])
    assert np.isinf(tree.distance[1:]).all()


def test_tree__refuses_bad_changes_and_stays_as_it_was():
    graph = graph_from_edges(3, [[0, 1], [1, 2]], [1, 1])
    tree = ShortestPathTree.of(graph, 0)
    changes = [
        lambda: tree.raise_weights([0, 1], [2, 0.5]),
        lambda: tree.raise_weights([0], [np.nan]),
        lambda: tree.raise_weights([0], [1, 2]),
        lambda: tree.remove_edges([0, 2]),
        lambda: tree.remove_edges([-1]),
        lambda: tree.remove_edges([0.5]),
        lambda: tree.remove_vertices([3]),
        lambda: tree.reset(3),
        lambda: tree.path(-1),
    ]
    for change in changes:
        with pytest.raises(InvalidInputError, match="expected"):
            change()
        np.testing.assert_array_equal(tree.distance, [0, 1, 2])
        np.testing.assert_array_equal(tree.weights, [1, 1])
    with pytest.raises(ValueError, match="read-only"):
        tree.distance[0] = 1


def test_tree__refuses_arrays_that_are_no_undirected_graph():
    graph = graph_from_edges(3, [[0, 1], [1, 2]], [1.0, 1.0])
    bad = [
        {"indptr": [0, 1, 3, 5]},
        {"indptr": [0, 2, 1, 4]},
        {"neighbours": [1, 0, 2, 0]},
        {"edge_of": [0, 1, 1, 1]},
        {"weights": [1.0, -1.0]},
        {"weights": [1.0]},
        {"source": 3},
    ]
    sound = {
        "indptr": graph.indptr,
        "neighbours": graph.neighbours,
        "edge_of": graph.edge_of,
        "weights": graph.lengths,
        "source": 0,
    }
    ShortestPathTree(**sound)
    for change in bad:
        with pytest.raises(InvalidInputError, match="expected"):
            ShortestPathTree(**{**sound, **change})
    for edges in ([[0, 3]], [[1, 1]], [[-1, 0]]):
        with pytest.raises(InvalidInputError):
            graph_from_edges(3, edges, [1.0])


def torus_distances(points, q, weights, periods):
    delta = np.abs(points - q)
    delta = np.where(periods > 0, np.minimum(delta, periods - delta), delta) * weights
    return np.sqrt((delta * delta).sum(axis=-1))


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(1, 8), st.booleans())
def test_nearest_graph__joins_the_nearest_both_ways(seed, n, k, duplicates):
    rng = np.random.default_rng(seed)
    points = rng.uniform([0, 0, -np.pi], [2, 2, np.pi], (n, 3))
    if duplicates:
        points[: n // 2] = points[0]
    graph = nearest_graph(points, SE2, k)
    expected = set()
    for v in range(n):
        distances = torus_distances(points, points[v], *SE2)
        order = [u for u in np.lexsort((np.arange(n), np.round(distances, 12))) if u != v][:k]
        expected |= {(min(u, v), max(u, v)) for u in order}
    edges = [tuple(e) for e in graph.edges.tolist()]
    assert len(edges) == len(set(edges))
    if not duplicates:
        assert set(edges) == expected
    degrees = np.diff(graph.indptr)
    assert (degrees >= min(k, n - 1)).all()
    for e, (u, v) in enumerate(edges):
        assert u < v
        assert graph.lengths[e] == pytest.approx(torus_distances(points[u], points[v], *SE2), abs=1e-12)
    ShortestPathTree.of(graph, 0)  # checks that each edge appears once from either end
