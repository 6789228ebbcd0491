"""-log Q of one node: worked by hand, and at the edges of floating point."""

from __future__ import annotations

import math

import numpy as np
import pytest

from guided_gym.kernels.softmin import choice_efficiency


def test_choice_efficiency__hand_worked() -> None:
    energy = np.array([0.0, math.log(2), math.log(4), -99.0])
    chosen, best = choice_efficiency(energy, 3, 1, 0.0)  # weights 1, 1/2, 1/4
    assert chosen == pytest.approx(math.log(3.5))
    assert best == pytest.approx(math.log(1.75))
    # epsilon = 1/4: gamma = (1.75 / 4 - 1/4) / (1 - 3/4) = 3/4, so Q = (1.75, 1.25, 1) / 4
    for node, share in enumerate((1.75, 1.25, 1.0)):
        chosen, best = choice_efficiency(energy, 3, node, 0.25)
        assert chosen == pytest.approx(-math.log(share / 4))
        assert best == pytest.approx(-math.log(1.75 / 4))


def test_choice_efficiency__is_uniform_where_no_gamma_exists() -> None:
    assert choice_efficiency(np.array([0.0, 900.0]), 2, 1, 0.5) == (math.log(2), math.log(2))


def test_choice_efficiency__survives_energies_out_of_range() -> None:
    energy = np.array([1e6, 1e6 + 2000, np.inf])
    assert choice_efficiency(energy, 3, 0, 1e-4)[0] == pytest.approx(-math.log(1 - 2e-4))
    assert choice_efficiency(energy, 3, 1, 1e-4)[0] == pytest.approx(-math.log(1e-4))
    assert choice_efficiency(energy, 3, 2, 1e-4)[0] == pytest.approx(-math.log(1e-4))
    assert choice_efficiency(energy, 3, 1, 0.0)[0] == pytest.approx(2000)
    assert choice_efficiency(energy, 3, 2, 0.0)[0] == math.inf
    assert choice_efficiency(energy, 1, 0, 1e-4) == (0, 0)
