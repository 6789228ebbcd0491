"""Measure the tables of docs/learned.md, and of the README: ``python docs/make_protocols.py FOLDER [SEEDS]``.

Results are kept in the folder, one file for each problem and protocol, so that the same command goes on after
an interruption. The tables are written between two marks of each page.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

from make_methods import put_between

from guided_gym import EvaluationSettings, evaluate, summarise

PAGE = Path(__file__).parent / "learned.md"
README, SHOWN = Path(__file__).parents[1] / "README.md", "RandomTrapCup@test"
BEGIN, END = "<!-- tables: docs/make_protocols.py -->", "<!-- end of tables -->"
SEEDS, MAX_SAMPLES = 32, 500
SCRIPTED = ("wavefront", "lazy_prm", "medial_axis", "hybrid", "oracle")
LEARNED = {
    "TrapCup": "learned:se2",
    "RandomSimplePassage@test": "learned:se2",
    "RandomTrapCup@test": "learned:se2",
    "RandomMaze@test": "learned:se2",
    "RandomClutter@test": "learned:se2",
    "RandomPointMaze@test": "learned:point",
    "HardPointMaze@test": "learned:point",
    "HardStickMaze@test": "learned:stick",
}


class Column(NamedTuple):
    """A protocol and how many candidates an expansion looks at; and what its cell shows."""

    title: str
    protocol: str
    candidates: int
    figure: str


COLUMNS = (
    Column("whole, 16", "whole", 16, "total_efficiency"),
    Column("whole, 256", "whole", 256, "total_efficiency"),
    Column("selection", "selection", 16, "excess_efficiency"),
    Column("expansion, 16", "expansion", 16, "excess_efficiency"),
    Column("expansion, 256", "expansion", 256, "excess_efficiency"),
)


def cells(environment: str, column: Column, folder: Path, seeds: int) -> dict[str, str]:
    """A cell for each guidance: samples, and the figure with its interval; what was not solved is said."""
    settings = EvaluationSettings(MAX_SAMPLES, candidates=column.candidates, protocol=column.protocol)
    guidances = [LEARNED[environment], *SCRIPTED]
    out = folder / f"{environment.replace('@', '-')}-{column.title.replace(', ', '-')}"
    rows = summarise(evaluate(environment, guidances, seeds=seeds, settings=settings, out=out))
    shown = {}
    for row in rows:
        samples, value = row.figures["samples_mean"], row.figures[column.figure]
        solved = row.figures["solved"].estimate
        least = "≥ " if solved < 1 else ""
        best = "**" if column.figure in row.best else ""
        said = f"{samples.estimate:.0f}; {best}{least}{value.text()}{best}"
        shown[row.guidance] = said if solved == 1 else f"{said}, {100 * solved:.0f} %"
    return shown


def table(environment: str, folder: Path, seeds: int) -> str:
    """The table of a problem, its guidances by the protocols."""
    columns = [cells(environment, column, folder, seeds) for column in COLUMNS]
    head = ["", *(column.title for column in COLUMNS)]
    rows = [head, ["---"] * len(head)]
    for guidance in (LEARNED[environment], *SCRIPTED):
        rows.append([f"`{guidance}`", *(column[guidance] for column in columns)])
    lines = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    return f"**{environment}**\n\n{lines}"


def main(folder: Path, seeds: int) -> None:
    """Measure, and write the tables into the pages."""
    measured = {}
    for environment in LEARNED:
        measured[environment] = table(environment, folder, seeds)
        print(measured[environment], flush=True)
    said = (
        f"Means over {seeds} problems (seeds of TrapCup), at most {MAX_SAMPLES} samples. Each cell: samples; "
        "total SE (whole) or excess SE (selection and expansion) in nats, with its 95 % interval; the share "
        "solved where it is not 100 %. Bold: no guidance is known to be better."
    )
    put_between(PAGE, BEGIN, END, "\n\n".join([said, *measured.values()]))
    put_between(README, BEGIN, END, measured[SHOWN])


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else SEEDS)
