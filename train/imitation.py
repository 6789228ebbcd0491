"""Imitation: the field network learns d_C from the oracle, the node scorer the target distribution (DAgger).

Four stages, each continued where a killed run stopped: lessons (what the oracle says of training problems),
the field's encoder, its decoder, and rounds of the scorer on trees that the policy itself visits. The weights
that search best on validation problems are kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from guided_gym.catalogue.table import make_distribution
from guided_gym.checks import count, integer, shown
from guided_gym.compute.workers import MapTasks, Workers, in_order, worker_pool
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.learned import field as field_module
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.agent import LearnedAgent, LearnedGuidance
from guided_gym.guidance.learned.field import FieldArchitecture, FieldModel, decoder_input, encoder_columns
from guided_gym.guidance.learned.scored import ScoredGuidance
from guided_gym.guidance.learned.scorer import ScorerArchitecture, ScorerColumn, ScorerModel
from guided_gym.guidance.solvers.wave import CostField, check_grid
from guided_gym.kernels import fields
from guided_gym.measure.target import Measure
from guided_gym.options import checked_samples
from guided_gym.randomness import seed_of, streams
from guided_gym.search.search import Expansion, Search
from guided_gym.train import networks
from guided_gym.train.checkpoints import RunFolder, check_board
from guided_gym.train.lessons import SHARD, Lesson, lessons, mixed_problem
from guided_gym.train.specs import package_version
from guided_gym.train.symmetries import SYMMETRIES, turned, turned_back
from guided_gym.train.validation import rank, validated

Tensors = dict[str, NDArray[Any]]
Progress = Callable[[int, int, str], None]
Tree = tuple[NDArray[np.float32], NDArray[np.float32]]
"""(n, columns) what the scorer sees of a tree's nodes, and (n,) the target distribution over them."""

AGENT_FOLDER: Final = "agent"
_DATA_SEED, _ENCODER_SEED, _DECODER_SEED, _SCORER_SEED = range(4)
_BETA: Final = 0.02  # errors below this part of the distance count by their square
_NEAREST: Final = 0.1  # sides of the square below which errors are no longer taken relative to the distance
_STEPS_KEPT: Final = 16  # of a search, for the scorer
_TREES_A_BATCH: Final = 32
_POSES_A_BATCH: Final = 512

# Bytes, about: what lessons, a round's trees and the scorer take.
_POSE: Final = 32  # a pose and its cost
_HEADING: Final = 4  # room of a pose, or a sample of the distance
_TREE: Final = 16 * 1024 * 60  # of the steps kept, each with its columns of some 1,000 nodes
_UNIT: Final = 100_000  # with its row of weights, Adam's moments, and its values in a batch of trees


@dataclass(frozen=True)
class ImitationConfig:
    """Options of a run; a TOML file holds the same names.

    Attributes:
        environments: Distributions of problems, taken in turns.
        seed: Of everything random. The same seed gives the same weights on one machine.
        problems: Training problems.
        validation: Validation problems.
        poses: Poses of each training problem that the oracle is asked about.
        encoder_steps: Steps of gradient descent of the encoder.
        decoder_epochs: Passes of the decoder over the training problems; 0 leaves the wave uncorrected.
        batch: Problems a step of the decoder.
        rounds: Rounds of DAgger; 0 keeps the scorer that has learned nothing.
        searches: Searches a round.
        scorer_steps: Steps of gradient descent a round.
        divergence: ``"forward"`` minimises D_KL(Q || P), ``"reverse"`` D_KL(P || Q).
        learning_rate: At the start of each stage; it falls to nothing along a cosine.
        max_samples: Samples after which a search gives up.
        device: ``"cpu"`` or ``"cuda"``.
        tensorboard: Whether to write TensorBoard files too.
        cells: Cells along each side of the raster.
        headings: Headings of the grid.
        planning: Whether the field has its wave; without, the decoder has to learn all by itself.
        scorer_hidden: Units of each layer of the scorer.

    Raises:
        InvalidInputError: An option that is out of range.
    """

    environments: tuple[str, ...] = ("RandomSimplePassage",)
    seed: int = 0
    problems: int = 512
    validation: int = 64
    poses: int = 1024
    encoder_steps: int = 500
    decoder_epochs: int = 10
    batch: int = 16
    rounds: int = 3
    searches: int = 96
    scorer_steps: int = 400
    divergence: str = "forward"
    learning_rate: float = 2e-3
    max_samples: int = 300
    device: str = "cpu"
    tensorboard: bool = False
    cells: int = 56
    headings: int = 16
    planning: bool = True
    scorer_hidden: int = 32

    def __post_init__(self) -> None:
        integer("seed", self.seed, least=0)
        for name in ("encoder_steps", "decoder_epochs", "rounds", "scorer_steps"):
            integer(name, getattr(self, name), least=0)
        integer("poses", self.poses, least=1)
        check_grid(self.cells, self.headings)
        lesson = _POSE * self.poses + _HEADING * self.cells**2 * (self.headings + fields.FINE**2)
        for name in ("problems", "validation", "batch"):
            count(name, getattr(self, name), least=1, each=lesson, what="the lessons of so many problems")
        checked_samples(self.max_samples)
        count("searches", self.searches, least=1, each=_TREE, what="the trees of a round")
        count("scorer_hidden", self.scorer_hidden, least=1, each=_UNIT, what="a scorer of so many units")
        if not self.environments:
            raise InvalidInputError("environments: expected at least one, got none")
        if self.divergence not in ("forward", "reverse"):
            raise InvalidInputError(
                f"divergence: expected 'forward' or 'reverse', got {shown(self.divergence)}"
            )
        if not 0 < self.learning_rate < math.inf:
            raise InvalidInputError(
                f"learning_rate: expected a positive number, got {shown(self.learning_rate)}"
            )

    def field(self) -> FieldArchitecture:
        """The field network's sizes."""
        return FieldArchitecture(cells=self.cells, headings=self.headings, planning=self.planning)

    def scorer(self) -> ScorerArchitecture:
        """The node scorer's sizes."""
        return ScorerArchitecture(hidden=self.scorer_hidden)


