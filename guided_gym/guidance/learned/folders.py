"""Where learned agents are: those that come with the package, and folders of your own."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from guided_gym.errors import UnknownNameError
from guided_gym.guidance.learned import weights

SHIPPED: Final = Path(__file__).parent / "shipped"


def shipped_agents() -> list[str]:
    """Names of the agents that come with the package."""
    if not SHIPPED.is_dir():
        return []
    return sorted(path.parent.name for path in SHIPPED.glob(f"*/{weights.CARD_FILE}"))


def agent_folder(name: str) -> Path:
    """The folder of a shipped agent or of one of your own.

    Raises:
        UnknownNameError: Neither a shipped agent nor a folder.
    """
    if name in shipped_agents():
        return SHIPPED / name
    folder = Path(name)
    try:
        there = bool(name) and folder.is_dir()
    except (OSError, ValueError):  # longer than any path
        there = False
    if not there:
        raise UnknownNameError("learned agent (and no such folder)", name, shipped_agents())
    return folder


def stamp_of(folder: Path) -> tuple[int, ...]:
    """Times and sizes of an agent's files, which change as the files do; 0 for a missing file."""
    stamp: list[int] = []
    for file in (weights.CARD_FILE, weights.WEIGHTS_FILE):
        found = (folder / file).stat() if (folder / file).is_file() else None
        stamp += [found.st_mtime_ns, found.st_size] if found else [0, 0]
    return tuple(stamp)
