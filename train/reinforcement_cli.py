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
    SELECTION,
    TENSORBOARD,
    VALIDATION,
    Config,
    OptionTable,
    need,
    optional,
    out_of,
    settings_of,
    train_app,
)

if TYPE_CHECKING:
    from guided_gym.compute.workers import Executor
    from guided_gym.train.reinforcement import ReinforcementConfig

_PPO: OptionTable = {
    "seed": SEED,
    "steps": (int, "Samples to learn from."),
    "copies": (int, "Environments that are searched side by side."),
    "rollout": (int, "Samples of each copy between two updates."),
    "batch": (int, "Samples per step of gradient descent."),
    "epochs": (int, "Passes over a rollout."),
    "learning_rate": (float, "Learning rate of Adam."),
    "anneal": (bool, "Whether the learning rate falls to zero."),
    "gamma": (float, "Discount."),
    "gae_lambda": (float, "Lambda of the advantage estimates."),
    "entropy": (float, "Weight of the entropy in the loss."),
    "clip": (float, "Clip of the ratio of probabilities."),
    "reward_scale": (float, "Factor on the reward while learning."),
    "max_samples": (int, "A search gives up after so many samples."),
    "validation": VALIDATION,
    "validate_every": (int, "Samples between validations."),
    "max_memory": (float, "Megabytes that the rollout buffer may take."),
    "device": DEVICE,
    "tensorboard": TENSORBOARD,
}
_HYBRID: OptionTable = {"guides": (str, "Guiding spaces to choose from, separated by commas."), **_PPO}
_SCORER: OptionTable = {
    "start": (str, "Where to start: scratch, plain, or an agent (a folder, or the name of a shipped one)."),
    "cells": (int, "Cells along each side of a field that is not learned."),
    "headings": (int, "Headings of a field that is not learned."),
    "scorer_hidden": (int, "Units of each layer of the scorer."),
    "selection": SELECTION,
    **_PPO,
}


@train_app.command("hybrid")
@takes({"out": out_of("hybrid"), **VALIDATION_WORK, **optional(_HYBRID)})
def hybrid(
    env: Annotated[
        str | None,
        typer.Argument(help="Environments to learn on, separated by commas. Default: RandomTrapCup."),
    ] = None,
    config: Config = None,
    **given: Any,
) -> None:
    """Learn which guiding space guides when, by PPO. Call it again to resume."""
    need("torch", "stable_baselines3", "sb3_contrib")
    from guided_gym.train.hybrid_rule import HybridConfig, train_hybrid

    executor, out = executor_of(given), given.pop("out")
    settings = settings_of(HybridConfig, config, {"environments": env, **given})
    _run("hybrid", train_hybrid, settings, out, executor)


@train_app.command("ppo")
@takes({"out": out_of("ppo"), **VALIDATION_WORK, **optional(_SCORER)})
def ppo(
    env: Annotated[
        str | None,
        typer.Argument(help="Environments to learn on, separated by commas. Default: RandomSimplePassage."),
    ] = None,
    config: Config = None,
    **given: Any,
) -> None:
    """Learn which node to expand, by MaskablePPO with the node scorer as policy. Call it again to resume."""
    need("torch", "stable_baselines3", "sb3_contrib")
    from guided_gym.train.node_policy import PPOConfig, train_ppo

    executor, out = executor_of(given), given.pop("out")
    settings = settings_of(PPOConfig, config, {"environments": env, **given})
    _run("ppo", train_ppo, settings, out, executor)


@train_app.command("curves")
def curves(
    runs: Annotated[list[Path], typer.Argument(help="Folders of runs of `train ppo` or `train hybrid`.")],
    against: Annotated[
        str | None, typer.Option(help="Guidances to compare with, separated by commas.")
    ] = None,
    out: Annotated[Path, typer.Option(help="File of the figure (.png, .pdf or .svg).")] = Path("curves.png"),
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

    from guided_gym.train.checkpoints import AGENT_FOLDER
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
    word = learned_word(folder / AGENT_FOLDER)
    print(f"\nIn {folder / AGENT_FOLDER}; try: guided-gym evaluate --guidance {word}")


__all__ = ["train_app"]