def checked_device(name: str) -> torch.device:
    """The device of that name.

    Raises:
        InvalidInputError: There is none, or it is not available.
    """
    if name not in ("cpu", "cuda"):
        raise InvalidInputError(f"device: expected 'cpu' or 'cuda', got {shown(name)}")
    if name == "cuda" and not torch.cuda.is_available():
        raise InvalidInputError("device: expected a CUDA device, but torch finds none; use --device cpu")
    return torch.device(name)


def train_imitation(
    config: ImitationConfig, out: Path, progress: Progress | None = None, workers: Workers = 1
) -> dict[str, Any]:
    """Run or continue a run; returns the card of the best agent, written to ``out/agent``.

    Args:
        config: What to learn from, and how.
        out: Folder of the run.
        progress: Called with (steps done, steps in all, what is being done).
        workers: Who validates: processes, or another executor.

    Raises:
        InvalidInputError: The device or TensorBoard is not there.
        UnknownNameError: No such environment.
        StorageError: The folder holds another run, or a damaged file.
    """
    run = _Run(config, out, progress or (lambda done, total, what: None))
    with worker_pool(workers) as run.search:
        return run.all_stages()


class _Run:
    """One run: networks, state and stages."""

    def __init__(self, config: ImitationConfig, out: Path, progress: Progress) -> None:
        self.config, self.progress = config, progress
        self.search: MapTasks = in_order
        self.device = checked_device(config.device)
        check_board(config.tensorboard)
        self.distributions = [make_distribution(name) for name in config.environments]
        self.architecture, self.scorer_architecture = config.field(), config.scorer()
        self.folder = RunFolder(out, config, "imitation")
        torch.manual_seed(config.seed)
        torch.set_num_threads(1)
        self.encoder = networks.Encoder(self.architecture).to(self.device)
        self.decoder = networks.Decoder(self.architecture).to(self.device)
        self.scorer = networks.NodeScorer(self.scorer_architecture).to(self.device)
        self.state: dict[str, Any] = {"encoder": 0, "epochs": 0, "rounds": 0, "history": [], "best": None}
        self.best: Tensors = {}
        self.moments: Tensors = {}
        self.writer = _board(out) if config.tensorboard else None
        self._restore()

    # Files

    def _tensors(self) -> Tensors:
        field = networks.field_tensors(self.encoder, self.decoder)
        scorer = networks.scorer_tensors(self.scorer)
        named = {f"field.{name}": t for name, t in field.items()}
        return {**named, **{f"scorer.{name}": t for name, t in scorer.items()}}

    def _load(self, tensors: Tensors) -> None:
        networks.load_field(self.encoder, self.decoder, weights.part_of(tensors, "field"))
        networks.load_scorer(self.scorer, weights.part_of(tensors, "scorer"))

    def _restore(self) -> None:
        """Continue from the last checkpoint, if there is one."""
        loaded = self.folder.load()
        if loaded is None:
            return
        self.state, tensors = loaded
        self._load(weights.part_of(tensors, "now", "/"))
        self.best, self.moments = (weights.part_of(tensors, group, "/") for group in ("best", "adam"))

    def _save(self, optimizer: torch.optim.Optimizer | None = None) -> None:
        self.moments = moments_of(optimizer) if optimizer is not None else {}
        tensors = {f"now/{name}": t for name, t in self._tensors().items()}
        tensors.update({f"best/{name}": t for name, t in self.best.items()})
        tensors.update({f"adam/{name}": t for name, t in self.moments.items()})
        self.folder.save(self.state, tensors)

    # Stages

    def all_stages(self) -> dict[str, Any]:
        """What is left of the run."""
        config = self.config
        self.total = config.problems + config.validation + 1 + config.decoder_epochs + config.rounds
        self.done = 0
        self.lessons = self._lessons("train", config.problems)
        self.held_out = self._lessons("validation", config.validation)
        if not self.state["encoder"]:
            self._train_encoder()
        self._step("the decoder")
        if self.state["epochs"] < config.decoder_epochs:
            self._train_decoder()
        self.done = config.problems + config.validation + 1 + config.decoder_epochs
        while self.state["rounds"] < config.rounds:
            self._step(f"the scorer, round {self.state['rounds'] + 1} of {config.rounds}", 0)
            self._train_scorer()
            self._step("the scorer")
        return self._write_agent()

    def _step(self, what: str, by: int = 1) -> None:
        self.done += by
        self.progress(self.done, self.total, f"Imitation: {what}")

    def _lessons(self, split: str, count: int) -> list[Lesson]:
        begun = self.done
        found = lessons(
            self.folder,
            self.distributions,
            self.architecture,
            split=split,
            count=count,
            poses=self.config.poses,
            seed=seed_of(self.config.seed, _DATA_SEED),
            progress=lambda n: self.progress(begun + n, self.total, f"Imitation: {split} lessons"),
        )
        self.done = begun + count
        return found

    def _train_encoder(self) -> None:
        """Which poses of the grid are valid: logistic regression on what the encoder sees of each."""
        config = self.config
        x = torch.from_numpy(
            np.concatenate([encoder_columns(lesson.grid)[lesson.places] for lesson in self.lessons])
        )
        y = torch.from_numpy(np.concatenate([lesson.labels for lesson in self.lessons]).astype(np.float32))
        plain = field_module.plain_tensors(self.architecture)
        networks.load_field(self.encoder, self.decoder, {**plain, **_random_decoder(self.decoder)})
        with torch.no_grad():  # less sure than the plain one, and all its units awake
            first, _, last, _ = self.encoder.parameters()
            first.add_(0.3 * torch.randn_like(first))
            last.mul_(0.1).add_(0.1 * torch.randn_like(last))
        rng = _generator(config.seed, _ENCODER_SEED)
        optimizer = torch.optim.Adam(self.encoder.parameters(), 0.01)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(config.encoder_steps, 1))
        for _ in range(config.encoder_steps):
            rows = torch.from_numpy(rng.integers(len(x), size=4096))
            loss = functional.binary_cross_entropy_with_logits(
                self.encoder(x[rows].to(self.device)), y[rows].to(self.device)
            )
            networks.descend(loss, optimizer, schedule)
        with torch.no_grad():
            right = ((self.encoder(x.to(self.device)) > 0).cpu() == (y > 0.5)).float().mean()
        self.state["encoder"] = 1
        self._note("encoder", accuracy=float(right))
        self._consider("encoder")
        self._save()

    def _train_decoder(self) -> None:
        """What the wave's arrival lacks to d_C at poses between those of the grid."""
        config = self.config
        model = FieldModel(self.architecture, networks.field_tensors(self.encoder, self.decoder))
        examples = [_Example(lesson, model, self.architecture.headings) for lesson in self.lessons]
        held_out = [_Example(lesson, model, self.architecture.headings) for lesson in self.held_out]
        optimizer = torch.optim.AdamW(self.decoder.parameters(), config.learning_rate, weight_decay=1e-4)
        put_moments(optimizer, self.moments)
        batches = math.ceil(len(examples) / config.batch)
        while self.state["epochs"] < config.decoder_epochs:
            epoch = self.state["epochs"]
            rng = _generator(config.seed, _DECODER_SEED, epoch)
            losses = []
            for number, rows in enumerate(np.array_split(rng.permutation(len(examples)), batches)):
                at = (epoch + number / batches) / config.decoder_epochs
                for group in optimizer.param_groups:
                    group["lr"] = config.learning_rate * 0.5 * (1 + math.cos(math.pi * at))
                loss = self._decoder_loss([examples[i] for i in rows], rng)
                losses.append(networks.descend(loss, optimizer))
            self.state["epochs"] = epoch + 1
            with torch.no_grad():
                error = float(np.mean([self._error(example) for example in held_out]))
            self._note("decoder", epoch=epoch + 1, loss=float(np.mean(losses)), validation_error=error)
            if self.state["epochs"] == config.decoder_epochs:
                self._consider("decoder")
            self._save(optimizer)
            self._step(f"the decoder, error {100 * error:.2f} %")

    def _decoder_loss(self, batch: list[_Example], rng: np.random.Generator) -> Tensor:
        symmetry = SYMMETRIES[int(rng.integers(len(SYMMETRIES)))]
        layers = torch.stack([example.layers() for example in batch]).to(self.device)
        out = turned_back(self.decoder(turned(layers, symmetry, self.architecture.headings)), symmetry)
        errors = []
        for example, maps in zip(batch, out, strict=True):
            rows = rng.integers(len(example.targets), size=min(_POSES_A_BATCH, len(example.targets)))
            errors.append(example.relative_errors(maps, rows))
        error = torch.cat(errors)
        return functional.smooth_l1_loss(error, torch.zeros_like(error), beta=_BETA)

    def _error(self, example: _Example) -> float:
        """Mean relative error of the corrected field over a problem's poses."""
        maps = self.decoder(example.layers()[None].to(self.device))[0]
        return float(example.relative_errors(maps, np.arange(len(example.targets))).abs().mean())

    def _train_scorer(self) -> None:
        """One round of DAgger: search with the policy as it is, then learn Q on all trees seen so far."""
        config, number = self.config, self.state["rounds"]
        name = f"data/trees-{number:03d}.safetensors"
        if not (self.folder.path / name).exists():
            self.folder.keep(name, {"round": number}, joined_trees(self._searched_trees(number)))
        trees = [tree for i in range(number + 1) for tree in _trees(self.folder.path, i)]
        rng = _generator(config.seed, _SCORER_SEED, number)
        optimizer, schedule = networks.adam(self.scorer, config.learning_rate, config.scorer_steps)
        losses = []
        for _ in range(config.scorer_steps if trees else 0):
            batch = [trees[i] for i in rng.integers(len(trees), size=_TREES_A_BATCH)]
            loss = tree_loss(self.scorer, batch, config.divergence, self.device)
            losses.append(networks.descend(loss, optimizer, schedule))
        self.state["rounds"] = number + 1
        late = float(np.mean(losses[-50:])) if losses else 0.0
        self._note("scorer", round=number + 1, loss=late, trees=len(trees))
        self._consider(f"round {number + 1}")
        self._save()

    def _searched_trees(self, number: int) -> list[Tree]:
        """Columns and targets of trees along searches of this round; every other search draws its nodes."""
        config = self.config
        agent = self._agent()
        kept: list[Tree] = []
        for i in range(config.searches):
            index = (number * config.searches + i) % config.problems
            problem = mixed_problem(self.distributions, "train", index)
            guidance = LearnedGuidance(agent, temperature=float(i % 2))
            _, expansion, choice = streams(seed_of(config.seed, _SCORER_SEED, number, i))
            search = Search(problem, expansion, choice)
            search.attach(guidance)
            lessons = TreeLessons(guidance, search)
            search.run(guidance, config.max_samples, watcher=lessons)
            kept.extend(lessons.some(_STEPS_KEPT))
        return kept

    # Validation

    def _agent(self) -> LearnedAgent:
        field = FieldModel(self.architecture, networks.field_tensors(self.encoder, self.decoder))
        scorer = ScorerModel(self.scorer_architecture, networks.scorer_tensors(self.scorer))
        return LearnedAgent({}, field, scorer)

    def _consider(self, stage: str) -> None:
        """Search on the validation problems; keep these weights if they are the best so far."""
        metrics = self._validate()
        self._note(f"validation after {stage}", **metrics)
        best = self.state["best"]
        if best is None or rank(metrics) < rank(best):
            self.state["best"] = {**metrics, "stage": stage}
            self.best = self._tensors()

    def _validate(self) -> dict[str, float]:
        return validated(
            self.distributions,
            LearnedGuidance(self._agent()),
            count=self.config.validation,
            max_samples=self.config.max_samples,
            run=self.search,
        )

    def _note(self, what: str, **values: float) -> None:
        self.state["history"].append({"what": what, **values})
        if self.writer is not None:
            step = int(values.get("epoch", values.get("round", len(self.state["history"]))))
            for name in values.keys() - {"epoch", "round"}:
                self.writer.add_scalar(f"{what.split()[0]}/{name}", values[name], step)

    def _write_agent(self) -> dict[str, Any]:
        tensors = self.best or self._tensors()
        card = {
            "name": self.folder.path.name,
            "package_version": package_version(),
            "field": asdict(self.architecture),
            "scorer": asdict(self.scorer_architecture),
            "training": {"method": "imitation", **asdict(self.config)},
            "metrics": {"validation": self.state["best"], "history": self.state["history"]},
        }
        weights.save_agent(self.folder.path / AGENT_FOLDER, card, tensors)
        return card


