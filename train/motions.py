"""Training of agents that believe in motions: p(free), cost-to-go and node scorer, for robots without a grid.

Four stages, each continued where a killed run stopped: lessons (random motions of training problems, and ways
over roadmaps that are certified), the belief, the cost-to-go, and rounds of the scorer on trees that the
policy itself visits. The scorer that searches best on validation problems is kept, the untaught one included.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn import functional

from guided_gym.checks import count, integer, number
from guided_gym.compute.workers import Workers, worker_pool
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
from guided_gym.problems import Problem
from guided_gym.randomness import seed_of
from guided_gym.structures.shortest_paths import ShortestPathTree
from guided_gym.train import networks
from guided_gym.train.checkpoints import AGENT_FOLDER, RunFolder
from guided_gym.train.lessons import SHARD, mixed_problem
from guided_gym.train.specs import package_version
from guided_gym.train.staged import StagedConfig, StagedRun, Tensors, late
from guided_gym.train.terminal import Progress

_DATA_SEED, _BELIEF_SEED, _ESTIMATE_SEED = range(3)
_LENGTHS: Final = (0.3, 8.0)  # of motions, in natural lengths
_STANDING: Final = 8  # of so many motions, one is a configuration
_GOALS: Final = 8  # of each problem, to which ways are known
_VERTICES: Final = 1500  # of the certified roadmap that tells them
_LAST: Final = 1e-6  # log probabilities stay as far below 0
_MOTION: Final = 20 * 5 * 4 * COLUMNS  # bytes of a motion's columns, about
_BATCH: Final = 256


@dataclass(frozen=True)
class MotionConfig(StagedConfig):
    """Options of a run; a TOML file holds the same names. `StagedConfig` has the others.

    Attributes:
        motions: Motions of each training problem that are checked for collision, and ways that are known.
        belief_steps: Steps of gradient descent of the belief.
        estimate_steps: Steps of the cost-to-go.
        learning_rate: Of the belief at the start; of the cost-to-go a third of it, of the scorer a fifth.
        cells: Cells along each side of the raster.
        hidden: Units of the belief.
        estimate_hidden: Units of each layer of the cost-to-go.

    Raises:
        InvalidInputError: An option that is out of range.
    """

    environments: tuple[str, ...] = ("RandomPlanarArm4",)
    motions: int = 512
    belief_steps: int = 2500
    estimate_steps: int = 3000
    learning_rate: float = 1e-2
    cells: int = 32
    hidden: int = 16
    estimate_hidden: int = 48

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("belief_steps", "estimate_steps"):
            integer(name, getattr(self, name), least=0)
        integer("motions", self.motions, least=_STANDING)
        each = _MOTION * self.motions
        count("problems", self.problems, least=1, each=each, what="the motions of so many problems")
        number("learning_rate", self.learning_rate, above=0)
        self.belief()
        integer("estimate_hidden", self.estimate_hidden, least=1)

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
    run = _Run(config, out, progress)
    with worker_pool(workers) as run.search:
        return run.all_stages()


_BELIEF_NAMES: Final = ("first", "last")
_ESTIMATE_NAMES: Final = ("0", "1", "2")


class _Run(StagedRun):
    """One run: networks and stages."""

    method = "motions"
    config: MotionConfig

    def __init__(self, config: MotionConfig, out: Path, progress: Progress | None) -> None:
        super().__init__(config, out, progress, {"stage": 0, "scored": None})
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
        self.restore()

    def tensors(self) -> Tensors:
        """Those of the three networks."""
        parts = {
            "belief": self.belief.tensors(_BELIEF_NAMES),
            "estimate": self.estimate.tensors(_ESTIMATE_NAMES),
            "scorer": networks.scorer_tensors(self.scorer),
        }
        return {f"{part}.{name}": t for part, some in parts.items() for name, t in some.items()}

    def load(self, tensors: Tensors) -> None:
        """Take weights that `tensors` gave."""
        self.belief.load(_BELIEF_NAMES, weights.part_of(tensors, "belief"))
        self.estimate.load(_ESTIMATE_NAMES, weights.part_of(tensors, "estimate"))
        networks.load_scorer(self.scorer, weights.part_of(tensors, "scorer"))

    def searcher(self, temperature: float = 0.0) -> MotionGuidance:
        """The policy as it is, selecting by its scorer."""
        return MotionGuidance(self._agent(), scored=True, temperature=temperature)

    def all_stages(self) -> dict[str, Any]:
        """Run what is left of the training."""
        config = self.config
        self.total, self.done = config.problems + 2 + config.rounds, 0
        lessons = self._lessons()
        stages = [
            (self._belief_stage, "the belief"),
            (self._estimate_stage, "the cost-to-go"),
            *[(self._scorer_stage, f"the scorer, round {i + 1}") for i in range(config.rounds)],
        ]
        for place, (stage, what) in enumerate(stages):
            self.progress(self.done, self.total, f"Motions: {what}")
            if self.state["stage"] <= place:
                torch.manual_seed(seed_of(config.seed, place))
                stage(lessons, what)
                self.state["stage"] = place + 1
                self.save()
            self.done += 1
        self.progress(self.done, self.total, "Motions: done")
        return self._write_agent()

    def _belief_stage(self, lessons: Tensors, what: str) -> None:
        self._train_belief(lessons)
        self.consider(what, MotionGuidance(self._agent()))

    def _estimate_stage(self, lessons: Tensors, what: str) -> None:
        """The cost-to-go is kept: it is there for where the roadmap has no way."""
        self._train_estimate(lessons)
        self.consider(what, MotionGuidance(self._agent()), always=True)
        if self.config.rounds:
            self.consider("no round of the scorer", self.searcher(), "scored")

    def _scorer_stage(self, lessons: Tensors, what: str) -> None:
        """A scorer is compared with other scorers: the other networks do not change any more."""
        self.train_scorer(self.state["stage"] - 2, self.config.learning_rate / 5)
        self.consider(what, self.searcher(), "scored")

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
                    f"got {problem.space.robot.name!r}, too"
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
        self.note("belief", loss=late(losses))

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
        self.note("estimate", loss=late(losses))

    def _agent(self) -> MotionAgent:
        return MotionAgent(
            {"robot": self.robot},
            BeliefModel(self.config.belief(), self.belief.tensors(_BELIEF_NAMES)),
            EstimateModel(self._estimate_sizes(), self.estimate.tensors(_ESTIMATE_NAMES)),
            ScorerModel(self.scorer_architecture, networks.scorer_tensors(self.scorer)),
        )

    def _estimate_sizes(self) -> EstimateArchitecture:
        return EstimateArchitecture(columns=self.columns, hidden=self.config.estimate_hidden)

    def _write_agent(self) -> dict[str, Any]:
        card = {
            "name": self.folder.path.name,
            "package_version": package_version(),
            "robot": self.robot,
            "belief": asdict(self.config.belief()),
            "estimate": asdict(self._estimate_sizes()),
            "scorer": asdict(self.scorer_architecture),
            "training": {"method": "motions", **asdict(self.config)},
            "metrics": {
                "validation": self.state["best"],
                "scored": self.state["scored"],
                "history": self.state["history"],
            },
        }
        save_motion_agent(self.folder.path / AGENT_FOLDER, card, self.best or self.tensors())
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
        raise InvalidInputError("environments: expected problems with free motions, got one without")
    return found, np.concatenate(parts)
