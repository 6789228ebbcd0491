"""Shapes that the problems are built of: walls with gaps, cups, columns of the workspace."""

from __future__ import annotations

from typing import Final

from shapely.geometry import Polygon, box
from shapely.geometry.base import BaseGeometry

from guided_gym.geometry.robots import Robot

SIZE: Final = 10.0
ROBOT_LENGTH, ROBOT_WIDTH = 0.8, 0.3


def rectangle_robot() -> Robot:
    """The paper's rectangular mobile base."""
    return Robot.rectangle(ROBOT_LENGTH, ROBOT_WIDTH)


def wall(x0: float, x1: float, *gaps: tuple[float, float]) -> list[Polygon]:
    """A wall across the workspace between x0 and x1, open at each (centre, width) of ``gaps``."""
    pieces, bottom = [], 0.0
    for centre, width in sorted(gaps):
        pieces.append(box(x0, bottom, x1, centre - width / 2))
        bottom = centre + width / 2
    pieces.append(box(x0, bottom, x1, SIZE))
    return pieces


def cup(x0: float, x1: float, y0: float, y1: float, thickness: float) -> list[Polygon]:
    """A C-shaped obstacle, open to the left: a dead end for those who come from there."""
    return [
        box(x0, y0, x1, y0 + thickness),
        box(x0, y1 - thickness, x1, y1),
        box(x1 - thickness, y0 + thickness, x1, y1 - thickness),
    ]


def columns(**edges: float) -> dict[str, BaseGeometry]:
    """Regions that are columns of the workspace: each name with its right edge, from left to right."""
    regions, left = {}, 0.0
    for name, right in edges.items():
        regions[name] = box(left, 0.0, right, SIZE)
        left = right
    return regions
