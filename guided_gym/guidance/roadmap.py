"""Guidance by a roadmap: h is the length of the shortest path to the goal on a graph in some guiding space.

PRM, LazyPRM, the medial axis and the path database are this one mechanism with different parts: which space
the roadmap lives in (a robot modification), where its vertices and edges come from (an environment
modification, or experience), and what a failed expansion takes away from it.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from guided_gym.guidance.base import GuidingSpace
from guided_gym.kernels.anchors import anchored_values, drop_anchors
from guided_gym.kernels.shortest_paths import RoadmapGraph, ShortestPathTree

if TYPE_CHECKING:
    from guided_gym.kernels.nearest import GrowingIndex
    from guided_gym.tree import SearchTree


@dataclass
class Anchors:
    """States of a roadmap's guiding space: how n configurations are joined to it, by up to k anchors each."""

    vertices: NDArray[np.int32]  # [n, k] roadmap vertex, -1 for none
    lengths: NDArray[np.float64]  # [n, k] length of the anchor, inf once it is dropped
    edges: NDArray[np.int32]  # [n, k] roadmap edge that the anchor runs along, -1 for none

    def __len__(self) -> int:
        return len(self.vertices)

    def grown(self, rows: int) -> Anchors:
        """A copy with room for that many rows."""
        return Anchors(*(_grown(a, rows) for a in (self.vertices, self.lengths, self.edges)))


def _grown(array: NDArray[Any], rows: int) -> NDArray[Any]:
    out = np.zeros((rows, *array.shape[1:]), array.dtype)
    out[: len(array)] = array
    return out


class Roadmap:
    """A weighted graph in a guiding space, with the shortest-path tree to its goal vertex.

    Attributes:
        points: (v, d') vertices, in the coordinates of the guiding space.
        edges: (m, 2) int32 vertex pairs.
        lengths: (m,) length of each edge.
        multipliers: (m,) factor on each length; infinite once an edge is removed.
        tree: Shortest paths to the goal vertex, repaired as edges get longer.
        goal: Index of the goal vertex.
    """

    def __init__(self, points: NDArray[np.float64], graph: RoadmapGraph, goal: int) -> None:
        self.points, self.edges, self.lengths, self.goal = points, graph.edges, graph.lengths, goal
        self._graph = graph
        self.multipliers = np.ones(len(graph.edges))
        self.tree = ShortestPathTree.of(graph, goal)

    @property
    def distance(self) -> NDArray[np.float64]:
        """(v,) length of the shortest path from each vertex to the goal; infinite if there is none."""
        return self.tree.distance

    def lengthen(self, edges: NDArray[np.int32], share: float) -> None:
        """Add a share of its length to the weight of some edges."""
        self.multipliers[edges] += share
        self.tree.raise_weights(edges, self.lengths[edges] * self.multipliers[edges])

    def remove(self, edges: NDArray[np.int32]) -> None:
        """Remove some edges."""
        self.multipliers[edges] = np.inf
        self.tree.remove_edges(edges)

    def remove_vertices(self, vertices: NDArray[np.int64]) -> None:
        """Remove some vertices with all their edges."""
        indptr, edge_of = self._graph.indptr, self._graph.edge_of
        self.remove(np.concatenate([edge_of[indptr[v] : indptr[v + 1]] for v in vertices]))

    def graph(self) -> nx.Graph:
        """The roadmap as it stands, as a networkx graph: ``pos`` per vertex, ``weight`` per edge."""
        graph = nx.Graph()
        graph.add_nodes_from((i, {"pos": tuple(p)}) for i, p in enumerate(self.points.tolist()))
        for (a, b), length, factor in zip(self.edges.tolist(), self.lengths, self.multipliers, strict=True):
            if np.isfinite(factor):
                graph.add_edge(a, b, weight=float(length * factor))
        return graph


