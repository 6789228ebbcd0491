"""What is observed of a tree, node by node: one row of features each."""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.kernels.collision import Geometry, pose_clearance, position
from guided_gym.kernels.metric import shortest
from guided_gym.kernels.plain import borrowing

Floats = NDArray[np.float64]

# Where the scales of one search stand; lengths unless it says otherwise.
X, Y, WIDTH, HEIGHT, UNIT, ROOM, ANGLE, ANGLES, SHOWN = range(9)
WEIGHTS: Final = 9
MOST_ANGLES: Final = 16
PERIODS: Final = WEIGHTS + MOST_ANGLES
SCALES: Final = PERIODS + MOST_ANGLES
"""Lower corner and size of the bounds, diameter of C, half the shorter side; which coordinate the first angle
is, how many there are, and for how many there are columns; length per radian and period of each angle."""
TAIL: Final = 6
"""Features after those of places and angles: distance to the goal, four that change while the tree grows, and
clearance. `guided_gym.envs.observations.NodeColumn` says what each is."""
PLACE: Final = 5
"""Where the four that change begin, from the end."""


@borrowing
def _clipped(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


@borrowing
def observe_configuration(
    row: NDArray[np.float32], q: Floats, goal: Floats, scales: Floats, geometry: Geometry
) -> None:
    """Write the features that depend on the configuration alone.

    Args:
        row: (F,) float32, written but for the four that change.
        q: (d,) configuration of the node.
        goal: (d,) the goal t.
        scales: (SCALES,) of the search.
        geometry: What the collision kernels take.
    """
    first, angles, shown = int(scales[ANGLE]), int(scales[ANGLES]), int(scales[SHOWN])
    x, y = position(q, geometry)
    goal_x, goal_y = position(goal, geometry)
    # Positions may leave the bounds where the robot lies beside its reference point.
    row[0] = _clipped(2.0 * (x - scales[X]) / scales[WIDTH] - 1.0, -1.0, 1.0)
    row[1] = _clipped(2.0 * (y - scales[Y]) / scales[HEIGHT] - 1.0, -1.0, 1.0)
    to_goal = 2 + 2 * shown
    row[to_goal] = _clipped((goal_x - x) / scales[WIDTH], -1.0, 1.0)
    row[to_goal + 1] = _clipped((goal_y - y) / scales[HEIGHT], -1.0, 1.0)
    squared = 0.0
    if first > 0 or angles == 0:  # a base that moves
        dx, dy = goal[0] - q[0], goal[1] - q[1]
        squared = dx * dx + dy * dy
    for k in range(shown):
        angle, turn = 0.0, 0.0
        if k < angles:
            angle = q[first + k]
            turn = shortest(goal[first + k] - angle, scales[PERIODS + k])
            around = scales[WEIGHTS + k] * turn
            squared += around * around
        row[2 + 2 * k] = math.cos(angle)
        row[3 + 2 * k] = math.sin(angle)
        row[to_goal + 2 + 2 * k] = math.cos(turn)
        row[to_goal + 3 + 2 * k] = math.sin(turn)
    row[row.size - TAIL] = _clipped(math.sqrt(squared) / scales[UNIT], 0.0, 1.0)
    row[row.size - 1] = _clipped(pose_clearance(q, geometry) / scales[ROOM], 0.0, 1.0)


@borrowing
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
        row: (F,) float32.
        cost: d_T(s, v), a length.
        counts: Edges from the root, children, failed expansions.
        unit: Diameter of C.
        highest: Where the cost, in units, is clipped.
        logarithms: What is shown of a count, up to the last.
    """
    last, at = logarithms.size - 1, row.size - PLACE
    row[at] = min(cost / unit, highest)
    row[at + 1] = logarithms[min(counts[0], last)]
    row[at + 2] = logarithms[min(counts[1], last)]
    row[at + 3] = logarithms[min(counts[2], last)]
