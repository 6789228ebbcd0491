"""Training of agents that believe in motions: p(free), cost-to-go and node scorer, for robots without a grid.

Four stages, each continued where a killed run stopped: lessons (random motions of training problems, and ways
over roadmaps that are certified), the belief, the cost-to-go, and rounds of the scorer on trees that the
policy itself visits. The weights that search best on validation problems are kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from guided_gym.catalogue.table import make_distribution
from guided_gym.checks import count, integer, number
from guided_gym.compute.workers import MapTasks, Workers, in_order, worker_pool
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.belief import BeliefArchitecture, BeliefModel, scene_of
from guided_gym.guidance.learned.estimate import (
    EstimateArchitecture,
    EstimateModel,
    column_count,
    columns_of,
)
from guided_gym.guidance.learned.motion_agent import MotionAgent, save_motion_agent
from guided_gym.guidance.learned.motion_guidance import MotionGuidance
from guided_gym.guidance.learned.scorer import ScorerArchitecture, ScorerModel
from guided_gym.kernels.belief import COLUMNS, motion_columns
from guided_gym.measure.roadmap import world_of
from guided_gym.options import checked_samples
from guided_gym.problems import Problem
from guided_gym.randomness import seed_of, streams
from guided_gym.search.search import Search
from guided_gym.search.tree import SearchTree
from guided_gym.structures.shortest_paths import ShortestPathTree
from guided_gym.train import networks
from guided_gym.train.checkpoints import RunFolder
from guided_gym.train.imitation import AGENT_FOLDER, TreeLessons, joined_trees, split_trees, tree_loss
from guided_gym.train.lessons import SHARD, mixed_problem
from guided_gym.train.specs import package_version
from guided_gym.train.validation import rank, validated

Tensors = dict[str, NDArray[Any]]
Progress = Callable[[int, int, str], None]

_DATA_SEED, _BELIEF_SEED, _ESTIMATE_SEED, _SCORER_SEED = range(4)
_LENGTHS: Final = (0.3, 8.0)  # of motions, in natural lengths
_STANDING: Final = 8  # of so many motions, one is a configuration
_GOALS: Final = 8  # of each problem, to which ways are known
_VERTICES: Final = 1500  # of the certified roadmap that tells them
_STEPS_KEPT: Final = 16  # of a search, for the scorer
_LAST: Final = 1e-6  # log probabilities stay as far below 0
_MOTION: Final = 20 * 5 * 4 * COLUMNS  # bytes of a motion's columns, about
_SEARCH: Final = 16 * 300 * 40  # of the steps kept of a search
_BATCH: Final = 256


@dataclass(frozen=True)
class MotionConfig:
    """Options of a run; a TOML file holds the same names.

    Attributes:
        environments: Distributions of problems of one robot, taken in turns.
        seed: Of everything random. The same seed gives the same weights on one machine.
        problems: Training problems.
        motions: Motions of each that are checked for collision, and ways of each that are known.
        validation: Validation problems.
        belief_steps: Steps of gradient descent of the belief.
        estimate_steps: Steps of the cost-to-go.
        rounds: Rounds of DAgger; 0 keeps the scorer that has learned nothing.
        searches: Searches a round.
        scorer_steps: Steps a round.
        selection: Whether the trees of the scorer are expanded uniformly, as in the protocol ``selection``.
        learning_rate: Of the belief at the start; of the others a third of it.
        max_samples: Samples after which a search gives up.
        cells: Cells along each side of the raster.
        hidden: Units of the belief.
        estimate_hidden: Units of each layer of the cost-to-go.
        scorer_hidden: Units of each layer of the scorer.

    Raises:
        InvalidInputError: An option that is out of range.
    """

    environments: tuple[str, ...] = ("RandomPlanarArm4",)
    seed: int = 0
    problems: int = 128
    motions: int = 512
    validation: int = 24
    belief_steps: int = 2500
    estimate_steps: int = 3000
    rounds: int = 1
    searches: int = 32
    scorer_steps: int = 400
    selection: bool = False
    learning_rate: float = 1e-2
    max_samples: int = 300
    cells: int = 32
    hidden: int = 16
    estimate_hidden: int = 48
    scorer_hidden: int = 32

    def __post_init__(self) -> None:
        if not self.environments:
            raise InvalidInputError("environments: expected at least one, got none")
        integer("seed", self.seed, least=0)
        for name in ("belief_steps", "estimate_steps", "rounds", "scorer_steps"):
            integer(name, getattr(self, name), least=0)
        integer("motions", self.motions, least=_STANDING)
        each = _MOTION * self.motions
        count("problems", self.problems, least=1, each=each, what="the motions of so many problems")
        count("searches", self.searches, least=1, each=_SEARCH, what="the trees of a round")
        integer("validation", self.validation, least=1)
        checked_samples(self.max_samples)
        number("learning_rate", self.learning_rate, above=0)
        self.belief()
        for name in ("estimate_hidden", "scorer_hidden"):
            integer(name, getattr(self, name), least=1)

    def belief(self) -> BeliefArchitecture:
        """The belief network's sizes."""
        return BeliefArchitecture(cells=self.cells, hidden=self.hidden)


