"""What a reader makes of a map of cells, and the arrays that numpy writes."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt

from guided_gym.errors import GuidedGymError, StorageError
from guided_gym.geometry.occupancy import MOST_CELLS
from guided_gym.storage.foreign_file import read_bytes


@dataclass(frozen=True)
class Raster:
    """A map of cells.

    Attributes:
        cells: (rows, columns), row 0 at the bottom, as `Environment.from_occupancy` takes them.
        resolution: Side of a cell (length); None where the map does not say it.
        origin: x, y and yaw of the lower left corner.
        usual: The side of a cell where nobody says it.
    """

    cells: npt.NDArray[Any]
    resolution: float | None = None
    origin: Sequence[float] = (0.0, 0.0, 0.0)
    usual: float | None = None


def array_raster(path: Path) -> Raster:
    """The cells of a ``.npy`` file.

    Raises:
        StorageError: It cannot be read, is damaged or too large, or has another shape.
    """
    read_bytes(path)
    try:
        header = np.load(path, mmap_mode="r", allow_pickle=False)
        if getattr(header, "ndim", 0) != 2 or header.size > MOST_CELLS:
            shape = getattr(header, "shape", "no array")
            raise StorageError(f"{path}: expected (rows, columns), at most {MOST_CELLS} cells, got {shape}")
        occupancy = np.array(header)
    except GuidedGymError:
        raise
    except Exception as error:  # numpy's reader raises many kinds on damaged files
        raise StorageError(f"{path}: expected an array in numpy's format, got: {error}") from error
    return Raster(occupancy)


def needed(module: str, package: str) -> ModuleType:
    """A module of the extra ``[maps]``.

    Raises:
        GuidedGymError: It is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise GuidedGymError(
            f"reading this needs {package}: pip install 'guided-gym[maps]' ({error})"
        ) from error
