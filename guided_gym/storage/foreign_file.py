"""Files that people bring: bounded in size and depth, each key once, and nothing in them can run code.

Messages name file and line.
"""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any, Final

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError, StorageError

LARGEST: Final = 2**28
"""Bytes of the largest file that is read."""
MOST_NESTED: Final = 32
"""Lists in lists that a file may have."""


def read_bytes(path: Path, largest: int = LARGEST) -> bytes:
    """The content of a file that is not larger than allowed.

    Raises:
        StorageError: It cannot be read, or is larger.
    """
    try:
        size = path.stat().st_size
        if size > largest:
            raise StorageError(f"{path}: expected a file of at most {largest} bytes, got {size}")
        with path.open("rb") as file:
            content = file.read(largest + 1)  # devices and pipes say no size
    except (OSError, ValueError) as error:
        raise StorageError(f"cannot read {path}: {error}") from error
    if len(content) > largest:
        raise StorageError(f"{path}: expected a file of at most {largest} bytes, got more")
    return content


def read_text(path: Path, largest: int = LARGEST) -> str:
    """The text of a UTF-8 file that is not larger than allowed.

    Raises:
        StorageError: It cannot be read, is larger, or is no UTF-8.
    """
    content = read_bytes(path, largest)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise StorageError(f"{path}, line {line}: expected UTF-8 text, got other bytes") from error


def check_nesting(path: Path, text: str) -> None:
    """Refuse text whose brackets are nested deeper than in any honest file: readers would overflow.

    Raises:
        StorageError: It is.
    """
    depth, quoted = 0, False
    for match in re.finditer(r'\\.|["\[\](){}]', text):
        mark = match.group()
        if mark == '"':
            quoted = not quoted
        elif quoted or mark[0] == "\\":
            continue
        elif mark in "[({":
            depth += 1
            if depth > MOST_NESTED:
                line = text.count("\n", 0, match.start()) + 1
                raise StorageError(
                    f"{path}, line {line}: expected lists nested at most {MOST_NESTED} deep, got more"
                )
        else:
            depth = max(depth - 1, 0)


def inside_folder(folder: Path, name: str, path: Path, field: str) -> Path:
    """A file named in the field of another, which may not lie outside that one's folder.

    Raises:
        InvalidInputError: It does.
        StorageError: There is none.
    """
    try:
        target = (folder / name).resolve()
        inside, there = target.is_relative_to(folder.resolve()), target.is_file()
    except (OSError, ValueError, RuntimeError) as error:
        why = getattr(error, "strerror", None) or error  # without the name, which may be long
        raise InvalidInputError(f"{field}: expected the name of a file, got {shown(name)}: {why}") from None
    if not inside:
        raise InvalidInputError(f"{field}: expected a file in {folder} or below, got {shown(name)}")
    if not there:
        raise StorageError(f"{path}: {field}: expected a file at {target}, but there is no such file")
    return target


def parsed_json(path: Path, text: str) -> Any:
    """The content of a JSON text without duplicate keys, NaN or infinity.

    Raises:
        StorageError: It is none, or nested deeper than any honest file; names the line.
    """
    check_nesting(path, text)

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        content = dict(pairs)
        if len(content) < len(pairs):
            raise _DuplicateError
        return content

    def refuse(word: str) -> Any:
        raise _ConstantError(word)

    try:
        return json.loads(text, object_pairs_hook=unique, parse_constant=refuse)
    except json.JSONDecodeError as error:
        raise StorageError(f"{path}, line {error.lineno}: expected JSON, got: {error.msg}") from error
    except _DuplicateError:
        line, name = _second_key(text)
        raise StorageError(
            f"{path}, line {line}: expected each key once, got {name[:60]!r} a second time"
        ) from None
    except _ConstantError as error:
        word = str(error.args[0])
        line = text.count("\n", 0, text.find(word)) + 1
        raise StorageError(f"{path}, line {line}: expected finite numbers, got {word}") from None
    except (ValueError, RecursionError) as error:
        raise StorageError(f"{path}: expected JSON, got: {reason(error)}") from error


def reason(error: Exception) -> str:
    """What a parser says, in words that fit a file."""
    text = str(error)
    return "an integer of thousands of digits" if "integer string conversion" in text else text


class _DuplicateError(Exception):
    """A key a second time."""


class _ConstantError(Exception):
    """NaN or an infinity."""


_JSON_TOKEN: Final = re.compile(r'"(?:\\.|[^"\\])*"|[\[\]{}:,]')


def _second_key(text: str) -> tuple[int, str]:
    """The line of the first key that stands in its object a second time, and that key."""
    keys: list[set[str] | None] = []  # of each object that is open; None for a list
    last = ""
    for match in _JSON_TOKEN.finditer(text):
        token = match.group()
        if token in "{[":
            keys.append(set() if token == "{" else None)
        elif token in "}]":
            keys.pop()
        elif token == ":" and keys and keys[-1] is not None:
            if last in keys[-1]:
                return text.count("\n", 0, match.start()) + 1, str(json.loads(last))
            keys[-1].add(last)
        elif token[0] == '"':
            last = json.dumps(json.loads(token))
    return 1, ""


def parsed_toml(path: Path, text: str) -> dict[str, Any]:
    """The content of a TOML text.

    Raises:
        StorageError: It is none, or nested deeper than any honest file; names the line where it can.
    """
    check_nesting(path, text)
    deepest = max((part.count(".") for part in re.split(r"[=,\[\]{}\n]", text)), default=0)
    if deepest > MOST_NESTED:  # Python's reader takes the square of that
        raise StorageError(f"{path}: expected keys of at most {MOST_NESTED} parts, got {deepest + 1}")
    if re.search(r"[0-9_]{5000}", text):  # Python's reader takes a hundred times the memory
        raise StorageError(f"{path}: expected TOML, got an integer of thousands of digits")
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        match = re.search(r"line (\d+)", str(error))
        place = f", line {match[1]}" if match else ", at its end"
        what = re.sub(r" \(at .*\)$", "", str(error))
        raise StorageError(f"{path}{place}: expected TOML, got: {what}") from error
    except (ValueError, RecursionError, OverflowError) as error:
        raise StorageError(f"{path}: expected TOML, got: {reason(error)}") from error
