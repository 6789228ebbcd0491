"""Agents for robots that are too complex for a grid: a belief in motions, a cost-to-go network, a scorer."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.belief import BeliefArchitecture, BeliefModel
from guided_gym.guidance.learned.estimate import Estimate, EstimateArchitecture, EstimateModel, column_count
from guided_gym.guidance.learned.folders import agent_folder, stamp_of
from guided_gym.guidance.learned.scorer import ScorerArchitecture, ScorerModel

MOTION_KIND: Final = "guided-gym motion agent"
PARTS: Final = ("belief", "estimate", "scorer")
_ENTRIES: Final = ("format", "kind", "name", "package_version", "robot", *PARTS, "training", "metrics")


class MotionAgent:
    """Networks of an agent with their card.

    Attributes:
        card: What is known of the agent.
        belief: How likely motions are free; for any planar robot.
        scorer: The node scorer.
    """

    def __init__(
        self, card: dict[str, Any], belief: BeliefModel, estimate: EstimateModel, scorer: ScorerModel
    ) -> None:
        self.card, self.belief, self.scorer = card, belief, scorer
        self._estimate = estimate

    @classmethod
    def load(cls, folder: str | Path) -> MotionAgent:
        """An agent from its folder.

        Raises:
            StorageError: A file is missing, truncated, foreign, or made for other networks.
        """
        card, tensors = weights.load_agent(Path(folder), MOTION_KIND, _ENTRIES)
        belief = BeliefArchitecture.from_card(card["belief"])
        estimate = EstimateArchitecture.from_card(card["estimate"])
        scorer = ScorerArchitecture.from_card(card["scorer"])
        shapes = {"belief": belief.shapes(), "estimate": estimate.shapes(), "scorer": scorer.shapes()}
        named = weights.parts_of(tensors, shapes, Path(folder) / weights.WEIGHTS_FILE)
        return cls(
            card,
            BeliefModel(belief, named["belief"]),
            EstimateModel(estimate, named["estimate"]),
            ScorerModel(scorer, named["scorer"]),
        )

    def estimate(self, space: ConfigurationSpace) -> Estimate:
        """The cost-to-go network on a space.

        Raises:
            InvalidInputError: Another robot than the one that it was trained with.
        """
        found, wanted = column_count(space), self._estimate.architecture.columns
        if found != wanted:
            raise InvalidInputError(
                f"cost-to-go network: expected the robot that it was trained for ({self.card.get('robot')}), "
                f"got {space.robot.name!r}"
            )
        return Estimate(self._estimate, self.belief.architecture, space)


def load_motion_card(folder: Path) -> dict[str, Any]:
    """The card of such an agent.

    Raises:
        StorageError: There is none, or it is another's, or of another format.
    """
    return weights.load_card(folder, MOTION_KIND, _ENTRIES)


def save_motion_agent(folder: Path, card: dict[str, Any], tensors: weights.Tensors) -> None:
    """Write an agent; the card needs all entries but format and kind.

    Raises:
        StorageError: The folder cannot be written.
    """
    weights.save_agent(folder, {"kind": MOTION_KIND, **card}, tensors)


def load_motion_agent(name: str) -> MotionAgent:
    """A shipped agent or a folder's, kept in memory as long as its files stay the same.

    Raises:
        UnknownNameError: No such agent.
        StorageError: Its files cannot be used, or are those of another kind of agent.
    """
    folder = agent_folder(name).resolve()
    if weights.card_kind(folder) != MOTION_KIND:
        card = folder / weights.CARD_FILE
        raise StorageError(f"{card}: expected the card of a {MOTION_KIND}, got another")
    return _loaded(folder, stamp_of(folder))


@lru_cache(maxsize=8)
def _loaded(folder: Path, stamp: tuple[int, ...]) -> MotionAgent:
    return MotionAgent.load(folder)
