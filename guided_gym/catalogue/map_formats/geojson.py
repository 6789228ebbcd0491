"""GeoJSON: its polygons are obstacles, and its geometries are the shapes of problem files."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import shapely

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.geometry.environment import Environment
from guided_gym.storage.foreign_file import parsed_json, read_text
from guided_gym.storage.whole_file import write_whole

FloatArray = npt.NDArray[np.float64]
Box = tuple[float, float, float, float]

EARTH: Final = 6371008.8
"""Mean radius of the earth (m)."""


def read_geojson(
    path: Path,
    box: Box | None = None,
    margin: float = 0.05,
    *,
    geographic: bool = False,
    repair: bool = False,
) -> Environment:
    """The environment of a GeoJSON file: its polygons are obstacles.

    A feature's property ``role`` may say otherwise: ``bounds`` (its bounding box), ``region`` or ``ignore``.

    Args:
        path: The file.
        box: The bounds; else those that the file says, else what holds the obstacles.
        margin: Room around the obstacles where nothing says the bounds, as a share of their extent.
        geographic: Whether it has longitude and latitude.
        repair: Whether polygons that cross themselves are mended.

    Raises:
        StorageError: It cannot be read or is no GeoJSON; names the feature.
        InvalidInputError: A polygon that cannot be an obstacle.
    """
    bounds, obstacles = None, []
    shapes = list(geojson_shapes(path))
    if geographic:
        shapes = _projected(path, shapes)
    for label, role, shape in shapes:
        if role == "bounds":
            bounds = shape.bounds
        elif role == "obstacle":
            obstacles += obstacle_polygons(label, shape, repair)
    if not obstacles and bounds is None and box is None:
        raise StorageError(f"{path}: expected polygons, got none")
    return Environment(box or bounds or _around(obstacles, margin), tuple(obstacles))


def geojson_shapes(path: Path) -> Iterator[tuple[str, str, shapely.Geometry]]:
    """What each feature is called, its role, and its shape.

    Raises:
        StorageError: It cannot be read or is no GeoJSON; names the feature.
    """
    content = parsed_json(path, read_text(path))
    kind = content.get("type") if isinstance(content, dict) else None
    if kind == "FeatureCollection" and isinstance(content.get("features"), list):
        features = content["features"]
    elif kind == "Feature":
        features = [content]
    else:
        features = [{"type": "Feature", "geometry": content}]
    for index, feature in enumerate(features):
        label = f"feature {index}"
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            raise StorageError(f"{path}, {label}: expected a GeoJSON feature, got {str(feature)[:60]}")
        properties = feature.get("properties")
        properties = properties if isinstance(properties, dict) else {}
        role = properties.get("role", "obstacle")
        if role not in ("obstacle", "bounds", "region", "ignore"):
            raise StorageError(
                f"{path}, {label}: role: expected obstacle, bounds, region or ignore, got {shown(role)}"
            )
        if isinstance(properties.get("name"), str):
            label += f" ({properties['name']!r})"
        if role != "ignore":
            yield label, role, geojson_shape(label, feature.get("geometry"))


_DEPTHS: Final = {
    "Point": 1, "MultiPoint": 2, "LineString": 2, "LinearRing": 2, "MultiLineString": 3,
    "Polygon": 3, "MultiPolygon": 4,
}  # fmt: skip


def geojson_shape(place: str, geometry: Any) -> shapely.Geometry:
    """The shape of a GeoJSON geometry.

    Args:
        place: Where it stands, for messages.
        geometry: What JSON made of it.

    Raises:
        InvalidInputError: It is no geometry, or not of finite numbers.
    """
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if kind == "GeometryCollection" and isinstance(geometry.get("geometries"), list):
        return shapely.GeometryCollection([geojson_shape(place, part) for part in geometry["geometries"]])
    if not isinstance(kind, str) or kind not in _DEPTHS:
        known = ", ".join(_DEPTHS)
        raise InvalidInputError(f"{place}: type: expected one of {known}, got {str(kind)[:40]!r}")
    coordinates = geometry.get("coordinates")
    _check_coordinates(place, coordinates, _DEPTHS[kind])
    try:
        return shapely.geometry.shape({"type": kind, "coordinates": coordinates})
    except (ValueError, TypeError, IndexError, shapely.errors.ShapelyError) as error:
        raise InvalidInputError(f"{place}: expected a {kind}, got: {error}") from None


def _check_coordinates(place: str, value: Any, depth: int) -> None:
    if not isinstance(value, list | tuple):
        raise InvalidInputError(f"{place}: coordinates: expected a list, got {str(value)[:40]!r}")
    if depth > 1:
        for part in value:
            _check_coordinates(place, part, depth - 1)
        return
    good = len(value) in (0, 2, 3) and all(type(x) in (int, float) and abs(x) <= 1e12 for x in value)
    if not good:
        raise InvalidInputError(
            f"{place}: coordinates: expected two finite numbers up to 1e12, got {str(value)[:60]}"
        )


def obstacle_polygons(place: str, shape: shapely.Geometry, repair: bool) -> list[shapely.Polygon]:
    """The polygons of an obstacle.

    Raises:
        InvalidInputError: It is a line or a point, or crosses itself.
    """
    parts = [part for part in shapely.get_parts(shape).tolist() if not part.is_empty]
    if any(isinstance(part, shapely.MultiPolygon | shapely.GeometryCollection) for part in parts):
        return [polygon for part in parts for polygon in obstacle_polygons(place, part, repair)]
    for part in parts:
        if not isinstance(part, shapely.Polygon):
            raise InvalidInputError(
                f"{place}: expected polygons, got a {part.geom_type} (role = 'ignore' leaves it out)"
            )
    if repair:
        mended = shapely.make_valid(np.array(parts, object), method="structure", keep_collapsed=False)
        parts = [part for part in shapely.get_parts(mended).tolist() if isinstance(part, shapely.Polygon)]
        return [part for whole in parts for part in shapely.get_parts(whole).tolist()]
    for part in parts:
        if not part.is_valid:
            reason = shapely.is_valid_reason(part)
            raise InvalidInputError(f"{place}: expected a simple polygon, got one with {reason}")
    return parts


def _around(obstacles: list[shapely.Polygon], margin: float) -> Box:
    xmin, ymin, xmax, ymax = shapely.total_bounds(np.array(obstacles, dtype=object)).tolist()
    room = margin * math.hypot(xmax - xmin, ymax - ymin)
    return (xmin - room, ymin - room, xmax + room, ymax + room)


def _projected(
    path: Path, shapes: Sequence[tuple[str, str, shapely.Geometry]]
) -> list[tuple[str, str, shapely.Geometry]]:
    """Longitude and latitude (degrees) as metres east and north of the map's centre."""
    box = shapely.total_bounds(np.array([shape for _, _, shape in shapes], dtype=object))
    if not (np.abs(box[[0, 2]]) <= 180).all() or not (np.abs(box[[1, 3]]) <= 89).all():
        raise StorageError(f"{path}: expected longitudes and latitudes in degrees, got {box.tolist()}")
    longitude, latitude = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    factors = EARTH * math.radians(1.0) * np.array([math.cos(math.radians(latitude)), 1.0])

    def metres(points: FloatArray) -> FloatArray:
        return np.asarray((points - [longitude, latitude]) * factors)

    return [(label, role, shapely.transform(shape, metres)) for label, role, shape in shapes]


def write_geojson(path: Path, environment: Environment) -> None:
    """Write an environment as GeoJSON, from which `read_geojson` makes the same one.

    Raises:
        StorageError: The file cannot be written.
    """
    bounds = shapely.box(*environment.bounds)
    rows = [
        json.dumps(
            {"type": "Feature", "properties": {"role": role}, "geometry": shapely.geometry.mapping(shape)}
        )
        for role, shape in (("bounds", bounds), *(("obstacle", one) for one in environment.obstacles))
    ]
    text = '{"type": "FeatureCollection", "features": [\n' + ",\n".join(rows) + "\n]}\n"
    write_whole(path, text)
