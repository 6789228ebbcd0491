"""The table of an evaluation: on the terminal, as CSV and as JSON."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from guided_gym.doors import door
from guided_gym.storage.whole_file import write_whole
from guided_gym.train.results import Column, Results
from guided_gym.train.statistics import Interval, bootstrap, paired_difference, significant, wilson

if TYPE_CHECKING:
    from rich.table import Table


LEAST_PAIRS = 6  # seeds below which no sign test could tell two guidances apart


@dataclass(frozen=True)
class Measure:
    """One column of the table.

    Attributes:
        key: Name in CSV and JSON.
        title: Heading on the terminal.
        column: What it is computed from.
        statistic: Over seeds.
        scale: Factor for the terminal, where ``title`` names another unit.
        part: Of the terminal's table: how well, or at what cost; "" for the files alone.
        censored: Whether it would have been larger, had an unsolved search gone on.
        better: Which figures are good; "" if that cannot be said.
    """

    key: str
    title: str
    column: Column
    statistic: Literal["mean", "median"] = "mean"
    scale: float = 1.0
    part: Literal["quality", "cost", ""] = "quality"
    censored: bool = False
    better: Literal["low", "high", ""] = "low"


# One row per column of the table.
MEASURES = (
    Measure("solved", "solved\n%", "solved", "mean", 100.0, better="high"),
    Measure("samples_median", "samples\nmedian", "samples", "median", censored=True),
    Measure("samples_mean", "samples\nmean", "samples", part="", censored=True),
    Measure("efficiency_per_sample", "SE per sample\nnats", "efficiency_per_sample"),
    Measure("total_efficiency", "total SE\nnats", "total_efficiency", censored=True),
    Measure("best_possible", "best possible\nnats", "best_possible", censored=True, better=""),
    Measure("excess_efficiency", "excess SE\nnats", "excess_efficiency", censored=True),
    Measure("path_ratio", "path over\noptimum", "path_ratio"),
    Measure("oracle_error", "oracle error\n%", "oracle_error", "mean", 100.0, "", better=""),
    Measure("entropy", "entropy\nnats", "entropy", censored=True, better=""),
    Measure("nodes", "nodes", "nodes", part="cost", censored=True),
    Measure("collision_checks", "collision\nchecks", "collision_checks", part="cost", censored=True),
    Measure("looks", "looks at the\nworkspace", "looks", part="cost", censored=True),
    Measure("preparation", "preparation\nms", "preparation", "mean", 1e3, "cost"),
    Measure("seconds", "wall time\nms", "seconds", "mean", 1e3, "cost", True),
    Measure("processor", "processor\nms", "processor", "mean", 1e3, "", True),
    Measure("processor_per_sample", "processor\nµs a sample", "processor_per_sample", "mean", 1e6, "cost"),
)

# Shown where they were asked for.
DISTRIBUTION_MEASURES = (
    Measure("divergence", "D_KL(P‖Q)\nnats", "divergence"),
    Measure("jensen_shannon", "D_JS(P‖Q)\nnats", "jensen_shannon"),
)

_BY_KEY = {measure.key: measure for measure in (*MEASURES, *DISTRIBUTION_MEASURES)}


@dataclass(frozen=True)
class Row:
    """Figures of one guidance on one environment.

    Attributes:
        environment: Name of the problem or distribution.
        guidance: Label of the guidance.
        seeds: Number of runs behind the figures.
        figures: Key of each measure to its estimate and 95 % interval over seeds.
        unsolved: Runs that found no path.
        rank: Place on this environment, from 1: who solves provably less than the best comes after those who
            do not, and then counts the measure of `ranking_measure`.
        best: Keys of the measures in which none is known to be better.
        skipped: Seeds whose problems were left out, and why.
    """

    environment: str
    guidance: str
    seeds: int
    figures: Mapping[str, Interval]
    unsolved: int = 0
    rank: int = 1
    best: frozenset[str] = frozenset()
    skipped: Mapping[int, str] = field(default_factory=dict)

    def record(self) -> dict[str, Any]:
        """Flat and JSON-able; what cannot be estimated is None."""
        flat: dict[str, Any] = {
            "environment": self.environment,
            "guidance": self.guidance,
            "rank": self.rank,
            "seeds": self.seeds,
            "unsolved": self.unsolved,
            "skipped": len(self.skipped),
            "best": " ".join(key for key in self.figures if key in self.best),
        }
        for key, interval in self.figures.items():
            values = (interval.estimate, interval.low, interval.high)
            for suffix, value in zip(("", "_low", "_high"), values, strict=True):
                flat[key + suffix] = value if math.isfinite(value) else None
        return flat


def ranking_measure(protocol: str) -> str:
    """Key of the measure that ranks: total SE of whole searches, else the regret of what is compared."""
    return "total_efficiency" if protocol == "whole" else "excess_efficiency"


@door
def summarise(results: Results) -> list[Row]:
    """One row per (environment, guidance): by environment as in the results, then by rank."""
    shown = [*MEASURES, *(DISTRIBUTION_MEASURES if _has_distributions(results) else ())]
    rows = []
    for environment in results.environments():
        comparison = Comparison(results, environment)
        best = {measure.key: comparison.best(measure) for measure in shown if measure.better}
        order = comparison.ranked(_BY_KEY[ranking_measure(results.protocol)])
        for rank, guidance in enumerate(order, 1):
            runs = results.group(environment, guidance)
            rows.append(
                Row(
                    environment,
                    guidance,
                    len(runs),
                    {measure.key: _figure(results, environment, guidance, measure) for measure in shown},
                    sum(not run.solved for run in runs),
                    rank,
                    frozenset(key for key, names in best.items() if guidance in names),
                    results.skipped.get(environment, {}),
                )
            )
    return rows


def _figure(results: Results, environment: str, guidance: str, measure: Measure) -> Interval:
    values = results.values(environment, guidance, measure.column)
    if measure.key == "solved":
        return wilson(int(values.sum()), values.size)
    return bootstrap(values, measure.statistic)


class Comparison:
    """The guidances on one environment, seed by seed.

    A search that was not solved would have cost more, had it gone on. So that it never looks good, it counts
    as the worst run of the table in every measure that would have grown.

    Args:
        results: All runs.
        environment: The environment.
    """

    def __init__(self, results: Results, environment: str) -> None:
        self._results, self._environment = results, environment
        self.guidances = results.guidances(environment)
        groups = [results.group(environment, guidance) for guidance in self.guidances]
        common = set.intersection(*({run.seed for run in runs} for runs in groups))
        self._rows = {
            guidance: [i for i, run in enumerate(runs) if run.seed in common]
            for guidance, runs in zip(self.guidances, groups, strict=True)
        }
        self.pairs = len(common)
        solved = {guidance: self._values(guidance, "solved") for guidance in self.guidances}
        leader = max(self.guidances, key=lambda guidance: float(solved[guidance].mean()))
        self.reliable = [
            guidance
            for guidance in self.guidances
            if not self._real(paired_difference(solved[guidance], solved[leader]))
        ]

    def _values(self, guidance: str, column: Column) -> NDArray[np.float64]:
        return self._results.values(self._environment, guidance, column)[self._rows[guidance]]

    def _real(self, difference: Interval) -> bool:
        return self.pairs >= LEAST_PAIRS and difference.outside(0.0, 0.0)

    def scores(self, measure: Measure) -> dict[str, NDArray[np.float64]]:
        """Guidance to (seeds,) what is compared, the seeds being those that all of them have."""
        values = {guidance: self._values(guidance, measure.column) for guidance in self.guidances}
        if measure.censored:
            worst = max(float(own.max(initial=0.0)) for own in values.values())
            for guidance, own in values.items():
                own[self._values(guidance, "solved") == 0] = worst
        return values

    def ranked(self, measure: Measure) -> list[str]:
        """The guidances, best first: those that solve provably less than the best come last."""
        scores = self.scores(measure)
        return sorted(
            self.guidances, key=lambda guidance: (guidance not in self.reliable, _mean(scores[guidance]))
        )

    def best(self, measure: Measure) -> list[str]:
        """Those that none is known to beat, among the guidances that solve no less than the best."""
        scores = self.scores(measure)
        sign = -1.0 if measure.better == "high" else 1.0
        scored = [guidance for guidance in self.reliable if np.isfinite(scores[guidance]).any()]
        if not scored:
            return []
        leader = min(scored, key=lambda guidance: sign * _mean(scores[guidance]))
        return [
            guidance
            for guidance in scored
            if not self._real(paired_difference(scores[guidance], scores[leader]))
        ]

    def verdict(self, measure: Measure) -> str:
        """Who is best, and whether the next one's difference is real, in one line."""
        order, scores = self.ranked(measure), self.scores(measure)
        what = " ".join(measure.title.split("\n")[:1])
        if len(order) < 2:
            return ""
        first, second = order[:2]
        if second not in self.reliable:
            return f"Least {what}: {first}; {second}, the next, solves less."
        difference = paired_difference(scores[second], scores[first])
        if self.pairs < LEAST_PAIRS:
            return f"Least {what}: {first}; {self.pairs} seeds are too few to say whether that is chance."
        if self._real(difference):
            return f"Least {what}: {first}; {second}, the next, has more by {difference.text()}."
        apart = f"{second}'s differs by {difference.text()}, which may be chance"
        return f"Least {what}: {first}; {apart}."


