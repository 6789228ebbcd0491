"""Reading the oracle's grid at any pose: the distance to the goal between the vertices.

In the open, a query is a trilinear interpolation. Where links are missing, the corners of a cell may lie on
different sides of a wall; there a corner counts only if a certified motion joins it to the pose, or if
certified links join it to one that counts. Each such corner speaks with its own linear model, so poses beside
obstacles, where most corners are in collision, are extrapolated towards the wall and not just given a
neighbour's value.
"""
# mypy: disable-error-code="misc,arg-type,no-any-return"

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from guided_gym.kernels.collision import Geometry, _motion_fraction, _pose_free, motion_free
from guided_gym.kernels.cost_grid import (
    COUNT_THETA,
    COUNT_X,
    COUNT_Y,
    GOAL,
    ORIGIN_X,
    ORIGIN_Y,
    SEES_GOAL,
    SIGHT,
    STEP_THETA,
    STEP_X,
    STEP_Y,
    WEIGHT,
    along,
    wrapped,
)
from guided_gym.kernels.eikonal import LINK_THETA, LINK_X, LINK_Y, PAD, FieldArray, LinkArray
from guided_gym.kernels.metric import Metric, placed, separation
from guided_gym.kernels.plain import NO, ONE, YES, borrowing, copy_row, owning, where_least

FloatArray = npt.NDArray[np.float64]
OracleState = tuple[FieldArray, LinkArray, FloatArray, Geometry]
"""(field, links, frame, geometry): what `cost_to_go_one` reads."""

_WIDEST = 3
"""Rings of vertices around a cell in which a reachable one is looked for."""
_HOPS = 8
"""Straight motions by which a pose that reaches no vertex may first move to where there is more room."""
_OPEN_CELL = 128
"""Bit that no link has: all edges of a cell are links."""


@borrowing
def _goal_distance(frame: FloatArray, x: float, y: float, theta: float) -> float:
    """Distance of the metric to the goal, obstacles left out."""
    dx, dy = frame[GOAL] - x, frame[GOAL + 1] - y
    if frame[COUNT_THETA] == 1.0:
        return math.sqrt(dx * dx + dy * dy)
    turn = frame[WEIGHT] * wrapped(frame[GOAL + 2] - theta)
    return math.sqrt(dx * dx + dy * dy + turn * turn)


@borrowing
def cost_to_go_one(q: FloatArray, state: OracleState) -> float:
    """True shortest-path distance from a free pose to the goal (paper's d_C); infinite where none is known.

    Args:
        q: (2,) or (3,) configuration; expected to be free.
        state: `Oracle.state`.
    """
    field, links, frame, geometry = state
    x, y, theta = q[0], q[1], q[2] if q.shape[0] > 2 else 0.0
    nt = int(frame[COUNT_THETA])
    gx, gy, gt = (x - frame[ORIGIN_X]) / frame[STEP_X], (y - frame[ORIGIN_Y]) / frame[STEP_Y], 0.0
    if not (abs(gx) < 1e9 and abs(gy) < 1e9 and abs(theta) < 1e9):
        return np.inf
    if nt > 1:
        gt = theta / frame[STEP_THETA]
        gt -= nt * math.floor(gt / nt)
    i, j, k = math.floor(gx), math.floor(gy), min(int(gt), nt - 1)
    straight = _goal_distance(frame, x, y, theta)
    if 0 <= i < frame[COUNT_X] - 1 and 0 <= j < frame[COUNT_Y] - 1:
        row = nt
        column = (int(frame[COUNT_Y]) + 2 * PAD) * nt
        v = (i + PAD) * column + (j + PAD) * row + k
        above = 1 if k < nt - 1 else 1 - nt
        bits = _open_bits(links, v, row, column, above)
        if bits & SEES_GOAL:
            return straight
        if bits and field[v] < np.inf:
            return max(_trilinear(field, v, row, column, above, gx - i, gy - j, gt - k), straight)
    return _beside_obstacles(field, links, frame, geometry, x, y, theta, straight)


