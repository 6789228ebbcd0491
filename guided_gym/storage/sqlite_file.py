"""One SQLite file per store: opened, checked and written so that kills and rival writers do no harm.

WAL mode keeps every committed transaction when its process is killed, drops unfinished ones whole, and lets
several processes write in turn. Nothing in such a file is ever run as code.
"""

from __future__ import annotations

import contextlib
import sqlite3
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from guided_gym.errors import StorageError

BUSY_TIMEOUT = 30.0  # seconds that a writer waits for another one
MEMORY = ":memory:"

Mode = Literal["create", "write", "read"]
Fill = Callable[[sqlite3.Cursor], None]

_SQLITE_MAGIC = b"SQLite format 3\x00"
_URI_MODES: dict[Mode, str] = {"create": "rwc", "write": "rw", "read": "ro"}


@dataclass(frozen=True)
class FileFormat:
    """What distinguishes our files of one kind from all other files.

    Attributes:
        name: What messages call such a file.
        application_id: Number in the SQLite header that no other program uses.
        version: Version of the schema.
        schema: SQL statements that make the empty tables.
        remedy: What to do about a file of another version, for the message.
    """

    name: str
    application_id: int
    version: int
    schema: Sequence[str]
    remedy: str = ""


def connect(
    path: Path | None, kind: FileFormat, mode: Mode = "create", fill: Fill | None = None
) -> sqlite3.Connection:
    """Open the file at ``path``; None for a store in memory.

    Args:
        path: The file.
        kind: What it has to be.
        mode: ``"create"`` makes the file, whole or not at all, when there is none; ``"write"`` wants one that
            is there; ``"read"`` too, never writes to it, and works in folders that cannot be written.
        fill: Called with a cursor in the transaction that makes the tables, to put the first rows in.

    Raises:
        StorageError: The file is missing, foreign, damaged, of another version, or not accessible.
    """
    if path is not None:
        _check_place(path, kind, mode)
    with storage_errors(path, kind, "open"):
        connection = _open(path, mode)
        try:
            if mode == "create":
                _create_if_empty(connection, kind, fill)
            _check(connection, path, kind)
            if mode != "read":  # only now: another program's file stays as it was
                _use_wal(connection)
        except BaseException:
            connection.close()
            raise
    return connection


@contextlib.contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[sqlite3.Cursor]:
    """A transaction: all or nothing. It takes the write lock first, so that two writers can't deadlock."""
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
    except (sqlite3.Error, OSError, UnicodeDecodeError) as error:  # the last, from a damaged schema or text
        raise StorageError(
            f"cannot {action} the {kind.name} {path or MEMORY}: "
            f"expected a sound, accessible {kind.name}, got: {error}"
        ) from error


def _check_place(path: Path, kind: FileFormat, mode: Mode) -> None:
    if not path.parent.is_dir():
        raise StorageError(f"expected an existing folder for {path.name}, got {path.parent}")
    if not path.exists():
        if mode == "create":
            return
        raise StorageError(f"expected a {kind.name} at {path}, but there is no such file")
    if not path.is_file():
        raise StorageError(f"expected a {kind.name} at {path}, got something that is no file")
    try:
        with path.open("rb") as file:
            head = file.read(len(_SQLITE_MAGIC))
    except OSError as error:
        raise StorageError(f"cannot read {path}: {error}") from error
    # A file that is still empty is one in the making, by this call or by another process.
    if head != _SQLITE_MAGIC and (head or mode != "create"):
        what = "something else" if head else "an empty file"
        raise StorageError(f"expected a {kind.name} (an SQLite file) at {path}, got {what}")


def _open(path: Path | None, mode: Mode) -> sqlite3.Connection:
    if path is None:
        return sqlite3.connect(MEMORY, isolation_level=None)
    connection = _open_uri(path, _URI_MODES[mode])
    if mode != "read":
        return connection
    try:
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
    except sqlite3.OperationalError:
        connection.close()
        if Path(f"{path}-wal").exists():
            raise
        # A folder that cannot be written has no room for WAL's index file. No log, so nobody is writing.
        return _open_uri(path, "ro&immutable=1")
    return connection


def _open_uri(path: Path, mode: str) -> sqlite3.Connection:
    uri = f"{path.resolve().as_uri()}?mode={mode}"
    return sqlite3.connect(uri, uri=True, timeout=BUSY_TIMEOUT, isolation_level=None)


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


def _create_if_empty(connection: sqlite3.Connection, kind: FileFormat, fill: Fill | None) -> None:
    if connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
        return
    with transaction(connection) as cursor:
        if cursor.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            return  # another process was faster
        for statement in kind.schema:
            cursor.execute(statement)
        cursor.execute(f"PRAGMA application_id = {kind.application_id}")
        cursor.execute(f"PRAGMA user_version = {kind.version}")
        if fill is not None:
            fill(cursor)


def _check(connection: sqlite3.Connection, path: Path | None, kind: FileFormat) -> None:
    application = connection.execute("PRAGMA application_id").fetchone()[0]
    version = connection.execute("PRAGMA user_version").fetchone()[0]
    if application != kind.application_id:
        raise StorageError(
            f"expected a {kind.name} at {path} (application id {kind.application_id:#x}), "
            f"got another program's SQLite file (application id {application:#x})"
        )
    if version != kind.version:
        remedy = f"; {kind.remedy}" if kind.remedy else ""
        raise StorageError(
            f"expected a {kind.name} of version {kind.version} at {path}, got version {version}{remedy}"
        )
    require_sound(connection, path, kind, "quick_check")


def require_sound(connection: sqlite3.Connection, path: Path | None, kind: FileFormat, check: str) -> None:
    """Have SQLite check the file with its ``quick_check`` or ``integrity_check``.

    Raises:
        StorageError: It finds damage; the first that it finds is said.
    """
    found = str(connection.execute(f"PRAGMA {check}(1)").fetchone()[0])
    if found != "ok":
        raise StorageError(f"{path} is damaged: expected a sound {kind.name}, got: {' '.join(found.split())}")
