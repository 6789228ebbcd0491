"""A slow, independent judge of motions: dense poses, exact polygon intersection.

It shares nothing with `guided_gym.kernels.collision`: no convex pieces, no separating axes, no advancement. A
pose collides when an edge of the robot's outline crosses an edge of an obstacle, when one contains the other,
or when a vertex leaves the bounds. A motion is checked at poses so dense that no point of the robot moves
more than `step` between two of them; poses whose circumscribed disc cannot reach an obstacle are skipped.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Scene = tuple[FloatArray, FloatArray, FloatArray, IntArray]
"""Bounds (4,), outline (V, 2), obstacle corners (N, 2), first corner of each obstacle and end (P + 1,)."""


def scene_of(robot: Robot, environment: Environment) -> Scene:
    """The arrays of the reference. Obstacles must have no holes."""
    outline = np.array(getattr(robot.outline, "exterior", robot.outline).coords)[:, :2]
    if robot.outline.geom_type == "Polygon":
        outline = outline[:-1]
    rings = [np.array(obstacle.exterior.coords)[:-1, :2] for obstacle in environment.obstacles]
    starts = np.cumsum([0] + [len(ring) for ring in rings]).astype(np.int64)
    corners = np.concatenate(rings) if rings else np.empty((0, 2))
    return np.array(environment.bounds), np.ascontiguousarray(outline), np.ascontiguousarray(corners), starts


@njit(cache=True)
def _side(ax, ay, bx, by, px, py):
    return (bx - ax) * (py - ay) - (by - ay) * (px - ax)


@njit(cache=True)
def _cross(ax, ay, bx, by, px, py, qx, qy):
    """Whether two segments touch."""
    if max(ax, bx) < min(px, qx) or max(px, qx) < min(ax, bx):
        return False
    if max(ay, by) < min(py, qy) or max(py, qy) < min(ay, by):
        return False
    s1, s2 = _side(ax, ay, bx, by, px, py), _side(ax, ay, bx, by, qx, qy)
    if (s1 > 0 and s2 > 0) or (s1 < 0 and s2 < 0):
        return False
    s3, s4 = _side(px, py, qx, qy, ax, ay), _side(px, py, qx, qy, bx, by)
    return not ((s3 > 0 and s4 > 0) or (s3 < 0 and s4 < 0))


@njit(cache=True)
def _inside(ring, first, end, px, py):
    """Whether a point is inside a ring, by the parity of crossings."""
    odd = False
    j = end - 1
    for i in range(first, end):
        xi, yi, xj, yj = ring[i, 0], ring[i, 1], ring[j, 0], ring[j, 1]
        if (yi > py) != (yj > py) and px < (xj - xi) * (py - yi) / (yj - yi) + xi:
            odd = not odd
        j = i
    return odd


@njit(cache=True)
def _touches(placed, corners, first, end):
    """Whether the placed outline (1 point, 2 ends of a segment, or a ring) meets one obstacle."""
    n = placed.shape[0]
    for i in range(n if n > 2 else n - 1):
        ax, ay, bx, by = placed[i, 0], placed[i, 1], placed[(i + 1) % n, 0], placed[(i + 1) % n, 1]
        j = end - 1
        for k in range(first, end):
            if _cross(ax, ay, bx, by, corners[j, 0], corners[j, 1], corners[k, 0], corners[k, 1]):
                return True
            j = k
    if _inside(corners, first, end, placed[0, 0], placed[0, 1]):
        return True
    return n > 2 and _inside(placed, 0, n, corners[first, 0], corners[first, 1])


@njit(cache=True)
def _distance(corners, first, end, px, py):
    """Distance of a point from an obstacle, 0 inside."""
    if _inside(corners, first, end, px, py):
        return 0.0
    smallest = np.inf
    j = end - 1
    for k in range(first, end):
        ux, uy = corners[k, 0] - corners[j, 0], corners[k, 1] - corners[j, 1]
        wx, wy = px - corners[j, 0], py - corners[j, 1]
        t = min(1.0, max(0.0, (ux * wx + uy * wy) / (ux * ux + uy * uy)))
        smallest = min(smallest, math.hypot(wx - t * ux, wy - t * uy))
        j = k
    return smallest


@njit(cache=True)
def _place(outline, placed, x, y, theta):
    c, s = math.cos(theta), math.sin(theta)
    for i in range(outline.shape[0]):
        placed[i, 0] = x + c * outline[i, 0] - s * outline[i, 1]
        placed[i, 1] = y + s * outline[i, 0] + c * outline[i, 1]


@njit(cache=True)
def _leaves(placed, bounds):
    for i in range(placed.shape[0]):
        x, y = placed[i, 0], placed[i, 1]
        if x <= bounds[0] or y <= bounds[1] or x >= bounds[2] or y >= bounds[3]:
            return True
    return False


@njit(cache=True)
def pose_collides(q, scene):
    """Whether the robot touches an obstacle or the bounds at pose q."""
    bounds, outline, corners, starts = scene
    placed = np.empty_like(outline)
    _place(outline, placed, q[0], q[1], q[2] if q.shape[0] > 2 else 0.0)
    if _leaves(placed, bounds):
        return True
    for p in range(starts.shape[0] - 1):  # noqa: SIM110 (numba has no generators in any())
        if _touches(placed, corners, starts[p], starts[p + 1]):
            return True
    return False


@njit(cache=True)
def _near(corners, starts, xmin, ymin, xmax, ymax, radius):
    """The obstacles whose bounding box comes within twice the robot's radius of the motion's."""
    reach = 2.0 * radius + 1e-6 * (xmax - xmin + ymax - ymin)
    near = np.empty(starts.shape[0] - 1, dtype=np.int64)
    n = 0
    for p in range(starts.shape[0] - 1):
        ring = corners[starts[p] : starts[p + 1]]
        if (
            ring[:, 0].min() <= xmax + reach
            and ring[:, 0].max() >= xmin - reach
            and ring[:, 1].min() <= ymax + reach
            and ring[:, 1].max() >= ymin - reach
        ):
            near[n] = p
            n += 1
    return near[:n]


@njit(cache=True)
def motion_collides(a, b, step, scene, low=0.0, high=1.0):
    """First colliding fraction found on the straight motion a -> b within [low, high], or -1.0."""
    bounds, outline, corners, starts = scene
    placed = np.empty_like(outline)
    n_obstacles = starts.shape[0] - 1
    free_until = np.zeros(n_obstacles, dtype=np.int64)
    radius = 0.0
    for i in range(outline.shape[0]):
        radius = max(radius, math.hypot(outline[i, 0], outline[i, 1]))
    theta, turn = 0.0, 0.0
    if a.shape[0] > 2:
        theta, turn = a[2], b[2] - a[2]
        if abs(turn) > math.pi:
            turn -= 2.0 * math.pi * np.rint(turn / (2.0 * math.pi))
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = math.hypot(dx, dy)
    near = _near(corners, starts, min(a[0], b[0]), min(a[1], b[1]), max(a[0], b[0]), max(a[1], b[1]), radius)
    count = math.ceil((high - low) * (length + radius * abs(turn)) / step) + 1
    for k in range(count + 1):
        t = low + (high - low) * k / count
        x, y = a[0] + t * dx, a[1] + t * dy
        _place(outline, placed, x, y, theta + t * turn)
        if _leaves(placed, bounds):
            return t
        for p in near:
            if k < free_until[p]:
                continue
            gap = _distance(corners, starts[p], starts[p + 1], x, y) - radius
            if gap > 0.0:
                ahead = gap * count / (length * (high - low)) if length > 0.0 else count + 1.0
                free_until[p] = k + max(1, int(min(ahead, count + 1.0)))
            elif _touches(placed, corners, starts[p], starts[p + 1]):
                return t
    return -1.0


@njit(cache=True)
def motions_collide(starts, ends, step, scene):
    """`motion_collides` for each pair of rows."""
    found = np.empty(starts.shape[0])
    for i in range(starts.shape[0]):
        found[i] = motion_collides(starts[i], ends[i], step, scene)
    return found
