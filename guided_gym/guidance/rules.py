"""Rules of hybrids: how much each guiding space guides the next sample (paper, Multi-Guidance Search).

One joins by adding a row to `RULES`, or by `register_rule`; it needs what `Rule` says.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import integer, number
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.search.search import Expansion, Search

Weights = NDArray[np.float64]


class Rule(Protocol):
    """Weights over guiding spaces, sample by sample: P = sum of w_i P_i.

    A rule with an attribute ``joint`` that is true weighs their values instead: P is the product of the
    P_i ** w_i, and h = sum of w_i h_i.
    """

    def begin(self, guides: Sequence[GuidingSpace], search: Search) -> None:
        """Begin a new search with its guiding spaces, all prepared."""

    def weights(self) -> Weights:
        """(k,) weights >= 0 of the guiding spaces for the next sample, not all 0; asked once a sample."""

    def learn(self, guide: int, expansion: Expansion) -> None:
        """Take note of what became of a sample that ``guide`` guided."""


class Taking:
    """A rule by which the guiding spaces take turns: one of them guides each sample. Subclasses say which."""

    joint = False

    def begin(self, guides: Sequence[GuidingSpace], search: Search) -> None:
        """Start over with the first."""
        self.guides, self.search = guides, search
        self.turn = 0
        self._alone = [row.copy() for row in np.eye(len(guides))]  # the weights of each turn
        for weights in self._alone:
            weights.flags.writeable = False

    def weights(self) -> Weights:
        """All weight on the one whose turn it is."""
        return self._alone[self.turn]

    def learn(self, guide: int, expansion: Expansion) -> None:
        """Nothing."""

    def pass_on(self) -> None:
        """The next one in turn."""
        self.turn = (self.turn + 1) % len(self.guides)


class Swap(Taking):
    """The paper's rule: swap the source of the guidance each time the search collides with an obstacle.

    A guiding space that never collides never hands over, unless there is a patience.

    Args:
        patience: Samples in a row without a collision after which it hands over all the same; 0 for never.
    """

    def __init__(self, patience: int = 0) -> None:
        self.patience = integer("patience", patience, least=0)

    def begin(self, guides: Sequence[GuidingSpace], search: Search) -> None:
        """Start over with the first."""
        super().begin(guides, search)
        self._free = 0

    def learn(self, guide: int, expansion: Expansion) -> None:
        """Pass on after a collision, or when patience is lost."""
        self._free = 0 if expansion.failed else self._free + 1
        if expansion.failed or (self.patience and self._free >= self.patience):
            self._free = 0
            self.pass_on()


class RoundRobin(Taking):
    """Each guiding space guides one sample, in turn."""

    def learn(self, guide: int, expansion: Expansion) -> None:
        """Pass on."""
        self.pass_on()


class Minimum(Taking):
    """The guiding space that sees the shortest way guides: the least h over guides and nodes."""

    def weights(self) -> Weights:
        """All weight on the one with the least value of a node."""
        self.turn = int(np.argmin([guide.least(self.search.tree)[1] for guide in self.guides]))
        return super().weights()


class MultiHeuristic(Taking):
    """Shared multi-heuristic A* (Aine et al., 2016): the first guide is the anchor, the others take turns.

    Args:
        factor: One of the others guides while the least h that it sees is at most so many times the anchor's;
            else the anchor does.
    """

    def __init__(self, factor: float = 2.0) -> None:
        self.factor = number("factor", factor, least=1)

    def begin(self, guides: Sequence[GuidingSpace], search: Search) -> None:
        """Start over."""
        super().begin(guides, search)
        self._tried = 0

    def weights(self) -> Weights:
        """All weight on the next inadmissible queue if its least key is in bounds, else on the anchor."""
        if len(self.guides) > 1:
            self._tried = self._tried % (len(self.guides) - 1) + 1
            least = [self.guides[i].least(self.search.tree)[1] for i in (0, self._tried)]
            self.turn = self._tried if least[1] <= self.factor * least[0] else 0
        return super().weights()


class Bandit(Taking):
    """The guiding space guides that has made progress lately: discounted UCB (Garivier and Moulines, 2011).

    A sample is worth 1 if its expansion succeeded and brought the least h of who guided it down, else 0.

    Args:
        discount: Weight of a sample against the one after it.
        exploration: How much not having guided for long counts.
    """

    def __init__(self, discount: float = 0.95, exploration: float = 0.3) -> None:
        self.discount = number("discount", discount, above=0, below=1)
        self.exploration = number("exploration", exploration, least=0)

    def begin(self, guides: Sequence[GuidingSpace], search: Search) -> None:
        """Nothing is known."""
        super().begin(guides, search)
        self._tries, self._worth = np.zeros(len(guides)), np.zeros(len(guides))
        self._least = [math.inf] * len(guides)

    def weights(self) -> Weights:
        """All weight on the one with the best upper bound; those never tried come first."""
        with np.errstate(divide="ignore", invalid="ignore"):
            spread = np.sqrt(np.log(max(float(self._tries.sum()), 1.0)) / self._tries)
            bounds = self._worth / self._tries + self.exploration * spread
        self.turn = int(np.argmax(np.where(self._tries > 0, bounds, np.inf)))
        return super().weights()

    def learn(self, guide: int, expansion: Expansion) -> None:
        """Take down what the sample was worth."""
        self._tries *= self.discount
        self._worth *= self.discount
        self._tries[guide] += 1.0
        _, least = self.guides[guide].least(self.search.tree)
        self._worth[guide] += float(not expansion.failed and least < self._least[guide])
        self._least[guide] = min(least, self._least[guide])


class Mixture:
    """P is the mixture of all P_i: each guides a sample with the probability of its weight.

    Args:
        weights: Of the guides, in order; equal if none are given.
    """

    joint = False

    def __init__(self, *weights: float) -> None:
        self._given = weights

    def begin(self, guides: Sequence[GuidingSpace], search: Search) -> None:
        """Note the number of guiding spaces.

        Raises:
            InvalidInputError: Another number of weights.
        """
        if self._given and len(self._given) != len(guides):
            raise InvalidInputError(
                f"rule: expected {len(guides)} weights, one for each guide, got {len(self._given)}"
            )
        self._weights = np.array(self._given or (1.0 / len(guides),) * len(guides))

    def weights(self) -> Weights:
        """The same for every sample."""
        return self._weights

    def learn(self, guide: int, expansion: Expansion) -> None:
        """Nothing."""


class Product(Mixture):
    """P is the product of all P_i: h is the sum of their h, so a node has to look good to all."""

    joint = True


# One row per rule: the words of ``rule=...``.
RULES: Final[dict[str, Callable[..., Any]]] = {
    "swap": Swap,
    "round_robin": RoundRobin,
    "minimum": Minimum,
    "product": Product,
    "mixture": Mixture,
    "multi_heuristic": MultiHeuristic,
    "bandit": Bandit,
}
