"""Cost-to-go on a graph in a guiding space: shared by roadmaps, skeletons, stored paths and search trees.

States are joined to the graph by anchors. A failure lengthens or removes what passes near it, anchors
included: the connection of a node to the graph is as unvalidated as the graph itself.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.guidance.solvers.base import Floats, Query, Valid
from guided_gym.guidance.subspace import Subspace
from guided_gym.kernels.anchors import anchored_values_of, charge_anchors, enter_anchors, linked_nodes
from guided_gym.kernels.metric import Metric
from guided_gym.structures.nearest import GrowingIndex
from guided_gym.structures.segments import SegmentIndex
from guided_gym.structures.shortest_paths import RoadmapGraph, ShortestPathTree

if TYPE_CHECKING:
    import networkx as nx

Int32s = NDArray[np.int32]
Ints = NDArray[np.int64]

_NONE: Final = np.zeros(0, np.int64)


@dataclass
class Anchors:
    """How n states are joined to a graph, by up to k anchors each."""

    vertices: Int32s  # [n, k] vertex, -1 for none
    lengths: Floats  # [n, k] length of the anchor, inf once it is dropped
    edges: Int32s  # [n, k] edge that the anchor runs along, -1 for none

    def __len__(self) -> int:
        return len(self.vertices)


class Graph:
    """A weighted graph in a guiding space, with the shortest-path tree to its goal vertex.

    Attributes:
        points: (v, d') vertices.
        edges: (m, 2) int32 vertex pairs.
        lengths: (m,) length of each edge.
        multipliers: (m,) factor on each length; infinite once an edge is removed.
        tree: Shortest paths to the goal vertex, repaired as edges get longer.
        goal: Index of the goal vertex.
    """

    def __init__(self, points: Floats, graph: RoadmapGraph, goal: int) -> None:
        self.points, self.edges, self.lengths, self.goal = points, graph.edges, graph.lengths, goal
        self._graph = graph
        self.multipliers = np.ones(len(graph.edges))
        self.tree = ShortestPathTree.of(graph, goal)
        self._changed: list[NDArray[np.integer[Any]]] = []
        self._removed: list[NDArray[np.int64]] = []  # edges, not taken out of the tree yet

    @property
    def distance(self) -> Floats:
        """(v,) length of the shortest path from each vertex to the goal; infinite if there is none."""
        self._settle()
        return self.tree.distance

    def _settle(self) -> None:
        """Repair the tree once for all edges removed since."""
        if self._removed:
            self.tree.remove_edges(np.concatenate(self._removed))
            self._removed = []
            self._changed.append(self.tree.changed.copy())

    def raise_edges(self, edges: NDArray[np.integer[Any]], factor: float | Floats) -> None:
        """Add ``factor - 1`` times its length to the weight of some edges; infinite removes them.

        Factors of their own, (k,), have to be finite.
        """
        raised: Ints = np.asarray(edges, np.int64)
        if raised.size == 0:
            return
        if isinstance(factor, float) and factor == math.inf:
            self.multipliers[raised] = np.inf
            self._removed.append(raised)
        else:
            self._settle()
            self.multipliers[raised] += factor - 1.0
            self.tree.raise_weights(raised, self.lengths[raised] * self.multipliers[raised])
            # Anchors run along them, too.
            self._changed += [self.edges[raised].ravel(), self.tree.changed.copy()]

    def remove_vertices(self, vertices: NDArray[np.int64]) -> None:
        """Remove some vertices with all their edges."""
        indptr, edge_of = self._graph.indptr, self._graph.edge_of
        self.raise_edges(np.concatenate([edge_of[indptr[v] : indptr[v + 1]] for v in vertices]), np.inf)

    @property
    def touched(self) -> bool:
        """Whether any distance may have changed since the last call of `take_changes`."""
        return bool(self._changed or self._removed)

    def take_changes(self) -> NDArray[np.int64]:
        """Vertices whose distance, or the weight of one of whose edges, has changed since the last call."""
        self._settle()
        if not self._changed:
            return _NONE
        changes = np.concatenate(self._changed).astype(np.int64)
        self._changed = []
        return changes

    def as_networkx(self) -> nx.Graph:
        """The graph as it stands: ``pos`` per vertex, ``weight`` per edge."""
        import networkx as nx  # here: it takes .1 s to load, and no search needs it

        graph = nx.Graph()
        graph.add_nodes_from((i, {"pos": tuple(p)}) for i, p in enumerate(self.points.tolist()))
        for (a, b), length, factor in zip(self.edges.tolist(), self.lengths, self.multipliers, strict=True):
            if np.isfinite(factor):
                graph.add_edge(a, b, weight=float(length * factor))
        return graph


class GraphCostToGo(ABC):
    """A solver whose cost-to-go is the length of the shortest path on a graph.

    No state has a way where the goal is in collision. A subclass writes `build` (the graph) and `anchor` (how
    states are joined to it), and may write `joined` (how nodes are, where that is another thing).
    """

    graph: Graph

    def begin(self, query: Query, rng: np.random.Generator, step: float) -> None:
        """Build the graph for a query."""
        self.query, self.rng, self.step = query, rng, step
        self.looks = 0
        self.taught = Taught(query.space.metric)
        # Where nothing is an obstacle nothing is looked at, not even the goal.
        seen = bool(query.space.environment.obstacles)
        self._open = not seen or bool(query.space.valid(query.goal))
        self._inspections: list[tuple[Floats, float, Valid]] = []
        self._restart()

    def _restart(self) -> None:
        self.graph = self.build()
        self._nodes: AnchoredStates | None = None
        self._h = np.zeros(256)
        self._segments: SegmentIndex | None = None
        self._inspected = np.zeros(len(self.graph.points), np.bool_)

    def _renew(self, share: float) -> None:
        """Build another graph, and teach it within ``share`` of its reach what the last one was taught."""
        lessons, inspections = self.taught, self._inspections
        self.taught, self._inspections = Taught(self.query.space.metric), []
        self._restart()
        for state, reach, factor in zip(*lessons.arrays, strict=True):
            self.raise_near(state, share * reach, factor)
        for state, reach, valid in inspections:
            self.inspect(state, reach, valid)

    @abstractmethod
    def build(self) -> Graph:
        """The graph for ``self.query``."""

    @abstractmethod
    def anchor(self, states: Floats) -> Anchors:
        """Join (n, d') states to the graph."""

    def joined(self, states: Floats) -> Anchors:
        """Join the nodes of a tree to the graph: as any states, unless a subclass takes more care."""
        anchors = self.anchor(states)
        self._charge(states, anchors)
        return anchors

    def __call__(self, states: Floats) -> Floats:
        """(n, d') states to (n,) the length of the shortest path to the goal on the graph as it stands."""
        anchors = self.anchor(np.ascontiguousarray(states))
        self._charge(states, anchors)
        return self._values(anchors, np.arange(len(anchors)))

    def follow(self, states: Floats) -> Floats:
        """(n,) cost-to-go of the nodes of a growing tree; costs what changes, not what the tree holds."""
        n = len(states)
        if n > self._h.size:
            self._h = np.resize(self._h, 2 * n)
        if self._nodes is None:
            self.graph.take_changes()
            self._nodes = AnchoredStates(self.query, len(self.graph.points))
        nodes, first = self._nodes, len(self._nodes)
        if self.graph.touched or nodes.stale:
            changed = nodes.affected(self.graph.take_changes())
            if changed.size:
                self._h[changed] = self._values(nodes.anchors, changed)
        if n > first:
            fresh = np.ascontiguousarray(states[first:n])
            nodes.append(fresh, self.joined(fresh))
            self._h[first:n] = self._values(nodes.anchors, np.arange(first, n))
        known = self._h[:n]
        known.flags.writeable = False
        return known

    def raise_near(self, state: Floats, reach: float, factor: float) -> None:
        """Lengthen, or remove, the edges and anchors that pass within ``reach`` of a state."""
        self.taught.add(state, reach, factor)
        self._teach(state, reach, factor)

    def _teach(self, state: Floats, reach: float, factor: float) -> None:
        self.graph.raise_edges(self.edges_near(state, reach), factor)
        if self._nodes is not None:
            self._nodes.charge(state, reach, factor, self.graph.points)

    def edges_near(self, state: Floats, reach: float) -> NDArray[np.int64]:
        """Edges that pass within ``reach`` of a state."""
        if self._segments is None:
            self._segments = SegmentIndex(self.graph.points, self.graph.edges, self.query.space.metric)
        return self._segments.within(state, reach)

    def inspect(self, state: Floats, reach: float, valid: Valid) -> None:
        """Remove the vertices within ``reach`` of a state that are not valid: a failure is the occasion."""
        self._inspections.append((state, reach, valid))
        near = self.vertices_near(state, reach)
        near = near[~self._inspected[near]]
        if near.size:
            self._inspected[near] = True
            self._discard(near[~valid(self.graph.points[near])])

    def _discard(self, vertices: Ints) -> None:
        """Take invalid vertices out of the graph."""
        if vertices.size:
            self.graph.remove_vertices(vertices)

    @abstractmethod
    def vertices_near(self, state: Floats, reach: float) -> NDArray[np.int64]:
        """Vertices within ``reach`` of a state."""

    def _charge(self, states: Floats, anchors: Anchors) -> None:
        """Have the anchors of states pay for what was raised near them."""
        taught = self.taught.arrays
        if len(states) == 1 and len(self.taught):  # most often: then only what was taught around it
            finite = anchors.lengths[np.isfinite(anchors.lengths)]
            taught = self.taught.around(states[0], float(finite.max()) if finite.size else 0.0)
        if len(taught[1]):
            charge_anchors(
                states, np.arange(len(states)), anchors.vertices, anchors.lengths, self.graph.points,
                taught, self.query.space.metric,
            )  # fmt: skip

    def _values(self, anchors: Anchors, rows: NDArray[np.int64]) -> Floats:
        graph = self.graph
        if not self._open:
            return np.full(len(rows), np.inf)
        return anchored_values_of(
            rows, anchors.vertices, anchors.lengths, anchors.edges, graph.multipliers, graph.distance
        )

    def drawing(self, values: bool = True) -> dict[str, Any]:
        """What a figure shows.

        ``points`` (v, 2) with their h as ``values`` (v,); ``edges`` (m, 2), ``alive`` (m,), ``weights`` (m,).

        Args:
            values: Whether h is asked for, which has the shortest paths repaired now.
        """
        factor, space, points = self.graph.multipliers, self.query.space, self.graph.points
        if isinstance(space, Subspace):
            points, space = space.lift(points), space.whole
        return {
            **({"values": self.graph.distance} if values else {}),
            "points": space.robot.position(points),
            "edges": self.graph.edges,
            "alive": np.isfinite(factor),
            "weights": np.where(np.isfinite(factor), factor, 1.0),
        }


class Taught:
    """What failures taught: states, a reach around each, and the factor by which ways there cost more.

    Attributes:
        index: Where the states are.
        farthest: The largest of the reaches.
    """

    def __init__(self, metric: Metric) -> None:
        self.index = GrowingIndex(metric, capacity=16)
        self.farthest = 0.0
        self._arrays = np.zeros((16, len(metric.weights))), np.zeros(16), np.zeros(16)
        self._n = 0

    def __len__(self) -> int:
        return self._n

    def add(self, state: Floats, reach: float, factor: float) -> None:
        """Add one."""
        if self._n == len(self._arrays[1]):
            a, b, c = (_grown(array, 2 * self._n) for array in self._arrays)
            self._arrays = a, b, c
        states, reaches, factors = self._arrays
        states[self._n], reaches[self._n], factors[self._n] = state, reach, factor
        self.index.add(state)
        self.farthest = max(self.farthest, float(reach))
        self._n += 1

    def around(self, state: Floats, length: float) -> tuple[Floats, Floats, Floats]:
        """`arrays` of those, in order, that an anchor of a length from a state can pass within reach of."""
        rows = self.index.within(state, (self.farthest + length) * (1.0 + 1e-9))
        states, reaches, factors = self._arrays
        return states[rows], reaches[rows], factors[rows]

    @property
    def arrays(self) -> tuple[Floats, Floats, Floats]:
        """(n, d') states, (n,) reaches and (n,) factors, as kernels take them."""
        states, reaches, factors = self._arrays
        return states[: self._n], reaches[: self._n], factors[: self._n]


class AnchoredStates:
    """The anchors of a growing tree's nodes, and for each vertex of the graph the nodes anchored to it.

    The lists tell which nodes a change of the graph concerns, so that it costs what it changes and not what
    the tree holds.
    """

    def __init__(self, query: Query, vertices: int) -> None:
        self._index = GrowingIndex(query.space.metric)
        self._metric = query.space.metric
        self._states = np.zeros((0, query.space.dimension))
        self.anchors = Anchors(np.zeros((0, 0), np.int32), np.zeros((0, 0)), np.zeros((0, 0), np.int32))
        self.longest = 0.0  # upper bound of the finite lengths
        self._n = 0
        self._head = np.full(vertices, -1, np.int32)
        self._node_of = np.zeros(0, np.int32)
        self._following = np.zeros(0, np.int32)
        self._links = 0
        self._stale: list[NDArray[np.int64]] = []

    def __len__(self) -> int:
        return self._n

    @property
    def stale(self) -> bool:
        """Whether the anchors of a node have changed since the last call of `affected`."""
        return bool(self._stale)

    def append(self, states: Floats, fresh: Anchors) -> None:
        """Take in the next nodes and their anchors."""
        first, last = self._n, self._n + len(fresh)
        if last > len(self.anchors):
            a = self.anchors if first else fresh
            columns = (x[:first] for x in (a.vertices, a.lengths, a.edges))
            self.anchors = Anchors(*(_grown(x, 2 * last) for x in columns))
            self._states = _grown(self._states[:first], 2 * last)
        self._states[first:last] = states
        self._n = last
        self._room_for(fresh.vertices.size)
        a, lists = self.anchors, (self._head, self._node_of, self._following)
        held, new = (a.vertices, a.lengths, a.edges), (fresh.vertices, fresh.lengths, fresh.edges)
        self._links, longest = enter_anchors(held, new, first, lists, self._links)
        self.longest = max(self.longest, longest)

    def replace(self, rows: NDArray[np.int64], fresh: Anchors) -> None:
        """Give some nodes other anchors."""
        self._room_for(fresh.vertices.size)
        a, lists = self.anchors, (self._head, self._node_of, self._following)
        for k, i in enumerate(rows.tolist()):
            held = a.vertices, a.lengths, a.edges
            row = slice(k, k + 1)
            new = fresh.vertices[row], fresh.lengths[row], fresh.edges[row]
            self._links, longest = enter_anchors(held, new, i, lists, self._links)
            self.longest = max(self.longest, longest)
        self._stale.append(rows)

    def _room_for(self, links: int) -> None:
        needed = self._links + links
        if needed > self._node_of.size:
            self._node_of, self._following = (_grown(x, 2 * needed) for x in (self._node_of, self._following))

    def states(self, rows: NDArray[np.int64]) -> Floats:
        """(r, d') states of some nodes."""
        return self._states[rows]

    def charge(self, state: Floats, reach: float, factor: float, points: Floats) -> None:
        """Raise the cost of the anchors that pass near a state."""
        known = len(self._index)  # of some graphs nobody asks for the nodes near a state
        if known < self._n:
            self._index.add_many(self._states[known : self._n])
        rows = self._index.within(state, reach + self.longest)
        a = self.anchors
        charge_anchors(
            self._states, rows, a.vertices, a.lengths, points,
            (state[None], np.array([reach]), np.array([factor])), self._metric,
        )  # fmt: skip
        self._stale.append(rows)

    def touch(self, row: int) -> None:
        """Note that the anchors of a node have changed."""
        self._stale.append(np.array([row]))

    def affected(self, vertices: NDArray[np.int64]) -> NDArray[np.int64]:
        """Nodes whose cost has to be computed anew: those anchored to one of the vertices, and stale ones."""
        rows = self._stale
        self._stale = []
        if vertices.size:
            rows.append(linked_nodes(vertices, self._head, self._node_of, self._following, self._n))
        return np.concatenate(rows) if rows else _NONE


def _grown(array: NDArray[Any], rows: int) -> NDArray[Any]:
    out = np.zeros((rows, *array.shape[1:]), array.dtype)
    out[: len(array)] = array
    return out
