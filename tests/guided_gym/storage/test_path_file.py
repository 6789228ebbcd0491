"""The store: what comes back, and what survives kills, rivals, full disks and damage."""

from __future__ import annotations

import math
import os
import sqlite3
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.storage.path_file import DatabaseHeader, PathDatabase

WEIGHTS = [1.0, 1.0, 0.5]
PERIODS = [0.0, 0.0, 2 * math.pi]
MAKE = {"name": "demo", "robot": "rectangle", "weights": WEIGHTS, "periods": PERIODS}


def path_of(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-3.0, 3.0, (2 + seed % 7, 3))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "paths with 100% of #odd? characters.db"


def test_roundtrip__in_seed_order_and_to_the_bit(file: Path) -> None:
    with PathDatabase.create(file, **MAKE) as database:
        for seed in (5, 2, 9):
            assert database.append(seed, path_of(seed))
        assert not database.append(5, path_of(6))  # the first one stays
        assert len(database) == 3
    with PathDatabase.open(file) as database:
        assert database.header == DatabaseHeader.of(**MAKE)
        assert database.seeds() == [2, 5, 9]
        assert [p.tolist() for p in database.paths()] == [path_of(s).tolist() for s in (2, 5, 9)]
        assert [p.tolist() for p in database.paths(2)] == [path_of(s).tolist() for s in (2, 5)]
        library = database.load()
        assert library.seeds.tolist() == [2, 5, 9]
        assert library.weights.tolist() == WEIGHTS
        assert library.periods.tolist() == PERIODS
        database.verify()
    assert not Path(f"{file}-wal").exists()  # one file once everybody has closed it


def test_missing_seeds__count_solvable_problems_only(file: Path) -> None:
    with PathDatabase.create(file, **MAKE) as database:
        assert database.missing_seeds(3) == [0, 1, 2]
        database.append_many([(0, path_of(0)), (4, path_of(4))])
        database.record_unsolved([1])
        assert database.missing_seeds(3) == [2, 3]
        assert database.missing_seeds(4) == [2, 3]  # 0, 2, 3, 4
        assert database.missing_seeds(0) == []
        assert database.unsolved_seeds() == [1]
        database.append(1, path_of(1))
        assert database.unsolved_seeds() == []
        database.record_unsolved([1])
        assert database.unsolved_seeds() == []


def test_empty_database(file: Path) -> None:
    with PathDatabase.create(file, **MAKE) as database:
        assert len(database) == 0
        assert database.paths() == []
        assert len(database.load()) == 0


@pytest.mark.parametrize(
    ("seed", "path", "message"),
    [
        (0, [[0, 0]], "dimension 3, got shape"),
        (0, np.empty((0, 3)), "got shape"),
        (0, [[0, 0, math.inf]], "finite"),
        (-1, [[0, 0, 0]], "seed"),
        (2**63, [[0, 0, 0]], "seed"),
        (1.5, [[0, 0, 0]], "seed"),
    ],
)
def test_append__refuses_bad_input_and_stores_nothing(
    file: Path, seed: int, path: list, message: str
) -> None:
    with PathDatabase.create(file, **MAKE) as database:
        with pytest.raises(InvalidInputError, match=message):
            database.append_many([(7, path_of(7)), (seed, path)])
        assert len(database) == 0


def test_create__refuses_an_existing_file_unless_told(file: Path) -> None:
    PathDatabase.create(file, **MAKE).close()
    with pytest.raises(StorageError, match="there is one"):
        PathDatabase.create(file, **MAKE)
    PathDatabase.create(file, **MAKE, exist_ok=True).close()
    for field, value in (("robot", "disc"), ("weights", [1.0, 1.0, 2.0]), ("periods", [0.0, 0.0, 0.0])):
        with pytest.raises(InvalidInputError, match=f"another {field}"):
            PathDatabase.create(file, **{**MAKE, field: value}, exist_ok=True)


