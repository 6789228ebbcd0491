"""The table of an evaluation: on the terminal, as CSV and as JSON."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from guided_gym.errors import StorageError
from guided_gym.train.results import Column, Results
from guided_gym.train.statistics import Interval, bootstrap, significant

if TYPE_CHECKING:
    from rich.table import Table


@dataclass(frozen=True)
class Measure:
    """One column of the table.

    Attributes:
        key: Name in CSV and JSON.
        title: Heading on the terminal.
        column: What it is computed from.
        statistic: Over seeds.
        scale: Factor for the terminal, where ``title`` names another unit.
    """

    key: str
    title: str
    column: Column
    statistic: Literal["mean", "median"]
    scale: float = 1.0


# One row per column of the table.
MEASURES = (
    Measure("solved", "solved\n%", "solved", "mean", 100.0),
    Measure("samples_median", "samples\nmedian", "samples", "median"),
    Measure("samples_mean", "samples\nmean", "samples", "mean"),
    Measure("efficiency_per_sample", "SE per sample\nnats", "efficiency_per_sample", "mean"),
    Measure("total_efficiency", "total SE\nnats", "total_efficiency", "mean"),
    Measure("best_possible", "best possible\nnats", "best_possible", "mean"),
    Measure("collision_checks", "collision\nchecks", "collision_checks", "mean"),
    Measure("seconds", "wall time\nms", "seconds", "mean", 1000.0),
)

# Shown where they were asked for.
DISTRIBUTION_MEASURES = (
    Measure("divergence", "D_KL(P‖Q)\nnats", "divergence", "mean"),
    Measure("jensen_shannon", "D_JS(P‖Q)\nnats", "jensen_shannon", "mean"),
)


@dataclass(frozen=True)
class Row:
    """Figures of one guidance on one environment.

    Attributes:
        environment: Name of the problem or distribution.
        guidance: Label of the guidance.
        seeds: Number of runs behind the figures.
        figures: Key of each measure to its estimate and 95 % bootstrap interval over seeds.
    """

    environment: str
    guidance: str
    seeds: int
    figures: Mapping[str, Interval]

    def record(self) -> dict[str, Any]:
        """Flat and JSON-able; what cannot be estimated is None."""
        flat: dict[str, Any] = {
            "environment": self.environment,
            "guidance": self.guidance,
            "seeds": self.seeds,
        }
        for key, interval in self.figures.items():
            values = (interval.estimate, interval.low, interval.high)
            for suffix, value in zip(("", "_low", "_high"), values, strict=True):
                flat[key + suffix] = value if math.isfinite(value) else None
        return flat


def summarise(results: Results) -> list[Row]:
    """One row per (environment, guidance), in the order of the results."""
    measures = [*MEASURES, *(DISTRIBUTION_MEASURES if _has_distributions(results) else ())]
    rows = []
    for pair in results.pairs():
        figures = {
            measure.key: bootstrap(results.values(*pair, measure.column), measure.statistic)
            for measure in measures
        }
        rows.append(Row(*pair, len(results.group(*pair)), figures))
    return rows


def _has_distributions(results: Results) -> bool:
    return any(math.isfinite(run.divergence) for run in results.runs)


def rich_tables(rows: list[Row]) -> list[Table]:
    """One table per environment, for `rich.print`; the interval is under each figure."""
    from rich import box
    from rich.table import Table

    tables = []
    for environment in dict.fromkeys(row.environment for row in rows):
        chosen = [row for row in rows if row.environment == environment]
        seeds = max(row.seeds for row in chosen)
        table = Table(
            title=f"{environment}, {seeds} {'seed' if seeds == 1 else 'seeds'}", title_justify="left",
            caption="Mean (or median) over seeds, 95 % bootstrap interval below. SE: lower is better.",
            caption_justify="left", box=box.SIMPLE_HEAD, pad_edge=False,
        )  # fmt: skip
        table.add_column("guidance", overflow="fold")
        measures = [one for one in (*MEASURES, *DISTRIBUTION_MEASURES) if one.key in chosen[0].figures]
        for measure in measures:
            table.add_column(measure.title, justify="right")
        for row in chosen:
            table.add_row(row.guidance, *(_cell(row.figures[measure.key], measure) for measure in measures))
        tables.append(table)
    return tables


def _cell(interval: Interval, measure: Measure) -> str:
    estimate, low, high = (
        significant(value * measure.scale) for value in (interval.estimate, interval.low, interval.high)
    )
    return f"{estimate}\n[dim]{low} – {high}[/dim]"  # blanks: a narrow window may break the line there


def save(rows: list[Row], folder: Path, name: str = "table") -> list[Path]:
    """Write ``name.csv`` and ``name.json`` into a folder, each whole or not at all.

    Raises:
        StorageError: The folder cannot be written.
    """
    return save_records([row.record() for row in rows], folder, name)


def save_records(records: list[dict[str, Any]], folder: Path, name: str) -> list[Path]:
    """Write JSON-able records with the same keys as CSV and as JSON, each whole or not at all.

    Raises:
        StorageError: The folder cannot be written.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(records[0]) if records else [], lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    contents = {
        folder / f"{name}.csv": text.getvalue(),
        folder / f"{name}.json": json.dumps(records, indent=1) + "\n",
    }
    for path, content in contents.items():
        write_whole(path, content.encode())
    return list(contents)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that it is there whole or not at all.

    Raises:
        StorageError: It cannot be written.
    """
    try:
        with tempfile.NamedTemporaryFile(dir=path.parent, prefix=path.name, delete=False) as file:
            file.write(content)
        os.chmod(file.name, 0o644)
        os.replace(file.name, path)
    except OSError as error:
        raise StorageError(f"cannot write {path}: {error}") from error
