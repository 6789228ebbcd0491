"""A search as a page: what `guided-gym replay` writes, and notebooks show."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from guided_gym.catalogue.files import problem_of
from guided_gym.checks import integer
from guided_gym.display.pages import embedded, escaped, page
from guided_gym.display.scene import digits_of, scene_of
from guided_gym.errors import InvalidInputError
from guided_gym.problems import Problem
from guided_gym.traces.reading import NUMBERS, TraceReader

MOST_SAMPLES: Final = 100_000
"""Samples that a page shows unless asked for fewer: some 10 MB, and as much as a browser draws with ease."""

SCRIPTS: Final = ("view.js", "player.js")
_DIGITS: Final = 4  # of SE and h
_HIDDEN: Final = ("problem",)  # of a header: the scene says what is seen

Row = dict[str, Any]


def replay_page(paths: Sequence[str | Path], *, samples: int = MOST_SAMPLES) -> str:
    """One page that plays the searches of one trace, or of two side by side.

    Args:
        paths: The traces.
        samples: How many of each one's samples are shown at most; the page says so where there are more.

    Raises:
        StorageError: A file cannot be read, or is no trace of this version.
        InvalidInputError: Not one trace or two, or a problem that cannot be used.
    """
    if not 1 <= len(paths) <= 2:
        raise InvalidInputError(f"traces: expected one or two, got {len(paths)}")
    contents = [trace_content(path, samples=samples) for path in paths]
    names = [content["lines"][0] for content in contents]
    title = " and ".join(f"{one.get('guidance') or 'search'} on {one['scene']['name']}" for one in names)
    body = "\n".join(
        [
            f'<main>\n<div class="top"><h1>{escaped(title)}</h1></div>\n<div id="player"></div>\n</main>',
            *(embedded(content, kind="trace") for content in contents),
        ]
    )
    return page(title, body, scripts=(*SCRIPTS, "replay.js"))


def trace_content(path: str | Path, *, samples: int = MOST_SAMPLES) -> dict[str, Any]:
    """What a page holds of a trace: its lines with the problem as a scene, rounded to what an eye can see.

    Returns:
        ``lines`` and ``trouble``: why the trace ends early, or empty.

    Raises:
        StorageError: The file cannot be read, or is not a trace of this version.
        InvalidInputError: Its problem cannot be used.
    """
    most = integer("samples", samples, least=1)
    reader = TraceReader(path, most)
    problem = problem_of(reader.header["problem"], reader.path)
    lines = shown_lines(reader.header, reader, problem)
    if reader.beyond:
        note_rest(lines, most, reader.beyond)
    elif reader.end is not None:
        lines.append({"end": reader.end})
    return {"lines": lines, "trouble": reader.trouble}


def shown_lines(header: Row, rows: Iterable[Row], problem: Problem) -> list[Row]:
    """Lines of a trace as a page has them: with the problem as a scene, rounded to what an eye can see."""
    shown = {key: value for key, value in header.items() if key not in _HIDDEN}
    shown["scene"] = scene_of(problem)
    digits = digits_of(problem.environment.extent)
    return [shown, *(_rounded(row, digits) for row in rows)]


def note_rest(lines: list[Row], shown: int, beyond: int) -> None:
    """Say on a page that a search goes on after the samples that it shows."""
    lines[0]["notices"] = [
        f"The search has {shown + beyond:,} samples, of which the first {shown:,} are shown."
    ]


def _rounded(row: Row, digits: int) -> Row:
    if "also" in row:
        return {**row, "also": [rounded_row(node, digits) for node in row["also"]]}
    return rounded_row(row, digits) if "n" in row else row


def rounded_row(row: Row, digits: int) -> Row:
    """A sample with coordinates and figures rounded to what an eye can see."""
    out = dict(row)
    for key in ("x", "c"):
        if key in out:
            out[key] = [round(value, digits) for value in out[key]]
    for key in NUMBERS:
        if key in out:
            out[key] = float(f"{out[key]:.{_DIGITS}g}") if key != "t" else round(out[key], digits)
    return out
