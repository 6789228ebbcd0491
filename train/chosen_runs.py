"""The runs of an evaluation to look at: the best, the median, the worst seed, or any; searched again."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NoReturn

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError
from guided_gym.train.evaluation import Plan, run_once
from guided_gym.train.results import Results, Run
from guided_gym.train.specs import file_label

TRACES: Final = "traces"
"""The folder of traces within that of an evaluation."""

CHOICES: Final = ("best", "median", "worst")


@dataclass(frozen=True)
class Chosen:
    """A run that was searched again.

    Attributes:
        plan: Its environment, guidance and settings.
        run: The run.
        names: Why it was chosen: ``best``, ``median``, ``worst``, or ``seed 3``.
        path: The trace.
        same: Whether the search again was the same; not where the code has changed since.
    """

    plan: Plan
    run: Run
    names: tuple[str, ...]
    path: Path
    same: bool


def check_words(words: Sequence[str], seeds: int) -> None:
    """Refuse what `chosen_runs` could not take, before anything is run.

    Raises:
        InvalidInputError: As there.
    """
    for word in words:
        if word not in CHOICES and not (word.isdecimal() and word.isascii() and int(word) < seeds):
            _refuse(word, f"0 to {seeds - 1}")


def _refuse(word: str, known: str) -> NoReturn:
    raise InvalidInputError(
        f"trace: expected {', '.join(CHOICES)} or a seed that was run ({known}), got {shown(word)}"
    )


def in_order(runs: Sequence[Run]) -> list[Run]:
    """Runs from best to worst: the solved ones by total SE, then the others by total SE."""
    return sorted(runs, key=lambda run: (not run.solved, run.total_efficiency, run.seed))


def chosen_runs(runs: Sequence[Run], words: Sequence[str]) -> dict[int, tuple[str, ...]]:
    """From each chosen seed to the reason for the choice.

    Args:
        runs: The runs of one guidance on one environment.
        words: Of ``best``, ``median``, ``worst``, and seeds.

    Raises:
        InvalidInputError: Another word, or a seed that was not run.
    """
    order = in_order(runs)
    places = {"best": 0, "median": (len(order) - 1) // 2, "worst": len(order) - 1}
    there = {run.seed for run in order}
    chosen: dict[int, tuple[str, ...]] = {}
    for word in words:
        if word in places:
            seed, name = order[places[word]].seed, word
        elif word.isdecimal() and word.isascii() and int(word) in there:
            seed, name = int(word), f"seed {int(word)}"
        else:
            _refuse(word, f"of {len(there)} from {min(there)} to {max(there)}")
        chosen[seed] = tuple(dict.fromkeys((*chosen.get(seed, ()), name)))
    return chosen


def trace_runs(
    results: Results,
    plans: Sequence[Plan],
    words: Sequence[str],
    folder: Path,
    progress: Callable[[int, int], None] | None = None,
) -> list[Chosen]:
    """Search some runs of each plan again, and write their traces; not of planners that cannot be traced.

    Args:
        results: What was found.
        plans: What was run.
        words: Which runs; see `chosen_runs`.
        folder: That of the evaluation; the traces go into `TRACES` below it.
        progress: Called with (traces written, traces to write).

    Raises:
        InvalidInputError: A word that is none of these.
        StorageError: A trace cannot be written.
    """
    wanted = [
        (plan, run, names)
        for plan in plans
        if results.has(plan.environment, plan.spec.label)
        for run, names in _chosen(results.group(plan.environment, plan.spec.label), words)
    ]
    found: list[Chosen] = []
    for plan, run, names in wanted:
        if progress is not None:
            progress(len(found), len(wanted))
        path = folder / TRACES / f"{trace_name(plan, run.seed)}.jsonl"
        _, result = run_once(plan, run.seed, path)
        same = (result.samples, len(result.tree)) == (run.samples, run.nodes)
        found.append(Chosen(plan, run, names, path, same))
    if progress is not None:
        progress(len(found), len(wanted))
    return found


def _chosen(runs: Sequence[Run], words: Sequence[str]) -> list[tuple[Run, tuple[str, ...]]]:
    by_seed = {run.seed: run for run in runs}
    return [(by_seed[seed], names) for seed, names in chosen_runs(runs, words).items()]


def trace_name(plan: Plan, seed: int) -> str:
    """A file's name for a run: environment, guidance and seed, without what no file name should have."""
    label = f"{file_label(plan.environment)}-{plan.spec.label}"
    plain = re.sub(r"[^\w@=+.,-]+", "_", label)[:80]
    if plain != label:  # two labels must not become one
        plain += "-" + hashlib.sha256(label.encode()).hexdigest()[:8]
    return f"{plain}-{seed}"
