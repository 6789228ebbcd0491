"""Guiding spaces that solve nothing: S = {0}, and Voronoi cells (paper, Simple Examples)."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import integer, number
from guided_gym.guidance.base import GuidingSpace
from guided_gym.kernels.cells import assign_cells

if TYPE_CHECKING:
    from guided_gym.search.tree import SearchTree


class Uninformed(GuidingSpace):
    """S = {0}: a trivial projection; every node of the tree is equally likely."""

    name: ClassVar[str] = "uninformed"

    def __init__(self) -> None:
        super().__init__(expansion_penalty=0.0)

    def project(self, tree: SearchTree, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Everything projects to 0."""
        return np.zeros(len(q))

    def heuristic(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """The value 0."""
        return states

    def distribution(self, tree: SearchTree) -> NDArray[np.float64]:
        """Uniform over the tree."""
        return np.full(len(tree), 1.0 / len(tree))

    def select(self, tree: SearchTree) -> int:
        """A node drawn uniformly."""
        return int(self.rng.integers(len(tree)))

    def propose(self, tree: SearchTree, node: int) -> NDArray[np.float64]:
        """A configuration drawn uniformly from N_C(v)."""
        return self.planner.uniform(tree.nodes.configurations[node])


_BLOCK = 1024  # samples drawn at a time


class Voronoi(GuidingSpace):
    """RRT: h is inversely proportional to the volume of a node's Voronoi cell.

    Sampling stays as usual (a uniform sample selects its nearest node, which steers towards it), so the
    cells stay implicit. P is estimated from the share of a fixed set of uniform samples in each cell.

    Args:
        goal_bias: Probability of taking the goal for the sample.
        cell_samples: Samples behind the estimate of the cells' volumes.
    """

    name: ClassVar[str] = "rrt"

    def __init__(self, *, goal_bias: float = 0.0, cell_samples: int = 4096) -> None:
        super().__init__(expansion_penalty=0.0)
        self.goal_bias = number("goal_bias", goal_bias, least=0, below=1)
        self.cell_samples = integer("cell_samples", cell_samples, least=1)

    def prepare(self) -> None:
        """Nothing is drawn yet."""
        self._buffer = np.zeros((0, self.space.dimension))
        self._next = 0
        self._sample = self.goal
        self._selected = -1
        self._cells: _Cells | None = None

    def _draw(self) -> NDArray[np.float64]:
        """The next sample of C."""
        self._fill()
        self._next += 1
        sample: NDArray[np.float64] = self._buffer[self._next - 1]
        return sample

    def _fill(self) -> None:
        """Draw another block of samples, goals among them, where the last is used up; one by one is dear."""
        if self._next == len(self._buffer):
            self._buffer, self._next = self.space.sample(self.rng, _BLOCK), 0
            if self.goal_bias:
                self._buffer[self.rng.random(_BLOCK) < self.goal_bias] = self.goal

    def select(self, tree: SearchTree) -> int:
        """The node nearest to a sample of C."""
        self._sample = self._draw()
        self._selected = tree.nearest(self._sample)
        return self._selected

    def propose(self, tree: SearchTree, node: int) -> NDArray[np.float64]:
        """One step from the node towards the sample that selected it.

        For a node that somebody else selected, towards a sample from its Voronoi cell.
        """
        if node != self._selected:
            self._sample = self._sample_of_cell(tree, node)
        self._selected = -1
        return self.planner.steer(tree.nodes.configurations[node], self._sample)

    def burst(self, limit: int) -> NDArray[np.int32] | None:
        """RRT's loop, compiled, while nobody else listens to the search.

        Not for subclasses: they may select or propose otherwise.
        """
        if type(self) is not Voronoi or self.search.listeners != [self]:
            return None
        self._fill()
        samples = self._buffer[self._next : self._next + limit]
        rows = self.search.extend_towards(samples)
        self._next += len(rows)
        return rows

    def _sample_of_cell(self, tree: SearchTree, node: int) -> NDArray[np.float64]:
        for _ in range(32):
            sample = self._draw()
            if tree.nearest(sample) == node:
                return sample
        return self.planner.uniform(tree.nodes.configurations[node])

    def distribution(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) estimated share of C in the Voronoi cell of each node."""
        if self._cells is None:
            self._cells = _Cells(self, self.cell_samples)
        return (1 - self.goal_bias) * self._cells.volumes(tree) + self.goal_bias * _one_hot(
            tree.nearest(self.goal), len(tree)
        )

    def project(self, tree: SearchTree, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """The volume of the cell that each configuration falls in, as a share of C."""
        volumes = self.distribution(tree)
        return volumes[[tree.nearest(x) for x in np.ascontiguousarray(q)]]

    def heuristic(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """The inverse of the volume."""
        with np.errstate(divide="ignore"):
            return 1.0 / np.asarray(states)

    def values(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) inverse volume of each node's cell."""
        return self.heuristic(self.distribution(tree))


class _Cells:
    """Which node of a growing tree each of a fixed set of samples is nearest to."""

    def __init__(self, guidance: Voronoi, count: int) -> None:
        space = guidance.space
        # A stream of its own: estimating P must not change what RRT samples next.
        self._samples = space.sample(np.random.default_rng(count), count)
        self._metric = space.metric
        self._owner = np.zeros(count, np.int64)
        self._distance = np.full(count, np.inf)
        self._n = 0

    def volumes(self, tree: SearchTree) -> NDArray[np.float64]:
        assign_cells(
            self._samples,
            tree.nodes.configurations,
            self._n,
            len(tree),
            self._metric,
            self._owner,
            self._distance,
        )
        self._n = len(tree)
        return np.bincount(self._owner, minlength=self._n) / self._owner.size


def _one_hot(node: int, n: int) -> NDArray[np.float64]:
    p = np.zeros(n)
    p[node] = 1.0
    return p
