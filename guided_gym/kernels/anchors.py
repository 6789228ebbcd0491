"""Configurations anchored to a roadmap: their heuristic, and the anchors that failures take away.

An anchor joins a configuration to a roadmap vertex: h is the least (length of the anchor + distance of its
vertex). Where the anchor runs along a roadmap edge, its length grows with the edge's multiplier.
"""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.collision import Geometry, pose_clearance
from guided_gym.kernels.metric import Metric, placed, segment_separation, separation, shortest
from guided_gym.kernels.nearest import State, k_nearest, within
from guided_gym.kernels.plain import borrowing
from guided_gym.kernels.segments import ROUNDING

Floats = NDArray[np.float64]
Int32s = NDArray[np.int32]
Ints = NDArray[np.int64]
Taught = tuple[Floats, Floats, Floats]
Anchored = tuple[Int32s, Floats, Int32s]
_SLACK = 1.0 + 1e-9  # the index and the metric may round differently


@njit(cache=True)
def anchored_values_of(
    rows: Ints, vertices: Int32s, lengths: Floats, edges: Int32s, multipliers: Floats, distance: Floats
) -> Floats:
    """Heuristic of some configurations; infinite where no anchor leads to the goal.

    Args:
        rows: (r,) int64 which of the configurations.
        vertices: (n, k) int32 roadmap vertex of each anchor; -1 for none.
        lengths: (n, k) length of each anchor; infinite if it was dropped.
        edges: (n, k) int32 roadmap edge that the anchor runs along; -1 for none.
        multipliers: (m,) factor on the length of each roadmap edge.
        distance: (v,) length of the shortest path from each vertex to the goal.
    """
    out = np.empty(rows.size)
    for r in range(rows.size):
        i = rows[r]
        best = np.inf
        for j in range(vertices.shape[1]):
            v = vertices[i, j]
            if v >= 0:
                e = edges[i, j]
                length = lengths[i, j] if e < 0 else lengths[i, j] * multipliers[e]
                best = min(best, length + distance[v])
        out[r] = best
    return out


@borrowing
def _apart(a: Floats, i: int, b: Floats, j: int, weights: Floats, periods: Floats) -> float:
    """`separation` of row i of a and row j of b; a view of each row would cost more than the distance."""
    total = 0.0
    for c in range(a.shape[1]):
        delta = b[j, c] - a[i, c]
        if periods[c] > 0.0:
            delta -= periods[c] * np.floor(delta / periods[c] + 0.5)
        total += (weights[c] * delta) * (weights[c] * delta)
    return np.sqrt(total)


@borrowing
def _charged(
    length: float,
    q: Floats,
    v: Floats,
    near: Ints,
    taught: Taught,
    metric: Metric,
) -> float:
    """Length of the anchor from ``q`` to ``v`` with what was raised near it."""
    states, reaches, factors = taught
    away = separation(q, v, metric)
    for f in near:
        if segment_separation(q, v, states[f], metric) <= reaches[f]:
            if factors[f] == np.inf:
                return np.inf
            length += (factors[f] - 1.0) * away
    return length


@njit(cache=True)
def _close(q: Floats, i: int, among: Ints, taught: Taught, longest: float, metric: Metric) -> Ints:
    """Which of some states an anchor of that length from row i of ``q`` can pass within their reach."""
    states, reaches, _ = taught
    weights, periods = metric
    near, count = np.empty(among.size, np.int64), 0
    for f in among:
        if _apart(q, i, states, f, weights, periods) <= reaches[f] + longest:
            near[count] = f
            count += 1
    return near[:count]


@njit(cache=True)
def _around(
    q: Floats, i: int, index: State, taught: Taught, farthest: float, longest: float, metric: Metric
) -> Ints:
    """`_close` among all states, by an index over them; ``farthest`` is the largest of their reaches."""
    some = within(index, q[i], (farthest + longest) * _SLACK)
    return _close(q, i, some, taught, longest, metric)


