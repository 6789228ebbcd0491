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
from guided_gym.kernels.anchors import (
    anchored_values,
    anchored_values_of,
    drop_anchors,
    link_anchors,
    linked_nodes,
)
from guided_gym.structures.shortest_paths import RoadmapGraph, ShortestPathTree

if TYPE_CHECKING:
    from guided_gym.search.tree import SearchTree
    from guided_gym.structures.nearest import GrowingIndex


@dataclass
class Anchors:
    """States of a roadmap's guiding space: how n configurations are joined to it, by up to k anchors each."""

    vertices: NDArray[np.int32]  # [n, k] roadmap vertex, -1 for none
    lengths: NDArray[np.float64]  # [n, k] length of the anchor, inf once it is dropped
    edges: NDArray[np.int32]  # [n, k] roadmap edge that the anchor runs along, -1 for none

    def __len__(self) -> int:
        return len(self.vertices)


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
        self._changed: list[NDArray[np.integer[Any]]] = []

    @property
    def distance(self) -> NDArray[np.float64]:
        """(v,) length of the shortest path from each vertex to the goal; infinite if there is none."""
        return self.tree.distance

    def lengthen(self, edges: NDArray[np.int32], share: float) -> None:
        """Add a share of its length to the weight of some edges."""
        self.multipliers[edges] += share
        self.tree.raise_weights(edges, self.lengths[edges] * self.multipliers[edges])
        self._changed += [self.tree.changed.copy(), self.edges[edges].ravel()]

    def remove(self, edges: NDArray[np.int32]) -> None:
        """Remove some edges."""
        self.multipliers[edges] = np.inf
        self.tree.remove_edges(edges)
        self._changed.append(self.tree.changed.copy())

    def remove_vertices(self, vertices: NDArray[np.int64]) -> None:
        """Remove some vertices with all their edges."""
        indptr, edge_of = self._graph.indptr, self._graph.edge_of
        self.remove(np.concatenate([edge_of[indptr[v] : indptr[v + 1]] for v in vertices]))

    def take_changes(self) -> NDArray[np.int64]:
        """Vertices whose distance, or the weight of one of whose edges, has changed since the last call."""
        changes = np.concatenate(self._changed).astype(np.int64) if self._changed else np.zeros(0, np.int64)
        self._changed = []
        return changes

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
        super().forget()
        self._anchored: AnchoredNodes | None = None

    def project(self, tree: SearchTree, q: NDArray[np.float64]) -> Anchors:  # type: ignore[override]
        """P_T: the anchors that join each configuration to the roadmap."""
        return self.anchor(np.ascontiguousarray(q))

    def heuristic(self, states: Anchors) -> NDArray[np.float64]:  # type: ignore[override]
        """h: length of the shortest path to the goal on the roadmap as it stands."""
        return anchored_values(
            states.vertices,
            states.lengths,
            states.edges,
            self.roadmap.multipliers,
            self.roadmap.distance,
            len(states),
        )

    def evaluate(self, tree: SearchTree, first: int, last: int) -> NDArray[np.float64]:
        """(last - first,) h of the nodes that have come since; their anchors are kept."""
        fresh = self.project(tree, tree.nodes.configurations[first:last])
        if self._anchored is None:
            self.roadmap.take_changes()
            self._anchored = AnchoredNodes(fresh, len(self.roadmap.points))
        else:
            self._anchored.append(fresh)
        return self.heuristic(fresh)

    def anchors(self, tree: SearchTree) -> Anchors:
        """The anchors of all nodes of the tree; at least ``len(tree)`` rows."""
        self.values(tree)
        assert self._anchored is not None
        return self._anchored.anchors

    def values(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) h of each node, the penalty for its expansions so far included."""
        if self._anchored is not None:
            rows = self._anchored.affected(self.roadmap.take_changes())
            if rows.size:
                self._values.change(tree, rows, self._values_at(rows))
        return super().values(tree)

    def _values_at(self, rows: NDArray[np.int64]) -> NDArray[np.float64]:
        assert self._anchored is not None
        a = self._anchored.anchors
        return anchored_values_of(
            rows, a.vertices, a.lengths, a.edges, self.roadmap.multipliers, self.roadmap.distance
        )

    def drop_near(self, tree: SearchTree, contact: NDArray[np.float64], radius: float) -> None:
        """Drop the nodes' anchors that pass within ``radius`` of a colliding configuration."""
        nodes = self._anchored
        if nodes is None:
            return
        rows = tree.index.within(contact, radius + nodes.longest)
        rows = rows[rows < len(nodes)]
        drop_anchors(
            tree.nodes.configurations, rows, nodes.anchors.vertices, nodes.anchors.lengths,
            self.roadmap.points, contact[None], radius, self.space.metric,
        )  # fmt: skip
        nodes.stale(rows)

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


