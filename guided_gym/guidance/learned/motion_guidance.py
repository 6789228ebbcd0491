"""Learned guidance without a grid: a lazy roadmap through what is believed free, and a node scorer."""

from __future__ import annotations

import math
from functools import partialmethod
from pathlib import Path
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import flag, number
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.composed import AVOID, Composed, Lesson
from guided_gym.guidance.learned.motion_agent import MotionAgent, load_motion_agent
from guided_gym.guidance.learned.scored import ScoredGuidance
from guided_gym.guidance.modifications import UNCHANGED, Predicted
from guided_gym.guidance.solvers.estimated import Estimated
from guided_gym.guidance.solvers.roadmap import Roadmap

LESSON: Final = Lesson(reach=0.2, factor=math.inf, check=0.0)
"""A failure refutes what passes near it; nothing is checked for collision."""
SIGHTS: Final = ("belief", "estimate", "both")
_NEAR: Final = 0.5  # steps around a contact that count as known to be bad


class MotionGuidance(ScoredGuidance):
    """``roadmap(environment=predicted(AGENT))`` with the agent's node scorer, and its cost-to-go as fallback.

    Args:
        agent: A shipped agent's name, a folder, or a `MotionAgent`.
        sees: What h rests on: ``"belief"``, the roadmap through what is believed free; ``"estimate"``, the
            cost-to-go network; ``"both"``, the roadmap, and the network while no node has a way on it.
        scored: Whether the scorer selects; without, h does.
        detour: How much a node's suboptimality counts in h, where the scorer does not select.
        temperature: 0 selects the largest logit, or least h; 1 draws from the softmax that was trained.
        failure_penalty: Nats that each failed expansion of a node takes from its logit.
        vertices: Of the roadmap, which is drawn once for each robot.
        neighbours: Edges from each vertex to its nearest neighbours.
        anchors: Vertices that a configuration is joined to.
        effort: What a failure costs, in lengths of the motion (see `Predicted`).
        candidates: Members of N_C(v) that a proposal looks at; None for as many as the search's options say.

    Raises:
        UnknownNameError: No such agent.
        StorageError: Its files cannot be used.
        InvalidInputError: An option that is out of range.
    """

    name: ClassVar[str] = "learned"

    def __init__(
        self,
        agent: str | Path | MotionAgent,
        *,
        sees: str = "both",
        scored: bool = False,
        detour: float = 0.0,
        temperature: float = 0.0,
        failure_penalty: float = 0.05,
        vertices: int = 8000,
        neighbours: int = 12,
        anchors: int = 12,
        effort: float = 1.0,
        candidates: int | None = None,
    ) -> None:
        self.agent = agent if isinstance(agent, MotionAgent) else load_motion_agent(str(agent))
        if sees not in SIGHTS:
            raise InvalidInputError(f"sees: expected one of {', '.join(SIGHTS)}, got {sees!r}")
        roadmap = Roadmap(vertices=vertices, neighbours=neighbours, anchors=anchors)
        predicted = Predicted(self.agent.belief, effort=effort)
        alone = sees == "estimate"
        super().__init__(
            Estimated(self.agent) if alone else roadmap,
            environment=UNCHANGED if alone else predicted,
            lesson=AVOID if alone else LESSON,
            fallback=Composed(Estimated(self.agent)) if sees == "both" else None,
            detour=detour,
            temperature=temperature,
            candidates=candidates,
        )
        self.scorer = self.agent.scorer
        self.scored = flag("scored", scored)
        self.failure_penalty = number("failure_penalty", failure_penalty, least=0)

    def _clearance(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Nothing: that would be a look at the obstacles themselves."""
        return np.zeros(len(q))

    def _crowding(self, q: NDArray[np.float64], contacts: NDArray[np.float64]) -> NDArray[np.float64]:
        """(n,) contacts within half a step of each configuration, each by its nearness."""
        reach, found = _NEAR * self.planner.step, np.zeros(len(q))
        for contact in contacts if len(q) else contacts[:0]:
            found += np.maximum(1.0 - self.space.distance(q, contact) / reach, 0.0)
        return found


def motion_class(name: str) -> type[MotionGuidance]:
    """The guiding space of one agent, as a class: what ``"learned:NAME"`` stands for."""
    load_motion_agent(name)
    body = {"name": f"learned:{name}", "__init__": partialmethod(MotionGuidance.__init__, name)}
    return type("MotionGuidance", (MotionGuidance,), {**body, "__doc__": MotionGuidance.__doc__})
