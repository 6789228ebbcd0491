"""Learned rules of `Hybrid`: which guiding space guides the next sample, decided by a small network on numpy.

`guided-gym train hybrid` writes them, from what the environment ``GuideSelection`` taught;
``"learned:FOLDER"`` is the hybrid of such a rule and the guides that it was trained with.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import number
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.guidance.base import draw
from guided_gym.guidance.grammar import parse
from guided_gym.guidance.hybrid import Hybrid
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.turns import COLUMN_NAMES, Turns, observed_size

if TYPE_CHECKING:
    from guided_gym.guidance.base import GuidingSpace
    from guided_gym.search.search import Expansion, Search

RULE_KIND: Final = "guided-gym rule"
_ENTRIES: Final = (
    "format", "kind", "name", "package_version", "guides", "columns", "hidden", "training", "metrics",
)  # fmt: skip


class RuleModel:
    """A perceptron with tanh between its layers: from features of the guides to a logit for each.

    Args:
        card: What is known of it; ``guides``, their names in order, and ``hidden``, sizes of its layers.
        tensors: ``layers.i.weight`` (out, in) and ``layers.i.bias`` (out,).

    Raises:
        StorageError: Card and tensors do not fit each other or this version.
    """

    def __init__(self, card: dict[str, Any], tensors: weights.Tensors, where: str | Path = "rule") -> None:
        if tuple(card["columns"]) != COLUMN_NAMES:
            raise StorageError(
                f"{where}: expected weights for the columns {', '.join(COLUMN_NAMES)}; got weights for "
                f"{', '.join(map(str, card['columns']))}"
            )
        weights.check_tensors(tensors, rule_shapes(card["guides"], card["hidden"]), where)
        self.card, self.guides = card, tuple(card["guides"])
        self._layers = [
            (tensors[f"layers.{i}.weight"].astype(np.float32).T, tensors[f"layers.{i}.bias"])
            for i in range(len(card["hidden"]) + 1)
        ]

    @classmethod
    def load(cls, folder: str | Path) -> RuleModel:
        """A rule from its folder.

        Raises:
            StorageError: A file is missing, truncated, foreign, or made for other columns.
        """
        card, tensors = weights.load_agent(Path(folder), RULE_KIND, _ENTRIES)
        return cls(card, tensors, Path(folder) / weights.WEIGHTS_FILE)

    def logits(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """(k,) logit of each guide from (5 + 13 k,) numbers (see `guided_gym.guidance.rules`)."""
        out = observation
        for i, (weight, bias) in enumerate(self._layers):
            out = (np.tanh(out) if i else out) @ weight + bias
        return out


def rule_shapes(guides: Sequence[str], hidden: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """Name and shape of each tensor of a rule."""
    sizes = [observed_size(len(guides)), *hidden, len(guides)]
    shapes: dict[str, tuple[int, ...]] = {}
    for i, (before, after) in enumerate(itertools.pairwise(sizes)):
        shapes[f"layers.{i}.weight"] = (after, before)
        shapes[f"layers.{i}.bias"] = (after,)
    return shapes


def save_rule(folder: Path, card: dict[str, Any], tensors: weights.Tensors) -> None:
    """Write a rule; the card needs all entries but format, kind and columns.

    Raises:
        StorageError: The folder cannot be written.
    """
    weights.save_agent(folder, {"kind": RULE_KIND, "columns": list(COLUMN_NAMES), **card}, tensors)


def load_rule_card(folder: Path) -> dict[str, Any]:
    """The card of a rule.

    Raises:
        StorageError: There is none, or it is not a rule's, or of another format.
    """
    return weights.load_card(folder, RULE_KIND, _ENTRIES)


class LearnedRule:
    """A trained rule: ``Hybrid(make_guides(rule.guides), rule=rule)``.

    Args:
        model: A folder that `guided-gym train hybrid` wrote, or a `RuleModel`.
        temperature: 0 takes the guide of the largest logit; 1 draws as the training did.

    Raises:
        StorageError: The folder cannot be used.
        InvalidInputError: A negative temperature.
    """

    def __init__(self, model: str | Path | RuleModel, *, temperature: float = 0.0) -> None:
        self.model = model if isinstance(model, RuleModel) else RuleModel.load(model)
        self.temperature = number("temperature", temperature, least=0)

    @property
    def guides(self) -> tuple[str, ...]:
        """Names of the guiding spaces that it was trained to choose from, in order."""
        return self.model.guides

    joint = False

    def begin(self, guides: Sequence[GuidingSpace], search: Search) -> None:
        """Begin a new search.

        Raises:
            InvalidInputError: The guides are not those that it was trained with.
        """
        names = tuple(guide.name for guide in guides)
        if names != tuple(parse(guide).name for guide in self.guides):
            raise InvalidInputError(
                f"rule: expected the guides {', '.join(self.guides)}, in this order; got {', '.join(names)}"
            )
        self._turns, self._rng = Turns(guides, search), search.guidance_rng

    def weights(self) -> NDArray[np.float64]:
        """All weight on the guide of the largest logit, or on one drawn as the training did."""
        logits = self.model.logits(self._turns.observe())
        out = np.zeros(len(logits))
        if self.temperature == 0:
            out[int(np.argmax(logits))] = 1.0
        else:
            p = np.exp((logits - logits.max()).astype(np.float64) / self.temperature)
            out[draw(p, self._rng)] = 1.0
        return out

    def learn(self, guide: int, expansion: Expansion) -> None:
        """Record what became of a sample."""
        self._turns.note(guide, expansion)


def hybrid_class(
    name: str, folder: Path, make_guides: Callable[[Sequence[str]], list[GuidingSpace]]
) -> type[Hybrid]:
    """The hybrid of a rule and of its guides, as a class: what ``"learned:NAME"`` stands for.

    Raises:
        StorageError: The rule's files cannot be used.
    """
    model = RuleModel.load(folder)

    class LearnedHybrid(Hybrid):
        """A hybrid with a learned rule, and with the guides that the rule was trained with.

        Args:
            temperature: Of the rule, see `LearnedRule`.
        """

        def __init__(self, *, temperature: float = 0.0) -> None:
            super().__init__(make_guides(model.guides), LearnedRule(model, temperature=temperature))

    LearnedHybrid.name = f"learned:{name}"
    return LearnedHybrid
