"""Learned guidance without a grid: a lazy roadmap through what is believed free, and a node scorer."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import flag, integer, number
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.composed import AVOID, Composed, Lesson
from guided_gym.guidance.learned.motion_agent import MotionAgent, load_motion_agent
from guided_gym.guidance.learned.scored import ScoredGuidance, class_of
from guided_gym.guidance.modifications import UNCHANGED, Expected, Inner, Predicted
from guided_gym.guidance.solvers.estimated import Estimated
from guided_gym.guidance.solvers.roadmap import Roadmap
from guided_gym.guidance.solvers.shortened import Shortened
from guided_gym.search.search import NO_NODE, Expansion

if TYPE_CHECKING:
    from guided_gym.search.tree import SearchTree

LESSON: Final = Lesson(reach=0.2, factor=math.inf, check=0.0)
"""A failure refutes what passes near it; nothing is checked for collision."""
SELECTION: Final = ("scored", "detour", "expansion_penalty", "effort")
"""Options of which a card may say what they are unless others are given."""
SIGHTS: Final = ("belief", "estimate", "both")
TEACHES_NOTHING: Final = Lesson(factor=1.0)
_NEAR: Final = 0.5  # steps around a contact that count as known to be bad


class MotionGuidance(ScoredGuidance):
    """``roadmap(environment=predicted(AGENT))`` with the agent's node scorer, and its cost-to-go as fallback.

    Args:
        agent: A shipped agent's name, a folder, or a `MotionAgent`.
        sees: What h rests on: ``"belief"``, the roadmap through what is believed free; ``"estimate"``, the
            cost-to-go network; ``"both"``, the roadmap, the network for nodes without a way on it, and a
            checked roadmap once no node has one.
        scored: Whether the scorer selects; without, h does.
        detour: How much a node's suboptimality counts in h, where the scorer does not select.
        temperature: 0 selects the largest logit, or least h; 1 draws from the softmax that was trained.
        failure_penalty: Nats that each failed expansion of a node takes from its logit.
        expansion_penalty: What each expansion of a node adds to its h (natural lengths), without the scorer.
        vertices: Of the roadmap, which is drawn once for each robot.
        neighbours: Edges from each vertex to its nearest neighbours.
        anchors: Vertices that a configuration is joined to.
        effort: What a failure costs, in lengths of the motion (see `Predicted`).
        checked: Vertices of that roadmap of the inner bodies, with as many neighbours and anchors. It is
            drawn, and checked for collision, only when it is needed. 0 for none: the network guides then.
        shortened: Whether the best way on the roadmap is shortened, and followed (see `Shortened`).
        trust: Failures after which the belief alone is not trusted any more: from then on, what a way would
            take is checked for collision first, and counted. None for never.
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
        expansion_penalty: float = 0.1,
        vertices: int = 8000,
        neighbours: int = 12,
        anchors: int = 12,
        effort: float = 1.0,
        checked: int = 8000,
        shortened: bool = True,
        trust: int | None = 4,
        candidates: int | None = None,
    ) -> None:
        self.agent = agent if isinstance(agent, MotionAgent) else load_motion_agent(str(agent))
        if sees not in SIGHTS:
            raise InvalidInputError(f"sees: expected one of {', '.join(SIGHTS)}, got {sees!r}")
        kind = Shortened if flag("shortened", shortened) else Roadmap
        roadmap = kind(vertices=vertices, neighbours=neighbours, anchors=anchors)
        predicted = Predicted(self.agent.belief, effort=effort)
        alone = sees == "estimate"
        estimate = Composed(Estimated(self.agent)) if sees == "both" else None
        super().__init__(
            Estimated(self.agent) if alone else roadmap,
            environment=UNCHANGED if alone else predicted,
            lesson=AVOID if alone else LESSON,
            fallback=estimate,
            detour=detour,
            temperature=temperature,
            expansion_penalty=expansion_penalty,
            candidates=candidates,
        )
        self.scorer = self.agent.scorer
        self.scored = flag("scored", scored)
        self.failure_penalty = number("failure_penalty", failure_penalty, least=0)
        self.trust = None if trust is None else integer("trust", trust, least=0)
        self._first, self._last = estimate, estimate
        if integer("checked", checked, least=0) and sees == "both":
            self._last = Composed(
                Roadmap(vertices=checked, neighbours=neighbours, anchors=anchors),
                Inner(),
                lesson=TEACHES_NOTHING,
                fallback=estimate,
            )

    def prepare(self) -> None:
        """Have the roadmap begin."""
        self.fallback = self._first
        super().prepare()
        self._look_where_it_failed(0)

    def feedback(self, expansion: Expansion) -> None:
        """As in `Composed`; after so many failures, ways are checked."""
        super().feedback(expansion)
        if expansion.contact is not None:
            self._look_where_it_failed(self.search.tree.failure_count)

    def _look_where_it_failed(self, failures: int) -> None:
        """Have ways checked from now on, if there are just as many failures as the belief is trusted for."""
        doubts = self.query.doubts
        if failures == self.trust and isinstance(doubts, Expected):
            doubts.check_in(self.space)
            if isinstance(self.solver, Shortened):
                self.solver.forget()

    def select(self, tree: SearchTree) -> int:
        """As in `Composed`; the checked roadmap begins where no node has a way for the first time."""
        if self.fallback is not self._last and self._lost(tree):
            self._check(tree)
        return super().select(tree)

    def _check(self, tree: SearchTree) -> None:
        """Have a checked roadmap guide where the belief sees no way; what it looks at is counted."""
        assert self._last is not None
        self.fallback = self._last
        self._last.reset(self.search)
        solver = self._last.solver
        assert isinstance(solver, Roadmap)
        self.search.looks += solver.checks
        self.search.collision_checks += solver.checks
        failed, count = tree.failed, tree.failure_count
        for node, target, contact in zip(
            failed.nodes[:count], failed.targets[:count], failed.contacts[:count], strict=True
        ):
            self._last.feedback(Expansion(int(node), target, NO_NODE, contact, False))

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
    return class_of(MotionGuidance, name, load_motion_agent(name).card, SELECTION)
