"""Convex pieces as the collision kernels read them: edges' normals, bounding boxes and a tree of these.

The layout is that of `guided_gym.kernels.collision`.
"""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from guided_gym.kernels.collision import ENTRY, HEADER, NUMBERS, ROW, TABLE
from guided_gym.kernels.plain import NO, YES, ZERO, borrowing

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]

RUN = 8
"""Most pieces of a leaf of the tree."""
FEW = 64
"""Up to so many pieces, looking at all their boxes is as fast as a tree."""
_SHARP = math.cos(math.radians(91.0))
"""Cosine between the axes of two edges below which the corner between them is sharper than 89 degrees."""
_SIDES = (0, 2, 1, 3)
"""The sides of the bounds in the order of their half-planes: left, right, bottom, top."""


@njit(cache=True)
def bounding_boxes(xy: FloatArray, ends: IntArray) -> FloatArray:
    """Boxes (p, 4), (xmin, ymin, xmax, ymax), of pieces given by their vertices and where each one ends."""
    boxes, first = np.empty((ends.size, 4)), 0
    for i in range(ends.size):
        xmin, ymin, xmax, ymax = np.inf, np.inf, -np.inf, -np.inf
        for k in range(first, ends[i]):
            xmin, ymin = min(xmin, xy[k, 0]), min(ymin, xy[k, 1])
            xmax, ymax = max(xmax, xy[k, 0]), max(ymax, xy[k, 1])
        boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3] = xmin, ymin, xmax, ymax
        first = ends[i]
    return boxes


@njit(cache=True)
def _halve(order: IntArray, centres: FloatArray, first: int, last: int) -> int:
    """Put the pieces with the smaller centres, in the direction of the larger spread, first; where to cut."""
    part = order[first:last].copy()
    axis, widest = 0, -1.0
    for k in range(2):
        low, high = np.inf, -np.inf
        for i in part:
            low, high = min(low, centres[i, k]), max(high, centres[i, k])
        if high - low > widest:
            axis, widest = k, high - low
    half = (last - first) // 2
    pivot = np.partition(centres[part, axis], half)[half]
    below, above = first, first + half
    equal = half
    for i in part:
        equal -= centres[i, axis] < pivot
    for i in part:
        if centres[i, axis] < pivot:
            order[below] = i
            below += 1
        elif centres[i, axis] == pivot and equal > 0:
            order[below] = i
            below, equal = below + 1, equal - 1
        else:
            order[above] = i
            above += 1
    return first + half


@njit(cache=True)
def box_tree(boxes: FloatArray) -> tuple[IntArray, FloatArray, IntArray]:
    """A binary tree over boxes, in preorder, cut again and again at the median.

    Args:
        boxes: (p, 4) bounding boxes of the pieces.

    Returns:
        (p,) the order of the pieces in which each leaf has a run of them; (n, 4) boxes of the nodes; (n, 3)
        for each node the next one that does not lie below it, and the range of its run (empty but at leaves).
    """
    p = boxes.shape[0]
    order = np.arange(p)
    centres = 0.5 * (boxes[:, :2] + boxes[:, 2:])
    most = 2 * p // ((RUN + 1) // 2)
    nodes, rows, n = np.empty((most, 4)), np.zeros((most, 3), dtype=np.int64), 0
    stack = [(0, p)]
    while stack:
        first, last = stack.pop()
        nodes[n, :2], nodes[n, 2:] = np.inf, -np.inf
        for i in order[first:last]:
            for k in range(2):
                nodes[n, k] = min(nodes[n, k], boxes[i, k])
                nodes[n, k + 2] = max(nodes[n, k + 2], boxes[i, k + 2])
        if last - first <= RUN:
            rows[n, 1], rows[n, 2] = first, last
        else:
            cut = _halve(order, centres, first, last)
            stack.append((cut, last))
            stack.append((first, cut))
        n += 1
    for at in range(n - 1, -1, -1):
        # The right half begins where the left one ends, and ends where the whole does.
        rows[at, 0] = at + 1 if rows[at, 2] > 0 else rows[rows[at + 1, 0], 0]
    return order, nodes[:n].copy(), rows[:n].copy()


