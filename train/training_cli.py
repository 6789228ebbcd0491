"""``guided-gym train ...``: the command line of the trainings."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from guided_gym.errors import GuidedGymError
from guided_gym.train.command_options import VALIDATION_WORK, Options, executor_of, takes
from guided_gym.train.terminal import progress_bar

if TYPE_CHECKING:
    from rich.table import Table

    from guided_gym.compute.workers import Executor

C = TypeVar("C")

train_app = typer.Typer(help="Train learned guidance (needs the extra 'train').", no_args_is_help=True)

Config = Annotated[
    Path | None,
    typer.Option(help="TOML file of options, as a run writes it. Options on the command line win."),
]

OptionTable = Mapping[str, tuple[type, str]]
"""Of options, named as the fields of a configuration: the type on the command line, and the help."""

SEED = (int, "Seed of every random choice.")
VALIDATION = (int, "Validation problems.")
DEVICE = (str, "Device to learn on: cpu or cuda.")
SELECTION = (bool, "Whether all searches expand uniformly, so that selection alone is learned.")
TENSORBOARD = (bool, "Write TensorBoard files.")
LISTS = ("environments", "guides")  # with commas on the command line

_OPTIONS: OptionTable = {
    "seed": SEED,
    "problems": (int, "Training problems."),
    "validation": VALIDATION,
    "decoder_epochs": (int, "Passes over the training problems."),
    "rounds": (int, "Rounds of DAgger."),
    "searches": (int, "Searches in each round."),
    "divergence": (str, "What is minimised: forward, D_KL(Q || P); or reverse, D_KL(P || Q)."),
    "selection": SELECTION,
    "cells": (int, "Cells along each side of the raster."),
    "headings": (int, "Headings of the grid."),
    "planning": (bool, "Whether a wave plans on the field."),
    "device": DEVICE,
    "tensorboard": TENSORBOARD,
}


def optional(table: OptionTable) -> Options:
    """The options of a table as a command takes them; None for those left out."""
    return {
        name: (Annotated[kind | None, typer.Option(help=text)], None) for name, (kind, text) in table.items()
    }


def out_of(method: str) -> tuple[Any, None]:
    """The option of the folder of a run by this method."""
    return Annotated[Path | None, typer.Option(help=f"Folder of the run. Default: runs/{method}-ENV.")], None


def need(*packages: str) -> None:
    """Refuse before anything starts if part of the extra ``[train]`` is not installed.

    Raises:
        GuidedGymError: A package is not.
    """
    for package in packages:
        if importlib.util.find_spec(package) is None:
            raise GuidedGymError(
                f"training needs {package}: in a checkout of guided-gym, pip install '.[train]'"
            )


def settings_of(kind: type[C], config: Path | None, given: Mapping[str, Any]) -> C:
    """The configuration of a run: the options in a TOML file, and those given here, which win.

    Raises:
        InvalidInputError: An option that is out of range, or an empty item in a list.
        StorageError: The file is missing or not TOML.
        UnknownNameError: An option in the file that there is not.
    """
    from guided_gym.train.checkpoints import build_config, check_board, read_config
    from guided_gym.train.specs import words

    options = dict(read_config(config)) if config is not None else {}
    for name, value in given.items():
        if value is not None:
            options[name] = words(name, value) if name in LISTS else value
    settings = build_config(kind, options)
    check_board(options.get("tensorboard", False))
    return settings


@train_app.command("imitation")
@takes({"out": out_of("imitation"), **VALIDATION_WORK, **optional(_OPTIONS)})
def imitation(
    env: Annotated[
        str | None,
        typer.Argument(help="Environments to learn from, separated by commas. Default: RandomSimplePassage."),
    ] = None,
    config: Config = None,
    **given: Any,
) -> None:
    """Learn a field from the oracle, and a node scorer from its target. Call it again to resume."""
    need("torch")
    from guided_gym.train.imitation import ImitationConfig, train_imitation

    executor, out = executor_of(given), given.pop("out")
    settings = settings_of(ImitationConfig, config, {"environments": env, **given})
    _run("imitation", partial(train_imitation, settings), settings.environments, out, executor)


_MOTION_OPTIONS: OptionTable = {
    "seed": SEED,
    "problems": (int, "Training problems."),
    "motions": (int, "Motions of each problem that are checked for collision."),
    "validation": VALIDATION,
    "belief_steps": (int, "Steps of gradient descent of the belief."),
    "estimate_steps": (int, "Steps of gradient descent of the cost-to-go."),
    "rounds": (int, "Rounds of DAgger."),
    "searches": (int, "Searches in each round."),
    "selection": SELECTION,
}


@train_app.command("motions")
@takes({"out": out_of("motions"), **VALIDATION_WORK, **optional(_MOTION_OPTIONS)})
def motions(
    env: Annotated[
        str | None,
        typer.Argument(help="Environments of one robot, separated by commas. Default: RandomPlanarArm4."),
    ] = None,
    config: Config = None,
    **given: Any,
) -> None:
    """Learn which motions are free, and the cost-to-go, without a grid. Call it again to resume."""
    need("torch")
    from guided_gym.train.motions import MotionConfig, train_motions

    executor, out = executor_of(given), given.pop("out")
    settings = settings_of(MotionConfig, config, {"environments": env, **given})
    _run("motions", partial(train_motions, settings), settings.environments, out, executor)


_SELECTION_OPTIONS: OptionTable = {
    "agent": (str, "Whose selection is sought: a shipped agent's name, or a folder."),
    "seed": SEED,
    "problems": (int, "Training problems."),
    "validation": VALIDATION,
    "generations": (int, "Generations of candidates."),
    "population": (int, "Candidates in each generation."),
    "searches": (int, "Searches of each candidate."),
    "max_samples": (int, "Samples after which a search gives up."),
}


@train_app.command("selection")
@takes({"out": out_of("selection"), **VALIDATION_WORK, **optional(_SELECTION_OPTIONS)})
def selection(
    env: Annotated[
        str | None,
        typer.Argument(help="Environments to search in. Default: RandomTrapCup,RandomMaze,RandomClutter."),
    ] = None,
    config: Config = None,
    **given: Any,
) -> None:
    """Seek the numbers by which an agent selects nodes, by what its searches come to (CMA-ES)."""
    need("torch", "cmaes")
    from guided_gym.train.selection import SelectionConfig, train_selection

    executor, out = executor_of(given), given.pop("out")
    settings = settings_of(SelectionConfig, config, {"environments": env, **given})
    _run("selection", partial(train_selection, settings), settings.environments, out, executor)


def _run(
    method: str,
    train: Callable[..., dict[str, Any]],
    environments: Sequence[str],
    out: Path | None,
    executor: Executor,
) -> None:
    """Run or continue a training in its folder, and say what came of it."""
    from guided_gym.train.checkpoints import AGENT_FOLDER
    from guided_gym.train.specs import learned_word

    folder = out or Path("runs") / f"{method}-{'+'.join(environments)}"
    with progress_bar(method.capitalize(), folder) as progress:
        card = train(folder, progress, executor)
    _print_history(card)
    agent = folder / AGENT_FOLDER
    print(f"\nAgent in {agent}; try: guided-gym evaluate --guidance {learned_word(agent)} --env ...")


def _print_history(card: dict[str, Any]) -> None:
    from rich.console import Console

    console = Console(highlight=False)
    console.print(_table([row for row in card["metrics"]["history"] if "solved" in row]))
    best = card["metrics"]["validation"]
    console.print(f"kept: the weights after {best['stage']}" if best else "kept: the last weights")


def _table(rows: list[dict[str, Any]]) -> Table:
    from rich.table import Table

    table = Table(title="Searches on validation problems", title_justify="left")
    for name in ("", "solved", "samples", "total SE", "best possible"):
        table.add_column(name, justify="left" if not name else "right")
    for row in rows:
        numbers = (row["samples"], row["total_efficiency"], row["best_possible"])
        table.add_row(row["what"], f"{row['solved']:.3f}", *(f"{number:.2f}" for number in numbers))
    return table
