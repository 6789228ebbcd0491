"""Roadmaps whose edges are believed to be free, and checked only along ways that are about to be taken."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.guidance.solvers.base import Doubts, Floats
from guided_gym.guidance.solvers.graph import Anchors, Graph
from guided_gym.kernels.belief import way_edges

_TOGETHER: Final = 64  # edges of a way that are asked about at once


class DoubtedGraph:
    """A graph whose edges count as free until a way along them is the shortest: then they are asked about.

    Once the doubts are ``checking``, what a way is known to take is asked about a second time: whether it is
    ``refuted``.

    Args:
        graph: The graph; its edges get longer, or are removed.
        doubts: Who is asked.
    """

    def __init__(self, graph: Graph, doubts: Doubts) -> None:
        self.graph, self.doubts = graph, doubts
        self._known, self._checked = np.zeros((2, len(graph.edges)), np.bool_)

    @property
    def checking(self) -> bool:
        """Whether the doubts have motions checked."""
        return bool(getattr(self.doubts, "checking", False))

    def look_along(self, vertex: int) -> bool:
        """Ask about the way from a vertex to the goal; returns whether there was anything to ask."""
        tree = self.graph.tree
        edges = way_edges(vertex, tree.parent, tree.parent_edge, self._known, _TOGETHER)
        if not edges.size:
            return self.checking and self._check_along(vertex)
        self._known[edges] = True
        ends = self.graph.points[self.graph.edges[edges]]
        factors = self.doubts.factors(ends[:, 0], ends[:, 1])
        self.graph.raise_edges(edges[np.isinf(factors)], math.inf)
        longer = (factors > 1.0) & np.isfinite(factors)
        self.graph.raise_edges(edges[longer], factors[longer])
        return True

    def _check_along(self, vertex: int) -> bool:
        """Have the way from a vertex checked; returns whether there was anything to check."""
        tree = self.graph.tree
        edges = way_edges(vertex, tree.parent, tree.parent_edge, self._checked, _TOGETHER)
        if edges.size:
            self._checked[edges] = True
            ends = self.graph.points[self.graph.edges[edges]]
            refuted: NDArray[np.bool_] = self.doubts.refuted(ends[:, 0], ends[:, 1])  # type: ignore[attr-defined]
            self.graph.raise_edges(edges[refuted], math.inf)
        return bool(edges.size)

    def look_from(self, states: Floats, anchors: Anchors, known: NDArray[np.int8], row: int) -> bool:
        """Ask about the shortest way from one of some states; returns whether there was anything to ask.

        Args:
            states: (n, d') the states.
            anchors: How they are joined to the graph; their lengths are changed in place.
            known: (n, k) how often anchors have been asked about, changed in place.
            row: Which state.
        """
        vertices = anchors.vertices[row]
        best = int(np.argmin(anchors.lengths[row] + self.graph.distance[vertices]))
        vertex = int(vertices[best])
        if known[row, best] < 1 + self.checking:
            ends = states[row][None], self.graph.points[vertex][None]
            if known[row, best] == 0:
                anchors.lengths[row, best] *= self.doubts.factors(*ends)[0]
            elif self.doubts.refuted(*ends)[0]:  # type: ignore[attr-defined]
                anchors.lengths[row, best] = math.inf
            known[row, best] += 1
            return True
        return self.look_along(vertex)

    def nearest(self, states: Floats, anchors: Anchors) -> tuple[int, float]:
        """Index of the state with the shortest known way to the goal, all of which has been asked about."""
        known = np.zeros(anchors.vertices.shape, np.int8)
        while True:
            ways = (anchors.lengths + self.graph.distance[anchors.vertices]).min(axis=1)
            row = int(np.argmin(ways))
            if not math.isfinite(ways[row]) or not self.look_from(states, anchors, known, row):
                return row, float(ways[row])
