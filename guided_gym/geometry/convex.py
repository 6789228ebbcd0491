"""Convex decomposition of planar shapes, the one form in which the collision kernels see them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import shapely

from guided_gym.errors import InvalidInputError

FloatArray = npt.NDArray[np.float64]
Vertex = tuple[float, float]
Diagonal = tuple[Vertex, Vertex, int, int]

_COLLINEAR = 1e-13
"""Sine below which three vertices count as collinear: a sagitta far below every collision tolerance."""

_LOST_AREA = 1e-9
"""Part of a polygon's area that rounding may cost its triangulation; more would be a hole in an obstacle."""

_MANY_DIAGONALS = 16
"""Beyond this many diagonals, fewer orders of dropping them are tried."""


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
    if isinstance(shape, shapely.Point):
        return [np.array([[shape.x, shape.y]])]
    if isinstance(shape, shapely.LineString):
        line = np.array(shape.coords)[:, :2]
        return [np.array(line[i : i + 2]) for i in range(len(line) - 1)]
    if isinstance(shape, shapely.MultiPolygon):
        return [piece for part in shape.geoms for piece in convex_pieces(part)]
    ring = _without_collinear(
        [(x, y) for x, y, *_ in shapely.remove_repeated_points(shape).exterior.coords[:-1]]
    )
    if not shapely.get_num_interior_rings(shape):
        ring = ring if _signed_area(ring) > 0 else ring[::-1]
        if _is_convex(ring):
            return [np.array(ring)]
    triangles = _triangles(shape)
    covered = sum(_signed_area(triangle) for triangle in triangles)
    if not abs(covered - shape.area) <= _LOST_AREA * shape.area:
        raise InvalidInputError(
            f"expected a polygon that can be triangulated, got one of area {shape.area:.9g} of which "
            f"the triangles cover {covered:.9g} (are some of its vertices almost on its edges?)"
        )
    return [np.array(piece) for piece in _merge_triangles(triangles)]


def _triangles(polygon: shapely.Polygon) -> list[list[Vertex]]:
    """Constrained Delaunay triangles of the polygon, counter-clockwise."""
    collection = shapely.constrained_delaunay_triangles(shapely.remove_repeated_points(polygon))
    triangles = []
    for triangle in collection.geoms:
        corners: list[Vertex] = [(x, y) for x, y, *_ in triangle.exterior.coords[:3]]
        triangles.append(corners if _signed_area(corners) > 0 else corners[::-1])
    return triangles


def _merge_triangles(triangles: list[list[Vertex]]) -> list[list[Vertex]]:
    """The fewest convex pieces that dropping diagonals in one of several orders leaves."""
    diagonals = _diagonals(triangles)
    orders = [diagonals, diagonals[::-1]]
    if len(diagonals) <= _MANY_DIAGONALS:
        orders += [diagonals[i:] + diagonals[:i] for i in range(1, len(diagonals))]
    return min((_dropped(triangles, order) for order in orders), key=len)


def _dropped(triangles: list[list[Vertex]], diagonals: list[Diagonal]) -> list[list[Vertex]]:
    """Hertel-Mehlhorn: drop each diagonal in turn whose removal leaves a convex piece."""
    pieces: dict[int, list[Vertex]] = dict(enumerate(triangles))
    owner = list(range(len(triangles)))

    def find(i: int) -> int:
        while owner[i] != i:
            owner[i] = owner[owner[i]]
            i = owner[i]
        return i

    for start, end, left, right in diagonals:
        i, j = find(left), find(right)
        if i == j:
            continue
        merged = _joined(pieces[i], pieces[j], start, end)
        if _is_convex(merged):
            pieces[i] = merged
            owner[j] = i
            del pieces[j]
    return [_without_collinear(piece) for piece in pieces.values()]


def _diagonals(triangles: list[list[Vertex]]) -> list[Diagonal]:
    """Shared edges as (start, end, triangle with it, triangle with its reverse), longest first."""
    edges = {(t[k], t[(k + 1) % 3]): i for i, t in enumerate(triangles) for k in range(3)}
    shared = [
        (start, end, i, edges[end, start])
        for (start, end), i in edges.items()
        if start < end and (end, start) in edges
    ]
    return sorted(shared, key=lambda d: (-((d[0][0] - d[1][0]) ** 2 + (d[0][1] - d[1][1]) ** 2), d[0], d[1]))


