"""Results of searches: one row per (environment, guidance, seed, settings), in one file.

The file is SQLite in WAL mode rather than JSON lines. Both keep what was committed when the process is
killed; SQLite also leaves no torn last line, takes two writers at once, and refuses a duplicate row.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.measure.target import padded
from guided_gym.storage.sqlite_file import FileFormat, connect, storage_errors, transaction

RESULTS_VERSION = 3  # raise it when a column changes its meaning: older rows are computed anew
_FILE_VERSION = 4  # raise it when the columns change: older files are refused
RESULTS_FILE = "results.sqlite"

_FORMAT = FileFormat(
    name="guided-gym results file",
    application_id=0x47475253,  # "GGRS"
    version=_FILE_VERSION,
    schema=(
        # What a settings fingerprint stands for, for people.
        "CREATE TABLE settings (fingerprint TEXT PRIMARY KEY, content TEXT NOT NULL)",
        # Problems that could not be posed, or have no path.
        """CREATE TABLE skipped (
            environment TEXT NOT NULL,
            guidance TEXT NOT NULL,
            seed INTEGER NOT NULL,
            settings TEXT NOT NULL,
            reason TEXT NOT NULL,
            PRIMARY KEY (environment, guidance, seed, settings)
        ) WITHOUT ROWID""",
        # curve, best: little-endian float32, cells: uint16, of each sample. checksum: CRC-32 of the rest.
        """CREATE TABLE runs (
            environment TEXT NOT NULL,
            guidance TEXT NOT NULL,
            seed INTEGER NOT NULL,
            settings TEXT NOT NULL,
            problem TEXT NOT NULL,
            solved INTEGER NOT NULL,
            samples INTEGER NOT NULL,
            nodes INTEGER NOT NULL,
            total_efficiency REAL NOT NULL,
            best_possible REAL NOT NULL,
            collision_checks INTEGER NOT NULL,
            seconds REAL NOT NULL,
            preparation REAL NOT NULL,
            processor REAL NOT NULL,
            looks INTEGER NOT NULL,
            path_cost REAL,
            optimum REAL NOT NULL,
            oracle_error REAL NOT NULL,
            oracle_tail REAL NOT NULL,
            divergence REAL,
            jensen_shannon REAL,
            entropy REAL,
            regions TEXT NOT NULL,
            curve BLOB NOT NULL,
            best BLOB NOT NULL,
            cells BLOB NOT NULL,
            checksum INTEGER NOT NULL,
            PRIMARY KEY (environment, guidance, seed, settings)
        ) WITHOUT ROWID""",
    ),
    remedy="another version of guided-gym wrote it: keep it for that one, or choose another folder",
)

Skipped = tuple[str, str, int, str, str]
"""(environment, guidance, seed, settings, reason) of a problem that was left out."""

Key = tuple[str, str]
"""(environment, guidance) of a group of runs that differ in their seeds only."""

Column = Literal[
    "solved",
    "samples",
    "nodes",
    "total_efficiency",
    "efficiency_per_sample",
    "best_possible",
    "excess_efficiency",
    "collision_checks",
    "looks",
    "seconds",
    "preparation",
    "processor",
    "processor_per_sample",
    "path_cost",
    "path_ratio",
    "optimum",
    "oracle_error",
    "oracle_tail",
    "divergence",
    "jensen_shannon",
    "entropy",
]

GRID = 24  # cells of the workspace along its longer side, for SE by place


@doors
@dataclass(frozen=True)
class Run:
    """What one search gave.

    Attributes:
        environment: Name of the problem or distribution.
        guidance: Label of the guiding space and its options.
        seed: Seed of the search, and of the problem where it is drawn.
        settings: Fingerprint of everything else that the figures depend on.
        problem: Hash of the problem that the seed posed.
        solved: Whether a path was found.
        samples: Samples drawn; the limit where unsolved.
        nodes: Nodes of the tree at the end.
        total_efficiency: Sum of SE over the samples, nats; 0 per sample after the end. It is that of
            selections, or of expansions if the protocol says so.
        best_possible: Sum of -log max Q over the samples: the least that any choices on these trees could
            have.
        collision_checks: Motions checked.
        seconds: Wall time of the search, oracle and metric excluded.
        preparation: Wall time before it, for the guidance to build its roadmap or query its database.
        processor: Processor time of the search, oracle and metric excluded.
        looks: How often the guidance itself looked at the workspace during the search, or at a raster of it.
        path_cost: Length of the path found, NaN where unsolved.
        optimum: d_C(s, t) by the oracle.
        oracle_error: Estimated relative error of that oracle over free poses, on average.
        oracle_tail: Likewise at the 99th percentile.
        divergence: Mean over the samples of D_KL(P || Q) of the guidance's whole distribution, NaN if it was
            not asked for.
        jensen_shannon: Mean over the samples of D_JS(P || Q), likewise.
        entropy: Entropy of the samples over a grid of C, nats; NaN if there were none.
        regions: Region of the selected node to (sum of SE, samples).
        curve: (samples,) float32 SE of each sample.
        best: (samples,) float32 the least that each choice could have had.
        cells: (samples,) uint16 cell of the selected node on the workspace's grid, see `grid_shape`.
    """

    environment: str
    guidance: str
    seed: int
    settings: str
    problem: str
    solved: bool
    samples: int
    nodes: int
    total_efficiency: float
    best_possible: float
    collision_checks: int
    seconds: float
    preparation: float
    processor: float
    looks: int
    path_cost: float
    optimum: float
    oracle_error: float
    oracle_tail: float
    divergence: float
    jensen_shannon: float
    entropy: float
    regions: Mapping[str, tuple[float, int]]
    curve: NDArray[np.float32] = field(repr=False)
    best: NDArray[np.float32] = field(repr=False)
    cells: NDArray[np.uint16] = field(repr=False)

    @property
    def efficiency_per_sample(self) -> float:
        """Total SE over the samples drawn; 0 if the start saw the goal."""
        return self.total_efficiency / self.samples if self.samples else 0.0

    @property
    def excess_efficiency(self) -> float:
        """Total SE less the best possible: the regret of the choices, nats."""
        return max(self.total_efficiency - self.best_possible, 0.0)

    @property
    def processor_per_sample(self) -> float:
        """Processor time of a sample; NaN if none was drawn."""
        return self.processor / self.samples if self.samples else math.nan

    @property
    def path_ratio(self) -> float:
        """Length of the path found over the optimum, NaN where unsolved; 1 where both are 0."""
        if self.optimum == 0:
            return 1.0 if self.path_cost == 0 else math.nan
        return self.path_cost / self.optimum


def grid_shape(bounds: tuple[float, float, float, float]) -> tuple[int, int]:
    """(rows, columns) of the grid over a workspace that `Run.cells` counts on, row by row from below."""
    width, height = bounds[2] - bounds[0], bounds[3] - bounds[1]
    longer = max(width, height)
    return max(1, round(GRID * height / longer)), max(1, round(GRID * width / longer))


def grid_cells(
    positions: NDArray[np.float64], bounds: tuple[float, float, float, float]
) -> NDArray[np.uint16]:
    """(m,) cell of each position (m, 2) on the grid of `grid_shape`; positions outside count to the edge."""
    rows, columns = grid_shape(bounds)
    x = ((positions[:, 0] - bounds[0]) / (bounds[2] - bounds[0]) * columns).astype(np.int64)
    y = ((positions[:, 1] - bounds[1]) / (bounds[3] - bounds[1]) * rows).astype(np.int64)
    cells = np.clip(y, 0, rows - 1) * columns + np.clip(x, 0, columns - 1)
    return cells.astype(np.uint16)


@doors
@dataclass(frozen=True)
class Results:
    """The runs of an evaluation, complete unless it was interrupted.

    Attributes:
        runs: The runs, in the order of environments, guidances and seeds that was asked for.
        max_samples: Limit on the samples of each search.
        skipped: Environment to seed to why its problem was left out: it cannot be posed, or has no path.
        protocol: What SE is of, see `guided_gym.train.protocols`.
    """

    runs: tuple[Run, ...]
    max_samples: int
    skipped: Mapping[str, Mapping[int, str]] = field(default_factory=dict)
    protocol: str = "whole"

    def __len__(self) -> int:
        return len(self.runs)

    def _repr_html_(self) -> str:
        """The table, for notebooks."""
        from guided_gym.train.report import results_html

        return results_html(self)

    def pairs(self) -> list[Key]:
        """(environment, guidance) pairs, in order of appearance."""
        return list(dict.fromkeys((run.environment, run.guidance) for run in self.runs))

    def environments(self) -> list[str]:
        """Names of the environments, in order of appearance."""
        return list(dict.fromkeys(run.environment for run in self.runs))

    def guidances(self, environment: str) -> list[str]:
        """Labels of the guidances evaluated on an environment, in order of appearance."""
        return [guidance for name, guidance in self.pairs() if name == environment]

    def has(self, environment: str, guidance: str) -> bool:
        """Whether there is at least one run of the pair."""
        return (environment, guidance) in self.pairs()

    def group(self, environment: str, guidance: str) -> list[Run]:
        """The runs of one pair, by seed.

        Raises:
            InvalidInputError: There are no such runs.
        """
        runs = [run for run in self.runs if (run.environment, run.guidance) == (environment, guidance)]
        if not runs:
            raise InvalidInputError(f"no results of {guidance!r} on {environment!r}; got {self.pairs()}")
        return sorted(runs, key=lambda run: run.seed)

    def values(self, environment: str, guidance: str, column: Column) -> NDArray[np.float64]:
        """(seeds,) one column of one pair, by seed."""
        return np.array([getattr(run, column) for run in self.group(environment, guidance)], np.float64)

    def curves(self, environment: str, guidance: str) -> NDArray[np.float64]:
        """(seeds, max_samples) SE of each sample, 0 after the end of a search."""
        runs = self.group(environment, guidance)
        return np.stack([padded(run.curve.astype(np.float64), self.max_samples) for run in runs])

    def best_curves(self, environment: str, guidance: str) -> NDArray[np.float64]:
        """(seeds, max_samples) the least SE that each choice could have had, 0 after the end of a search."""
        runs = self.group(environment, guidance)
        return np.stack([padded(run.best.astype(np.float64), self.max_samples) for run in runs])

    def survivors(self, environment: str, guidance: str) -> NDArray[np.float64]:
        """(seeds, max_samples) SE of each sample, NaN after the end of a search."""
        curves = self.curves(environment, guidance)
        for row, run in zip(curves, self.group(environment, guidance), strict=True):
            row[run.samples :] = np.nan
        return curves

    def solved_after(self, environment: str, guidance: str) -> NDArray[np.bool_]:
        """(seeds, max_samples + 1) whether a search was solved after so many samples, from 0 on."""
        runs = self.group(environment, guidance)
        ends = np.array([run.samples if run.solved else self.max_samples + 1 for run in runs])
        return ends[:, None] <= np.arange(self.max_samples + 1)

    def by_cell(
        self, environment: str, guidance: str, shape: tuple[int, int]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Over the workspace's grid, row by row from below: mean total SE of a search, and of its excess."""
        runs, size = self.group(environment, guidance), shape[0] * shape[1]
        total, excess = np.zeros(size), np.zeros(size)
        for run in runs:
            total += np.bincount(run.cells, run.curve, size)
            excess += np.bincount(run.cells, run.curve - run.best, size)
        return total.reshape(shape) / len(runs), excess.reshape(shape) / len(runs)

    def by_region(self, environment: str, guidance: str) -> dict[str, NDArray[np.float64]]:
        """Region to (seeds,) sum of SE over the samples whose selected node lies there."""
        runs = self.group(environment, guidance)
        names = dict.fromkeys(name for run in runs for name in run.regions)
        return {
            name: np.array([run.regions.get(name, (0.0, 0))[0] for run in runs], np.float64) for name in names
        }


