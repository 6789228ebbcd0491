"""One SQLite file per store: opened, checked and written so that kills and rival writers do no harm.

WAL mode keeps every committed transaction when its process is killed, drops unfinished ones whole, and lets
several processes write in turn. Nothing in such a file is ever run as code.
"""

from __future__ import annotations

import contextlib
import sqlite3
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from guided_gym.errors import StorageError

BUSY_TIMEOUT = 30.0  # seconds that a writer waits for another one
MEMORY = ":memory:"

_SQLITE_MAGIC = b"SQLite format 3\x00"


@dataclass(frozen=True)
class FileFormat:
    """What tells our files of one kind from every other file.

    Attributes:
        name: What messages call such a file.
        application_id: Number in the SQLite header that no other program uses.
        version: Version of the schema.
        schema: SQL statements that make the empty tables.
    """

    name: str
    application_id: int
    version: int
    schema: Sequence[str]


def connect(path: Path | None, kind: FileFormat) -> sqlite3.Connection:
    """Open the file at ``path``, making it when there is none; None for a store in memory.

    Raises:
        StorageError: The file is foreign, damaged, of another version, or cannot be opened or written.
    """
    if path is not None:
        _check_place(path, kind)
    where = MEMORY if path is None else str(path)
    with storage_errors(path, kind, "open"):
        connection = sqlite3.connect(where, timeout=BUSY_TIMEOUT, isolation_level=None)
        try:
            _use_wal(connection)
            _create_if_empty(connection, kind)
            _check(connection, path, kind)
        except BaseException:
            connection.close()
            raise
    return connection


@contextlib.contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[sqlite3.Cursor]:
    """All of what happens inside, or none. Takes the write lock first, so that two writers can't deadlock."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield connection.cursor()
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:
            connection.execute("ROLLBACK")
        raise


@contextlib.contextmanager
def storage_errors(path: Path | None, kind: FileFormat, action: str) -> Iterator[None]:
    """Turn SQLite's and the system's errors into a `StorageError` that names the file."""
    try:
        yield
    except (sqlite3.Error, OSError) as error:
        raise StorageError(
            f"cannot {action} the {kind.name} {path or MEMORY}: "
            f"expected a sound, accessible {kind.name}, got: {error}"
        ) from error


def _check_place(path: Path, kind: FileFormat) -> None:
    if not path.parent.is_dir():
        raise StorageError(f"expected an existing folder for {path.name}, got {path.parent}")
    if not path.exists():
        return
    if not path.is_file():
        raise StorageError(f"expected a {kind.name} at {path}, got something that is no file")
    try:
        with path.open("rb") as file:
            head = file.read(len(_SQLITE_MAGIC))
    except OSError as error:
        raise StorageError(f"cannot read {path}: {error}") from error
    if head not in (b"", _SQLITE_MAGIC):
        raise StorageError(f"expected a {kind.name} (an SQLite file) at {path}, got one that begins {head!r}")


def _use_wal(connection: sqlite3.Connection) -> None:
    """Switch to WAL; SQLite does not wait by itself when another process is just doing the same."""
    deadline = time.monotonic() + BUSY_TIMEOUT
    while True:
        try:
            connection.execute("PRAGMA journal_mode = WAL").fetchone()
            break
        except sqlite3.OperationalError as error:
            if "locked" not in str(error) or time.monotonic() > deadline:
                raise
            time.sleep(0.01)
    connection.execute("PRAGMA synchronous = NORMAL")


def _create_if_empty(connection: sqlite3.Connection, kind: FileFormat) -> None:
    if connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
        return
    with transaction(connection) as cursor:
        if cursor.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            return  # another process was faster
        for statement in kind.schema:
            cursor.execute(statement)
        cursor.execute(f"PRAGMA application_id = {kind.application_id}")
        cursor.execute(f"PRAGMA user_version = {kind.version}")


def _check(connection: sqlite3.Connection, path: Path | None, kind: FileFormat) -> None:
    application = connection.execute("PRAGMA application_id").fetchone()[0]
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if application != kind.application_id:
        raise StorageError(
            f"expected a {kind.name} at {path} (application id {kind.application_id:#x}), "
            f"got another program's SQLite file (application id {application:#x})"
        )
    if version != kind.version:
        raise StorageError(f"expected a {kind.name} of version {kind.version} at {path}, got {version}")
    report = [text for (text,) in connection.execute("PRAGMA quick_check")]
    if report != ["ok"]:
        raise StorageError(f"{path} is damaged: expected a sound {kind.name}, got: {report[:3]}")
