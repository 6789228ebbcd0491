"""Shortest paths to one vertex of a roadmap whose edges only get longer, repaired instead of recomputed.

A lazy roadmap loses edges at every collision, few of them, and each time needs the distances to the goal
anew. Only the vertices whose tree path used a raised edge can change (the idea of Ramalingam and Reps, 1996):
they are collected by walking the tree, and Dijkstra's algorithm runs on them alone, started from their
unaffected neighbours. The sums are formed in the same order as in a run from scratch, so distances agree bit
for bit.

Graphs are undirected, in CSR form: the neighbours of v are `neighbours[indptr[v]:indptr[v + 1]]`, reached
over the edges `edge_of[indptr[v]:indptr[v + 1]]`; both directions of an edge share its id.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from guided_gym.errors import InvalidInputError
from guided_gym.kernels.nearest import Floats, GrowingIndex, Ints, kernel_array

Int32s: TypeAlias = NDArray[np.int32]
Adjacency: TypeAlias = tuple[Int32s, Int32s, Int32s]
"""CSR: indptr (n + 1,), neighbours (m2,), edge_of (m2,), all int32."""
Tree: TypeAlias = tuple[Floats, Floats, Int32s, Int32s]
"""weights (m,) float64, distance (n,) float64, parent (n,) int32, parent_edge (n,) int32."""
Scratch: TypeAlias = tuple[Int32s, Int32s, Int32s, Floats]
"""place (n,) int32: position in the heap or a mark; heap (n,) int32: vertices; affected (n,) int32: vertices;
before (n,) float64: distances of the affected vertices before the repair, in the same order."""

_Scalar = TypeVar("_Scalar", bound=np.generic)

NO_PARENT = -1
BAD_ID = -1
"""Returned by a kernel for an id out of range; nothing was changed."""
BAD_WEIGHT = -2
"""Returned by a kernel for a weight below the present one; nothing was changed."""

_SETTLED = -1  # marks in `place`: not affected, or done
_WAITING = -2  # affected, without a finite distance so far


@njit(cache=True)
def _before(distance: Floats, u: int, v: int) -> bool:
    """Order of the heap: by distance, ties by index."""
    return distance[u] < distance[v] or (distance[u] == distance[v] and u < v)


@njit(cache=True)
def _sift_up(heap: Int32s, place: Int32s, distance: Floats, slot: int) -> None:
    v = heap[slot]
    while slot > 0:
        up = (slot - 1) >> 1
        if not _before(distance, v, heap[up]):
            break
        heap[slot] = heap[up]
        place[heap[slot]] = slot
        slot = up
    heap[slot] = v
    place[v] = slot


@njit(cache=True)
def _pop(heap: Int32s, place: Int32s, distance: Floats, size: int) -> int:
    """Remove the first vertex of a heap of `size` and return it."""
    first: int = heap[0]
    place[first] = _SETTLED
    v = heap[size - 1]
    slot, child = 0, 1
    while child < size - 1:
        if child + 1 < size - 1 and _before(distance, heap[child + 1], heap[child]):
            child += 1
        if not _before(distance, heap[child], v):
            break
        heap[slot] = heap[child]
        place[heap[slot]] = slot
        slot = child
        child = 2 * slot + 1
    if size > 1:
        heap[slot] = v
        place[v] = slot
    return first


@njit(cache=True)
def _settle(graph: Adjacency, tree: Tree, scratch: Scratch, size: int) -> None:
    """Run Dijkstra's algorithm from a heap of `size` vertices over those not marked as settled."""
    indptr, neighbours, edge_of = graph
    weights, distance, parent, parent_edge = tree
    place, heap, _, _ = scratch
    while size > 0:
        u = _pop(heap, place, distance, size)
        size -= 1
        for a in range(indptr[u], indptr[u + 1]):
            v = neighbours[a]
            via = distance[u] + weights[edge_of[a]]
            if via > distance[v] or via == np.inf:
                continue
            if via == distance[v]:
                # A tie: the lower index becomes the parent, also of a vertex that the repair leaves alone.
                if u < parent[v] and distance[u] < via:
                    parent[v], parent_edge[v] = u, edge_of[a]
                continue
            parent[v], parent_edge[v], distance[v] = u, edge_of[a], via
            if place[v] == _WAITING:
                heap[size] = v
                place[v] = size
                size += 1
            _sift_up(heap, place, distance, place[v])


def solve(graph: Adjacency, tree: Tree, scratch: Scratch, source: int) -> None:
    """Compute `distance`, `parent` and `parent_edge` from scratch."""
    _, distance, parent, parent_edge = tree
    place, heap, _, _ = scratch
    distance[:] = np.inf
    parent[:] = NO_PARENT
    parent_edge[:] = NO_PARENT
    place[:] = _WAITING
    distance[source] = 0.0
    heap[0], place[source] = source, 0
    _settle(graph, tree, scratch, 1)
    place[:] = _SETTLED


@njit(cache=True)
def _raise(ends: Int32s, tree: Tree, scratch: Scratch, edge: int, weight: float, count: int) -> int:
    """Raise one edge; the vertex that hangs on it joins the first `count` affected ones."""
    weights, _, _, parent_edge = tree
    place, _, affected, _ = scratch
    if weight <= weights[edge]:
        return count
    weights[edge] = weight
    for end in range(2):
        v = ends[edge, end]
        if parent_edge[v] == edge and place[v] == _SETTLED:
            place[v] = _WAITING
            affected[count] = v
            count += 1
    return count


