"""Environment modification, S = (r, E'): roadmaps that see fewer obstacles (paper, Section 4.2)."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import integer, number
from guided_gym.guidance.solvers.roadmap import Anchors, Roadmap, RoadmapGuidance
from guided_gym.kernels.anchors import drop_anchors
from guided_gym.structures.nearest import GrowingIndex
from guided_gym.structures.segments import SegmentIndex
from guided_gym.structures.shortest_paths import nearest_graph

if TYPE_CHECKING:
    from guided_gym.search.search import Expansion
    from guided_gym.search.tree import SearchTree

_REBUILDS = 6  # each roadmap has half as many vertices again: where no path exists, there must be a last one


class SampledRoadmap(RoadmapGuidance):
    """A roadmap of uniform samples of C, joined to their nearest neighbours.

    Args:
        vertices: Number of samples.
        neighbours: Edges from each vertex to its nearest neighbours.
        anchors: Roadmap vertices that a configuration is joined to.
        temperature: See `GuidingSpace`.
        expansion_penalty: See `GuidingSpace`.
    """

    def __init__(
        self,
        *,
        vertices: int = 2000,
        neighbours: int = 12,
        anchors: int = 8,
        temperature: float = 0.0,
        expansion_penalty: float = 0.1,
    ) -> None:
        super().__init__(temperature=temperature, expansion_penalty=expansion_penalty)
        self.vertices = integer("vertices", vertices, least=1)
        self.neighbours = integer("neighbours", neighbours, least=1)
        self.anchor_count = integer("anchors", anchors, least=1)

    def samples(self, count: int) -> NDArray[np.float64]:
        """(count + 1, d) vertices, the goal last."""
        return np.vstack([self.space.sample(self.rng, count), self.goal])

    def build(self) -> Roadmap:
        """Sample the vertices and join each to its nearest neighbours."""
        return self.sampled(self.vertices)

    def sampled(self, count: int) -> Roadmap:
        """A roadmap of that many vertices."""
        points = self.samples(count)
        graph = nearest_graph(points, self.space.metric, self.neighbours)
        self._index = GrowingIndex(self.space.metric)
        self._index.add_many(points)
        return Roadmap(points, graph, len(points) - 1)

    def anchor(self, q: NDArray[np.float64]) -> Anchors:
        """Join each configuration to its nearest vertices."""
        count = min(self.anchor_count, len(self._index))
        vertices, lengths = self._index.k_nearest_many(q, count)
        return Anchors(vertices.astype(np.int32), lengths, np.full(vertices.shape, -1, np.int32))


class PRM(SampledRoadmap):
    """A probabilistic roadmap in C: vertices and edges are validated before the search, anchors when used.

    E' = E: the preprocessing is what a search over many tasks in one C would share.
    """

    name: ClassVar[str] = "prm"

    def samples(self, count: int) -> NDArray[np.float64]:
        """(<= count + 1, d) valid vertices, the goal last; fewer only if C_free is tiny."""
        kept: list[NDArray[np.float64]] = []
        for _ in range(20):
            drawn = self.space.sample(self.rng, count)
            kept.append(drawn[self.space.valid(drawn)])
            if sum(map(len, kept)) >= count:
                break
        return np.vstack([np.concatenate(kept)[:count], self.goal])

    def build(self) -> Roadmap:
        """Build the roadmap and remove the edges whose motion is not free."""
        roadmap = super().build()
        a, b = roadmap.points[roadmap.edges[:, 0]], roadmap.points[roadmap.edges[:, 1]]
        roadmap.remove(np.flatnonzero(~self.space.motions_free(a, b)).astype(np.int32))
        return roadmap

    def anchor(self, q: NDArray[np.float64]) -> Anchors:
        """Join each configuration to the nearest vertices that a free motion reaches."""
        anchors = super().anchor(q)
        starts = np.repeat(q, anchors.vertices.shape[1], axis=0)
        free = self.space.motions_free(starts, self.roadmap.points[anchors.vertices.ravel()])
        self.search.collision_checks += free.size
        anchors.lengths[~free.reshape(anchors.lengths.shape)] = np.inf
        return anchors


class LazyPRM(SampledRoadmap):
    """A roadmap that ignores all obstacles: E' is empty at first, and learns from every collision.

    A failed expansion removes the edges that pass within ``radius`` of the colliding configuration, and the
    anchors that do: the connection of a node to the roadmap is as unvalidated as the roadmap itself. It also
    has the vertices within ``check`` looked at, and those in collision removed. When nothing leads to the
    goal any more, the roadmap is built anew with more vertices and a smaller radius, and all collisions so
    far are applied to it.

    Args:
        radius: A collision deletes the edges and anchors that pass this near, in units of the local
            planner's step.
        check: A collision has the vertices this near validated, in the same units.
        vertices: Number of vertices.
        neighbours: Edges from each vertex to its nearest neighbours.
        anchors: Roadmap vertices that a configuration is joined to.
        temperature: See `GuidingSpace`.
        expansion_penalty: See `GuidingSpace`.
    """

    name: ClassVar[str] = "lazy_prm"

    def __init__(
        self,
        *,
        radius: float = 0.1,
        check: float = 1.5,
        vertices: int = 2000,
        neighbours: int = 12,
        anchors: int = 8,
        temperature: float = 0.0,
        expansion_penalty: float = 0.1,
    ) -> None:
        super().__init__(
            vertices=vertices,
            neighbours=neighbours,
            anchors=anchors,
            temperature=temperature,
            expansion_penalty=expansion_penalty,
        )
        self.radius = number("radius", radius, above=0)
        self.check = number("check", check, above=0)

    def prepare(self) -> None:
        """Build the first roadmap."""
        self.rebuilds = 0
        self._reach = self.radius * self.planner.step
        self._contacts = GrowingIndex(self.space.metric)
        super().prepare()

    def build(self) -> Roadmap:
        """Build the roadmap and index its edges."""
        roadmap = self.sampled(int(self.vertices * 1.5**self.rebuilds))
        self._segments = SegmentIndex(roadmap.points, roadmap.edges, self.space.metric)
        return roadmap

    def project(self, tree: SearchTree, q: NDArray[np.float64]) -> Anchors:  # type: ignore[override]
        """P_T: nearest vertices, without the anchors that pass near a known collision."""
        q = np.ascontiguousarray(q)
        anchors = self.anchor(q)
        near = self._contacts_near(q, float(anchors.lengths.max()))
        if len(near):
            drop_anchors(
                q, np.arange(len(q)), anchors.vertices, anchors.lengths, self.roadmap.points, near,
                self._reach, self.space.metric,
            )  # fmt: skip
        return anchors

    def _contacts_near(self, q: NDArray[np.float64], longest: float) -> NDArray[np.float64]:
        """Known collisions that could matter to anchors of that length from configurations near q[0]."""
        if len(self._contacts) == 0:
            return self._contacts.points[:0]
        if len(q) > 4 * self.planner.candidate_count:
            return np.array(self._contacts.points)
        spread = float(self.space.distance(q, q[0]).max())
        return self._contacts.points[self._contacts.within(q[0], spread + longest + self._reach)]

    def feedback(self, expansion: Expansion) -> None:
        """Delete what passes near the collision."""
        if expansion.contact is None:
            return
        self._contacts.add(expansion.contact)
        self._learn(expansion.contact)
        self.drop_near(self.search.tree, expansion.contact, self._reach)

    def _learn(self, contact: NDArray[np.float64]) -> None:
        edges = self._segments.within(contact, self._reach)
        if len(edges):
            self.roadmap.remove(np.asarray(edges, np.int32))
        bad = self.invalid_near(self._index, contact, self.check * self.planner.step)
        if len(bad):
            self.roadmap.remove_vertices(bad)

    def select(self, tree: SearchTree) -> int:
        """Argmin h; where nothing leads to the goal any more, on a new and finer roadmap.

        After the finest, every node is as good as another.
        """
        while self.rebuilds < _REBUILDS and not np.isfinite(self.values(tree).min()):
            self._renew()
        return super().select(tree)

    def _renew(self) -> None:
        self.rebuilds += 1
        self._reach = self.radius * self.planner.step * 0.5**self.rebuilds
        self.roadmap = self.build()
        self.forget()
        for contact in self._contacts.points:
            self._learn(contact)
