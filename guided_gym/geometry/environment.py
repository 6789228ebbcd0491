"""The workspace: a rectangle with polygonal obstacles."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
import numpy.typing as npt
import shapely
from shapely.geometry.base import BaseGeometry

from guided_gym.checks import affordable, integer, number, shown, vector
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.convex import Pieces, cover_polygons
from guided_gym.geometry.occupancy import cell_obstacles, occupied_cells
from guided_gym.geometry.packing import local_origin, pack
from guided_gym.kernels import collision

FloatArray = npt.NDArray[np.float64]
Bounds = tuple[float, float, float, float]
Ring = Sequence[Sequence[float]] | FloatArray


@doors
@dataclass(frozen=True)
class Environment:
    """An environment E (paper, section "Preliminaries"): bounds not to leave, obstacles not to touch.

    Attributes:
        bounds: (xmin, ymin, xmax, ymax), length units.
        obstacles: Polygons; they may have holes, overlap each other and stick out of the bounds.
            Multi-polygons are taken apart, and so are collections, of which only the polygons count. One
            polygon alone is one obstacle.

    Raises:
        InvalidInputError: Bounds that are not finite and ordered; an obstacle that is empty, non-finite,
            self-intersecting, not a polygon or wholly outside the bounds.
    """

    bounds: Bounds
    obstacles: tuple[shapely.Polygon, ...] = ()
    in_space: ClassVar[bool] = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "bounds", _checked_bounds(self.bounds))
        items = _as_items("obstacles", self.obstacles, "polygons")
        object.__setattr__(self, "obstacles", _checked_obstacles(items, self.bounds))

    @classmethod
    def from_polygons(cls, bounds: Sequence[float], rings: Iterable[Ring]) -> Environment:
        """An environment from the corners (V, 2) of each obstacle, closed or not."""
        polygons = []
        for place, ring in enumerate(_as_items("rings", rings, "rings of corners")):
            try:
                corners = np.asarray(ring, dtype=np.float64)
            except (TypeError, ValueError) as error:
                raise InvalidInputError(
                    f"obstacle {place}: corners must be numbers of shape (V, 2): {error}"
                ) from None
            if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 3:
                raise InvalidInputError(
                    f"obstacle {place}: expected corners (V, 2) with V >= 3, got shape {corners.shape}"
                )
            if not np.isfinite(corners).all():  # shapely would warn first
                raise InvalidInputError(f"obstacle {place}: expected finite corners, got NaN or infinity")
            polygons.append(shapely.Polygon(corners))
        return cls(_checked_bounds(bounds), tuple(polygons))

    @classmethod
    def from_occupancy(
        cls,
        occupancy: npt.ArrayLike,
        resolution: float,
        origin: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        unknown: str = "occupied",
        threshold: float = 0.5,
        simplify: float = 0.0,
        speckles: int = 1,
    ) -> Environment:
        """An environment from a raster: the exact union of its occupied cells, unless simplified.

        Args:
            occupancy: (rows, columns), row 0 at the bottom: booleans, True for occupied; integers, -1 for
                unknown, else 0 to 100 per cent; or floats, NaN for unknown, else 0 to 1.
            resolution: Side of a cell (length).
            origin: (x, y) or (x, y, yaw) of the lower left corner of cell [0, 0]; yaw in radians. Around a
                turned raster, the bounds are the rectangle that holds it, and their rest counts as unknown.
            unknown: ``"occupied"`` or ``"free"``: what unknown cells count as.
            threshold: Probability from which a cell is occupied.
            simplify: Boundaries may move by half of this (length): no passage wider than it opens or closes.
            speckles: Parts of fewer cells than this are left out.

        Raises:
            InvalidInputError: An array of another shape, type or range, or a number out of range.
        """
        occupied = occupied_cells(occupancy, unknown=unknown, threshold=threshold)
        cells = cell_obstacles(
            occupied,
            resolution,
            origin,
            simplify=simplify,
            speckles=speckles,
            outside=unknown == "occupied",
        )
        environment = cls(cells.bounds, cells.polygons)
        if cells.cover is not None:  # far fewer and sooner than by triangles
            environment.__dict__["cover"] = cells.cover
        return environment

    @cached_property
    def extent(self) -> float:
        """Diagonal of the bounds (length)."""
        xmin, ymin, xmax, ymax = self.bounds
        return float(np.hypot(xmax - xmin, ymax - ymin))

    @property
    def sides(self) -> dict[str, float]:
        """The bounds by name, the lower ones first."""
        return dict(zip(("xmin", "ymin", "xmax", "ymax"), self.bounds, strict=True))

    @cached_property
    def width(self) -> float:
        """Twice the area of the free space over the length of its boundary: a corridor's width."""
        free = self.free_space
        return 2.0 * free.area / free.length if free.length > 0 else self.extent

    @cached_property
    def least_width(self) -> float:
        """What `width` is at least: no obstacle takes more than its area, nor adds more than its boundary."""
        shapes = np.array(self.obstacles, dtype=object)
        xmin, ymin, xmax, ymax = self.bounds
        area = (xmax - xmin) * (ymax - ymin) - float(shapely.area(shapes).sum())
        return 2.0 * area / (2.0 * (xmax - xmin + ymax - ymin) + float(shapely.length(shapes).sum()))

    def magnitudes(self) -> tuple[float, float]:
        """The largest coordinate of the kernels' arrays, and that of the caller's bounds."""
        x, y = local_origin(self.bounds)
        xmin, ymin, xmax, ymax = self.bounds
        vertices = self.cover.vertices
        beyond = np.abs(vertices - (x, y) if x or y else vertices).max() if len(vertices) else 0.0
        local = max(abs(xmin - x), abs(ymin - y), abs(xmax - x), abs(ymax - y), float(beyond))
        return local, max(map(abs, self.bounds))

    def keeping(self, kept: Sequence[int]) -> Environment:
        """The same bounds with some of the obstacles, by their indices.

        Raises:
            InvalidInputError: There is no such obstacle.
        """
        n = len(self.obstacles)
        for i in kept:
            if not 0 <= integer("kept", i, least=0) < n:
                raise InvalidInputError(f"kept: expected obstacles 0 to {n - 1}, got {shown(i)}")
        return Environment(self.bounds, tuple(self.obstacles[i] for i in kept))

    def hulls(self) -> Environment:
        """The convex hull of each obstacle in its place."""
        return Environment(self.bounds, tuple(o.convex_hull for o in self.obstacles))

    def boxes(self) -> Environment:
        """The bounding box of each obstacle in its place."""
        return Environment(self.bounds, tuple(o.envelope for o in self.obstacles))

    def shrunk(self, margin: float) -> Environment:
        """The environment with obstacles that are smaller by a margin (length) all around; thin ones vanish.

        Raises:
            InvalidInputError: The margin is not a finite number.
        """
        margin = number("margin", margin, what="length")
        smaller = (o.buffer(-margin, join_style="mitre") for o in self.obstacles)
        return Environment(self.bounds, tuple(o for o in smaller if not o.is_empty))

    @cached_property
    def thinnest(self) -> float:
        """Diameter of the largest disc in the thinnest obstacle; 0 without any."""
        # The line from the disc's centre to its rim.
        inside = (2.0 * shapely.maximum_inscribed_circle(o).length for o in self.obstacles)
        return min(inside, default=0.0)

    def identity(self) -> Iterator[bytes]:
        """The obstacles, for fingerprints."""
        shapes = np.array(self.obstacles, dtype=object)
        yield from shapely.to_wkb(shapes, byte_order=1, include_srid=False).tolist()

    @cached_property
    def obstacle_union(self) -> shapely.Polygon | shapely.MultiPolygon:
        """The union of the obstacles; an empty MultiPolygon, whose distances are NaN, if there are none."""
        # Parts that touch nobody are left alone: a map of thousands is united in a twentieth of the time.
        parts = np.array(self.obstacles, dtype=object)
        return shapely.disjoint_subset_union_all(parts) if self.obstacles else shapely.MultiPolygon()

    @cached_property
    def free_space(self) -> shapely.Polygon | shapely.MultiPolygon:
        """The bounds minus the obstacles: where a point robot may be."""
        return shapely.box(*self.bounds).difference(self.obstacle_union)

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 (hex) of bounds and obstacles, the same in every process."""
        digest = hashlib.sha256(np.array(self.bounds, dtype="<f8").tobytes())
        for body in self.identity():
            digest.update(len(body).to_bytes(8, "little") + body)
        return digest.hexdigest()

    @cached_property
    def cover(self) -> Pieces:
        """Convex pieces that cover the obstacles exactly, in one array; they may overlap."""
        return cover_polygons(self.obstacles)

    @property
    def pieces(self) -> list[FloatArray]:
        """Convex pieces (V, 2) that cover the obstacles exactly; they may overlap."""
        return self.cover.arrays()

    @cached_property
    def point_geometry(self) -> collision.Geometry:
        """What the kernels take, for a point robot."""
        point = Pieces(np.zeros((1, 2)), np.array([1]))
        return pack(point, self.cover, self.bounds, 1e-9 * self.extent)

    def clearance(self, points: FloatArray | Sequence[float]) -> FloatArray:
        """Distance from points (..., 2) to the nearest obstacle or bound: (...), 0 inside an obstacle."""
        points = np.asarray(points, dtype=np.float64)
        if points.ndim < 1 or points.shape[-1] != 2:
            raise InvalidInputError(f"expected points of shape (..., 2), got shape {points.shape}")
        flat = np.require(points.reshape(-1, 2), requirements=["C", "W"])
        return collision.pose_clearances(flat, self.point_geometry).reshape(points.shape[:-1])

    def raster(self, n: int) -> npt.NDArray[np.uint8]:
        """Occupancy of n x n cells over the bounds: uint8 (n, n), 1 where a cell's centre is in an obstacle.

        Row = y from the bottom up, column = x from left to right, so `raster[row, column]`. The array is a
        fresh copy.

        Raises:
            InvalidInputError: n is not positive.
        """
        side = integer("raster", n, least=1)
        affordable("raster", n, 24 * side * side, "a raster of the workspace")
        xmin, ymin, xmax, ymax = self.bounds
        centres = (np.arange(n) + 0.5) / n
        x, y = xmin + centres * (xmax - xmin), ymin + centres * (ymax - ymin)
        occupied = np.zeros((n, n), dtype=np.uint8)
        boxes = shapely.bounds(np.array(self.obstacles, dtype=object)).reshape(-1, 4)
        lefts, rights = np.searchsorted(x, boxes[:, 0]), np.searchsorted(x, boxes[:, 2], side="right")
        bottoms, tops = np.searchsorted(y, boxes[:, 1]), np.searchsorted(y, boxes[:, 3], side="right")
        for obstacle, left, right, bottom, top in zip(
            self.obstacles, lefts, rights, bottoms, tops, strict=True
        ):
            if left < right and bottom < top:
                shapely.prepare(obstacle)
                here = shapely.intersects_xy(obstacle, *np.meshgrid(x[left:right], y[bottom:top]))
                occupied[bottom:top, left:right] |= here.astype(np.uint8)
        return occupied


def _as_items(what: str, values: object, kind: str) -> list[object]:
    if isinstance(values, BaseGeometry):
        return [values]
    try:
        return list(values)  # type: ignore[call-overload, no-any-return]
    except TypeError:
        raise InvalidInputError(f"{what}: expected a sequence of {kind}, got {shown(values)}") from None


def _checked_bounds(bounds: Sequence[float]) -> Bounds:
    xmin, ymin, xmax, ymax = vector("bounds", bounds, 4).tolist()
    if not (xmin < xmax and ymin < ymax):
        raise InvalidInputError(
            f"bounds: expected (xmin, ymin, xmax, ymax) with xmin < xmax and ymin < ymax, got {shown(bounds)}"
        )
    return xmin, ymin, xmax, ymax


def _checked_obstacles(items: list[object], bounds: Bounds) -> tuple[shapely.Polygon, ...]:
    """The polygons that the items consist of, each of them checked."""
    if all(isinstance(item, shapely.Polygon) for item in items):
        shapes = np.empty(len(items), dtype=object)
        shapes[:] = items
        # What is valid is finite, and what meets something is not empty.
        if (
            shapely.is_valid(shapes).all()
            and (shapely.intersects(shapely.box(*bounds), shapes) > shapely.has_z(shapes)).all()
        ):
            return tuple(items)  # type: ignore[arg-type]
    polygons = [part for number, item in enumerate(items) for part in _checked_obstacle(number, item, bounds)]
    return tuple(polygons)


def _checked_obstacle(number: int, obstacle: object, bounds: Bounds) -> list[shapely.Polygon]:
    if not isinstance(obstacle, shapely.Polygon | shapely.MultiPolygon | shapely.GeometryCollection):
        kind = getattr(obstacle, "geom_type", type(obstacle).__name__)
        raise InvalidInputError(f"obstacle {number}: expected a Polygon or MultiPolygon, got {kind}")
    if not np.isfinite(shapely.get_coordinates(obstacle)).all():
        raise InvalidInputError(f"obstacle {number}: expected finite coordinates, got NaN or infinity")
    polygons = _polygons_in(shapely.force_2d(obstacle))
    if not polygons:
        held = sorted({part.geom_type for part in getattr(obstacle, "geoms", ())})
        raise InvalidInputError(
            f"obstacle {number}: expected a polygon with an area, got "
            + (f"a collection of {' and '.join(held)} only" if held else "an empty one")
        )
    # Polygons of a collection may overlap, as obstacles may; those of a MultiPolygon may not.
    for shape in polygons if type(obstacle) is shapely.GeometryCollection else [obstacle]:
        if not shape.is_valid:
            raise InvalidInputError(
                f"obstacle {number}: expected a simple polygon, got one with {shapely.is_valid_reason(shape)}"
            )
    if not shapely.intersects(shapely.box(*bounds), polygons).any():
        raise InvalidInputError(
            f"obstacle {number}: expected a polygon that meets the bounds {bounds}, got {obstacle.bounds}"
        )
    return polygons


def _polygons_in(shape: BaseGeometry) -> list[shapely.Polygon]:
    """The polygons that have an area, of a geometry and all that it holds."""
    if isinstance(shape, shapely.Polygon):
        return [] if shape.is_empty else [shape]
    return [polygon for part in getattr(shape, "geoms", ()) for polygon in _polygons_in(part)]
