"""The environment of a problem file, for `gymnasium.make`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from guided_gym.catalogue.file_problems import file_distribution
from guided_gym.envs.guided_search_env import GuidedSearchEnv


class ProblemFileEnv(GuidedSearchEnv):
    """`GuidedSearchEnv` on a file's problem: ``gym.make("guided_gym/ProblemFile-v0", path="office.toml")``.

    Args:
        path: A problem file (``.toml`` or ``.json``) or a MovingAI scenario (``.scen``).
        **options: Those of `GuidedSearchEnv`.

    Raises:
        StorageError: The file cannot be read, or is damaged.
        InvalidInputError: Its problem cannot be used.
    """

    def __init__(self, path: str | Path, **options: Any) -> None:
        super().__init__(file_distribution(str(path)), **options)
