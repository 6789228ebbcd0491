"""What callers hand in is checked by one set of small functions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from guided_gym.checks import count, flag, instance, integer, number, same_place, shown, vector
from guided_gym.errors import InvalidInputError


@pytest.mark.parametrize("value", [1, 0.5, np.float32(0.5), np.int64(3), 0])
def test_numbers_of_any_make_are_numbers(value):
    assert number("x", value, least=0) == float(value)


@pytest.mark.parametrize("value", ["1", None, True, math.nan, math.inf, -1, [1.0], 1j, np.zeros(1)])
def test_what_is_no_number_is_refused(value):
    with pytest.raises(InvalidInputError, match="x: expected a finite number at least 0, got"):
        number("x", value, least=0)


def test_limits_are_as_said():
    assert number("x", 0, least=0, below=1) == 0
    with pytest.raises(InvalidInputError, match="at least 0 and below 1, got 1"):
        number("x", 1, least=0, below=1)
    with pytest.raises(InvalidInputError, match="expected a positive length, got 0"):
        number("x", 0, above=0, what="length")


@pytest.mark.parametrize("value", ["1", None, True, 1.0, math.nan, 0])
def test_what_is_no_integer_is_refused(value):
    assert integer("n", np.int32(1), least=1) == 1
    with pytest.raises(InvalidInputError, match="n: expected an integer, at least 1, got"):
        integer("n", value, least=1)


def test_flags_and_instances():
    assert flag("f", np.True_) is True
    with pytest.raises(InvalidInputError, match="f: expected True or False, got 1"):
        flag("f", 1)
    assert instance("o", 3, int) == 3
    with pytest.raises(InvalidInputError, match="o: expected an Exception, got 3"):
        instance("o", 3, Exception)


def test_same_place():
    assert same_place(flag, flag)
    assert not same_place(flag, integer)
    assert not same_place(lambda: 1, lambda: 1)


@pytest.mark.parametrize("value", [[0, 1], (0.5, 2), np.arange(2), [10**30, 1], range(2)])
def test_vectors_of_any_make_are_vectors(value):
    found = vector("v", value, 2)
    assert found.dtype == np.float64
    np.testing.assert_array_equal(found, [float(x) for x in value])
    assert not np.shares_memory(found, value) if isinstance(value, np.ndarray) else True


@pytest.mark.parametrize(
    "value", ["01", b"01", {0, 1}, {0: 1}, ["0", "1"], [True, False], [0, None], [0], [[0, 1]], [0, math.nan],
              [0, 1j], [0, [1]], 3, None, [0, 10**400]]
)  # fmt: skip
def test_what_is_no_vector_is_refused(value):
    with pytest.raises(InvalidInputError, match="v: expected 2 finite numbers, got"):
        vector("v", value, 2)


def test_sizes__are_refused_by_the_memory_that_they_take(monkeypatch):
    monkeypatch.setenv("GUIDED_GYM_MAX_MEMORY", "1000")
    assert count("n", 10, least=1, each=100, what="all") == 10
    with pytest.raises(InvalidInputError, match=r"n: all would take 1\.1e-06 GB of memory at 11"):
        count("n", 11, least=1, each=100, what="all")
    with pytest.raises(InvalidInputError, match=r"more than 1e\+15 GB"):
        count("n", 10**5000, least=1, each=100, what="all")  # Python does not even write it


def test_long_values_do_not_make_long_messages():
    assert len(shown("a" * 10**6)) < 250
    assert "\n" not in shown(np.zeros((30, 3)))
    with pytest.raises(InvalidInputError, match="an int that cannot be written"):
        number("x", 10**5000)