@borrowing
def _put_boxes(boxes: FloatArray, numbers: FloatArray, at: int) -> int:
    """Write boxes one after the other; return where they end."""
    for i in range(boxes.shape[0]):
        for k in range(4):
            numbers[at + k] = boxes[i, k]
        at += 4
    return at


@njit(cache=True)
def pack_pieces(
    header: FloatArray,
    bounds: FloatArray,
    robot: FloatArray,
    robot_ends: IntArray,
    obstacles: FloatArray,
    obstacle_ends: IntArray,
    boxes: FloatArray,
    nodes: FloatArray,
    rows: IntArray,
) -> tuple[FloatArray, IntArray]:
    """The two arrays of a `Geometry`.

    Args:
        header: (NUMBERS,) the first entries of `numbers`.
        bounds: (4,) xmin, ymin, xmax, ymax.
        robot: (v, 2) vertices of the robot's pieces in the body frame.
        robot_ends: (r,) where each of them ends.
        obstacles: (n, 2) vertices of the obstacles' pieces.
        obstacle_ends: (p,) where each of them ends.
        boxes: (p, 4) their bounding boxes.
        nodes: (m, 4) boxes of the tree.
        rows: (m, 3) rows of the tree.
    """
    r, p, m = robot_ends.size, obstacle_ends.size + 4, rows.shape[0]
    numbers = np.empty(NUMBERS + 6 * robot.shape[0] + 5 * obstacles.shape[0] + 12 + 4 * (p + m))
    index = np.empty(HEADER + ROW * (r + p) + 3 * m, dtype=np.int64)
    for k in range(NUMBERS):
        numbers[k] = header[k]
    at, row, first = int(NUMBERS), int(HEADER), int(ZERO)
    for i in range(r):
        at = _put_piece(robot, first, robot_ends[i], bool(YES), numbers, at, index, row)
        row, first = row + ROW, robot_ends[i]
    first = int(ZERO)
    for i in range(p - 4):
        at = _put_piece(obstacles, first, obstacle_ends[i], bool(NO), numbers, at, index, row)
        row, first = row + ROW, obstacle_ends[i]
    for k in _SIDES:
        index[row], index[row + 1], index[row + 2], index[row + 3], index[row + 4] = at, 0, at, 1, 0
        inward = 1.0 if k < 2 else -1.0
        numbers[at], numbers[at + 1] = 0.0, 0.0
        numbers[at + k % 2], numbers[at + 2] = inward, inward * bounds[k]
        at, row = at + 3, row + ROW
    index[0], index[1], index[2], index[3], index[4] = r, p, at, m, row
    index[5], index[6] = at + 4 * p, p - 4 if m > 0 else 0
    index[ENTRY] = index[TABLE] = 0
    at = _put_boxes(boxes, numbers, at)
    for k in _SIDES:
        numbers[at], numbers[at + 1], numbers[at + 2], numbers[at + 3] = -np.inf, -np.inf, np.inf, np.inf
        numbers[at + (k + 2) % 4] = bounds[k]
        at += 4
    at = _put_boxes(nodes, numbers, at)
    for i in range(m):
        for k in range(3):
            index[row + 3 * i + k] = rows[i, k]
    return numbers[:at], index


JOINTS, BODIES, PAIRS, BASE, JOINT_NUMBERS, BODY_NUMBERS, LIMITS, OWN_ROWS, TOOL, TOOL_NUMBERS = range(10)
"""Entries before the rows of a linkage's table; `guided_gym.kernels.linkage` says what they are."""
TABLE_HEADER = 10

BOX, CYLINDER, HALF_SPACE = range(3)
"""Kinds of solids in space; `guided_gym.kernels.spatial` says what they are."""
SOLIDS = OWN_ROWS
"""Where the table of an arm in space says how many of them there are."""


