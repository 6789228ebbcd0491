"""``guided-gym replay``: searches from their traces, as a page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from guided_gym.train.terminal import console


def register(app: typer.Typer) -> None:
    """Add the commands of this module to an application."""
    app.command()(replay)


def replay(
    trace: Annotated[Path, typer.Argument(help="A trace, as guided_search(..., trace=FILE) writes it.")],
    other: Annotated[Path | None, typer.Argument(help="Another one, shown beside it.")] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="The page.")] = Path("search.html"),
    samples: Annotated[int, typer.Option(help="Samples of each that are shown at most.")] = 100_000,
) -> None:
    """Make a page that plays a search, or two side by side; it needs no network and opens from disk."""
    from guided_gym.display.replay import replay_page
    from guided_gym.train.table import write_whole

    traces = [trace] if other is None else [trace, other]
    page = replay_page(traces, samples=samples).encode()
    write_whole(out, page)
    console().print(f"{out}: {len(page) / 1e6:.2g} MB; open it in a browser", markup=False)
