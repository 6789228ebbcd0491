"""A store of solved paths: one SQLite file in WAL mode.

The file is safe when its writer is killed, and when several processes append at once. It holds numbers and
text only, so loading one never runs code. `guided_gym.storage.path_build` fills it from worker processes.
"""

from __future__ import annotations

import importlib.metadata
import json
import sqlite3
import sys
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from guided_gym.checks import shown
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.storage.path_library import FloatArray, PathLibrary, checked_path, path_length
from guided_gym.storage.sqlite_file import FileFormat, connect, require_sound, storage_errors, transaction
from guided_gym.structures.nearest import checked_metric

if TYPE_CHECKING:
    from guided_gym.geometry.space import ConfigurationSpace

FORMAT = FileFormat(
    name="guided-gym path database",
    application_id=0x47475044,  # "GGPD"
    version=1,
    schema=(
        "CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL)",  # values are JSON
        # Blobs are little-endian float64: start (d,), goal (d,), waypoints (n, d); checksum is their CRC-32.
        """CREATE TABLE paths (
            id INTEGER PRIMARY KEY,
            seed INTEGER NOT NULL UNIQUE,
            start BLOB NOT NULL,
            goal BLOB NOT NULL,
            waypoints BLOB NOT NULL,
            length REAL NOT NULL,
            checksum INTEGER NOT NULL,
            created_by TEXT NOT NULL
        )""",
        # Problems that were tried in vain, so that a build does not try them for ever.
        "CREATE TABLE unsolved (seed INTEGER PRIMARY KEY, created_by TEXT NOT NULL)",
    ),
)

_MAX_SEED = 2**63 - 1


@dataclass(frozen=True)
class DatabaseHeader:
    """What the paths of a database are for: only spaces that agree with it can use them."""

    name: str  # the problem distribution
    robot: str  # fingerprint of the robot
    weights: tuple[float, ...]  # (d,) length per unit of each coordinate
    periods: tuple[float, ...]  # (d,) period of each coordinate, 0 where it is not periodic

    @classmethod
    def of(cls, name: str, robot: str, weights: ArrayLike, periods: ArrayLike) -> DatabaseHeader:
        """Make a header from arrays.

        Raises:
            InvalidInputError: weights and periods differ in shape, or are not finite and > 0 (>= 0).
        """
        checked_weights, checked_periods = checked_metric(weights, periods)
        return cls(str(name), str(robot), tuple(checked_weights.tolist()), tuple(checked_periods.tolist()))

    @classmethod
    def for_space(cls, name: str, space: ConfigurationSpace) -> DatabaseHeader:
        """Make the header of paths through `space`, or through others with the same robot and metric.

        The robot's fingerprint is its description as text: readable, and the same in every process.
        """
        return cls.of(name, space.robot.description, space.weights, space.periods)

    @property
    def dimension(self) -> int:
        """Dimension d of the configurations."""
        return len(self.weights)

    def require(self, other: DatabaseHeader, where: str) -> None:
        """Check that `other` (what was asked for) means the same configurations as this header.

        The name is not compared: paths of one distribution may guide searches in another.

        Raises:
            InvalidInputError: the dimension, the robot, the weights or the periods differ.
        """
        for field in ("dimension", "robot", "weights", "periods"):
            here, wanted = getattr(self, field), getattr(other, field)
            if here != wanted:
                raise InvalidInputError(
                    f"{where} holds paths of another {field}: expected {wanted!r}, got {shown(here)}"
                )


