"""The node scorer: equivariance, independence of the tree's size, agreement with the target."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.guidance.learned.scorer import (
    COLUMN_NAMES,
    ScorerArchitecture,
    ScorerColumn,
    ScorerModel,
    plain_tensors,
)
from guided_gym.measure.target import target
from guided_gym.options import TargetParameters

ARCHITECTURE = ScorerArchitecture()


def trained(seed: int = 0) -> ScorerModel:
    rng = np.random.default_rng(seed)
    shapes = ARCHITECTURE.shapes()
    return ScorerModel(
        ARCHITECTURE,
        {name: (0.3 * rng.standard_normal(shape)).astype(np.float32) for name, shape in shapes.items()},
    )


def table(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((n, len(ScorerColumn)), np.float32)


def test_columns_have_names() -> None:
    assert len(COLUMN_NAMES) == len(ScorerColumn) == ARCHITECTURE.shapes()["linear.weight"][1]


@settings(max_examples=20, deadline=None)
@given(n=st.integers(1, 60), seed=st.integers(0, 100))
def test_logits_move_with_the_nodes(n: int, seed: int) -> None:
    columns = table(n, seed)
    order = np.random.default_rng(seed).permutation(n)
    model = trained()
    assert np.allclose(model.logits(columns[order]), model.logits(columns)[order], atol=1e-4)


@pytest.mark.parametrize("times", [2, 4])
def test_a_tree_many_times_as_large_of_the_same_nodes_scores_the_same(times: int) -> None:
    columns = table(50)
    model = trained()
    repeated = model.logits(np.tile(columns, (times, 1)))
    assert np.allclose(repeated, np.tile(model.logits(columns), times), atol=1e-4)


def test_unlearned_logits_are_the_log_of_the_target_if_the_field_is_the_truth() -> None:
    rng = np.random.default_rng(1)
    columns = np.zeros((30, len(ScorerColumn)), np.float32)
    columns[:, ScorerColumn.REMAINING] = rng.random(30)
    columns[:, ScorerColumn.EXCESS] = rng.random(30)
    logits = ScorerModel(ARCHITECTURE, plain_tensors(ARCHITECTURE)).logits(columns).astype(float)
    p = np.exp(logits - logits.max())
    q = target(
        columns[:, ScorerColumn.EXCESS], columns[:, ScorerColumn.REMAINING], 1.0, TargetParameters(epsilon=0)
    )
    assert np.allclose(p / p.sum(), q, atol=1e-6)
