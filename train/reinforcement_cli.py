"""``guided-gym train hybrid`` and ``guided-gym train ppo``."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from guided_gym.errors import GuidedGymError
from guided_gym.train.terminal import progress_bar
from guided_gym.train.training_cli import Config, train_app

if TYPE_CHECKING:
    from guided_gym.train.reinforcement import ReinforcementConfig

Env = Annotated[str | None, typer.Argument(help="Environments to learn on, separated by commas.")]
Out = Annotated[
    Path | None, typer.Option(help="Folder of the run; runs/hybrid-ENV or runs/ppo-ENV by default.")
]
Seed = Annotated[int | None, typer.Option(help="Seed of everything random.")]
Steps = Annotated[int | None, typer.Option(help="Samples to learn from.")]
Copies = Annotated[int | None, typer.Option(help="Environments that are searched side by side.")]
Rollout = Annotated[int | None, typer.Option(help="Samples of each copy between updates.")]
Batch = Annotated[int | None, typer.Option(help="Samples a step of gradient descent.")]
Epochs = Annotated[int | None, typer.Option(help="Passes over a rollout.")]
LearningRate = Annotated[float | None, typer.Option(help="Learning rate of Adam.")]
Anneal = Annotated[
    bool | None, typer.Option("--anneal/--no-anneal", help="Whether the learning rate falls to nothing.")
]
Gamma = Annotated[float | None, typer.Option(help="Discount.")]
GaeLambda = Annotated[float | None, typer.Option(help="Lambda of the advantage estimates.")]
Entropy = Annotated[float | None, typer.Option(help="Weight of the entropy in the loss.")]
Clip = Annotated[float | None, typer.Option(help="Clip of the ratio of probabilities.")]
RewardScale = Annotated[float | None, typer.Option(help="Factor on the reward while learning.")]
MaxSamples = Annotated[int | None, typer.Option(help="Samples after which a search gives up.")]
Validation = Annotated[int | None, typer.Option(help="Validation problems.")]
ValidateEvery = Annotated[int | None, typer.Option(help="Samples between validations.")]
MaxMemory = Annotated[float | None, typer.Option(help="MB that the rollout buffer may take.")]
Device = Annotated[str | None, typer.Option(help="cpu or cuda.")]
Board = Annotated[
    bool | None, typer.Option("--tensorboard/--no-tensorboard", help="Write TensorBoard files.")
]


@train_app.command("hybrid")
def hybrid(
    env: Env = None,
    config: Config = None,
    out: Out = None,
    guides: Annotated[
        str | None, typer.Option(help="Guiding spaces to choose from, separated by commas.")
    ] = None,
    seed: Seed = None,
    steps: Steps = None,
    copies: Copies = None,
    rollout: Rollout = None,
    batch: Batch = None,
    epochs: Epochs = None,
    learning_rate: LearningRate = None,
    anneal: Anneal = None,
    gamma: Gamma = None,
    gae_lambda: GaeLambda = None,
    entropy: Entropy = None,
    clip: Clip = None,
    reward_scale: RewardScale = None,
    max_samples: MaxSamples = None,
    validation: Validation = None,
    validate_every: ValidateEvery = None,
    max_memory: MaxMemory = None,
    device: Device = None,
    tensorboard: Board = None,
) -> None:
    """Learn which guiding space guides when, by plain PPO. Call it again to resume."""
    given = {name: value for name, value in locals().items() if name not in ("env", "config", "out")}
    need_stable_baselines()
    from guided_gym.train.hybrid_rule import HybridConfig, train_hybrid

    _run("hybrid", HybridConfig, train_hybrid, env, config, out, given)


@train_app.command("ppo")
def ppo(
    env: Env = None,
    config: Config = None,
    out: Out = None,
    start: Annotated[
        str | None,
        typer.Option(help="scratch, plain, or an agent to go on from (a folder, or a shipped one's name)."),
    ] = None,
    cells: Annotated[int | None, typer.Option(help="Cells along each side of an untaught field.")] = None,
    headings: Annotated[int | None, typer.Option(help="Headings of an untaught field.")] = None,
    scorer_hidden: Annotated[int | None, typer.Option(help="Units of each layer of the scorer.")] = None,
    seed: Seed = None,
    steps: Steps = None,
    copies: Copies = None,
    rollout: Rollout = None,
    batch: Batch = None,
    epochs: Epochs = None,
    learning_rate: LearningRate = None,
    anneal: Anneal = None,
    gamma: Gamma = None,
    gae_lambda: GaeLambda = None,
    entropy: Entropy = None,
    clip: Clip = None,
    reward_scale: RewardScale = None,
    max_samples: MaxSamples = None,
    validation: Validation = None,
    validate_every: ValidateEvery = None,
    max_memory: MaxMemory = None,
    device: Device = None,
    tensorboard: Board = None,
) -> None:
    """Learn which node to expand, by MaskablePPO with the node scorer as policy. Call it again to resume."""
    given = {name: value for name, value in locals().items() if name not in ("env", "config", "out")}
    need_stable_baselines()
    from guided_gym.train.node_policy import PPOConfig, train_ppo

    _run("ppo", PPOConfig, train_ppo, env, config, out, given)


def need_stable_baselines() -> None:
    """Refuse before anything starts if the extra ``[train]`` is not installed.

    Raises:
        GuidedGymError: Part of it is not.
    """
    for package in ("torch", "stable_baselines3", "sb3_contrib"):
        if importlib.util.find_spec(package) is None:
            raise GuidedGymError(f"training needs {package}: pip install 'guided-gym[train]'")


def _run(
    kind: str,
    options: type[ReinforcementConfig],
    run: Callable[..., dict[str, Any]],
    env: str | None,
    config: Path | None,
    out: Path | None,
    given: dict[str, Any],
) -> None:
    """Build the configuration, train with a progress bar, and print what came of it."""
    from guided_gym.train.checkpoints import build_config, read_config
    from guided_gym.train.specs import words

    given["environments"] = env
    for name in ("environments", "guides"):
        if given.get(name) is not None:
            given[name] = words(name, given[name])
    chosen = dict(read_config(config)) if config is not None else {}
    chosen.update({name: value for name, value in given.items() if value is not None})
    settings = build_config(options, chosen)
    folder = out or Path("runs") / f"{kind}-{'+'.join(settings.environments)}"
    with progress_bar(kind, folder) as progress:
        card = run(settings, folder, progress)
    _print_history(card, folder)


def _print_history(card: dict[str, Any], folder: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    best = card["metrics"]["validation"]
    table = Table(title="Searches on validation problems", title_justify="left")
    for name in ("steps", "solved", "samples", "total SE", "best possible", ""):
        table.add_column(name, justify="right")
    for row in card["metrics"]["history"]:
        numbers = (row["samples"], row["total_efficiency"], row["best_possible"])
        kept = "kept" if row == best else ""
        table.add_row(str(row["steps"]), f"{row['solved']:.3f}", *(f"{n:.2f}" for n in numbers), kept)
    Console(highlight=False).print(table)
    print(f"\nIn {folder / 'agent'}; try: guided-gym evaluate --guidance learned:{folder / 'agent'}")


__all__ = ["train_app"]
