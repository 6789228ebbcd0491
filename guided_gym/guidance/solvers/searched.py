"""A guided search as a solver: S is searched itself, guided by another guiding space (paper, hierarchy)."""

from __future__ import annotations

import numpy as np

from guided_gym.checks import integer, shown
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.solvers.base import Floats, require_body
from guided_gym.guidance.solvers.graph import Anchors, Graph, GraphCostToGo, Ints
from guided_gym.problems import Problem, Task
from guided_gym.search.search import Search
from guided_gym.structures.nearest import GrowingIndex
from guided_gym.structures.shortest_paths import graph_from_edges


class Searched(GraphCostToGo):
    """The costs of a search tree that grows from the goal of the easier problem, under its own guidance.

    The tree is a graph: failures in C lengthen its edges. Where it does not reach, the way to its nearest
    nodes counts.

    Args:
        guidance: Who guides the search in C' = (r', E').
        samples: Samples of that search; it goes on when it has found the start, so that more is known.
        anchors: Nodes of the tree that a state is joined to.
    """

    def __init__(self, guidance: GuidingSpace, *, samples: int = 1000, anchors: int = 8) -> None:
        if not isinstance(guidance, GuidingSpace):
            raise InvalidInputError(f"guidance: expected a guiding space, got {shown(guidance)}")
        self.guidance = guidance
        self.samples = integer("samples", samples, least=1)
        self.anchors = integer("anchors", anchors, least=1)

    def build(self) -> Graph:
        """Search from the goal; where the start or the goal is in collision, no state has a way.

        Raises:
            InvalidInputError: No space of a body.
        """
        require_body("searched", self.query)
        space, start, goal = self.query[:3]
        points, edges, lengths = goal[None], np.zeros((0, 2), np.int32), np.zeros(0)
        self._open = bool(space.valid(goal)) and bool(space.valid(start))
        if self._open:
            # By nearness alone, so that the search does not end where it sees the start.
            task = Task(goal, start, tolerance=1e-6 * space.extent, by_edge=False)
            problem = Problem(space.robot, space.environment, task, rotation_weight=space.rotation_weight)
            expansion, choice = self.rng.spawn(2)
            search = Search(problem, expansion, choice)
            search.attach(self.guidance)
            search.run(self.guidance, self.samples)
            tree = search.tree
            self.looks += search.collision_checks
            points = np.array(tree.configurations)
            edges = np.stack([np.arange(1, len(tree), dtype=np.int32), tree.parents[1:]], axis=1)
            lengths = tree.cost_to_come[1:] - tree.cost_to_come[tree.parents[1:]]
        self._index = GrowingIndex(space.metric, capacity=len(points))
        self._index.add_many(points)
        return Graph(points, graph_from_edges(len(points), edges, np.maximum(lengths, 0.0)), 0)

    def anchor(self, states: Floats) -> Anchors:
        """Join each state to the nearest nodes of the tree."""
        ids, lengths = self._index.k_nearest_many(states, min(self.anchors, len(self._index)))
        vertices = ids.astype(np.int32)
        return Anchors(vertices, lengths, np.full(vertices.shape, -1, np.int32))

    def vertices_near(self, state: Floats, reach: float) -> Ints:
        """Nodes of the tree within ``reach`` of a state."""
        return self._index.within(state, reach)