@njit(cache=True)
def charge_anchors(
    q: Floats,
    rows: Ints,
    vertices: Int32s,
    lengths: Floats,
    points: Floats,
    taught: Taught,
    metric: Metric,
) -> None:
    """Add ``factor - 1`` times their distance to the anchors that pass near some states; infinite drops them.

    Args:
        q: (n, d) configurations.
        rows: (r,) int64 those to look at.
        vertices: (n, k) int32 roadmap vertex of each anchor; -1 for none.
        lengths: (n, k) length of each anchor, changed in place.
        points: (v, d) roadmap vertices.
        taught: (f, d) where ways were made costlier, (f,) how far around them, (f,) how many times costlier.
        metric: Weights and periods of the distance.
    """
    every = np.arange(taught[1].size)
    for i in rows:
        longest = -1.0
        for j in range(vertices.shape[1]):
            if vertices[i, j] >= 0 and lengths[i, j] < np.inf:
                longest = max(longest, separation(q[i], points[vertices[i, j]], metric))
        if longest < 0.0:
            continue
        near = _close(q, i, every, taught, longest, metric)
        for j in range(vertices.shape[1]):
            if vertices[i, j] >= 0 and lengths[i, j] < np.inf:
                v = points[vertices[i, j]]
                lengths[i, j] = _charged(lengths[i, j], q[i], v, near, taught, metric)


@njit(cache=True)
def nearest_anchors(q: Floats, index: State, points: Floats, k: int, metric: Metric) -> tuple[Int32s, Floats]:
    """(n, k) int32 the nearest vertices of each configuration, and (n, k) their distances.

    Args:
        q: (n, d) configurations.
        index: Nearest-neighbour index over the vertices but the last, which is the goal.
        points: (v, d) roadmap vertices.
        k: Anchors a configuration, at most v - 1; the goal takes the place of the farthest if it is nearer.
        metric: Weights and periods of the distance.
    """
    vertices, lengths = np.empty((q.shape[0], k), np.int32), np.empty((q.shape[0], k))
    goal = points.shape[0] - 1
    for i in range(q.shape[0]):
        ids, away = k_nearest(index, q[i], k)
        vertices[i], lengths[i] = ids.astype(np.int32), away
        far = separation(q[i], points[goal], metric)
        if far <= away[-1]:
            vertices[i, k - 1], lengths[i, k - 1] = goal, far
    return vertices, lengths


@njit(cache=True)
def charged_anchors(
    q: Floats,
    index: State,
    points: Floats,
    k: int,
    taught: Taught,
    lessons: State,
    farthest: float,
    metric: Metric,
) -> Anchored:
    """`nearest_anchors` that have paid for what was raised near them (`charge_anchors`), along no edges."""
    vertices, lengths = nearest_anchors(q, index, points, k, metric)
    for i in range(q.shape[0]):
        near = _around(q, i, lessons, taught, farthest, lengths[i].max(), metric)
        for j in range(k):
            lengths[i, j] = _charged(lengths[i, j], q[i], points[vertices[i, j]], near, taught, metric)
    return vertices, lengths, np.full(vertices.shape, -1, np.int32)


