"""Learned guidance: a field network and a node scorer as a guiding space (paper, Experience-based Guidance).

`make_guidance("learned:NAME")` makes one of a shipped agent or of a folder that training wrote. Runs on numpy
alone.
"""

from __future__ import annotations

import hashlib
import os
from collections import OrderedDict
from functools import lru_cache, partialmethod
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.agents import rules, weights
from guided_gym.agents.field import CostField, FieldArchitecture, FieldModel, Grid
from guided_gym.agents.scorer import ScorerArchitecture, ScorerColumn, ScorerModel
from guided_gym.checks import integer, number
from guided_gym.errors import UnknownNameError
from guided_gym.guidance.base import GuidingSpace, draw
from guided_gym.kernels import fields

if TYPE_CHECKING:
    from guided_gym.problems import Problem
    from guided_gym.tree import SearchTree

SHIPPED: Final = Path(__file__).parent / "shipped"
_FIELDS_KEPT: Final = 8
_MOTION_PARTS: Final = 4  # poses along a motion at which its room is looked up
_ENOUGH_ROOM: Final = 0.5  # cells; a motion with less is worth less
_CONTACT_REACH: Final = 0.5  # steps around a contact that count as known to be bad
_CROWD: Final = 6.0  # nodes within that reach that are no crowd yet, the node itself included
_AGAIN: Final = 3.0  # failures that each child of a node after its first counts as
_NEVER: Final = 1e6  # steps; stands for "the field sees no way"


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
    """Networks of an agent with their card, and the fields that they gave lately.

    Attributes:
        card: What is known of the agent (see `guided_gym.agents.weights`).
        field: The field network.
        scorer: The node scorer.
    """

    def __init__(self, card: dict[str, Any], field: FieldModel, scorer: ScorerModel) -> None:
        self.card, self.field, self.scorer = card, field, scorer
        self._fields: OrderedDict[str, CostField] = OrderedDict()

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

    def cost_field(self, problem: Problem) -> CostField:
        """The field of a problem, evaluated once."""
        key = problem.fingerprint
        if key not in self._fields:
            grid = Grid.of(problem.space, self.field.architecture)
            self._fields[key] = self.field.evaluate(grid, problem.task.goal)
            while len(self._fields) > _FIELDS_KEPT:
                self._fields.popitem(last=False)
        self._fields.move_to_end(key)
        return self._fields[key]


def _part(tensors: weights.Tensors, part: str) -> weights.Tensors:
    return {name.partition(".")[2]: t for name, t in tensors.items() if name.startswith(f"{part}.")}


