"""Multi-guidance search: it combines guiding spaces that know nothing of each other (paper, Section 7.1)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import shown
from guided_gym.doors import door
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.base import GuidingSpace, draw
from guided_gym.guidance.rules import Rule, Swap
from guided_gym.search.search import Expansion
from guided_gym.search.tree import SearchTree

Floats = NDArray[np.float64]


class Hybrid(GuidingSpace):
    """The cross product of guiding spaces, with a rule that says how much each of them counts.

    All of them learn from every expansion, no matter which of them proposed it.

    Args:
        guides: The guiding spaces; `make_guidance` takes their names, too.
        rule: Weights over the guides (see `guided_gym.guidance.rules`); the paper's swap at each collision by
            default.

    Attributes:
        current: The guiding space that guides the next sample.
    """

    name: ClassVar[str] = "hybrid"

    @door
    def __init__(self, guides: Sequence[GuidingSpace], rule: Rule | None = None) -> None:
        super().__init__(expansion_penalty=0.0)
        if isinstance(guides, str) or not isinstance(guides, Sequence) or not guides:
            raise InvalidInputError(f"guides: expected a sequence of guiding spaces, got {shown(guides)}")
        self.guides = list(guides)
        for guide in self.guides:
            if not isinstance(guide, GuidingSpace):
                raise InvalidInputError(
                    "guides: expected guiding spaces (`make_guidance` makes them from names), "
                    f"got {shown(guide)}"
                )
        if len({id(guide) for guide in self.guides}) != len(self.guides):
            raise InvalidInputError("guides: expected each instance once, got one of them twice")
        if rule is not None and not all(hasattr(rule, name) for name in ("begin", "weights", "learn")):
            raise InvalidInputError(
                f"rule: expected an object with begin, weights and learn, got {shown(rule)}"
            )
        self.rule: Rule = Swap() if rule is None else rule
        self.current = 0

    @property
    def guide(self) -> GuidingSpace:
        """The guiding space whose turn it is."""
        return self.guides[self.current]

    def prepare(self) -> None:
        """Prepare every guiding space."""
        for guide in self.guides:
            guide.reset(self.search)
        self.rule.begin(self.guides, self.search)
        self._joint = bool(getattr(self.rule, "joint", False))
        self._weights, self._given = np.zeros(0), [0.0]
        self._turn()

    def _turn(self) -> None:
        """Ask the rule for the next sample's weights, and draw who guides it."""
        weights = self.rule.weights()
        if weights is not self._weights or weights.flags.writeable or weights.base is not None:
            self._weights, self._given = self._checked_weights(weights)  # else nobody can have changed them
        given = self._given
        largest = given.index(max(given))
        alone = given[largest] == sum(given) or self._joint
        self.current = largest if alone else draw(self._weights, self.rng)

    def _checked_weights(self, weights: Any) -> tuple[Floats, list[float]]:
        """The weights as an array and as a list."""
        try:
            given = np.asarray(weights, np.float64)
        except (TypeError, ValueError):
            given = np.zeros(0)
        listed: list[float] = given.tolist()
        fits = given.shape == (len(self.guides),) and all(map(math.isfinite, listed))
        if not fits or min(listed) < 0:
            raise InvalidInputError(
                f"rule {type(self.rule).__name__}: expected {len(self.guides)} finite weights >= 0, got "
                f"{weights!r}"
            )
        if not any(listed):
            raise InvalidInputError(
                f"rule {type(self.rule).__name__}: expected a weight > 0, got {shown(weights)}"
            )
        return given, listed

    def project(self, tree: SearchTree, q: Floats) -> tuple[int, Any]:  # type: ignore[override]
        """P_T into the space whose turn it is, or into all: (its index, its states), or (-1, list)."""
        if self._joint:
            return -1, [guide.project(tree, q) for guide in self.guides]
        return self.current, self.guide.project(tree, q)

    def heuristic(self, states: tuple[int, Any]) -> Floats:  # type: ignore[override]
        """The heuristic of the guiding space that the states belong to, or the weighted sum of all."""
        index, inner = states
        if index >= 0:
            return self.guides[index].heuristic(inner)
        return self._sum([g.heuristic(s) for g, s in zip(self.guides, inner, strict=True)])

    def _sum(self, values: list[Floats]) -> Floats:
        # What has no weight has no say, not even by an infinite value.
        counted = [w * v for w, v in zip(self._weights, values, strict=True) if w > 0]
        return np.asarray(np.sum(counted, axis=0))

    def values(self, tree: SearchTree) -> Floats:
        """(n,) h of each node in the guiding space whose turn it is, or the weighted sum of all."""
        if self._joint:
            return self._sum([guide.values(tree) for guide in self.guides])
        return self.guide.values(tree)

    def distribution(self, tree: SearchTree) -> Floats:
        """(n,) P: the mixture of the guides' P by their weights; argmin of the sum of h for a product."""
        if self._joint:
            return super().distribution(tree)
        share = self._weights / self._weights.sum()
        counted = [w * g.distribution(tree) for w, g in zip(share, self.guides, strict=True) if w > 0]
        return np.asarray(np.sum(counted, axis=0))

    def select(self, tree: SearchTree) -> int:
        """The node that the current guide selects, or the one with the least sum of h."""
        node = super().select(tree) if self._joint else self.guide.select(tree)
        self.no_path = self.guide.no_path
        return node

    def propose(self, tree: SearchTree, node: int) -> Floats:
        """The configuration that the current guide proposes, or the candidate with the least sum of h."""
        return super().propose(tree, node) if self._joint else self.guide.propose(tree, node)

    def feedback(self, expansion: Expansion) -> None:
        """Every guide learns; then the rule says who guides next."""
        for guide in self.guides:
            guide.feedback(expansion)
        self.rule.learn(self.current, expansion)
        self._turn()