@njit(cache=True)
def candidate_values(
    q: Floats,
    index: State,
    points: Floats,
    distance: Floats,
    k: int,
    around: int,
    taught: Taught,
    lessons: State,
    farthest: float,
    metric: Metric,
) -> Floats:
    """Heuristic of configurations; those that lie close together share the search for their vertices.

    Args:
        q: (n, d) configurations.
        index: Nearest-neighbour index over the vertices but the last, which is the goal.
        points: (v, d) roadmap vertices.
        distance: (v,) length of the shortest path from each vertex to the goal.
        k: Anchors a configuration.
        around: Vertices around all of them from which each takes its own.
        taught: Where ways were made costlier, as in `charge_anchors`.
        lessons: Index over those places, so that a choice costs what was taught near it and not all there is.
        farthest: The largest of their reaches.
        metric: Weights and periods of the distance.

    Returns:
        (n,) the least of length + distance, infinite where no anchor leads to the goal.
    """
    n, goal = q.shape[0], points.shape[0] - 1
    middle = np.zeros(q.shape[1])
    for i in range(n):
        for c in range(q.shape[1]):
            middle[c] += shortest(q[i, c] - q[0, c], metric.periods[c]) / n
    for c in range(q.shape[1]):
        middle[c] = placed(q[0, c] + middle[c], metric.periods[c])
    some, away = k_nearest(index, middle, around)
    spread = 0.0
    for i in range(n):
        spread = max(spread, separation(middle, q[i], metric))
    if separation(middle, points[goal], metric) <= away[-1]:
        some, away = np.append(some, goal), np.append(away, away[-1])
    alone = middle.reshape(1, middle.size)
    close = _around(alone, 0, lessons, taught, farthest, 2.0 * spread + away[-1], metric)
    out = np.full(n, np.inf)
    lengths, ids = np.empty(k), np.empty(k, np.int64)
    weights, periods = metric
    for i in range(n):
        held, off = 0, separation(middle, q[i], metric)
        for a in range(some.size):
            v = some[a]
            if held == k and away[a] - off > ROUNDING * lengths[k - 1] and v != goal:
                continue  # those farther from the middle are farther from here
            length = _apart(q, i, points, v, weights, periods)
            if held == k and length >= lengths[k - 1]:
                continue
            slot = held if held < k else k - 1
            while slot > 0 and lengths[slot - 1] > length:
                lengths[slot], ids[slot] = lengths[slot - 1], ids[slot - 1]
                slot -= 1
            lengths[slot], ids[slot] = length, v
            held = min(held + 1, k)
        if lengths[k - 1] > away[-1] - off:  # another vertex may be nearer
            own, far = nearest_anchors(q[i : i + 1], index, points, k, metric)
            ids[:], lengths[:] = own[0].astype(np.int64), far[0]
            near = _around(q, i, lessons, taught, farthest, lengths[k - 1], metric)
        else:
            near = _close(q, i, close, taught, lengths[k - 1], metric)
        for j in range(k):
            if lengths[j] + distance[ids[j]] < out[i]:
                v = points[ids[j]]
                length = _charged(lengths[j], q[i], v, near, taught, metric)
                out[i] = min(out[i], length + distance[ids[j]])
    return out


@njit(cache=True)
def segments_touched(tails: Floats, heads: Floats, q: Floats, reach: float, metric: Metric) -> Ints:
    """Which of a few segments (m, d) to (m, d) pass within ``reach`` of a configuration."""
    out, count = np.empty(tails.shape[0], np.int64), 0
    for e in range(tails.shape[0]):
        if segment_separation(tails[e], heads[e], q, metric) <= reach:
            out[count] = e
            count += 1
    return out[:count]


@borrowing
def link_anchors(
    vertices: Int32s, first: int, last: int, head: Int32s, node_of: Int32s, following: Int32s, count: int
) -> int:
    """Enter rows ``first`` to ``last`` into the lists, one per roadmap vertex, of who is anchored to it.

    Args:
        vertices: (>= last, k) int32 roadmap vertex of each anchor; -1 for none.
        first: First row to enter.
        last: One past the last.
        head: (v,) int32 first link of each vertex's list; -1 for none.
        node_of: (>= count + (last - first) k,) int32 row of each link.
        following: The same length, int32 next link in the same list; -1 at its end.
        count: Links so far.

    Returns:
        The new number of links.
    """
    for i in range(first, last):
        for j in range(vertices.shape[1]):
            v = vertices[i, j]
            if v >= 0:
                node_of[count], following[count], head[v] = i, head[v], count
                count += 1
    return count


