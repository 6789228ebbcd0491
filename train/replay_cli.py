"""``guided-gym replay`` and ``report``: searches and evaluations as pages."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from guided_gym.train.terminal import console, progress_bar


def register(app: typer.Typer) -> None:
    """Add the commands of this module to an application."""
    for command in (replay, report):
        app.command()(command)


def replay(
    trace: Annotated[Path, typer.Argument(help="Trace, as guided_search(..., trace=FILE) writes it.")],
    other: Annotated[Path | None, typer.Argument(help="Second trace, shown beside the first.")] = None,
    out: Annotated[Path, typer.Option("-o", "--out", help="File of the page.")] = Path("search.html"),
    samples: Annotated[int, typer.Option(help="Most samples of a search that the page shows.")] = 100_000,
) -> None:
    """Make a page that plays a search, or two side by side. It needs no network and opens from disk."""
    from guided_gym.display.replay import replay_page
    from guided_gym.storage.whole_file import write_whole

    traces = [trace] if other is None else [trace, other]
    with console(stderr=True).status(f"Reading {', '.join(one.name for one in traces)}"):
        page = replay_page(traces, samples=samples).encode()
    write_whole(out, page)
    console().print(f"{out}: {len(page) / 1e6:.2g} MB; open it in a browser", markup=False)


def report(
    folder: Annotated[Path, typer.Argument(help="Folder that `evaluate` or `reproduce` has written.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="File of the page. Default: report.html in the folder.")
    ] = None,
    replays: Annotated[
        bool, typer.Option(help="Search the best, median and worst seeds again, and show them.")
    ] = True,
    imports: Annotated[
        list[str] | None,
        typer.Option(
            "--import",
            help="Module to import first, which registers environments or guidances. May be repeated.",
        ),
    ] = None,
) -> None:
    """Make one page of an evaluation: tables, differences, figures, searches, and what was not solved."""
    from guided_gym.train.specs import import_modules

    import_modules(imports or ())
    say_report(folder, out, replays)


def say_report(folder: Path, out: Path | None = None, replays: bool = True) -> Path:
    """Write the report of a folder, and say where it is."""
    from guided_gym.train.report import write_report

    with progress_bar("Recording searches for the report", folder) as progress:
        page = write_report(folder, out, replays=replays, progress=progress)
    console().print(
        f"The report: {page} ({page.stat().st_size / 1e6:.2g} MB); open it in a browser", markup=False
    )
    return page
