"""Roadmaps as graphs, and shortest paths to one of their vertices, kept up to date as edges get longer."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError
from guided_gym.kernels.metric import Metric
from guided_gym.kernels.nearest import Floats, Ints
from guided_gym.kernels.shortest_paths import (
    BAD_ID,
    BAD_WEIGHT,
    Adjacency,
    Int32s,
    Scratch,
    Tree,
    lengthen,
    raise_weights,
    solve,
)
from guided_gym.structures.nearest import GrowingIndex, kernel_array

_Scalar = TypeVar("_Scalar", bound=np.generic)


class RoadmapGraph(NamedTuple):
    """An undirected graph in CSR form (see the module); unpacks as a tuple.

    Attributes:
        indptr: (n + 1,) int32.
        neighbours: (2 m,) int32, ascending within each vertex.
        edge_of: (2 m,) int32, the edge behind each neighbour.
        edges: (m, 2) int32, ends u < v, in lexicographic order.
        lengths: (m,) float64.
    """

    indptr: Int32s
    neighbours: Int32s
    edge_of: Int32s
    edges: Int32s
    lengths: Floats


def graph_from_edges(n: int, edges: ArrayLike, lengths: ArrayLike) -> RoadmapGraph:
    """Build the CSR form of `n` vertices and undirected edges (m, 2) with lengths (m,).

    Edge ids are positions in `edges`; parallel edges are allowed, loops are not.

    Raises:
        InvalidInputError: wrong shapes, ends outside 0..n-1, a loop, a negative or NaN length.
    """
    ends = np.ascontiguousarray(np.asarray(edges).reshape(-1, 2), dtype=np.int32)
    weights = np.ascontiguousarray(lengths, dtype=np.float64)
    m = len(ends)
    if weights.shape != (m,):
        raise InvalidInputError(f"expected lengths of shape ({m},), one per edge, got {weights.shape}")
    if m and (ends.min() < 0 or ends.max() >= n or np.any(ends[:, 0] == ends[:, 1])):
        raise InvalidInputError(
            f"expected edges between two different vertices of 0..{n - 1}, got {shown(ends)}"
        )
    if not np.all(weights >= 0):
        raise InvalidInputError("expected lengths >= 0, got a negative one or NaN")
    tails = np.concatenate([ends[:, 0], ends[:, 1]])
    heads = np.concatenate([ends[:, 1], ends[:, 0]])
    order = np.argsort(tails * np.int64(n) + heads, kind="stable")
    indptr = np.zeros(n + 1, np.int32)
    np.cumsum(np.bincount(tails, minlength=n), out=indptr[1:])
    edge_of = np.tile(np.arange(m, dtype=np.int32), 2)[order]
    return RoadmapGraph(indptr, heads[order], edge_of, ends, weights)


def nearest_graph(points: ArrayLike, metric: Metric, k: int) -> RoadmapGraph:
    """Join every configuration to its k nearest others (ties to the lower index), both ways.

    Args:
        points: (n, d) configurations.
        metric: Weights and periods of the distance.
        k: neighbours per vertex; a vertex gets more where others choose it.

    Raises:
        InvalidInputError: wrong shapes, values that are not finite, or k < 1.
    """
    if k < 1:
        raise InvalidInputError(f"expected k >= 1, got {k}")
    index = GrowingIndex(metric, capacity=max(1, len(np.asarray(points))))
    index.add_many(points)
    n = len(index)
    if n < 2:
        return graph_from_edges(n, np.empty((0, 2)), np.empty(0))
    ids, lengths = index.k_nearest_many(index.points, min(k + 1, n))
    others = ids != np.arange(n)[:, None]
    others[:, -1] &= ~others.all(axis=1)  # hidden among its duplicates, a vertex may not find itself
    tails = np.broadcast_to(np.arange(n)[:, None], ids.shape)[others]
    heads = ids[others]
    low, high = np.minimum(tails, heads), np.maximum(tails, heads)
    pairs, first = np.unique(low * n + high, return_index=True)
    edges = np.stack([pairs // n, pairs % n], axis=1)
    return graph_from_edges(n, edges, lengths[others][first])


def with_vertex(graph: RoadmapGraph, near: ArrayLike, lengths: ArrayLike) -> RoadmapGraph:
    """The graph with one more vertex, the last, joined to some others; its edges come last, too.

    Args:
        graph: The graph, which stays as it is.
        near: (k,) distinct vertices that it is joined to.
        lengths: (k,) lengths of its edges.
    """
    ends, far = np.asarray(near, np.int32), np.asarray(lengths, np.float64)
    order = np.argsort(ends, kind="stable")
    ends, far = ends[order], far[order]
    n, m = len(graph.indptr) - 1, len(graph.lengths)
    ids = np.arange(m, m + len(ends), dtype=np.int32)
    places = graph.indptr[ends + 1]  # behind the neighbours of each: the new vertex has the highest number
    neighbours = np.insert(graph.neighbours, places, n)
    edge_of = np.insert(graph.edge_of, places, ids)
    longer = np.zeros(n, np.int32)
    longer[ends] = 1
    indptr = np.concatenate([graph.indptr, [0]]).astype(np.int32)
    indptr[1 : n + 1] += np.cumsum(longer, dtype=np.int32)
    indptr[n + 1] = len(neighbours) + len(ends)
    new = np.stack([ends, np.full(len(ends), n, np.int32)], axis=1)
    return RoadmapGraph(
        indptr,
        np.concatenate([neighbours, ends]).astype(np.int32),
        np.concatenate([edge_of, ids]).astype(np.int32),
        np.concatenate([graph.edges, new]).astype(np.int32),
        np.concatenate([graph.lengths, far]),
    )


class ShortestPathTree:
    """Distances to one source in an undirected graph whose weights only grow, repaired after each change.

    Deterministic: among equally short ways the parent with the lower index wins, in a repair as in a run from
    scratch (as long as no weight is 0). Not safe for use by two threads at once.
    """

    def __init__(
        self, indptr: ArrayLike, neighbours: ArrayLike, edge_of: ArrayLike, weights: ArrayLike, source: int
    ) -> None:
        """Take a graph in CSR form with weights (m,) by edge id (copied) and solve it.

        Raises:
            InvalidInputError: arrays that do not form an undirected graph, a negative or NaN weight, or a
                source that is no vertex.
        """
        graph = tuple(kernel_array(a, np.int32) for a in (indptr, neighbours, edge_of))
        self._graph: Adjacency = (graph[0], graph[1], graph[2])
        values = np.array(weights, dtype=np.float64, order="C")
        self._begin(values, _edge_ends(self._graph, values), source)

    def _begin(self, values: Floats, ends: Int32s, source: int) -> None:
        self._ends = ends
        n = len(self._graph[0]) - 1
        self._tree: Tree = (values, np.empty(n), np.empty(n, np.int32), np.empty(n, np.int32))
        self._scratch: Scratch = (
            np.empty(n, np.int32),
            np.empty(n, np.int32),
            np.empty(n, np.int32),
            np.empty(n),
        )
        self.reset(source)

    @classmethod
    def of(cls, graph: RoadmapGraph, source: int) -> ShortestPathTree:
        """Solve a `RoadmapGraph`, which is sound, for one source; the graph's lengths are copied."""
        tree = cls.__new__(cls)
        tree._graph = (graph.indptr, graph.neighbours, graph.edge_of)
        tree._begin(graph.lengths.copy(), graph.edges, source)
        return tree

    @property
    def source(self) -> int:
        """The vertex that distances lead to."""
        return self._source

    @property
    def weights(self) -> Floats:
        """Read-only view (m,) float64 of the weights, inf where an edge was removed."""
        return _read_only(self._tree[0])

    @property
    def distance(self) -> Floats:
        """Read-only view (n,) float64 of the distances to the source, inf where there is no way."""
        return _read_only(self._tree[1])

    @property
    def parent(self) -> Int32s:
        """Read-only view (n,) int32 of the next vertices on the way to the source, -1 where there is none."""
        return _read_only(self._tree[2])

    @property
    def parent_edge(self) -> Int32s:
        """Read-only view (n,) int32 of the edges to the parents, -1 where there is none."""
        return _read_only(self._tree[3])

    @property
    def state(self) -> tuple[Adjacency, Int32s, Tree, Scratch]:
        """The first four arguments of `lengthen`, for fused kernels."""
        return self._graph, self._ends, self._tree, self._scratch

    @property
    def changed(self) -> Int32s:
        """The vertices, ascending, whose distance changed in the last repair; all after a reset."""
        return np.sort(self._scratch[2][: self._changed])

    def reset(self, source: int) -> None:
        """Solve anew for a source, with the weights as they are now.

        Raises:
            InvalidInputError: the source is no vertex.
        """
        n = len(self._tree[1])
        if not 0 <= source < n:
            raise InvalidInputError(f"expected a source in 0..{n - 1}, got {source}")
        self._source = int(source)
        solve(self._graph, self._tree, self._scratch, self._source)
        self._scratch[2][:] = np.arange(n)
        self._changed = n

    def raise_weights(self, edge_ids: ArrayLike, new_weights: ArrayLike) -> int:
        """Raise edges (k,) to new weights (k,) and return the number of distances that changed.

        Raises:
            InvalidInputError: an unknown edge, a weight lower than it is, or NaN (then nothing is changed).
        """
        ids = _ids(edge_ids)
        values = kernel_array(new_weights, np.float64)
        if values.shape != ids.shape:
            raise InvalidInputError(f"expected new weights of shape {ids.shape}, got {values.shape}")
        status = raise_weights(self._graph, self._ends, self._tree, self._scratch, ids, values)
        if status == BAD_ID:
            raise InvalidInputError(f"expected edge ids in 0..{len(self._tree[0]) - 1}, got {ids.tolist()}")
        if status == BAD_WEIGHT:
            now = self._tree[0][ids].tolist()
            raise InvalidInputError(f"expected weights not below {now}, got {values.tolist()}")
        self._changed = status
        return status

    def lengthen(self, edge_ids: Ints, lengths: Floats, multipliers: Floats) -> Int32s:
        """Raise edges (k,), known to be some, to their length times their multiplier.

        Args:
            edge_ids: (k,) which.
            lengths: (m,) length of each edge.
            multipliers: (m,) factor on each length, never below that of an earlier call; infinite deletes.

        Returns:
            The vertices whose distance changed, in no order.
        """
        self._changed = lengthen(*self.state, edge_ids, lengths, multipliers)
        return self._scratch[2][: self._changed].copy()

    def remove_edges(self, edge_ids: ArrayLike) -> int:
        """Delete edges (k,), removed ones allowed, and return the number of distances that changed.

        Raises:
            InvalidInputError: an unknown edge (then nothing is changed).
        """
        ids = _ids(edge_ids)
        return self.raise_weights(ids, np.full(len(ids), np.inf))

    def remove_vertices(self, ids: ArrayLike) -> int:
        """Delete all edges at the vertices (k,) and return the number of distances that changed.

        Raises:
            InvalidInputError: an unknown vertex (then nothing is changed).
        """
        vertices = _ids(ids)
        indptr, _, edge_of = self._graph
        n = len(indptr) - 1
        if vertices.size and not (vertices.min() >= 0 and vertices.max() < n):
            raise InvalidInputError(f"expected vertices in 0..{n - 1}, got {vertices.tolist()}")
        edges = [edge_of[indptr[v] : indptr[v + 1]] for v in vertices]
        return self.remove_edges(np.concatenate(edges) if edges else vertices)

    def path(self, v: int) -> Int32s:
        """Return the vertices from `v` to the source, both included; empty if there is no way.

        Raises:
            InvalidInputError: `v` is no vertex.
        """
        _, distance, parent, _ = self._tree
        if not 0 <= v < len(distance):
            raise InvalidInputError(f"expected a vertex in 0..{len(distance) - 1}, got {v}")
        if not np.isfinite(distance[v]):
            return np.empty(0, np.int32)
        way = [int(v)]
        while way[-1] != self._source:
            way.append(int(parent[way[-1]]))
        return np.array(way, np.int32)


