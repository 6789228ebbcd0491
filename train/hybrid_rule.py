"""The learned hybrid: plain PPO on the choice of the guiding space (paper, Section 7.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

from guided_gym.checks import integer, shown
from guided_gym.compute.workers import Workers
from guided_gym.envs.guide_selection_env import DEFAULT_GUIDES, GuideSelectionEnv
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.hybrid import Hybrid
from guided_gym.guidance.learned.rule import LearnedRule, RuleModel, rule_shapes, save_rule
from guided_gym.guidance.learned.turns import COLUMN_NAMES
from guided_gym.guidance.registry import make_guides
from guided_gym.train.reinforcement import ReinforcementConfig, Tensors, Trainee, train
from guided_gym.train.specs import package_version
from guided_gym.train.terminal import Progress


@dataclass(frozen=True)
class HybridConfig(ReinforcementConfig):
    """Options of a run that trains a rule.

    Attributes:
        guides: Names of the guiding spaces to choose from.
        hidden: Units of each hidden layer.

    Raises:
        InvalidInputError: An option that is out of range.
    """

    guides: tuple[str, ...] = DEFAULT_GUIDES
    hidden: tuple[int, ...] = (64, 64)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.guides) < 2:
            raise InvalidInputError(f"guides: expected at least two, got {shown(self.guides)}")
        for units in self.hidden:
            integer("hidden", units, least=1)


def train_hybrid(
    config: HybridConfig,
    out: Path,
    progress: Progress | None = None,
    say: Callable[[str], None] = print,
    workers: Workers = 1,
) -> dict[str, Any]:
    """Run or continue a run; returns the card of the best rule, written to ``out/agent``.

    ``workers`` validate.

    Raises:
        InvalidInputError: The device or TensorBoard is not there, or the buffer would take too much memory.
        UnknownNameError: No such environment or guiding space.
        StorageError: The folder holds another run, or a damaged file.
    """
    return train(_HybridTrainee(config), out, progress, say, workers)


class _HybridTrainee(Trainee):
    kind = "hybrid"
    config: HybridConfig

    def __init__(self, config: HybridConfig) -> None:
        self.config = config

    def environment(self, name: str) -> gymnasium.Env[Any, Any]:
        return GuideSelectionEnv(
            name, guides=self.config.guides, max_samples=self.config.max_samples, split="train"
        )

    def model(self, environments: DummyVecEnv, options: dict[str, Any]) -> PPO:
        layers = list(self.config.hidden)
        return PPO(
            "MlpPolicy", environments, policy_kwargs={"net_arch": {"pi": layers, "vf": layers}}, **options
        )

    def export(self, model: PPO) -> Tensors:
        state = {name: t.detach().cpu().numpy().copy() for name, t in model.policy.state_dict().items()}
        last = len(self.config.hidden)
        tensors: Tensors = {}
        for i in range(last + 1):
            # The linear layers of the perceptron are every other one of the sequence, tanh between them.
            source = f"mlp_extractor.policy_net.{2 * i}" if i < last else "action_net"
            for part in ("weight", "bias"):
                tensors[f"layers.{i}.{part}"] = state[f"{source}.{part}"].astype(np.float32)
        assert {n: t.shape for n, t in tensors.items()} == rule_shapes(self.config.guides, self.config.hidden)
        return tensors

    def guidance(self, tensors: Tensors) -> GuidingSpace:
        card = {"guides": self.config.guides, "hidden": self.config.hidden, "columns": COLUMN_NAMES}
        return Hybrid(make_guides(self.config.guides), rule=LearnedRule(RuleModel(card, tensors)))

    def write(self, folder: Path, card: dict[str, Any], tensors: Tensors) -> None:
        sizes = {"guides": list(self.config.guides), "hidden": list(self.config.hidden)}
        save_rule(folder, {**card, "package_version": package_version(), **sizes}, tensors)