def train_motions(
    config: MotionConfig, out: Path, progress: Progress | None = None, workers: Workers = 1
) -> dict[str, Any]:
    """Run or continue a run; returns the card of the best agent, written to ``out/agent``.

    Args:
        config: What to learn from, and how.
        out: Folder of the run.
        progress: Called with (steps done, steps in all, what is being done).
        workers: Who validates: processes, or another executor.

    Raises:
        InvalidInputError: Robots that differ, or one that is not planar.
        UnknownNameError: No such environment.
        StorageError: The folder holds another run, or a damaged file.
    """
    run = _Run(config, out, progress or (lambda done, total, what: None))
    with worker_pool(workers) as run.search:
        return run.all_stages()


_BELIEF_NAMES: Final = ("first", "last")
_ESTIMATE_NAMES: Final = ("0", "1", "2")


class _Run:
    """One run: networks, state and stages."""

    def __init__(self, config: MotionConfig, out: Path, progress: Progress) -> None:
        self.config, self.progress = config, progress
        self.search: MapTasks = in_order
        self.distributions = [make_distribution(name) for name in config.environments]
        self.folder = RunFolder(out, config, "motions")
        torch.manual_seed(config.seed)
        torch.set_num_threads(1)
        robot = mixed_problem(self.distributions, "train", 0).space
        self.robot = robot.robot.name
        self.columns = column_count(robot)
        self.belief = networks.Layers(COLUMNS, config.hidden, 1)
        hidden = config.estimate_hidden
        self.estimate = networks.Layers(self.columns, hidden, hidden, 1)
        self.scorer_architecture = ScorerArchitecture(hidden=config.scorer_hidden)
        self.scorer = networks.NodeScorer(self.scorer_architecture)
        self.state: dict[str, Any] = {"stage": 0, "history": [], "best": None}
        self.best: Tensors = {}
        loaded = self.folder.load()
        if loaded is not None:
            self.state, tensors = loaded
            self.best = weights.part_of(tensors, "best", "/")
            self._load(weights.part_of(tensors, "now", "/"))

    def _tensors(self) -> Tensors:
        parts = {
            "belief": self.belief.tensors(_BELIEF_NAMES),
            "estimate": self.estimate.tensors(_ESTIMATE_NAMES),
            "scorer": networks.scorer_tensors(self.scorer),
        }
        return {f"{part}.{name}": t for part, some in parts.items() for name, t in some.items()}

    def _load(self, tensors: Tensors) -> None:
        self.belief.load(_BELIEF_NAMES, weights.part_of(tensors, "belief"))
        self.estimate.load(_ESTIMATE_NAMES, weights.part_of(tensors, "estimate"))
        networks.load_scorer(self.scorer, weights.part_of(tensors, "scorer"))

    def all_stages(self) -> dict[str, Any]:
        """What is left of the run."""
        config = self.config
        self.total, self.done = config.problems + 2 + config.rounds, 0
        lessons = self._lessons()
        stages = [
            (self._train_belief, "the belief"),
            (self._train_estimate, "the cost-to-go"),
            *[(self._train_scorer, f"the scorer, round {i + 1}") for i in range(config.rounds)],
        ]
        for place, (stage, what) in enumerate(stages):
            self.progress(self.done, self.total, f"Motions: {what}")
            if self.state["stage"] <= place:
                torch.manual_seed(seed_of(config.seed, place))
                stage(lessons)
                self._consider(what)
                self.state["stage"] = place + 1
                self._save()
            self.done += 1
        self.progress(self.done, self.total, "Motions: done")
        return self._write_agent()

    def _save(self) -> None:
        tensors = {f"now/{name}": t for name, t in self._tensors().items()}
        tensors.update({f"best/{name}": t for name, t in self.best.items()})
        self.folder.save(self.state, tensors)

    def _lessons(self) -> Tensors:
        """What is known of the training problems, from the run's files as far as they are there."""
        found: list[Tensors] = []
        for first in range(0, self.config.problems, SHARD):
            name = f"data/motions-{first:06d}.safetensors"
            numbers = range(first, min(first + SHARD, self.config.problems))
            if not (self.folder.path / name).exists():
                self.folder.keep(name, {"problems": len(numbers)}, self._shard(numbers))
            found.append(RunFolder.read(self.folder.path / name)[1])
            self.done = numbers.stop
            self.progress(self.done, self.total, "Motions: lessons")
        return {key: np.concatenate([part[key] for part in found]) for key in found[0]}

    def _shard(self, numbers: range) -> Tensors:
        rows = []
        for index in numbers:
            problem = mixed_problem(self.distributions, "train", index)
            if column_count(problem.space) != self.columns:
                raise InvalidInputError(
                    f"environments: expected problems of one robot, {self.robot!r}, "
                    f"got {problem.space.robot.name!r} too"
                )
            rng = np.random.default_rng([self.config.seed, _DATA_SEED, index])
            rows.append(_lesson(problem, self.config, rng))
        return {key: np.concatenate([row[key] for row in rows]) for key in rows[0]}

    def _train_belief(self, lessons: Tensors) -> None:
        """Which motions are free: the likelihood of what was checked, over all parts of each motion."""
        config, free = self.config, torch.from_numpy(lessons["free"] > 0)
        ends = np.concatenate([[0], np.cumsum(lessons["parts"])])
        columns = torch.from_numpy(lessons["columns"])
        rng = np.random.default_rng([config.seed, _BELIEF_SEED])
        with torch.no_grad():
            self.belief.layers[-1].bias.fill_(3.0)  # type: ignore[operator, union-attr]  # most parts are free
        optimizer, schedule = networks.adam(self.belief, config.learning_rate, config.belief_steps)
        losses = []
        for _ in range(config.belief_steps):
            first = int(rng.integers(max(1, len(free) - _BATCH)))
            some = slice(first, first + _BATCH)
            rows = slice(int(ends[first]), int(ends[min(first + _BATCH, len(free))]))
            owner = np.repeat(np.arange(len(free[some])), lessons["parts"][some])
            parts = functional.logsigmoid(self.belief(columns[rows]))
            logs = torch.zeros(len(free[some])).index_add(0, torch.from_numpy(owner), parts)
            blocked = torch.log(-torch.expm1(logs.clamp(max=-_LAST)))
            losses.append(
                networks.descend(-torch.where(free[some], logs, blocked).mean(), optimizer, schedule)
            )
        self._note("belief", loss=_late(losses))

    def _train_estimate(self, lessons: Tensors) -> None:
        """By what part certified ways are longer than straight lines."""
        config = self.config
        seen, excess = (torch.from_numpy(lessons[name]) for name in ("seen", "excess"))
        rng = np.random.default_rng([config.seed, _ESTIMATE_SEED])
        optimizer, schedule = networks.adam(self.estimate, config.learning_rate / 3, config.estimate_steps)
        losses = []
        for _ in range(config.estimate_steps):
            rows = torch.from_numpy(rng.integers(len(seen), size=_BATCH))
            out = functional.softplus(self.estimate(seen[rows]))
            error = torch.log1p(out) - torch.log1p(excess[rows])
            losses.append(networks.descend((error * error).mean(), optimizer, schedule))
        self._note("estimate", loss=_late(losses))

    def _train_scorer(self, lessons: Tensors) -> None:
        """One round of DAgger: search with the policy as it is, then learn Q on all trees seen so far."""
        config, number = self.config, self.state["stage"] - 2
        name = f"data/trees-{number:03d}.safetensors"
        if not (self.folder.path / name).exists():
            self.folder.keep(name, {"round": number}, joined_trees(self._searched(number)))
        files = (self.folder.path / f"data/trees-{i:03d}.safetensors" for i in range(number + 1))
        trees = [tree for file in files for tree in split_trees(RunFolder.read(file)[1])]
        rng = np.random.default_rng([config.seed, _SCORER_SEED, number])
        optimizer, schedule = networks.adam(self.scorer, config.learning_rate / 5, config.scorer_steps)
        losses = []
        for _ in range(config.scorer_steps if trees else 0):
            batch = [trees[i] for i in rng.integers(len(trees), size=32)]
            losses.append(networks.descend(tree_loss(self.scorer, batch), optimizer, schedule))
        self._note("scorer", loss=_late(losses), trees=len(trees))

    def _searched(self, number: int) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
        """Columns and targets along searches of this round; every other search draws its nodes."""
        config, kept = self.config, []
        agent = self._agent()
        for i in range(config.searches):
            index = (number * config.searches + i) % config.problems
            problem = mixed_problem(self.distributions, "train", index)
            guidance = MotionGuidance(agent, temperature=float(i % 2))
            _, expansion, choice = streams(seed_of(config.seed, _SCORER_SEED, number, i))
            search = Search(problem, expansion, choice)
            search.attach(guidance)
            seen = TreeLessons(guidance, search)
            propose = partial(_uniform, search) if config.selection else None
            search.run(guidance, config.max_samples, propose=propose, watcher=seen)
            kept.extend(seen.some(_STEPS_KEPT))
        return kept

    def _agent(self) -> MotionAgent:
        return MotionAgent(
            {"robot": self.robot},
            BeliefModel(self.config.belief(), self.belief.tensors(_BELIEF_NAMES)),
            EstimateModel(self._estimate_sizes(), self.estimate.tensors(_ESTIMATE_NAMES)),
            ScorerModel(self.scorer_architecture, networks.scorer_tensors(self.scorer)),
        )

    def _estimate_sizes(self) -> EstimateArchitecture:
        return EstimateArchitecture(columns=self.columns, hidden=self.config.estimate_hidden)

    def _consider(self, stage: str) -> None:
        """Search on the validation problems; keep these weights if they are the best so far."""
        config, guidance = self.config, MotionGuidance(self._agent())
        found = validated(
            self.distributions,
            guidance,
            count=config.validation,
            max_samples=config.max_samples,
            run=self.search,
            expansion="uniform" if config.selection else None,
        )
        self._note(f"validation after {stage}", **found)
        best = self.state["best"]
        if best is None or stage == "the cost-to-go" or rank(found) < rank(best):
            self.state["best"] = {**found, "stage": stage}
            self.best = self._tensors()

    def _note(self, what: str, **values: float) -> None:
        self.state["history"].append({"what": what, **values})

    def _write_agent(self) -> dict[str, Any]:
        card = {
            "name": self.folder.path.name,
            "package_version": package_version(),
            "robot": self.robot,
            "belief": asdict(self.config.belief()),
            "estimate": asdict(self._estimate_sizes()),
            "scorer": asdict(self.scorer_architecture),
            "training": {"method": "motions", **asdict(self.config)},
            "metrics": {"validation": self.state["best"], "history": self.state["history"]},
        }
        save_motion_agent(self.folder.path / AGENT_FOLDER, card, self.best or self._tensors())
        return card


