"""Experience-based guidance: paths of solved problems guide the next one (paper, Section 4.3)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import integer, number
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.cells import Voronoi
from guided_gym.guidance.solvers.roadmap import AnchoredNodes, Anchors, Roadmap, RoadmapGuidance
from guided_gym.kernels.waypoints import path_anchors
from guided_gym.structures.nearest import GrowingIndex
from guided_gym.structures.shortest_paths import graph_from_edges

if TYPE_CHECKING:
    from guided_gym.search.search import Expansion
    from guided_gym.search.tree import SearchTree
    from guided_gym.storage.path_file import DatabaseHeader
    from guided_gym.storage.path_library import PathLibrary


class PathDatabase(RoadmapGuidance):
    """Lightning refactored: h is the length of a stored path, from the tasks most similar to this one.

    The queried paths are a roadmap of chains. A node is anchored to the waypoints within one step that a free
    motion reaches. Paths that pass within ``radius`` of a colliding configuration are filtered out; when all
    of a query are, the next most similar tasks are queried. While no node sees a path, RRT guides.

    Args:
        database: A `PathLibrary`, or the file that ``guided-gym database build`` wrote.
        paths: Use only the first so many paths of the database; None for all.
        similar: Paths a query.
        radius: A collision filters out the paths that pass this near, in units of the local planner's step.
        check: A collision has the waypoints this near validated, in the same units; a path with one in
            collision is filtered out.
        temperature: See `GuidingSpace`.
        expansion_penalty: See `GuidingSpace`.
    """

    name: ClassVar[str] = "path_database"

    def __init__(
        self,
        *,
        database: PathLibrary | str | Path | None = None,
        paths: int | None = None,
        similar: int = 128,
        radius: float = 0.1,
        check: float = 2.5,
        temperature: float = 0.0,
        expansion_penalty: float = 0.1,
    ) -> None:
        super().__init__(temperature=temperature, expansion_penalty=expansion_penalty)
        if database is None:
            raise InvalidInputError(
                "path_database: expected a database of paths (database=FILE), got none; "
                "`guided-gym database build ENV --paths N` makes one"
            )
        if paths is not None:
            paths = integer("paths", paths, least=0)
        self._header: DatabaseHeader | None = None
        if isinstance(database, str | Path):
            from guided_gym.storage.path_file import PathDatabase as Store

            with Store.open(database, readonly=True) as store:
                self._file, self._header = str(database), store.header
                database = store.load(paths)
        elif not hasattr(database, "most_similar"):
            raise InvalidInputError(f"database: expected a file or a PathLibrary, got {database!r}")
        elif paths is not None:
            database = database.subset(paths)
        self.library: PathLibrary = database
        self.similar = integer("similar", similar, least=1)
        self.radius = number("radius", radius, above=0)
        self.check = number("check", check, above=0)
        self._fallback = Voronoi()

    def prepare(self) -> None:
        """Query the first paths."""
        if self.library.dimension != self.space.dimension:
            raise InvalidInputError(
                f"path_database: expected paths of dimension {self.space.dimension}, "
                f"got {self.library.dimension}"
            )
        if self._header is not None:
            self._header.require(self._header.for_space("", self.space), self._file)
        self.queried = 0
        self.filtered = 0
        self._fallback.reset(self.search)
        self._contacts: list[NDArray[np.float64]] = []
        super().prepare()

    def build(self) -> Roadmap:
        """The roadmap of the next most similar tasks' paths: a chain per path, on to the goal."""
        start, goal = self.search.start, self.goal
        wanted = min(self.queried + self.similar, len(self.library))
        ids = self.library.most_similar(start, goal, wanted)[self.queried :] if wanted else np.zeros(0, int)
        self.queried = wanted
        rows, self._path_of = self._resampled([self.library.path(int(i)) for i in ids])
        points = np.vstack([rows, goal])
        end = len(points) - 1
        edges = np.stack([np.arange(end), np.arange(1, end + 1)], axis=1)
        edges[self._path_of[edges[:, 0]] != self._path_of[edges[:, 1]], 1] = end
        lengths = np.atleast_1d(self.space.distance(points[edges[:, 0]], points[edges[:, 1]]))
        self._alive = np.bincount(self._path_of[:end], minlength=len(ids)) > 0
        self._index = GrowingIndex(self.space.metric)
        self._index.add_many(points[:end])
        return Roadmap(points, graph_from_edges(len(points), edges, lengths), end)

    def _resampled(self, paths: list[NDArray[np.float64]]) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        """The paths on to the goal, with waypoints no further apart than a collision reaches.

        On to the goal: what joins a path to it is to be filtered like the path itself.

        Returns:
            (w, d) waypoints without the goal, and (w + 1,) the path of each; the goal has its own number.
        """
        corners = np.vstack([*(np.vstack([path, self.goal]) for path in paths), self.goal])
        owner = np.repeat(np.arange(len(paths) + 1), [*(len(path) + 1 for path in paths), 1])
        lengths = self.space.distance(corners[:-1], corners[1:])
        counts = np.ceil(lengths / (self.radius * self.planner.step)).astype(np.int64)
        counts[owner[:-1] != owner[1:]] = 0
        segment = np.repeat(np.arange(len(counts)), counts)
        first = np.repeat(np.cumsum(counts) - counts, counts)
        t = (np.arange(len(segment)) - first) / counts[segment]
        rows = self.space.interpolate(corners[segment], corners[segment + 1], t)
        return rows, np.append(owner[segment], len(paths)).astype(np.int32)

    def anchor(self, q: NDArray[np.float64]) -> Anchors:
        """Join each configuration to the best waypoints within one step, on different paths."""
        reach = self.planner.step
        spread = float(np.max(self.space.distance(q, q[0])))
        near = self._index.within(q[0], spread + reach)
        vertices, lengths = path_anchors(
            q, near, self.roadmap.points, self._path_of, self.roadmap.distance, reach, 8,
            self.space.metric,
        )  # fmt: skip
        return Anchors(vertices, lengths, np.full(vertices.shape, -1, np.int32))

    def project(self, tree: SearchTree, q: NDArray[np.float64]) -> Anchors:  # type: ignore[override]
        """P_T: the waypoints that each node of the tree can see (its anchors are validated)."""
        anchors = self.anchor(np.ascontiguousarray(q))
        rows, columns = np.nonzero(anchors.vertices >= 0)
        if rows.size:
            free = self.space.motions_free(q[rows], self.roadmap.points[anchors.vertices[rows, columns]])
            self.search.collision_checks += free.size
            anchors.lengths[rows[~free], columns[~free]] = np.inf
        return anchors

    def feedback(self, expansion: Expansion) -> None:
        """Filter out the paths that pass near the collision."""
        if expansion.contact is not None:
            self._contacts.append(expansion.contact)
            self._filter(expansion.contact)
        self._fallback.feedback(expansion)

    def _filter(self, contact: NDArray[np.float64]) -> None:
        step = self.planner.step
        near = self._index.within(contact, self.radius * step)
        bad = self.invalid_near(self._index, contact, self.check * step)
        struck = np.unique(self._path_of[np.concatenate([near, bad])])
        struck = struck[self._alive[struck]]
        if struck.size == 0:
            return
        self._alive[struck] = False
        self.filtered += struck.size
        on_struck = np.isin(self._path_of[self.roadmap.edges[:, 0]], struck)
        self.roadmap.remove(np.flatnonzero(on_struck).astype(np.int32))
        if self._anchored is not None:
            self._look_again(self._anchored)

    def _look_again(self, nodes: AnchoredNodes) -> None:
        """Anchor anew the nodes that saw only paths which are gone."""
        n = len(nodes)
        had = (nodes.anchors.vertices[:n] >= 0).any(axis=1)
        blind = np.flatnonzero(had & ~np.isfinite(self._values_at(np.arange(n))))
        for i in blind:  # one by one: `anchor` looks around the first of a batch
            tree = self.search.tree
            nodes.replace(np.array([i]), self.project(tree, tree.nodes.configurations[i : i + 1]))
        nodes.stale(blind)

    def _sighted(self, tree: SearchTree) -> bool:
        """Whether some node sees a path; queries further while all queried paths are filtered out."""
        while not self._alive.any() and self.queried < len(self.library):
            self.roadmap = self.build()
            self.forget()
            for contact in self._contacts:
                self._filter(contact)
        return bool(np.isfinite(self.values(tree)).any())

    def select(self, tree: SearchTree) -> int:
        """Argmin h, or RRT's choice while no node sees a path."""
        return super().select(tree) if self._sighted(tree) else self._fallback.select(tree)

    def distribution(self, tree: SearchTree) -> NDArray[np.float64]:
        """One-hot at argmin h (softmin with a temperature), or RRT's P while no node sees a path."""
        return super().distribution(tree) if self._sighted(tree) else self._fallback.distribution(tree)

    def propose(self, tree: SearchTree, node: int) -> NDArray[np.float64]:
        """The candidate with the least h, or RRT's step while the node sees no path."""
        if not np.isfinite(self.values(tree)[node]):
            return self._fallback.propose(tree, node)
        candidates = self.planner.candidates(tree.nodes.configurations[node])
        best: NDArray[np.float64] = candidates[np.argmin(self.heuristic(self.anchor(candidates)))]
        return best
