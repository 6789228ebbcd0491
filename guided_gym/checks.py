"""What a caller hands in, checked at the door: numbers, counts, switches and kinds of objects."""

from __future__ import annotations

import math
import os
from typing import Any, Final, TypeVar

import numpy as np

from guided_gym.errors import InvalidInputError

T = TypeVar("T")

MEMORY_VARIABLE: Final = "GUIDED_GYM_MAX_MEMORY"
MEMORY_LIMIT: Final = 4 * 10**9
"""Bytes that one option may ask for, unless the environment variable says otherwise."""


def number(
    name: str,
    value: object,
    *,
    least: float | None = None,
    above: float | None = None,
    below: float | None = None,
    what: str = "number",
) -> float:
    """A finite number within limits.

    Args:
        name: What the message calls the value.
        value: What came.
        least: The smallest value allowed.
        above: Values have to be greater than this.
        below: Values have to be smaller than this.
        what: What kind of number it is, for the message.

    Raises:
        InvalidInputError: It is no number (a boolean is none), NaN, infinite or out of the limits.
    """
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        number = float(value)
        if (
            math.isfinite(number)
            and (least is None or number >= least)
            and (above is None or number > above)
            and (below is None or number < below)
        ):
            return number
    limits = (("at least", least), ("above", above), ("below", below))
    said = " and ".join(f"{word} {limit:g}" for word, limit in limits if limit is not None)
    if above == 0 and below is None:
        raise InvalidInputError(f"{name}: expected a positive {what}, got {value!r}")
    raise InvalidInputError(f"{name}: expected a finite {what} {said}".rstrip() + f", got {value!r}")


def integer(name: str, value: object, *, least: int) -> int:
    """An integer that is large enough.

    Raises:
        InvalidInputError: It is no integer (a boolean is none), or smaller.
    """
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and value >= least:
        return int(value)
    raise InvalidInputError(f"{name}: expected an integer, at least {least}, got {value!r}")


def affordable(name: str, value: object, size: int, what: str) -> None:
    """Refuse what would take more memory than a caller is likely to mean.

    Args:
        name: What the message calls the value.
        value: What came.
        size: Bytes that it would take.
        what: What would take them.

    Raises:
        InvalidInputError: It is more than `MEMORY_VARIABLE` allows, by default `MEMORY_LIMIT`.
    """
    limit = _memory_limit()
    if size > limit:
        raise InvalidInputError(
            f"{name}: {what} would take {_gigabytes(size)} of memory at {value!r}, expected at most "
            f"{_gigabytes(limit)}; {MEMORY_VARIABLE} (bytes) raises the limit"
        )


def _memory_limit() -> int:
    given = os.environ.get(MEMORY_VARIABLE, "").strip()
    if not given:
        return MEMORY_LIMIT
    try:
        return int(float(given))
    except (ValueError, OverflowError):
        raise InvalidInputError(f"{MEMORY_VARIABLE}: expected a number of bytes, got {given!r}") from None


def _gigabytes(size: int) -> str:
    # Integers of any size: those that make no float are not written out either.
    return f"{size / 1e9:.3g} GB" if size < 10**24 else "more than 1e+15 GB"


def flag(name: str, value: object) -> bool:
    """True or False.

    Raises:
        InvalidInputError: It is something else.
    """
    if isinstance(value, bool | np.bool_):
        return bool(value)
    raise InvalidInputError(f"{name}: expected True or False, got {value!r}")


def instance(name: str, value: Any, kind: type[T], called: str = "") -> T:
    """An object of one class, which messages call by another name if one is given.

    Raises:
        InvalidInputError: It is of another class.
    """
    if isinstance(value, kind):
        return value
    raise InvalidInputError(f"{name}: expected {_article(called or kind.__name__)}, got {value!r}")


def same_place(one: Any, other: Any) -> bool:
    """Whether two classes or functions were defined in the same place, as when a module is loaded twice."""
    if one is other:
        return True
    names = [(getattr(x, "__module__", None), getattr(x, "__qualname__", None)) for x in (one, other)]
    return names[0] == names[1] and None not in names[0] and "<lambda>" not in str(names[0][1])


def _article(noun: str) -> str:
    return f"{'an' if noun[0] in 'AEIOU' else 'a'} {noun}"
