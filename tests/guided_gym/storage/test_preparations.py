"""What is prepared is kept on disk where that was asked for, and never believed when it is damaged."""

from __future__ import annotations

import os
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest

from guided_gym.storage.cache_folder import CacheFolder
from guided_gym.storage.preparations import (
    Arrays,
    PreparationStore,
    fits,
    keeping,
    prepared,
    within,
)


class Counted:
    """Makes arrays, and counts how often."""

    def __init__(self) -> None:
        self.times = 0

    def __call__(self) -> dict[str, np.ndarray]:
        self.times += 1
        return {"points": np.arange(6.0).reshape(3, 2), "pairs": np.array([[0, 1], [1, 2]])}


def sound(kept: Arrays) -> bool:
    n = len(kept["points"])
    return (
        fits(kept["points"], np.float64, n, 2)
        and fits(kept["pairs"], np.int64, -1, 2)
        and within(kept["pairs"], n)
    )


@pytest.fixture
def store(tmp_path: Path) -> PreparationStore:
    return PreparationStore(tmp_path / "preparations")


def file_of(store: PreparationStore) -> Path:
    assert store.folder is not None
    (file,) = store.folder.iterdir()
    return file


def test_prepared__is_kept_only_where_that_was_asked_for(store: PreparationStore) -> None:
    made = Counted()
    prepared("test 1", "a", made, sound)
    assert made.times == 1 and not store.folder.exists()  # type: ignore[union-attr]
    for _ in range(2):
        with keeping(store):
            kept = prepared("test 1", "a", made, sound)
    assert made.times == 2
    expected = Counted()()
    for name, array in kept.items():
        np.testing.assert_array_equal(array, expected[name])
        assert array.dtype == expected[name].dtype and array.flags.carray  # or kernels would compile again
    with keeping(store):
        prepared("test 2", "a", made, sound)
        prepared("test 1", "b", made, sound)
    assert made.times == 4


@pytest.mark.parametrize("how", ["cut", "longer", "empty", "bit", "foreign", "pickle", "moved"])
def test_prepared__what_is_damaged_is_made_anew(how: str, store: PreparationStore) -> None:
    made = Counted()
    with keeping(store):
        prepared("test 1", "a", made, sound)
    file = file_of(store)
    content = bytearray(file.read_bytes())
    if how == "cut":
        content = content[:-9]
    elif how == "longer":
        content = content[:8] + b"x" + content[8:]
    elif how == "empty":
        content = bytearray()
    elif how == "bit":
        content[len(content) // 2] ^= 1
    elif how == "foreign":
        content = bytearray(os.urandom(len(content)))
    elif how == "pickle":
        content = bytearray(pickle.dumps(Counted()()))
    file.write_bytes(content)
    if how == "moved":  # whole, but of something else
        with keeping(store):
            prepared("test 1", "b", made, sound)
        (other,) = (one for one in file.parent.iterdir() if one != file)
        shutil.copy(other, file)
    before = made.times
    with keeping(store):
        prepared("test 1", "a", made, sound)
        assert made.times == before + 1
        prepared("test 1", "a", made, sound)
        assert made.times == before + 1


@pytest.mark.parametrize(
    "wrong",
    [
        {"points": np.zeros((3, 2)), "pairs": np.array([[0, 3]])},
        {"points": np.zeros((3, 2)), "pairs": np.array([[-1, 2]])},
        {"points": np.zeros((3, 2), np.float32), "pairs": np.array([[0, 1]])},
        {"points": np.zeros((3, 3)), "pairs": np.array([[0, 1]])},
        {"points": np.zeros((3, 2)), "pairs": np.zeros((2, 2), np.int32)},
        {"points": np.zeros((3, 2))},
        {},
    ],
)
def test_prepared__arrays_that_fit_nothing_are_not_used(
    wrong: dict[str, np.ndarray], store: PreparationStore
) -> None:
    made = Counted()
    with keeping(store):
        prepared("test 1", "a", made, sound)
        key = file_of(store).stem
        store.save(key, wrong)  # whole, with a right checksum
        prepared("test 1", "a", made, sound)
    assert made.times == 2


def test_store__is_bounded_and_lets_the_oldest_go(tmp_path: Path) -> None:
    store = PreparationStore(tmp_path, max_bytes=50_000)
    for k in range(12):
        store.save(f"{k:064x}", {"x": np.zeros(1000)})
        for age, file in enumerate(sorted(tmp_path.iterdir())):
            os.utime(file, (1e9 + age, 1e9 + age))
    assert sum(file.stat().st_size for file in tmp_path.iterdir()) <= 50_000
    assert store.load(f"{11:064x}") is not None and store.load(f"{0:064x}") is None


def test_store__reads_no_more_than_it_may_hold(tmp_path: Path) -> None:
    store = PreparationStore(tmp_path, max_bytes=10_000)
    with (tmp_path / ("a" * 64 + ".prepared")).open("wb") as file:
        file.truncate(2**40)  # a terabyte that takes no room
    assert store.load("a" * 64) is None


def test_stores__share_a_root(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("GUIDED_GYM_CACHE", str(tmp_path))
    assert PreparationStore.default().folder == tmp_path / "preparations"
    monkeypatch.setenv("GUIDED_GYM_CACHE", "off")
    assert PreparationStore.default().folder is None
    made = Counted()
    with keeping():
        prepared("test 1", "a", made, sound)
        prepared("test 1", "a", made, sound)
    assert made.times == 2
    assert issubclass(PreparationStore, CacheFolder)