@njit(cache=True)
def cost_to_go_many(qs: FloatArray, state: OracleState) -> FloatArray:
    """`cost_to_go_one` for each row of qs (n, d): float64 array (n,)."""
    costs = np.empty(qs.shape[0])
    for i in range(qs.shape[0]):
        costs[i] = cost_to_go_one(qs[i], state)
    return costs


@njit(cache=True)
def descend(
    begin: FloatArray,
    goal: FloatArray,
    reaches: FloatArray,
    directions: FloatArray,
    most: int,
    state: OracleState,
    metric: Metric,
) -> tuple[FloatArray, bool]:
    """A free path (n, d) down the field, from pose to pose in sight, and whether it ends at the goal.

    Args:
        begin: (d,) its first pose.
        goal: (d,) where the field is 0.
        reaches: (r,) lengths of a step; the next one is tried where one leads nowhere.
        directions: (m, d) steps of length 1.
        most: Steps after which it ends.
        state: `Oracle.state`.
        metric: Weights and periods of the distance.
    """
    path = np.empty((most + 2, begin.size))
    copy_row(begin, path[0])
    cost = cost_to_go_one(begin, state)
    for n in range(1, most + 2):
        if motion_free(path[n - 1], goal, state[3]):
            copy_row(goal, path[n])
            return path[: n + 1], True
        for reach in reaches:
            poses = _around(path[n - 1], reach, directions, metric)
            left = step_down(path[n - 1], cost, poses, state, metric, path[n])
            if left < cost:
                break
        else:
            return path[:n], False
        cost = left
    return path[: most + 1], False


@njit(cache=True)
def _around(here: FloatArray, reach: float, directions: FloatArray, metric: Metric) -> FloatArray:
    """(m, d) the poses that far from a pose (d,)."""
    periods = metric[1]
    poses = np.empty(directions.shape)
    for i in range(directions.shape[0]):
        for a in range(directions.shape[1]):
            poses[i, a] = placed(here[a] + reach * directions[i, a], periods[a])
    return poses


@njit(cache=True)
def step_down(
    here: FloatArray, cost: float, poses: FloatArray, state: OracleState, metric: Metric, out: FloatArray
) -> float:
    """The pose in sight from which the way left is shortest, into ``out``; its cost, infinite for none.

    Args:
        here: (d,) where to go from.
        cost: Its distance to the goal; a pose counts only if it is nearer.
        poses: (m, d) where one might go.
        state: `Oracle.state`.
        metric: Weights and periods of the distance.
        out: (d,) written.
    """
    m = poses.shape[0]
    left, through = np.empty(m), np.empty(m)
    for i in range(m):
        left[i], through[i] = cost_to_go_one(poses[i], state), np.inf
        if left[i] < cost:
            through[i] = left[i] + separation(here, poses[i], metric)
    for _ in range(m):
        i = where_least(through)
        if through[i] == np.inf:
            break
        if motion_free(here, poses[i], state[3]):
            copy_row(poses[i], out)
            return left[i]
        through[i] = np.inf
    return np.inf


@borrowing
def _open_bits(links: LinkArray, v: int, row: int, column: int, above: int) -> int:
    """0 unless all twelve edges of a cell are links; the bits of its corners in common otherwise."""
    a, b, c, d = links[v], links[v + column], links[v + row], links[v + column + row]
    v += above
    e, f, g, h = links[v], links[v + column], links[v + row], links[v + column + row]
    if a & b & e & LINK_Y and a & c & e & LINK_X and a & b & c & d & LINK_THETA and f & LINK_Y and g & LINK_X:
        return (a & b & c & d & e & f & g & h & SEES_GOAL) | _OPEN_CELL
    return 0