def verdicts(results: Results) -> list[str]:
    """For each environment, who is best, and whether the difference is real."""
    measure = _BY_KEY[ranking_measure(results.protocol)]
    lines = [(name, Comparison(results, name).verdict(measure)) for name in results.environments()]
    return [f"{name}: {line}" for name, line in lines if line]


def _mean(values: NDArray[np.float64]) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else math.inf


def _has_distributions(results: Results) -> bool:
    return any(math.isfinite(run.divergence) for run in results.runs)


_PARTS = {
    "quality": "SE in nats, lower is better; 95 % intervals over seeds below. * none is known to be better "
    "(paired seeds, 95 %). ≥ some searches were not solved; in comparisons each counts as the worst.",
    "cost": "Looks: what the guidance itself checked for collision, or looked up in a raster.",
}


def rich_tables(rows: list[Row]) -> list[Table]:
    """Two tables per environment, for `rich.print`: how well, and at what cost; intervals under figures."""
    tables = []
    for environment in dict.fromkeys(row.environment for row in rows):
        chosen = [row for row in rows if row.environment == environment]
        tables += [_rich_table(chosen, part) for part in _PARTS]
    return tables


def _rich_table(rows: list[Row], part: str) -> Table:
    from rich import box
    from rich.table import Table

    title = _title(rows) if part == "quality" else f"{rows[0].environment}, what it cost"
    table = Table(
        title=title, title_justify="left", caption=_PARTS[part], caption_justify="left",
        box=box.SIMPLE_HEAD, pad_edge=False,
    )  # fmt: skip
    table.add_column("")
    table.add_column("guidance", overflow="fold")
    measures = [one for key, one in _BY_KEY.items() if one.part == part and key in rows[0].figures]
    for measure in measures:
        table.add_column(measure.title, justify="right")
    for row in rows:
        table.add_row(f"{row.rank}", row.guidance, *(_cell(row, measure) for measure in measures))
    return table


def _title(rows: list[Row]) -> str:
    seeds, skipped = max(row.seeds for row in rows), rows[0].skipped
    error = max(row.figures["oracle_error"].estimate for row in rows)
    title = f"{rows[0].environment}, {seeds} {'seed' if seeds == 1 else 'seeds'}, oracle error {error:.1%}"
    if skipped:
        first = next(iter(skipped))
        title += f" ({len(skipped)} skipped; the first, seed {first}: {skipped[first]})".replace("[", r"\[")
    return title


def _cell(row: Row, measure: Measure) -> str:
    interval = row.figures[measure.key]
    estimate, low, high = (
        significant(value * measure.scale) for value in (interval.estimate, interval.low, interval.high)
    )
    if measure.censored and row.unsolved:
        estimate = f"≥ {estimate}"
    if not math.isfinite(interval.estimate):
        return "–"
    if measure.key == "solved" and row.unsolved:
        estimate = f"[red]{estimate}[/red]"
    if measure.key in row.best:
        estimate = f"[bold]{estimate}*[/bold]"
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
        write_whole(path, content)
    return list(contents)
