"""Features of guiding spaces that take turns, by which a learned rule chooses among them.

The environment ``GuideSelection`` observes these, and a learned rule of `Hybrid` decides by them, so that
what was trained in the one runs in the other. Nothing of the oracle is among them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from enum import IntEnum
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.guidance.base import GuidingSpace
from guided_gym.kernels.metric import separation
from guided_gym.kernels.turns import seen
from guided_gym.search.search import NO_NODE, Expansion, Search


class GuideColumn(IntEnum):
    """Features of a guiding space. Its "favourite" is the node of least h, its choice if undisturbed."""

    CURRENT = 0  # 1 for the one that guided last
    LAST_FAILED = 1  # whether its last expansion failed
    FAILURES = 2  # share of its expansions that failed, the last ones weighing most
    WAITING = 3  # samples since it last guided, log(1 + n) / log(101), at most 1
    USE = 4  # share of all samples that it guided
    REMAINING = 5  # least h of the tree, by that of the root at first, at most 2
    TREND = 6  # by how much that fell lately (h of the root = 1, times 4), -1 to 1
    TRIES = 7  # expansions of its favourite so far, log(1 + n) / log(101), at most 1
    NODE_FAILURES = 8  # failed ones among them, likewise
    CLEARANCE = 9  # of the robot at its favourite, in steps of the local planner, halved, at most 1
    DISTANCE = 10  # from its favourite to the goal, by that from the root, halved, at most 1
    AGREES = 11  # 1 if its favourite is also that of the one that guided last
    AGE = 12  # how long ago its favourite joined the tree, as a share of the nodes


class SearchColumn(IntEnum):
    """Features of the search; these come first."""

    SAMPLES = 0  # samples so far, log(1 + n) / log(1001), at most 1: it tells what is left, too
    GROWTH = 1  # nodes per sample
    FAILED = 2  # whether the last expansion failed
    STREAK = 3  # failures in a row, log(1 + n) / log(101), at most 1
    NEAREST = 4  # distance of the nearest node to the goal, by that of the root, at most 1


COLUMN_NAMES: Final = tuple(f"search.{c.name.lower()}" for c in SearchColumn) + tuple(
    f"guide.{c.name.lower()}" for c in GuideColumn
)
_MEMORY: Final = 0.8  # of the failures: what counts is about the last five
_LAG: Final = 0.9  # of the trend: about the last ten


def observed_size(guides: int) -> int:
    """Length of the feature vector of so many guiding spaces."""
    return len(SearchColumn) + guides * len(GuideColumn)


@cache
def bounds(guides: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Least and largest value of each number."""
    low, high = np.zeros(len(GuideColumn), np.float32), np.ones(len(GuideColumn), np.float32)
    low[GuideColumn.TREND] = -1.0
    high[GuideColumn.REMAINING] = 2.0
    search = np.zeros(len(SearchColumn), np.float32)
    return np.concatenate([search, np.tile(low, guides)]), np.concatenate([search + 1, np.tile(high, guides)])


class Turns:
    """The record of guiding spaces that take turns in one search.

    Args:
        guides: The guiding spaces, prepared for the search.
        search: The search.
    """

    def __init__(self, guides: Sequence[GuidingSpace], search: Search) -> None:
        self._guides, self._search = guides, search
        k = len(guides)
        self._current = 0
        self._last_failed, self._failures = [0.0] * k, [0.0] * k
        self._waiting, self._uses = [0.0] * k, [0.0] * k
        self._record, self._favourites = np.zeros((6, k)), np.zeros(k, np.int64)  # as `seen` takes them
        self._scale, self._lagging = [1.0] * k, [math.nan] * k
        self._bounds = bounds(k)
        self._streak = 0
        self._far = max(float(search.space.distance(search.start, search.goal)), 1e-9)
        self._nearest = 1.0

    def note(self, guide: int, expansion: Expansion) -> None:
        """Record what became of a sample that ``guide`` guided."""
        failed = float(expansion.failed)
        self._current = guide
        self._last_failed[guide] = failed
        self._failures[guide] += (1 - _MEMORY) * (failed - self._failures[guide])
        self._waiting = [samples + 1 for samples in self._waiting]
        self._waiting[guide] = 0.0
        self._uses[guide] += 1
        self._streak = self._streak + 1 if expansion.failed else 0
        if expansion.child != NO_NODE:
            search = self._search
            child = search.tree.nodes.configurations[expansion.child]
            gap = separation(child, search.goal, search.space.metric) / self._far
            self._nearest = min(self._nearest, gap)

    def observe(self) -> NDArray[np.float32]:
        """(5 + 13 k,) the numbers, `SearchColumn` first, then `GuideColumn` of each; once a sample."""
        search, record = self._search, self._record
        last_failed, failures, waiting, uses, remaining, trend = record
        for guide in range(len(self._guides)):
            self._favourites[guide], h = self._favourite(guide)
            before = self._lagging[guide]
            self._lagging[guide] = _LAG * before + (1 - _LAG) * h
            last_failed[guide], failures[guide] = self._last_failed[guide], self._failures[guide]
            waiting[guide], uses[guide] = self._waiting[guide], self._uses[guide]
            remaining[guide], trend[guide] = h, 4 * (before - h)
        nodes = search.tree.nodes
        numbers: NDArray[np.float32] = seen(
            record,
            self._favourites,
            (self._nearest, self._far, search.planner.step),
            (search.samples, len(search.tree), self._streak, self._current),
            (nodes.configurations, nodes.failures, nodes.children),
            search.goal,
            search.space.geometry,
            search.space.metric,
            self._bounds,
        )
        return numbers

    def _favourite(self, guide: int) -> tuple[int, float]:
        """The node of least h, and that h by the root's at first."""
        node, h = self._guides[guide].least(self._search.tree)
        first = math.isnan(self._lagging[guide])
        if first and 0 < h < math.inf:
            self._scale[guide] = h
        h = min(h / self._scale[guide], 2.0)
        if first:
            self._lagging[guide] = h
        return node, h
