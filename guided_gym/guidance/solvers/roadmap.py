"""A roadmap of sampled vertices: lazy or validated (paper, Simple Examples and Environment Modification)."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from guided_gym.checks import affordable, integer
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.solvers.base import Floats, Query
from guided_gym.guidance.solvers.doubted import DoubtedGraph
from guided_gym.guidance.solvers.graph import AnchoredStates, Anchors, Graph, GraphCostToGo, Ints
from guided_gym.kernels.anchors import (
    candidate_values,
    charged_anchors,
    enter_charged,
    nearest_anchors,
    not_yet_near,
    roadmap_edges_near,
)
from guided_gym.kernels.metric import Metric
from guided_gym.storage.preparations import Arrays, fits, prepared, within
from guided_gym.structures.nearest import GrowingIndex
from guided_gym.structures.segments import SegmentIndex
from guided_gym.structures.shortest_paths import (
    RoadmapGraph,
    graph_from_edges,
    nearest_graph,
    with_vertex,
)

_NETS: Final = 8  # roadmaps of one kind that a search may get: drawn once, and used again
_RENEWALS: Final = 9  # where no path exists, there must be a last one
_DOUBTED_RENEWALS: Final = 3  # each asks about all its vertices anew; further ones found no further way
_VERTEX: Final = 300  # bytes of a vertex, its place in the index and in the tree of shortest paths included
_EDGE: Final = 200  # of an edge: while the graph is built, and in the index of its segments
_ANCHOR: Final = 40  # of an anchor, and its link back
LIKELY: Final = 0.5
"""p(free) of a motion that is worth a sample."""
_AROUND: Final = 12  # times as many vertices around candidates as each of them has anchors


class _Net(NamedTuple):
    """A roadmap without start and goal: what does not depend on the query, nor, if lazy, on the obstacles."""

    points: Floats
    graph: RoadmapGraph
    nearest: GrowingIndex
    segments: SegmentIndex


class Roadmap(GraphCostToGo):
    """Shortest paths on a roadmap of uniform samples of C', joined to their nearest neighbours.

    Vertices are valid in E' and edges are free motions: the preprocessing is what a search over many tasks in
    one C shares. Where E' has no obstacles nothing is checked, and the roadmap depends on the bounds and the
    metric alone: it is drawn once for each kind of space, as one of `_NETS`, and serves every search there.
    Where nothing leads to the goal any more, a lazy one gives way to another, and what was taught holds
    within half the reach. The other has half as many vertices again, unless failures cut off all nodes from
    the vertices, as they do around a start in a tight place: more vertices would change nothing there.
    Where the query brings doubts, vertices and edges are free of what the robot has of itself, and the doubts
    are asked about the vertices, and then about those ways that are about to be taken (`DoubtedGraph`). The
    other roadmap has as many vertices there, so that it, too, was drawn before.

    Args:
        vertices: Number of samples.
        neighbours: Edges from each vertex to its nearest neighbours.
        anchors: Vertices that a state is joined to.
    """

    doubts = True

    def __init__(self, *, vertices: int = 1000, neighbours: int = 12, anchors: int = 4) -> None:
        self.vertices = integer("vertices", vertices, least=1)
        self.neighbours = integer("neighbours", neighbours, least=1)
        self.anchors = integer("anchors", anchors, least=1)
        size = _VERTEX + _EDGE * self.neighbours
        affordable("vertices, neighbours", (vertices, neighbours), self.vertices * size, "the roadmap")
        affordable("anchors", anchors, self.anchors * _ANCHOR * 1000, "the anchors of 1,000 nodes")

    def begin(self, query: Query, rng: np.random.Generator, step: float) -> None:
        """Draw the roadmap, or take an earlier one."""
        self._finer = self._renewals = 0
        self._most = _RENEWALS if query.doubts is None else _DOUBTED_RENEWALS
        self._lazy = not query.space.environment.obstacles
        self._asked = 0 if query.doubts is None else query.doubts.looks
        super().begin(query, rng, step)

    def build(self) -> Graph:
        """The roadmap with the goal as its last vertex."""
        space, goal = self.query.space, self.query.goal
        number = int(self.rng.integers(_NETS))
        count = int(self.vertices * 1.5**self._finer)
        doubts = self.query.doubts
        kind = _Kind(space) if self._lazy and doubts is None else _Validated(space)
        self._net = _net(kind, count, self.neighbours, number)
        ids, lengths = np.zeros(0, np.int64), np.zeros(0)
        if len(self._net.points):  # none where C' has no room at all
            ids, lengths = self._net.nearest.k_nearest(goal, min(self.neighbours, len(self._net.points)))
        if not self._lazy and ids.size:
            starts = np.repeat(goal[None], len(ids), axis=0)
            free = space.motions_free(starts, self._net.points[ids])
            ids, lengths = ids[free], lengths[free]
        self._near_goal = ids
        points = np.vstack([self._net.points, goal])
        graph = with_vertex(self._net.graph, ids, lengths)
        ends = points[graph.edges[len(self._net.graph.lengths) :]]
        self._own = np.ascontiguousarray(ends[:, 0]), np.ascontiguousarray(ends[:, 1])  # edges of the goal
        if doubts is None:
            return Graph(points, graph, len(points) - 1)
        hopeless = np.isinf(doubts.factors(points[:-1], points[:-1]))
        gone = np.append(hopeless, False)[graph.edges].any(axis=1)
        made = Graph(points, graph._replace(lengths=np.where(gone, np.inf, graph.lengths)), len(points) - 1)
        self._doubted = DoubtedGraph(made, doubts)
        self._told = np.zeros((0, 0), np.int8)  # how often anchors of the nodes have been asked about
        return made

    @property
    def checks(self) -> int:
        """Vertices and edges that were checked, or would be, if no other search had drawn this roadmap."""
        return 0 if self._lazy else len(self._net.points) * (1 + self.neighbours)

    def anchor(self, states: Floats) -> Anchors:
        """Join each state to its nearest vertices, or to the goal where that is nearer."""
        points, count = self.graph.points, min(self.anchors, len(self.graph.points) - 1)
        space = self.query.space
        if count == 0:
            return Anchors(*(np.zeros((len(states), 0), kind) for kind in (np.int32, np.float64, np.int32)))
        vertices, lengths = nearest_anchors(states, self._net.nearest.state, points, count, space.metric)
        anchors = Anchors(vertices, lengths, np.full(vertices.shape, -1, np.int32))
        if not self._lazy:
            starts = np.repeat(states, count, axis=0)
            free = space.motions_free(starts, points[vertices.ravel()])
            self.looks += free.size
            anchors.lengths[~free.reshape(lengths.shape)] = np.inf
        return anchors

    def joined(self, states: Floats) -> Anchors:
        """Join the nodes of a tree to the graph; their anchors pay for what was raised near them."""
        points = self.graph.points
        count = min(self.anchors, len(points) - 1)
        if not self._lazy or count == 0:
            return super().joined(states)
        nearest, metric = self._net.nearest.state, self.query.space.metric
        taught = self.taught.room, self.taught.index.state, self.taught.farthest
        return Anchors(*charged_anchors(states, nearest, points, count, *taught, metric))

    def _enter(self, nodes: AnchoredStates, states: Floats) -> None:
        """Join the next nodes of a tree, and compute their cost-to-go."""
        graph = self.graph
        count = min(self.anchors, len(graph.points) - 1)
        if not self._lazy or count == 0:
            super()._enter(nodes, states)
            return
        first = len(nodes)
        nodes.make_room(states, count)
        found = enter_charged(
            states, (first, nodes.links, count), nodes.held, nodes.lists, self._h,
            (self._net.nearest.state, graph.points, graph.ways),
            self.taught.room, self.taught.index.state, self.taught.farthest, self.query.space.metric,
        )  # fmt: skip
        nodes.joined(*found)

    def __call__(self, states: Floats) -> Floats:
        """(n, d') states to (n,) cost-to-go; candidates around a node share the search for vertices."""
        states = np.ascontiguousarray(states)
        if self.query.doubts is not None:
            anchors = self.joined(states)
            ends = self.graph.points[anchors.vertices.ravel()]
            starts = np.repeat(states, anchors.vertices.shape[1], axis=0)
            anchors.lengths *= self.query.doubts.factors(starts, ends).reshape(anchors.lengths.shape)
            self._count_asked()
            return self._values(anchors, np.arange(len(anchors)))
        around = _AROUND * self.anchors
        if self._lazy and 1 < len(states) <= around < len(self.graph.points):
            graph = self.graph
            h: Floats = candidate_values(
                states, self._net.nearest.state, graph.points, graph.ways, self.anchors,
                self.taught.room, self.taught.index.state, self.taught.farthest, self.query.space.metric,
            )  # fmt: skip
            return h
        return super().__call__(states)

    def follow(self, states: Floats) -> Floats:
        """(n,) cost-to-go of the nodes; on another roadmap where none of them sees a way any more."""
        h = self._followed(states)
        if self.query.doubts is not None:
            while math.isfinite(h.min()) and self._look_from_node(states, int(np.argmin(h))):
                h = self._followed(states)
            self._count_asked()
        return h

    def _look_from_node(self, states: Floats, node: int) -> bool:
        """Ask about the way from a node; whether there was anything to ask."""
        nodes = self._nodes
        assert nodes is not None
        if len(nodes) > len(self._told):
            told = np.zeros((2 * len(nodes), nodes.anchors.vertices.shape[1]), np.int8)
            told[: len(self._told), : self._told.shape[1]] = self._told
            self._told = told
        if not self._doubted.look_from(states, nodes.anchors, self._told, node):
            return False
        nodes.touch(node)
        return True

    def choose(self, origin: Floats, states: Floats) -> int:
        """Choose one of some states around another: likely to be reached, with the shortest way on.

        Only where the query brings doubts.
        """
        assert self.query.doubts is not None
        chances = self.query.doubts.likely(np.repeat(origin[None], len(states), axis=0), states)
        likely = np.flatnonzero(chances >= LIKELY)
        chosen = int(np.argmax(chances))
        if likely.size and len(self.graph.points) > 1:
            near = np.ascontiguousarray(states[likely])
            row, way = self._doubted.nearest(near, self.joined(near))
            chosen = int(likely[row]) if math.isfinite(way) else chosen
        self._count_asked()
        return chosen

    def _count_asked(self) -> None:
        """What the doubts have looked at is looked at by this solver."""
        doubts = self.query.doubts
        if doubts is not None:
            self.looks += doubts.looks - self._asked
            self._asked = doubts.looks

    def _on_graph(self, states: Floats) -> Floats:
        """(n,) cost-to-go of the nodes on the roadmap as it stands, whether they see a way or not."""
        return super().follow(states)

    def _followed(self, states: Floats) -> Floats:
        h = super().follow(states)
        while self._lazy and self._renewals < self._most and not math.isfinite(h[h.argmin()]):
            self._renewals += 1
            reached = self._nodes is not None and np.isfinite(self._nodes.anchors.lengths[: len(h)]).any()
            if reached and self.query.doubts is None:
                self._finer += 1
            self._renew(0.5)
            h = super().follow(states)
        return h

    def edges_near(self, state: Floats, reach: float) -> Ints:
        """Edges that pass within ``reach`` of a state; the goal's own come last."""
        first, metric = len(self._net.graph.lengths), self.query.space.metric
        edges: Ints = roadmap_edges_near(self._net.segments.state, self._own, first, state, reach, metric)
        return edges

    def _not_inspected(self, state: Floats, reach: float) -> Ints:
        """Vertices near a state that nobody has asked for so far."""
        near: Ints = not_yet_near(self._net.nearest.state, state, reach, self._inspected)
        return near

    def vertices_near(self, state: Floats, reach: float) -> Ints:
        """Vertices within ``reach`` of a state; the goal is none of them."""
        return self._net.nearest.within(state, reach)


class _Kind:
    """Spaces that lazy roadmaps cannot tell apart: those of the same bounds and metric."""

    def __init__(self, space: ConfigurationSpace) -> None:
        self._space = space
        self._key = b"".join(a.tobytes() for a in (space.lower, space.upper, *space.metric))

    def __hash__(self) -> int:
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and other._key == self._key

    @property
    def fingerprint(self) -> str:
        """All that a roadmap of such spaces depends on."""
        return self._key.hex()

    @property
    def metric(self) -> Metric:
        """The metric of such spaces."""
        return self._space.metric

    def vertices(self, rng: np.random.Generator, count: int) -> Floats:
        """(count, d') samples."""
        return self._space.sample(rng, count)

    def free(self, starts: Floats, ends: Floats) -> np.ndarray | slice:
        """Which edges to keep."""
        return slice(None)


class _Validated(_Kind):
    """One space, obstacles included."""

    def __init__(self, space: ConfigurationSpace) -> None:
        super().__init__(space)
        self._key = space.fingerprint().encode()

    def vertices(self, rng: np.random.Generator, count: int) -> Floats:
        """(<= count, d') valid samples; fewer only if C'_free is tiny."""
        kept: list[Floats] = []
        for _ in range(20):
            drawn = self._space.sample(rng, count)
            kept.append(drawn[self._space.valid(drawn)])
            if sum(map(len, kept)) >= count:
                break
        return np.concatenate(kept)[:count]

    def free(self, starts: Floats, ends: Floats) -> np.ndarray | slice:
        """The edges whose motion is free."""
        return self._space.motions_free(starts, ends)


@lru_cache(maxsize=64)
def _net(kind: _Kind, vertices: int, neighbours: int, number: int) -> _Net:
    def build() -> dict[str, np.ndarray]:
        points = kind.vertices(np.random.default_rng([vertices, neighbours, number]), vertices)
        near = nearest_graph(points, kind.metric, neighbours)
        kept = kind.free(points[near.edges[:, 0]], points[near.edges[:, 1]])
        return {"points": points, "edges": near.edges[kept], "lengths": near.lengths[kept]}

    def sound(kept: Arrays) -> bool:
        n, m, d = len(kept["points"]), len(kept["edges"]), len(kind.metric[0])
        return (
            fits(kept["points"], np.float64, n, d)
            and fits(kept["edges"], np.int32, m, 2)
            and fits(kept["lengths"], np.float64, m)
            and within(kept["edges"], n)
        )

    key = f"{kind.fingerprint} {vertices} {neighbours} {number}"
    made = prepared("roadmap 1", key, build, sound)
    points = made["points"]
    graph = graph_from_edges(len(points), made["edges"], made["lengths"])
    index = GrowingIndex(kind.metric, capacity=max(len(points), 1))
    index.add_many(points)
    return _Net(points, graph, index, SegmentIndex(points, graph.edges, kind.metric))
