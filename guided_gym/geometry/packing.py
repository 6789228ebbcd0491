"""Robot, obstacles and bounds packed into the arrays of `guided_gym.kernels.collision`."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from guided_gym.geometry.convex import Pieces
from guided_gym.kernels.collision import ENTRY, TABLE, Geometry
from guided_gym.kernels.packing import BASE, FEW, TOOL, bounding_boxes, box_tree, pack_linkage, pack_pieces

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
Bounds = tuple[float, float, float, float]

_FAR = 16.0
"""Coordinates beyond this many sides of the bounds are taken from a corner of these."""


def local_origin(bounds: Bounds) -> tuple[float, float]:
    """Where the kernels' coordinates begin: (0, 0), or a corner of the bounds if these lie far from there.

    A site in UTM coordinates is some hundred metres wide and thousands of kilometres from the origin;
    rounding of products of such coordinates would exceed its tolerance.
    """
    xmin, ymin, xmax, ymax = bounds
    far = max(map(abs, bounds)) > _FAR * max(xmax - xmin, ymax - ymin)
    return (xmin, ymin) if far else (0.0, 0.0)


def pack(
    robot: Pieces, obstacles: Pieces, bounds: Bounds, tolerance: float, radius: float | None = None
) -> Geometry:
    """Pack convex pieces and bounds into the arrays that the collision kernels read.

    Args:
        robot: Pieces in the body frame.
        obstacles: Pieces in the workspace.
        bounds: (xmin, ymin, xmax, ymax); its sides become four half-planes.
        tolerance: Gap up to which a pose counts as colliding (length).
        radius: Of the robot's pieces about their origin (length), where it is known.
    """
    origin = local_origin(bounds)
    vertices = obstacles.vertices - origin if any(origin) else obstacles.vertices
    boxes = bounding_boxes(vertices, obstacles.ends)
    ends, nodes, rows = obstacles.ends, np.empty((0, 4)), np.empty((0, 3), dtype=np.int64)
    if len(boxes) > FEW:
        order, nodes, rows = box_tree(boxes)
        vertices, ends = Pieces(vertices, obstacles.ends).taken(order)
        boxes = boxes[order]
    if radius is None:
        radius = float(np.hypot(*robot.vertices.T).max())
    header = np.array([tolerance, 1.001 * tolerance, radius, *origin])
    sides = np.array(bounds) - [*origin, *origin] if any(origin) else np.array(bounds)
    numbers, index = pack_pieces(
        header, sides, robot.vertices, robot.ends, vertices, ends, boxes, nodes, rows
    )
    return numbers.copy(), index  # without the room that was left


def with_linkage(
    whole: Geometry,
    entry: int,
    mobile: bool,
    joints: tuple[FloatArray, IntArray],
    bodies: tuple[FloatArray, IntArray, IntArray],
    limits: FloatArray,
    tool: tuple[int, tuple[float, float]],
    pairs: IntArray,
) -> Geometry:
    """A `Geometry` whose robot pieces hang on joints: with the table of `guided_gym.kernels.linkage`.

    Args:
        whole: All pieces packed, each in the frame of its joint.
        entry: Address of the function that answers for the robot.
        mobile: Whether the first two coordinates move the base.
        joints: (n, 4) offset x, y, heading, length of the offset; (n, 3) parent, coordinate, periodic.
        bodies: (m, 3) centre x, y and radius of a circle around each; (m,) its joint; (m,) end of its pieces.
        limits: (d, 2) smallest and largest value of each coordinate.
        tool: Index of the joint that carries the tool, and the tool's place in its frame.
        pairs: (p, 2) bodies that must not touch each other.
    """
    place = np.array(tool[1])
    numbers, index = pack_linkage(
        whole[0],
        whole[1],
        joints[0],
        joints[1],
        bodies[0],
        bodies[1],
        bodies[2],
        limits,
        place,
        pairs,
    )
    table = index[TABLE]
    index[ENTRY], index[table + BASE], index[table + TOOL] = entry, mobile, tool[0]
    return numbers, index