def _read_only(values: NDArray[_Scalar]) -> NDArray[_Scalar]:
    view = values.view()
    view.flags.writeable = False
    return view


def _ids(values: ArrayLike) -> Ints:
    ids = np.asarray(values)
    if ids.dtype == np.int64 and ids.ndim == 1 and ids.size:
        return kernel_array(ids, np.int64)
    if ids.size == 0:
        return np.empty(0, np.int64)
    if ids.ndim != 1 or not np.issubdtype(ids.dtype, np.integer):
        raise InvalidInputError(f"expected integer ids of shape (k,), got {ids.dtype} of shape {ids.shape}")
    return kernel_array(ids, np.int64)


def _edge_ends(graph: Adjacency, weights: Floats) -> Int32s:
    """Check a CSR graph and return the ends (m, 2) int32 of its edges."""
    indptr, neighbours, edge_of = graph
    m, n = len(weights), len(indptr) - 1
    if weights.ndim != 1 or not np.all(weights >= 0):
        raise InvalidInputError(
            "expected weights of shape (m,), all >= 0, got another shape, negatives or NaN"
        )
    if n < 1 or indptr[0] != 0 or indptr[-1] != len(neighbours) or np.any(np.diff(indptr) < 0):
        raise InvalidInputError(
            f"expected indptr (n + 1,) to rise from 0 to {len(neighbours)}, got {shown(indptr)}"
        )
    if len(neighbours) != 2 * m or len(edge_of) != 2 * m:
        raise InvalidInputError(
            f"expected {2 * m} neighbours and edge ids for {m} weights, "
            f"got {len(neighbours)} and {len(edge_of)}"
        )
    tails = np.repeat(np.arange(n, dtype=np.int32), np.diff(indptr))
    order = np.lexsort((tails, edge_of))
    pairs, twins = order[0::2], order[1::2]
    sound = np.array_equal(edge_of[pairs], np.arange(m)) and np.array_equal(edge_of[twins], np.arange(m))
    if not sound or np.any(tails[pairs] != neighbours[twins]) or np.any(tails[twins] != neighbours[pairs]):
        raise InvalidInputError(
            f"expected each edge id twice in edge_of, once from either end, got {shown(edge_of)}"
        )
    return np.stack([tails[pairs], tails[twins]], axis=1)