@borrowing
def enter_anchors(
    held: Anchored, fresh: Anchored, first: int, lists: tuple[Int32s, Int32s, Int32s], count: int
) -> tuple[int, float]:
    """Write the anchors of the next nodes behind those of the earlier ones, and enter them into the lists.

    Args:
        held: Vertices, lengths and edges (capacity, k) of all nodes' anchors, changed in place.
        fresh: Those of the next nodes, (n, k).
        first: How many nodes there were.
        lists: ``head``, ``node_of`` and ``following`` of `link_anchors`.
        count: Links so far.

    Returns:
        The new number of links, and the longest of the fresh anchors that are finite, else 0.
    """
    last, longest = first + fresh[0].shape[0], 0.0
    for i in range(first, last):
        for j in range(fresh[0].shape[1]):
            length = fresh[1][i - first, j]
            held[0][i, j], held[1][i, j], held[2][i, j] = (
                fresh[0][i - first, j],
                length,
                fresh[2][i - first, j],
            )
            if longest < length < np.inf:
                longest = length
    return link_anchors(held[0], first, last, lists[0], lists[1], lists[2], count), longest


@njit(cache=True)
def linked_nodes(changed: Ints, head: Int32s, node_of: Int32s, following: Int32s, n: int) -> Ints:
    """The rows, ascending, that are anchored to one of the ``changed`` vertices; see `link_anchors`.

    Args:
        changed: (c,) int64 roadmap vertices.
        head: (v,) int32 first link of each vertex's list.
        node_of: int32 row of each link.
        following: int32 next link in the same list.
        n: Number of rows.
    """
    marked = np.zeros(n, np.bool_)
    for v in changed:
        link = head[v]
        while link >= 0:
            marked[node_of[link]] = True
            link = following[link]
    return np.nonzero(marked)[0]


@borrowing
def _segment_squared(q: Floats, tails: Floats, heads: Floats, e: int) -> tuple[float, float]:
    """Fraction along a segment of its point nearest to q, and the square of the distance to that."""
    ux, uy = heads[e, 0] - tails[e, 0], heads[e, 1] - tails[e, 1]
    px, py = q[0] - tails[e, 0], q[1] - tails[e, 1]
    squared = ux * ux + uy * uy
    t = 0.0 if squared == 0.0 else min(1.0, max(0.0, (ux * px + uy * py) / squared))
    dx, dy = px - t * ux, py - t * uy
    return t, dx * dx + dy * dy


@njit(cache=True)
def nearest_segments(q: Floats, tails: Floats, heads: Floats) -> tuple[Int32s, Floats, Floats]:
    """The nearest of a set of plane segments to each point.

    Args:
        q: (n, >= 2) points; the first two coordinates count.
        tails: (m, 2) first end of each segment.
        heads: (m, 2) second end of each segment.

    Returns:
        (n,) int32 segment, (n,) fraction along it of the nearest point, (n,) distance to that point.
    """
    n = q.shape[0]
    segment, fraction, away = np.zeros(n, np.int32), np.zeros(n), np.full(n, np.inf)
    for i in range(n):
        for e in range(tails.shape[0]):
            t, d = _segment_squared(q[i], tails, heads, e)
            if d < away[i]:
                segment[i], fraction[i], away[i] = e, t, d
        away[i] = np.sqrt(away[i])
    return segment, fraction, away


@njit(cache=True)
def edge_anchors(
    q: Floats, tails: Floats, heads: Floats, edges: Int32s, lengths: Floats, geometry: Geometry
) -> Anchored:
    """Join each point to both ends of its nearest segment; one in an obstacle by ways of infinite length.

    Args:
        q: (n, 2) points.
        tails: (m, 2) first end of each segment.
        heads: (m, 2) second end of each segment.
        edges: (m, 2) int32 vertices of both ends.
        lengths: (m,) length of each segment.
        geometry: Of a point robot.

    Returns:
        (n, 2) int32 vertices, (n, 2) lengths along the segment, (n, 2) int32 the segment.
    """
    n = q.shape[0]
    segment, fraction, _ = nearest_segments(q, tails, heads)
    vertices, along, edge = np.empty((n, 2), np.int32), np.empty((n, 2)), np.empty((n, 2), np.int32)
    for i in range(n):
        e = segment[i]
        vertices[i], edge[i] = edges[e], e
        if pose_clearance(q[i], geometry) > 0.0:
            along[i, 0] = fraction[i] * lengths[e]
            along[i, 1] = lengths[e] - along[i, 0]
        else:
            along[i] = np.inf
    return vertices, along, edge
