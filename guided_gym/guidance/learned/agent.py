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

from guided_gym.checks import number
from guided_gym.errors import UnknownNameError
from guided_gym.guidance import composed
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.composed import Composed
from guided_gym.guidance.learned import field, scorer, weights
from guided_gym.guidance.learned import rule as rules
from guided_gym.guidance.learned.field import FieldArchitecture, FieldModel
from guided_gym.guidance.learned.scorer import ScorerArchitecture, ScorerColumn, ScorerModel
from guided_gym.guidance.solvers import wave as pose_grid
from guided_gym.guidance.solvers.wave import Wave
from guided_gym.kernels import fields
from guided_gym.options import DEFAULT_TARGET

if TYPE_CHECKING:
    from guided_gym.search.tree import SearchTree

_CLIP: Final = 4.0  # of remaining way and of detour, in optima
_LEAST: Final = 1e-9  # sides of the workspace that a way left may be as a unit
_AGAIN: Final = 3.0  # failures that each child of a node after its first counts as
_CONTACT_REACH: Final = 0.5  # steps around a contact that count as known to be bad

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
    try:
        there = bool(name) and folder.is_dir()
    except (OSError, ValueError):  # longer than any path
        there = False
    if not there:
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


class LearnedGuidance(Composed):
    """S = the columns of the node scorer over a learned field; h falls as the score rises.

    A composition whose solver is a wave through what the field network takes for free. A node is selected by
    its logit; x_new is the candidate from which the field sees the shortest way.

    Args:
        agent: A shipped agent's name, a folder, or a `LearnedAgent`.
        temperature: 0 selects the largest logit; 1 draws from the softmax that was trained.
        failure_penalty: Nats that each failed expansion of a node takes from its logit; each child after the
            first takes more, so that nothing is tried in vain forever.
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
        temperature: float = 0.0,
        failure_penalty: float = 0.05,
        candidates: int | None = None,
    ) -> None:
        self.agent = agent if isinstance(agent, LearnedAgent) else load_named(str(agent))
        super().__init__(Wave.of(self.agent.field), temperature=temperature, candidates=candidates)
        self.failure_penalty = number("failure_penalty", failure_penalty, least=0)

    def prepare(self) -> None:
        """Evaluate the field, once per problem."""
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
        """(n,) nats taken from the logit of each node, so that nothing is tried in vain forever."""
        n = len(tree)
        again = _AGAIN * np.maximum(tree.nodes.children[:n] - 1, 0)
        return np.asarray(self.failure_penalty * (tree.nodes.failures[:n] + again))

    def logits(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) the score of each node, less its penalty."""
        scores = self.agent.scorer.logits(self.columns(tree)).astype(np.float64)
        return np.asarray(scores - self.penalties(tree))

    def values(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) h of each node (length): how far its logit lies below the largest, as a way left would count.

        A way left of an optimum takes 1 / tau nats from the target's logit.
        """
        logits = self.logits(tree)
        return np.asarray((logits.max() - logits) * DEFAULT_TARGET.tau * self._optimum(tree))

    def distribution(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) one-hot at the largest logit, or the softmax of the logits if there is a temperature."""
        if self.temperature == 0:
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
            self._seen[first:n, 0] = self.space.clearance(q[first:n])
            self._seen[first:n, 1] = self.space.distance(q[first:n], self.goal)
            self._seen[first:n, 2] = self._crowding(q[first:n], contacts[: self._contacts])
            self._nodes = n
        return self._seen[:n]

    def _crowding(self, q: NDArray[np.float64], contacts: NDArray[np.float64]) -> NDArray[np.float64]:
        reach = _CONTACT_REACH * self.planner.step
        weight = float(self.space.weights[2]) if self.space.dimension == 3 else 0.0
        return np.asarray(fields.crowding(q, contacts, np.ones(len(contacts)), reach, weight))


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
    modules = (rules,) if a_rule else (sys.modules[__name__], field, scorer, composed, pose_grid, fields)
    for module in modules:
        source = Path(str(module.__file__))
        digest.update(source.read_bytes() if source.is_file() else b"")
    return digest.hexdigest()[:16]
