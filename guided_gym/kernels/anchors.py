"""Configurations anchored to a roadmap: their heuristic, and the anchors that failures take away.

An anchor joins a configuration to a roadmap vertex: h is the least (length of the anchor + distance of its
vertex). Where the anchor runs along a roadmap edge, its length grows with the edge's multiplier.
"""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.metric import Metric, segment_separation, separation

Floats = NDArray[np.float64]
Int32s = NDArray[np.int32]
Ints = NDArray[np.int64]


@njit(cache=True)
def anchored_values(
    vertices: Int32s,
    lengths: Floats,
    edges: Int32s,
    multipliers: Floats,
    distance: Floats,
    n: int,
) -> Floats:
    """Heuristic of the first n configurations; infinite where no anchor leads to the goal.

    Args:
        vertices: (>= n, k) int32 roadmap vertex of each anchor; -1 for none.
        lengths: (>= n, k) length of each anchor; infinite if it was dropped.
        edges: (>= n, k) int32 roadmap edge that the anchor runs along; -1 for none.
        multipliers: (m,) factor on the length of each roadmap edge.
        distance: (v,) length of the shortest path from each vertex to the goal.
        n: Number of configurations.
    """
    return anchored_values_of(np.arange(n), vertices, lengths, edges, multipliers, distance)


@njit(cache=True)
def anchored_values_of(
    rows: Ints, vertices: Int32s, lengths: Floats, edges: Int32s, multipliers: Floats, distance: Floats
) -> Floats:
    """Heuristic of some configurations, given by their ``rows``; see `anchored_values`."""
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


@njit(cache=True)
def drop_anchors(
    q: Floats,
    rows: Ints,
    vertices: Int32s,
    lengths: Floats,
    points: Floats,
    contacts: Floats,
    radius: float,
    metric: Metric,
) -> None:
    """Drop the anchors that pass within ``radius`` of a colliding configuration: their length becomes inf.

    Args:
        q: (n, d) configurations.
        rows: (r,) int64 those to look at.
        vertices: (n, k) int32 roadmap vertex of each anchor; -1 for none.
        lengths: (n, k) length of each anchor, changed in place.
        points: (v, d) roadmap vertices.
        contacts: (f, d) colliding configurations.
        radius: Distance within which an anchor is dropped.
        metric: Weights and periods of the distance.
    """
    for i in rows:
        longest = -1.0
        for j in range(vertices.shape[1]):
            if vertices[i, j] >= 0 and lengths[i, j] < np.inf:
                longest = max(longest, lengths[i, j])
        if longest < 0.0:
            continue
        for f in range(contacts.shape[0]):
            away = separation(q[i], contacts[f], metric)
            if away > radius + longest:
                continue
            for j in range(vertices.shape[1]):
                v = vertices[i, j]
                if v < 0 or away > radius + lengths[i, j] or lengths[i, j] == np.inf:
                    continue
                if segment_separation(q[i], points[v], contacts[f], metric) <= radius:
                    lengths[i, j] = np.inf


@njit(cache=True)
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


@njit(cache=True)
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
def segments_within(q: Floats, tails: Floats, heads: Floats, reach: float) -> Int32s:
    """The plane segments, ascending, at most ``reach`` from a point; see `nearest_segments`."""
    out = np.empty(tails.shape[0], np.int32)
    count = 0
    for e in range(tails.shape[0]):
        if _segment_squared(q, tails, heads, e)[1] <= reach * reach:
            out[count] = e
            count += 1
    return out[:count]
