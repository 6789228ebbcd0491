"""The text of problem files: where a field stands, what is wrong with it, and how to write TOML and JSON."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, get_args

from pydantic import BaseModel

from guided_gym.checks import shown

Place = tuple[int | str, ...]
"""Where a field stands: keys and indices, from the outside in."""


_PART: Final = r'"(?:\\.|[^"\\])*"|[A-Za-z_][\w-]*|\[\d+\]'


def place_of(message: str) -> Place:
    """The place that a message begins with: ``robot.joints[2].limits: expected ...``; none as ()."""
    found = re.match(rf"((?:(?:{_PART})\.?)+)(?::| \()", message)
    parts = re.findall(_PART, found[1]) if found else []
    return tuple(int(part[1:-1]) if part[0] == "[" else part.strip('"') for part in parts)


def message_of(error: Any, model: type[BaseModel]) -> str:
    """One line of ours for an error of pydantic's."""
    loc = error["loc"]
    field = "".join(map(_named_part, loc)).lstrip(".")
    before = f"{field}: " if field else ""
    if error["type"] == "missing":
        return f"{before}expected this field, got none"
    if error["type"] == "extra_forbidden":
        known = list(_model_at(model, loc[:-1]).model_fields)
        close = difflib.get_close_matches(str(loc[-1]), known, n=1, cutoff=0.5)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        return f"{before}unknown field{hint} (known: {', '.join(known)})"
    text = str(error["msg"])
    if error["type"] == "value_error":
        return before + text.removeprefix("Value error, ")
    text = re.sub(r"^Input should be |^(List|String|Dictionary) should (have )?", "expected ", text)
    text = re.sub(r" after validation, not \d+$", "", text)
    got = error["input"]
    if isinstance(got, list | dict | str) and len(got) > 8:
        got = f"{type(got).__name__} of {len(got)}"
        return f"{before}{text}, got a {got}"
    said = shown(got)
    return f"{before}{text}, got {said if len(said) <= 60 else said[:57] + '...'}"


def _named_part(part: int | str) -> str:
    if isinstance(part, int):
        return f"[{part}]"
    return f".{part}" if re.fullmatch(_PART, part) else f".{json.dumps(part, ensure_ascii=False)}"


def _model_at(model: type[BaseModel], loc: Sequence[int | str]) -> type[BaseModel]:
    """The model of what stands at a place of a file."""
    for part in loc:
        if part in model.model_fields:
            model = next(_models(model.model_fields[str(part)].annotation), model)
    return model


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)


_TOKEN: Final = re.compile(r'"(?:\\.|[^"\\\n])*"|#[^\n]*|[\[\]{}:=,]|[^\s\[\]{}:=,"#]+')


def line_of(path: Path, text: str, place: tuple[int | str, ...]) -> int:
    """The line of a field, or of what it would stand in."""
    if path.suffix.lower() == ".json":
        return _json_line(text, place, 1)
    return _toml_line(text, place)


def _json_line(text: str, place: tuple[int | str, ...], first: int) -> int:
    """The line where the value at a place begins, as deep as it is found; ``first`` is the first line."""
    best_depth, best = -1, first
    path: list[int | str] = []
    objects: list[bool] = []
    wants_key = False
    line, counted = first, 0
    for match in _TOKEN.finditer(text):
        token = match.group()
        if token == ",":
            if objects and objects[-1]:
                wants_key = True
            elif path and isinstance(path[-1], int):
                path[-1] += 1
        elif token in ":=" or token[0] == "#":
            continue
        elif token in "]}":
            if objects:
                objects.pop()
                path.pop()
            wants_key = False
            if not objects:
                break
        elif wants_key:
            path[-1] = token.strip('"')
            wants_key = False
        else:
            if len(path) > best_depth and place[: len(path)] == tuple(path):
                line += text.count("\n", counted, match.start())
                counted = match.start()
                best_depth, best = len(path), line
                if best_depth == len(place):
                    break
            if token in "[{":
                objects.append(token == "{")
                wants_key = token == "{"
                path.append("" if wants_key else 0)
    return best


def _toml_line(text: str, place: tuple[int | str, ...]) -> int:
    """The line of a field of a TOML file, as deep as it is found."""
    best_depth, best = 0, 1
    table: tuple[int | str, ...] = ()
    counts: dict[tuple[int | str, ...], int] = {}
    lines = text.split("\n")
    for number, line in enumerate(lines, start=1):
        header = re.match(r"\s*(\[\[?)\s*([A-Za-z_\"'][^\[\],]*?)\s*\]\]?\s*(#.*)?$", line)
        key = re.match(r"\s*([A-Za-z0-9_-]+|\"[^\"]*\"|'[^']*')\s*(?:\.\s*[A-Za-z0-9_-]+\s*)?=", line)
        if header:
            *outer, last = (part.strip().strip("\"'") for part in header[2].split("."))
            table = ()
            for part in outer:  # below an array of tables, the last one of it is meant
                table = (*table, part)
                table = (*table, counts[table]) if table in counts else table
            table = (*table, last)
            if header[1] == "[[":
                counts[table] = counts.get(table, -1) + 1
                table = (*table, counts[table])
            here = table
        elif key:
            here = (*table, key[1].strip("\"'"))
        else:
            continue
        if len(here) > best_depth and place[: len(here)] == here:
            best_depth, best = len(here), number
            if key and len(place) > len(here):
                rest = line[key.end() :] + "\n" + "\n".join(lines[number:])
                return _json_line(rest, place[len(here) :], number)
    return best


def json_text(content: Mapping[str, Any]) -> str:
    """JSON with a line for each field, obstacle and region."""
    rows = []
    for name, value in content.items():
        if name == "obstacles":
            body = ",\n".join("    " + json.dumps(part, ensure_ascii=False) for part in value)
            rows.append(f"  {json.dumps(name)}: [\n{body}\n  ]")
        elif name == "regions":
            body = ",\n".join(
                f"    {json.dumps(key, ensure_ascii=False)}: {json.dumps(part, ensure_ascii=False)}"
                for key, part in value.items()
            )
            rows.append(f"  {json.dumps(name)}: {{\n{body}\n  }}")
        else:
            rows.append(f"  {json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}")
    return "{\n" + ",\n".join(rows) + "\n}\n"


def toml_text(content: Mapping[str, Any]) -> str:
    """TOML with tables for the parts of the model."""
    plain = [f"{name} = {_toml_value(v)}" for name, v in content.items() if not isinstance(v, dict | list)]
    plain += [
        f"{name} = {_toml_value(v)}"
        for name, v in content.items()
        if isinstance(v, list) and name != "obstacles"
    ]
    rows = plain
    for name, value in content.items():
        if not isinstance(value, dict):
            continue
        if name == "regions":
            for key, part in value.items():
                rows += ["", f"[regions.{_toml_value(key)}]", *_toml_rows(part)]
        else:
            rows += ["", f"[{name}]", *_toml_rows(value)]
    for part in content.get("obstacles", ()):
        rows += ["", "[[obstacles]]", *_toml_rows(part)]
    return "\n".join(rows) + "\n"


def _toml_rows(part: Mapping[str, Any]) -> list[str]:
    return [f"{name} = {_toml_value(value)}" for name, value in part.items() if value is not None]


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_toml_value(k)} = {_toml_value(v)}" for k, v in value.items()) + " }"
    return repr(value)
