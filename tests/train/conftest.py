"""Synthetic runs, with known answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from guided_gym.train.results import Run


def synthetic_run(
    environment: str = "Cup",
    guidance: str = "rrt",
    seed: int = 0,
    *,
    samples: int = 4,
    efficiency: float = 2.0,
    solved: bool = True,
    regions: Mapping[str, tuple[float, int]] | None = None,
    **changes: Any,
) -> Run:
    """A run whose SE is the same at each sample."""
    values: dict[str, Any] = {
        "settings": "s",
        "problem": "p",
        "nodes": samples + 1,
        "total_efficiency": samples * efficiency,
        "best_possible": 1.0,
        "collision_checks": 2 * samples,
        "seconds": 1e-3 * samples,
        "preparation": 2e-3,
        "processor": 1e-3 * samples,
        "looks": 3 * samples,
        "path_cost": 10.0 if solved else float("nan"),
        "optimum": 9.0,
        "oracle_error": 0.004,
        "oracle_tail": 0.02,
        "divergence": float("nan"),
        "jensen_shannon": float("nan"),
        "entropy": 1.5,
        "curve": np.full(samples, efficiency, np.float32),
        "best": np.full(samples, 1.0 / max(samples, 1), np.float32),
        "cells": np.zeros(samples, np.uint16),
    }
    values |= changes
    regions = {"elsewhere": (samples * efficiency, samples)} if regions is None else regions
    return Run(environment, guidance, seed, solved=solved, samples=samples, regions=regions, **values)


@pytest.fixture
def make_run() -> Callable[..., Run]:
    """`synthetic_run`."""
    return synthetic_run
