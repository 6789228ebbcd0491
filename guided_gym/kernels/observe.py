"""What is observed of a tree, node by node: one row of features each."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from guided_gym.kernels.collision import Geometry, pose_clearance
from guided_gym.kernels.metric import shortest

Floats = NDArray[np.float64]

# Where the scales of one search stand; lengths unless it says otherwise.
X, Y, WIDTH, HEIGHT, UNIT, ROOM, TURN_WEIGHT, ANGLE = range(8)
SCALES: Final = 8
"""Lower corner and size of the bounds, diameter of C, half the shorter side, length per radian of the turn;
which coordinate the angle is (-1: the robot cannot turn)."""
FEATURES: Final = 14
"""`guided_gym.envs.observations.NodeColumn` says what each is."""
PLACE: Final = 9
"""The first of the four features that change while the tree grows; clearance comes after them."""


@njit(cache=True)
def _clipped(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@njit(cache=True)
def observe_configuration(
    row: NDArray[np.float32], q: Floats, goal: Floats, scales: Floats, geometry: Geometry
) -> None:
    """Write the features that depend on the configuration alone.

    Args:
        row: (FEATURES,) float32, written but for the four from PLACE on.
        q: (d,) configuration of the node.
        goal: (d,) the goal t.
        scales: (SCALES,) of the search.
        geometry: What the collision kernels take.
    """
    angle, turn, periodic = 0.0, 0.0, int(scales[ANGLE])
    if periodic >= 0:
        angle = q[periodic]
        turn = shortest(goal[periodic] - angle, 2.0 * math.pi)
    dx, dy = goal[0] - q[0], goal[1] - q[1]
    around = scales[TURN_WEIGHT] * turn
    # Positions may leave the bounds where the robot lies beside its reference point.
    row[0] = _clipped(2.0 * (q[0] - scales[X]) / scales[WIDTH] - 1.0, -1.0, 1.0)
    row[1] = _clipped(2.0 * (q[1] - scales[Y]) / scales[HEIGHT] - 1.0, -1.0, 1.0)
    row[2] = math.cos(angle)
    row[3] = math.sin(angle)
    row[4] = _clipped(dx / scales[WIDTH], -1.0, 1.0)
    row[5] = _clipped(dy / scales[HEIGHT], -1.0, 1.0)
    row[6] = math.cos(turn)
    row[7] = math.sin(turn)
    row[8] = _clipped(math.sqrt(dx * dx + dy * dy + around * around) / scales[UNIT], 0.0, 1.0)
    row[13] = _clipped(pose_clearance(q, geometry) / scales[ROOM], 0.0, 1.0)


@njit(cache=True)
def observe_place(
    row: NDArray[np.float32],
    cost: float,
    counts: tuple[int, int, int],
    unit: float,
    highest: float,
    logarithms: Floats,
) -> None:
    """Write the four features that change while the tree grows.

    Args:
        row: (FEATURES,) float32.
        cost: d_T(s, v), a length.
        counts: Edges from the root, children, failed expansions.
        unit: Diameter of C.
        highest: Where the cost, in units, is clipped.
        logarithms: What is shown of a count, up to the last.
    """
    last = logarithms.size - 1
    row[PLACE] = min(cost / unit, highest)
    row[PLACE + 1] = logarithms[min(counts[0], last)]
    row[PLACE + 2] = logarithms[min(counts[1], last)]
    row[PLACE + 3] = logarithms[min(counts[2], last)]
