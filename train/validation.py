"""How well a guidance searches on validation problems: what trainings keep their best weights by."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from guided_gym.catalogue.distributions import ProblemDistribution
from guided_gym.guidance.base import GuidingSpace
from guided_gym.planning import guided_search
from guided_gym.train.lessons import mixed_problem


def validated(
    distributions: list[ProblemDistribution], guidance: GuidingSpace, *, count: int, max_samples: int
) -> dict[str, float]:
    """Means over the first ``count`` validation problems of several distributions taken in turns.

    Returns:
        Solved rate, samples, total SE, and the sum of -log max Q over the same trees (both in nats).

    Raises:
        NoPathError: A problem without a path.
    """
    results = [
        guided_search(
            mixed_problem(distributions, "validation", i), guidance, seed=i, max_samples=max_samples
        )
        for i in range(count)
    ]
    return {
        "solved": float(np.mean([result.solved for result in results])),
        "samples": float(np.mean([result.samples for result in results])),
        "total_efficiency": float(np.mean([result.total_efficiency for result in results])),
        "best_possible": float(np.mean([result.record.best.sum() for result in results])),
    }


def rank(metrics: Mapping[str, Any]) -> tuple[float, float]:
    """Less is better: more solved, then less total SE."""
    return -metrics["solved"], metrics["total_efficiency"]
