"""``guided-gym train hybrid`` and ``guided-gym train ppo``."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from guided_gym.train.command_options import VALIDATION_WORK, executor_of, takes
from guided_gym.train.terminal import progress_bar
from guided_gym.train.training_cli import (
    DEVICE,
    SEED,
    TENSORBOARD,
    VALIDATION,
    Config,
    OptionTable,
    need,
    optional,
    settings_of,
    train_app,
)

if TYPE_CHECKING:
    from guided_gym.compute.workers import Executor
    from guided_gym.train.reinforcement import ReinforcementConfig

Env = Annotated[str | None, typer.Argument(help="Environments to learn on, separated by commas.")]
Out = Annotated[
    Path | None, typer.Option(help="Folder of the run; runs/hybrid-ENV or runs/ppo-ENV by default.")
]

_PPO: OptionTable = {
    "seed": SEED,
    "steps": (int, "Samples to learn from."),
    "copies": (int, "Environments that are searched side by side."),
    "rollout": (int, "Samples of each copy between updates."),
    "batch": (int, "Samples a step of gradient descent."),
    "epochs": (int, "Passes over a rollout."),
    "learning_rate": (float, "Learning rate of Adam."),
    "anneal": (bool, "Whether the learning rate falls to nothing."),
    "gamma": (float, "Discount."),
    "gae_lambda": (float, "Lambda of the advantage estimates."),
    "entropy": (float, "Weight of the entropy in the loss."),
    "clip": (float, "Clip of the ratio of probabilities."),
    "reward_scale": (float, "Factor on the reward while learning."),
    "max_samples": (int, "Samples after which a search gives up."),
    "validation": VALIDATION,
    "validate_every": (int, "Samples between validations."),
    "max_memory": (float, "MB that the rollout buffer may take."),
    "device": DEVICE,
    "tensorboard": TENSORBOARD,
}
_HYBRID: OptionTable = {"guides": (str, "Guiding spaces to choose from, separated by commas."), **_PPO}
_SCORER: OptionTable = {
    "start": (str, "scratch, plain, or an agent to go on from (a folder, or a shipped one's name)."),
    "cells": (int, "Cells along each side of an untaught field."),
    "headings": (int, "Headings of an untaught field."),
    "scorer_hidden": (int, "Units of each layer of the scorer."),
    **_PPO,
}


@train_app.command("hybrid")
@takes({**VALIDATION_WORK, **optional(_HYBRID)})
def hybrid(
    env: Env = None,
    config: Config = None,
    out: Out = None,
    **given: Any,
) -> None:
    """Learn which guiding space guides when, by plain PPO. Call it again to resume."""
    need("torch", "stable_baselines3", "sb3_contrib")
    from guided_gym.train.hybrid_rule import HybridConfig, train_hybrid

    executor = executor_of(given)
    settings = settings_of(HybridConfig, config, {"environments": env, **given})
    _run("hybrid", train_hybrid, settings, out, executor)


@train_app.command("ppo")
@takes({**VALIDATION_WORK, **optional(_SCORER)})
def ppo(
    env: Env = None,
    config: Config = None,
    out: Out = None,
    **given: Any,
) -> None:
    """Learn which node to expand, by MaskablePPO with the node scorer as policy. Call it again to resume."""
    need("torch", "stable_baselines3", "sb3_contrib")
    from guided_gym.train.node_policy import PPOConfig, train_ppo

    executor = executor_of(given)
    settings = settings_of(PPOConfig, config, {"environments": env, **given})
    _run("ppo", train_ppo, settings, out, executor)


@train_app.command("curves")
def curves(
    runs: Annotated[list[Path], typer.Argument(help="Folders of runs of train ppo or train hybrid.")],
    against: Annotated[
        str | None, typer.Option(help="Guidances to compare with, separated by commas.")
    ] = None,
    out: Annotated[Path, typer.Option(help="The figure: a .png, .pdf or .svg file.")] = Path("curves.png"),
) -> None:
    """Draw the learning curves of runs, beside other guidances on the same validation problems."""
    from guided_gym.train.curves import learning_curves, read_runs, references
    from guided_gym.train.specs import words
    from guided_gym.train.style import save
    from guided_gym.train.terminal import drawing_status

    cards = read_runs(runs)
    names = [] if against is None else words("against", against)
    with drawing_status(shown=True) as say:
        levels = references(cards[0], names, say)
    print(f"figure: {save(learning_curves(cards, levels), out, formats=(out.suffix[1:],))[0]}")


def _run(
    kind: str,
    train: Callable[..., dict[str, Any]],
    settings: ReinforcementConfig,
    out: Path | None,
    workers: Executor,
) -> None:
    """Train with a progress bar, and print what came of it."""
    folder = out or Path("runs") / f"{kind}-{'+'.join(settings.environments)}"
    with progress_bar(kind, folder) as progress:
        card = train(settings, folder, progress, workers=workers)
    _print_history(card, folder)


def _print_history(card: dict[str, Any], folder: Path) -> None:
    from rich.console import Console
    from rich.table import Table

    from guided_gym.train.specs import learned_word

    best = card["metrics"]["validation"]
    table = Table(title="Searches on validation problems", title_justify="left")
    for name in ("steps", "seconds", "solved", "samples", "total SE", "best possible", ""):
        table.add_column(name, justify="right")
    for row in card["metrics"]["history"]:
        numbers = (row["samples"], row["total_efficiency"], row["best_possible"])
        kept = "kept" if row == best else ""
        seconds, solved = f"{row.get('seconds', math.nan):.0f}", f"{row['solved']:.3f}"
        table.add_row(str(row["steps"]), seconds, solved, *(f"{n:.2f}" for n in numbers), kept)
    Console(highlight=False).print(table)
    word = learned_word(folder / "agent")
    print(f"\nIn {folder / 'agent'}; try: guided-gym evaluate --guidance {word}")


__all__ = ["train_app"]