@njit(cache=True)
def pack_linkage(
    numbers: FloatArray,
    index: IntArray,
    joints: FloatArray,
    joint_rows: IntArray,
    circles: FloatArray,
    body_joints: IntArray,
    body_ends: IntArray,
    limits: FloatArray,
    tool: FloatArray,
    pairs: IntArray,
) -> tuple[FloatArray, IntArray]:
    """The two arrays of a `Geometry` with the table of a linkage behind them, but for entry, base and tool.

    Args:
        numbers: Those of all pieces.
        index: Likewise.
        joints: (n, 4) offset x, y, heading, length of the offset.
        joint_rows: (n, 3) parent, coordinate, periodic.
        circles: (m, 3) centre x, y and radius of a circle around each body.
        body_joints: (m,) the joint of each body.
        body_ends: (m,) where its pieces end.
        limits: (d, 2) smallest and largest value of each coordinate.
        tool: (2,) place of the tool in its joint's frame.
        pairs: (p, 2) bodies that must not touch each other.
    """
    n, m, p, pieces = joints.shape[0], circles.shape[0], pairs.shape[0], index[0]
    corners = 0
    for i in range(pieces):
        corners += index[HEADER + ROW * i + 1]
    table, at = index.size, numbers.size
    room = np.empty(at + joints.size + circles.size + limits.size + tool.size + 5 * corners)
    rows = np.zeros(table + TABLE_HEADER + 3 * (n + m) + 2 * p + ROW * pieces, dtype=np.int64)
    room[:at], rows[:table] = numbers, index
    rows[TABLE] = table
    rows[table + JOINTS], rows[table + BODIES], rows[table + PAIRS] = n, m, p
    for which, values in ((JOINT_NUMBERS, joints), (BODY_NUMBERS, circles), (LIMITS, limits)):
        rows[table + which] = at
        room[at : at + values.size] = values.ravel()
        at += values.size
    rows[table + TOOL_NUMBERS] = at
    room[at : at + 2] = tool
    at += 2
    row = table + TABLE_HEADER
    rows[row : row + 3 * n] = joint_rows.ravel()
    row += 3 * n
    for i in range(m):
        rows[row] = body_joints[i]
        rows[row + 1] = HEADER + ROW * (body_ends[i - 1] if i > 0 else 0)
        rows[row + 2] = HEADER + ROW * body_ends[i]
        row += 3
    rows[row : row + 2 * p] = pairs.ravel()
    row += 2 * p
    rows[table + OWN_ROWS] = row
    for i in range(pieces):
        own = HEADER + ROW * i
        xy = np.empty((index[own + 1], 2))
        for k in range(index[own + 1]):
            xy[k] = numbers[index[own] + 3 * k : index[own] + 3 * k + 2]
        at = _put_piece(xy, int(ZERO), index[own + 1], bool(NO), room, at, rows, row)
        row += ROW
    return room[:at].copy(), rows


@borrowing
def _put_piece(
    xy: FloatArray,
    first: int,
    last: int,
    norms: bool,
    numbers: FloatArray,
    at: int,
    index: IntArray,
    row: int,
) -> int:
    """Write a piece's vertices, its axes (nx, ny, max n.v) and its row; return where its numbers end."""
    index[row], index[row + 1] = at, last - first
    for k in range(first, last):
        numbers[at], numbers[at + 1] = xy[k, 0], xy[k, 1]
        at += 2
        if norms:
            numbers[at] = math.hypot(xy[k, 0], xy[k, 1])
            at += 1
    edges = last - first if last - first > 1 else 0
    index[row + 2], index[row + 3] = at, edges
    for k in range(first, first + edges):
        after = k + 1 if k + 1 < last else first
        ex, ey = xy[after, 0] - xy[k, 0], xy[after, 1] - xy[k, 1]
        length = math.hypot(ex, ey)
        nx, ny, offset = ey / length, -ex / length, -np.inf
        for v in range(first, last):
            offset = max(offset, nx * xy[v, 0] + ny * xy[v, 1])
        numbers[at], numbers[at + 1], numbers[at + 2] = nx, ny, offset
        at += 3
    index[row + 4] = 1 if edges == 0 else 0
    bx, by = (numbers[at - 3], numbers[at - 2]) if edges else (0.0, 0.0)
    for e in range(at - 3 * edges, at, 3):
        if numbers[e] * bx + numbers[e + 1] * by < _SHARP:
            index[row + 4] = 1
        bx, by = numbers[e], numbers[e + 1]
    return at
