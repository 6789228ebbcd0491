"""Where drawn problems put the robot: free poses in a part of the workspace."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.errors import NoPathError
from guided_gym.geometry.environment import Bounds
from guided_gym.geometry.space import ConfigurationSpace

BATCH: Final = 32
BATCHES: Final = 32


def free_pose(
    space: ConfigurationSpace,
    rng: np.random.Generator,
    area: Bounds | None = None,
    tries: tuple[int, int] = (BATCH, BATCHES),
) -> NDArray[np.float64]:
    """(d,) a free pose, uniform among those whose reference point is in ``area``.

    Args:
        space: Configuration space.
        rng: Source of the draws.
        area: (xmin, ymin, xmax, ymax); None for the whole workspace.
        tries: How many are drawn at once, and how often at most.

    Raises:
        NoPathError: None was found; the area is as good as full.
    """
    lower, upper = space.lower.copy(), space.upper.copy()
    if area is not None:
        lower[:2] = np.maximum(area[:2], lower[:2])
        upper[:2] = np.minimum(area[2:], upper[:2])
    at_once, rounds = tries
    for _ in range(rounds):
        poses = lower + rng.random((at_once, space.dimension)) * (upper - lower)
        free = np.flatnonzero(space.valid(poses))
        if free.size:
            pose: NDArray[np.float64] = poses[free[0]]
            return pose
    raise NoPathError(
        f"expected a free pose in {area or space.environment.bounds}, got none in {at_once * rounds} draws"
    )
