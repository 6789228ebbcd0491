"""The Gymnasium ids, as a table; registered when `guided_gym` is imported."""

from __future__ import annotations

from typing import Final

import gymnasium

# By string, so that the core does not import the environment, which stands above it.
ENTRY_POINT: Final = "guided_gym.envs.guided_search_env:GuidedSearchEnv"
VECTOR_ENTRY_POINT: Final = "guided_gym.envs.vector_env:make_vector"

# id -> name in `guided_gym.catalogue.table`. Behaviour changes of an environment need a new version suffix.
ENVIRONMENTS: Final[dict[str, str]] = {
    "guided_gym/SimplePassage-v0": "SimplePassage",
    "guided_gym/Cup-v0": "Cup",
    "guided_gym/Trap-v0": "Trap",
    "guided_gym/TrapCup-v0": "TrapCup",
    "guided_gym/RandomSimplePassage-v0": "RandomSimplePassage",
    "guided_gym/RandomTrapCup-v0": "RandomTrapCup",
    "guided_gym/RandomClutter-v0": "RandomClutter",
    "guided_gym/RandomMaze-v0": "RandomMaze",
    "guided_gym/RandomPointMaze-v0": "RandomPointMaze",
    "guided_gym/HardPointMaze-v0": "HardPointMaze",
    "guided_gym/HardStickMaze-v0": "HardStickMaze",
    "guided_gym/Building-v0": "Building",
    "guided_gym/RandomBuilding-v0": "RandomBuilding",
    "guided_gym/PlanarArm2-v0": "PlanarArm2",
    "guided_gym/PlanarArm4-v0": "PlanarArm4",
    "guided_gym/PlanarArm7-v0": "PlanarArm7",
    "guided_gym/RandomPlanarArm4-v0": "RandomPlanarArm4",
    "guided_gym/RandomPlanarArm7-v0": "RandomPlanarArm7",
    "guided_gym/Snake7-v0": "Snake7",
    "guided_gym/RandomSpatialArm-v0": "RandomSpatialArm",
}

SELECTION_ENTRY_POINT: Final = "guided_gym.envs.guide_selection_env:GuideSelectionEnv"

# Those in which the action is the guiding space that guides, likewise.
SELECTIONS: Final[dict[str, str]] = {
    "guided_gym/GuideSelection-v0": "TrapCup",
    "guided_gym/RandomGuideSelection-v0": "RandomTrapCup",
}

# On an arm in space: ours, or that of the URDF file which is the option ``urdf``.
SPATIAL_ENVIRONMENT: Final = "guided_gym/SpatialArm-v0"
SPATIAL_ENTRY_POINT: Final = "guided_gym.envs.spatial_arm_env:SpatialArmEnv"

# On the problem of a file, which is the option ``path``.
FILE_ENVIRONMENT: Final = "guided_gym/ProblemFile-v0"
FILE_ENTRY_POINT: Final = "guided_gym.envs.problem_file_env:ProblemFileEnv"


def register_environments() -> None:
    """Register every id of these tables; those already there are left alone.

    No step limit is registered: the environment truncates by itself, at ``max_samples``.
    """
    for entry_point, table in ((ENTRY_POINT, ENVIRONMENTS), (SELECTION_ENTRY_POINT, SELECTIONS)):
        for name, distribution in table.items():
            if name not in gymnasium.registry:
                gymnasium.register(
                    name,
                    entry_point=entry_point,
                    vector_entry_point=VECTOR_ENTRY_POINT if entry_point is ENTRY_POINT else None,
                    kwargs={"distribution": distribution},
                )
    for name, entry_point in (
        (SPATIAL_ENVIRONMENT, SPATIAL_ENTRY_POINT),
        (FILE_ENVIRONMENT, FILE_ENTRY_POINT),
    ):
        if name not in gymnasium.registry:
            gymnasium.register(name, entry_point=entry_point)
