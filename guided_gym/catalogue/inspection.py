"""What is wrong with a pose, and where a workspace is narrow beside a robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace

FloatArray = NDArray[np.float64]

_RINGS: Final = 60  # distances from a pose that are tried
_AROUND: Final = 24  # directions at each
_HEADINGS: Final = 8
_SEED: Final = 0
_WIDE: Final = 1.25  # circumcircles beside which a gap is not called narrow
_SAME_GAP: Final = 0.02  # by how much of itself the room in the middle of a gap may fall short


@dataclass(frozen=True)
class Gap:
    """A narrow place between two obstacles, or an obstacle and the bounds.

    Attributes:
        width: Distance between the two (length).
        ends: (2, 2) a point on each, as near as they come.
        verdict: What it means for the robot, in words.
        passable: False if the robot surely does not fit.
    """

    width: float
    ends: FloatArray
    verdict: str
    passable: bool

    @property
    def middle(self) -> FloatArray:
        """(2,) the point between."""
        return np.asarray(self.ends.mean(axis=0))


def robot_widths(robot: Robot) -> tuple[float, float]:
    """The least width of a robot's convex hull, and the diameter of the circle that it turns in (length).

    Through a gap between two points narrower than the first it never fits; it may fit through one that is
    wider. Where the second fits, it passes whatever its heading.
    """
    hull = shapely.convex_hull(robot.outline)
    if not isinstance(hull, shapely.Polygon):
        return 0.0, 2.0 * robot.radius
    corners = shapely.get_coordinates(hull)
    edges = np.diff(corners, axis=0)
    normals = np.stack([-edges[:, 1], edges[:, 0]], axis=1) / np.hypot(*edges.T)[:, None]
    across = corners @ normals.T
    if robot.dimension == 2:  # it does not turn, so what counts is how wide it is across its own axes
        xmin, ymin, xmax, ymax = hull.bounds
        return float(min(xmax - xmin, ymax - ymin, np.ptp(across, axis=0).min())), 2.0 * robot.radius
    return float(np.ptp(across, axis=0).min()), 2.0 * robot.radius


def pose_trouble(space: ConfigurationSpace, q: FloatArray, names: Sequence[str] = ()) -> str:
    """Why a pose is not free, and the nearest one that is.

    Args:
        space: The configuration space.
        q: (d,) a configuration that is not valid.
        names: What to call the first of the obstacles; the others get their number.
    """
    placed = shapely.union_all(space.robot.place(q))
    hits = hit_obstacles(space.environment, placed)
    called = [names[i] if i < len(names) else f"obstacle {i}" for i in hits]
    if called:
        what = "in collision with " + ", ".join(dict.fromkeys(called[:4]))
        what += f" and {len(called) - 4} more" if len(called) > 4 else ""
    elif shapely.box(*space.environment.bounds).contains_properly(placed):
        what = f"nearer to an obstacle or the bounds than the tolerance {space.tolerance:.3g}"
    else:
        what = f"touching or crossing the bounds {space.environment.bounds}"
    near = nearest_free_pose(space, q)
    hint = "none was found near it" if near is None else f"{[round(v, 6) for v in near.tolist()]} is free"
    return f"{q.tolist()}, {what}; {hint}"


def hit_obstacles(environment: Environment, shape: shapely.Geometry) -> list[int]:
    """Numbers of the obstacles that a placed robot touches."""
    tree = shapely.STRtree(environment.obstacles)
    return [int(i) for i in tree.query(shape, predicate="intersects")]


def nearest_free_pose(space: ConfigurationSpace, q: FloatArray) -> FloatArray | None:
    """A free pose near q: the nearest of a few thousand around it; None if none of them is free.

    Args:
        space: The configuration space.
        q: (d,) any configuration.
    """
    if not isinstance(space.robot, Robot):
        return _nearest_free(space, q)
    low, high = space.lower[:2], space.upper[:2]
    centre = np.clip(q[:2], low, high)
    radii = space.extent * np.geomspace(1e-4, 1.0, _RINGS)
    angles = 2.0 * math.pi * (np.arange(_AROUND) + 0.5 * np.arange(_RINGS)[:, None] % 1) / _AROUND
    offsets = radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    places = np.concatenate([centre[None], (centre + offsets).reshape(-1, 2)])
    places = places[((places > low) & (places < high)).all(axis=1)]
    if space.dimension == 2:
        poses = places
    else:
        turns = q[2] + 2.0 * math.pi * np.arange(_HEADINGS) / _HEADINGS
        poses = np.column_stack([np.repeat(places, _HEADINGS, axis=0), np.tile(turns, len(places))])
        poses = space.wrap(poses)
    free = poses[np.asarray(space.valid(np.ascontiguousarray(poses)))]
    if not len(free):
        return None
    inside = space.wrap(np.concatenate([centre, q[2:]]))
    return np.asarray(free[np.argmin(space.distance(free, inside))])


def _nearest_free(space: ConfigurationSpace, q: FloatArray) -> FloatArray | None:
    """A free configuration of a robot with joints near q: of some in each of many shells around it."""
    rng = np.random.default_rng(_SEED)
    inside = np.where(space.periods > 0, q, np.clip(q, space.lower, space.upper))
    across = float(np.linalg.norm((space.upper - space.lower) * space.weights))
    for radius in across * np.geomspace(1e-4, 1.0, _RINGS):
        steps = rng.standard_normal((_AROUND * _HEADINGS, space.dimension))
        steps *= radius / np.linalg.norm(steps, axis=1, keepdims=True) / space.weights
        around = space.wrap(np.clip(inside + steps, *_reachable(space)))
        free = around[np.asarray(space.valid(around))]
        if len(free):
            return np.asarray(free[np.argmin(space.distance(free, inside))])
    return None


def _reachable(space: ConfigurationSpace) -> tuple[FloatArray, FloatArray]:
    turns = space.periods > 0
    return np.where(turns, -np.inf, space.lower), np.where(turns, np.inf, space.upper)


def narrow_gaps(environment: Environment, robot: Robot, most: int = 20) -> list[Gap]:
    """The gaps in which a robot may get stuck, the narrowest first.

    A gap is where a disc touches two convex parts of obstacles (or of the bounds) at opposite points and
    nothing else. Of those side by side within a robot's width, the narrowest counts.

    Args:
        environment: The workspace.
        robot: The robot.
        most: How many at most.
    """
    least, turning = robot_widths(robot)
    reach = max(_WIDE * turning, 1e-3 * environment.extent)
    shapes = _parts(environment)
    tree = shapely.STRtree(shapes)
    one, other = tree.query(shapes, predicate="dwithin", distance=reach)
    pairs = np.stack([one, other], axis=1)[one < other]
    if not len(pairs):
        return []
    lines = shapely.shortest_line(shapes[pairs[:, 0]], shapes[pairs[:, 1]])
    widths = shapely.length(lines)
    apart = widths > 1e-9 * environment.extent
    lines, widths = lines[apart], widths[apart]
    ends = shapely.get_coordinates(lines).reshape(-1, 2, 2)
    if not len(ends):
        return []
    real = environment.clearance(ends.mean(axis=1)) >= (1.0 - _SAME_GAP) * widths / 2.0
    order = np.flatnonzero(real)[np.argsort(widths[real], kind="stable")]
    gaps: list[Gap] = []
    for i in order.tolist():
        width, middle = float(widths[i]), ends[i].mean(axis=0)
        if all(np.hypot(*(gap.middle - middle)) > max(turning, width) for gap in gaps):
            gaps.append(Gap(width, ends[i], *_verdict(width, least, turning)))
            if len(gaps) >= most:
                break
    return gaps


def _parts(environment: Environment) -> NDArray[np.object_]:
    """Convex parts of the obstacles, and the four sides of the bounds."""
    sizes = np.array([len(piece) for piece in environment.pieces], dtype=np.int64)
    rings = [np.concatenate([piece, piece[:1]]) for piece in environment.pieces]
    parts = []
    if rings:
        indices = np.repeat(np.arange(len(rings)), sizes + 1)
        parts = shapely.polygons(shapely.linearrings(np.concatenate(rings), indices=indices)).tolist()
    xmin, ymin, xmax, ymax = environment.bounds
    corners: Sequence[tuple[float, float]] = [(xmin, ymin), (xmax, ymin), (xmax, ymax), (xmin, ymax)]
    sides = [shapely.LineString([corners[i - 1], corners[i]]) for i in range(4)]
    return np.array([*parts, *sides], dtype=object)


def _verdict(width: float, least: float, turning: float) -> tuple[str, bool]:
    if width <= least:
        return f"too narrow for the robot, which is {least:.4g} wide", False
    if width <= turning:
        return f"fits only some headings: the robot is {least:.4g} wide, and turns in {turning:.4g}", True
    return f"tight: the robot turns in {turning:.4g}", True
