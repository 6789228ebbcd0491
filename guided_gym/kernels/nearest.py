"""Exact nearest neighbours among configurations that keep arriving: an insert-only k-d tree.

A search tree asks for a neighbour before every insertion, so the index is never rebuilt as a whole for one.
Leaves are buckets that split at the median; every node keeps the tight box of its points, so a split plane
only guides insertion and ties may lie on both sides. A subtree that grows lopsided (sorted insertions) is
rebuilt, which bounds the depth and keeps the amortised cost of an insertion logarithmic.

Distances are `sqrt(sum_i (w_i * wrap(delta_i))^2)`. Rounding is monotone in every step of it, for points and
for boxes alike, so pruning never loses a neighbour, not even one that ties in the last bit. The order is that
of the squares, ties by index.

Fused kernels take `GrowingIndex.state` and call `insert`, `nearest`, `k_nearest` and `within` themselves.
`insert` returns `FULL` and changes nothing when no row is left: the kernel must then return to Python, which
calls `GrowingIndex.reserve` and enters the kernel again with the *new* `state`.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.plain import borrowing

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]
State: TypeAlias = tuple[Floats, NDArray[np.int32], Floats, Floats, Ints]
"""The index as arrays, of one numba type for every dimension (all C-contiguous; d is the dimension):

points (capacity, d) float64: configurations, periodic coordinates wrapped to [-period/2, period/2)
nodes (node capacity, 5 + LEAF_SIZE) int32: axis (-1 in a leaf), left, right, count, lowest index, bucket
boxes (node capacity, 2 d + 1) float64: lower corner, upper corner, split value
work (3 d + STACK_SIZE,) float64: weights, periods (inf: not periodic), the query, stacked squared distances
counters (3 + STACK_SIZE,) int64: number of points, number of nodes used, first free node, stacked nodes
"""

FULL = -1
"""Returned by `insert` when no row is left; nothing was changed."""
NOT_FINITE = -2
"""Returned by `insert` for a configuration with NaN or an infinity; nothing was changed."""

LEAF_SIZE = 24
STACK_SIZE = 128  # the depth stays below log(n) / log(1 / MAX_SHARE) + LEAF_SIZE
MAX_SHARE = 0.75  # a child with a larger share of its parent's points has the parent rebuilt
MIN_REBUILD = 8 * LEAF_SIZE
MAX_DIMENSION = 16

AXIS, LEFT, RIGHT, COUNT, LOWEST, BUCKET = range(6)
POINTS, NODES, FREE, STACK = range(4)
NONE = -1


@borrowing
def wrapped(value: float, period: float) -> float:
    """Return `value` in [-period/2, period/2); unchanged where the period is infinite."""
    half = 0.5 * period
    if -half <= value < half or not np.isfinite(period):
        return value
    value -= period * np.floor((value + half) / period)
    if value >= half or value < -half:  # only rounding gets here
        return -half
    return value


@borrowing
def load_query(work: Floats, q: Floats) -> None:
    """Write a configuration, wrapped, to where the distance functions read it."""
    d = q.shape[0]
    for j in range(d):
        work[2 * d + j] = wrapped(q[j], work[d + j])


@borrowing
def point_distance2(points: Floats, i: int, work: Floats) -> float:
    """Squared distance of point `i` from the loaded query."""
    d = points.shape[1]
    total = 0.0
    for j in range(d):
        delta = abs(points[i, j] - work[2 * d + j])
        delta = min(delta, work[d + j] - delta) * work[j]
        total += delta * delta
    return total


@borrowing
def box_distance2(boxes: Floats, node: int, work: Floats) -> float:
    """Squared distance of the loaded query from a node's box, the shorter way round where periodic."""
    d = boxes.shape[1] // 2
    total = 0.0
    for j in range(d):
        below = boxes[node, j] - work[2 * d + j]
        above = work[2 * d + j] - boxes[node, d + j]
        gap = max(below, above)
        if gap > 0.0:
            gap = min(gap, work[d + j] + min(below, above)) * work[j]
            total += gap * gap
    return total


@borrowing
def _new_node(nodes: NDArray[np.int32], boxes: Floats, counters: Ints) -> int:
    node: int = counters[FREE]
    if node >= 0:
        counters[FREE] = nodes[node, LEFT]
    else:
        node = counters[NODES]
        counters[NODES] = node + 1
    clear_node(nodes, boxes, node)
    return node


@borrowing
def clear_node(nodes: NDArray[np.int32], boxes: Floats, node: int) -> None:
    """Make a node an empty leaf."""
    d = boxes.shape[1] // 2
    nodes[node, AXIS] = NONE
    nodes[node, COUNT] = 0
    for j in range(d):
        boxes[node, j] = np.inf
        boxes[node, d + j] = -np.inf