class _Example:
    """A lesson as the decoder takes it: the wave has run, each pose knows the corners that speak for it."""

    def __init__(self, lesson: Lesson, model: FieldModel, headings: int) -> None:
        self._lesson, self._headings = lesson, headings
        self._side = lesson.grid.side
        found = model.begin(lesson.grid, lesson.frame[fields.GOAL :])
        self.arrival = model.arrival(found)
        signed = np.where(found.seems > 0, self.arrival, -self.arrival)
        places, shares = fields.corners(lesson.poses, signed, lesson.frame)
        spoken = shares.sum(axis=1) > 0
        field = CostField(lesson.frame, signed)
        base = field.cost_to_go(lesson.poses) if len(lesson.poses) else np.zeros(0)
        self.turns = lesson.grid.room.shape[2]
        if self.turns == 1:
            places = places * headings
        self.places = torch.from_numpy(places[spoken])
        self.shares = torch.from_numpy(shares[spoken])
        costs = lesson.costs[spoken] / self._side
        self.targets = torch.from_numpy((costs - base[spoken] / self._side).astype(np.float32))
        self.scale = torch.from_numpy((_NEAREST + costs).astype(np.float32))

    def layers(self) -> Tensor:
        """(layers * T + 1, n, n) the decoder's input."""
        layers = decoder_input(self._lesson.grid, self._lesson.frame, self.arrival)
        if self.turns == 1:
            layers = np.concatenate(
                [np.repeat(layers[..., :-1], self._headings, axis=-1), layers[..., -1:]], axis=-1
            )
        return torch.from_numpy(np.ascontiguousarray(layers.transpose(2, 0, 1)))

    def relative_errors(self, maps: Tensor, rows: NDArray[Any]) -> Tensor:
        """(m,) error of the corrected field at some poses, relative to their distance; maps are (T, n, n)."""
        maps = maps.permute(1, 2, 0)
        if self.turns == 1:
            maps = maps.mean(-1, keepdim=True).expand_as(maps)
        chosen = torch.from_numpy(rows)
        device = maps.device
        values = maps.reshape(-1)[self.places[chosen].to(device)]
        corrections = (values * self.shares[chosen].to(device)).sum(1)
        return (corrections - self.targets[chosen].to(device)) / self.scale[chosen].to(device)