def _lesson(problem: Problem, config: MotionConfig, rng: np.random.Generator) -> Tensors:
    """Random motions, whether they are free, and how long certified ways are."""
    space, scene = problem.space, scene_of(problem.space, config.belief())
    starts, ends = random_motions(space, config.motions, rng)
    columns, owner = motion_columns(starts, ends, scene, space.metric)
    seen, excess = _ways(space, config.motions, rng)
    return {
        "columns": columns,
        "parts": np.bincount(owner, minlength=len(starts)).astype(np.int64),
        "free": np.asarray(space.motions_free(starts, ends)).astype(np.uint8),
        "seen": np.concatenate([columns_of(space, scene, some, goal) for some, goal in seen]),
        "excess": excess,
    }


def random_motions(
    space: ConfigurationSpace, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n, d) starts and (n, d) ends of motions of all lengths, and configurations among them."""
    starts = space.sample(rng, count)
    aside = rng.normal(size=starts.shape)
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    low, high = np.log(np.array(_LENGTHS) * space.scale)
    lengths = np.exp(rng.uniform(low, high, (count, 1)))
    lengths[::_STANDING] = 0.0
    ends = np.clip(space.wrap(starts + lengths * aside / space.weights), space.lower, space.upper)
    return starts, np.ascontiguousarray(ends)


def _ways(
    space: ConfigurationSpace, count: int, rng: np.random.Generator
) -> tuple[list[tuple[NDArray[np.float64], NDArray[np.float64]]], NDArray[np.float32]]:
    """States with a goal each, and by what part the way over a certified roadmap is longer than straight."""
    roadmap = world_of(space, cache=False).roadmap(_VERTICES)
    found, parts = [], []
    for goal in rng.integers(len(roadmap.points), size=_GOALS) if len(roadmap.points) else ():
        distance = np.array(ShortestPathTree.of(roadmap.graph, int(goal)).distance)
        known = np.flatnonzero(np.isfinite(distance) & (distance > 0.0))
        some = known[rng.permutation(known.size)[: max(1, count // _GOALS)]]
        if some.size:
            states = np.ascontiguousarray(roadmap.points[some])
            straight = np.asarray(space.distance(states, roadmap.points[goal]))
            found.append((states, roadmap.points[goal]))
            parts.append(np.maximum(distance[some] / straight - 1.0, 0.0).astype(np.float32))
    if not found:
        raise InvalidInputError("environments: expected problems with ways in them, got one with no room")
    return found, np.concatenate(parts)


def _uniform(search: Search, tree: SearchTree, node: int) -> NDArray[np.float64]:
    return search.planner.uniform(tree.configurations[node])


def _late(losses: list[float]) -> float:
    return float(np.mean(losses[-50:])) if losses else math.nan