@borrowing
def _include(points: Floats, nodes: NDArray[np.int32], boxes: Floats, node: int, i: int) -> None:
    """Count point `i` in `node` and widen its box."""
    d = points.shape[1]
    if nodes[node, COUNT] == 0 or i < nodes[node, LOWEST]:
        nodes[node, LOWEST] = i
    nodes[node, COUNT] += 1
    for j in range(d):
        boxes[node, j] = min(boxes[node, j], points[i, j])
        boxes[node, d + j] = max(boxes[node, d + j], points[i, j])


@borrowing
def _select_middle(points: Floats, ids: NDArray[np.int32], start: int, stop: int, axis: int) -> int:
    """Partition ids[start:stop] about the middle by (coordinate, id) and return the middle."""
    middle = (start + stop) // 2
    low, high = start, stop - 1
    while low < high:
        pivot = ids[(low + high) // 2]
        value = points[pivot, axis]
        left, right = low, high
        while left <= right:
            while points[ids[left], axis] < value or (points[ids[left], axis] == value and ids[left] < pivot):
                left += 1
            while points[ids[right], axis] > value or (
                points[ids[right], axis] == value and ids[right] > pivot
            ):
                right -= 1
            if left <= right:
                ids[left], ids[right] = ids[right], ids[left]
                left += 1
                right -= 1
        if middle <= right:
            high = right
        elif middle >= left:
            low = left
        else:
            break
    return middle


@borrowing
def _widest_axis(boxes: Floats, node: int, work: Floats) -> int:
    d = boxes.shape[1] // 2
    axis, widest = 0, -1.0
    for j in range(d):
        extent = (boxes[node, d + j] - boxes[node, j]) * work[j]
        if extent > widest:
            axis, widest = j, extent
    return axis


@njit(cache=True)
def _build(state: State, root: int, ids: NDArray[np.int32]) -> None:
    """Make `root` (cleared) the subtree over `ids`."""
    points, nodes, boxes, work, counters = state
    d = points.shape[1]
    pending = np.empty((STACK_SIZE, 3), np.int64)
    pending[0, 0], pending[0, 1], pending[0, 2] = root, 0, ids.shape[0]
    top = 1
    while top > 0:
        top -= 1
        node, start, stop = pending[top, 0], pending[top, 1], pending[top, 2]
        for s in range(start, stop):
            _include(points, nodes, boxes, node, ids[s])
        if stop - start <= LEAF_SIZE:
            for s in range(start, stop):
                nodes[node, BUCKET + s - start] = ids[s]
            continue
        axis = _widest_axis(boxes, node, work)
        middle = _select_middle(points, ids, start, stop, axis)
        nodes[node, AXIS] = axis
        boxes[node, 2 * d] = points[ids[middle], axis]
        for side in range(2):
            child = _new_node(nodes, boxes, counters)
            nodes[node, LEFT + side] = child
            pending[top, 0] = child
            pending[top, 1] = middle if side else start
            pending[top, 2] = stop if side else middle
            top += 1


@njit(cache=True)
def _dissolve(state: State, root: int, extra: int) -> NDArray[np.int32]:
    """Free every node under `root`, clear `root` itself, and return the ids that it held, and `extra`."""
    _, nodes, boxes, _, counters = state
    ids = np.empty(nodes[root, COUNT] + 1, np.int32)
    ids[0] = extra
    found = 1
    counters[STACK] = root
    top = 1
    while top > 0:
        top -= 1
        node = counters[STACK + top]
        if nodes[node, AXIS] < 0:
            for s in range(nodes[node, COUNT]):
                ids[found] = nodes[node, BUCKET + s]
                found += 1
        else:
            counters[STACK + top] = nodes[node, RIGHT]
            counters[STACK + top + 1] = nodes[node, LEFT]
            top += 2
        if node != root:
            nodes[node, LEFT] = counters[FREE]
            counters[FREE] = node
    clear_node(nodes, boxes, root)
    return ids[:found]


@borrowing
def _child_for(state: State, node: int, i: int) -> int:
    """Choose the child that takes point `i`; a point on the split plane goes to the smaller side."""
    points, nodes, boxes, _, _ = state
    value = points[i, nodes[node, AXIS]]
    split = boxes[node, 2 * points.shape[1]]
    left: int = nodes[node, LEFT]
    right: int = nodes[node, RIGHT]
    if value < split or (value == split and nodes[left, COUNT] <= nodes[right, COUNT]):
        return left
    return right


@njit(cache=True)
def insert(state: State, q: Floats) -> int:
    """Add a configuration and return its index, or `FULL`, or `NOT_FINITE`.

    Amortised O(log n) for every order of insertion (rarely a rebuild: O(log^2 n)).
    """
    points, nodes, boxes, work, counters = state
    i: int = counters[POINTS]
    d = points.shape[1]
    if i >= points.shape[0]:
        return FULL
    for j in range(d):
        if not np.isfinite(q[j]):
            return NOT_FINITE
    for j in range(d):
        points[i, j] = wrapped(q[j], work[d + j])
    counters[POINTS] = i + 1
    node, lopsided = 0, NONE
    while nodes[node, AXIS] >= 0:
        _include(points, nodes, boxes, node, i)
        child = _child_for(state, node, i)
        count = nodes[node, COUNT]
        if lopsided < 0 and count > MIN_REBUILD and nodes[child, COUNT] + 1 > MAX_SHARE * count:
            lopsided = node
        node = child
    if lopsided < 0 and nodes[node, COUNT] < LEAF_SIZE:
        nodes[node, BUCKET + nodes[node, COUNT]] = i
        _include(points, nodes, boxes, node, i)
    else:
        if lopsided >= 0:
            node = lopsided
        _build(state, node, _dissolve(state, node, i))
    return i


@borrowing
def _offer(d2: float, i: int, indices: Ints, squares: Floats) -> None:
    """Keep (d2, i) among the k best, sorted by distance, then by index."""
    last = indices.shape[0] - 1
    if d2 > squares[last] or (d2 == squares[last] and i > indices[last]):
        return
    while last > 0 and (d2 < squares[last - 1] or (d2 == squares[last - 1] and i < indices[last - 1])):
        squares[last] = squares[last - 1]
        indices[last] = indices[last - 1]
        last -= 1
    squares[last] = d2
    indices[last] = i


@borrowing
def _search(state: State, q: Floats, indices: Ints, squares: Floats) -> None:
    """Fill `indices` and `squares` (k,) with the k nearest; k must not exceed the number of points."""
    points, nodes, boxes, work, counters = state
    n, last, stacked = counters[POINTS], indices.shape[0] - 1, 3 * points.shape[1]
    load_query(work, q)
    for s in range(last + 1):
        indices[s], squares[s] = n, np.inf
    node, node_d2, top = 0, 0.0, 0
    while True:
        while node_d2 < squares[last] or (node_d2 == squares[last] and nodes[node, LOWEST] < indices[last]):
            if nodes[node, AXIS] < 0:
                for s in range(nodes[node, COUNT]):
                    i = nodes[node, BUCKET + s]
                    _offer(point_distance2(points, i, work), i, indices, squares)
                break
            near, far = nodes[node, LEFT], nodes[node, RIGHT]
            near_d2, far_d2 = box_distance2(boxes, near, work), box_distance2(boxes, far, work)
            if far_d2 < near_d2:
                near, far, near_d2, far_d2 = far, near, far_d2, near_d2
            if far_d2 <= squares[last]:
                counters[STACK + top], work[stacked + top] = far, far_d2
                top += 1
            node, node_d2 = near, near_d2
        if top == 0:
            return
        top -= 1
        node, node_d2 = counters[STACK + top], work[stacked + top]


@borrowing
def nearest(state: State, q: Floats) -> tuple[int, float]:
    """Return the nearest configuration's index and distance; (-1, inf) if none or q is not finite."""
    points, nodes, boxes, work, counters = state
    n, stacked = counters[POINTS], 3 * points.shape[1]
    load_query(work, q)
    best, best_d2 = n, np.inf
    node, node_d2, top = 0, 0.0, 0
    while True:
        while node_d2 < best_d2 or (node_d2 == best_d2 and nodes[node, LOWEST] < best):
            if nodes[node, AXIS] < 0:
                for s in range(nodes[node, COUNT]):
                    i = nodes[node, BUCKET + s]
                    d2 = point_distance2(points, i, work)
                    if d2 < best_d2 or (d2 == best_d2 and i < best):
                        best, best_d2 = i, d2
                break
            near, far = nodes[node, LEFT], nodes[node, RIGHT]
            near_d2, far_d2 = box_distance2(boxes, near, work), box_distance2(boxes, far, work)
            if far_d2 < near_d2:
                near, far, near_d2, far_d2 = far, near, far_d2, near_d2
            if far_d2 <= best_d2:
                counters[STACK + top], work[stacked + top] = far, far_d2
                top += 1
            node, node_d2 = near, near_d2
        if top == 0:
            break
        top -= 1
        node, node_d2 = counters[STACK + top], work[stacked + top]
    if best_d2 == np.inf:
        return -1, np.inf
    return best, np.sqrt(best_d2)


@njit(cache=True)
def k_nearest(state: State, q: Floats, k: int) -> tuple[Ints, Floats]:
    """Return indices (k,) int64 and distances (k,), nearest first, ties by index; fewer if fewer exist."""
    k = min(k, state[4][POINTS])
    indices, squares = np.empty(k, np.int64), np.empty(k, np.float64)
    if k > 0:
        _search(state, q, indices, squares)
    return indices, np.sqrt(squares)


@njit(cache=True)
def doubled(values: Ints) -> Ints:
    """Return a copy with room for as many again."""
    wider = np.empty(2 * values.shape[0], np.int64)
    for s in range(values.shape[0]):
        wider[s] = values[s]
    return wider


@njit(cache=True)
def first_sorted(values: Ints, count: int) -> Ints:
    """Return the first `count` values, ascending (heapsort: numba's own sort takes seconds to compile)."""
    out = np.empty(count, np.int64)
    for s in range(count):
        out[s] = values[s]
    start, stop = count // 2, count
    while stop > 1:
        if start > 0:
            start -= 1
        else:
            stop -= 1
            out[0], out[stop] = out[stop], out[0]
        slot = start
        value = out[slot]
        child = 2 * slot + 1
        while child < stop:
            if child + 1 < stop and out[child] < out[child + 1]:
                child += 1
            if out[child] <= value:
                break
            out[slot] = out[child]
            slot = child
            child = 2 * slot + 1
        out[slot] = value
    return out


@njit(cache=True)
def within(state: State, q: Floats, r: float) -> Ints:
    """Return the indices (m,) int64, ascending, of all configurations at a distance of at most `r`."""
    points, nodes, boxes, work, counters = state
    load_query(work, q)
    found, hits = 0, np.empty(64, np.int64)
    counters[STACK] = 0
    top = 1
    while top > 0:
        top -= 1
        node = counters[STACK + top]
        if np.sqrt(box_distance2(boxes, node, work)) > r:
            continue
        if nodes[node, AXIS] >= 0:
            counters[STACK + top] = nodes[node, RIGHT]
            counters[STACK + top + 1] = nodes[node, LEFT]
            top += 2
            continue
        if found + LEAF_SIZE > hits.shape[0]:
            hits = doubled(hits)
        for s in range(nodes[node, COUNT]):
            i = nodes[node, BUCKET + s]
            if np.sqrt(point_distance2(points, i, work)) <= r:
                hits[found] = i
                found += 1
    return first_sorted(hits, found)


@njit(cache=True)
def insert_many(state: State, Q: Floats) -> int:
    """`insert` for each row (n, d), all finite; into an empty index all at once."""
    points, _, _, work, counters = state
    n: int = Q.shape[0]
    d: int = Q.shape[1]
    if counters[POINTS] == 0 and LEAF_SIZE < n <= points.shape[0]:
        for row in range(n):
            for j in range(d):
                points[row, j] = wrapped(Q[row, j], work[d + j])
        counters[POINTS] = n
        _build(state, 0, np.arange(n).astype(np.int32))
        return n
    for row in range(n):
        status: int = insert(state, Q[row])
        if status < 0:
            return status
    return n


@njit(cache=True)
def nearest_many(state: State, Q: Floats) -> tuple[Ints, Floats]:
    """`nearest` for each row (n, d)."""
    indices, distances = np.empty(Q.shape[0], np.int64), np.empty(Q.shape[0], np.float64)
    for row in range(Q.shape[0]):
        indices[row], distances[row] = nearest(state, Q[row])
    return indices, distances


@njit(cache=True)
def k_nearest_many(state: State, Q: Floats, k: int) -> tuple[Ints, Floats]:
    """`k_nearest` for each row (n, d)."""
    indices, squares = np.empty((Q.shape[0], k), np.int64), np.empty((Q.shape[0], k), np.float64)
    for row in range(Q.shape[0]):
        _search(state, Q[row], indices[row], squares[row])
    return indices, np.sqrt(squares)


@njit(cache=True)
def depth(nodes: NDArray[np.int32]) -> int:
    """Number of levels, for tests of the balance."""
    pending = np.zeros((STACK_SIZE, 2), np.int64)
    top, deepest = 1, 0
    while top > 0:
        top -= 1
        node, level = pending[top, 0], pending[top, 1] + 1
        deepest = max(deepest, level)
        if nodes[node, AXIS] >= 0:
            pending[top, 0], pending[top, 1] = nodes[node, RIGHT], level
            pending[top + 1, 0], pending[top + 1, 1] = nodes[node, LEFT], level
            top += 2
    return deepest
