"""What trainings in stages share: checkpoints, history, the best weights, and rounds of the node scorer.

A round searches with the policy as it is, and learns the target distribution on all trees so far (DAgger).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from guided_gym.catalogue.table import make_distribution
from guided_gym.checks import count, integer
from guided_gym.compute.workers import MapTasks, in_order
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.scored import ScoredGuidance
from guided_gym.guidance.learned.scorer import ScorerColumn
from guided_gym.measure.target import Measure
from guided_gym.options import checked_samples
from guided_gym.planning import proposer
from guided_gym.randomness import seed_of, streams
from guided_gym.search.search import Expansion, Search
from guided_gym.train import networks
from guided_gym.train.checkpoints import RunFolder
from guided_gym.train.lessons import mixed_problem
from guided_gym.train.terminal import Progress
from guided_gym.train.validation import rank, validated

Tensors = dict[str, NDArray[Any]]
Tree = tuple[NDArray[np.float32], NDArray[np.float32]]
"""(n, columns) what the scorer sees of a tree's nodes, and (n,) the target distribution over them."""

SCORER_SEED: Final = 3
_STEPS_KEPT: Final = 16  # of a search, for the scorer
_TREES_A_BATCH: Final = 32
_LATE: Final = 50  # last losses, whose mean is noted

# Bytes, about: what a round's trees and the scorer take.
_TREE: Final = 16 * 1024 * 60  # of the steps kept, each with its columns of some 1,000 nodes
_UNIT: Final = 100_000  # with its row of weights, Adam's moments, and its values in a batch of trees


@dataclass(frozen=True)
class StagedConfig:
    """The options that every such run has.

    Attributes:
        environments: Distributions of problems, taken in turns.
        seed: Of everything random. The same seed gives the same weights on one machine.
        problems: Training problems.
        validation: Validation problems.
        rounds: Rounds of DAgger; 0 keeps the scorer that has learned nothing.
        searches: Searches a round.
        scorer_steps: Steps of gradient descent a round.
        selection: Whether trees, and the searches that choose among scorers, are expanded uniformly, as in
            the protocol ``selection``; less excess SE is better there.
        max_samples: Samples after which a search gives up.
        scorer_hidden: Units of each layer of the scorer.

    Raises:
        InvalidInputError: An option that is out of range.
    """

    environments: tuple[str, ...] = ()
    seed: int = 0
    problems: int = 128
    validation: int = 24
    rounds: int = 1
    searches: int = 32
    scorer_steps: int = 400
    selection: bool = False
    max_samples: int = 300
    scorer_hidden: int = 32

    def __post_init__(self) -> None:
        if not self.environments:
            raise InvalidInputError("environments: expected at least one, got none")
        for name in ("seed", "rounds", "scorer_steps"):
            integer(name, getattr(self, name), least=0)
        for name in ("problems", "validation"):
            integer(name, getattr(self, name), least=1)
        checked_samples(self.max_samples)
        count("searches", self.searches, least=1, each=_TREE, what="the trees of a round")
        count("scorer_hidden", self.scorer_hidden, least=1, each=_UNIT, what="a scorer of so many units")


