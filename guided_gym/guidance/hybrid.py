"""Multi-guidance search: guiding spaces that know nothing of each other, combined (paper, Section 7.1)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from guided_gym.errors import InvalidInputError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.rules import Rule, SwapAtCollision, Watching
from guided_gym.search.search import Expansion
from guided_gym.search.tree import SearchTree


class Hybrid(GuidingSpace):
    """The cross product of guiding spaces, with a rule that says whose heuristic counts.

    All of them learn from every expansion, whoever proposed it.

    Args:
        guides: The guiding spaces; `make_guidance` takes their names, too.
        rule: Who guides when; the paper's swap at each collision by default. One that is `Watching` sees the
            guiding spaces and the search.
    """

    name: ClassVar[str] = "hybrid"

    def __init__(
        self,
        guides: Sequence[GuidingSpace],
        rule: Rule | None = None,
    ) -> None:
        super().__init__(expansion_penalty=0.0)
        if isinstance(guides, str) or not isinstance(guides, Sequence) or not guides:
            raise InvalidInputError(f"guides: expected a sequence of guiding spaces, got {guides!r}")
        self.guides = list(guides)
        for guide in self.guides:
            if not isinstance(guide, GuidingSpace):
                raise InvalidInputError(
                    f"guides: expected guiding spaces (`make_guidance` makes them of names), got {guide!r}"
                )
        if len({id(guide) for guide in self.guides}) != len(self.guides):
            raise InvalidInputError("guides: expected each instance once, got one of them twice")
        if rule is not None and not (hasattr(rule, "reset") and hasattr(rule, "next")):
            raise InvalidInputError(f"rule: expected an object with reset and next, got {rule!r}")
        self.rule: Rule = SwapAtCollision() if rule is None else rule
        self.current = 0

    @property
    def guide(self) -> GuidingSpace:
        """The guiding space whose turn it is."""
        return self.guides[self.current]

    def prepare(self) -> None:
        """Prepare every guiding space."""
        for guide in self.guides:
            guide.reset(self.search)
        if isinstance(self.rule, Watching):
            self.rule.watch(self.guides, self.search)
        self.current = self.rule.reset(len(self.guides))

    def project(self, tree: SearchTree, q: NDArray[np.float64]) -> tuple[int, Any]:  # type: ignore[override]
        """P_T into the guiding space whose turn it is: (its index, its states)."""
        return self.current, self.guide.project(tree, q)

    def heuristic(self, states: tuple[int, Any]) -> NDArray[np.float64]:  # type: ignore[override]
        """H of the guiding space that the states belong to."""
        index, inner = states
        return self.guides[index].heuristic(inner)

    def values(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) h of each node in the guiding space whose turn it is."""
        return self.guide.values(tree)

    def distribution(self, tree: SearchTree) -> NDArray[np.float64]:
        """P of the guiding space whose turn it is."""
        return self.guide.distribution(tree)

    def select(self, tree: SearchTree) -> int:
        """The node that the current guide selects."""
        return self.guide.select(tree)

    def propose(self, tree: SearchTree, node: int) -> NDArray[np.float64]:
        """The configuration that the current guide proposes."""
        return self.guide.propose(tree, node)

    def feedback(self, expansion: Expansion) -> None:
        """Every guide learns; then the rule decides who guides next."""
        for guide in self.guides:
            guide.feedback(expansion)
        self.current = self.rule.next(self.current, expansion)