class LearnedGuidance(GuidingSpace):
    """S = the columns of the node scorer and the learned field; h falls as the score rises.

    A node is selected by its logit; x_new is the candidate from which the field sees the shortest way, less
    likely through what looks blocked or lies beside known contacts.

    Args:
        agent: A shipped agent's name, a folder, or a `LearnedAgent`.
        temperature: 0 selects the largest logit; 1 draws from the softmax that was trained.
        failure_penalty: Nats that each failed expansion of a node takes from its logit; each child after the
            first takes more, and a crowd of nodes around it some, so that nothing is tried in vain forever.
        candidates: Members of N_C(v) that a proposal looks at.

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
        candidates: int = 64,
    ) -> None:
        super().__init__(temperature=temperature, expansion_penalty=0.0)
        self.agent = agent if isinstance(agent, LearnedAgent) else load_named(str(agent))
        self.failure_penalty = number("failure_penalty", failure_penalty, least=0)
        self.candidates = integer("candidates", candidates, least=1)

    def prepare(self) -> None:
        """Evaluate the field, once per problem."""
        self._field = self.agent.cost_field(self.search.problem)
        self._reach = _CONTACT_REACH * self.planner.step
        self._side = float(self._field.frame[fields.CELL] * len(self._field.values))
        self._weight = float(self._field.frame[fields.WEIGHT])
        self._nodes = np.zeros((256, 5))  # remaining, contacts, clearance, distance to the goal, nodes around
        self._seen = self._contacts = 0

    def project(self, tree: SearchTree, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """(m, 2) the field at configurations (length) and how crowded known contacts are around them."""
        q = np.ascontiguousarray(q)
        remaining = np.minimum(self._field.cost_to_go(q), _NEVER * self.planner.step)
        contacts = tree._contacts[: tree.failure_count]
        return np.column_stack([remaining, fields.crowding(q, contacts, self._reach, self._weight)])

    def heuristic(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """The field, and a step for each contact at hand."""
        return np.asarray(states[:, 0] + self.planner.step * states[:, 1])

    def columns(self, tree: SearchTree) -> NDArray[np.float32]:
        """(n, F) what the scorer sees of each node, as in `ScorerColumn`."""
        self._update(tree)
        n = len(tree)
        remaining, crowding, clearance, distance, _ = self._nodes[:n].T
        unit = min(max(self._nodes[0, 0], 1e-9), 4.0 * self._side)
        out = np.empty((n, len(ScorerColumn)), np.float32)
        left = np.minimum(remaining / unit, 4.0)
        excess = np.clip((tree._costs[:n] + remaining) / unit - 1.0, 0.0, 4.0)
        energy = left + excess
        out[:, ScorerColumn.REMAINING] = left
        out[:, ScorerColumn.EXCESS] = excess
        out[:, ScorerColumn.FAILURES] = np.log1p(tree._failures[:n])
        out[:, ScorerColumn.CHILDREN] = np.log1p(tree._children[:n])
        out[:, ScorerColumn.CONTACTS] = np.log1p(crowding)
        out[:, ScorerColumn.CLEARANCE] = np.minimum(clearance / self.planner.step, 2.0)
        out[:, ScorerColumn.DISTANCE] = np.minimum(distance / unit, 4.0)
        out[:, ScorerColumn.GAP] = np.minimum(energy - energy.min(), 2.0)
        return out

    def logits(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) the score of each node."""
        scores = self.agent.scorer.logits(self.columns(tree)).astype(np.float64)
        return np.asarray(scores - self.penalties(tree))

    def penalties(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) what is taken from the score of each node, after `columns`."""
        crowd = np.log1p(np.maximum(self._nodes[: len(tree), 4] - _CROWD, 0.0))
        again = _AGAIN * np.maximum(tree._children[: len(tree)] - 1, 0)
        return np.asarray(self.failure_penalty * (tree._failures[: len(tree)] + again + crowd))

    def values(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) h of each node: how far its logit lies below the largest, in nats."""
        logits = self.logits(tree)
        return np.asarray(logits.max() - logits)

    def distribution(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) the distribution P over the nodes from which `select` draws."""
        h = self.values(tree)
        if self.temperature == 0:
            p = np.zeros(h.size)
            p[int(np.argmin(h))] = 1.0
            return p
        p = np.exp(-h / self.temperature)
        return np.asarray(p / p.sum())

    def select(self, tree: SearchTree) -> int:
        """The node of the largest logit, or a draw from P if there is a temperature."""
        if self.temperature == 0:
            return int(np.argmax(self.logits(tree)))
        return draw(self.distribution(tree), self.rng)

    def propose(self, tree: SearchTree, node: int) -> NDArray[np.float64]:
        """(d,) x_new: the candidate with the shortest way on, shy of what looks blocked."""
        q = tree._configurations[node]
        step = self.planner.step
        self._update(tree)
        candidates = self.planner.candidates(q, self.candidates)
        lengths = np.asarray(self.space.distance(candidates, q))
        states = self.project(tree, candidates)
        # No free motion brings the goal nearer than by its length: what seems to lies behind a wall.
        states[:, 0] = np.maximum(states[:, 0], self._nodes[node, 0] - lengths)
        room = fields.least_room(q, candidates, self._field.room, self._field.frame, _MOTION_PARTS)
        tight = np.clip((_ENOUGH_ROOM - room) / _ENOUGH_ROOM, 0.0, 4.0)
        tight /= 1 + tree._children[node]  # what was safe has not helped: dare more
        return np.asarray(candidates[int(np.argmin(self.heuristic(states) + 0.5 * lengths + step * tight))])

    def _update(self, tree: SearchTree) -> None:
        """Take in the nodes and contacts that are new."""
        n, failed = len(tree), tree.failure_count
        if failed > self._contacts and self._seen:
            fresh = tree._contacts[self._contacts : failed]
            old = tree._configurations[: self._seen]
            self._nodes[: self._seen, 1] += fields.crowding(old, fresh, self._reach, self._weight)
        self._contacts = failed
        if n > len(self._nodes):
            self._nodes = np.concatenate([self._nodes, np.zeros((n, 5))])
        if n > self._seen:
            q = tree._configurations[self._seen : n]
            rows = self._nodes[self._seen : n]
            rows[:, :2] = self.project(tree, q)
            rows[:, 2] = self.space.clearance(q)
            rows[:, 3] = self.space.distance(q, self.goal)
            old = tree._configurations[: self._seen]
            self._nodes[: self._seen, 4] += fields.crowding(old, q, self._reach, self._weight)
            rows[:, 4] = fields.crowding(q, tree._configurations[:n], self._reach, self._weight)
            for i in range(max(self._seen, 1), n):
                # The edge to the parent is free, so the way on is no longer than it and the parent's.
                parent = int(tree._parents[i])
                edge = float(self.space.distance(tree._configurations[i], tree._configurations[parent]))
                self._nodes[i, 0] = min(self._nodes[i, 0], self._nodes[parent, 0] + edge)
            self._seen = n


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


def guidance_class(name: str) -> type[GuidingSpace]:
    """The guiding space of one agent, as a class: what ``"learned:NAME"`` stands for.

    Of a rule's folder, the hybrid of that rule and its guides.

    Raises:
        UnknownNameError: No such agent.
        StorageError: Its files cannot be used.
    """
    if weights.card_kind(agent_folder(name)) == rules.RULE_KIND:
        return rules.hybrid_class(name, agent_folder(name))
    load_named(name)
    body = {"name": f"learned:{name}", "__init__": partialmethod(LearnedGuidance.__init__, name)}
    return type("LearnedGuidance", (LearnedGuidance,), {**body, "__doc__": LearnedGuidance.__doc__})


def fingerprint(name: str) -> str:
    """Hash of an agent's card and weights and of the code that runs them, for results files.

    Raises:
        UnknownNameError: No such agent.
        StorageError: Its card cannot be used.
    """
    here = Path(__file__).parent
    folder = agent_folder(name)
    a_rule = weights.card_kind(folder) == rules.RULE_KIND
    card = rules.load_rule_card(folder) if a_rule else weights.load_card(folder)
    digest = hashlib.sha256(card["weights_sha256"].encode())
    for module in ("rules.py",) if a_rule else ("learned.py", "field.py", "scorer.py"):
        digest.update((here / module).read_bytes() if os.path.isfile(here / module) else b"")
    return digest.hexdigest()[:16]
