"""How well a guidance searches on validation problems, by which trainings choose their best weights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np

from guided_gym.catalogue.distributions import ProblemDistribution
from guided_gym.compute.workers import MapTasks, in_order
from guided_gym.guidance.base import GuidingSpace
from guided_gym.planning import guided_search
from guided_gym.train.lessons import mixed_problem

_BATCH: Final = 4  # searches that go to a worker together, with the guidance
_FIGURES: Final = ("solved", "samples", "total_efficiency", "best_possible")


class Found(NamedTuple):
    """What a search for a problem came to; SE in nats.

    Attributes:
        number: The problem's, among those of several distributions taken in turns.
        solved: Whether it ended at the goal.
        samples: How many it took.
        total: The SE of its choices.
        best: The least that choices over the same trees could have had.
    """

    number: int
    solved: bool
    samples: int
    total: float
    best: float


def validated(
    distributions: list[ProblemDistribution],
    guidance: GuidingSpace,
    *,
    count: int,
    max_samples: int,
    run: MapTasks = in_order,
    expansion: str | None = None,
) -> dict[str, float]:
    """Means over the first ``count`` validation problems of several distributions taken in turns.

    Args:
        distributions: The distributions.
        guidance: Who searches.
        count: How many problems.
        max_samples: Samples after which a search gives up.
        expansion: Who proposes, as `guided_search` takes it; the guidance itself if None.
        run: Who does the searches (`guided_gym.compute.workers.worker_pool`); this process if not said.

    Returns:
        Solved rate, samples, total SE, and the sum of -log max Q over the same trees (both in nats).

    Raises:
        NoPathError: A problem without a path.
    """
    found = searched(
        distributions, guidance, wanted=range(count), max_samples=max_samples, run=run, expansion=expansion
    )
    columns = zip(*(row[1:] for row in found), strict=True)
    return {name: float(np.mean(column)) for name, column in zip(_FIGURES, columns, strict=True)}


def searched(
    distributions: list[ProblemDistribution],
    guidance: GuidingSpace,
    *,
    wanted: Sequence[int],
    max_samples: int,
    split: str = "validation",
    run: MapTasks = in_order,
    expansion: str | None = None,
) -> list[Found]:
    """A search for each problem whose number is wanted, in that order; arguments as in `validated`.

    Raises:
        NoPathError: A problem without a path.
    """
    batches = [wanted[i : i + _BATCH] for i in range(0, len(wanted), _BATCH)]
    work = partial(_searches, distributions, guidance, max_samples, expansion, split)
    found = {row.number: row for rows in run(work, batches) for row in rows}  # whoever is done first
    return [found[i] for i in wanted]


def _searches(
    distributions: list[ProblemDistribution],
    guidance: GuidingSpace,
    max_samples: int,
    expansion: str | None,
    split: str,
    numbers: Sequence[int],
) -> list[Found]:
    rows = []
    for i in numbers:
        problem = mixed_problem(distributions, split, i)
        result = guided_search(problem, guidance, seed=i, max_samples=max_samples, expansion=expansion)
        best = float(result.record.best.sum())
        rows.append(Found(i, result.solved, result.samples, result.total_efficiency, best))
    return rows


def rank(metrics: Mapping[str, Any], selection: bool = False) -> tuple[float, float]:
    """Less is better: more solved, then less total SE; less excess SE where only the selection is judged."""
    total: float = metrics["total_efficiency"]
    return -metrics["solved"], total - metrics["best_possible"] if selection else total