class ResultsFile:
    """The one results file of a folder; any number of processes may write to it at once.

    Args:
        path: The file, made when there is none; None keeps results in memory only.

    Raises:
        StorageError: The file is corrupt, foreign, of another version, or cannot be made. One that is there
            and can be read, but not written, says so when something is to be added.
    """

    def __init__(self, path: Path | None) -> None:
        self.path = path
        self._trouble: StorageError | None = None  # why it can be read only
        try:
            self._connection = connect(path, _FORMAT)
        except StorageError as error:
            if path is None or not path.is_file():
                raise
            try:
                self._connection = connect(path, _FORMAT, "read")
            except StorageError:
                raise error from None
            self._trouble = error

    @classmethod
    def in_folder(cls, folder: Path | None) -> ResultsFile:
        """The results file of an output folder, which is made when there is none; None for memory.

        Raises:
            StorageError: The folder can't be made, or as above.
        """
        if folder is None:
            return cls(None)
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"expected a folder for results at {folder}, got: {error}") from error
        return cls(folder / RESULTS_FILE)

    def close(self) -> None:
        """Close the file; the last process to do so folds the write-ahead log into it."""
        self._connection.close()

    def __enter__(self) -> ResultsFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def describe(self, fingerprint: str, content: Mapping[str, Any]) -> None:
        """Note what a settings fingerprint stands for, unless the file can only be read."""
        if self._trouble is not None:
            return
        row = (fingerprint, json.dumps(content, sort_keys=True))
        with storage_errors(self.path, _FORMAT, "write"), transaction(self._connection) as cursor:
            cursor.execute("INSERT OR IGNORE INTO settings VALUES (?, ?)", row)

    def add(self, runs: Iterable[Run]) -> None:
        """Store runs, all of them or, on an error, none; a run that is there already stays as it is.

        Raises:
            StorageError: The file cannot be written.
        """
        self.require_writing()
        rows = [_row(run) for run in runs]
        marks = ", ".join("?" * len(_COLUMNS))
        with storage_errors(self.path, _FORMAT, "write"), transaction(self._connection) as cursor:
            cursor.executemany(f"INSERT OR IGNORE INTO runs ({', '.join(_COLUMNS)}) VALUES ({marks})", rows)

    def skip(self, rows: Iterable[Skipped]) -> None:
        """Note problems that are left out, and why.

        Raises:
            StorageError: The file cannot be written.
        """
        self.require_writing()
        with storage_errors(self.path, _FORMAT, "write"), transaction(self._connection) as cursor:
            cursor.executemany("INSERT OR IGNORE INTO skipped VALUES (?, ?, ?, ?, ?)", list(rows))

    def skipped(self, environment: str, guidance: str, settings: str) -> dict[int, str]:
        """Seeds that were left out, and why."""
        query = "SELECT seed, reason FROM skipped WHERE environment = ? AND guidance = ? AND settings = ?"
        return dict(self._select(query, (environment, guidance, settings)))

    def seeds(self, environment: str, guidance: str, settings: str) -> set[int]:
        """Seeds that are there already, or were left out."""
        query = "SELECT seed FROM runs WHERE environment = ? AND guidance = ? AND settings = ?"
        there = {seed for (seed,) in self._select(query, (environment, guidance, settings))}
        return there | set(self.skipped(environment, guidance, settings))

    def problems(self, environment: str, guidance: str, settings: str) -> dict[int, str]:
        """Hash of the problem that each seed posed, of those that are there already."""
        query = "SELECT seed, problem FROM runs WHERE environment = ? AND guidance = ? AND settings = ?"
        return dict(self._select(query, (environment, guidance, settings)))

    def discard(self, environment: str, guidance: str, settings: str, seeds: Iterable[int]) -> None:
        """Drop the runs of some seeds.

        Raises:
            StorageError: The file cannot be written.
        """
        rows = [(environment, guidance, settings, seed) for seed in seeds]
        query = "DELETE FROM runs WHERE environment = ? AND guidance = ? AND settings = ? AND seed = ?"
        if rows:
            self.require_writing()
            with storage_errors(self.path, _FORMAT, "write"), transaction(self._connection) as cursor:
                cursor.executemany(query, rows)

    def runs(self, environment: str, guidance: str, settings: str, seeds: Sequence[int]) -> list[Run]:
        """The runs that are there, by seed.

        Raises:
            StorageError: A row is damaged.
        """
        query = (
            f"SELECT {', '.join(_COLUMNS)} FROM runs "
            "WHERE environment = ? AND guidance = ? AND settings = ? ORDER BY seed"
        )
        wanted = set(seeds)
        rows = self._select(query, (environment, guidance, settings))
        return [self._run(row) for row in rows if row[2] in wanted]

    def require_writing(self) -> None:
        """Refuse a file that can only be read.

        Raises:
            StorageError: It is one.
        """
        if self._trouble is not None:
            raise self._trouble

    def _select(self, query: str, values: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
        with storage_errors(self.path, _FORMAT, "read"):
            yield from self._connection.execute(query, values).fetchall()

    def _run(self, row: tuple[Any, ...]) -> Run:
        if _checksum(row[:-1]) != row[-1]:
            raise StorageError(
                f"{self.path} is damaged: the run of {row[1]} on {row[0]} with seed {row[2]} "
                "does not match its checksum; delete the file to compute it anew"
            )
        values = dict(zip(_COLUMNS[:-1], row[:-1], strict=True))
        values["solved"] = bool(values["solved"])
        values |= {name: math.nan for name in _MAY_BE_NAN if values[name] is None}
        values["regions"] = {
            name: (float(total), int(count)) for name, (total, count) in json.loads(values["regions"]).items()
        }
        for name, (stored, kind) in _ARRAYS.items():
            values[name] = np.frombuffer(values[name], stored).astype(kind)
        return Run(**values)


_COLUMNS = (
    "environment",
    "guidance",
    "seed",
    "settings",
    "problem",
    "solved",
    "samples",
    "nodes",
    "total_efficiency",
    "best_possible",
    "collision_checks",
    "seconds",
    "preparation",
    "processor",
    "looks",
    "path_cost",
    "optimum",
    "oracle_error",
    "oracle_tail",
    "divergence",
    "jensen_shannon",
    "entropy",
    "regions",
    "curve",
    "best",
    "cells",
    "checksum",
)
_MAY_BE_NAN = ("path_cost", "divergence", "jensen_shannon", "entropy")
_ARRAYS: Mapping[str, tuple[str, type[Any]]] = {
    "curve": ("<f4", np.float32),
    "best": ("<f4", np.float32),
    "cells": ("<u2", np.uint16),
}


def _row(run: Run) -> tuple[Any, ...]:
    values = {name: getattr(run, name) for name in _COLUMNS[:-1]}
    values["solved"] = int(run.solved)
    values |= {name: None for name in _MAY_BE_NAN if math.isnan(values[name])}  # SQLite has no NaN
    values["regions"] = json.dumps({name: list(pair) for name, pair in run.regions.items()})
    values |= {name: getattr(run, name).astype(stored).tobytes() for name, (stored, _) in _ARRAYS.items()}
    # SQLite gives -0.0 back as 0.0, which has another checksum.
    row = tuple(value + 0.0 if isinstance(value, float) else value for value in values.values())
    return (*row, _checksum(row))


def _checksum(row: Sequence[Any]) -> int:
    return zlib.crc32(repr(row).encode())
