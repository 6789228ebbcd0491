"""``guided-gym train ...``: the command line of the trainings."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from guided_gym.errors import GuidedGymError
from guided_gym.train.terminal import progress_bar

if TYPE_CHECKING:
    from rich.table import Table

train_app = typer.Typer(help="Train learned guidance (needs the extra [train]).", no_args_is_help=True)

Config = Annotated[
    Path | None, typer.Option(help="TOML file of options, as a run writes it; options given here win.")
]
Out = Annotated[Path | None, typer.Option(help="Folder of the run; runs/imitation-ENV by default.")]


def need_torch() -> None:
    """Refuse before anything starts if torch is not installed.

    Raises:
        GuidedGymError: It is not.
    """
    if importlib.util.find_spec("torch") is None:
        raise GuidedGymError("training needs torch: pip install 'guided-gym[train]'")


@train_app.command("imitation")
def imitation(
    env: Annotated[
        str | None, typer.Argument(help="Environments to learn from, separated by commas.")
    ] = None,
    config: Config = None,
    out: Out = None,
    seed: Annotated[int | None, typer.Option(help="Seed of everything random.")] = None,
    problems: Annotated[int | None, typer.Option(help="Training problems.")] = None,
    validation: Annotated[int | None, typer.Option(help="Validation problems.")] = None,
    decoder_epochs: Annotated[int | None, typer.Option(help="Passes over the training problems.")] = None,
    rounds: Annotated[int | None, typer.Option(help="Rounds of DAgger.")] = None,
    searches: Annotated[int | None, typer.Option(help="Searches a round.")] = None,
    divergence: Annotated[
        str | None, typer.Option(help="forward: D_KL(Q || P); reverse: D_KL(P || Q).")
    ] = None,
    cells: Annotated[int | None, typer.Option(help="Cells along each side of the raster.")] = None,
    headings: Annotated[int | None, typer.Option(help="Headings of the grid.")] = None,
    planning: Annotated[
        bool | None, typer.Option("--planning/--no-planning", help="Whether the field has its wave.")
    ] = None,
    device: Annotated[str | None, typer.Option(help="cpu or cuda.")] = None,
    tensorboard: Annotated[
        bool | None, typer.Option("--tensorboard/--no-tensorboard", help="Write TensorBoard files.")
    ] = None,
) -> None:
    """Learn a field network from the oracle and a node scorer from its target. Call it again to resume."""
    from guided_gym.train.checkpoints import build_config, check_board, read_config

    need_torch()
    from guided_gym.train.imitation import AGENT_FOLDER, ImitationConfig, train_imitation
    from guided_gym.train.specs import words

    given = {
        "environments": None if env is None else words("environments", env),
        "seed": seed, "problems": problems, "validation": validation, "decoder_epochs": decoder_epochs,
        "rounds": rounds, "searches": searches, "divergence": divergence, "cells": cells,
        "headings": headings, "planning": planning, "device": device, "tensorboard": tensorboard,
    }  # fmt: skip
    options = dict(read_config(config)) if config is not None else {}
    options.update({name: value for name, value in given.items() if value is not None})
    settings = build_config(ImitationConfig, options)
    check_board(settings.tensorboard)
    folder = out or Path("runs") / f"imitation-{'+'.join(settings.environments)}"
    with progress_bar("Imitation", folder) as progress:
        card = train_imitation(settings, folder, progress)
    _print_history(card)
    agent = folder / AGENT_FOLDER
    print(f"\nAgent in {agent}; try: guided-gym evaluate --guidance learned:{agent} --env ...")


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
