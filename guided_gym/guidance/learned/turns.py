"""Features of guiding spaces that take turns, by which a learned rule chooses among them.

The environment ``GuideSelection`` observes these, and a learned rule of `Hybrid` decides by them, so that
what was trained in the one runs in the other. Nothing of the oracle is among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.guidance.base import GuidingSpace
from guided_gym.kernels.turns import Record, noted, seen
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
_NOTHING: Final = -1, 0, NO_NODE  # has been noted since the last observation


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
        self._record = Record(np.zeros((6, k)), np.ones(k), np.full(k, np.nan), np.array([1.0, 0.0]))
        self._news = _NOTHING
        self._latest, self._favourites = np.zeros(k), np.zeros(k, np.int64)
        self._bounds = bounds(k)
        self._far = max(float(search.space.distance(search.start, search.goal)), 1e-9)

    def note(self, guide: int, expansion: Expansion) -> None:
        """Record what became of a sample that ``guide`` guided."""
        if self._news is not _NOTHING:
            nodes, goal, metric = self._search.tree.nodes, self._search.goal, self._search.space.metric
            noted(self._record, self._news, nodes.configurations, goal, self._far, metric)
        self._current = guide
        self._news = guide, int(expansion.failed), expansion.child

    def observe(self) -> NDArray[np.float32]:
        """(5 + 13 k,) the numbers, `SearchColumn` first, then `GuideColumn` of each; once a sample."""
        search, latest, favourites = self._search, self._latest, self._favourites
        tree = search.tree
        for i, guide in enumerate(self._guides):
            favourites[i], latest[i] = guide.least(tree)
        nodes, news = tree.nodes, self._news
        self._news = _NOTHING
        numbers: NDArray[np.float32] = seen(
            self._record,
            news,
            (favourites, latest),
            (self._far, search.planner.step),
            (search.samples, len(tree), self._current),
            (nodes.configurations, nodes.failures, nodes.children),
            search.goal,
            search.space.geometry,
            search.space.metric,
            self._bounds,
        )
        return numbers
