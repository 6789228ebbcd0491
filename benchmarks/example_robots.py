"""Arms of the package example-robot-data, for benchmarks and tests."""

from __future__ import annotations

import sys
from pathlib import Path

FILES = {
    "panda": ("panda_description/urdf/panda.urdf", "panda_hand_tcp"),
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "ee_link"),
}
"""File and tip of each."""


def installed() -> dict[str, tuple[Path, str]]:
    """File and tip of each arm; empty if the package is not installed."""
    for entry in sys.path:
        for above in (Path(entry), *Path(entry).parents[:4]):
            folder = above / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
            if folder.is_dir():
                return {name: (folder / file, tip) for name, (file, tip) in FILES.items()}
    return {}
