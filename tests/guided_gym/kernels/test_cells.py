"""Voronoi cells by counting: the same owners as a full search gives, however the nodes arrive."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.kernels.cells import assign_cells
from guided_gym.kernels.metric import separation


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32),
    st.sampled_from(["plane", "rigid", "around"]),
    st.lists(st.integers(1, 12), max_size=4),
)
def test_assign_cells__agrees_with_a_full_search(seed: int, kind: str, batches: list[int]) -> None:
    rng = np.random.default_rng(seed)
    turn = 2 * math.pi
    weights, periods = {
        "plane": ([1.0, 1.0], [0.0, 0.0]),
        "rigid": ([1.0, 1.0, 0.5], [0.0, 0.0, turn]),
        "around": ([0.3, 2.0], [turn, 0.0]),  # the first coordinate wraps
    }[kind]
    weights, periods = np.array(weights), np.array(periods)
    samples = rng.uniform(-math.pi, math.pi, (60, weights.size))
    nodes = rng.uniform(-math.pi, math.pi, (sum(batches) + 1, weights.size))
    owner, distance = np.zeros(60, np.int64), np.full(60, np.inf)
    first = 0
    for last in np.cumsum([1, *batches]):
        assign_cells(samples, nodes, first, last, (weights, periods), owner, distance)
        first = last
    for j in range(60):
        all_of_them = [separation(q, samples[j], (weights, periods)) for q in nodes]
        assert owner[j] == int(np.argmin(all_of_them))
        assert distance[j] == pytest.approx(min(all_of_them))
