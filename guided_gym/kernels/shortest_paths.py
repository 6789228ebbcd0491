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

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from guided_gym.kernels.nearest import Floats, Ints
from guided_gym.kernels.plain import borrowing

Int32s: TypeAlias = NDArray[np.int32]
Adjacency: TypeAlias = tuple[Int32s, Int32s, Int32s]
"""CSR: indptr (n + 1,), neighbours (m2,), edge_of (m2,), all int32."""
Tree: TypeAlias = tuple[Floats, Floats, Int32s, Int32s]
"""weights (m,) float64, distance (n,) float64, parent (n,) int32, parent_edge (n,) int32."""
Scratch: TypeAlias = tuple[Int32s, Int32s, Int32s, Floats]
"""place (n,) int32: position in the heap or a mark; heap (n,) int32: vertices; affected (n,) int32: vertices;
before (n,) float64: distances of the affected vertices before the repair, in the same order."""


NO_PARENT = -1
BAD_ID = -1
"""Returned by a kernel for an id out of range; nothing was changed."""
BAD_WEIGHT = -2
"""Returned by a kernel for a weight below the present one; nothing was changed."""

_SETTLED = -1  # marks in `place`: not affected, or done
_WAITING = -2  # affected, without a finite distance so far


@borrowing
def _before(distance: Floats, u: int, v: int) -> bool:
    """Order of the heap: by distance, ties by index."""
    return distance[u] < distance[v] or (distance[u] == distance[v] and u < v)


@borrowing
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


@borrowing
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


@borrowing
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


@borrowing
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


@borrowing
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


@borrowing
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


@borrowing
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


@borrowing
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


@borrowing
def lengthen(
    graph: Adjacency,
    ends: Int32s,
    tree: Tree,
    scratch: Scratch,
    edge_ids: Ints,
    lengths: Floats,
    multipliers: Floats,
) -> int:
    """Raise edges (k,), all of which there are, to their length times their multiplier, and repair.

    Returns the number of vertices whose distance changed; they come first in `affected`.
    """
    count = 0
    for e in edge_ids:
        weight = np.inf if multipliers[e] == np.inf else lengths[e] * multipliers[e]
        count = _raise(ends, tree, scratch, e, weight, count)
    if count == 0:
        return 0
    return _repair(graph, tree, scratch, count)
