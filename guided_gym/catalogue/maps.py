"""Maps in common formats: ROS map_server, MovingAI, GeoJSON, pictures and arrays.

A map is bounds and obstacles, an `Environment`; robots and tasks come from problem files
(`guided_gym.catalogue.files`). Each format has its reader in `guided_gym.catalogue.map_formats`; what a
reader cannot know is in `MapOptions`. Nothing that is read can run code, and sizes are checked before
anything is unpacked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from guided_gym.catalogue.map_formats.geojson import read_geojson
from guided_gym.catalogue.map_formats.movingai import GridTask, movingai_raster, scenario_tasks
from guided_gym.catalogue.map_formats.pictures import picture_raster
from guided_gym.catalogue.map_formats.raster import Raster, array_raster
from guided_gym.catalogue.map_formats.ros import ros_raster
from guided_gym.checks import number, shown
from guided_gym.doors import door, doors
from guided_gym.errors import InvalidInputError, StorageError, named
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.occupancy import UNKNOWN

_RASTERS: Final[dict[str, Callable[[Path], Raster]]] = {
    ".yaml": ros_raster,
    ".yml": ros_raster,
    ".map": movingai_raster,
    ".png": picture_raster,
    ".pgm": picture_raster,
    ".bmp": picture_raster,
    ".jpg": picture_raster,
    ".jpeg": picture_raster,
    ".npy": array_raster,
}
MAP_SUFFIXES: Final = (*_RASTERS, ".geojson")


@doors
@dataclass(frozen=True)
class MapOptions:
    """What a map does not say by itself.

    Attributes:
        unknown: ``"occupied"`` or ``"free"``: what unknown cells count as.
        threshold: Probability from which a cell counts as occupied.
        simplify: Boundaries of a raster may move by half of this (length).
        speckles: Parts of fewer cells than this are left out.
        resolution: Side of a cell of a picture or array (length); a map's own value wins.
        bounds: Bounds of a map without any.
        margin: Room around the obstacles of a map without bounds, as a share of their extent.
        geographic: Whether GeoJSON has longitude and latitude; they become metres around the map's centre.
        repair: Whether polygons that cross themselves are mended; else they are refused.
    """

    unknown: str = "occupied"
    threshold: float = 0.5
    simplify: float = 0.0
    speckles: int = 1
    resolution: float | None = None
    bounds: tuple[float, float, float, float] | None = None
    margin: float = 0.05
    geographic: bool = False
    repair: bool = False

    def __post_init__(self) -> None:
        if self.unknown not in UNKNOWN:
            raise InvalidInputError(
                f"unknown: expected one of {', '.join(UNKNOWN)}, got {shown(self.unknown)}"
            )
        number("margin", self.margin, least=0)


DEFAULT_OPTIONS: Final = MapOptions()


@door
def read_map(path: str | Path, options: MapOptions = DEFAULT_OPTIONS) -> Environment:
    """The environment of a map file, by its extension: see `MAP_SUFFIXES`.

    Args:
        path: A ROS ``.yaml``, MovingAI ``.map``, ``.geojson``, a picture (``.png``, ``.pgm``, ``.bmp``,
            ``.jpg``) or an array (``.npy``).
        options: What the file does not say.

    Raises:
        StorageError: The file cannot be read, is damaged, or is no such map; names file and place.
        InvalidInputError: Another extension, or options that do not fit.
        GuidedGymError: A package that reads it is not installed.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    with named(path):
        if suffix not in MAP_SUFFIXES:
            known = ", ".join(MAP_SUFFIXES)
            raise InvalidInputError(
                f"expected a map with one of the extensions {known}, got {shown(path.suffix)}"
            )
        try:
            if suffix in _RASTERS:
                return _of_cells(_RASTERS[suffix](path), options)
            return read_geojson(
                path, options.bounds, options.margin, geographic=options.geographic, repair=options.repair
            )
        except (MemoryError, RecursionError) as error:
            raise StorageError(
                f"{path}: expected a map, got one that is too large or nested too deeply"
            ) from error


def _of_cells(raster: Raster, options: MapOptions) -> Environment:
    sides = (raster.resolution, options.resolution, raster.usual)  # a map's own value wins
    side = next((side for side in sides if side is not None), None)
    if side is None:
        raise InvalidInputError(
            "resolution: expected the side of a cell, since this map does not say it; got none"
        )
    return Environment.from_occupancy(
        raster.cells,
        side,
        raster.origin,
        unknown=options.unknown,
        threshold=options.threshold,
        simplify=options.simplify,
        speckles=options.speckles,
    )


@door
def read_scenario(path: str | Path) -> list[GridTask]:
    """The tasks of a MovingAI ``.scen``, in the coordinates of its map as `read_map` reads it.

    Raises:
        StorageError: It cannot be read, is damaged or names a cell outside its map.
    """
    return scenario_tasks(Path(path))
