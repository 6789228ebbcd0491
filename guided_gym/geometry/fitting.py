"""Capsules around shapes: they stand for the collision geometry of a link."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt
import shapely

from guided_gym.geometry.solids import Capsule, triple, turned_to

FloatArray = npt.NDArray[np.float64]

_RADII: Final = np.linspace(1.0, 1.6, 25)  # tried for each direction, times the narrowest one
_ROUNDS: Final = 3  # of directions ever nearer to the best one
_AROUND: Final = 12  # directions in each
_SAFE: Final = 1.0 + 1e-9  # more than rounding


def capsule_around(points: FloatArray) -> Capsule:
    """A capsule of little volume that holds points (n, 3), and so their convex hull.

    Directions of the axis are the main ones of the points and those of the frame, then some around the best;
    for each, the narrowest cylinder and wider ones, whose round ends need less length. Not the smallest one
    there is, but it holds them all: the radius is taken from the distances at last.
    """
    points = np.asarray(points, np.float64)
    middle = points.mean(axis=0)
    main = np.linalg.svd(points - middle, full_matrices=False)[2]
    best = min((_along(points, axis) for axis in (*np.eye(3), *main)), key=lambda found: found[0])
    for k in range(_ROUNDS):
        spread, axis = 0.3 / 3.0**k, best[1]
        aside = turned_to(axis)[:, :2]
        for turn in 2.0 * math.pi * np.arange(_AROUND) / _AROUND:
            tried = axis + spread * (aside @ [math.cos(turn), math.sin(turn)])
            best = min(best, _along(points, tried / np.linalg.norm(tried)), key=lambda found: found[0])
    _, _, a, b = best
    length = float(np.linalg.norm(b - a))
    part = np.clip((points - a) @ (b - a) / length**2, 0.0, 1.0) if length > 0 else np.zeros(len(points))
    radius = float(np.linalg.norm(points - a - part[:, None] * (b - a), axis=1).max()) * _SAFE
    return Capsule(triple("start", a), triple("end", b), radius)


def _along(points: FloatArray, axis: FloatArray) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """Volume, axis and ends of the best capsule along a direction."""
    frame = turned_to(axis)
    local = points @ frame
    circle = shapely.minimum_bounding_circle(shapely.MultiPoint(local[:, :2]))
    centre = shapely.get_coordinates(circle.centroid)[0]
    aside = np.hypot(*(local[:, :2] - centre).T)
    radii = max(float(aside.max()), 1e-9) * _RADII[:, None]
    room = np.sqrt(np.maximum(0.0, radii**2 - aside**2))
    low, high = (local[:, 2] + room).min(axis=1), (local[:, 2] - room).max(axis=1)
    length = np.maximum(0.0, high - low)
    volumes = math.pi * radii[:, 0] ** 2 * (length + 4.0 * radii[:, 0] / 3.0)
    k = int(np.argmin(volumes))
    ends = (low[k], high[k]) if high[k] > low[k] else (0.5 * (low[k] + high[k]),) * 2
    a, b = (frame @ np.array([*centre, end]) for end in ends)
    return float(volumes[k]), axis, a, b


def capsules_around(triangles: FloatArray, parts: int) -> list[Capsule]:
    """At most so many capsules that together hold all triangles (n, 3, 3) of a surface.

    The part whose capsule is the largest is cut in two, across its longest direction, as often as it takes.
    """
    groups = [triangles]
    found = [capsule_around(triangles.reshape(-1, 3))]
    while len(groups) < parts:
        k = max(range(len(groups)), key=lambda i: found[i].size[0])
        group = groups[k]
        middles = group.mean(axis=1)
        main = np.linalg.svd(middles - middles.mean(axis=0), full_matrices=False)[2][0]
        along = middles @ main
        upper = along > 0.5 * (along.min() + along.max())
        if upper.all() or not upper.any():
            break
        groups[k : k + 1] = halves = [group[upper], group[~upper]]
        found[k : k + 1] = [capsule_around(half.reshape(-1, 3)) for half in halves]
    return found


def box_corners(sides: tuple[float, float, float]) -> FloatArray:
    """(8, 3) corners of a box around the origin."""
    corners: FloatArray = np.array(np.meshgrid(*[(-0.5 * s, 0.5 * s) for s in sides])).reshape(3, -1).T
    return corners


def capsule_of_cylinder(radius: float, length: float) -> Capsule:
    """The smallest capsule around a cylinder along z, its middle at the origin."""
    rim = np.array([[radius, 0.0, 0.5 * length], [-radius, 0.0, -0.5 * length]])
    rims = np.concatenate([rim @ _turn(t).T for t in 2.0 * math.pi * np.arange(48) / 48])
    _, _, a, b = _along(rims, np.array([0.0, 0.0, 1.0]))
    half = float(abs(b[2] - a[2])) / 2.0
    needed = math.hypot(radius, 0.5 * length - half) * _SAFE
    return Capsule((0.0, 0.0, -half), (0.0, 0.0, half), needed)


def _turn(t: float) -> FloatArray:
    c, s = math.cos(t), math.sin(t)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
