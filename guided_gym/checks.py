"""What a caller hands in, checked at the door: numbers, counts, switches and kinds of objects."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Set
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from guided_gym.errors import InvalidInputError

T = TypeVar("T")

_LONGEST: Final = 200  # characters of a value that a message repeats

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
        try:
            number = float(value)
        except OverflowError:  # an integer beyond all floats
            number = math.inf
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
        raise InvalidInputError(f"{name}: expected a positive {what}, got {shown(value)}")
    raise InvalidInputError(f"{name}: expected a finite {what} {said}".rstrip() + f", got {shown(value)}")


def integer(name: str, value: object, *, least: int) -> int:
    """An integer that is large enough.

    Raises:
        InvalidInputError: It is no integer (a boolean is none), or smaller.
    """
    if isinstance(value, int | np.integer) and not isinstance(value, bool) and value >= least:
        return int(value)
    raise InvalidInputError(f"{name}: expected an integer, at least {least}, got {shown(value)}")


def count(name: str, value: object, *, least: int, each: float, what: str) -> int:
    """An integer that is large enough, of things that together take no more memory than `affordable` says.

    Args:
        name: What the message calls the value.
        value: What came.
        least: The smallest value allowed.
        each: Bytes that one of them takes.
        what: What takes them.

    Raises:
        InvalidInputError: It is no integer, smaller, or too large.
    """
    number = integer(name, value, least=least)
    # In integers, which have no largest; a float of some sizes would be infinite.
    affordable(name, number, number * max(round(each * 16), 1) // 16, what)
    return number


def vector(name: str, value: object, size: int | None = None) -> NDArray[np.float64]:
    """A vector of finite numbers, as an array of its own.

    Args:
        name: What the message calls the value.
        value: What came: a sequence or array of numbers; text and booleans are none.
        size: How many; None for any number.

    Raises:
        InvalidInputError: It is something else.
    """
    if not isinstance(value, str | bytes | bytearray | Set | Mapping):
        try:
            array = np.array(value)
            if array.dtype == object and all(map(_is_number, array.flat)):  # integers of many digits
                array = array.astype(np.float64)
        except (TypeError, ValueError, OverflowError):
            array = np.zeros(0, object)
        fits = array.ndim == 1 and size in (None, array.size)
        if fits and array.dtype.kind in "iuf" and np.isfinite(array).all():
            return array.astype(np.float64)
    many = "a vector of" if size is None else f"{size}"
    raise InvalidInputError(f"{name}: expected {many} finite numbers, got {shown(value)}")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)


def shown(value: object) -> str:
    """A value as a message shows it: in one line, and not endlessly long."""
    try:
        text = repr(value)
    except Exception as error:  # Python writes integers of 4,300 digits at most; others do as they like
        text = f"{_article(type(value).__name__)} that cannot be written ({type(error).__name__})"
    text = " ".join(text.split())
    return text if len(text) <= _LONGEST else text[:_LONGEST] + "…"


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
            f"{name}: {what} would take {_gigabytes(size)} of memory at {shown(value)}, expected at most "
            f"{_gigabytes(limit)}; {MEMORY_VARIABLE} (bytes) raises the limit"
        )


def is_affordable(size: int) -> bool:
    """Whether so many bytes are no more than a caller may be thought to mean, see `affordable`."""
    return size <= _memory_limit()


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
    raise InvalidInputError(f"{name}: expected True or False, got {shown(value)}")


def instance(name: str, value: Any, kind: type[T], called: str = "") -> T:
    """An object of one class, which messages call by another name if one is given.

    Raises:
        InvalidInputError: It is of another class.
    """
    if isinstance(value, kind):
        return value
    raise InvalidInputError(f"{name}: expected {_article(called or kind.__name__)}, got {shown(value)}")


def same_place(one: Any, other: Any) -> bool:
    """Whether two classes or functions were defined in the same place, as when a module is loaded twice."""
    if one is other:
        return True
    names = [(getattr(x, "__module__", None), getattr(x, "__qualname__", None)) for x in (one, other)]
    return names[0] == names[1] and None not in names[0] and "<lambda>" not in str(names[0][1])


def _article(noun: str) -> str:
    return f"{'an' if noun[0] in 'AEIOUaeiou' else 'a'} {noun}"
