"""Reinforcement learning: PPO of stable-baselines3, in runs that survive a kill.

`train_hybrid` (in `hybrid_rule`) teaches a rule of hybrids, `train_ppo` (in `node_policy`) a scorer. Both
are a `Trainee` for the loop here: rollouts and updates, validation searches, the best weights kept.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np
import torch
from gymnasium.wrappers import TransformReward
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from guided_gym.catalogue.table import make_distribution
from guided_gym.checks import count, integer, number
from guided_gym.compute.workers import MapTasks, Workers, in_order, worker_pool
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.learned import weights
from guided_gym.options import checked_samples
from guided_gym.randomness import seed_of
from guided_gym.train.checkpoints import AGENT_FOLDER, RunFolder, check_board
from guided_gym.train.imitation import checked_device
from guided_gym.train.staged import moments_of, put_moments
from guided_gym.train.terminal import Progress
from guided_gym.train.validation import rank, validated

Tensors = dict[str, NDArray[Any]]

CHECKPOINT_SECONDS: Final = 20.0
_MB: Final = 1_000_000
_COPY: Final = 1_000_000  # bytes, at least: a problem, its oracle and the observation of a tree
_SEARCH: Final = 10_000  # likewise: what is kept of a validation search
_ROW: Final = 32  # bytes of action, reward, return, episode start, value, log-probability and advantage


@dataclass(frozen=True)
class ReinforcementConfig:
    """Options of a run; a TOML file holds the same names.

    Attributes:
        environments: Distributions of problems; the copies of the environment take them in turns.
        seed: Of everything random. The same seed gives the same weights on one machine.
        steps: Samples to learn from, in all.
        copies: Environments that are searched side by side.
        rollout: Samples of each copy between updates.
        batch: Samples a step of gradient descent.
        epochs: Passes over a rollout.
        learning_rate: Of Adam.
        anneal: Whether it falls to nothing along a line, so that the weights come to rest.
        gamma: Discount.
        gae_lambda: Of the advantage estimates.
        entropy: Weight of the entropy in the loss.
        clip: Of the ratio of probabilities.
        reward_scale: Factor on the reward while learning.
        max_samples: Samples after which a search gives up.
        validation: Validation problems.
        validate_every: Samples between validations.
        max_memory: MB that the rollout buffer and the copy that sampling makes of it may take.
        device: ``"cpu"`` or ``"cuda"``.
        tensorboard: Whether to write TensorBoard files too.

    Raises:
        InvalidInputError: An option that is out of range.
    """

    environments: tuple[str, ...] = ("RandomTrapCup",)
    seed: int = 0
    steps: int = 200_000
    copies: int = 8
    rollout: int = 256
    batch: int = 512
    epochs: int = 8
    learning_rate: float = 5e-4
    anneal: bool = True
    gamma: float = 0.995
    gae_lambda: float = 0.95
    entropy: float = 0.01
    clip: float = 0.2
    reward_scale: float = 0.1
    max_samples: int = 500
    validation: int = 48
    validate_every: int = 20_000
    max_memory: float = 2000.0
    device: str = "cpu"
    tensorboard: bool = False

    def __post_init__(self) -> None:
        if not self.environments:
            raise InvalidInputError("environments: expected at least one, got none")
        for name in ("steps", "epochs", "validate_every"):
            integer(name, getattr(self, name), least=1)
        checked_samples(self.max_samples)
        count("copies", self.copies, least=1, each=_COPY, what="so many environments")
        count(
            "validation", self.validation, least=1, each=_SEARCH, what="so many problems and their searches"
        )
        for name in ("rollout", "batch"):
            integer(name, getattr(self, name), least=2)
        integer("seed", self.seed, least=0)
        for name in ("learning_rate", "reward_scale", "max_memory", "clip"):
            number(name, getattr(self, name), above=0)
        number("entropy", self.entropy, least=0)
        for name in ("gamma", "gae_lambda"):
            if number(name, getattr(self, name), least=0) > 1:
                raise InvalidInputError(f"{name}: expected at most 1, got {getattr(self, name)!r}")
        if self.copies * self.rollout % self.batch == 1:
            raise InvalidInputError(
                f"batch: expected batches of at least two samples, got {self.batch}, which leaves one over"
            )


class Trainee(ABC):
    """What is learned: an environment, the model that learns in it, and the guidance that results.

    Attributes:
        kind: The command that trains it.
        config: Its options.
        selection: Whether selection alone is learned: validation expands uniformly, and ranks by excess SE.
    """

    kind: str
    config: ReinforcementConfig
    selection: bool = False

    @abstractmethod
    def environment(self, name: str) -> gymnasium.Env[Any, Any]:
        """The environment over the training problems of a distribution."""

    @abstractmethod
    def model(self, environments: DummyVecEnv, options: dict[str, Any]) -> PPO:
        """The learner; ``options`` are those that every PPO has."""

    @abstractmethod
    def export(self, model: PPO) -> Tensors:
        """The weights, as an agent's files hold them."""

    @abstractmethod
    def guidance(self, tensors: Tensors) -> GuidingSpace:
        """The guiding space of some weights."""

    @abstractmethod
    def write(self, folder: Path, card: dict[str, Any], tensors: Tensors) -> None:
        """Write the agent."""