def test_header_require__names_what_differs(file: Path) -> None:
    header = DatabaseHeader.of("demo", "rectangle", [1.0, 1.0], [0.0, 0.0])
    with PathDatabase.create(file, **MAKE) as database, pytest.raises(InvalidInputError, match="dimension"):
        database.header.require(header, str(file))


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04" + bytes(500), b"SQLite format 3\x00junk"])
def test_open__refuses_files_that_are_no_database(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    with pytest.raises(StorageError, match="expected"):
        PathDatabase.open(file)
    assert file.read_bytes() == content


def test_open__refuses_another_programs_database_and_leaves_it_alone(file: Path) -> None:
    with sqlite3.connect(file) as other:
        other.execute("CREATE TABLE paths (x)")
    other.close()
    content = file.read_bytes()
    for attempt in (PathDatabase.open, lambda f: PathDatabase.create(f, **MAKE, exist_ok=True)):
        with pytest.raises(StorageError, match="another program's"):
            attempt(file)
    assert file.read_bytes() == content


def test_open__refuses_newer_formats_and_broken_headers(file: Path) -> None:
    PathDatabase.create(file, **MAKE).close()
    _execute(file, "UPDATE meta SET value = '[1.0' WHERE key = 'weights'")
    with pytest.raises(StorageError, match="damaged"):
        PathDatabase.open(file)
    _execute(file, "PRAGMA user_version = 99")
    with pytest.raises(StorageError, match=r"version 1 .*, got version 99"):
        PathDatabase.open(file)


def test_open__says_what_is_missing(file: Path, tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="no such file"):
        PathDatabase.open(file)
    assert not file.exists()
    with pytest.raises(StorageError, match="existing folder"):
        PathDatabase.create(tmp_path / "nowhere" / "x.db", **MAKE)
    with pytest.raises(StorageError, match="no file"):
        PathDatabase.create(tmp_path, **MAKE)


def test_damage__is_found_and_never_returned(file: Path) -> None:
    with PathDatabase.create(file, **MAKE) as database:
        database.append_many((seed, path_of(seed)) for seed in range(300))
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(StorageError, match="path database"), PathDatabase.open(file) as database:
        database.load()
    blob = path_of(123).tobytes()
    at = whole.index(blob) + len(blob) // 2
    file.write_bytes(whole[:at] + bytes([whole[at] ^ 1]) + whole[at + 1 :])
    with PathDatabase.open(file) as database:
        for read in (database.load, database.verify):
            with pytest.raises(StorageError, match="seed 123"):
                read()


def test_full_disk__stores_all_or_nothing(file: Path) -> None:
    with PathDatabase.create(file, **MAKE) as database:
        database.append(0, path_of(0))
        database._connection.execute("PRAGMA max_page_count = 12")
        with pytest.raises(StorageError, match="full"):
            database.append_many((seed, np.zeros((50, 3))) for seed in range(1, 200))
        assert database.seeds() == [0]
        database._connection.execute("PRAGMA max_page_count = 100000")
        assert database.append(1, path_of(1))
        database.verify()


def test_readonly__reads_but_does_not_write(file: Path) -> None:
    with PathDatabase.create(file, **MAKE) as database:
        database.append(3, path_of(3))
        with PathDatabase.open(file, readonly=True) as reader:  # while a writer is at work
            assert reader.seeds() == [3]
    with PathDatabase.open(file, readonly=True) as reader:
        assert reader.seeds() == [3]
        with pytest.raises(StorageError, match="readonly"):
            reader.append(4, path_of(4))


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_readonly__works_in_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    folder = tmp_path / "fixed"
    folder.mkdir()
    with PathDatabase.create(folder / "x.db", **MAKE) as database:
        database.append(3, path_of(3))
    (folder / "x.db").chmod(0o444)
    folder.chmod(0o555)
    try:
        with PathDatabase.open(folder / "x.db", readonly=True) as reader:
            assert reader.seeds() == [3]
    finally:
        folder.chmod(0o755)


WRITER = """
    import sys
    import numpy as np
    from guided_gym.storage.path_file import PathDatabase

    def path_of(seed):
        return np.random.default_rng(seed).uniform(-3.0, 3.0, (2 + seed % 7, 3))

    first, step, count = map(int, sys.argv[2:])
    with PathDatabase.open(sys.argv[1]) as database:
        for seed in range(first, first + step * count, step):
            database.append_many([(seed, path_of(seed))])
            print(seed, flush=True)
"""


def start_writer(file: Path, first: int, step: int, count: int) -> subprocess.Popen[str]:
    arguments = [sys.executable, "-c", textwrap.dedent(WRITER), file, first, step, count]
    return subprocess.Popen(list(map(str, arguments)), stdout=subprocess.PIPE, text=True)


def test_kill__loses_nothing_that_was_reported_stored(file: Path) -> None:
    PathDatabase.create(file, **MAKE).close()
    for first in (0, 100_000, 200_000):
        with start_writer(file, first, 1, 100_000) as writer:
            reported = [int(writer.stdout.readline()) for _ in range(40)]
            writer.kill()
            reported += [int(line) for line in writer.stdout.read().splitlines(keepends=True) if "\n" in line]
        with PathDatabase.open(file) as database:
            database.verify()
            assert set(reported) <= set(database.seeds())
            library = database.load()
            for index, seed in enumerate(library.seeds.tolist()):
                assert np.array_equal(library.path(index), path_of(seed))


def test_rivals__two_processes_append_at_once(file: Path) -> None:
    PathDatabase.create(file, **MAKE).close()
    writers = [start_writer(file, 0, 1, 300), start_writer(file, 0, 2, 300)]  # they share even seeds
    for writer in writers:
        writer.communicate(timeout=60)
        assert writer.returncode == 0
    with PathDatabase.open(file) as database:
        database.verify()
        assert database.seeds() == [*range(300), *range(300, 600, 2)]


def test_rivals__creating_at_once_makes_one_database(file: Path) -> None:
    code = """
        import sys
        from guided_gym.storage.path_file import PathDatabase
        make = dict(name="demo", robot="rectangle", weights=[1.0, 1.0], periods=[0.0, 0.0])
        for index in range(20):
            with PathDatabase.create(f"{sys.argv[1]}{index}", **make, exist_ok=True) as database:
                database.append(int(sys.argv[2]), [[0.0, 0.0]])
    """
    arguments = [sys.executable, "-c", textwrap.dedent(code), str(file)]
    rivals = [subprocess.Popen([*arguments, str(seed)]) for seed in range(3)]
    assert [rival.wait(timeout=60) for rival in rivals] == [0, 0, 0]
    for index in range(20):
        with PathDatabase.open(f"{file}{index}") as database:
            assert database.seeds() == [0, 1, 2]


def _execute(file: Path, statement: str) -> None:
    connection = sqlite3.connect(file)
    connection.execute(statement)
    connection.commit()
    connection.close()