@borrowing
def _trilinear(
    field: FieldArray, v: int, row: int, column: int, above: int, fx: float, fy: float, ft: float
) -> float:
    low = field[v] + fx * (field[v + column] - field[v])
    high = field[v + row] + fx * (field[v + column + row] - field[v + row])
    lower = low + fy * (high - low)
    v += above
    low = field[v] + fx * (field[v + column] - field[v])
    high = field[v + row] + fx * (field[v + column + row] - field[v + row])
    return lower + ft * (low + fy * (high - low) - lower)


@owning
def _beside_obstacles(
    field: FieldArray,
    links: LinkArray,
    frame: FloatArray,
    geometry: Geometry,
    x: float,
    y: float,
    theta: float,
    straight: float,
) -> float:
    """The cost-to-go where the cell around the pose is not open."""
    numbers, index = geometry
    if not _pose_free(numbers, index, x, y, theta):
        return np.inf
    walked = 0.0
    for _ in range(_HOPS):
        for ring in range(_WIDEST + 1):
            targets, costs = _targets(field, frame, x, y, theta, ring)
            while True:
                n = where_least(costs)
                if costs[n] == np.inf:
                    break
                t = targets[n]
                if _motion_fraction(numbers, index, x, y, theta, t[0], t[1], t[2], bool(YES)) < 1.0:
                    costs[n] = np.inf
                    continue
                u = costs[n]
                if ring == 0 and n > 0:
                    u = _blend(field, links, frame, x, y, theta, n - 1)
                return max(walked + u, straight)
        # Wedged in: move along the axis in which the pose gets farthest, up to one link.
        best, best_length = np.zeros(3), 0.0
        for side in range(6 if frame[COUNT_THETA] > 1.0 else 4):
            t = np.zeros(3)
            t[side >> 1] = (1 - 2 * (side & 1)) * frame[STEP_X + (side >> 1)]
            part = _motion_fraction(numbers, index, x, y, theta, t[0], t[1], t[2], bool(NO))
            # Half of what is free leaves room on both sides.
            part = part if part == 1.0 else 0.5 * part
            t[0], t[1], t[2] = t[0] * part, t[1] * part, t[2] * part
            length = math.sqrt(t[0] * t[0] + t[1] * t[1] + (frame[WEIGHT] * t[2]) ** 2)
            if length > best_length:
                best, best_length = t, length
        x, y, theta, walked = x + best[0], y + best[1], theta + best[2], walked + best_length
    return np.inf


@njit(cache=True)
def _targets(
    field: FieldArray, frame: FloatArray, x: float, y: float, theta: float, ring: int
) -> tuple[FloatArray, FloatArray]:
    """Motions (n, 3) by which a pose may reach something known, and the cost-to-go (n,) each would give.

    The first leads to the goal, the others to the corners of the cell around the pose and the rings around
    it; the cost is infinite where that makes no sense.
    """
    depth = 0 if frame[COUNT_THETA] == 1.0 else 1
    nt = int(frame[COUNT_THETA])
    gx, gy = (x - frame[ORIGIN_X]) / frame[STEP_X], (y - frame[ORIGIN_Y]) / frame[STEP_Y]
    gt = theta / frame[STEP_THETA] * depth
    i, j, k = math.floor(gx), math.floor(gy), math.floor(gt)
    side, layers = 2 + 2 * ring, 2 + 2 * ring * depth
    targets, costs = np.empty((1 + side * side * layers, 3)), np.empty(1 + side * side * layers)
    turn = wrapped(frame[GOAL + 2] - theta) * depth
    targets[0, 0], targets[0, 1], targets[0, 2] = frame[GOAL] - x, frame[GOAL + 1] - y, turn
    costs[0] = _length(frame, targets[0])
    if costs[0] > frame[SIGHT]:
        costs[0] = np.inf
    for n in range(side * side * layers):
        # In the cell itself, the bits of n are the corner's offsets along x, y and theta.
        a, b, c = i - ring + n % side, j - ring + n // side % side, k + (n // (side * side) - ring) * depth
        costs[n + 1] = np.inf
        if 0 <= a < frame[COUNT_X] and 0 <= b < frame[COUNT_Y] and (depth or n < side * side):
            u = field[((a + PAD) * (int(frame[COUNT_Y]) + 2 * PAD) + b + PAD) * nt + c % nt]
            targets[n + 1, 0] = (a - gx) * frame[STEP_X]
            targets[n + 1, 1] = (b - gy) * frame[STEP_Y]
            targets[n + 1, 2] = (c - gt) * frame[STEP_THETA]
            costs[n + 1] = u + _length(frame, targets[n + 1])
    return targets, costs


