"""The environment of an arm in space, for `gymnasium.make`: ours, or that of a URDF file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from guided_gym.catalogue.spatial import shelves_for
from guided_gym.catalogue.table import make_distribution
from guided_gym.envs.guided_search_env import GuidedSearchEnv


class SpatialArmEnv(GuidedSearchEnv):
    """`GuidedSearchEnv` on an arm before shelves: ``gym.make("guided_gym/SpatialArm-v0", urdf="ur5.urdf")``.

    Args:
        urdf: A URDF file, before whose arm shelves are drawn, as large as it reaches; None for the arm of
            seven joints that comes with the package, and its one task.
        tip: The link at the end of the file's chain, where it has several ends.
        arm: Other arguments of `SpatialArm.from_urdf`.
        **options: Those of `GuidedSearchEnv`.

    Raises:
        InvalidInputError: As `SpatialArm.from_urdf`.
    """

    def __init__(
        self,
        urdf: str | Path | None = None,
        tip: str | None = None,
        *,
        arm: dict[str, Any] | None = None,
        **options: Any,
    ) -> None:
        distribution = (
            make_distribution("SpatialArm") if urdf is None else shelves_for(urdf, tip, **(arm or {}))
        )
        super().__init__(distribution, **options)