class RoadmapGuidance(GuidingSpace):
    """A guiding space whose heuristic is the shortest-path length on a roadmap.

    A subclass writes `build` (the roadmap), `anchor` (how configurations project onto it) and usually
    `feedback` (what a failure takes away).
    """

    roadmap: Roadmap

    def prepare(self) -> None:
        """Build the roadmap."""
        self.roadmap = self.build()
        self.forget()

    @abstractmethod
    def build(self) -> Roadmap:
        """The roadmap for ``self.search``."""

    @abstractmethod
    def anchor(self, q: NDArray[np.float64]) -> Anchors:
        """Join (n, d) configurations to the roadmap."""

    def forget(self) -> None:
        """Project all nodes anew."""
        self._anchors: Anchors | None = None
        self._anchored = 0

    def project(self, tree: SearchTree, q: NDArray[np.float64]) -> Anchors:  # type: ignore[override]
        """P_T: the anchors that join each configuration to the roadmap."""
        return self.anchor(np.ascontiguousarray(q))

    def heuristic(self, states: Anchors) -> NDArray[np.float64]:  # type: ignore[override]
        """h: length of the shortest path to the goal on the roadmap as it stands."""
        return self._values_of(states, len(states))

    def _values_of(self, states: Anchors, n: int) -> NDArray[np.float64]:
        return anchored_values(
            states.vertices, states.lengths, states.edges, self.roadmap.multipliers, self.roadmap.distance, n
        )

    def anchors(self, tree: SearchTree) -> Anchors:
        """The anchors of all nodes of the tree; at least ``len(tree)`` rows."""
        n = len(tree)
        if self._anchored < n or self._anchors is None:
            fresh = self.project(tree, tree._configurations[self._anchored : n])
            held = (
                self._anchors.grown(2 * n) if self._anchors is not None and n > len(self._anchors) else None
            )
            if self._anchors is None:
                held = fresh.grown(2 * n)
            if held is not None:
                self._anchors = held
            assert self._anchors is not None
            for name in ("vertices", "lengths", "edges"):
                getattr(self._anchors, name)[self._anchored : n] = getattr(fresh, name)
            self._anchored = n
        return self._anchors

    def values(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) h of each node, the penalty for its expansions so far included."""
        h = self._values_of(self.anchors(tree), len(tree))
        if self.expansion_penalty:
            h += (self.expansion_penalty * self.planner.step) * (tree.failures + tree.children)
        return h

    def drop_near(self, tree: SearchTree, contacts: NDArray[np.float64], radius: float) -> None:
        """Drop the nodes' anchors that pass within ``radius`` of the colliding configurations (f, d)."""
        if self._anchors is not None:
            drop_anchors(
                tree._configurations,
                self._anchored,
                self._anchors.vertices,
                self._anchors.lengths,
                self.roadmap.points,
                contacts,
                radius,
                self.space.weights,
                self.space.periods,
            )

    def invalid_near(
        self, index: GrowingIndex, contact: NDArray[np.float64], reach: float
    ) -> NDArray[np.int64]:
        """Roadmap vertices within ``reach`` of a colliding configuration that are in collision too.

        A collision is the occasion to look at what was left unvalidated around it.
        """
        near = index.within(contact, reach)
        near = near[np.isfinite(self.roadmap.distance[near])]
        if near.size == 0:
            return near
        self.search.collision_checks += near.size
        return near[~self.space.valid(self.roadmap.points[near])]

    def drawing(self) -> dict[str, NDArray[Any]]:
        """What a figure shows.

        ``points`` (v, 2) with their h as ``values`` (v,); ``edges`` (m, 2), ``alive`` (m,), ``weights`` (m,).
        """
        factor = self.roadmap.multipliers
        return {
            "points": self.roadmap.points[:, :2],
            "values": self.roadmap.distance,
            "edges": self.roadmap.edges,
            "alive": np.isfinite(factor),
            "weights": np.where(np.isfinite(factor), factor, 1.0),
        }
