"""The one exception family of the package, and its warnings."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_LONGEST = 200  # characters of a name that a message repeats


class GuidedGymError(Exception):
    """Root of every error that this package raises on purpose.

    Each message says what was expected, what came, and where.
    """


class InvalidInputError(GuidedGymError, ValueError):
    """A value handed in by the caller cannot be used (bad geometry, NaN, a start in collision, ...)."""


@contextmanager
def named(place: str | Path) -> Iterator[None]:
    """Put where it happened before the message of an `InvalidInputError`."""
    try:
        yield
    except InvalidInputError as error:
        raise InvalidInputError(f"{place}: {error}") from None


class UnknownNameError(GuidedGymError, KeyError):
    """A name (environment, guidance, option) that is not in its table.

    Attributes:
        subject: The kind of thing and its name, for messages.
    """

    def __init__(self, kind: str, name: object, known: Iterable[str], where: str = "") -> None:
        known = sorted(known)
        lower = {word.lower(): word for word in reversed(known)}
        close = difflib.get_close_matches(str(name).lower(), lower, n=1, cutoff=0.4)
        hint = f"; did you mean {lower[close[0]]!r}?" if close else ""
        said = repr(name)
        self.subject = f"{kind} {said if len(said) <= _LONGEST else said[:_LONGEST] + '…'}"
        self.message = f"unknown {self.subject}{where and f' {where}'}{hint} (known: {', '.join(known)})"
        super().__init__(self.message)

    def __str__(self) -> str:
        return self.message

    def placed(self, where: str) -> UnknownNameError:
        """This error, saying where in a longer text the name was, unless it does already."""
        if where in self.message:
            return self
        return _restored(f"{self.message} {where}", self.subject, type(self))

    def __reduce__(self) -> tuple[object, ...]:
        # They alone come back from a worker process.
        return _restored, (self.message, self.subject, type(self))


class UnknownOptionError(UnknownNameError, TypeError):
    """An option that a constructor does not know; also a TypeError, in Python's words.

    Libraries that try whether an environment takes an option look for both. Gymnasium raises a TypeError
    anew with a message of its own, so this is made of a message, too: ``UnknownOptionError(message)``.
    """

    def __init__(self, owner: str, name: object = None, known: Iterable[str] | None = None) -> None:
        if known is None:
            self.message, self.subject = owner, "option"
        else:
            super().__init__("option", name, known)
            self.message = f"{owner} got an unexpected keyword argument {str(name)!r}: {self.message}"
        self.args = (self.message,)


def _restored(message: str, subject: str, cls: type[UnknownNameError] = UnknownNameError) -> UnknownNameError:
    error = cls.__new__(cls, message)
    error.message, error.subject = message, subject
    return error


class NoPathError(GuidedGymError):
    """No path joins start and goal: to the oracle's resolution, or by a guiding space's proof.

    Attributes:
        result: The `SearchResult` of a search that ended because a guiding space had proved it; else None.
    """

    result: Any = None

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), self.args  # the message alone comes back from a worker process


class StorageError(GuidedGymError):
    """A file of ours (database, cache, results) is corrupt, foreign or cannot be written."""


class GuidedGymWarning(RuntimeWarning):
    """A warning: something is missing, or slower than it could be."""


def warn(message: str) -> None:
    """Warn of something that no line of the caller's code caused, and show none with it."""
    warnings.warn_explicit(message, GuidedGymWarning, "guided-gym", 0)
