"""Imitation: the field network learns d_C from the oracle, the node scorer the target distribution (DAgger).

Four stages, each continued where a killed run stopped: lessons (what the oracle says of training problems),
the field's encoder, its decoder, and rounds of the scorer on trees that the policy itself visits. The weights
that search best on validation problems are kept.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from guided_gym.checks import count, integer, shown
from guided_gym.compute.workers import Workers, worker_pool
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.learned import field as field_module
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.agent import LearnedAgent, LearnedGuidance
from guided_gym.guidance.learned.field import FieldArchitecture, FieldModel, decoder_input, encoder_columns
from guided_gym.guidance.learned.scorer import ScorerArchitecture, ScorerModel
from guided_gym.guidance.solvers.wave import CostField, check_grid
from guided_gym.kernels import fields
from guided_gym.randomness import seed_of
from guided_gym.train import networks
from guided_gym.train.checkpoints import AGENT_FOLDER, check_board
from guided_gym.train.lessons import SHARD, Lesson, lessons
from guided_gym.train.specs import package_version
from guided_gym.train.staged import StagedConfig, StagedRun, Tensors, put_moments
from guided_gym.train.symmetries import SYMMETRIES, turned, turned_back
from guided_gym.train.terminal import Progress

_DATA_SEED, _ENCODER_SEED, _DECODER_SEED = range(3)
_BETA: Final = 0.02  # errors below this part of the distance count by their square
_NEAREST: Final = 0.1  # sides of the square below which errors are no longer taken relative to the distance
_POSES_A_BATCH: Final = 512

# Bytes, about: what lessons take.
_POSE: Final = 32  # a pose and its cost
_HEADING: Final = 4  # room of a pose, or a sample of the distance


@dataclass(frozen=True)
class ImitationConfig(StagedConfig):
    """Options of a run; a TOML file holds the same names. `StagedConfig` has the others.

    Attributes:
        poses: Poses of each training problem that the oracle is asked about.
        encoder_steps: Steps of gradient descent of the encoder.
        decoder_epochs: Passes of the decoder over the training problems; 0 leaves the wave uncorrected.
        batch: Problems a step of the decoder.
        divergence: ``"forward"`` minimises D_KL(Q || P), ``"reverse"`` D_KL(P || Q).
        learning_rate: At the start of each stage; it falls to nothing along a cosine.
        device: ``"cpu"`` or ``"cuda"``.
        tensorboard: Whether to write TensorBoard files too.
        cells: Cells along each side of the raster.
        headings: Headings of the grid.
        planning: Whether the field has its wave; without, the decoder has to learn all by itself.

    Raises:
        InvalidInputError: An option that is out of range.
    """

    environments: tuple[str, ...] = ("RandomSimplePassage",)
    problems: int = 512
    validation: int = 64
    rounds: int = 3
    searches: int = 96
    poses: int = 1024
    encoder_steps: int = 500
    decoder_epochs: int = 10
    batch: int = 16
    divergence: str = "forward"
    learning_rate: float = 2e-3
    device: str = "cpu"
    tensorboard: bool = False
    cells: int = 56
    headings: int = 16
    planning: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("encoder_steps", "decoder_epochs"):
            integer(name, getattr(self, name), least=0)
        integer("poses", self.poses, least=1)
        check_grid(self.cells, self.headings)
        lesson = _POSE * self.poses + _HEADING * self.cells**2 * (self.headings + fields.FINE**2)
        for name in ("problems", "validation", "batch"):
            count(name, getattr(self, name), least=1, each=lesson, what="the lessons of so many problems")
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
    run = _Run(config, out, progress)
    with worker_pool(workers) as run.search:
        return run.all_stages()


class _Run(StagedRun):
    """One run: networks and stages."""

    method = "imitation"
    config: ImitationConfig

    def __init__(self, config: ImitationConfig, out: Path, progress: Progress | None) -> None:
        device = checked_device(config.device)
        check_board(config.tensorboard)
        begun: dict[str, Any] = {"encoder": 0, "epochs": 0, "rounds": 0}
        super().__init__(config, out, progress, begun, device)
        self.architecture, self.scorer_architecture = config.field(), config.scorer()
        torch.manual_seed(config.seed)
        torch.set_num_threads(1)
        self.encoder = networks.Encoder(self.architecture).to(device)
        self.decoder = networks.Decoder(self.architecture).to(device)
        self.scorer = networks.NodeScorer(self.scorer_architecture).to(device)
        self.writer = _board(out) if config.tensorboard else None
        self.restore()

    def tensors(self) -> Tensors:
        """Those of the field and of the scorer."""
        field = networks.field_tensors(self.encoder, self.decoder)
        scorer = networks.scorer_tensors(self.scorer)
        named = {f"field.{name}": t for name, t in field.items()}
        return {**named, **{f"scorer.{name}": t for name, t in scorer.items()}}

    def load(self, tensors: Tensors) -> None:
        """Take weights that `tensors` gave."""
        networks.load_field(self.encoder, self.decoder, weights.part_of(tensors, "field"))
        networks.load_scorer(self.scorer, weights.part_of(tensors, "scorer"))

    # Stages

    def all_stages(self) -> dict[str, Any]:
        """Run what is left of the training."""
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
        self.note("encoder", accuracy=float(right))
        self.consider("encoder", self.searcher())
        self.save()

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
            self.note("decoder", epoch=epoch + 1, loss=float(np.mean(losses)), validation_error=error)
            if self.state["epochs"] == config.decoder_epochs:
                self.consider("decoder", self.searcher())
            self.save(optimizer)
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
        """One round of DAgger."""
        number = self.state["rounds"]
        self.train_scorer(number, self.config.learning_rate, self.config.divergence)
        self.state["rounds"] = number + 1
        self.consider(f"round {number + 1}", self.searcher())
        self.save()

    def searcher(self, temperature: float = 0.0) -> LearnedGuidance:
        """The policy as it is."""
        field = FieldModel(self.architecture, networks.field_tensors(self.encoder, self.decoder))
        scorer = ScorerModel(self.scorer_architecture, networks.scorer_tensors(self.scorer))
        return LearnedGuidance(LearnedAgent({}, field, scorer), temperature=temperature)

    def note(self, what: str, **values: float) -> None:
        """Enter something in the history, and in TensorBoard's files."""
        super().note(what, **values)
        if self.writer is not None:
            step = int(values.get("epoch", values.get("round", len(self.state["history"]))))
            for name in values.keys() - {"epoch", "round"}:
                self.writer.add_scalar(f"{what.split()[0]}/{name}", values[name], step)

    def _write_agent(self) -> dict[str, Any]:
        tensors = self.best or self.tensors()
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


def _generator(*numbers: int) -> np.random.Generator:
    return np.random.default_rng(seed_of(*numbers))


def _random_decoder(decoder: networks.Decoder) -> Tensors:
    return {name: t.detach().cpu().numpy().copy() for name, t in decoder.state_dict().items()}


def _board(out: Path) -> Any:
    from torch.utils.tensorboard import SummaryWriter

    return SummaryWriter(str(out / "tensorboard"))  # type: ignore[no-untyped-call]


__all__ = ["SHARD", "ImitationConfig", "checked_device", "train_imitation"]
