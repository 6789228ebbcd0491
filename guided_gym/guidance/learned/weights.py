"""Weights of learned agents: one safetensors file and one JSON card beside it. Nothing is ever unpickled."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError
from safetensors.numpy import load, save

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

_REQUIRED: Final = ("format", "kind", "name", "package_version", "field", "scorer", "training", "metrics")


def pack_tensors(tensors: Mapping[str, NDArray[Any]]) -> bytes:
    """The bytes of a safetensors file.

    Raises:
        InvalidInputError: A tensor of a type that the format lacks.
    """
    # In order: the package stores other values of views that are not contiguous.
    whole = {name: np.array(tensor, order="C") for name, tensor in tensors.items()}
    try:
        return save(whole)
    except SafetensorError as error:
        raise InvalidInputError(f"tensors: expected types that safetensors has: {error}") from error


def unpack_tensors(data: bytes, where: str | Path = "weights") -> Tensors:
    """The tensors of a safetensors file.

    Raises:
        StorageError: The bytes are truncated, a pickle, or no safetensors file for another reason.
    """
    if (data[:1] == b"\x80" and data[8:9] != b"{") or data[:2] == b"PK":
        raise StorageError(
            f"{where}: expected a safetensors file, got a pickle or zip; those can run code and are not read"
        )
    try:
        return {name: tensor.copy() for name, tensor in load(data).items()}
    except (SafetensorError, KeyError, TypeError, ValueError) as error:  # a type that numpy lacks, too
        raise StorageError(f"{where}: expected a whole safetensors file: {error}") from None


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
    """The card of an agent, or of another thing that `kind` names.

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
    """The kind of the card in a folder; "" for a file that is not one of ours.

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
    """Card and tensors of an agent, or of another thing that `kind` names.

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


def selection_of(card: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    """How an agent selects, as its card says: options of its guidance that were sought for it.

    Args:
        card: The card.
        names: The options that there are.

    Raises:
        StorageError: The entry holds something else.
    """
    entry = card.get("selection", {})
    if not isinstance(entry, dict) or not set(entry) <= set(names):
        raise StorageError(f"card: expected a selection of {', '.join(sorted(names))}, got {shown(entry)}")
    for name, value in entry.items():
        least = 1 if name == "factor" else 0
        numeric = isinstance(value, int | float) and math.isfinite(value) and value >= least
        if not (isinstance(value, bool) if name == "scored" else numeric and not isinstance(value, bool)):
            wanted = f"a number >= {least}"
            raise StorageError(f"card: expected {wanted} as the selection's {name}, got {shown(value)}")
    return dict(entry)


def part_of(tensors: Tensors, part: str, mark: str = ".") -> Tensors:
    """The tensors of one part of an agent or checkpoint, their names without the part's prefix."""
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
