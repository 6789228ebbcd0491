"""Which straight edges of a roadmap pass near a configuration: an index over segments.

An edge is the short way between its ends, held as its midpoint and half of its difference vector. The
midpoints live in a k-d tree (`nearest`), whose nodes also know the longest half edge below them: long edges
slow down their own part of the tree alone.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.nearest import (
    AXIS,
    BUCKET,
    COUNT,
    LEAF_SIZE,
    LEFT,
    RIGHT,
    STACK,
    Floats,
    Ints,
    State,
    box_distance2,
    doubled,
    first_sorted,
    insert_many,
    load_query,
    point_distance2,
    wrapped,
)
from guided_gym.kernels.plain import borrowing

Int32s: TypeAlias = NDArray[np.int32]

ROUNDING = 1.0 + 1e-12  # widens radii before pruning: these bounds do not round monotonically


@borrowing
def _offset(points: Floats, i: int, work: Floats, j: int, turned: int) -> float:
    """Coordinate j of point `i` minus the query, the short way round, the other way if `turned` says so."""
    period = work[points.shape[1] + j]
    delta: float = points[i, j] - work[2 * points.shape[1] + j]
    if 2.0 * abs(delta) > period:
        delta -= np.copysign(period, delta)
    if (turned >> j) & 1:
        delta -= np.copysign(period, delta)
    return delta


@borrowing
def _shifted_distance2(points: Floats, i: int, work: Floats, halves: Floats, row: int, turned: int) -> float:
    """Squared distance of the origin from `offset + t * halves[row]`, t in [-1, 1]."""
    d = points.shape[1]
    along, length2 = 0.0, 0.0
    for j in range(d):
        half = halves[row, j] * work[j]
        along -= _offset(points, i, work, j, turned) * work[j] * half
        length2 += half * half
    t = 0.0
    if length2 > 0.0:
        t = min(1.0, max(-1.0, along / length2))
    total = 0.0
    for j in range(d):
        gap = (_offset(points, i, work, j, turned) + t * halves[row, j]) * work[j]
        total += gap * gap
    return total


@borrowing
def segment_distance2(points: Floats, i: int, work: Floats, halves: Floats, row: int) -> float:
    """Squared distance between a segment and a configuration, over every way round.

    One of point `i` and the loaded query is the segment's midpoint, the other the configuration;
    `halves[row]` (d,) is half the segment's difference vector, so at most a quarter of a period long.
    """
    d = points.shape[1]
    turnable = 0
    for j in range(d):
        period = work[d + j]
        delta = abs(points[i, j] - work[2 * d + j])
        if min(delta, period - delta) + abs(halves[row, j]) > 0.5 * period:
            turnable |= 1 << j  # one end of the segment is nearer the other way round
    best = _shifted_distance2(points, i, work, halves, row, 0)
    turned = turnable
    while turned > 0:
        best = min(best, _shifted_distance2(points, i, work, halves, row, turned))
        turned = (turned - 1) & turnable
    return best


@borrowing
def load_segment(work: Floats, a: Floats, b: Floats, halves: Floats, row: int) -> float:
    """Load the midpoint of the short way from `a` to `b` as the query; return half of its length.

    Half of the difference vector goes to `halves[row]`.
    """
    d = a.shape[0]
    half2: float = 0.0
    for j in range(d):
        period = work[d + j]
        start = wrapped(a[j], period)
        half = 0.5 * wrapped(b[j] - start, period)
        halves[row, j] = half
        work[2 * d + j] = wrapped(start + half, period)
        half2 += (half * work[j]) ** 2
    return float(np.sqrt(half2))


@njit(cache=True)
def node_reach(nodes: Int32s, half_lengths: Floats, reach: Floats) -> None:
    """Fill reach (node capacity,) with the longest half of a segment in each subtree."""
    order = np.zeros(nodes.shape[0], np.int64)  # from the root down, parents first
    count, head = 1, 0
    while head < count:
        node = order[head]
        head += 1
        if nodes[node, AXIS] >= 0:
            order[count], order[count + 1] = nodes[node, LEFT], nodes[node, RIGHT]
            count += 2
    for head in range(count - 1, -1, -1):
        node = order[head]
        if nodes[node, AXIS] >= 0:
            reach[node] = max(reach[nodes[node, LEFT]], reach[nodes[node, RIGHT]])
        for s in range(nodes[node, COUNT] if nodes[node, AXIS] < 0 else 0):
            reach[node] = max(reach[node], half_lengths[nodes[node, BUCKET + s]])


@njit(cache=True)
def load_segments(state: State, points: Floats, edges: Int32s, halves: Floats, lengths: Floats) -> None:
    """Insert the midpoints of the edges, and fill halves (m, d) and half lengths (m,)."""
    work = state[3]
    d = points.shape[1]
    middles = np.empty(halves.shape)
    for e in range(edges.shape[0]):
        lengths[e] = load_segment(work, points[edges[e, 0]], points[edges[e, 1]], halves, e)
        middles[e] = work[2 * d : 3 * d]
    insert_many(state, middles)


@njit(cache=True)
def segments_within(
    state: State, halves: Floats, half_lengths: Floats, reach: Floats, q: Floats, r: float
) -> Ints:
    """Return the ids (k,) int64, ascending, of the segments that pass within `r` of `q`.

    Args:
        state: index of the midpoints.
        halves: (m, d) half of each segment's difference vector.
        half_lengths: (m,) their lengths.
        reach: (node capacity,) longest half of a segment under each node of the index.
        q: (d,) configuration.
        r: radius, in the unit of the distance.
    """
    points, nodes, boxes, work, counters = state
    load_query(work, q)
    found, hits = 0, np.empty(64, np.int64)
    counters[STACK] = 0
    top = 1
    while top > 0:
        top -= 1
        node = counters[STACK + top]
        if np.sqrt(box_distance2(boxes, node, work)) > (r + reach[node]) * ROUNDING:
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
            far = (r + half_lengths[i]) * ROUNDING
            if point_distance2(points, i, work) > far * far:
                continue
            if np.sqrt(segment_distance2(points, i, work, halves, i)) <= r:
                hits[found] = i
                found += 1
    return first_sorted(hits, found)
