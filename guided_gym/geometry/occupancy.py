"""Rasters as polygons, the exact union of occupied cells in a few array operations; polygons as rasters."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import shapely

from guided_gym.checks import affordable, integer, number, shown
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.convex import Pieces

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
FloatArray = npt.NDArray[np.float64]

# Which of the four cells around a grid vertex are occupied.
_BELOW_LEFT, _BELOW_RIGHT, _ABOVE_LEFT, _ABOVE_RIGHT = 1, 2, 4, 8
# The corners of the boundary at a vertex with that code. Of each: an occupied cell on its inner side, where
# its horizontal edge goes (-1 left, 1 right), where its vertical edge goes (-1 down, 1 up), and whether one
# who walks with the occupied side on his left leaves it along the horizontal edge. Where two cells meet in a
# point only, each has a corner of its own: they are two polygons that touch.
_Corner = tuple[int, int, int, bool]
_CORNERS: dict[int, tuple[_Corner, ...]] = {
    1: ((_BELOW_LEFT, -1, -1, True),),
    2: ((_BELOW_RIGHT, 1, -1, False),),
    4: ((_ABOVE_LEFT, -1, 1, False),),
    8: ((_ABOVE_RIGHT, 1, 1, True),),
    14: ((_ABOVE_RIGHT, -1, -1, False),),
    13: ((_ABOVE_LEFT, 1, -1, True),),
    11: ((_BELOW_RIGHT, -1, 1, True),),
    7: ((_BELOW_LEFT, 1, 1, False),),
    9: ((_BELOW_LEFT, -1, -1, True), (_ABOVE_RIGHT, 1, 1, True)),
    6: ((_BELOW_RIGHT, 1, -1, False), (_ABOVE_LEFT, -1, 1, False)),
}


MOST_CELLS: Final = 2**26
"""Cells of the largest raster that is taken: 8,192 x 8,192."""

_CORNER_BYTES: Final = 300
"""Bytes that a corner takes until it is part of an obstacle, about."""

_EDGE: Final = 1e-6
"""Cells: what lies less deep in a cell only touches it."""

UNKNOWN: Final = ("occupied", "free")
"""What cells of which nothing is known may count as."""


@dataclass(frozen=True)
class CellObstacles:
    """The obstacles of a raster.

    Attributes:
        bounds: (xmin, ymin, xmax, ymax) of the raster (length).
        polygons: The union of the occupied cells, part by part.
        cover: Convex pieces that cover the polygons exactly, few of them; None where that is not known.
    """

    bounds: tuple[float, float, float, float]
    polygons: tuple[shapely.Polygon, ...]
    cover: Pieces | None


def occupied_cells(array: object, *, unknown: str = "occupied", threshold: float = 0.5) -> BoolArray:
    """Which cells count as occupied.

    Args:
        array: (rows, columns) of booleans; of integers, -1 for unknown, else 0 to 100 per cent, as in ROS; or
            of floats, NaN for unknown, else 0 to 1.
        unknown: ``"occupied"`` or ``"free"``: what cells of which nothing is known count as.
        threshold: Probability from which a cell is occupied, above 0.

    Raises:
        InvalidInputError: Another shape, type, value or word, or more than `MOST_CELLS` cells.
    """
    cells = np.asarray(array)
    if cells.ndim != 2 or not 0 < cells.size <= MOST_CELLS:
        raise InvalidInputError(
            f"occupancy: expected an array (rows, columns) of 1 to {MOST_CELLS} cells, got {cells.shape}"
        )
    if unknown not in UNKNOWN:
        raise InvalidInputError(f"unknown: expected one of {', '.join(UNKNOWN)}, got {shown(unknown)}")
    threshold = number("threshold", threshold, above=0)
    if cells.dtype == bool:
        return np.array(cells)
    if cells.dtype.kind in "iu":
        least, most, nothing = -1, 100, cells == -1
        full = cells >= 100.0 * threshold
    elif cells.dtype.kind == "f":
        least, most, nothing = 0, 1, np.isnan(cells)
        full = cells >= threshold
    else:
        raise InvalidInputError(f"occupancy: expected booleans or numbers, got an array of {cells.dtype}")
    wrong = ~nothing & ((cells < least) | (cells > most))
    if wrong.any():
        row, column = np.argwhere(wrong)[0].tolist()
        raise InvalidInputError(
            f"occupancy: expected {least} to {most}, got {cells[row, column]} in row {row}, column {column}"
        )
    return np.asarray(full | nothing if unknown == "occupied" else full & ~nothing)


def cell_obstacles(
    occupied: BoolArray,
    resolution: float,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    simplify: float = 0.0,
    speckles: int = 1,
    outside: bool = True,
) -> CellObstacles:
    """The obstacles of a raster of occupied cells.

    Args:
        occupied: (rows, columns), row 0 at the bottom.
        resolution: Side of a cell (length).
        origin: (x, y) or (x, y, yaw) of the lower left corner of cell [0, 0].
        simplify: Boundaries may move by half of this (length), so that no passage wider than it opens or
            closes; 0 for the exact union of the cells.
        speckles: Parts of fewer cells (joined by edges or corners) are left out.
        outside: Whether what lies in the bounds of a turned raster, but not in the raster, is an obstacle.

    Raises:
        InvalidInputError: A number out of range, or boundaries that would take more memory than is allowed.
    """
    resolution = number("resolution", resolution, above=0, what="length")
    simplify = number("simplify", simplify, least=0, what="length")
    try:
        pose = [number("origin", float(value)) for value in origin]
    except (TypeError, ValueError):
        pose = []
    if len(pose) not in (2, 3):
        raise InvalidInputError(f"origin: expected finite (x, y) or (x, y, yaw), got {shown(origin)}")
    if abs(yaw := (*pose, 0.0)[2]) > 2.0 * math.pi:
        raise InvalidInputError(f"origin: expected a yaw of -2 pi to 2 pi (radians), got {shown(yaw)}")
    if integer("speckles", speckles, least=1) > 1:
        occupied = without_speckles(occupied, speckles)
    rows, columns = occupied.shape
    c, s = math.cos(yaw), math.sin(yaw)

    def placed(cells: FloatArray) -> FloatArray:
        x, y = np.asarray(cells, np.float64).reshape(-1, 2).T * resolution
        turned = (x, y) if yaw == 0 else (c * x - s * y, s * x + c * y)
        return np.stack([pose[0] + turned[0], pose[1] + turned[1]], axis=1)

    frame = placed(np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]]))
    low, high = frame.min(axis=0).tolist(), frame.max(axis=0).tolist()
    polygons = shapely.transform(np.array(cell_polygons(occupied), dtype=object), placed).tolist()
    pieces: list[FloatArray] | None = None
    if simplify > 0:
        polygons = shapely.simplify(np.array(polygons, dtype=object), simplify / 2.0).tolist()
    else:
        x0, y0, x1, y1 = cell_rectangles(occupied).T
        pieces = list(placed(np.stack([x0, y0, x1, y0, x1, y1, x0, y1], axis=1)).reshape(-1, 4, 2))
    if outside and yaw != 0:
        rest = shapely.get_parts(shapely.box(*low, *high).difference(shapely.Polygon(frame))).tolist()
        polygons += rest
        if pieces is not None:
            pieces += [shapely.get_coordinates(part)[:-1] for part in shapely.orient_polygons(rest)]
    return CellObstacles((*low, *high), tuple(polygons), None if pieces is None else _joined(pieces))


def covered_cells(
    shape: shapely.Geometry, bounds: tuple[float, float, float, float], resolution: float
) -> BoolArray:
    """Cells of a raster that a shape reaches into, or that leave the bounds: (rows, columns), from below.

    So what is free in the raster is free in the workspace. Of a union of cells of this raster, just those.

    Args:
        shape: Polygons.
        bounds: (xmin, ymin, xmax, ymax) length; the lower left corner is that of cell [0, 0].
        resolution: Side of a cell (length).

    Raises:
        InvalidInputError: A resolution that is not positive, or more than `MOST_CELLS` cells.
    """
    resolution = number("resolution", resolution, above=0, what="length")
    low = np.array(bounds[:2])
    extent = (np.array(bounds[2:]) - low) / resolution
    if extent.max() > MOST_CELLS or np.prod(np.ceil(extent)) > MOST_CELLS:
        raise InvalidInputError(
            f"resolution: expected at most {MOST_CELLS} cells, got {extent[0]:.4g} x {extent[1]:.4g}"
        )
    columns, rows = np.maximum(np.ceil(extent - _EDGE), 1).astype(int).tolist()
    covered = np.zeros((rows, columns), bool)
    covered[:, int(extent[0] + _EDGE) :] = covered[int(extent[1] + _EDGE) :] = True
    shapely.prepare(shape)
    size, corners = 1 << (max(rows, columns) - 1).bit_length(), np.zeros((1, 2), np.int64)
    while len(corners):  # blocks that are neither all covered nor all free are cut into four
        ends = np.minimum(corners + size, [columns, rows])
        blocks = shapely.box(
            *(low + resolution * (corners + _EDGE)).T, *(low + resolution * (ends - _EDGE)).T
        )
        reached = shapely.intersects(shape, blocks)
        corners, ends, blocks = corners[reached], ends[reached], blocks[reached]
        full = np.ones(len(blocks), bool) if size == 1 else shapely.contains(shape, blocks)
        for (left, bottom), (right, top) in zip(corners[full].tolist(), ends[full].tolist(), strict=True):
            covered[bottom:top, left:right] = True
        size //= 2
        quarters = size * np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
        corners = (corners[~full][:, None] + quarters).reshape(-1, 2)
        corners = corners[(corners < [columns, rows]).all(axis=1)]
    return covered


def _joined(pieces: list[FloatArray]) -> Pieces:
    """Convex pieces (V, 2) each as one array."""
    vertices = np.concatenate(pieces) if pieces else np.zeros((0, 2))
    return Pieces(np.ascontiguousarray(vertices), np.cumsum([len(piece) for piece in pieces], dtype=np.int64))


def cell_polygons(occupied: BoolArray) -> list[shapely.Polygon]:
    """The union of the occupied cells as polygons with holes, one for each part that is connected by edges.

    Exact: each vertex is a corner of cells, and none lies on a straight edge. Parts that meet in a point
    only are polygons that touch there.

    Args:
        occupied: (rows, columns); cell [i, j] is the unit square from (j, i) to (j + 1, i + 1).
    """
    if not occupied.any():
        return []
    from scipy import ndimage

    labels, count = ndimage.label(occupied)
    vertices, owner, across, up, turn = _corners(occupied, labels)
    rings = _rings(vertices, *_links(vertices, across, up), turn.astype(bool))
    sizes = np.array([len(ring) for ring in rings])
    firsts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    points = vertices[np.concatenate(rings)].astype(np.float64)
    shapes = shapely.linearrings(points, indices=np.repeat(np.arange(len(rings)), sizes))
    return _assembled(shapes, _areas(points, firsts, sizes) > 0, owner[[r[0] for r in rings]] - 1, count)


def _corners(occupied: BoolArray, labels: npt.NDArray[Any]) -> tuple[IntArray, ...]:
    """(n, 2) x and y of the corners, and (n,) of each: its part, where its edges go, and which one leaves."""
    padded = np.pad(occupied, 1).astype(np.uint8)
    code = padded[:-1, :-1] * np.uint8(_BELOW_LEFT) + padded[:-1, 1:] * np.uint8(_BELOW_RIGHT)
    code += padded[1:, :-1] * np.uint8(_ABOVE_LEFT) + padded[1:, 1:] * np.uint8(_ABOVE_RIGHT)
    number_of = sum(
        int(np.count_nonzero(code == value)) * len(corners) for value, corners in _CORNERS.items()
    )
    affordable("occupancy", number_of, number_of * _CORNER_BYTES, "boundaries with so many corners")
    around = np.pad(labels, 1)
    columns: list[IntArray] = []
    for value, corners in _CORNERS.items():
        y, x = np.nonzero(code == value)
        for cell, across, up, leaves in corners:
            owner = around[y + (cell >= _ABOVE_LEFT), x + (cell in (_BELOW_RIGHT, _ABOVE_RIGHT))]
            same = (np.full(len(x), number) for number in (across, up, leaves))
            columns.append(np.stack([x, y, owner, *same]))
    x, y, owner, across_, up_, turn = np.concatenate(columns, axis=1)
    return np.stack([x, y], axis=1), owner, across_, up_, turn


def _links(vertices: IntArray, across: IntArray, up: IntArray) -> tuple[IntArray, IntArray]:
    """(n,) the corner at the other end of each corner's horizontal edge, and of its vertical edge.

    Along a row of grid vertices, edges begin and end by turns.
    """
    x, y = vertices.T
    horizontal, vertical = np.empty(len(x), np.int64), np.empty(len(x), np.int64)
    for link, order in ((horizontal, np.lexsort((across, x, y))), (vertical, np.lexsort((up, y, x)))):
        link[order[0::2]], link[order[1::2]] = order[1::2], order[0::2]
    return horizontal, vertical


def _rings(vertices: IntArray, horizontal: IntArray, vertical: IntArray, turn: BoolArray) -> list[list[int]]:
    """Indices of the corners around each simple ring, the occupied side on the left."""
    following = np.where(turn, horizontal, vertical).tolist()
    places = (vertices[:, 1] * (int(vertices[:, 0].max()) + 1) + vertices[:, 0]).tolist()
    seen = bytearray(len(places))
    rings: list[list[int]] = []
    for start in range(len(places)):
        ring: list[int] = []
        here = start
        while not seen[here]:
            seen[here] = 1
            ring.append(here)
            here = following[here]
        if ring:
            rings.extend(_simple(ring, places))
    return rings


def _simple(ring: list[int], places: list[int]) -> list[list[int]]:
    """A ring cut into rings that do not touch themselves."""
    if len({places[i] for i in ring}) == len(ring):
        return [ring]
    rings: list[list[int]] = []
    walked: list[int] = []
    at: dict[int, int] = {}
    for i in ring:
        if places[i] in at:
            first = at[places[i]]
            loop = walked[first:]
            rings.append(loop)
            for j in loop:
                del at[places[j]]
            del walked[first:]
        at[places[i]] = len(walked)
        walked.append(i)
    return [*rings, walked]


def _areas(points: FloatArray, firsts: IntArray, sizes: IntArray) -> FloatArray:
    """Twice the signed area of each ring: positive for one around a part, negative around a hole."""
    after = np.arange(len(points)) + 1
    after[firsts + sizes - 1] = firsts
    x, y = points.T
    return np.asarray(np.add.reduceat(x * y[after] - x[after] * y, firsts))


def _assembled(
    rings: npt.NDArray[np.object_], outer: BoolArray, part: IntArray, count: int
) -> list[shapely.Polygon]:
    """The polygons of all parts from the ring around each and those around its holes."""
    shells = np.empty(count, dtype=object)
    shells[part[outer]] = rings[outer]
    polygons: list[shapely.Polygon] = list(shapely.polygons(shells))
    holes: dict[int, list[shapely.LinearRing]] = {}
    for index in np.flatnonzero(~outer).tolist():
        holes.setdefault(int(part[index]), []).append(rings[index])
    for index, cut in holes.items():
        polygons[index] = shapely.polygons(shells[index], cut)
    return polygons


def cell_rectangles(occupied: BoolArray) -> IntArray:
    """Rectangles that cover the occupied cells and nothing else, without overlap.

    Runs along a row, joined with an equal run in the row above.

    Returns:
        (n, 4) column and row where each begins, and where it ends.
    """
    padded = np.pad(occupied, ((1, 1), (1, 1))).astype(np.int8)
    edges = np.diff(padded[1:-1], axis=1)
    rows, first = np.nonzero(edges == 1)
    last = np.nonzero(edges == -1)[1]
    order = np.lexsort((rows, last, first))
    rows, first, last = rows[order], first[order], last[order]
    if not rows.size:
        return np.zeros((0, 4), np.int64)
    begins = np.ones(len(rows), bool)
    begins[1:] = (np.diff(first) != 0) | (np.diff(last) != 0) | (np.diff(rows) != 1)
    heads = np.flatnonzero(begins)
    tails = np.append(heads[1:], len(rows)) - 1
    return np.stack([first[heads], rows[heads], last[heads], rows[tails] + 1], axis=1)


def without_speckles(occupied: BoolArray, cells: int) -> BoolArray:
    """The raster without the parts (joined by edges or corners) of fewer than that many cells."""
    from scipy import ndimage

    labels, _ = ndimage.label(occupied, np.ones((3, 3), int))
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray(sizes[labels] >= max(cells, 1))
