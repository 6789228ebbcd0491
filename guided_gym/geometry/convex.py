"""Convex decomposition of planar shapes, the one form in which the collision kernels see them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import shapely

from guided_gym.errors import InvalidInputError
from guided_gym.kernels.convex import convex_rings, merge_triangles

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

_LOST_AREA = 1e-9
"""Part of a polygon's area that rounding may cost its triangulation; more would be a hole in an obstacle."""


class Pieces(NamedTuple):
    """Convex pieces: one vertex for a point, two for a segment, counter-clockwise vertices for a polygon."""

    vertices: FloatArray  # [n, 2] float64, of all pieces, one piece after the other (length)
    ends: IntArray  # [p] int64, where each piece ends in the vertices

    @property
    def starts(self) -> IntArray:
        """Where each piece begins in the vertices (p,)."""
        starts = np.zeros_like(self.ends)
        starts[1:] = self.ends[:-1]
        return starts

    def arrays(self) -> list[FloatArray]:
        """The pieces apart, (V, 2) each."""
        return np.split(self.vertices, self.ends[:-1]) if len(self.ends) else []

    def taken(self, order: IntArray) -> Pieces:
        """These pieces in another order, or some of them."""
        starts = self.starts
        sizes = (self.ends - starts)[order]
        ends = np.cumsum(sizes)
        rows = np.arange(ends[-1] if len(ends) else 0) + np.repeat(starts[order] - (ends - sizes), sizes)
        return Pieces(self.vertices[rows], ends)


def convex_pieces(shape: shapely.Geometry) -> list[FloatArray]:
    """Cut a point, polyline, polygon or multi-polygon into convex pieces that cover it exactly.

    Every vertex of a piece is a vertex of the shape; nothing is moved or added. The pieces of a polygon
    (holes allowed) come from its constrained Delaunay triangulation, with triangles merged while the result
    stays convex.

    Args:
        shape: A valid, non-empty shapely geometry.

    Returns:
        Arrays (V, 2): one vertex for a point, two for a segment, counter-clockwise vertices for a polygon.

    Raises:
        InvalidInputError: The polygon is so nearly degenerate that its triangulation loses area.
    """
    return cover(shape).arrays()


def cover(shape: shapely.Geometry) -> Pieces:
    """`convex_pieces` in one array."""
    if isinstance(shape, shapely.Point):
        return Pieces(np.array([[shape.x, shape.y]]), np.array([1]))
    if isinstance(shape, shapely.LineString):
        line = shapely.get_coordinates(shapely.remove_repeated_points(shape))
        ends = np.arange(2, 2 * len(line), 2)
        return Pieces(np.repeat(line, 2, axis=0)[1:-1], ends)
    return cover_polygons([shape] if isinstance(shape, shapely.Polygon) else shapely.get_parts([shape]))


def cover_polygons(polygons: Sequence[shapely.Polygon] | npt.NDArray[np.object_]) -> Pieces:
    """`convex_pieces` of many polygons at once, in their order.

    Raises:
        InvalidInputError: A polygon is so nearly degenerate that its triangulation loses area.
    """
    shapes = np.asarray(polygons, dtype=object)
    holes = shapely.get_num_interior_rings(shapes)
    rings = shapes[holes == 0] if holes.any() else shapes
    counts = shapely.get_num_coordinates(rings)
    vertices, sizes, ends, convex_all = convex_rings(shapely.get_coordinates(rings), counts)
    if convex_all and len(sizes) == len(shapes):
        return Pieces(vertices, ends)
    convex = np.flatnonzero(holes == 0)[sizes > 0]
    others = np.ones(len(shapes), dtype=bool)
    others[convex] = False
    concave = np.flatnonzero(others)
    more, more_sizes, of = _merged(shapes[concave])
    pieces = Pieces(
        np.concatenate((vertices, more)), np.cumsum(np.concatenate((sizes[sizes > 0], more_sizes)))
    )
    return pieces.taken(np.argsort(np.concatenate((convex, concave[of])), kind="stable"))


def _merged(shapes: npt.NDArray[np.object_]) -> tuple[FloatArray, IntArray, IntArray]:
    """Pieces of polygons that are not convex: their vertices, how many a piece has, and its polygon."""
    corners, of = _triangles(shapes)
    edges, of_edge = _diagonals(corners, of)
    counts = np.bincount(of, minlength=len(shapes)), np.bincount(of_edge, minlength=len(shapes))
    return merge_triangles(corners.reshape(-1, 2), np.cumsum(counts[0]), edges, np.cumsum(counts[1]))


def _triangles(shapes: npt.NDArray[np.object_]) -> tuple[FloatArray, IntArray]:
    """Constrained Delaunay triangles (t, 3, 2), counter-clockwise, and the number of each one's polygon."""
    collections = shapely.constrained_delaunay_triangles(shapely.remove_repeated_points(shapes))
    triangles, of = shapely.get_parts(collections, return_index=True)
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3].copy()
    sides = corners[:, 1:] - corners[:, :1]
    areas = 0.5 * (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    clockwise = ~(areas > 0)
    corners[clockwise] = corners[clockwise, ::-1]
    covered = np.bincount(of, np.abs(areas), minlength=len(shapes))
    wanted = shapely.area(shapes)
    lost = ~(np.abs(covered - wanted) <= _LOST_AREA * wanted)
    if lost.any():
        worst = int(np.argmax(lost))
        raise InvalidInputError(
            f"expected a polygon that can be triangulated, got one of area {wanted[worst]:.9g} of which "
            f"the triangles cover {covered[worst]:.9g} (are some of its vertices almost on its edges?)"
        )
    return corners, of


def _diagonals(corners: FloatArray, of: IntArray) -> tuple[IntArray, IntArray]:
    """Edges that two triangles of a polygon share, and the polygon: of each polygon the longest first.

    Edge e runs from corner e of all the triangles to the next one of its triangle; a row holds an edge that
    runs from left to right (or up) and its reverse.
    """
    number = np.unique(corners.reshape(-1, 2).view(np.complex128), return_inverse=True)[1].reshape(-1, 3)
    begin, end = number.ravel(), np.roll(number, -1, axis=1).ravel()
    low, high, shape = np.minimum(begin, end), np.maximum(begin, end), np.repeat(of, 3)
    order = np.lexsort((begin, high, low, shape))
    a, b = order[:-1], order[1:]
    shared = (low[a] == low[b]) & (high[a] == high[b]) & (shape[a] == shape[b])
    edges = np.column_stack((a[shared], b[shared]))
    along = corners.reshape(-1, 2)[edges[:, 1]] - corners.reshape(-1, 2)[edges[:, 0]]
    start, length = edges[:, 0], np.einsum("ij,ij->i", along, along)
    order = np.lexsort((high[start], low[start], -length, shape[start]))
    return edges[order], shape[start[order]]
