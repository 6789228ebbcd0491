"""A guided search as a solver: S is searched itself, guided by another guiding space (paper, hierarchy)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import integer, shown
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.cells import Voronoi
from guided_gym.guidance.solvers.base import Floats, require_body
from guided_gym.guidance.solvers.graph import Anchors, Graph, GraphCostToGo, Ints
from guided_gym.problems import Problem, Task
from guided_gym.search.search import Search
from guided_gym.search.tree import SearchTree
from guided_gym.structures.nearest import GrowingIndex
from guided_gym.structures.shortest_paths import graph_from_edges, nearest_graph


class Searched(GraphCostToGo):
    """The costs of a search tree that grows from the goal of the easier problem, under its own guidance.

    Where that search has found the start, RRT goes on in its place, so that other ways are known when the
    first fails. The nodes are joined to their neighbours, too: failures in C lengthen the edges, and a tree
    has no detours.

    Args:
        guidance: Who guides the search in C' = (r', E').
        samples: Samples of that search.
        neighbours: Nodes that each of them is joined to, where the motion is free.
        anchors: Nodes that a state is joined to: where the motion is free, or, where the tree does not reach,
            by nearness alone.
    """

    def __init__(
        self, guidance: GuidingSpace, *, samples: int = 1000, neighbours: int = 12, anchors: int = 8
    ) -> None:
        if not isinstance(guidance, GuidingSpace):
            raise InvalidInputError(f"guidance: expected a guiding space, got {shown(guidance)}")
        self.guidance = guidance
        self.samples = integer("samples", samples, least=1)
        self.neighbours = integer("neighbours", neighbours, least=1)
        self.anchors = integer("anchors", anchors, least=1)

    def build(self) -> Graph:
        """Search from the goal; where the start or the goal is in collision, no state has a way.

        Raises:
            InvalidInputError: No space of a body.
        """
        require_body("searched", self.query)
        space, start, goal = self.query[:3]
        points, edges, lengths = goal[None], np.zeros((0, 2), np.int32), np.zeros(0)
        if space.valid(goal) and space.valid(start):
            tree = self._search()
            points = np.array(tree.configurations)
            near = nearest_graph(points, space.metric, self.neighbours)
            free = self._free(points[near.edges[:, 0]], points[near.edges[:, 1]])
            grown = np.stack([np.arange(1, len(tree), dtype=np.int32), tree.parents[1:]], axis=1)
            ways = tree.cost_to_come[1:] - tree.cost_to_come[tree.parents[1:]]
            edges = np.vstack([near.edges[free], grown])
            lengths = np.append(near.lengths[free], np.maximum(ways, 0.0))
        self._index = GrowingIndex(space.metric, capacity=len(points))
        self._index.add_many(points)
        return Graph(points, graph_from_edges(len(points), edges, lengths), 0)

    def _search(self) -> SearchTree:
        """The tree that grows from the goal."""
        space, start, goal = self.query[:3]
        # By nearness alone, so that the search does not end where it sees the start.
        task = Task(goal, start, tolerance=1e-6 * space.extent, by_edge=False)
        problem = Problem(space.robot, space.environment, task, rotation_weight=space.rotation_weight)
        expansion, choice = self.rng.spawn(2)
        search = Search(problem, expansion, choice)
        search.attach(self.guidance)
        search.run(self.guidance, self.samples)
        rest = Voronoi()
        search.listeners.clear()
        search.attach(rest)
        search.run(rest, self.samples, stop=lambda: False)
        self.looks += search.collision_checks
        return search.tree

    def _free(self, starts: Floats, ends: Floats) -> NDArray[np.bool_]:
        """(n,) which motions are free in C'."""
        self.looks += len(starts)
        return self.query.space.motions_free(starts, ends)

    def anchor(self, states: Floats) -> Anchors:
        """Join each state to the nearest nodes of the tree: where the motion is free, if any of them is."""
        ids, lengths = self._index.k_nearest_many(states, min(self.anchors, len(self._index)))
        vertices = ids.astype(np.int32)
        starts = np.repeat(np.ascontiguousarray(states), vertices.shape[1], axis=0)
        free = self._free(starts, self.graph.points[vertices.ravel()]).reshape(lengths.shape)
        if len(self._index) > 1:  # else nobody has a way: the start or the goal is in collision
            free |= ~free.any(axis=1, keepdims=True)
        return Anchors(vertices, np.where(free, lengths, np.inf), np.full(vertices.shape, -1, np.int32))

    def vertices_near(self, state: Floats, reach: float) -> Ints:
        """Nodes of the tree within ``reach`` of a state."""
        return self._index.within(state, reach)
