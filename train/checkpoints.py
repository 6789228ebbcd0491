"""The folder of a training run: its configuration, its checkpoint, and what it may be continued with.

A checkpoint is one safetensors file, written whole or not at all: a killed run continues from the last one.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
from collections.abc import Mapping
from dataclasses import asdict, fields, is_dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError, StorageError, UnknownNameError
from guided_gym.guidance.learned.weights import pack_tensors, read_bytes, unpack_tensors
from guided_gym.storage.foreign_file import parsed_toml, read_text
from guided_gym.storage.whole_file import write_whole

CONFIG_FILE: Final = "config.toml"
AGENT_FOLDER: Final = "agent"
CHECKPOINT_FILE: Final = "checkpoint.safetensors"
_STATE: Final = "state.json"
_CHECKSUM: Final = "sha256"
_LARGEST_CONFIG: Final = 2**20  # bytes

Tensors = dict[str, NDArray[Any]]
C = TypeVar("C")


def to_toml(config: Any) -> str:
    """A flat dataclass of numbers, words and lists of them as TOML."""
    if not is_dataclass(config) or isinstance(config, type):
        raise InvalidInputError(f"expected a dataclass of options, got {shown(config)}")
    return "".join(f"{name} = {_toml(value)}\n" for name, value in asdict(config).items())


def _toml(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return json.dumps(value)


def read_config(file: Path) -> dict[str, Any]:
    """The options in a TOML file.

    Raises:
        StorageError: It is missing or not TOML.
    """
    if not file.is_file():
        raise StorageError(f"expected a configuration at {file}, got no file")
    return parsed_toml(file, read_text(file, _LARGEST_CONFIG))


def build_config(kind: type[C], options: Mapping[str, Any]) -> C:
    """A dataclass of options, each checked against the type of its default.

    Raises:
        UnknownNameError: An option that it does not have; the nearest one is suggested.
        InvalidInputError: A value of another type, or one that the dataclass refuses.
    """
    known = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for name, value in options.items():
        if name not in known:
            raise UnknownNameError("option", name, known)
        default = known[name].default
        wanted = type(default)
        if isinstance(value, list):
            value = tuple(value)
        if wanted is float and type(value) is int:
            value = float(value)
        if wanted in (int, float, str, bool, tuple) and type(value) is not wanted:
            raise InvalidInputError(f"{name}: expected {wanted.__name__}, got {shown(value)}")
        values[name] = value
    return kind(**values)


def check_board(wanted: bool) -> None:
    """Refuse TensorBoard files where nothing can write them.

    Raises:
        InvalidInputError: They are wanted, and TensorBoard is not installed.
    """
    if wanted and importlib.util.find_spec("tensorboard") is None:
        raise InvalidInputError(
            "tensorboard: expected the package tensorboard, got none; "
            "in a checkout of guided-gym: pip install '.[train]'"
        )


def _checksum(tensors: Mapping[str, NDArray[Any]]) -> NDArray[np.uint8]:
    """Names, types, shapes and numbers of tensors in one number, kept as a tensor beside them."""
    return np.frombuffer(hashlib.sha256(pack_tensors(tensors)).digest(), np.uint8)


class RunFolder:
    """The folder of one run.

    Args:
        path: The folder; made if it is not there.
        config: The run's configuration, a flat dataclass.
        kind: What kind of training, for messages.

    Raises:
        StorageError: The folder holds another run or other files; nothing in it is changed.
    """

    def __init__(self, path: Path, config: Any, kind: str) -> None:
        self.path = path
        text = f"# guided-gym train {kind} --config {CONFIG_FILE}\n" + to_toml(config)
        file = path / CONFIG_FILE
        if file.is_file():
            there = read_bytes(file, "a configuration").decode("utf-8", "replace")
            if there != text:
                changed = sorted(set(text.splitlines()) ^ set(there.splitlines()))
                raise StorageError(
                    f"{path}: expected the folder of the same run, got another run's; they differ in "
                    f"{'; '.join(changed[:6])}. Choose another folder (--out) to train anew"
                )
        elif path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise StorageError(
                f"{path}: expected an empty folder, or that of a run, got another; nothing was written"
            )
        else:
            write_whole(file, text)

    def save(self, state: Mapping[str, Any], tensors: Mapping[str, NDArray[Any]]) -> None:
        """Replace the checkpoint."""
        self.keep(CHECKPOINT_FILE, state, tensors)

    def load(self) -> tuple[dict[str, Any], Tensors] | None:
        """State and tensors of the last checkpoint; None if there is none yet.

        Raises:
            StorageError: The checkpoint is damaged.
        """
        file = self.path / CHECKPOINT_FILE
        if not file.exists():
            return None
        return self.read(file)

    @staticmethod
    def read(file: Path) -> tuple[dict[str, Any], Tensors]:
        """State and tensors of a file that `save` or `keep` wrote.

        Raises:
            StorageError: It is damaged.
        """
        tensors = unpack_tensors(read_bytes(file, "a checkpoint"), file)
        checksum = tensors.pop(_CHECKSUM, None)
        if checksum is None or not np.array_equal(checksum, _checksum(tensors)):
            found = (
                "one that does not match its checksum" if checksum is not None else "one without a checksum"
            )
            raise StorageError(
                f"{file} is damaged: expected a checkpoint as it was written, got {found}; "
                "delete the file to compute what it holds anew"
            )
        try:
            state = json.loads(tensors.pop(_STATE).tobytes())
        except (KeyError, ValueError, RecursionError):
            raise StorageError(f"{file}: expected a checkpoint, got tensors without a state") from None
        return state, tensors

    def keep(self, name: str, state: Mapping[str, Any], tensors: Mapping[str, NDArray[Any]]) -> None:
        """Write a file of data that need not be computed again."""
        text = np.frombuffer(json.dumps(state).encode(), np.uint8)
        content = {**tensors, _STATE: text}
        write_whole(self.path / name, pack_tensors({**content, _CHECKSUM: _checksum(content)}))