class AnchoredNodes:
    """The anchors of a growing tree's nodes, and for each roadmap vertex the nodes that are anchored to it.

    The lists tell which nodes a change of the roadmap concerns, so that it costs what it changes and not
    what the tree holds.
    """

    def __init__(self, first: Anchors, roadmap_vertices: int) -> None:
        self.anchors = Anchors(first.vertices[:0], first.lengths[:0], first.edges[:0])
        self.longest = 0.0  # upper bound of the finite lengths
        self._n = 0
        self._head = np.full(roadmap_vertices, -1, np.int32)
        self._node_of = np.zeros(0, np.int32)
        self._following = np.zeros(0, np.int32)
        self._links = 0
        self._stale: list[NDArray[np.int64]] = []
        self.append(first)

    def __len__(self) -> int:
        return self._n

    def append(self, fresh: Anchors) -> None:
        """Take in the anchors of the next nodes."""
        first, last = self._n, self._n + len(fresh)
        if last > len(self.anchors):
            a = self.anchors
            self.anchors = Anchors(*(_grown(x, 2 * last) for x in (a.vertices, a.lengths, a.edges)))
        self._n = last
        self.replace(np.arange(first, last), fresh, contiguous=True)

    def replace(self, rows: NDArray[np.int64], fresh: Anchors, contiguous: bool = False) -> None:
        """Give some nodes other anchors."""
        a = self.anchors
        where = slice(rows[0], rows[-1] + 1) if contiguous else rows
        a.vertices[where], a.lengths[where], a.edges[where] = fresh.vertices, fresh.lengths, fresh.edges
        finite = fresh.lengths[np.isfinite(fresh.lengths)]
        if finite.size:
            self.longest = max(self.longest, float(finite.max()))
        needed = self._links + fresh.vertices.size
        if needed > self._node_of.size:
            self._node_of, self._following = (_grown(x, 2 * needed) for x in (self._node_of, self._following))
        spans = [(int(rows[0]), int(rows[-1]) + 1)] if contiguous else [(int(i), int(i) + 1) for i in rows]
        for first, last in spans:
            self._links = link_anchors(
                a.vertices, first, last, self._head, self._node_of, self._following, self._links
            )

    def stale(self, rows: NDArray[np.int64]) -> None:
        """Note that h of these nodes has to be computed anew."""
        self._stale.append(rows)

    def affected(self, vertices: NDArray[np.int64]) -> NDArray[np.int64]:
        """Nodes whose h has to be computed anew: anchored to one of the vertices, or stale."""
        rows = self._stale
        self._stale = []
        if vertices.size:
            rows.append(linked_nodes(vertices, self._head, self._node_of, self._following, self._n))
        return np.concatenate(rows) if rows else np.zeros(0, np.int64)


def _grown(array: NDArray[Any], rows: int) -> NDArray[Any]:
    out = np.zeros((rows, *array.shape[1:]), array.dtype)
    out[: len(array)] = array
    return out