class StagedRun(ABC):
    """One run: its state and files. A subclass has the networks and the stages.

    Args:
        config: Its options.
        out: Its folder.
        progress: Called with (steps done, steps in all, what is being done).
        begun: What the state of a run holds before its first stage.
        device: Where the scorer learns.

    Raises:
        UnknownNameError: No such environment.
        StorageError: The folder holds another run, or a damaged file.
    """

    method: ClassVar[str]
    config: StagedConfig
    scorer: networks.NodeScorer

    def __init__(
        self,
        config: StagedConfig,
        out: Path,
        progress: Progress | None,
        begun: dict[str, Any],
        device: torch.device | None = None,
    ) -> None:
        self.config, self.device = config, device
        self.progress = progress or (lambda done, total, what: None)
        self.search: MapTasks = in_order
        self.distributions = [make_distribution(name) for name in config.environments]
        self.folder = RunFolder(out, config, self.method)
        self.state: dict[str, Any] = {**begun, "history": [], "best": None}
        self.best: Tensors = {}
        self.moments: Tensors = {}

    @abstractmethod
    def tensors(self) -> Tensors:
        """The weights as they are."""

    @abstractmethod
    def load(self, tensors: Tensors) -> None:
        """Take weights that `tensors` gave."""

    @abstractmethod
    def searcher(self, temperature: float = 0.0) -> ScoredGuidance:
        """The policy as it is, selecting by its scorer."""

    def restore(self) -> None:
        """Continue from the last checkpoint, if there is one."""
        loaded = self.folder.load()
        if loaded is not None:
            self.state, tensors = loaded
            self.load(weights.part_of(tensors, "now", "/"))
            self.best, self.moments = (weights.part_of(tensors, group, "/") for group in ("best", "adam"))

    def save(self, optimizer: torch.optim.Optimizer | None = None) -> None:
        """Replace the checkpoint; with an optimizer in the midst of a stage."""
        self.moments = moments_of(optimizer) if optimizer is not None else {}
        groups = {"now": self.tensors(), "best": self.best, "adam": self.moments}
        self.folder.save(
            self.state, {f"{group}/{name}": t for group, some in groups.items() for name, t in some.items()}
        )

    def note(self, what: str, **values: float) -> None:
        """Enter something in the history."""
        self.state["history"].append({"what": what, **values})

    def consider(self, stage: str, guidance: GuidingSpace, kind: str = "best", always: bool = False) -> None:
        """Search on the validation problems; keep these weights if they are the best so far.

        Args:
            stage: What has been learned last.
            guidance: Who searches.
            kind: Which of the entries of the state's bests is compared: figures of the same guidance.
            always: Keep them, whatever they reach: what follows builds on them.
        """
        config = self.config
        found = validated(
            self.distributions,
            guidance,
            count=config.validation,
            max_samples=config.max_samples,
            run=self.search,
            expansion="uniform" if config.selection else None,
        )
        self.note(f"validation after {stage}", **found)
        best = self.state.get(kind)
        order = partial(rank, selection=config.selection)
        if best is None or always or order(found) < order(best):
            self.state[kind] = {**found, "stage": stage}
            self.best = self.tensors()

    def train_scorer(self, number: int, learning_rate: float, divergence: str = "forward") -> None:
        """One round: search with the policy as it is, then learn Q on all trees seen so far."""
        config = self.config
        names = [f"data/trees-{i:03d}.safetensors" for i in range(number + 1)]
        if not (self.folder.path / names[-1]).exists():
            self.folder.keep(names[-1], {"round": number}, joined_trees(self._searched_trees(number)))
        trees = [t for name in names for t in split_trees(RunFolder.read(self.folder.path / name)[1])]
        rng = np.random.default_rng(seed_of(config.seed, SCORER_SEED, number))
        optimizer, schedule = networks.adam(self.scorer, learning_rate, config.scorer_steps)
        losses = []
        for _ in range(config.scorer_steps if trees else 0):
            batch = [trees[i] for i in rng.integers(len(trees), size=_TREES_A_BATCH)]
            loss = tree_loss(self.scorer, batch, divergence, self.device)
            losses.append(networks.descend(loss, optimizer, schedule))
        self.note("scorer", round=number + 1, loss=late(losses), trees=len(trees))

    def _searched_trees(self, number: int) -> list[Tree]:
        """Columns and targets of trees along searches of this round; every other search draws its nodes."""
        config = self.config
        kept: list[Tree] = []
        for i in range(config.searches):
            index = (number * config.searches + i) % config.problems
            problem = mixed_problem(self.distributions, "train", index)
            guidance = self.searcher(temperature=float(i % 2))
            _, expansion, choice = streams(seed_of(config.seed, SCORER_SEED, number, i))
            search = Search(problem, expansion, choice)
            search.attach(guidance)
            seen = TreeLessons(guidance, search)
            propose = proposer(search, "uniform" if config.selection else None)
            search.run(guidance, config.max_samples, propose=propose, watcher=seen)
            kept.extend(seen.some(_STEPS_KEPT))
        return kept


