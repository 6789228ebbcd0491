"""Arguments held to their annotations: what is refused, and what is left alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

import guided_gym as gg
from guided_gym.doors import door, doors
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


def test_door__a_huge_integer_for_a_float_becomes_one() -> None:
    @door
    def summed(number: float) -> float:
        if isinstance(number, int):
            raise TypeError("as numpy and numba do with integers beyond 64 bits")
        return number

    assert summed(10**30) == 1e30
    with pytest.raises(InvalidInputError, match="number: expected a number"):
        summed(10**400)


@pytest.mark.parametrize("robot", ["PlanarArm4", "SpatialArm", "Cup"])
def test_configurations_of_another_length_are_refused_by_all_that_robots_offer(robot: str) -> None:
    body = gg.make_distribution(robot).problem(0).robot
    named = [n for n in ("frames", "position", "tool_at", "displacement", "place") if hasattr(body, n)]
    for name in named:
        for q in (np.zeros(2), np.zeros((3, 2)), [0.0, 0.0], (), np.zeros(())):
            with pytest.raises(InvalidInputError):
                getattr(body, name)(q)


def test_methods_that_a_class_inherits_are_held_to_their_annotations_too() -> None:
    with pytest.raises(InvalidInputError, match="environment: expected an Environment"):
        gg.Robot.point().gaps(np.zeros(2), np.float32(0.5))  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match=r"rng: expected a numpy\.random\.Generator"):
        gg.make_distribution("RandomMaze").draw(7)  # type: ignore[arg-type]


def test_a_random_agent_wants_a_seed_that_can_be_one() -> None:
    with pytest.raises(InvalidInputError, match="seed: expected an integer, at least 0, got -1"):
        gg.RandomAgent(seed=-1)


def test_doors__leaves_methods_that_take_nothing_as_they_are_and_holds_the_others() -> None:
    @doors
    class Thing:
        def size(self) -> int:
            return 3

        def times(self, count: int) -> int:
            return 3 * count

        def drawn(self, rng: np.random.Generator | None = None) -> float:
            return 0.0 if rng is None else rng.random()

    assert not hasattr(Thing.size, "__wrapped__")
    assert Thing().drawn() == Thing().drawn(None) == 0.0 < Thing().drawn(np.random.default_rng(0))
    with pytest.raises(InvalidInputError, match="rng: expected"):
        Thing().drawn(rng=3)  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match="count: expected an integer"):
        Thing().times({1})  # type: ignore[arg-type]


def test_door__hands_on_parameters_of_every_kind_as_they_were_given() -> None:
    @door
    def given(a: int, /, b: int = 2, *more: int, rng: object = None, c: float = 4.0, **rest: object) -> Any:
        if c < 0:
            raise TypeError("c")
        return a, b, more, rng, c, rest

    for call in (given, given):  # the first call gives the door its body
        assert call(1) == (1, 2, (), None, 4.0, {})
        assert call(1, 3, 5, 7, rng=8, c=9.0, a=10) == (1, 3, (5, 7), 8, 9.0, {"a": 10})
        assert call(1, c=1, b=6) == (1, 6, (), None, 1, {})
        with pytest.raises(TypeError, match="positional argument"):
            call()
        with pytest.raises(TypeError, match="c"):
            call(1, c=-1.0)
        with pytest.raises(InvalidInputError, match="a: expected an integer, got 'x'"):
            call("x", c=-1.0)
    assert given.__name__ == "given"
    assert given.__code__.co_qualname.endswith("given")


def test_door__defaults_of_another_kind_are_the_functions_own() -> None:
    @doors
    @dataclass
    class Holder:
        generator: np.random.Generator = field(default_factory=np.random.default_rng)
        number: float = "none"  # type: ignore[assignment]

        def __post_init__(self) -> None:
            if self.number == "none":
                raise TypeError("theirs")

    assert isinstance(Holder(number=1.0).generator, np.random.Generator)
    with pytest.raises(TypeError, match="theirs"):
        Holder()
    with pytest.raises(InvalidInputError, match="generator: expected a numpy"):
        Holder(3, 1.0)  # type: ignore[arg-type]
