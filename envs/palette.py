"""The colours that frames and figures share; colour-blind people can tell them apart, too."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int]

PAPER: Colour = (255, 255, 255)
FREE: Colour = (248, 247, 244)
OBSTACLE: Colour = (74, 82, 94)
FRAME: Colour = (74, 82, 94)
INK: Colour = (33, 37, 43)
MUTED: Colour = (116, 123, 133)
START: Colour = (0, 114, 178)  # Okabe-Ito blue
GOAL: Colour = (0, 138, 100)  # Okabe-Ito bluish green, a shade darker for thin lines
PATH: Colour = (213, 44, 20)
FAILURE: Colour = (213, 44, 20)

# Nine stops of viridis, from its bright end (little Q) to its dark end (much Q); the brightest tenth is left
# out, as it would vanish on a light background.
_STOPS = np.array(
    [
        (187, 223, 39),
        (137, 213, 72),
        (83, 197, 104),
        (42, 176, 127),
        (32, 146, 140),
        (42, 117, 142),
        (56, 86, 140),
        (70, 48, 126),
        (68, 1, 84),
    ],
    np.float64,
)
LEVELS = 256


def _table() -> NDArray[np.uint8]:
    at = np.linspace(0.0, 1.0, LEVELS)
    stops = np.linspace(0.0, 1.0, len(_STOPS))
    channels = [np.interp(at, stops, _STOPS[:, i]) for i in range(3)]
    table = np.rint(np.stack(channels, axis=1)).astype(np.uint8)
    table.setflags(write=False)
    return table


TARGET_COLOURS = _table()
"""(256, 3) uint8: from little target probability (light) to much (dark)."""


def target_levels(target: NDArray[np.float64], floor: float = 1e-4) -> NDArray[np.intp]:
    """(n,) rows of `TARGET_COLOURS` for target probabilities (n,): log scale, ``floor`` to the largest."""
    lowest = np.log(floor)
    logs = np.log(np.maximum(target, floor))
    span = max(float(logs.max()) - lowest, np.log(10.0))
    levels: NDArray[np.intp] = np.rint((logs - lowest) / span * (LEVELS - 1)).astype(np.intp)
    return levels


def hexadecimal(colour: Colour) -> str:
    """The colour as ``#rrggbb``, for matplotlib."""
    return "#{:02x}{:02x}{:02x}".format(*colour)