def _joined(a: list[Vertex], b: list[Vertex], start: Vertex, end: Vertex) -> list[Vertex]:
    """The union of two pieces along the edge start -> end of `a` (end -> start in `b`)."""
    i, j = a.index(start), b.index(end)
    around_a = a[i + 1 :] + a[: i + 1]  # end ... start
    around_b = b[j + 1 :] + b[: j + 1]  # start ... end
    return around_a + around_b[1:-1]


def _corner_sine(p: Vertex, q: Vertex, r: Vertex) -> float:
    """Sine of the left turn at q."""
    ux, uy, vx, vy = q[0] - p[0], q[1] - p[1], r[0] - q[0], r[1] - q[1]
    lengths = math.hypot(ux, uy) * math.hypot(vx, vy)
    return (ux * vy - uy * vx) / lengths if lengths > 0 else 0.0


def _corners(ring: list[Vertex]) -> Iterable[tuple[Vertex, Vertex, Vertex]]:
    return ((ring[i - 1], ring[i], ring[(i + 1) % len(ring)]) for i in range(len(ring)))


def _is_convex(ring: list[Vertex]) -> bool:
    return all(_corner_sine(*corner) >= -_COLLINEAR for corner in _corners(ring))


def _without_collinear(ring: list[Vertex]) -> list[Vertex]:
    kept = [q for p, q, r in _corners(ring) if abs(_corner_sine(p, q, r)) > _COLLINEAR]
    return kept if len(kept) >= 3 else ring


def _signed_area(ring: list[Vertex]) -> float:
    x0, y0 = ring[0]
    return 0.5 * sum(
        (p[0] - x0) * (q[1] - y0) - (p[1] - y0) * (q[0] - x0) for p, q in itertools.pairwise(ring[1:])
    )


def pack(
    robot_pieces: list[FloatArray],
    obstacle_pieces: list[FloatArray],
    bounds: tuple[float, float, float, float],
    tolerance: float,
) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Pack convex pieces and bounds into the arrays of `guided_gym.kernels.collision` (layout there).

    Args:
        robot_pieces: Arrays (V, 2) in the body frame.
        obstacle_pieces: Arrays (V, 2) in the workspace.
        bounds: (xmin, ymin, xmax, ymax); its sides become four half-planes.
        tolerance: Gap up to which a pose counts as colliding.

    Returns:
        The float64 and the int64 array of a `Geometry`.
    """
    radius = max(float(np.hypot(*piece.T).max()) for piece in robot_pieces)
    numbers: list[float] = [tolerance, 1.001 * tolerance, radius]
    rows: list[int] = []
    for piece in robot_pieces:
        vertices = np.column_stack((piece, np.hypot(*piece.T)))
        _append_piece(numbers, rows, vertices, _outward_axes(piece))
    for piece in obstacle_pieces:
        _append_piece(numbers, rows, piece, _outward_axes(piece))
    xmin, ymin, xmax, ymax = bounds
    inf = float("inf")
    half_planes = [(1.0, 0.0, xmin), (-1.0, 0.0, -xmax), (0.0, 1.0, ymin), (0.0, -1.0, -ymax)]
    for half_plane in half_planes:
        _append_piece(numbers, rows, np.empty((0, 2)), np.array([half_plane]))
    boxes = [(*piece.min(axis=0), *piece.max(axis=0)) for piece in obstacle_pieces]
    boxes += [
        (-inf, -inf, xmin, inf),
        (xmax, -inf, inf, inf),
        (-inf, -inf, inf, ymin),
        (-inf, ymax, inf, inf),
    ]
    header = [len(robot_pieces), len(boxes), len(numbers)]
    numbers.extend(np.array(boxes).ravel())
    return np.array(numbers, dtype=np.float64), np.array(header + rows, dtype=np.int64)


def _append_piece(numbers: list[float], rows: list[int], vertices: FloatArray, axes: FloatArray) -> None:
    rows += [len(numbers), len(vertices), len(numbers) + vertices.size, len(axes)]
    numbers.extend(vertices.ravel())
    numbers.extend(axes.ravel())


def _outward_axes(piece: FloatArray) -> FloatArray:
    """Rows (nx, ny, max n.v): unit outward normals of a counter-clockwise convex piece; none for a point."""
    if len(piece) == 1:
        return np.empty((0, 3))
    edges = np.roll(piece, -1, axis=0) - piece
    normals = np.column_stack((edges[:, 1], -edges[:, 0])) / np.hypot(*edges.T)[:, None]
    return np.column_stack((normals, (normals @ piece.T).max(axis=1)))
