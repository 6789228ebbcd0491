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
from guided_gym.kernels.anchors import (
    anchored_values_of,
    charge_anchors,
    charge_near,
    concerned_nodes,
    edges_at,
    enter_anchors,
)
from guided_gym.kernels.metric import Metric
from guided_gym.structures.nearest import GrowingIndex, kernel_array
from guided_gym.structures.segments import SegmentIndex
from guided_gym.structures.shortest_paths import RoadmapGraph, ShortestPathTree

if TYPE_CHECKING:
    import networkx as nx

Int32s = NDArray[np.int32]
Ints = NDArray[np.int64]

_NONE: Final = np.zeros(0, np.int64)
_ROOM: Final = 256  # nodes and links that there is room for at first
_KINDS: Final = np.int32, np.float64, np.int32  # of the columns of anchors


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
        self._distance = self.tree.state[2][1]
        self._raised: list[Ints] = []  # edges that got longer, which the tree does not know of yet
        self._changed: list[NDArray[np.integer[Any]]] = []  # vertices, since `concerned` was asked last

    @property
    def distance(self) -> Floats:
        """(v,) length of the shortest path from each vertex to the goal; infinite if there is none."""
        self._settle()
        return self.tree.distance

    @property
    def ways(self) -> Floats:
        """`distance` as kernels take it."""
        self._settle()
        return self._distance

    def _settle(self) -> None:
        """Repair the tree once for all edges that got longer since."""
        if self._raised:
            raised = _taken(self._raised)
            changed = self.tree.lengthen(raised, self.lengths, self.multipliers)
            self._changed += [self.edges[raised].ravel(), changed]  # anchors run along them, too

    def raise_edges(self, edges: NDArray[np.integer[Any]], factor: float | Floats) -> None:
        """Add ``factor - 1`` times its length to the weight of some edges; infinite removes them.

        Factors of their own, (k,), have to be finite.
        """
        raised: Ints = np.asarray(edges, np.int64)
        if raised.size == 0:
            return
        if isinstance(factor, float) and factor == math.inf:
            self.multipliers[raised] = np.inf
        else:
            self.multipliers[raised] += factor - 1.0
        self._raised.append(raised)

    def remove_edges_at(self, vertices: Ints, bad: NDArray[np.bool_]) -> None:
        """Remove the ``bad`` ones (k,) of some vertices (k,), with all their edges."""
        self.raise_edges(edges_at(vertices, bad, self._graph.indptr, self._graph.edge_of), np.inf)

    @property
    def touched(self) -> bool:
        """Whether the cost of any node may have changed since the last call of `concerned`."""
        return bool(self._changed or self._raised)

    def concerned(self, stale: Ints, lists: tuple[Int32s, Int32s, Int32s], n: int) -> Ints:
        """The nodes whose cost has to be computed anew, for what has changed since the last call.

        Args:
            stale: Nodes of which that is known.
            lists: Who is anchored to each vertex, see `guided_gym.kernels.anchors.link_anchors`.
            n: How many nodes there are.
        """
        raised, changed = _taken(self._raised), _taken(self._changed).astype(np.int64, copy=False)
        costs = self.lengths, self.multipliers
        rows: Ints = concerned_nodes(raised, changed, stale, self.tree.state, costs, lists, n)
        return rows

    def forget_changes(self) -> None:
        """Nobody has asked for a cost yet."""
        self._settle()
        self._changed.clear()

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
        self._h = np.zeros(_ROOM)
        self._known = self._h[:0]  # of it, what has been given away
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
            self.graph.forget_changes()
            self._nodes = AnchoredStates(self.query, len(self.graph.points))
        nodes, first = self._nodes, len(self._nodes)
        if self.graph.touched or nodes.stale:
            changed = nodes.affected(self.graph)
            if changed.size:
                self._h[changed] = self._values(nodes.anchors, changed)
        if n > first:
            self._enter(nodes, np.ascontiguousarray(states[first:n]))
        if self._known.size != n or self._known.base is not self._h:
            self._known = self._h[:n]
            self._known.flags.writeable = False
        return self._known

    def _enter(self, nodes: AnchoredStates, states: Floats) -> None:
        """Join the next nodes of a tree, and compute their cost-to-go; in one go where a kernel can."""
        first, last = len(nodes), len(nodes) + len(states)
        nodes.append(states, self.joined(states))
        self._h[first:last] = self._values(nodes.anchors, np.arange(first, last))

    def raise_near(self, state: Floats, reach: float, factor: float) -> None:
        """Lengthen, or remove, the edges and anchors that pass within ``reach`` of a state."""
        state = kernel_array(state, np.float64)
        self.taught.add(state, reach, factor)
        self._teach(state, reach, factor)

    def _teach(self, state: Floats, reach: float, factor: float) -> None:
        self.graph.raise_edges(self.edges_near(state, reach), factor)
        if self._nodes is not None:
            self._nodes.charge(state, reach, factor, self.graph.points)

    def edges_near(self, state: Floats, reach: float) -> NDArray[np.int64]:
        """Edges that pass within ``reach`` of a state."""
        return self.segments.within(state, reach)

    @property
    def segments(self) -> SegmentIndex:
        """Where the edges are; found out when it is asked for."""
        if self._segments is None:
            self._segments = SegmentIndex(self.graph.points, self.graph.edges, self.query.space.metric)
        return self._segments

    def inspect(self, state: Floats, reach: float, valid: Valid) -> None:
        """Remove the vertices within ``reach`` of a state that are not valid: a failure is the occasion."""
        state = kernel_array(state, np.float64)
        self._inspections.append((state, reach, valid))
        near = self._not_inspected(state, reach)
        if near.size:
            self._discard(near, ~valid(self.graph.points[near]))

    def _not_inspected(self, state: Floats, reach: float) -> Ints:
        """Vertices near a state that nobody has asked for so far."""
        near = self.vertices_near(state, reach)
        near = near[~self._inspected[near]]
        self._inspected[near] = True
        return near

    def _discard(self, vertices: Ints, bad: NDArray[np.bool_]) -> None:
        """Take the bad ones of some vertices out of the graph."""
        self.graph.remove_edges_at(vertices, bad)

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
            rows, anchors.vertices, anchors.lengths, anchors.edges, graph.multipliers, graph.ways
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
        self._arrays = np.zeros((16, len(metric[0]))), np.zeros(16), np.zeros(16)
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
    def room(self) -> tuple[Floats, Floats, Floats]:
        """`arrays`, and room for more: for kernels that look by the index alone."""
        return self._arrays

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

    @property
    def held(self) -> tuple[Int32s, Floats, Int32s]:
        """Vertices, lengths and edges of all anchors, room for more included, as kernels take them."""
        a = self.anchors
        return a.vertices, a.lengths, a.edges

    @property
    def lists(self) -> tuple[Int32s, Int32s, Int32s]:
        """Who is anchored to each vertex, as kernels take it."""
        return self._head, self._node_of, self._following

    @property
    def links(self) -> int:
        """How many anchors the lists hold."""
        return self._links

    def make_room(self, states: Floats, k: int) -> None:
        """Take in the next nodes, without their anchors so far: `k` a node.

        A kernel may write them then, where it knows `held`, `lists` and `links`; `joined` ends it.
        """
        first, last = self._n, self._n + len(states)
        if last > len(self.anchors):
            wide = self.anchors if first else Anchors(*(np.zeros((0, k), kind) for kind in _KINDS))
            rows = max(2 * last, _ROOM)
            self.anchors = Anchors(*(_grown(x[:first], rows) for x in _columns(wide)))
            self._states = _grown(self._states[:first], rows)
        self._states[first:last] = states
        self._n = last
        self._room_for(len(states) * k)

    def joined(self, links: int, longest: float) -> None:
        """Take note of what a kernel has entered: the number of links now, and the longest anchor."""
        self._links, self.longest = links, max(self.longest, longest)

    def append(self, states: Floats, fresh: Anchors) -> None:
        """Take in the next nodes and their anchors."""
        first = self._n
        self.make_room(states, fresh.vertices.shape[1])
        self.joined(*enter_anchors(self.held, _columns(fresh), first, self.lists, self._links))

    def replace(self, rows: NDArray[np.int64], fresh: Anchors) -> None:
        """Give some nodes other anchors."""
        self._room_for(fresh.vertices.size)
        for k, i in enumerate(rows.tolist()):
            row = slice(k, k + 1)
            new = fresh.vertices[row], fresh.lengths[row], fresh.edges[row]
            self.joined(*enter_anchors(self.held, new, i, self.lists, self._links))
        self._stale.append(rows)

    def _room_for(self, links: int) -> None:
        needed = self._links + links
        if needed > self._node_of.size:
            room = max(2 * needed, _ROOM)
            self._node_of, self._following = (_grown(x, room) for x in (self._node_of, self._following))

    def states(self, rows: NDArray[np.int64]) -> Floats:
        """(r, d') states of some nodes."""
        return self._states[rows]

    def charge(self, state: Floats, reach: float, factor: float, points: Floats) -> None:
        """Raise the cost of the anchors that pass near a state."""
        known = len(self._index)  # of some graphs nobody asks for the nodes near a state
        self._index.reserve(self._n - known)
        a = self.anchors
        rows = charge_near(
            (state, reach, factor), self._index.state, (self._states, a.vertices, a.lengths),
            (known, self._n), self.longest, points, self._metric,
        )  # fmt: skip
        self._stale.append(rows)

    def touch(self, row: int) -> None:
        """Note that the anchors of a node have changed."""
        self._stale.append(np.array([row]))

    def affected(self, graph: Graph) -> Ints:
        """Nodes whose cost has to be computed anew: by a change of the graph, or of their anchors."""
        return graph.concerned(_taken(self._stale), self.lists, self._n)


def _taken(arrays: list[Any]) -> Any:
    """All that a list of arrays holds, in one; the list is empty then."""
    if not arrays:
        return _NONE
    whole = arrays[0] if len(arrays) == 1 else np.concatenate(arrays)
    arrays.clear()
    return whole


def _columns(anchors: Anchors) -> tuple[Int32s, Floats, Int32s]:
    return anchors.vertices, anchors.lengths, anchors.edges


def _grown(array: NDArray[Any], rows: int) -> NDArray[Any]:
    out = np.zeros((rows, *array.shape[1:]), array.dtype)
    out[: len(array)] = array
    return out
