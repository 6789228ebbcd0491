"""What guiding spaces are asked at every sample: their totals over the nodes, and what is seen of them."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.collision import Geometry, pose_clearance
from guided_gym.kernels.metric import Metric, separation
from guided_gym.kernels.plain import borrowing

Floats = NDArray[np.float64]
Int32s = NDArray[np.int32]

_MEMORY: Final = 0.8  # of the failures: what counts is about the last five
_LAG: Final = 0.9  # of the trend: about the last ten


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


class Record(NamedTuple):
    """What is kept of guiding spaces that take turns.

    Attributes:
        shares: (6, k) of each: whether its last expansion failed, its share of failures, its samples of
            waiting and of use, the least h of its nodes by that of the root, and its trend.
        scale: (k,) h of the root.
        lagging: (k,) the least h by that of the root as it was lately; NaN before the first.
        search: (2,) nearest distance of a node to the goal by the root's, and failures in a row.
    """

    shares: Floats
    scale: Floats
    lagging: Floats
    search: Floats


@borrowing
def noted(
    record: Record,
    news: tuple[int, int, int],
    configurations: Floats,
    goal: Floats,
    far: float,
    metric: Metric,
) -> None:
    """Take in what became of a sample: who guided, whether it failed, and the new node (or none, < 0)."""
    guide, failed, child = news
    shares = record.shares
    shares[0, guide] = failed
    shares[1, guide] += (1 - _MEMORY) * (failed - shares[1, guide])
    for i in range(shares.shape[1]):
        shares[2, i] += 1.0
    shares[2, guide] = 0.0
    shares[3, guide] += 1.0
    record.search[1] = record.search[1] + 1.0 if failed else 0.0
    if child >= 0:
        gap = separation(configurations[child], goal, metric) / far
        record.search[0] = min(record.search[0], gap)


@borrowing
def _compare(record: Record, latest: Floats) -> None:
    """Take in the least h of each guiding space: by that of the root at first, and how it has changed."""
    for i in range(latest.size):
        h, first = latest[i], np.isnan(record.lagging[i])
        if first and 0 < h < np.inf:
            record.scale[i] = h
        h = min(h / record.scale[i], 2.0)
        before = h if first else record.lagging[i]
        record.lagging[i] = _LAG * before + (1 - _LAG) * h
        record.shares[4, i], record.shares[5, i] = h, 4 * (before - h)


@njit(cache=True)
def seen(
    record: Record,
    news: tuple[int, int, int],
    favourites: tuple[NDArray[np.int64], Floats],
    search: tuple[float, float],
    counts: tuple[int, int, int],
    nodes: tuple[Floats, Int32s, Int32s],
    goal: Floats,
    geometry: Geometry,
    metric: Metric,
    bounds: tuple[NDArray[np.float32], NDArray[np.float32]],
) -> NDArray[np.float32]:
    """The numbers of `guided_gym.guidance.learned.turns`, in the order of their columns.

    Args:
        record: What is kept of the guiding spaces; brought up to date.
        news: What became of the last sample, see `noted`; who guided is < 0 if that is known.
        favourites: (k,) node of least h of each, and (k,) that h.
        search: Distance of the root to the goal, step (length).
        counts: Samples, nodes, who guided last.
        nodes: Configurations, failures and children of the tree's nodes.
        goal: (d,) goal.
        geometry: Of the robot.
        metric: Weights and periods of the distance.
        bounds: Least and largest value of each number.
    """
    far, step = search
    samples, size, current = counts
    if news[0] >= 0:
        noted(record, news, nodes[0], goal, far, metric)
    favourite, shares = favourites[0], record.shares
    _compare(record, favourites[1])
    nearest, streak = record.search[0], record.search[1]
    hundred, k = np.log(101.0), favourite.size
    columns = 13
    out = np.zeros(5 + columns * k)
    out[0] = np.log1p(samples) / np.log(1001.0)
    out[1] = (size - 1) / max(samples, 1)
    out[2] = 1.0 if streak > 0 else 0.0
    out[3] = np.log1p(streak) / hundred
    out[4] = nearest
    for i in range(k):
        row, node = out[5 + columns * i : 5 + columns * (i + 1)], favourite[i]
        q, failures = nodes[0][node], nodes[1][node]
        row[0] = 1.0 if i == current and samples > 0 else 0.0
        row[1], row[2] = shares[0, i], shares[1, i]
        row[3] = np.log1p(shares[2, i]) / hundred
        row[4] = shares[3, i] / max(samples, 1)
        row[5], row[6] = shares[4, i], shares[5, i]
        row[7] = np.log1p(failures + nodes[2][node]) / hundred
        row[8] = np.log1p(failures) / hundred
        row[9] = pose_clearance(q, geometry) / step / 2.0
        row[10] = separation(q, goal, metric) / far / 2.0
        row[11] = 1.0 if node == favourite[current] else 0.0
        row[12] = 1.0 - node / max(size - 1, 1)
    numbers = out.astype(np.float32)
    for j in range(numbers.size):
        numbers[j] = min(max(numbers[j], bounds[0][j]), bounds[1][j])
    return numbers
