"""Anchors from configurations to stored paths: per path, the waypoint with the least length to the goal."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.metric import Metric, separation

Floats = NDArray[np.float64]
Int32s = NDArray[np.int32]
Ints = NDArray[np.int64]


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
