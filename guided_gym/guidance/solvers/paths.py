"""Stored paths of solved problems as a solver (paper, Experience-Based Guidance)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from guided_gym.checks import integer, number, shown
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.guidance.solvers.base import Floats, Query, require_body
from guided_gym.guidance.solvers.graph import Anchors, Graph, GraphCostToGo, Int32s, Ints
from guided_gym.kernels.waypoints import path_anchors
from guided_gym.storage.path_file import DatabaseHeader, PathDatabase
from guided_gym.storage.path_library import PathLibrary
from guided_gym.structures.nearest import GrowingIndex
from guided_gym.structures.shortest_paths import graph_from_edges

_SPACING: Final = 0.1  # of the natural length: waypoints no further apart than a failure reaches
_PREFILTER: Final = 4  # times as many similar tasks that a dearer measure of similarity chooses from


class StoredPaths(GraphCostToGo):
    """The lengths of stored paths of similar problems: a graph of chains, each on to this goal.

    A node is joined to the waypoints within one step that a free motion reaches. A failure that forbids
    filters out whole paths, those that pass near it; when all of a query are gone, the next most similar are
    queried.

    Args:
        database: A `PathLibrary`, or the file that ``guided-gym database build`` wrote.
        paths: Use only the first so many paths of the database; None for all.
        similar: Paths per query.
        by: How similar paths are found: ``"task"`` (start and goal), ``"dtw"`` (dynamic time warping between
            a path and the straight line from start to goal) or ``"occupancy"`` (paths of which the least lies
            in the obstacles of this workspace).
        mixture: 0 for the shortest of the paths that a state is joined to; else the temperature (in natural
            lengths) at which all of them count, as the components of a mixture.
    """

    def __init__(
        self,
        *,
        database: PathLibrary | str | Path | None = None,
        paths: int | None = None,
        similar: int = 128,
        by: str = "task",
        mixture: float = 0.0,
    ) -> None:
        if database is None:
            raise InvalidInputError(
                "stored paths: expected a database of paths (database=FILE), got none; "
                "`guided-gym database build ENV --paths N` makes one"
            )
        if paths is not None:
            paths = integer("paths", paths, least=0)
        self._header: DatabaseHeader | None = None
        if isinstance(database, str | Path):
            with PathDatabase.open(database, readonly=True) as store:
                self._file, self._header = str(database), store.header
                database = store.load(paths)
        elif not hasattr(database, "most_similar"):
            raise InvalidInputError(f"database: expected a file or a PathLibrary, got {shown(database)}")
        elif paths is not None:
            database = database.subset(paths)
        self.library: PathLibrary = database
        self.similar = integer("similar", similar, least=1)
        if by not in RETRIEVAL:
            raise UnknownNameError("by", by, RETRIEVAL)
        self.by = by
        self.mixture = number("mixture", mixture, least=0)

    def begin(self, query: Query, rng: np.random.Generator, step: float) -> None:
        """Query the first paths.

        Raises:
            InvalidInputError: Paths of another dimension, robot or metric.
        """
        require_body("stored paths", query)
        if self.library.dimension != query.space.dimension:
            raise InvalidInputError(
                f"stored paths: expected paths of dimension {query.space.dimension}, "
                f"got {self.library.dimension}"
            )
        if self._header is not None:
            self._header.require(self._header.for_space("", query.space), self._file)
        self.queried = self.filtered = 0
        super().begin(query, rng, step)

    def build(self) -> Graph:
        """The graph of the next most similar paths: a chain for each, on to the goal."""
        space, goal = self.query.space, self.query.goal
        wanted = min(self.queried + self.similar, len(self.library))
        found = RETRIEVAL[self.by](self.library, self.query, wanted) if wanted else np.zeros(0, np.int64)
        ids = found[self.queried :]
        self.queried = wanted
        rows, self._path_of = self._resampled([self.library.path(int(i)) for i in ids])
        points = np.vstack([rows, goal])
        end = len(points) - 1
        edges = np.stack([np.arange(end), np.arange(1, end + 1)], axis=1)
        edges[self._path_of[edges[:, 0]] != self._path_of[edges[:, 1]], 1] = end
        lengths = np.atleast_1d(space.distance(points[edges[:, 0]], points[edges[:, 1]]))
        self._alive = np.bincount(self._path_of[:end], minlength=len(ids)) > 0
        self._index = GrowingIndex(space.metric)
        self._index.add_many(points[:end])
        return Graph(points, graph_from_edges(len(points), edges, lengths), end)

    def _resampled(self, paths: list[Floats]) -> tuple[Floats, Int32s]:
        """The paths on to the goal, with waypoints no further apart than a failure reaches.

        On to the goal: what joins a path to it is to be filtered like the path itself.

        Returns:
            (w, d) waypoints without the goal, and (w + 1,) the path of each; the goal has its own number.
        """
        space, goal = self.query.space, self.query.goal
        corners = np.vstack([*(np.vstack([path, goal]) for path in paths), goal])
        owner = np.repeat(np.arange(len(paths) + 1), [*(len(path) + 1 for path in paths), 1])
        lengths = space.distance(corners[:-1], corners[1:])
        counts = np.ceil(lengths / (_SPACING * space.scale)).astype(np.int64)
        counts[owner[:-1] != owner[1:]] = 0
        segment = np.repeat(np.arange(len(counts)), counts)
        first = np.repeat(np.cumsum(counts) - counts, counts)
        t = (np.arange(len(segment)) - first) / counts[segment]
        rows = space.interpolate(corners[segment], corners[segment + 1], t)
        return rows, np.append(owner[segment], len(paths)).astype(np.int32)

    def anchor(self, states: Floats) -> Anchors:
        """Join each state to the best waypoints within one step, on different paths."""
        spread = float(np.max(self.query.space.distance(states, states[0])))
        near = self._index.within(states[0], spread + self.step)
        vertices, lengths = path_anchors(
            states, near, self.graph.points, self._path_of, self.graph.distance, self.step, 8,
            self.query.space.metric,
        )  # fmt: skip
        return Anchors(vertices, lengths, np.full(vertices.shape, -1, np.int32))

    def joined(self, states: Floats) -> Anchors:
        """Join each node to waypoints that it can see: these anchors are validated."""
        anchors = self.anchor(states)
        rows, columns = np.nonzero(anchors.vertices >= 0)
        if rows.size:
            ends = self.graph.points[anchors.vertices[rows, columns]]
            free = self.query.space.motions_free(states[rows], ends)
            self.looks += free.size
            anchors.lengths[rows[~free], columns[~free]] = np.inf
        return anchors

    def _charge(self, states: Floats, anchors: Anchors) -> None:
        """Nothing: anchors are validated, and paths that pass near a failure are gone."""

    def _values(self, anchors: Anchors, rows: Ints) -> Floats:
        """The shortest of the paths, or what a mixture of them expects."""
        least = super()._values(anchors, rows)
        if self.mixture == 0:
            return least
        vertices = anchors.vertices[rows]
        costs = np.where(vertices >= 0, anchors.lengths[rows] + self.graph.distance[vertices], np.inf)
        unit = self.mixture * self.query.space.scale
        with np.errstate(invalid="ignore"):
            weights = np.exp(-(costs - least[:, None]) / unit)
            expected = np.nansum(np.where(weights > 0, weights * costs, 0.0), axis=1) / np.nansum(
                weights, axis=1
            )
        return np.where(np.isfinite(least), expected, np.inf)

    def follow(self, states: Floats) -> Floats:
        """(n,) cost-to-go of the nodes; queries further while all queried paths are filtered out."""
        while not self._alive.any() and self.queried < len(self.library):
            self._renew(1.0)
        return super().follow(states)

    def raise_near(self, state: Floats, reach: float, factor: float) -> None:
        """Lengthen the edges near a state; an infinite factor filters out the paths that pass there."""
        self.taught.add(state, reach, factor)
        if np.isfinite(factor):
            self.graph.raise_edges(self.edges_near(state, reach), factor)
        else:
            self._filter(self._index.within(state, reach))

    def _discard(self, vertices: Ints, bad: np.ndarray) -> None:
        """Filter out the paths that have an invalid waypoint."""
        self._filter(vertices[bad])

    def _filter(self, waypoints: Ints) -> None:
        struck = np.unique(self._path_of[waypoints])
        struck = struck[self._alive[struck]]
        if struck.size == 0:
            return
        self._alive[struck] = False
        self.filtered += struck.size
        on_struck = np.isin(self._path_of[self.graph.edges[:, 0]], struck)
        self.graph.raise_edges(np.flatnonzero(on_struck), np.inf)
        if self._nodes is not None:
            self._look_again()

    def _look_again(self) -> None:
        """Join anew the nodes that saw only paths which are gone."""
        nodes = self._nodes
        assert nodes is not None
        n = len(nodes)
        had = (nodes.anchors.vertices[:n] >= 0).any(axis=1)
        blind = np.flatnonzero(had & ~np.isfinite(super()._values(nodes.anchors, np.arange(n))))
        for i in blind:  # one by one: `anchor` looks around the first of a batch
            row = np.array([i])
            nodes.replace(row, self.joined(nodes.states(row)))

    def vertices_near(self, state: Floats, reach: float) -> Ints:
        """Waypoints within ``reach`` of a state."""
        return self._index.within(state, reach)


def _by_task(library: PathLibrary, query: Query, count: int) -> Ints:
    """Paths whose start and goal are nearest to these."""
    return library.most_similar(query.start, query.goal, count)


def _by_warping(library: PathLibrary, query: Query, count: int) -> Ints:
    """Paths that dynamic time warping finds nearest to the straight line from start to goal."""
    from guided_gym.guidance.solvers.warping import warped

    ids = library.most_similar(query.start, query.goal, min(_PREFILTER * count, len(library)))
    line = query.space.interpolate(query.start, query.goal, np.linspace(0.0, 1.0, 32))
    costs = [warped(library.path(int(i)) * query.space.weights, line * query.space.weights) for i in ids]
    return ids[np.argsort(costs, kind="stable")[:count]]


def _by_occupancy(library: PathLibrary, query: Query, count: int) -> Ints:
    """Of paths of similar tasks, those of which the least lies in obstacles of this workspace."""
    ids = library.most_similar(query.start, query.goal, min(_PREFILTER * count, len(library)))
    blocked = []
    for i in ids:
        path = library.path(int(i))
        t = np.linspace(0.0, 1.0, 8)[:, None]
        inner = query.space.interpolate(path[:-1], path[1:], np.broadcast_to(t, (8, len(path) - 1)))
        clearance = query.space.environment.clearance(
            query.space.robot.position(inner.reshape(-1, path.shape[1]))
        )
        blocked.append(float(np.mean(clearance <= 0.0)))
    return ids[np.argsort(blocked, kind="stable")[:count]]


RETRIEVAL: Final[dict[str, Callable[[PathLibrary, Query, int], Ints]]] = {
    "task": _by_task,
    "dtw": _by_warping,
    "occupancy": _by_occupancy,
}