@njit(cache=True)
def _collect(graph: Adjacency, tree: Tree, scratch: Scratch, count: int) -> int:
    """Extend the first `count` affected vertices by their subtrees and return the new count."""
    indptr, neighbours, _ = graph
    parent = tree[2]
    place, _, affected, _ = scratch
    head = 0
    while head < count:
        u = affected[head]
        head += 1
        for a in range(indptr[u], indptr[u + 1]):
            v = neighbours[a]
            if parent[v] == u and place[v] == _SETTLED:
                place[v] = _WAITING
                affected[count] = v
                count += 1
    return count


@njit(cache=True)
def _reconnect(graph: Adjacency, tree: Tree, scratch: Scratch, v: int) -> None:
    """Give an affected vertex its best settled neighbour as a parent, if any."""
    indptr, neighbours, edge_of = graph
    weights, distance, parent, parent_edge = tree
    place = scratch[0]
    best, best_parent, best_edge = np.inf, NO_PARENT, NO_PARENT
    for a in range(indptr[v], indptr[v + 1]):
        u = neighbours[a]
        if place[u] != _SETTLED:
            continue
        via = distance[u] + weights[edge_of[a]]
        if via < best or (via == best and via < np.inf and u < best_parent):
            best, best_parent, best_edge = via, u, edge_of[a]
    distance[v], parent[v], parent_edge[v] = best, best_parent, best_edge


@njit(cache=True)
def _repair(graph: Adjacency, tree: Tree, scratch: Scratch, roots: int) -> int:
    """Mend the subtrees under the first `roots` affected vertices.

    Returns the number of vertices whose distance changed; they come first in `affected`.
    """
    distance = tree[1]
    place, heap, affected, before = scratch
    count = _collect(graph, tree, scratch, roots)
    for s in range(count):
        before[s] = distance[affected[s]]
    for s in range(count):
        _reconnect(graph, tree, scratch, affected[s])
    size = 0
    for s in range(count):
        v = affected[s]
        if distance[v] < np.inf:
            heap[size] = v
            _sift_up(heap, place, distance, size)
            size += 1
    _settle(graph, tree, scratch, size)
    changed = 0
    for s in range(count):
        v = affected[s]
        place[v] = _SETTLED
        if distance[v] != before[s]:
            affected[changed] = v
            changed += 1
    return changed


@njit(cache=True)
def raise_weights(
    graph: Adjacency, ends: Int32s, tree: Tree, scratch: Scratch, edge_ids: Ints, new_weights: Floats
) -> int:
    """Raise edges (k,) to new weights (k,), inf to delete them, and repair.

    Returns the number of vertices whose distance changed (they come first in `affected`), or, with nothing
    done, `BAD_ID` or `BAD_WEIGHT` (lower than it was, or NaN).
    """
    weights = tree[0]
    for s in range(edge_ids.shape[0]):
        if not 0 <= edge_ids[s] < weights.shape[0]:
            return BAD_ID
        if not new_weights[s] >= weights[edge_ids[s]]:
            return BAD_WEIGHT
    count = 0
    for s in range(edge_ids.shape[0]):
        count = _raise(ends, tree, scratch, edge_ids[s], new_weights[s], count)
    if count == 0:
        return 0
    return _repair(graph, tree, scratch, count)


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
        raise InvalidInputError(f"expected lengths of shape ({m},), one an edge, got {weights.shape}")
    if m and (ends.min() < 0 or ends.max() >= n or np.any(ends[:, 0] == ends[:, 1])):
        raise InvalidInputError(f"expected edges between two different vertices of 0..{n - 1}")
    if not np.all(weights >= 0):
        raise InvalidInputError("expected lengths >= 0, got a negative one or NaN")
    tails = np.concatenate([ends[:, 0], ends[:, 1]])
    heads = np.concatenate([ends[:, 1], ends[:, 0]])
    order = np.lexsort((heads, tails))
    indptr = np.zeros(n + 1, np.int32)
    np.cumsum(np.bincount(tails, minlength=n), out=indptr[1:])
    edge_of = np.tile(np.arange(m, dtype=np.int32), 2)[order]
    return RoadmapGraph(indptr, heads[order], edge_of, ends, weights)


def nearest_graph(points: ArrayLike, weights: ArrayLike, periods: ArrayLike, k: int) -> RoadmapGraph:
    """Join every configuration to its k nearest others (ties to the lower index), both ways.

    Args:
        points: (n, d) configurations.
        weights: (d,) weights of the distance.
        periods: (d,) periods, 0 where not periodic.
        k: neighbours per vertex; a vertex gets more where others choose it.

    Raises:
        InvalidInputError: wrong shapes, values that are not finite, or k < 1.
    """
    if k < 1:
        raise InvalidInputError(f"expected k >= 1, got {k}")
    index = GrowingIndex(weights, periods, capacity=max(1, len(np.asarray(points))))
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
        self._ends = _edge_ends(self._graph, values)
        n = len(graph[0]) - 1
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
        """Solve a `RoadmapGraph` for one source; the graph's lengths are copied."""
        return cls(graph.indptr, graph.neighbours, graph.edge_of, graph.lengths, source)

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
        raise InvalidInputError("expected indptr (n + 1,) to rise from 0 to len(neighbours)")
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
        raise InvalidInputError("expected each edge id twice in edge_of, once from either end")
    return np.stack([tails[pairs], tails[twins]], axis=1)
