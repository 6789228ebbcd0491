"""A composition whose nodes are selected by a learned scorer."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partialmethod
from typing import TYPE_CHECKING, Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from guided_gym.guidance.composed import Composed
from guided_gym.guidance.learned.scorer import ScorerColumn, ScorerModel
from guided_gym.guidance.learned.weights import selection_of
from guided_gym.kernels import fields
from guided_gym.options import DEFAULT_TARGET

if TYPE_CHECKING:
    from guided_gym.search.tree import SearchTree

_CLIP: Final = 4.0  # of remaining way and of detour, in optima
_LEAST: Final = 1e-9  # sides of the workspace that a way left may be as a unit
_AGAIN: Final = 3.0  # failures that each child of a node after its first counts as
_CONTACT_REACH: Final = 0.5  # steps around a contact that count as known to be bad


class ScoredGuidance(Composed):
    """A composition that selects by a node scorer: h falls as the score rises. Proposals are the solver's.

    Attributes:
        scorer: The node scorer.
        scored: Whether it selects; without, the solver's h does, as in any composition.
        failure_penalty: Nats that each failed expansion of a node takes from its logit; each child after the
            first takes more, so that nothing is tried in vain forever.
    """

    scorer: ScorerModel
    scored: bool
    failure_penalty: float

    def prepare(self) -> None:
        """Have the solver begin, and forget what was seen of nodes."""
        super().prepare()
        self._seen = np.zeros((256, 3))  # clearance, distance to the goal, contacts around
        self._nodes = self._contacts = 0

    def columns(self, tree: SearchTree) -> NDArray[np.float32]:
        """(n, F) what the scorer sees of each node, as in `ScorerColumn`."""
        n, nodes = len(tree), tree.nodes
        way, optimum = self.costs(tree), self._optimum(tree)
        clearance, distance, contacts = self._seen_of(tree).T
        left = np.minimum(way / optimum, _CLIP)
        excess = np.clip((nodes.costs[:n] + way) / optimum - 1.0, 0.0, _CLIP)
        energy = left + excess
        out = np.empty((n, len(ScorerColumn)), np.float32)
        out[:, ScorerColumn.REMAINING] = left
        out[:, ScorerColumn.EXCESS] = excess
        out[:, ScorerColumn.FAILURES] = np.log1p(nodes.failures[:n])
        out[:, ScorerColumn.CHILDREN] = np.log1p(nodes.children[:n])
        out[:, ScorerColumn.CONTACTS] = np.log1p(contacts)
        out[:, ScorerColumn.CLEARANCE] = np.minimum(clearance / self.planner.step, 2.0)
        out[:, ScorerColumn.DISTANCE] = np.minimum(distance / optimum, 4.0)
        out[:, ScorerColumn.GAP] = np.minimum(energy - energy.min(), 2.0)
        return out

    def _optimum(self, tree: SearchTree) -> float:
        """The way left at the root (length), as far as it is of any use as a unit."""
        side = self.space.extent
        return float(min(max(self.costs(tree)[0], _LEAST * side), _CLIP * side))

    def penalties(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) nats subtracted from the logit of each node, so that no node is tried in vain forever."""
        n = len(tree)
        again = _AGAIN * np.maximum(tree.nodes.children[:n] - 1, 0)
        return np.asarray(self.failure_penalty * (tree.nodes.failures[:n] + again))

    def logits(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) the score of each node, less its penalty."""
        scores = self.scorer.logits(self.columns(tree)).astype(np.float64)
        return np.asarray(scores - self.penalties(tree))

    def values(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) h of each node: how far its logit lies below the largest, as a length.

        A way left of an optimum takes 1 / tau nats from the target's logit. Without the scorer it is the
        solver's h.
        """
        if not self.scored:
            return super().values(tree)
        logits = self.logits(tree)
        return np.asarray((logits.max() - logits) * DEFAULT_TARGET.tau * self._optimum(tree))

    def _lost(self, tree: SearchTree) -> bool:
        """Whether no node has a way; the scores of nodes without one say nothing of it."""
        return not np.isfinite(self.costs(tree)).any() if self.scored else super()._lost(tree)

    def distribution(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) one-hot at the largest logit, or the softmax of the logits if there is a temperature."""
        if self.temperature == 0 or not self.scored:
            return super().distribution(tree)
        logits = self.logits(tree)
        p = np.exp((logits - logits.max()) / self.temperature)
        return np.asarray(p / p.sum())

    def _seen_of(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n, 3) clearance, distance to the goal and contacts around each node, each looked at once."""
        n, first, q = len(tree), self._nodes, tree.nodes.configurations
        if n > len(self._seen):
            self._seen = np.concatenate([self._seen, np.zeros((n, 3))])
        contacts = tree.failed.contacts
        if tree.failure_count > self._contacts:
            fresh = contacts[self._contacts : tree.failure_count]
            self._seen[:first, 2] += self._crowding(q[:first], fresh)
            self._contacts = tree.failure_count
        if n > first:
            self._seen[first:n, 0] = self._clearance(q[first:n])
            self._seen[first:n, 1] = self.space.distance(q[first:n], self.goal)
            self._seen[first:n, 2] = self._crowding(q[first:n], contacts[: self._contacts])
            self._nodes = n
        return self._seen[:n]

    def _clearance(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) clearance of the robot (length)."""
        return np.asarray(self.space.clearance(q))

    def _crowding(self, q: NDArray[np.float64], contacts: NDArray[np.float64]) -> NDArray[np.float64]:
        reach = _CONTACT_REACH * self.planner.step
        weight = float(self.space.weights[2]) if self.space.dimension == 3 else 0.0
        return np.asarray(fields.crowding(q, contacts, np.ones(len(contacts)), reach, weight))


G = TypeVar("G", bound=ScoredGuidance)


def class_of(kind: type[G], name: str, card: Mapping[str, Any], options: Collection[str]) -> type[G]:
    """The guiding space of one agent, as a class.

    Args:
        kind: The class of such guiding spaces; the agent is its first argument.
        name: The agent's name.
        card: Its card; its selection gives defaults.
        options: Those of which a card may say what they are.

    Raises:
        StorageError: The card's selection holds something else.
    """
    init = partialmethod(kind.__init__, name, **selection_of(card, options))
    body = {"name": f"learned:{name}", "__init__": init, "__doc__": kind.__doc__}
    return type(kind.__name__, (kind,), {**body, "__module__": kind.__module__})
