"""Learned guidance: a field network and a node scorer as a guiding space (paper, Experience-based Guidance).

`make_guidance("learned:NAME")` makes one of a shipped agent or of a folder that training wrote. Runs on numpy
alone.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import sys
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, Final

from guided_gym.checks import flag, number
from guided_gym.guidance import composed
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.composed import AVOID, Lesson
from guided_gym.guidance.learned import field, motion_agent, scored, scorer, weights
from guided_gym.guidance.learned import rule as rules
from guided_gym.guidance.learned.field import FieldArchitecture, FieldModel
from guided_gym.guidance.learned.folders import agent_folder, stamp_of
from guided_gym.guidance.learned.motion_agent import load_motion_card
from guided_gym.guidance.learned.motion_guidance import motion_class
from guided_gym.guidance.learned.scored import ScoredGuidance, class_of
from guided_gym.guidance.learned.scorer import ScorerArchitecture, ScorerModel
from guided_gym.guidance.solvers import wave as pose_grid
from guided_gym.guidance.solvers.wave import Wave
from guided_gym.kernels import fields

_OF_MOTIONS: Final = tuple(  # what runs an agent that believes in motions
    f"guided_gym.{name}"
    for name in (
        "guidance.learned.motion_guidance",
        "guidance.learned.belief",
        "guidance.learned.estimate",
        "guidance.modifications",
        "guidance.solvers.doubted",
        "guidance.solvers.estimated",
        "guidance.solvers.roadmap",
        "kernels.belief",
    )
)


SELECTION: Final = ("scored", "detour", "expansion_penalty", "reach", "factor", "foreseen")
"""Options of which a card may say what they are unless others are given."""


class LearnedAgent:
    """Networks of an agent with their card.

    Attributes:
        card: What is known of the agent (see `guided_gym.guidance.learned.weights`).
        field: The field network.
        scorer: The node scorer.
    """

    def __init__(self, card: dict[str, Any], field: FieldModel, scorer: ScorerModel) -> None:
        self.card, self.field, self.scorer = card, field, scorer

    @classmethod
    def load(cls, folder: str | Path) -> LearnedAgent:
        """An agent from its folder.

        Raises:
            StorageError: A file is missing, truncated, foreign, or made for other columns or networks.
        """
        card, tensors = weights.load_agent(Path(folder))
        field = FieldArchitecture.from_card(card["field"])
        scorer = ScorerArchitecture.from_card(card["scorer"])
        shapes = {"field": field.shapes(), "scorer": scorer.shapes()}
        parts = weights.parts_of(tensors, shapes, Path(folder) / weights.WEIGHTS_FILE)
        return cls(card, FieldModel(field, parts["field"]), ScorerModel(scorer, parts["scorer"]))


class LearnedGuidance(ScoredGuidance):
    """S holds the columns of the node scorer over a learned field; h falls as the score rises.

    A composition whose solver is a wave through what the field network takes for free. A node is selected by
    its logit, or, without the scorer, by h as `wavefront` has it; x_new is the candidate from which the field
    sees the shortest way.

    Args:
        agent: A shipped agent's name, a folder, or a `LearnedAgent`.
        scored: Whether the scorer selects; without, h does.
        detour: How much a node's suboptimality counts in h, where the scorer does not select.
        temperature: 0 selects the largest logit; 1 draws from the softmax that was trained.
        failure_penalty: Nats that each failed expansion of a node takes from its logit; each child after the
            first takes more, so that nothing is tried in vain forever.
        expansion_penalty: What each expansion of a node adds to its h (natural lengths), without the scorer.
        reach: How far around a failure the field gets costlier (natural lengths; see `Lesson`).
        factor: How many times costlier.
        foreseen: What part of the reach a failure has that the field foresaw.
        candidates: Members of N_C(v) that a proposal looks at; None for as many as the search's options say.

    Raises:
        UnknownNameError: No such agent.
        StorageError: Its files cannot be used.
        InvalidInputError: An option that is out of range.
    """

    name: ClassVar[str] = "learned"

    def __init__(
        self,
        agent: str | Path | LearnedAgent,
        *,
        scored: bool = True,
        detour: float = 0.5,
        temperature: float = 0.0,
        failure_penalty: float = 0.05,
        expansion_penalty: float = 0.1,
        reach: float = AVOID.reach,
        factor: float = AVOID.factor,
        foreseen: float = 1.0,
        candidates: int | None = None,
    ) -> None:
        self.agent = agent if isinstance(agent, LearnedAgent) else load_named(str(agent))
        super().__init__(
            Wave.of(self.agent.field),
            lesson=Lesson(reach=reach, factor=factor, foreseen=foreseen),
            detour=detour,
            temperature=temperature,
            expansion_penalty=expansion_penalty,
            candidates=candidates,
        )
        self.scorer, self.scored = self.agent.scorer, flag("scored", scored)
        self.failure_penalty = number("failure_penalty", failure_penalty, least=0)


@lru_cache(maxsize=8)
def _loaded(folder: Path, stamp: tuple[int, ...]) -> LearnedAgent:
    return LearnedAgent.load(folder)


def load_named(name: str) -> LearnedAgent:
    """An agent by name or folder, kept in memory as long as its files stay the same.

    Raises:
        UnknownNameError: No such agent.
        StorageError: Its files cannot be used.
    """
    folder = agent_folder(name).resolve()
    return _loaded(folder, stamp_of(folder))


def guidance_class(
    name: str, make_guides: Callable[[Sequence[str]], list[GuidingSpace]]
) -> type[GuidingSpace]:
    """The guiding space of one agent, as a class: what ``"learned:NAME"`` stands for.

    Of a rule's folder, the hybrid of that rule and its guides.

    Args:
        name: The agent.
        make_guides: Makes guiding spaces of the names of a rule's guides.

    Raises:
        UnknownNameError: No such agent.
        StorageError: Its files cannot be used.
    """
    kind = weights.card_kind(agent_folder(name))
    if kind == rules.RULE_KIND:
        return rules.hybrid_class(name, agent_folder(name), make_guides)
    if kind == motion_agent.MOTION_KIND:
        return motion_class(name)
    return class_of(LearnedGuidance, name, load_named(name).card, SELECTION)


def fingerprint(name: str) -> str:
    """Hash of an agent's card and weights and of the code that runs them, for results files.

    Raises:
        UnknownNameError: No such agent.
        StorageError: Its card cannot be used.
    """
    folder = agent_folder(name)
    kind = weights.card_kind(folder)
    own = sys.modules[__name__], scored, scorer, composed
    modules: tuple[ModuleType, ...] = (*own, field, pose_grid, fields)
    if kind == rules.RULE_KIND:
        modules, card = (rules,), rules.load_rule_card(folder)
    elif kind == motion_agent.MOTION_KIND:
        modules = *own, *(importlib.import_module(name) for name in _OF_MOTIONS)
        card = load_motion_card(folder)
    else:
        card = weights.load_card(folder)
    selection = json.dumps(card["selection"], sort_keys=True) if "selection" in card else ""
    digest = hashlib.sha256((card["weights_sha256"] + selection).encode())
    for module in modules:
        source = Path(str(module.__file__))
        digest.update(source.read_bytes() if source.is_file() else b"")
    return digest.hexdigest()[:16]
