"""What the browser draws of a problem: rings of obstacles, and the robot as joints with bodies on them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
import shapely

if TYPE_CHECKING:
    from guided_gym.geometry.robots import Robot
    from guided_gym.problems import Problem

_DIGITS: Final = 6  # of a workspace's size, to which corners are rounded: less than a pixel

Scene = dict[str, Any]


def scene_of(problem: Problem) -> Scene:
    """The scene of a problem, as ``view.js`` takes it and JSON can hold it.

    Returns:
        ``name``, ``bounds``; ``obstacles``, each a list of rings (its holes after its shell) of flat
        coordinates; ``regions`` (``name``, ``polygons``); ``robot`` (see `robot_table`); ``start`` and
        ``goal``; ``tolerance``; ``metric`` (``weights`` and ``periods`` of the coordinates).
    """
    environment, task, space = problem.environment, problem.task, problem.space
    digits = digits_of(environment.extent)
    return {
        "name": problem.name,
        "bounds": list(environment.bounds),
        "obstacles": [_rings(polygon, digits) for polygon in environment.obstacles],
        "regions": [
            {
                "name": name,
                "polygons": [_rings(part, digits) for part in shapely.get_parts(shape) if _area(part)],
            }
            for name, shape in problem.regions.items()
        ],
        "robot": robot_table(problem.robot),
        "start": task.start.tolist(),
        "goal": task.goal.tolist(),
        "tolerance": task.tolerance,
        "metric": {"weights": space.weights.tolist(), "periods": space.periods.tolist()},
    }


def digits_of(extent: float) -> int:
    """Decimals that a workspace of that size needs to be drawn."""
    return _DIGITS - 1 - int(np.floor(np.log10(extent)))


def _area(shape: shapely.Geometry) -> bool:
    return isinstance(shape, shapely.Polygon) and not shape.is_empty


def _rings(polygon: shapely.Polygon, digits: int) -> list[list[float]]:
    rings = (polygon.exterior, *polygon.interiors)
    return [np.round(shapely.get_coordinates(ring)[:-1], digits).ravel().tolist() for ring in rings]


def robot_table(robot: Robot) -> dict[str, Any]:
    """A robot as a kinematic table.

    Returns:
        ``joints``, in the order of a chain: ``kind`` (``x``, ``y`` or ``turn``), ``coordinate`` (of the
        configuration), ``parent`` (a joint before it; -1 is the world), ``offset`` in the parent's frame;
        ``bodies``: ``joint`` that carries it, ``ring`` of flat coordinates in its frame, ``closed``; and
        ``tip``: ``joint`` and ``point`` that stand for the robot where it is drawn as a point.
    """
    kinds = ("x", "y", "turn")[: robot.dimension]
    joints = [
        {"kind": kind, "coordinate": i, "parent": i - 1, "offset": [0.0, 0.0]} for i, kind in enumerate(kinds)
    ]
    outline, last = robot.outline, len(joints) - 1
    closed = isinstance(outline, shapely.Polygon)
    corners = shapely.get_coordinates(outline)[: -1 if closed else None]
    body = {"joint": last, "ring": corners.ravel().tolist(), "closed": closed}
    return {
        "name": robot.name,
        "dimension": robot.dimension,
        "joints": joints,
        "bodies": [body],
        "tip": {"joint": last, "point": [0.0, 0.0]},
    }
