"""Waypoints of paths: the shortest way over those that see each other; anchors to those of stored paths."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.collision import Geometry, motion_free
from guided_gym.kernels.metric import Metric, placed, separation
from guided_gym.kernels.plain import ONE, ZERO, copy_row, where_least

Floats = NDArray[np.float64]
Int32s = NDArray[np.int32]
Ints = NDArray[np.int64]

_WORTH = 0.02
"""Part of its way that a waypoint must shorten the path by to move."""


@njit(cache=True)
def path_anchors(
    q: Floats,
    near: Ints,
    points: Floats,
    path_of: Int32s,
    distance: Floats,
    reach: float,
    k: int,
    metric: Metric,
) -> tuple[Int32s, Floats]:
    """Up to k anchors of each configuration, on different paths, by ascending anchor length + distance.

    Args:
        q: (n, d) configurations.
        near: (w,) int64 waypoints that may be within reach of some of them, ascending.
        points: (v, d) waypoints of all paths.
        path_of: (v,) int32 path of each waypoint.
        distance: (v,) length from each waypoint to the goal; infinite on filtered paths.
        reach: Longest anchor.
        k: Anchors a configuration.
        metric: Weights and periods of the distance.

    Returns:
        (n, k) int32 waypoints, -1 for none, and (n, k) float64 lengths.
    """
    n = q.shape[0]
    vertices, lengths = np.full((n, k), -1, np.int32), np.full((n, k), np.inf)
    for i in range(n):
        totals = np.full(k, np.inf)
        j = 0
        while j < near.size:
            path = path_of[near[j]]
            best, best_total, best_length = -1, np.inf, np.inf
            while j < near.size and path_of[near[j]] == path:
                v = near[j]
                j += 1
                if distance[v] >= best_total:
                    continue
                length = separation(q[i], points[v], metric)
                if length <= reach and length + distance[v] < best_total:
                    best, best_total, best_length = v, length + distance[v], length
            if best < 0 or best_total >= totals[k - 1]:
                continue
            slot = k - 1
            while slot > 0 and totals[slot - 1] > best_total:
                totals[slot] = totals[slot - 1]
                vertices[i, slot] = vertices[i, slot - 1]
                lengths[i, slot] = lengths[i, slot - 1]
                slot -= 1
            totals[slot], vertices[i, slot], lengths[i, slot] = best_total, best, best_length
    return vertices, lengths


@njit(cache=True)
def over_sights(path: Floats, ahead: int, geometry: Geometry, metric: Metric) -> Floats:
    """The shortest way (m, d) over waypoints of a free path (n, d) that see each other, from end to end.

    Args:
        path: (n, d) waypoints; each sees the next one.
        ahead: How many waypoints ahead one is looked for that a waypoint sees.
        geometry: Robot and environment.
        metric: Weights and periods of the distance.
    """
    n = path.shape[0]
    left, following = np.empty(n), np.empty(n, np.int64)
    left[n - 1], following[n - 1] = 0.0, n - 1
    for i in range(n - 2, -1, -1):
        following[i] = i + 1
        left[i] = separation(path[i], path[i + 1], metric) + left[i + 1]
        for j in range(min(i + ahead, n - 1), i + 1, -1):  # the farthest is mostly the best that is seen
            through = separation(path[i], path[j], metric) + left[j]
            if through < left[i] and motion_free(path[i], path[j], geometry):
                left[i], following[i] = through, j
    out, i, count = np.empty(path.shape), int(ZERO), int(ONE)
    copy_row(path[0], out[0])
    while i < n - 1:
        i = following[i]
        copy_row(path[i], out[count])
        count += 1
    return out[:count]


@njit(cache=True)
def slide(
    path: Floats, directions: Floats, first: float, last: float, geometry: Geometry, metric: Metric
) -> Floats:
    """A free path (n, d) whose inner waypoints have moved where that shortens it: the same number, (n, d).

    Args:
        path: (n, d) waypoints of a free path.
        directions: (m, d) steps of length 1.
        first: How far a waypoint moves at first (length); half as far when none has gained, and so on.
        last: How far at least.
        geometry: Robot and environment.
        metric: Weights and periods of the distance.
    """
    periods = metric[1]
    out, step = path.copy(), first
    poses, lengths = np.empty(directions.shape), np.empty(directions.shape[0])
    while step >= last:
        moved = False
        for i in range(1, path.shape[0] - 1):
            before, after = out[i - 1], out[i + 1]
            most = separation(before, out[i], metric) + separation(out[i], after, metric) - _WORTH * step
            for j in range(lengths.size):
                for a in range(path.shape[1]):
                    poses[j, a] = placed(out[i, a] + step * directions[j, a], periods[a])
                lengths[j] = separation(before, poses[j], metric) + separation(poses[j], after, metric)
            for _ in range(lengths.size):
                j = where_least(lengths)
                if lengths[j] >= most:
                    break
                if motion_free(before, poses[j], geometry) and motion_free(poses[j], after, geometry):
                    copy_row(poses[j], out[i])
                    moved = True
                    break
                lengths[j] = np.inf
        if not moved:
            step *= 0.5
    return out
