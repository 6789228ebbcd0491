"""Distances to a goal over a dense certified roadmap, for configuration spaces that no grid can cover."""

from __future__ import annotations

import hashlib
import math
import threading
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import cycle
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError, NoPathError
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.kernels import cost_grid
from guided_gym.kernels.cost_query import OracleState
from guided_gym.kernels.extend import grow_rrt
from guided_gym.kernels.roadmap_query import TURNS, Roads, Ways, costs_by_roadmap
from guided_gym.measure.oracle_store import FieldStore
from guided_gym.measure.solution import Kept, OracleError, free_poses, warn_of
from guided_gym.options import OracleOptions
from guided_gym.search.tree import SearchTree
from guided_gym.structures.nearest import GrowingIndex
from guided_gym.structures.shortest_paths import (
    RoadmapGraph,
    ShortestPathTree,
    graph_from_edges,
    nearest_graph,
    with_vertex,
)

FloatArray = NDArray[np.float64]

KIND: Final = "roadmap"
VERSION: Final = 1  # part of every cache key: raise it with any change that alters a roadmap
A_VERTEX: Final = 200  # vertices of a grid that cost as much as one of a roadmap, whose motions are checked
_FIRST: Final = 4000  # vertices of the first roadmap
_SMALLER: Final = 4  # times fewer in what its error is estimated from
_NEIGHBOURS: Final = 24
_NARROW: Final = 0.3  # part of the vertices that stand in narrow passages, as far as there are any
_BRIDGES: Final = 16  # times as many tries
_SPANS: Final = (math.log(0.3), math.log(3.0))  # of a passage, in natural lengths: logarithms
_NEAR: Final = 100  # vertices that the goal is joined to, at most
_LOOKS: Final = (32, 5)  # nearest vertices looked at, ways pulled tight
_WIDER: Final = (256, 4)  # likewise where nothing was seen
_ASKED: Final = (0.02, 0.2)  # error that is asked for unless another is: mean, tail
_GOALS: Final = 6  # at which two roadmaps are compared
_POSES: Final = 25  # for each of them
_GROWN: Final = 2000  # samples of a tree by which a configuration in a pocket looks for a way out
_REACHES: Final = (
    0.03,
    1.0,
)  # how far around it they lie, at first and at last, in ranges of the coordinates
_STEPS: Final = (0.1, 0.3, 1.0)  # steps of the tree, in natural lengths, in turn
_STAGES: Final = 30
_EXITS: Final = 12  # nodes of each stage that are asked for their way
_REMEMBERED: Final = 8  # roadmaps kept in memory


@dataclass(frozen=True, eq=False)
class Roadmap:
    """Free configurations of a space, each joined to its nearest others where the motion is certified.

    Attributes:
        points: (n, d) vertices.
        graph: Which of them are joined.
        index: Over the vertices.
    """

    points: FloatArray
    graph: RoadmapGraph
    index: GrowingIndex

    @classmethod
    def of(cls, space: ConfigurationSpace, count: int) -> Roadmap:
        """The roadmap of so many vertices; fewer where hardly a pose is free."""
        rng = np.random.default_rng(0)
        narrow = _in_passages(space, rng, int(_NARROW * count))
        points = np.ascontiguousarray(np.concatenate([narrow, free_poses(space, rng, count - len(narrow))]))
        near = nearest_graph(points, space.metric, _NEIGHBOURS)
        ends = points[near.edges[:, 0]], points[near.edges[:, 1]]
        free = np.asarray(space.motions_free(*ends)) if len(near.edges) else np.zeros(0, np.bool_)
        return cls._with(space, points, near.edges[free], near.lengths[free])

    @classmethod
    def _with(
        cls, space: ConfigurationSpace, points: FloatArray, edges: NDArray[np.int32], lengths: FloatArray
    ) -> Roadmap:
        index = GrowingIndex(space.metric, capacity=max(len(points), 1))
        if len(points):
            index.add_many(points)
        return cls(points, graph_from_edges(len(points), edges, lengths), index)

    @classmethod
    def stored(cls, space: ConfigurationSpace, count: int, cache: bool) -> Roadmap:
        """The roadmap from disk, or made anew and then stored."""
        store = FieldStore.default() if cache else FieldStore(None)
        text = f"roadmap {VERSION} {space.fingerprint()} {count}\n"
        key = hashlib.sha256(text.encode()).hexdigest()
        body = store.load_arrays(key)
        if body is not None:
            points, edges, lengths = body
            return cls._with(space, points, edges, lengths)
        made = cls.of(space, count)
        store.save_arrays(key, made.points, made.graph.edges, made.graph.lengths)
        return made