def train(
    trainee: Trainee,
    out: Path,
    progress: Progress | None = None,
    say: Callable[[str], None] = print,
    workers: Workers = 1,
) -> dict[str, Any]:
    """Run or continue a run; returns the card of the best agent, written to ``out/agent``.

    ``workers`` validate, while this process learns; what they find does not depend on them.

    Raises:
        InvalidInputError: The device or TensorBoard is not there, or the buffer would take too much memory.
        UnknownNameError: No such environment.
        StorageError: The folder holds another run, or a damaged file.
    """
    run = _Run(trainee, out, progress or (lambda done, total, what: None), say)
    with worker_pool(workers) as run.search:
        return run.finish()


def buffer_bytes(space: gymnasium.Space[Any], config: ReinforcementConfig, mask: int = 0) -> int:
    """Bytes of the rollout buffer over an observation space; ``mask`` floats of action masks come with it."""
    spaces = space.spaces.values() if isinstance(space, gymnasium.spaces.Dict) else (space,)
    row = sum(int(np.prod(s.shape or (1,))) * np.dtype(s.dtype or np.float64).itemsize for s in spaces)
    return config.copies * config.rollout * (row + 4 * mask + _ROW)


class _Run:
    """One run: its model, state and files."""

    def __init__(self, trainee: Trainee, out: Path, progress: Progress, say: Callable[[str], None]) -> None:
        self.trainee, self.config, self.progress = trainee, trainee.config, progress
        self.search: MapTasks = in_order
        config = self.config
        device = checked_device(config.device)
        check_board(config.tensorboard)
        self.distributions = [make_distribution(name) for name in config.environments]
        copies = [self._copy(i) for i in range(config.copies)]
        space, actions = copies[0].observation_space, copies[0].action_space
        masked = int(actions.n) if isinstance(space, gymnasium.spaces.Dict) else 0  # type: ignore[attr-defined]
        self._check_memory(buffer_bytes(space, config, masked), say)
        self.folder = RunFolder(out, config, trainee.kind)
        torch.set_num_threads(1)
        self.environments = DummyVecEnv([lambda env=env: env for env in copies])  # type: ignore[misc]
        self.model = trainee.model(
            self.environments,
            {
                "learning_rate": _falling(config.learning_rate) if config.anneal else config.learning_rate,
                "n_steps": config.rollout, "batch_size": config.batch,
                "n_epochs": config.epochs, "gamma": config.gamma, "gae_lambda": config.gae_lambda,
                "ent_coef": config.entropy, "clip_range": config.clip, "seed": config.seed, "device": device,
                "tensorboard_log": str(out / "tensorboard") if config.tensorboard else None,
            },
        )  # fmt: skip
        self.state: dict[str, Any] = {
            "steps": 0, "seconds": 0.0, "validated": 0, "history": [], "best": None,
        }  # fmt: skip
        self.best: Tensors = {}
        self._restore()
        self._begun = time.monotonic() - self.state["seconds"]

    def _elapsed(self) -> float:
        """Seconds that the run has taken so far, interruptions left out."""
        return float(time.monotonic() - self._begun)

    def _copy(self, i: int) -> gymnasium.Env[Any, Any]:
        names, scale = self.config.environments, self.config.reward_scale
        env = self.trainee.environment(names[i % len(names)])
        return Monitor(TransformReward(env, lambda reward: scale * float(reward)))

    def _check_memory(self, size: int, say: Callable[[str], None]) -> None:
        """Say what the buffer takes, the copy that sampling makes included; refuse what is too much."""
        needed, most = 2 * size / _MB, self.config.max_memory
        shape = f"{self.config.copies} copies x {self.config.rollout} samples"
        if needed > most:
            raise InvalidInputError(
                f"max_memory: expected at least {needed:.1f} MB for a rollout buffer of {shape}, got {most:g}"
            )
        say(f"rollout buffer: {needed:.1f} MB ({shape}; at most {most:g} MB)")

    # Files

    def _restore(self) -> None:
        loaded = self.folder.load()
        if loaded is not None:
            self.state, tensors = loaded
            now = weights.part_of(tensors, "now", "/")
            self.model.policy.load_state_dict({name: torch.from_numpy(t) for name, t in now.items()})
            put_moments(self.model.policy.optimizer, weights.part_of(tensors, "adam", "/"))
            self.best = weights.part_of(tensors, "best", "/")
            self.model.num_timesteps = self.state["steps"]
        # Seeds of problems: another stretch of the training problems after each interruption.
        seed = seed_of(self.config.seed, self.state["steps"])
        self.model.set_random_seed(seed % 2**29)

    def save(self) -> None:
        """Replace the checkpoint."""
        self.state["steps"], self.state["seconds"] = self.model.num_timesteps, self._elapsed()
        policy = self.model.policy
        tensors = {f"now/{n}": t.detach().cpu().numpy() for n, t in policy.state_dict().items()}
        tensors.update({f"adam/{name}": t for name, t in moments_of(policy.optimizer).items()})
        tensors.update({f"best/{name}": t for name, t in self.best.items()})
        self.folder.save(self.state, tensors)

    # The loop

    def finish(self) -> dict[str, Any]:
        """Run what is left of the training."""
        left = self.config.steps - self.model.num_timesteps
        if left > 0:
            self.model.learn(left, callback=_Keeper(self), reset_num_timesteps=False, tb_log_name="ppo")
            self.validate()
            self.save()
        self.environments.close()
        card = {
            "name": self.folder.path.name,
            "training": {"method": self.trainee.kind, **asdict(self.config)},
            "metrics": {"validation": self.state["best"], "history": self.state["history"]},
        }
        self.trainee.write(self.folder.path / AGENT_FOLDER, card, self.best)
        return card

    def validate(self) -> None:
        """Search on the validation problems; keep these weights if they are the best so far."""
        config, tensors = self.config, self.trainee.export(self.model)
        guidance = self.trainee.guidance(tensors)
        metrics: dict[str, float] = {"steps": self.model.num_timesteps, "seconds": round(self._elapsed(), 1)}
        metrics |= validated(
            self.distributions,
            guidance,
            count=config.validation,
            max_samples=config.max_samples,
            run=self.search,
            expansion="uniform" if self.trainee.selection else None,
        )
        self.state["history"].append(metrics)
        self.state["validated"] = self.model.num_timesteps
        self._log(metrics)
        best = self.state["best"]
        order = partial(rank, selection=self.trainee.selection)
        if best is None or order(metrics) < order(best):
            self.state["best"], self.best = metrics, tensors

    def _log(self, metrics: dict[str, Any]) -> None:
        """Curves of the validations, at once: stable-baselines3 writes after the next rollout only."""
        logger = self.model.logger
        for name, value in metrics.items():
            if name != "steps":
                logger.record(f"validation/{name}", value)
        logger.dump(metrics["steps"])


class _Keeper(BaseCallback):
    """Between updates: checkpoints, validation, progress."""

    def __init__(self, run: _Run) -> None:
        super().__init__()
        self._run, self._saved = run, time.monotonic()

    def _on_step(self) -> bool:
        self._tell()
        return True

    def _on_rollout_start(self) -> None:
        run = self._run
        if time.monotonic() - self._saved > CHECKPOINT_SECONDS:
            run.save()
            self._saved = time.monotonic()
        due = run.state["validated"] + run.config.validate_every
        if not run.state["history"] or run.model.num_timesteps >= due:
            run.validate()
            run.save()
            self._saved = time.monotonic()
        self._tell()

    def _tell(self) -> None:
        run, best = self._run, self._run.state["best"]
        so_far = f"best SE {best['total_efficiency']:.1f} at {best['steps']}" if best else "validating"
        run.progress(run.model.num_timesteps, run.config.steps, f"{run.trainee.kind}: {so_far}")


def _falling(rate: float) -> Callable[[float], float]:
    """A learning rate by the share of the run that is left."""
    return lambda left: rate * max(left, 0.0)