class TreeLessons:
    """What a node scorer is taught: its columns and the target distribution, before each choice."""

    def __init__(self, guidance: ScoredGuidance, search: Search) -> None:
        self._guidance, self._tree, self._measure = guidance, search.tree, Measure(search)
        self.rows: list[Tree] = []

    def some(self, count: int) -> list[Tree]:
        """Up to ``count`` of them, evenly spread, of trees with a choice."""
        rows = self.rows
        which = np.unique(np.linspace(0, len(rows) - 1, min(count, len(rows))).astype(int))
        return [rows[k] for k in which if len(rows[k][1]) > 1]

    def before(self, node: int) -> None:
        """Take down the tree as it stands."""
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


def _generator(*numbers: int) -> np.random.Generator:
    return np.random.default_rng(seed_of(*numbers))


def _random_decoder(decoder: networks.Decoder) -> Tensors:
    return {name: t.detach().cpu().numpy().copy() for name, t in decoder.state_dict().items()}


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


def _trees(folder: Path, number: int) -> list[Tree]:
    return split_trees(RunFolder.read(folder / f"data/trees-{number:03d}.safetensors")[1])


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
    """Give Adam the state that `moments_of` took; nothing to give leaves it as it is."""
    if not moments:
        return
    state = optimizer.state_dict()
    for key, value in moments.items():
        index, _, name = key.partition(".")
        state["state"].setdefault(int(index), {})[name] = torch.from_numpy(np.array(value))
    optimizer.load_state_dict(state)


def _board(out: Path) -> Any:
    from torch.utils.tensorboard import SummaryWriter

    return SummaryWriter(str(out / "tensorboard"))  # type: ignore[no-untyped-call]


__all__ = ["AGENT_FOLDER", "SHARD", "ImitationConfig", "checked_device", "train_imitation"]
