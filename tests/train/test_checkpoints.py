"""Run folders: configurations, checkpoints, and what they refuse."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from guided_gym.errors import InvalidInputError, StorageError, UnknownNameError
from guided_gym.train.checkpoints import CHECKPOINT_FILE, RunFolder, build_config, read_config, to_toml


@dataclass(frozen=True)
class Options:
    names: tuple[str, ...] = ("a",)
    rate: float = 0.5
    count: int = 3
    word: str = "x"
    flag: bool = False


def test_a_configuration_comes_back_from_its_file(tmp_path: Path) -> None:
    options = Options(("a", 'b"c'), 1e-4, 7, "ü", True)
    (tmp_path / "c.toml").write_text(to_toml(options), encoding="utf-8")
    assert build_config(Options, read_config(tmp_path / "c.toml")) == options


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": "3"}, "count: expected int"),
        ({"count": True}, "count"),
        ({"word": 3}, "word: expected str"),
    ],
)
def test_values_of_another_type_are_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        build_config(Options, options)


def test_unknown_options_and_files_that_are_not_toml_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'count'"):
        build_config(Options, {"counts": 3})
    with pytest.raises(StorageError, match="configuration"):
        read_config(tmp_path / "none.toml")
    (tmp_path / "c.toml").write_text("= nothing")
    with pytest.raises(StorageError, match="TOML"):
        read_config(tmp_path / "c.toml")


def test_a_checkpoint_comes_back(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run", Options(), "test")
    assert folder.load() is None
    folder.save({"epoch": 3}, {"w": np.arange(4.0)})
    loaded = RunFolder(tmp_path / "run", Options(), "test").load()
    assert loaded is not None
    assert loaded[0] == {"epoch": 3}
    assert np.array_equal(loaded[1]["w"], np.arange(4.0))


def test_the_folder_of_another_run_is_refused_and_left_alone(tmp_path: Path) -> None:
    RunFolder(tmp_path, Options(), "test").save({}, {})
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    with pytest.raises(StorageError, match="count = 3; count = 4"):
        RunFolder(tmp_path, Options(count=4), "test")
    with pytest.raises(StorageError, match="another run's"):
        RunFolder(tmp_path, Options(), "other")
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_a_foreign_folder_or_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    for place in (tmp_path, tmp_path / "thesis.txt"):
        with pytest.raises(StorageError, match="expected an empty folder"):
            RunFolder(place, Options(), "test")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_a_damaged_checkpoint_is_refused(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path, Options(), "test")
    folder.save({"epoch": 3}, {"w": np.arange(4.0)})
    file = tmp_path / CHECKPOINT_FILE
    file.write_bytes(file.read_bytes()[:-3])
    with pytest.raises(StorageError, match="expected a whole safetensors file"):
        folder.load()


@pytest.mark.parametrize(
    "text",
    ["a = " + "[" * 100_000 + "]" * 100_000, "a = " + "9" * 5_000, ".".join("a" * 20_000) + " = 1", "a = ["],
    ids=["nested", "digits", "parts", "cut"],
)  # fmt: skip
def test_configurations_that_no_reader_takes_are_refused_at_once(tmp_path: Path, text: str) -> None:
    (tmp_path / "c.toml").write_text(text)
    began = time.perf_counter()
    with pytest.raises(StorageError, match=r"c\.toml.*: expected"):
        read_config(tmp_path / "c.toml")
    assert time.perf_counter() - began < 2


@pytest.mark.parametrize("name", [CHECKPOINT_FILE, "data/trees-000.safetensors"])
def test_no_flipped_bit_is_accepted(tmp_path: Path, name: str) -> None:
    folder = RunFolder(tmp_path, Options(), "test")
    state, tensors = {"steps": 3, "history": [0.5]}, {"a": np.arange(4.0), "b": np.arange(3, dtype=np.uint8)}
    folder.keep(name, state, tensors)
    file = tmp_path / name
    whole = file.read_bytes()
    for bit in range(8 * len(whole)):
        damaged = bytearray(whole)
        damaged[bit // 8] ^= 1 << bit % 8
        file.write_bytes(damaged)
        try:
            found = RunFolder.read(file)
        except StorageError:
            continue
        # What makes no difference to what is read: white space in the header, say.
        assert found[0] == state
        assert found[1].keys() == tensors.keys()
        assert all(np.array_equal(found[1][key], tensors[key]) for key in tensors)
    file.write_bytes(whole)
    assert RunFolder.read(file)[0] == state
