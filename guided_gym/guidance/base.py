"""The guiding space S: a projection P_T and a heuristic h, and the distribution they induce over T."""

from __future__ import annotations

import importlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import number, shown
from guided_gym.doors import door
from guided_gym.errors import InvalidInputError

if TYPE_CHECKING:
    from guided_gym.search.search import Expansion, Search
    from guided_gym.search.tree import SearchTree


# By name: pictures stand above guiding spaces.
_NOTEBOOK: Final = "guided_gym.display.notebook"


class GuidingSpace(ABC):
    """A guiding space S: a projection P_T : C -> S and a heuristic h : S -> R+ (paper, Section 3.1).

    A subclass writes `project` and `heuristic`; selection, proposal and the distribution over the tree
    follow. It may write `prepare` (once, before a search), `feedback` (after each expansion) and anything
    that it can do faster.

    Args:
        temperature: 0 selects argmin h, as in Algorithm 1. A positive temperature, in units of the local
            planner's step, selects from softmin(h / temperature).
        expansion_penalty: What each expansion of a node, failed or not, adds to its h, in units of the
            local planner's step. h is conditioned on T, so that no node is tried in vain forever.

    Attributes:
        name: The name in tables and on the command line.
        expression: The expression that it was made from, for messages; empty without one.
        no_path: Why no path joins start and goal in C, once this guiding space has proved it: the search
            then ends. None until then.
    """

    name: ClassVar[str] = ""
    no_path: str | None = None
    expression: str = ""

    @door
    def __init__(self, *, temperature: float = 0.0, expansion_penalty: float = 0.1) -> None:
        self.temperature = number("temperature", temperature, least=0)
        self.expansion_penalty = number("expansion_penalty", expansion_penalty, least=0)

    def _repr_html_(self) -> str:
        """Its options and, once it is prepared, what it sees; for notebooks."""
        return str(importlib.import_module(_NOTEBOOK).guiding_space_html(self))

    def reset(self, search: Search) -> None:
        """Forget the last search and get ready for a new one."""
        self.search = search
        self.space, self.goal = search.space, search.goal
        self.planner, self.rng = search.planner, search.guidance_rng
        for option in ("temperature", "expansion_penalty"):
            if not hasattr(self, option):
                what = f"{type(self).__name__}.__init__: expected it to call super().__init__()"
                raise InvalidInputError(f"{what}, which sets {option}; got no {option}")
        self.no_path = None
        self.forget()
        self.prepare()

    def prepare(self) -> None:  # noqa: B027  a hook: nothing to prepare is common
        """Build what this guiding space needs for ``self.search``; nothing by default."""

    @abstractmethod
    def project(self, tree: SearchTree, q: NDArray[np.float64]) -> NDArray[Any]:
        """P_T: (n, d) configurations to n states of S."""

    @abstractmethod
    def heuristic(self, states: NDArray[Any]) -> NDArray[np.float64]:
        """h: n states of S to (n,) values >= 0; infinite where S gives no guidance."""

    def feedback(self, expansion: Expansion) -> None:  # noqa: B027  a hook, like prepare
        """Learn from an expansion; called after the tree has changed. Nothing by default."""

    def burst(self, limit: int) -> NDArray[np.int32] | None:
        """Run many samples in one go, if it can: the same as so many selections, proposals and expansions.

        Args:
            limit: Most samples to take.

        Returns:
            (k, 2) selected node and new node of each sample, as `Search.extend_towards` gives them; None to
            be asked sample by sample, as most guiding spaces are.
        """
        return None

    def forget(self) -> None:
        """Compute h of all nodes anew. Call it when the projection or the heuristic has changed."""
        self._values = NodeValues(self.expansion_penalty * self.planner.step)

    def evaluate(self, tree: SearchTree, first: int, last: int) -> NDArray[np.float64]:
        """(last - first,) h of the new nodes; called once for each."""
        return self._h(tree, tree.nodes.configurations[first:last])

    def values(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) h(P_T(v)) of each node, the penalty for its expansions so far included."""
        return self._values.update(tree, self.evaluate)

    def least(self, tree: SearchTree) -> tuple[int, float]:
        """The node of least h, the first of equals, and its h; both as `values` has them."""
        h = self.values(tree)
        node = int(h.argmin())
        return node, float(h[node])

    def distribution(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) the distribution P over the nodes from which `select` draws."""
        h = self.values(tree)
        lowest = h.min()
        if not np.isfinite(lowest):
            return np.full(h.size, 1.0 / h.size)
        if self.temperature == 0:
            certain = np.zeros(h.size)
            certain[int(np.argmin(h))] = 1.0
            return certain
        p: NDArray[np.float64] = np.exp((lowest - h) / (self.temperature * self.planner.step))
        p /= p.sum()
        return p

    def select(self, tree: SearchTree) -> int:
        """The node to expand: x_min = argmin h(P_T(v)), or a draw from P if there is a temperature.

        If h is infinite everywhere, S gives no guidance, and all nodes are equally good.
        """
        if self.temperature == 0:
            node, h = self.least(tree)
            return node if math.isfinite(h) else int(self.rng.integers(len(tree)))
        return draw(self.distribution(tree), self.rng)

    def propose(self, tree: SearchTree, node: int) -> NDArray[np.float64]:
        """(d,) x_new: the member of N_C(v) with the least h, among the local planner's candidates."""
        candidates = self.planner.candidates(tree.nodes.configurations[node])
        h = self._h(tree, candidates)
        best: NDArray[np.float64] = candidates[np.argmin(h)]
        return best

    def _h(self, tree: SearchTree, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) h(P_T(q)), checked: both methods may be a user's."""
        states = self.project(tree, q)
        if states is None:
            raise InvalidInputError(
                f"{type(self).__name__}.project: expected the states of {len(q)} configurations, got None"
            )
        return self._checked(self.heuristic(states), len(q))

    def _checked(self, h: Any, count: int) -> NDArray[np.float64]:
        """What `heuristic` returned, if it is ``count`` values of h."""

        def wrong(got: str) -> InvalidInputError:
            what = f"{type(self).__name__}.heuristic: expected ({count},) numbers >= 0"
            return InvalidInputError(f"{what}, infinite for no guidance; got {got}")

        try:
            values = np.asarray(h, np.float64)
        except (TypeError, ValueError) as error:
            raise wrong(shown(h)) from error
        if values.shape != (count,):
            raise wrong(f"shape {values.shape}")
        if count and not values[values.argmin()] >= 0:  # nor is NaN; a reduction takes three times as long
            bad = int(np.argmin(values >= 0))
            raise wrong(f"{values[bad]} for state {bad}")
        return values


