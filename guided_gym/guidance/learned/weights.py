"""Weights of learned agents: one safetensors file and one JSON card beside it. Nothing is ever unpickled.

The safetensors format is simple (a length, a JSON header, raw numbers), so it is read and written here with
every field checked: a plain install needs no further package to run a learned agent.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.storage.whole_file import write_whole

A = TypeVar("A")

Tensors = dict[str, NDArray[Any]]
Shapes = Mapping[str, tuple[int, ...]]

CARD_FILE: Final = "card.json"
WEIGHTS_FILE: Final = "weights.safetensors"
CARD_FORMAT: Final = 1
AGENT_KIND: Final = "guided-gym agent"

_DTYPES: Final[dict[str, np.dtype[Any]]] = {
    "F16": np.dtype("<f2"),
    "F32": np.dtype("<f4"),
    "F64": np.dtype("<f8"),
    "I32": np.dtype("<i4"),
    "I64": np.dtype("<i8"),
    "U8": np.dtype("u1"),
}
_NAMES: Final = {dtype: name for name, dtype in _DTYPES.items()}
_LARGEST_HEADER: Final = 10_000_000
_REQUIRED: Final = ("format", "kind", "name", "package_version", "field", "scorer", "training", "metrics")


def pack_tensors(tensors: Mapping[str, NDArray[Any]], metadata: Mapping[str, str] | None = None) -> bytes:
    """The bytes of a safetensors file.

    Raises:
        InvalidInputError: A tensor of a type that the format lacks here.
    """
    header: dict[str, Any] = {"__metadata__": dict(metadata)} if metadata else {}
    blobs: list[bytes] = []
    start = 0
    for name in sorted(tensors):
        array = np.asarray(tensors[name])
        kind = _NAMES.get(array.dtype.newbyteorder("<") if array.dtype.itemsize > 1 else array.dtype)
        if kind is None:
            raise InvalidInputError(f"tensor {name!r}: expected one of {sorted(_DTYPES)}, got {array.dtype}")
        blob = array.astype(_DTYPES[kind], copy=False).tobytes()
        header[name] = {
            "dtype": kind,
            "shape": list(array.shape),
            "data_offsets": [start, start + len(blob)],
        }
        blobs.append(blob)
        start += len(blob)
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    return len(text).to_bytes(8, "little") + text + b"".join(blobs)


def unpack_tensors(data: bytes, where: str | Path = "weights") -> Tensors:
    """The tensors of a safetensors file, every field of its header checked.

    Raises:
        StorageError: The bytes are truncated, a pickle, or no safetensors file for another reason.
    """
    header, body = _header(data, where)
    tensors: Tensors = {}
    used = 0
    for name, entry in sorted(header.items(), key=lambda item: _offset(item[1])):
        try:
            dtype = _DTYPES[entry["dtype"]]
            shape = tuple(entry["shape"])
            begin, end = entry["data_offsets"]
            whole = all(type(n) is int and n >= 0 for n in (*shape, begin, end))
        except (KeyError, TypeError, ValueError):
            raise StorageError(f"{where}: tensor {name!r} has a damaged entry: {entry!r}") from None
        if not whole or begin != used or end - begin != dtype.itemsize * math.prod(shape):
            raise StorageError(f"{where}: tensor {name!r} has a damaged entry: {entry!r}")
        if end > len(body):
            raise StorageError(
                f"{where}: expected {end} bytes of tensors, got {len(body)}; the file is truncated"
            )
        tensors[name] = np.frombuffer(body[begin:end], dtype).reshape(shape).copy()
        used = end
    if used != len(body):
        raise StorageError(f"{where}: expected {used} bytes of tensors, got {len(body)}")
    return tensors


def _offset(entry: Any) -> int:
    try:
        return int(entry["data_offsets"][0])
    except (KeyError, TypeError, ValueError, IndexError):
        return 0


def _header(data: bytes, where: str | Path) -> tuple[dict[str, Any], memoryview]:
    if (data[:1] == b"\x80" and data[8:9] != b"{") or data[:2] == b"PK":
        raise StorageError(
            f"{where}: expected a safetensors file, got a pickle or zip; those can run code and are not read"
        )
    length = int.from_bytes(data[:8], "little")
    if len(data) < 8 or length > min(_LARGEST_HEADER, len(data) - 8):
        raise StorageError(
            f"{where}: expected a safetensors file, got {len(data)} bytes that are truncated or foreign"
        )
    try:
        header = json.loads(data[8 : 8 + length].decode("utf-8"))
    except (UnicodeDecodeError, ValueError, RecursionError):
        raise StorageError(f"{where}: expected a safetensors file, got one without a JSON header") from None
    if not isinstance(header, dict):
        raise StorageError(f"{where}: expected a safetensors header, got {type(header).__name__}")
    header.pop("__metadata__", None)
    return header, memoryview(data)[8 + length :]


def read_bytes(file: Path, what: str) -> bytes:
    """A file's content.

    Raises:
        StorageError: It is missing or cannot be read.
    """
    try:
        return file.read_bytes()
    except OSError as error:
        raise StorageError(f"expected {what} at {file}: {error.strerror or error}") from error


def save_agent(folder: Path, card: Mapping[str, Any], tensors: Mapping[str, NDArray[Any]]) -> None:
    """Write an agent: its weights, then the card that names them by their hash.

    Raises:
        StorageError: The folder cannot be written.
    """
    data = pack_tensors(tensors)
    content = {"format": CARD_FORMAT, "kind": AGENT_KIND, **card}
    content["weights_sha256"] = hashlib.sha256(data).hexdigest()
    write_whole(folder / WEIGHTS_FILE, data)
    write_whole(folder / CARD_FILE, json.dumps(content, indent=2) + "\n")


def load_card(folder: Path, kind: str = AGENT_KIND, required: Sequence[str] = _REQUIRED) -> dict[str, Any]:
    """The card of an agent, or of what else `kind` says.

    Raises:
        StorageError: There is none, or it is not one of ours, or of another format.
    """
    card = _json_card(folder)
    file = folder / CARD_FILE
    if not isinstance(card, dict) or card.get("kind") != kind:
        found = card.get("kind") if isinstance(card, dict) else None
        raise StorageError(f"{file}: expected the card of a {kind}, got {found or 'another JSON file'}")
    if card.get("format") != CARD_FORMAT:
        raise StorageError(f"{file}: expected card format {CARD_FORMAT}, got {card.get('format')!r}")
    missing = [key for key in required if key not in card]
    if missing:
        raise StorageError(f"{file}: expected the entries {', '.join(required)}; missing: {missing}")
    return card


def card_kind(folder: Path) -> str:
    """What the card in a folder is of; "" for a file that is not one of ours.

    Raises:
        StorageError: There is none, or it is not JSON.
    """
    card = _json_card(folder)
    return str(card.get("kind", "")) if isinstance(card, dict) else ""


def _json_card(folder: Path) -> Any:
    file = folder / CARD_FILE
    try:
        return json.loads(read_bytes(file, "an agent's card").decode("utf-8"))
    except (UnicodeDecodeError, ValueError, RecursionError) as error:
        raise StorageError(f"{file}: expected JSON, got something else: {error}") from None


def load_agent(
    folder: Path, kind: str = AGENT_KIND, required: Sequence[str] = _REQUIRED
) -> tuple[dict[str, Any], Tensors]:
    """Card and tensors of an agent, or of what else `kind` says.

    Raises:
        StorageError: A file is missing, truncated, foreign, or not the one that the card was written for.
    """
    card = load_card(folder, kind, required)
    file = folder / WEIGHTS_FILE
    data = read_bytes(file, "an agent's weights")
    tensors = unpack_tensors(data, file)
    found = hashlib.sha256(data).hexdigest()
    if card.get("weights_sha256") != found:
        raise StorageError(
            f"{file}: expected the weights that {CARD_FILE} names (sha256 {card.get('weights_sha256')}), "
            f"got others (sha256 {found})"
        )
    return card, tensors


def part_of(tensors: Tensors, part: str, mark: str = ".") -> Tensors:
    """The tensors of one part, of an agent or a checkpoint, without its name and the mark behind it."""
    prefix = f"{part}{mark}"
    return {name.removeprefix(prefix): t for name, t in tensors.items() if name.startswith(prefix)}


def parts_of(tensors: Tensors, shapes: Mapping[str, Shapes], where: str | Path) -> dict[str, Tensors]:
    """The tensors of each part of an agent, if they fit the shapes of its networks.

    Raises:
        StorageError: As `check_tensors`.
    """
    expected = {f"{part}.{name}": shape for part, some in shapes.items() for name, shape in some.items()}
    check_tensors(tensors, expected, where)
    return {part: part_of(tensors, part) for part in shapes}


def architecture(kind: type[A], entry: Any, what: str) -> A:
    """The sizes of a network, from the entry of a card.

    Args:
        kind: The dataclass of such sizes.
        entry: What the card says.
        what: What the network is, for the message.

    Raises:
        StorageError: The entry is not one that this version can build.
    """
    try:
        return kind(**entry)
    except (TypeError, ValueError) as error:
        raise StorageError(f"card: expected the sizes of a {what}, got {shown(entry)}: {error}") from None


def check_tensors(tensors: Tensors, expected: Shapes, where: str | Path) -> None:
    """Refuse tensors that do not fit the architecture.

    Raises:
        StorageError: One is missing, too many, of another shape, or not finite.
    """
    for name, shape in expected.items():
        if name not in tensors:
            raise StorageError(f"{where}: expected a tensor {name!r} of shape {shape}, got none")
        if tensors[name].shape != shape:
            raise StorageError(
                f"{where}: expected tensor {name!r} of shape {shape}, got {tensors[name].shape}"
            )
        if not np.isfinite(tensors[name]).all():
            raise StorageError(f"{where}: expected finite numbers in tensor {name!r}, got NaN or infinity")
    extra = sorted(set(tensors) - set(expected))
    if extra:
        raise StorageError(f"{where}: expected the architecture's tensors only, got {extra} too")