class World:
    """The roadmaps of one space: they serve every task in it."""

    def __init__(self, space: ConfigurationSpace, cache: bool) -> None:
        self.space, self._cache = space, cache
        self._roadmaps: dict[int, Roadmap] = {}
        self._errors: dict[tuple[int, int], OracleError] = {}

    def roadmap(self, count: int) -> Roadmap:
        """The roadmap of so many vertices."""
        if count not in self._roadmaps:
            self._roadmaps[count] = Roadmap.stored(self.space, count, self._cache)
        return self._roadmaps[count]

    def error(self, count: int, fewer: int) -> OracleError:
        """The error of a roadmap: how far a smaller one differs from it between some poses and goals.

        What is too long shrinks with the square of the distance between the vertices, a way being longer by
        the square of how far it bends aside: like n^(-2/d).
        """
        key = count, fewer
        if key not in self._errors:
            trust = 1.0 / ((count / fewer) ** (2.0 / self.space.dimension) - 1.0)
            self._errors[key] = _apart(self, count, fewer, trust)
        return self._errors[key]


def _apart(world: World, count: int, fewer: int, trust: float) -> OracleError:
    space, rng = world.space, np.random.default_rng(1)
    goals = free_poses(space, rng, _GOALS)
    apart = []
    for goal in goals:
        poses = free_poses(space, rng, _POSES)
        ours, theirs = (_Task(space, world.roadmap(n), goal).costs(poses) for n in (count, fewer))
        known = np.isfinite(ours) & np.isfinite(theirs) & (ours > 0.0)
        apart.append(np.abs(theirs[known] - ours[known]) / ours[known])
    every = trust * np.concatenate(apart) if apart else np.zeros(0)
    if not every.size:
        return OracleError(0.0, 0.0) if not len(goals) else OracleError(1.0, 1.0)
    return OracleError(float(every.mean()), float(np.quantile(every, 0.99)))


@dataclass(frozen=True, eq=False)
class _Own:
    """Vertices that a task has beside the roadmap's, with certified edges between them and to those.

    Attributes:
        points: (e, d) configurations.
        edges: (m, 2) their numbers, which follow those of the roadmap; the goal's follows theirs.
        lengths: (m,) of the edges.
    """

    points: FloatArray
    edges: NDArray[np.int64]
    lengths: FloatArray

    @classmethod
    def around(cls, space: ConfigurationSpace, roadmap: Roadmap, poses: list[FloatArray]) -> _Own:
        """Trees that lead out of the pockets in which some configurations lie, the goal first."""
        goal, count = -1, len(roadmap.points)
        points: list[FloatArray] = []
        edges, lengths = [], []
        for q in poses:
            *_, tree = _growing(space, q)
            nodes, parents = np.array(tree.configurations), tree.parents[1:]
            numbers = count + np.arange(len(nodes))
            if not points:  # the goal is none of these vertices: it comes behind them
                numbers = np.append(goal, numbers[:-1])
            count += len(nodes) - (not points)
            edges.append(np.stack([numbers[1:], numbers[parents]], axis=1))
            lengths.append(tree.cost_to_come[1:] - tree.cost_to_come[parents])
            for number, node in zip(numbers, nodes, strict=True):
                seen, far = _seen(space, roadmap, node, _EXITS)
                edges.append(np.stack([np.full(len(seen), number), seen], axis=1))
                lengths.append(far)
            points.append(nodes if points else nodes[1:])
        every = np.concatenate(edges).astype(np.int64)
        every[every == goal] = count
        return cls(np.concatenate(points), every, np.concatenate(lengths))