class TreeLessons:
    """What a node scorer is taught: its columns and the target distribution, before each choice."""

    def __init__(self, guidance: ScoredGuidance, search: Search) -> None:
        self._guidance, self._tree, self._measure = guidance, search.tree, Measure(search)
        self.rows: list[Tree] = []

    def some(self, count: int) -> list[Tree]:
        """Up to ``count`` of the lessons, evenly spread, from trees with a choice."""
        rows = self.rows
        which = np.unique(np.linspace(0, len(rows) - 1, min(count, len(rows))).astype(int))
        return [rows[k] for k in which if len(rows[k][1]) > 1]

    def before(self, node: int) -> None:
        """Record the tree as it stands."""
        target = self._measure.distribution().astype(np.float32)
        self.rows.append((self._guidance.columns(self._tree), target))

    def after(self, expansion: Expansion) -> None:
        """Nothing."""

    def take(self, rows: NDArray[np.int32]) -> None:
        """Nothing: learned guidance runs in no bursts."""

    def rewiring(self) -> None:
        """No planner is watched here."""

    def changed(self) -> None:
        """No planner is watched here."""


def tree_loss(
    scorer: networks.NodeScorer,
    batch: list[Tree],
    divergence: str = "forward",
    device: torch.device | None = None,
) -> Tensor:
    """Mean divergence between the target distribution and the softmax of a scorer's logits."""
    longest = max(len(q) for _, q in batch)
    columns = np.zeros((len(batch), longest, len(ScorerColumn)), np.float32)
    target = np.zeros((len(batch), longest), np.float32)
    for row, (nodes, q) in enumerate(batch):
        columns[row, : len(q)], target[row, : len(q)] = nodes, q
    wanted = torch.from_numpy(target).to(device)
    mask = wanted > 0
    logp = functional.log_softmax(scorer(torch.from_numpy(columns).to(device), mask), dim=1)
    logp = logp.masked_fill(~mask, 0.0)
    logq = torch.log(wanted.clamp_min(1e-30)).masked_fill(~mask, 0.0)
    if divergence == "forward":
        terms = wanted * (logq - logp)
    else:
        terms = logp.exp().masked_fill(~mask, 0.0) * (logp - logq)
    return terms.sum(1).mean()


def joined_trees(trees: list[Tree]) -> Tensors:
    """Trees as the tensors of a file."""
    none = np.zeros((0, len(ScorerColumn)), np.float32), np.zeros(0, np.float32)
    return {
        "sizes": np.array([len(q) for _, q in trees], np.int64),
        "columns": np.concatenate([none[0], *(c for c, _ in trees)]),
        "targets": np.concatenate([none[1], *(q for _, q in trees)]),
    }


def split_trees(tensors: Tensors) -> list[Tree]:
    """The trees that `joined_trees` joined."""
    ends = np.cumsum(tensors["sizes"])[:-1]
    return list(zip(np.split(tensors["columns"], ends), np.split(tensors["targets"], ends), strict=True))


def moments_of(optimizer: torch.optim.Optimizer) -> Tensors:
    """Adam's state as tensors."""
    out: Tensors = {}
    for index, entry in optimizer.state_dict()["state"].items():
        for name, value in entry.items():
            out[f"{index}.{name}"] = value.detach().cpu().numpy().astype(np.float32)
    return out


def put_moments(optimizer: torch.optim.Optimizer, moments: Tensors) -> None:
    """Give Adam the state that `moments_of` took; without any, leave it as it is."""
    if not moments:
        return
    state = optimizer.state_dict()
    for key, value in moments.items():
        index, _, name = key.partition(".")
        state["state"].setdefault(int(index), {})[name] = torch.from_numpy(np.array(value))
    optimizer.load_state_dict(state)


def late(losses: list[float]) -> float:
    """The mean of the last losses; 0 without any."""
    return float(np.mean(losses[-_LATE:])) if losses else 0.0
