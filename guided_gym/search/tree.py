"""The search tree T with its failed expansions (paper, Algorithm 1), as a struct of arrays."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import count, integer, number, shown, vector
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError
from guided_gym.kernels.extend import Failures, Nodes

if TYPE_CHECKING:
    from guided_gym.geometry.space import ConfigurationSpace
    from guided_gym.structures.nearest import GrowingIndex

NO_PARENT: Final = -1
_ROW: Final = 40  # bytes of a node and a failure, beside their configurations
ROOT: Final = 0

Floats = NDArray[np.float64]
Int32s = NDArray[np.int32]
_Array = TypeVar("_Array", bound=NDArray[Any])
_Rows = TypeVar("_Rows", Nodes, Failures)


def _readonly(array: _Array) -> _Array:
    view = array.view()
    view.flags.writeable = False
    return view


@doors
class SearchTree:
    """A tree of configurations rooted at the start, grown one node at a time in O(1).

    All properties are read-only views of the first ``len(tree)`` rows (or ``tree.failure_count`` rows);
    a view is stale after the next append.

    Attributes:
        nodes: The arrays of the nodes, spare rows included, as kernels and guiding spaces take them; another
            tuple once they have grown.
        failed: The arrays of the failed expansions, likewise.
        rewirings: How many edges were replaced so far.
        changes: How often it has changed: as long as this is the same, so is the tree.
        certified: Whether all edges are certified free; those of a planner that samples its motions are not.

    Args:
        space: The configuration space that the nodes live in.
        root: (d,) start configuration.
        capacity: Rows allocated at first; doubled when full.
    """

    def __init__(self, space: ConfigurationSpace, root: NDArray[np.float64], capacity: int = 256) -> None:
        d = space.dimension
        count("capacity", capacity, least=1, each=_ROW + 24 * d, what="a tree of so many nodes")
        root = vector("root", root, d)
        self.space = space
        self._n = 0
        self._failed = 0
        self.nodes = Nodes(
            np.zeros((capacity, d)),
            np.full(capacity, NO_PARENT, np.int32),
            np.zeros(capacity),
            np.zeros(capacity, np.int32),
            np.zeros(capacity, np.int32),
            np.zeros(capacity, np.int32),
        )
        self.failed = Failures(np.zeros(capacity, np.int32), np.zeros((capacity, d)), np.zeros((capacity, d)))
        self._index: GrowingIndex | None = None
        self.rewirings = 0
        self.changes = 0
        self.certified = True
        self._append(root, NO_PARENT, 0.0, 0)

    def __len__(self) -> int:
        return self._n

    def __repr__(self) -> str:
        return f"SearchTree({self._n} nodes, {self._failed} failed expansions, d={self.space.dimension})"

    @property
    def failure_count(self) -> int:
        """Number of failed expansions."""
        return self._failed

    @property
    def configurations(self) -> NDArray[np.float64]:
        """(n, d) configuration of each node."""
        return _readonly(self.nodes.configurations[: self._n])

    @property
    def parents(self) -> NDArray[np.int32]:
        """(n,) parent of each node, NO_PARENT at the root."""
        return _readonly(self.nodes.parents[: self._n])

    @property
    def cost_to_come(self) -> NDArray[np.float64]:
        """(n,) d_T(s, v): length of the tree path from the root."""
        return _readonly(self.nodes.costs[: self._n])

    @property
    def depths(self) -> NDArray[np.int32]:
        """(n,) edges from the root."""
        return _readonly(self.nodes.depths[: self._n])

    @property
    def children(self) -> NDArray[np.int32]:
        """(n,) number of children."""
        return _readonly(self.nodes.children[: self._n])

    @property
    def failures(self) -> NDArray[np.int32]:
        """(n,) number of failed expansions from each node."""
        return _readonly(self.nodes.failures[: self._n])

    @property
    def failed_nodes(self) -> NDArray[np.int32]:
        """(f,) node that each failed expansion started from."""
        return _readonly(self.failed.nodes[: self._failed])

    @property
    def failed_targets(self) -> NDArray[np.float64]:
        """(f, d) configuration that each failed expansion aimed at."""
        return _readonly(self.failed.targets[: self._failed])

    @property
    def contacts(self) -> NDArray[np.float64]:
        """(f, d) colliding configuration of each failed expansion: where its motion stopped being free."""
        return _readonly(self.failed.contacts[: self._failed])

    @property
    def index(self) -> GrowingIndex:
        """Nearest-neighbour index over the nodes, brought up to date when asked for."""
        if self._index is None:
            from guided_gym.structures.nearest import GrowingIndex

            self._index = GrowingIndex(self.space.metric)
        index = self._index
        known = len(index)
        if known + 1 == self._n:
            index.add(self.nodes.configurations[known])
        elif known < self._n:
            index.add_many(self.nodes.configurations[known : self._n])
        return index

    def nearest(self, q: NDArray[np.float64]) -> int:
        """Index of the node nearest to q; the lowest on ties.

        Raises:
            InvalidInputError: ``q`` is no configuration.
        """
        return int(self.index.nearest(self.space.configuration(q))[0])

    def check_node(self, node: int) -> None:
        """Refuse anything but a node of this tree: kernels would read beyond it.

        Raises:
            InvalidInputError: It is not one.
        """
        self._check(node)

    def _check(self, node: int) -> None:
        """`check_node` for what is called with each sample."""
        if not ((type(node) is int or isinstance(node, int | np.integer)) and 0 <= node < self._n):
            raise InvalidInputError(f"node: expected an integer, 0 to {self._n - 1}, got {shown(node)}")

    def _append(self, q: NDArray[np.float64], parent: int, cost: float, depth: int) -> int:
        i = self._n
        if i == self.nodes.parents.size:
            self.nodes = _doubled(self.nodes)
        configurations, parents, costs, depths, _, _ = self.nodes
        configurations[i], parents[i], costs[i], depths[i] = q, parent, cost, depth
        self._n = i + 1
        self.changes += 1
        return i

    def add(self, q: NDArray[np.float64], parent: int, length: float) -> int:
        """Append q as a child of ``parent`` over an edge of the given length; returns its index.

        Raises:
            InvalidInputError: There is no such node, ``q`` is not a configuration, or the length is not one.
        """
        self._check(parent)
        q = self.space.configuration(q)
        if not length >= 0:  # nor is NaN
            raise InvalidInputError(f"length: expected a number >= 0, got {shown(length)}")
        return self.enter(q, parent, length)

    def enter(self, q: NDArray[np.float64], parent: int, length: float) -> int:
        """`add` of what has been checked."""
        nodes = self.nodes
        child = self._append(q, parent, nodes.costs.item(parent) + length, nodes.depths.item(parent) + 1)
        self.nodes.children[parent] += 1  # other arrays, perhaps
        return child

    def add_failure(self, node: int, target: NDArray[np.float64], contact: NDArray[np.float64]) -> None:
        """Append (node, target) to the failed expansions; ``contact`` is the colliding configuration.

        Raises:
            InvalidInputError: There is no such node, or one of the two is no configuration.
        """
        self._check(node)
        self.enter_failure(node, self.space.configuration(target), self.space.configuration(contact))

    def enter_failure(self, node: int, target: NDArray[np.float64], contact: NDArray[np.float64]) -> None:
        """`add_failure` of what has been checked."""
        i = self._failed
        if i == self.failed.nodes.size:
            self.failed = _doubled(self.failed)
        self.failed.nodes[i] = node
        self.failed.targets[i] = target
        self.failed.contacts[i] = contact
        self.nodes.failures[node] += 1
        self._failed = i + 1
        self.changes += 1

    def path_to(self, node: int) -> NDArray[np.int32]:
        """(k,) node indices from the root to ``node``.

        Raises:
            InvalidInputError: There is no such node.
        """
        self._check(node)
        path = [node]
        while (node := int(self.nodes.parents[node])) != NO_PARENT:
            path.append(node)
        return np.array(path[::-1], np.int32)

    def rewire(self, node: int, parent: int, length: float) -> None:
        """Give ``node`` a new parent over an edge of the given length; its subtree's costs follow.

        The caller vouches that the edge is free and that ``parent`` is no descendant of ``node``.

        Raises:
            InvalidInputError: There is no such node, or the length is not one.
        """
        self._check(node)
        self._check(parent)
        number("length", length, least=0)
        if node == ROOT:
            raise InvalidInputError("node: expected one that has a parent, got the root")
        self.nodes.children[self.nodes.parents[node]] -= 1
        self.nodes.children[parent] += 1
        self.nodes.parents[node] = parent
        order: list[list[int]] = [[] for _ in range(self._n)]
        for child, p in enumerate(self.nodes.parents[: self._n].tolist()):
            if p != NO_PARENT:
                order[p].append(child)
        change = float(self.nodes.costs[parent]) + length - float(self.nodes.costs[node])
        deeper = int(self.nodes.depths[parent]) + 1 - int(self.nodes.depths[node])
        stack = [node]
        while stack:
            v = stack.pop()
            self.nodes.costs[v] += change
            self.nodes.depths[v] += deeper
            stack.extend(order[v])
        self.rewirings += 1
        self.changes += 1

    def reserve(self, extra: int) -> None:
        """Make room for that many more nodes and failures.

        Raises:
            InvalidInputError: No such number, or one that would take more memory than is allowed.
        """
        row = _ROW + 24 * self.space.dimension
        count("extra", extra, least=0, each=row, what="a tree of so many nodes")
        while self.nodes.parents.size < self._n + extra:
            self.nodes = _doubled(self.nodes)
        while self.failed.nodes.size < self._failed + extra:
            self.failed = _doubled(self.failed)

    def clone(self) -> SearchTree:
        """An independent copy of the tree; its index is built when it is asked for."""
        other = copy.copy(self)
        other.nodes, other.failed = _copied(self.nodes), _copied(self.failed)
        other._index = None
        return other

    def grown(self, nodes: int, failures: int) -> None:
        """Take in the nodes and failures that a kernel has written behind the last ones.

        Raises:
            InvalidInputError: There is no room for so many.
        """
        spare = self.nodes.parents.size - self._n, self.failed.nodes.size - self._failed
        for name, value, most in zip(("nodes", "failures"), (nodes, failures), spare, strict=True):
            if integer(name, value, least=0) > most:
                raise InvalidInputError(f"{name}: expected at most {most}, got {shown(value)}")
        self._n += nodes
        self._failed += failures
        self.changes += 1


def _copied(rows: _Rows) -> _Rows:
    """The same arrays, apart from these."""
    return type(rows)(*(array.copy() for array in rows))  # type: ignore[arg-type]


def _doubled(rows: _Rows) -> _Rows:
    """The same arrays with as many spare rows again."""
    return type(rows)(*(np.concatenate([array, np.zeros_like(array)]) for array in rows))  # type: ignore[arg-type]