class _Task:
    """A roadmap with the shortest paths to one goal.

    Args:
        space: The configuration space.
        roadmap: Its roadmap.
        goal: (d,) the goal.
        pockets: Configurations from which a tree looks for a way out, beside the goal; none if None, and
            none for the goal either if it sees a vertex.
    """

    def __init__(
        self,
        space: ConfigurationSpace,
        roadmap: Roadmap,
        goal: FloatArray,
        pockets: list[FloatArray] | None = None,
    ) -> None:
        self.space = space
        ids, lengths = _seen(space, roadmap, goal, _NEAR)
        if ids.size and pockets is None:
            vertices, graph = np.vstack([roadmap.points, goal]), with_vertex(roadmap.graph, ids, lengths)
        else:
            own = _Own.around(space, roadmap, [goal, *(pockets or [])])
            vertices = np.vstack([roadmap.points, own.points, goal])
            ends = np.concatenate([roadmap.graph.edges, own.edges])
            graph = graph_from_edges(len(vertices), ends, np.append(roadmap.graph.lengths, own.lengths))
        tree = ShortestPathTree.of(graph, len(vertices) - 1)
        self._roads = Roads(vertices, np.array(tree.distance), np.array(tree.parent), roadmap.index.state)
        self._forget()

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in self.__dict__.items() if key != "_ways"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._forget()

    def _forget(self) -> None:
        """Know no way but that of the goal; the others are worked out as they are asked for."""
        vertices = self._roads.vertices
        room = (TURNS + 1) * len(vertices) + 1
        self._ways = Ways(
            np.empty((room, vertices.shape[1])),
            np.full(room, -1, np.int32),
            np.zeros(room),
            np.full(len(vertices), -1, np.int32),
            np.ones(1, np.int64),
        )
        self._ways.points[0], self._ways.first[-1] = vertices[-1], 0

    def costs(self, qs: FloatArray) -> FloatArray:
        """(n,) lengths of the ways from configurations (n, d); infinite where none is seen."""
        found = self._looked(qs, _LOOKS)
        lost = np.isinf(found)
        if lost.any():
            lost[lost] = self.space.valid(qs[lost])
            found[lost] = self._looked(qs[lost], _WIDER)
        return found

    def _looked(self, qs: FloatArray, looks: tuple[int, int]) -> FloatArray:
        space = self.space
        return costs_by_roadmap(qs, self._roads, self._ways, looks, space.geometry, space.metric)

    def escape(self, q: FloatArray) -> float:
        """Length of a way out of a pocket and on to the goal; infinite if none is found."""
        asked = 1
        for tree in _growing(self.space, q):
            fresh = np.arange(asked, len(tree))[:: max(1, (len(tree) - asked) // _EXITS)]
            asked = len(tree)
            if fresh.size:
                found = tree.cost_to_come[fresh] + self._looked(np.array(tree.configurations[fresh]), _LOOKS)
                if np.isfinite(found).any():
                    return float(found.min())
        return math.inf


def _in_passages(space: ConfigurationSpace, rng: np.random.Generator, count: int) -> FloatArray:
    """(<= count, d) free poses between two that are not: narrow passages, which uniform ones would miss."""
    found = np.empty((0, space.dimension))
    for _ in range(_BRIDGES):
        ends = space.sample(rng, 2 * count)
        reach = space.scale * np.exp(rng.uniform(*_SPANS, (2 * count, 1)))
        aside = rng.normal(size=ends.shape)
        aside *= reach / np.linalg.norm(aside, axis=1, keepdims=True)
        others = space.wrap(ends + aside / space.weights)
        middles = space.interpolate(ends, others, np.full(len(ends), 0.5))
        bridge = ~np.asarray(space.valid(ends))
        bridge[bridge] = ~np.asarray(space.valid(others[bridge]))
        bridge[bridge] = space.valid(middles[bridge])
        found = np.concatenate([found, middles[bridge]])
        if len(found) >= count:
            break
    return found[:count]


def _growing(space: ConfigurationSpace, q: FloatArray) -> Iterator[SearchTree]:
    """A tree that grows out of a configuration, first around it, then farther; at each of its stages."""
    rng, tree = np.random.default_rng(0), SearchTree(space, q)
    reaches = np.geomspace(*_REACHES, _GROWN)[:, None] * (space.upper - space.lower)
    samples = space.wrap(q + reaches * rng.uniform(-1.0, 1.0, reaches.shape))
    for step, part in zip(cycle(_STEPS), np.array_split(samples, _STAGES), strict=False):
        tree.index.reserve(len(part))
        tree.reserve(len(part))
        record = np.empty(len(part), np.int32), np.empty(len(part), np.int32)
        grow_rrt(
            part, (len(tree), 0), tree.nodes, tree.failed, tree.index.state, np.array(q),
            (step * space.scale, 0.0, False), space.geometry, space.metric, record,
        )  # fmt: skip
        tree.grown(int((record[1] >= 0).sum()), 0)
        yield tree


def _seen(
    space: ConfigurationSpace, roadmap: Roadmap, q: FloatArray, near: int
) -> tuple[NDArray[np.int64], FloatArray]:
    """Of the nearest vertices, those that a configuration sees, and how far they are."""
    if not len(roadmap.points):
        return np.zeros(0, np.int64), np.zeros(0)
    ids, lengths = roadmap.index.k_nearest(q, near)
    free = np.asarray(space.motions_free(np.repeat(q[None], len(ids), axis=0), roadmap.points[ids]))
    return ids[free], lengths[free]


class RoadmapSolution:
    """Distances to one goal over a roadmap dense enough for the space; see `Solution`.

    The shortest path over a roadmap of free configurations, pulled tight: so every distance is the length of
    a certified path, and never too short by more than rounding. The roadmap belongs to the space: it is made
    once, kept on disk, and serves every task there. It grows until the error, estimated from a smaller one,
    is as small as the options ask, or their budget is spent.

    Args:
        space: The configuration space.
        goal: (d,) a valid configuration.
        start: (d,) a valid configuration, which has to be connected to the goal; None for none.
        options: Vertices, error asked for, budget.
        cache: Whether to use the disk cache.

    Raises:
        InvalidInputError: A resolution that is no number of vertices.
        NoPathError: No path from start to goal, as far as the largest roadmap can tell.
    """

    state: OracleState

    def __init__(
        self,
        space: ConfigurationSpace,
        goal: FloatArray,
        start: FloatArray | None,
        options: OracleOptions,
        cache: bool,
    ) -> None:
        self.space, self.goal, self.options, self._cache = space, goal, options, cache
        self._start = None if start is None else start.tolist()
        self._world: World | None = world_of(space, cache)
        self._most = max(_FIRST, options.budget // A_VERTEX)
        self._count, self._fewer = min(_FIRST, self._most), _FIRST // _SMALLER
        if options.resolution is not None:
            self._count = _checked(options.resolution)
            self._fewer = max(1, self._count // _SMALLER)
        else:
            self._grow()
        self._pockets: list[FloatArray] | None = None
        self._solve()
        if start is not None:
            self._reach(start)
        frame = np.ones(cost_grid.FRAME)
        frame[cost_grid.ORIGIN_X] = -1e300  # every configuration is outside
        self.state = (np.full(1, np.inf, np.float32), np.zeros(1, np.uint8), frame, space.geometry)

    def __getstate__(self) -> dict[str, Any]:
        """The state without the roadmaps of the whole space: its own roadmap is enough."""
        return {**self.__dict__, "_world": None}

    def __repr__(self) -> str:
        return f"a roadmap of {self._count:,} configurations"

    @property
    def resolution(self) -> tuple[int, ...]:
        """(1,) the number of vertices that were asked for."""
        return (self._count,)

    @property
    def error(self) -> OracleError:
        """The estimated error: of the roadmap, between any poses and goals of its space."""
        return self._of_world.error(self._count, self._fewer)

    @property
    def _of_world(self) -> World:
        if self._world is None:
            self._world = world_of(self.space, self._cache)
        return self._world

    def kept(self) -> Kept:
        """Nothing: the roadmap belongs to the space, and is made once on each machine."""
        return Kept(KIND, {"start": self._start}, {})

    @classmethod
    def restored(
        cls, space: ConfigurationSpace, goal: FloatArray, options: OracleOptions, kept: Kept
    ) -> RoadmapSolution:
        """A solution over the space's roadmap, solved anew.

        Raises:
            NoPathError: From another version: no path from the start.
        """
        start = kept.meta["start"]
        return cls(space, goal, None if start is None else np.array(start, np.float64), options, True)

    def cost(self, q: FloatArray) -> float:
        """Distance to the goal of one configuration (d,)."""
        return float(self.costs(q[None])[0])

    def costs(self, qs: FloatArray) -> FloatArray:
        """(n,) distances to the goal of configurations (n, d)."""
        known = np.isfinite(qs).all(axis=1)
        costs = np.full(len(qs), np.inf)
        costs[known] = self._task.costs(np.ascontiguousarray(qs[known]))
        for i in np.flatnonzero(known & np.isinf(costs)):
            if self.space.valid(qs[i]):
                costs[i] = self._task.escape(qs[i])
        return costs

    def connects(self, q: FloatArray) -> bool:
        """Whether the roadmap joins a valid configuration to the goal."""
        return math.isfinite(self._task.costs(q[None])[0])

    def _solve(self) -> None:
        self._task = _Task(self.space, self._of_world.roadmap(self._count), self.goal, self._pockets)

    def _grow(self) -> None:
        """Take larger roadmaps until the error is as small as asked, or the budget spent: then warn."""
        while (excess := self._excess()) > 1.0:
            wanted = self._count * max(2.0, (1.1 * excess) ** (0.5 * self.space.dimension))
            more = int(min(wanted, self._most))
            if more < 1.5 * self._count:
                warn_of(self.error, f"over {self!r}", self.options.budget)
                return
            self._fewer, self._count = self._count, more

    def _excess(self) -> float:
        """How many times larger the error is than asked for."""
        return self.options.excess(self.error, _ASKED)

    def _reach(self, start: FloatArray) -> None:
        """Grow trees out of start and goal, then the roadmap, until the start is connected.

        Raises:
            NoPathError: Not even the largest roadmap connects it.
        """
        while not self.connects(start):
            if self._pockets is None:
                self._pockets = [start]
            elif self._count * 1.5 <= self._most and self.options.resolution is None:
                self._fewer, self._count = self._count, min(4 * self._count, self._most)
            else:
                raise NoPathError(
                    f"no path from start {start.tolist()} to goal {self.goal.tolist()}: none found over "
                    f"{self!r}; one may exist through a narrower passage: raise the budget (OracleOptions)"
                )
            self._solve()


def _checked(resolution: tuple[int, ...]) -> int:
    if len(resolution) != 1:
        raise InvalidInputError(
            f"expected one number of vertices as a roadmap's resolution, got {shown(resolution)}"
        )
    return int(resolution[0])


_lock = threading.Lock()
_worlds: OrderedDict[tuple[str, bool], World] = OrderedDict()


def world_of(space: ConfigurationSpace, cache: bool) -> World:
    """The roadmaps of a space, the same for every task in it."""
    key = space.fingerprint(), cache
    with _lock:
        if key not in _worlds:
            _worlds[key] = World(space, cache)
            while len(_worlds) > _REMEMBERED:
                _worlds.popitem(last=False)
        _worlds.move_to_end(key)
        return _worlds[key]
