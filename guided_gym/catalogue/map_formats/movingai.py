"""MovingAI: grids of cells (``.map``) and tasks on them (``.scen``)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from guided_gym.catalogue.map_formats.raster import Raster
from guided_gym.checks import shown
from guided_gym.errors import StorageError
from guided_gym.geometry.occupancy import MOST_CELLS
from guided_gym.storage.foreign_file import read_text

FloatArray = npt.NDArray[np.float64]

_PASSABLE: Final = ".GS"
_BLOCKED: Final = "@OTW"


@dataclass(frozen=True)
class GridTask:
    """A task of a MovingAI scenario.

    Attributes:
        start: (2,) centre of the start's cell.
        goal: (2,) centre of the goal's cell.
        length: Length of the shortest path over the grid's eight directions, as the scenario has it.
        map_name: The map that it names.
    """

    start: FloatArray
    goal: FloatArray
    length: float
    map_name: str


def movingai_raster(path: Path) -> Raster:
    """The cells of a ``.map``, of side 1, y upwards, so row 0 lies at the top; errors as `movingai_cells`."""
    return Raster(movingai_cells(path)[::-1], usual=1.0)


def movingai_cells(path: Path) -> npt.NDArray[np.bool_]:
    """(rows, columns) whether each cell is blocked, row 0 first in the file.

    Raises:
        StorageError: It cannot be read, is damaged or cut off.
    """
    lines = read_text(path).splitlines()
    header = [line.split() for line in lines[:4]]
    names = [words[0].lower() if words else "" for words in header]
    if names != ["type", "height", "width", "map"]:
        raise StorageError(f"{path}: expected lines type, height, width and map first, got {shown(names)}")
    sizes = []
    for line, words in enumerate(header[1:3], start=2):
        if len(words) != 2 or not words[1].isdecimal() or not 0 < len(words[1]) < 8 or not int(words[1]):
            raise StorageError(
                f"{path}, line {line}: expected a positive integer, got {' '.join(words[1:])!r}"
            )
        sizes.append(int(words[1]))
    height, width = sizes
    rows = lines[4 : 4 + height]
    if height * width > MOST_CELLS or len(rows) < height:
        raise StorageError(f"{path}: expected {height} rows of {width} cells, got {len(rows)} rows")
    for line, row in enumerate(rows, start=5):
        bad = set(row) - set(_PASSABLE + _BLOCKED)
        if len(row) != width or bad:
            what = f"a cell {sorted(bad)[0]!r}" if bad else f"{len(row)} cells"
            raise StorageError(
                f"{path}, line {line}: expected {width} cells of {_PASSABLE + _BLOCKED}, got {what}"
            )
    codes = np.frombuffer("".join(rows).encode("ascii"), np.uint8).reshape(height, width)
    return ~np.isin(codes, np.frombuffer(_PASSABLE.encode(), np.uint8))


def scenario_tasks(path: Path) -> list[GridTask]:
    """The tasks of a ``.scen``, in the coordinates of `movingai_raster`.

    Raises:
        StorageError: It cannot be read, is damaged or names a cell outside its map.
    """
    lines = read_text(path).splitlines()
    if not lines or lines[0].split()[:1] != ["version"]:
        raise StorageError(f"{path}, line 1: expected 'version 1', got {lines[0][:40] if lines else ''!r}")
    return [_grid_task(path, line, text) for line, text in enumerate(lines[1:], start=2) if text.strip()]


def _grid_task(path: Path, line: int, text: str) -> GridTask:
    words = text.split("\t") if "\t" in text else text.split()
    try:
        width, height, x0, y0, x1, y1 = (int(word) for word in words[2:8])
        length = float(words[8])
    except (ValueError, IndexError):
        raise StorageError(
            f"{path}, line {line}: expected bucket, map, width, height, start x, y, goal x, y and length, "
            f"got {text[:80]!r}"
        ) from None
    for x, y in ((x0, y0), (x1, y1)):
        if not (0 <= x < width and 0 <= y < height):
            raise StorageError(f"{path}, line {line}: expected cells in {width} x {height}, got ({x}, {y})")
    if not (math.isfinite(length) and length >= 0):
        raise StorageError(f"{path}, line {line}: expected a length >= 0, got {words[8]!r}")
    start, goal = (np.array([x + 0.5, height - y - 0.5]) for x, y in ((x0, y0), (x1, y1)))
    return GridTask(start, goal, length, words[1].strip())
