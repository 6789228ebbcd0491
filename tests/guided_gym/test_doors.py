"""Arguments held to their annotations: what is refused, and what is left alone."""

from __future__ import annotations

from typing import Any

import pytest

from guided_gym.doors import door
from guided_gym.errors import InvalidInputError


@door
def halved(anything: Any, thing: object, number: float) -> float:
    """Half a number; the others may be of any kind."""
    return number / 2


def test_door__names_the_argument_that_does_not_fit() -> None:
    assert halved(None, None, 3) == 1.5
    with pytest.raises(InvalidInputError, match=r"number: expected a number, got 'a'"):
        halved(1, [2], "a")  # type: ignore[arg-type]


def test_door__any_fits_any_and_an_error_of_the_caller_goes_on() -> None:
    @door
    def called(anything: Any) -> None:
        raise KeyError("theirs")

    with pytest.raises(KeyError, match="theirs"):
        called(object())
