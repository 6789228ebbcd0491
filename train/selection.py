"""Direct search for the numbers by which an agent selects nodes, on what is measured: excess SE.

CMA-ES (the package ``cmaes``) tries numbers on searches of training problems in which all expand uniformly.
All candidates of a generation search the same problems with the same seeds, and so do the numbers that the
run began with: a candidate's loss is its share of theirs. Nothing is taught, so nothing has to be known of
what a good choice is. Numbers are kept only if they search better on validation problems: if they solve more,
or as many with less total SE.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from cmaes import CMA
from numpy.typing import NDArray

from guided_gym.catalogue.table import make_distribution
from guided_gym.checks import count, integer
from guided_gym.compute.workers import MapTasks, Workers, in_order, worker_pool
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.agent import LearnedAgent, LearnedGuidance
from guided_gym.guidance.learned.folders import agent_folder
from guided_gym.guidance.learned.motion_agent import MOTION_KIND, MotionAgent
from guided_gym.guidance.learned.motion_guidance import MotionGuidance
from guided_gym.options import checked_samples
from guided_gym.train.checkpoints import AGENT_FOLDER, RunFolder
from guided_gym.train.specs import package_version
from guided_gym.train.terminal import Progress
from guided_gym.train.validation import Found, rank, searched, validated

_BEGIN: Final = {
    weights.AGENT_KIND: {"detour": 0.5, "expansion_penalty": 0.1, "foreseen": 1.0},
    MOTION_KIND: {"detour": 0.5, "expansion_penalty": 0.1, "effort": 1.0},
}
"""What is sought for each kind of agent, and where: numbers above 0, whose logarithms are varied."""
_SPREAD: Final = 0.7  # of the first generation's logarithms
_MOST: Final = 1_000_000  # bytes of a search's result, about


@dataclass(frozen=True)
class SelectionConfig:
    """Options of a run; a TOML file holds the same names.

    Attributes:
        environments: Distributions of problems, taken in turns; each counts as much as any other.
        agent: Whose selection is sought: a shipped agent's name, or a folder.
        seed: Of everything random.
        problems: Training problems, taken in turns.
        validation: Validation problems.
        generations: Generations of numbers.
        population: Candidates in each.
        searches: Searches of each candidate.
        max_samples: Samples after which a search gives up, and nats that it is charged for that.

    Raises:
        InvalidInputError: An option that is out of range.
    """

    environments: tuple[str, ...] = ("RandomTrapCup", "RandomMaze", "RandomClutter")
    agent: str = "se2"
    seed: int = 0
    problems: int = 192
    validation: int = 48
    generations: int = 8
    population: int = 8
    searches: int = 24
    max_samples: int = 1000

    protocol: ClassVar[str] = "selection"

    def __post_init__(self) -> None:
        if not self.environments:
            raise InvalidInputError("environments: expected at least one, got none")
        integer("seed", self.seed, least=0)
        integer("generations", self.generations, least=0)
        integer("population", self.population, least=4)
        for name in ("problems", "validation"):
            integer(name, getattr(self, name), least=1)
        count("searches", self.searches, least=1, each=_MOST, what="the searches of a candidate")
        checked_samples(self.max_samples)


def train_selection(
    config: SelectionConfig, out: Path, progress: Progress | None = None, workers: Workers = 1
) -> dict[str, Any]:
    """Run or continue a run; returns the card of the agent with the best numbers, written to ``out/agent``.

    Args:
        config: Whose selection is sought, and on what.
        out: Folder of the run.
        progress: Called with (steps done, steps in all, what is being done).
        workers: Who searches: processes, or another executor.

    Raises:
        InvalidInputError: An option that is out of range.
        UnknownNameError: No such environment or agent.
        StorageError: The folder holds another run, or a damaged file.
    """
    run = _Run(config, out, progress)
    with worker_pool(workers) as run.search:
        return run.all_stages()


class _Run:
    """One run: what has been tried, and what came of it."""

    def __init__(self, config: SelectionConfig, out: Path, progress: Progress | None) -> None:
        self.config, self.progress = config, progress or (lambda done, total, what: None)
        self.search: MapTasks = in_order
        self.distributions = [make_distribution(name) for name in config.environments]
        source = agent_folder(config.agent)
        self.kind = weights.card_kind(source)
        if self.kind not in _BEGIN:
            raise InvalidInputError(f"agent: expected one that selects nodes, got a {self.kind or 'file'}")
        self.agent: Any = (MotionAgent if self.kind == MOTION_KIND else LearnedAgent).load(source)
        self.source = source
        self.begin = _BEGIN[self.kind]
        self.folder = RunFolder(out, config, "selection")
        loaded = self.folder.load()
        self.state: dict[str, Any] = loaded[0] if loaded else {"losses": [], "history": [], "judged": []}

    def searcher(self, numbers: Mapping[str, float]) -> GuidingSpace:
        """The agent selecting by these numbers."""
        kind: Any = MotionGuidance if self.kind == MOTION_KIND else LearnedGuidance
        guidance: GuidingSpace = kind(self.agent, scored=False, **numbers)
        return guidance

    def numbers(self, logarithms: NDArray[np.float64]) -> dict[str, float]:
        """The numbers that a candidate stands for."""
        factors = np.exp(np.clip(logarithms, -5.0, 5.0))
        return {
            name: float(f"{at * f:.4g}") for (name, at), f in zip(self.begin.items(), factors, strict=True)
        }

    def all_stages(self) -> dict[str, Any]:
        """Run what is left."""
        config, total = self.config, 2 * self.config.generations + 2
        optimizer = CMA(
            np.zeros(len(self.begin)), _SPREAD, seed=config.seed, population_size=config.population
        )
        for generation in range(config.generations):
            self.progress(generation, total, f"Selection: generation {generation + 1}")
            candidates = [optimizer.ask() for _ in range(config.population)]
            if generation == len(self.state["losses"]):  # else an earlier call has tried these
                self._try(generation, candidates)
            losses = self.state["losses"][generation]
            optimizer.tell(list(zip(candidates, losses, strict=True)))
        best = [row for row in self.state["history"] if "share" in row]
        found = {"nothing": self.begin, f"generation {config.generations}": self.numbers(optimizer.mean)}
        found |= {f"the best of {row['what']}": {name: row[name] for name in self.begin} for row in best}
        for place, (stage, numbers) in enumerate(found.items()):
            self.progress(config.generations + place, total, "Selection: validation")
            if place == len(self.state["judged"]):
                self._judge(numbers, stage)
        self.progress(total, total, "Selection: done")
        return self._write_agent()

    def _try(self, generation: int, candidates: list[NDArray[np.float64]]) -> None:
        """The loss of each candidate on this generation's problems."""
        config = self.config
        first = generation * config.searches
        numbers = [(first + i) % config.problems for i in range(config.searches)]
        search = partial(
            searched,
            self.distributions,
            wanted=numbers,
            split="train",
            max_samples=config.max_samples,
            run=self.search,
            expansion="uniform",
        )
        least = self._losses(search(guidance=self.searcher(self.begin)))
        shares = []
        for logarithms in candidates:
            own = self._losses(search(guidance=self.searcher(self.numbers(logarithms))))
            shares.append(float(np.mean(own / least)))
        self.state["losses"].append(shares)
        best = int(np.argmin(shares))
        self.state["history"].append(
            {"what": f"generation {generation + 1}", "share": shares[best], **self.numbers(candidates[best])}
        )
        self.folder.save(self.state, {})

    def _losses(self, found: list[Found]) -> NDArray[np.float64]:
        """(m,) mean loss (nats) on each distribution: excess SE, and a charge for what is not solved."""
        charges = [0.0 if f.solved else float(self.config.max_samples) for f in found]
        loss = np.array([f.total - f.best + charge for f, charge in zip(found, charges, strict=True)])
        which = np.array([f.number % len(self.distributions) for f in found])
        return np.array([1.0 + loss[which == k].mean() for k in np.unique(which)])

    def _judge(self, numbers: Mapping[str, float], stage: str) -> None:
        """Search on the validation problems."""
        config = self.config
        found = validated(
            self.distributions,
            self.searcher(numbers),
            count=config.validation,
            max_samples=config.max_samples,
            run=self.search,
            expansion="uniform",
        )
        self.state["judged"].append({**found, "stage": stage, "numbers": dict(numbers)})
        self.state["history"].append({"what": f"validation after {stage}", **found})
        self.folder.save(self.state, {})

    def _write_agent(self) -> dict[str, Any]:
        """The agent with the numbers that were judged best; its weights are those that it had."""
        required = ("format", "kind", "training", "metrics")
        card, tensors = weights.load_agent(self.source, self.kind, required)
        best = min(self.state["judged"], key=rank)  # excess SE alone would not mind longer searches
        earlier = {"training": card["training"], "metrics": card["metrics"]}
        card |= {
            "name": self.folder.path.name,
            "package_version": package_version(),
            "selection": {"scored": False, **best["numbers"]},
            "training": {"method": "selection", **asdict(self.config), "before": earlier},
            "metrics": {"validation": best, "history": self.state["history"]},
        }
        weights.save_agent(self.folder.path / AGENT_FOLDER, card, tensors)
        return card