@borrowing
def _length(frame: FloatArray, motion: FloatArray) -> float:
    return math.sqrt(motion[0] ** 2 + motion[1] ** 2 + (frame[WEIGHT] * motion[2]) ** 2)


@njit(cache=True)
def _blend(
    field: FieldArray, links: LinkArray, frame: FloatArray, x: float, y: float, theta: float, start: int
) -> float:
    """Value from the corner `start` of the cell around a pose and the corners that its links join to it.

    Each speaks with its own linear model, weighted as in a trilinear interpolation.
    """
    depth = 0 if frame[COUNT_THETA] == 1.0 else 1
    nt = int(frame[COUNT_THETA])
    gx, gy = (x - frame[ORIGIN_X]) / frame[STEP_X], (y - frame[ORIGIN_Y]) / frame[STEP_Y]
    gt = theta / frame[STEP_THETA] * depth
    i, j, k = math.floor(gx), math.floor(gy), math.floor(gt)
    corners = np.empty(8, dtype=np.int64)
    for c in range(8):
        column = i + (c & 1) + PAD
        row = j + (c >> 1 & 1) + PAD
        angle = (k + (c >> 2) * depth) % nt
        corners[c] = (column * (int(frame[COUNT_Y]) + 2 * PAD) + row) * nt + angle
    mask = _joined(links, corners, start, 2 + depth)
    total, summed, lowest, highest = 0.0, 0.0, -np.inf, np.inf
    offset = np.empty(3)
    for c in range(8):
        if not mask & (1 << c):
            continue
        v = corners[c]
        offset[0], offset[1], offset[2] = gx - i - (c & 1), gy - j - (c >> 1 & 1), gt - k - (c >> 2)
        share = (1.0 - abs(offset[0])) * (1.0 - abs(offset[1])) * (1.0 - abs(offset[2])) + 1e-9
        u = float(field[v])
        for axis in range(2 + depth):
            u += offset[axis] * _slope(field, links, frame, v, axis)
        summed += share * u
        total += share
        for axis in range(3):
            offset[axis] *= frame[STEP_X + axis]
        apart = _length(frame, offset)
        lowest, highest = max(lowest, field[v] - apart), min(highest, field[v] + apart)
    return min(max(summed / total, lowest), highest)


@borrowing
def _slope(field: FieldArray, links: LinkArray, frame: FloatArray, v: int, axis: int) -> float:
    """Upwind difference of the field at v along one axis, per link."""
    lo, hi = along(frame, v, axis, int(-ONE)), along(frame, v, axis, int(ONE))
    below = field[lo] if links[lo] & (1 << axis) else np.float32(np.inf)
    above = field[hi] if links[v] & (1 << axis) else np.float32(np.inf)
    if below <= above:
        return max(field[v] - below, 0.0) if below < np.inf else 0.0
    return -max(field[v] - above, 0.0)


@borrowing
def _joined(links: LinkArray, corners: npt.NDArray[np.int64], start: int, axes: int) -> int:
    """Bit mask of the corners of a cell that its own links join to the corner `start`."""
    mask, grown = 1 << start, True
    while grown:
        grown = False
        for c in range(1 << axes):
            for axis in range(axes):
                lower = corners[c & ~(1 << axis)]
                if mask & (1 << (c ^ (1 << axis))) and not mask & (1 << c) and links[lower] & (1 << axis):
                    mask |= 1 << c
                    grown = True
    return mask
