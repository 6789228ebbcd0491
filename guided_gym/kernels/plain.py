"""Constants for what kernels pass each other: ``int(ONE)`` is a number, 1 and True are literals.

numba compiles what is called with a literal once more; see `guided_gym.kernels`.
"""

from __future__ import annotations

from typing import Final

ZERO: Final = 0
ONE: Final = 1
YES: Final = True
NO: Final = False