@doors
class PathDatabase:
    """Solved paths in one file; use it as a context manager, or call `close`.

    Make one with `PathDatabase.create` or `PathDatabase.open`. One object serves one thread of one process;
    any number of processes may open the file at once.
    """

    def __init__(self, path: Path, connection: sqlite3.Connection) -> None:
        """Take over a connection, see `create` and `open`."""
        self.path = path
        self._connection = connection
        try:
            self.header = _read_header(path, self._rows("SELECT key, value FROM meta"))
        except BaseException:
            self.close()
            raise

    @classmethod
    def create(
        cls,
        path: str | Path,
        *,
        name: str,
        robot: str,
        weights: ArrayLike,
        periods: ArrayLike,
        exist_ok: bool = False,
    ) -> PathDatabase:
        """Create an empty database, whole or not at all.

        Args:
            path: the file; its folder must exist.
            name: name of the problem distribution.
            robot: fingerprint of the robot.
            weights: (d,) length per unit of each coordinate.
            periods: (d,) period of each coordinate, 0 where it is not periodic.
            exist_ok: open a database that is there already, if it was made for the same robot and metric.

        Raises:
            StorageError: the file exists (unless exist_ok), is foreign, or cannot be written.
            InvalidInputError: weights or periods are not usable, or an existing database disagrees.
        """
        header = DatabaseHeader.of(name, robot, weights, periods)
        made = False

        def fill(cursor: sqlite3.Cursor) -> None:
            nonlocal made
            made = True
            _write_header(cursor, header)

        database = cls(Path(path), connect(Path(path), FORMAT, "create", fill))
        try:
            if not made and not exist_ok:
                raise StorageError(
                    f"expected no file at {path}, to create a path database there, but there is one"
                )
            database.header.require(header, str(path))
        except BaseException:
            database.close()
            raise
        return database

    @classmethod
    def create_or_open(cls, path: str | Path, header: DatabaseHeader) -> PathDatabase:
        """Open the database at `path`, after creating it if need be; see `create` for the errors."""
        return cls.create(
            path,
            name=header.name,
            robot=header.robot,
            weights=header.weights,
            periods=header.periods,
            exist_ok=True,
        )

    @classmethod
    def open(cls, path: str | Path, readonly: bool = False) -> PathDatabase:
        """Open an existing database.

        Args:
            path: the file.
            readonly: never write to it; works in folders that cannot be written, too.

        Raises:
            StorageError: there is no such file, it is no path database, of a newer format, or damaged.
        """
        path = Path(path)
        return cls(path, connect(path, FORMAT, "read" if readonly else "write"))

    def close(self) -> None:
        """Close the file; the last process to do so folds the write-ahead log into it."""
        self._connection.close()

    def __enter__(self) -> PathDatabase:
        """Return the database itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self.close()

    def __len__(self) -> int:
        """Return the number of stored paths."""
        return int(self._rows("SELECT count(*) FROM paths")[0][0])

    @property
    def dimension(self) -> int:
        """Dimension d of the configurations."""
        return self.header.dimension

    def append(self, seed: int, path: ArrayLike) -> bool:
        """Store the (n, d) path that solves problem `seed`; do nothing when that seed has one already.

        Returns:
            Whether the path was stored.

        Raises:
            InvalidInputError: the seed is no integer in [0, 2**63), or the path is empty, not finite or of
                another dimension.
            StorageError: the file cannot be written (disk full, read-only, ...); nothing was stored.
        """
        return self.append_many([(seed, path)]) == 1

    def append_many(self, items: Iterable[tuple[int, ArrayLike]]) -> int:
        """Store (seed, path) pairs in one transaction, all of them or, on an error, none.

        Returns:
            How many were stored; seeds that have a path already are passed over.

        Raises:
            InvalidInputError: as for `append`.
            StorageError: as for `append`.
        """
        return self.record(items, ())

    def record_unsolved(self, seeds: Iterable[int]) -> None:
        """Note problems that were tried in vain, so that `missing_seeds` passes over them.

        Raises:
            InvalidInputError: a seed is no integer in [0, 2**63).
            StorageError: the file cannot be written; nothing was noted.
        """
        self.record((), seeds)

    def record(self, solved: Iterable[tuple[int, ArrayLike]], unsolved: Iterable[int]) -> int:
        """Do `append_many(solved)` and `record_unsolved(unsolved)` in one transaction."""
        rows = [self._row(seed, path) for seed, path in solved]
        failures = [_checked_seed(seed) for seed in unsolved]
        maker = _creator()
        with storage_errors(self.path, FORMAT, "write"), transaction(self._connection) as cursor:
            before = self._connection.total_changes
            cursor.executemany(
                "INSERT INTO paths (seed, start, goal, waypoints, length, checksum, created_by) "
                "VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT (seed) DO NOTHING",
                [(*row, maker) for row in rows],
            )
            stored = self._connection.total_changes - before
            cursor.executemany("DELETE FROM unsolved WHERE seed = ?", [(row[0],) for row in rows])
            cursor.executemany(
                "INSERT OR IGNORE INTO unsolved (seed, created_by) "
                "SELECT ?1, ?2 WHERE NOT EXISTS (SELECT 1 FROM paths WHERE seed = ?1)",
                [(seed, maker) for seed in failures],
            )
        return stored

    def seeds(self) -> list[int]:
        """Return the seeds that have a path, ascending."""
        return [seed for (seed,) in self._rows("SELECT seed FROM paths ORDER BY seed")]

    def unsolved_seeds(self) -> list[int]:
        """Return the seeds that were tried in vain, ascending."""
        return [seed for (seed,) in self._rows("SELECT seed FROM unsolved ORDER BY seed")]

    def missing_seeds(self, n: int) -> list[int]:
        """Return the seeds to try next, ascending, so that the first `n` solvable problems get their paths.

        Empty when they all have. The answer assumes that every untried problem is solvable: try those that it
        names, store what came of them, and ask again.

        Raises:
            InvalidInputError: n is negative.
        """
        if n < 0:
            raise InvalidInputError(f"expected a number of paths >= 0, got {n}")
        solved, unsolved = set(self.seeds()), set(self.unsolved_seeds())
        missing: list[int] = []
        seed = counted = 0
        while counted < n:
            if seed in solved:
                counted += 1
            elif seed not in unsolved:
                missing.append(seed)
                counted += 1
            seed += 1
        return missing

    def paths(self, limit: int | None = None) -> list[FloatArray]:
        """Return the (n, d) waypoint arrays of the first `limit` paths (all when None), in seed order.

        Raises:
            InvalidInputError: limit is negative.
            StorageError: a row is damaged.
        """
        library = self.load(limit)
        return [library.path(index) for index in range(len(library))]

    def load(self, limit: int | None = None) -> PathLibrary:
        """Return the first `limit` paths (all when None), in seed order, as a `PathLibrary` in memory.

        Raises:
            InvalidInputError: limit is negative.
            StorageError: a row is damaged.
        """
        if limit is not None and limit < 0:
            raise InvalidInputError(f"expected a number of paths >= 0 or None, got {limit}")
        rows = self._rows(
            "SELECT seed, start, goal, waypoints, checksum FROM paths ORDER BY seed LIMIT ?",
            (-1 if limit is None else limit,),
        )
        for row in rows:
            self._check_row(*row)
        width = 8 * self.dimension
        offsets = np.zeros(len(rows) + 1, dtype=np.int64)
        np.cumsum([len(row[3]) // width for row in rows], out=offsets[1:])
        flat = np.frombuffer(b"".join(row[3] for row in rows), dtype="<f8").reshape(-1, self.dimension)
        seeds = np.array([row[0] for row in rows], dtype=np.int64)
        return PathLibrary.from_flat(
            flat.astype(np.float64), offsets, self.header.weights, self.header.periods, seeds
        )

    def verify(self) -> None:
        """Read the whole file and check it.

        Raises:
            StorageError: SQLite or a row's checksum finds damage.
        """
        with storage_errors(self.path, FORMAT, "read"):
            require_sound(self._connection, self.path, FORMAT, "integrity_check")
        self.load()

    def _rows(self, query: str, values: tuple[Any, ...] = ()) -> list[Any]:
        with storage_errors(self.path, FORMAT, "read"):
            return self._connection.execute(query, values).fetchall()

    def _row(self, seed: int, path: ArrayLike) -> tuple[int, bytes, bytes, bytes, float, int]:
        waypoints = checked_path(path, self.dimension)
        weights, periods = np.array(self.header.weights), np.array(self.header.periods)
        blob = waypoints.astype("<f8").tobytes()
        width = 8 * self.dimension
        length = path_length(waypoints, weights, periods)
        return _checked_seed(seed), blob[:width], blob[-width:], blob, length, zlib.crc32(blob)

    def _check_row(self, seed: object, start: object, goal: object, waypoints: object, crc: object) -> None:
        width = 8 * self.dimension
        sound = (
            isinstance(waypoints, bytes)
            and len(waypoints) >= width
            and len(waypoints) % width == 0
            and zlib.crc32(waypoints) == crc
            and waypoints[:width] == start
            and waypoints[-width:] == goal
        )
        if not sound:
            size = len(waypoints) if isinstance(waypoints, bytes) else 0
            raise StorageError(
                f"{self.path} is damaged: expected a whole path of dimension {self.dimension} for seed "
                f"{seed}, got {size} bytes that do not match its checksum, start or goal"
            )


def _write_header(cursor: sqlite3.Cursor, header: DatabaseHeader) -> None:
    meta = {
        "format": FORMAT.name,
        "version": FORMAT.version,
        "created_by": _creator(),
        "dimension": header.dimension,
        "name": header.name,
        "robot": header.robot,
        "weights": header.weights,
        "periods": header.periods,
    }
    cursor.executemany(
        "INSERT INTO meta VALUES (?, ?)", [(key, json.dumps(value)) for key, value in meta.items()]
    )


def _read_header(path: Path, rows: list[Any]) -> DatabaseHeader:
    try:
        meta = {key: json.loads(value) for key, value in rows}
        header = DatabaseHeader.of(meta["name"], meta["robot"], meta["weights"], meta["periods"])
        if meta["format"] != FORMAT.name or meta["dimension"] != header.dimension:
            raise ValueError(f"format {meta['format']!r}, dimension {meta['dimension']!r}")
    except (ValueError, TypeError, KeyError) as error:
        raise StorageError(
            f"{path} is damaged: expected the entries of a {FORMAT.name} in its table meta, got a "
            f"missing or wrong one: {error}"
        ) from error
    return header


def _checked_seed(seed: int) -> int:
    if not isinstance(seed, (int, np.integer)) or isinstance(seed, bool) or not 0 <= seed <= _MAX_SEED:
        raise InvalidInputError(f"expected a seed that is an integer in [0, 2**63), got {shown(seed)}")
    return int(seed)


def _creator() -> str:
    try:
        version = importlib.metadata.version("guided-gym")
    except importlib.metadata.PackageNotFoundError:
        version = "unknown"
    return f"guided-gym {version}, python {sys.version_info.major}.{sys.version_info.minor}"
