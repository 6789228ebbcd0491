"""The one exception family of the package, and its warnings."""

from __future__ import annotations

import difflib
import warnings
from collections.abc import Iterable


class GuidedGymError(Exception):
    """Root of every error that this package raises on purpose.

    Each message says what was expected, what came, and where.
    """


class InvalidInputError(GuidedGymError, ValueError):
    """A value handed in by the caller cannot be used (bad geometry, NaN, a start in collision, ...)."""


class UnknownNameError(GuidedGymError, KeyError):
    """A name (environment, guidance, option) that is not in its table."""

    def __init__(self, kind: str, name: object, known: Iterable[str]) -> None:
        known = sorted(known)
        close = difflib.get_close_matches(str(name), known, n=1, cutoff=0.4)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        self.message = f"unknown {kind} {name!r}{hint} (known: {', '.join(known)})"
        super().__init__(self.message)

    def __str__(self) -> str:
        return self.message

    def __reduce__(self) -> tuple[object, ...]:
        return _restored, (self.message,)  # the message alone comes back from a worker process


def _restored(message: str) -> UnknownNameError:
    error = UnknownNameError.__new__(UnknownNameError, message)
    error.message = message
    return error


class NoPathError(GuidedGymError):
    """The oracle proved, to its resolution, that no path joins start and goal."""


class StorageError(GuidedGymError):
    """A file of ours (database, cache, results) is corrupt, foreign or cannot be written."""


class GuidedGymWarning(RuntimeWarning):
    """Something that this package does without, or does more slowly than it could."""


def warn(message: str) -> None:
    """Warn of something that no line of the caller's code is to blame for: none is shown with it."""
    warnings.warn_explicit(message, GuidedGymWarning, "guided-gym", 0)
