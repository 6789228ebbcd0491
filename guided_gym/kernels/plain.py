"""What compiles in less time than numba's own, and kernels without reference counts.

Constants for what kernels pass each other: ``int(ONE)`` is a number, 1 and True are literals, and what is
called with a literal is compiled once more. And what takes the place of ``out[:] = row`` and `numpy.argmin`.
"""
# mypy: disable-error-code="misc,no-any-return"

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, TypeVar, cast, overload

import numpy as np
from numba import njit
from numpy.typing import NDArray

F = TypeVar("F", bound=Callable[..., Any])

ZERO: Final = 0
ONE: Final = 1
YES: Final = True
NO: Final = False


@overload
def borrowing(kernel: F) -> F: ...


@overload
def borrowing(*, error_model: str) -> Callable[[F], F]: ...


def borrowing(kernel: F | None = None, **options: str) -> F | Callable[[F], F]:
    """Compile a kernel that makes no arrays and returns none: it counts no references to what it is given.

    numba counts references wherever an array gets another name, by atomic operations, and spares itself only
    some of them: they took up to half of the time of small kernels that call each other. Whoever calls such a
    kernel holds its arrays. A view that it returned would be let go once too often, so it returns numbers
    only. What it calls is `borrowing`, too, or `owning`: numba compiles what is called by its first caller's
    options.
    """
    compiled: Callable[[F], F] = cast(Any, njit)(cache=True, _nrt=False, **options)
    return compiled if kernel is None else compiled(kernel)


def owning(kernel: F) -> F:
    """Compile a kernel that makes arrays though it is called from one that is `borrowing`; see there."""
    compiled: F = cast(Any, njit)(cache=True, _nrt=True)(kernel)
    return compiled


@borrowing
def copy_row(row: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """Write a row (d,) into another one of the same length."""
    for a in range(row.size):
        out[a] = row[a]


@borrowing
def where_least(values: NDArray[np.float64]) -> int:
    """Index of the least of values (n,), the first on ties; none may be NaN."""
    least = 0
    for i in range(1, values.size):
        if values[i] < values[least]:
            least = i
    return least
