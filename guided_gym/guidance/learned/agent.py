"""Learned guidance: a field network and a node scorer as a guiding space (paper, Experience-based Guidance).

`make_guidance("learned:NAME")` makes one of a shipped agent or of a folder that training wrote. Runs on numpy
alone.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Sequence
from functools import lru_cache, partialmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.errors import UnknownNameError
from guided_gym.guidance import wavefront
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.learned import field, scorer, weights
from guided_gym.guidance.learned import rule as rules
from guided_gym.guidance.learned.field import FieldArchitecture, FieldModel
from guided_gym.guidance.learned.scorer import ScorerArchitecture, ScorerColumn, ScorerModel
from guided_gym.guidance.solvers import wave as pose_grid
from guided_gym.guidance.wavefront import Wavefront
from guided_gym.kernels import fields

if TYPE_CHECKING:
    from guided_gym.search.tree import SearchTree

SHIPPED: Final = Path(__file__).parent / "shipped"


def shipped_agents() -> list[str]:
    """Names of the agents that come with the package."""
    if not SHIPPED.is_dir():
        return []
    return sorted(path.parent.name for path in SHIPPED.glob(f"*/{weights.CARD_FILE}"))


def agent_folder(name: str) -> Path:
    """The folder of a shipped agent or of one of your own.

    Raises:
        UnknownNameError: Neither a shipped agent nor a folder.
    """
    if name in shipped_agents():
        return SHIPPED / name
    folder = Path(name)
    if not name or not folder.is_dir():
        raise UnknownNameError("learned agent (and no such folder)", name, shipped_agents())
    return folder


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
        expected = {f"field.{name}": shape for name, shape in field.shapes().items()}
        expected.update({f"scorer.{name}": shape for name, shape in scorer.shapes().items()})
        weights.check_tensors(tensors, expected, Path(folder) / weights.WEIGHTS_FILE)
        parts = {part: _part(tensors, part) for part in ("field", "scorer")}
        return cls(card, FieldModel(field, parts["field"]), ScorerModel(scorer, parts["scorer"]))


def _part(tensors: weights.Tensors, part: str) -> weights.Tensors:
    return {name.partition(".")[2]: t for name, t in tensors.items() if name.startswith(f"{part}.")}


class LearnedGuidance(Wavefront):
    """S = the columns of the node scorer and the learned field; h falls as the score rises.

    A node is selected by its logit; x_new is the candidate from which the field sees the shortest way, as in
    `Wavefront`.

    Args:
        agent: A shipped agent's name, a folder, or a `LearnedAgent`.
        temperature: 0 selects the largest logit; 1 draws from the softmax that was trained.
        failure_penalty: Nats that each failed expansion of a node takes from its logit; each child after the
            first takes more, and a crowd of nodes around it some, so that nothing is tried in vain forever.
        candidates: Members of N_C(v) that a proposal looks at, more of them in a crowd; None for as many as
            the search's options say.
        patience: Expansions in a row without progress after which the wave runs again.

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
        temperature: float = 0.0,
        failure_penalty: float = 0.3,
        candidates: int | None = None,
        patience: int = 12,
    ) -> None:
        self.agent = agent if isinstance(agent, LearnedAgent) else load_named(str(agent))
        self._begin(self.agent.field, temperature, failure_penalty, candidates, patience)

    def prepare(self) -> None:
        """Evaluate the field, once per problem."""
        super().prepare()
        self._sights = np.zeros((256, 2))  # clearance, distance to the goal
        self._sighted = 0

    def columns(self, tree: SearchTree) -> NDArray[np.float32]:
        """(n, F) what the scorer sees of each node, as in `ScorerColumn`."""
        self._update(tree)
        n = len(tree)
        clearance, distance = self._seen_of(tree).T
        out = np.empty((n, len(ScorerColumn)), np.float32)
        left, excess = self._left_and_detour(tree)
        energy = left + excess
        out[:, ScorerColumn.REMAINING] = left
        out[:, ScorerColumn.EXCESS] = excess
        out[:, ScorerColumn.FAILURES] = np.log1p(tree.nodes.failures[:n])
        out[:, ScorerColumn.CHILDREN] = np.log1p(tree.nodes.children[:n])
        out[:, ScorerColumn.CONTACTS] = np.log1p(self._nodes[:n, 1])
        out[:, ScorerColumn.CLEARANCE] = np.minimum(clearance / self.planner.step, 2.0)
        out[:, ScorerColumn.DISTANCE] = np.minimum(distance / self._optimum(), 4.0)
        out[:, ScorerColumn.GAP] = np.minimum(energy - energy.min(), 2.0)
        return out

    def logits(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) the score of each node."""
        scores = self.agent.scorer.logits(self.columns(tree)).astype(np.float64)
        return np.asarray(scores - self.penalties(tree))

    def _seen_of(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n, 2) clearance and distance to the goal of each node, looked at once."""
        n = len(tree)
        if n > len(self._sights):
            self._sights = np.concatenate([self._sights, np.zeros((n, 2))])
        if n > self._sighted:
            q = tree.nodes.configurations[self._sighted : n]
            self._sights[self._sighted : n, 0] = self.space.clearance(q)
            self._sights[self._sighted : n, 1] = self.space.distance(q, self.goal)
            self._sighted = n
        return self._sights[:n]


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
    stamp = []
    for file in (weights.CARD_FILE, weights.WEIGHTS_FILE):
        found = (folder / file).stat() if (folder / file).is_file() else None
        stamp += [found.st_mtime_ns, found.st_size] if found else [0, 0]
    return _loaded(folder, tuple(stamp))


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
    if weights.card_kind(agent_folder(name)) == rules.RULE_KIND:
        return rules.hybrid_class(name, agent_folder(name), make_guides)
    load_named(name)
    body = {"name": f"learned:{name}", "__init__": partialmethod(LearnedGuidance.__init__, name)}
    return type("LearnedGuidance", (LearnedGuidance,), {**body, "__doc__": LearnedGuidance.__doc__})


def fingerprint(name: str) -> str:
    """Hash of an agent's card and weights and of the code that runs them, for results files.

    Raises:
        UnknownNameError: No such agent.
        StorageError: Its card cannot be used.
    """
    folder = agent_folder(name)
    a_rule = weights.card_kind(folder) == rules.RULE_KIND
    card = rules.load_rule_card(folder) if a_rule else weights.load_card(folder)
    digest = hashlib.sha256(card["weights_sha256"].encode())
    modules = (rules,) if a_rule else (sys.modules[__name__], field, scorer, wavefront, pose_grid, fields)
    for module in modules:
        source = Path(str(module.__file__))
        digest.update(source.read_bytes() if source.is_file() else b"")
    return digest.hexdigest()[:16]