class NodeValues:
    """h of each node of a growing tree, with what its expansions add to it; O(new nodes) to keep up to date.

    Args:
        penalty: What each expansion of a node adds to its h.
    """

    def __init__(self, penalty: float) -> None:
        self._penalty = penalty
        self._h = np.zeros(64)
        self._totals = np.zeros(64)
        self._nodes = self._failures = self._rewirings = 0

    def update(
        self, tree: SearchTree, evaluate: Callable[[SearchTree, int, int], NDArray[np.float64]]
    ) -> NDArray[np.float64]:
        """(n,) totals, a read-only view; ``evaluate(tree, first, last)`` is asked for h of the new nodes."""
        first, n = self._nodes, len(tree)
        if n > self._h.size:
            self._h, self._totals = (np.resize(a, 2 * n) for a in (self._h, self._totals))
        if first < n:
            self._h[first:n] = evaluate(tree, first, n)
        failed = tree.failed.nodes[self._failures : tree.failure_count]
        if n - first + failed.size > 8 or tree.rewirings != self._rewirings:
            self._charge(tree, slice(0, n))
        else:  # one by one: the usual case is one new node, or one failure
            for node in (*range(first, n), *tree.nodes.parents[max(first, 1) : n].tolist(), *failed.tolist()):
                self._charge(tree, node)
        self._nodes, self._failures, self._rewirings = n, tree.failure_count, tree.rewirings
        totals = self._totals[:n]
        totals.flags.writeable = False
        return totals

    def change(self, tree: SearchTree, nodes: NDArray[np.int64], h: NDArray[np.float64]) -> None:
        """Set h of some nodes anew."""
        self._h[nodes] = h
        self._charge(tree, nodes)

    def _charge(self, tree: SearchTree, nodes: int | slice | NDArray[np.int64]) -> None:
        expansions = tree.nodes.failures[nodes] + tree.nodes.children[nodes]
        self._totals[nodes] = self._h[nodes] + self._penalty * expansions


def draw(p: NDArray[np.float64], rng: np.random.Generator) -> int:
    """An index drawn from the probabilities p; never one of probability 0."""
    cumulative = np.cumsum(p)
    return int(min(np.searchsorted(cumulative, rng.random() * cumulative[-1], side="right"), p.size - 1))
