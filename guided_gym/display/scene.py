"""What the browser draws of a problem: rings of obstacles, and the robot as joints with bodies on them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
import shapely

from guided_gym.geometry.linkages import Linkage
from guided_gym.geometry.robots import rigid
from guided_gym.geometry.solids import VIEW
from guided_gym.geometry.spatial_arms import SpatialArm

if TYPE_CHECKING:
    from guided_gym.geometry.mechanism import Mechanism
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


def robot_table(robot: Mechanism) -> dict[str, Any]:
    """A robot as a kinematic table.

    Returns:
        ``joints``, parents first: ``kind`` (``x``, ``y`` or ``turn``), ``coordinate`` (of the configuration;
        -1 for one that stays at ``value``), ``parent`` (a joint before it; -1 is the world), ``offset`` in
        the parent's frame; ``bodies``: ``joint`` that carries it, ``ring`` of flat coordinates in its frame,
        ``closed``; ``tip``: ``joint`` and ``point`` that stand for the robot where it is drawn as a point.
        An arm in space has a ``view``, too, and joints and bodies as `_in_space` says.

    Raises:
        InvalidInputError: A robot that is not planar.
    """
    joints: list[dict[str, Any]] = []
    if isinstance(robot, SpatialArm):
        return _in_space(robot)
    if isinstance(robot, Linkage):
        of = _add_joints(robot, joints)
        bodies = [(of[body.joint], body.outline) for body in robot.bodies]
        tip, point = of[robot.tool[0]], list(robot.tool[1])
    else:
        _add_chain(("x", "y", "turn")[: robot.dimension], joints)
        tip, point = len(joints) - 1, [0.0, 0.0]
        bodies = [(tip, rigid(robot, "scene").outline)]
    return {
        "name": robot.name,
        "dimension": robot.dimension,
        "joints": joints,
        "bodies": [_body(joint, outline) for joint, outline in bodies],
        "tip": {"joint": tip, "point": point},
    }


def _in_space(robot: SpatialArm) -> dict[str, Any]:
    """An arm in space: ``view``, the plane that it is drawn in, and a chain of joints that move along z."""
    joints = [
        {
            "kind": "slide" if slides else "spin",
            "coordinate": column,
            "factor": factor,
            "shift": shift,
            "turned": turned.ravel().tolist(),
            "offset": offset.tolist(),
        }
        for slides, column, factor, shift, turned, offset in robot.chain_rows()
    ]
    bodies = [
        {"joint": joint, "start": start.tolist(), "end": end.tolist(), "radius": radius}
        for joint, start, end, radius in robot.body_rows()
    ]
    joint, point = robot.aligned_tool()
    return {
        "name": robot.name,
        "dimension": robot.dimension,
        "view": VIEW.ravel().tolist(),
        "joints": joints,
        "bodies": bodies,
        "tip": {"joint": joint, "point": point.tolist()},
    }


def _add_chain(kinds: tuple[str, ...], joints: list[dict[str, Any]]) -> None:
    """One joint for each of the first coordinates."""
    for i, kind in enumerate(kinds):
        joints.append({"kind": kind, "coordinate": i, "parent": i - 1, "offset": [0.0, 0.0]})


def _add_joints(robot: Linkage, joints: list[dict[str, Any]]) -> list[int]:
    """The rows of a linkage's joints, and which of them is that of each."""
    if robot.mobile:
        _add_chain(("x", "y"), joints)
    base, of = len(joints), list[int]()
    for k, joint in enumerate(robot.joints):
        parent, offset = (of[joint.parent] if joint.parent >= 0 else base - 1), list(joint.offset)
        if joint.heading:
            fixed = {"kind": "turn", "coordinate": -1, "value": joint.heading}
            joints.append({**fixed, "parent": parent, "offset": offset})
            parent, offset = len(joints) - 1, [0.0, 0.0]
        joints.append({"kind": "turn", "coordinate": base + k, "parent": parent, "offset": offset})
        of.append(len(joints) - 1)
    return of


def _body(joint: int, outline: shapely.Geometry) -> dict[str, Any]:
    closed = isinstance(outline, shapely.Polygon)
    corners = shapely.get_coordinates(outline)[: -1 if closed else None]
    return {"joint": joint, "ring": corners.ravel().tolist(), "closed": closed}
