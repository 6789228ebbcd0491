"""What compiles in less time than numba's own: see `guided_gym.kernels`.

Constants for what kernels pass each other: ``int(ONE)`` is a number, 1 and True are literals, and what is
called with a literal is compiled once more. And what takes the place of ``out[:] = row`` and `numpy.argmin`.
"""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

ZERO: Final = 0
ONE: Final = 1
YES: Final = True
NO: Final = False


@njit(cache=True)
def copy_row(row: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Write a row (d,) into another one of the same length."""
    for a in range(row.size):
        out[a] = row[a]


@njit(cache=True)
def where_least(values: NDArray[np.float64]) -> int:
    """Index of the least of values (n,), the first on ties; none may be NaN."""
    least = 0
    for i in range(1, values.size):
        if values[i] < values[least]:
            least = i
    return least
