"""What guiding spaces are asked at every sample: their totals over the nodes, and what is seen of them."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.collision import Geometry, pose_clearance
from guided_gym.kernels.metric import Metric, separation
from guided_gym.kernels.plain import borrowing

Floats = NDArray[np.float64]
Int32s = NDArray[np.int32]


@njit(cache=True)
def charged(h: Floats, failures: Int32s, children: Int32s, penalty: float) -> Floats:
    """(n,) h of each node, and ``penalty`` for each of its expansions.

    Args:
        h: (n,) cost-to-go.
        failures: (>= n,) int32 failed expansions.
        children: (>= n,) int32 successful ones.
        penalty: What each adds.
    """
    out = np.empty(h.size)
    for i in range(h.size):
        out[i] = h[i] + penalty * (failures[i] + children[i])
    return out


@borrowing
def least_charged(h: Floats, failures: Int32s, children: Int32s, penalty: float) -> tuple[int, float]:
    """The node of the least `charged` value, the first of equals, and that value; h has one at least."""
    node, least = 0, h[0] + penalty * (failures[0] + children[0])
    for i in range(1, h.size):
        total = h[i] + penalty * (failures[i] + children[i])
        if total < least:
            node, least = i, total
    return node, least


@njit(cache=True)
def seen(
    record: Floats,
    favourites: NDArray[np.int64],
    search: tuple[float, float, float],
    counts: tuple[int, int, int, int],
    nodes: tuple[Floats, Int32s, Int32s],
    goal: Floats,
    geometry: Geometry,
    metric: Metric,
    bounds: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> NDArray[np.float32]:
    """The numbers of `guided_gym.guidance.learned.turns`, in the order of their columns.

    Args:
        record: (6, k) of each guiding space: whether its last expansion failed, its share of failures, its
            samples of waiting and of use, the least h of its nodes by that of the root, and its trend.
        favourites: (k,) int64 node of least h of each.
        search: Nearest distance to the goal by the root's, that of the root (length), step (length).
        counts: Samples, nodes, failures in a row, who guided last.
        nodes: Configurations, failures and children of the tree's nodes.
        goal: (d,) goal.
        geometry: Of the robot.
        metric: Weights and periods of the distance.
        bounds: Least and largest value of each number.
    """
    nearest, far, step = search
    samples, size, streak, current = counts
    hundred, k = np.log(101.0), favourites.size
    columns = 13
    out = np.zeros(5 + columns * k)
    out[0] = np.log1p(samples) / np.log(1001.0)
    out[1] = (size - 1) / max(samples, 1)
    out[2] = 1.0 if streak > 0 else 0.0
    out[3] = np.log1p(streak) / hundred
    out[4] = nearest
    for i in range(k):
        row, node = out[5 + columns * i : 5 + columns * (i + 1)], favourites[i]
        q, failures = nodes[0][node], nodes[1][node]
        row[0] = 1.0 if i == current and samples > 0 else 0.0
        row[1], row[2] = record[0, i], record[1, i]
        row[3] = np.log1p(record[2, i]) / hundred
        row[4] = record[3, i] / max(samples, 1)
        row[5], row[6] = record[4, i], record[5, i]
        row[7] = np.log1p(failures + nodes[2][node]) / hundred
        row[8] = np.log1p(failures) / hundred
        row[9] = pose_clearance(q, geometry) / step / 2.0
        row[10] = separation(q, goal, metric) / far / 2.0
        row[11] = 1.0 if node == favourites[current] else 0.0
        row[12] = 1.0 - node / max(size - 1, 1)
    numbers = out.astype(np.float32)
    for j in range(numbers.size):
        numbers[j] = min(max(numbers[j], bounds[0][j]), bounds[1][j])
    return numbers
