"""The paper's claims, each a small function of the results that can come out either way."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from guided_gym.train.results import Column, Key, Results
from guided_gym.train.statistics import (
    Interval,
    bootstrap,
    bootstrap_ratio_of_medians,
    bootstrap_slope,
    falling_trend,
    significant,
)

PROBLEMS = ("SimplePassage", "Cup", "Trap", "TrapCup")
DRAWN = "RandomSimplePassage"
DATABASE_SIZES = (10, 30, 100, 300, 1000, 3000)
EARLY = 20  # samples that count as the start of a search
SOLVED_SHARE = 0.95
RATIO_RANGE = (0.67, 1.5)
SIGNIFICANCE = 0.05

# The problems that suit each guidance. RRT "performs similarly on all environments"; LazyPRM "performs well
# on SimplePassage but poorly on Cup", MedialAxis "on SimplePassage but poorly on Trap", so that each other's
# hard problem suits them; TrapCup holds both and suits the hybrid alone.
SUITED: Mapping[str, tuple[str, ...]] = {
    "rrt": PROBLEMS,  # the paper evaluates it on these four
    "lazy_prm": ("SimplePassage", "Trap"),
    "medial_axis": ("SimplePassage", "Cup"),
    "hybrid": ("TrapCup",),
    "path_database": (DRAWN,),
    "oracle": (*PROBLEMS, DRAWN),
}


def database_label(paths: int) -> str:
    """Label of the path database guidance with so many paths."""
    return f"path_database({paths})"


@dataclass(frozen=True)
class Outcome:
    """What came of a claim: whether it holds, and the figures that say so."""

    holds: bool
    figures: str


@dataclass(frozen=True)
class Claim:
    """One claim.

    Attributes:
        statement: What is claimed.
        needs: The groups of runs that it is about.
        check: The function that decides; called when all of them are there.
    """

    statement: str
    needs: tuple[Key, ...]
    check: Callable[[Results], Outcome]


@dataclass(frozen=True)
class ClaimResult:
    """A claim with its outcome; ``holds`` is None if runs that it needs are missing."""

    statement: str
    holds: bool | None
    figures: str

    @property
    def verdict(self) -> str:
        """For people."""
        if self.holds is None:
            return "not evaluated"
        return "holds" if self.holds else "does not hold"

    def record(self) -> dict[str, Any]:
        """JSON-able."""
        return {"claim": self.statement, "verdict": self.verdict, "figures": self.figures}


def check_claims(results: Results, claims: Sequence[Claim] | None = None) -> list[ClaimResult]:
    """Check claims (all of the paper's by default) against results."""
    there = set(results.pairs())
    checked = []
    for claim in all_claims() if claims is None else claims:
        if missing := [key for key in claim.needs if key not in there]:
            names = ", ".join(f"{guidance} on {environment}" for environment, guidance in missing)
            checked.append(ClaimResult(claim.statement, None, f"no results of {names}"))
            continue
        outcome = claim.check(results)
        checked.append(ClaimResult(claim.statement, outcome.holds, outcome.figures))
    return checked


def all_claims() -> list[Claim]:
    """Every claim of the paper, in its order."""
    return [
        *_simple_passage_claims(),
        *_weakness_claims(),
        *_trap_cup_claims(),
        *_database_claims(),
        *_solved_claims(),
        *_oracle_claims(),
    ]


def _simple_passage_claims() -> Iterator[Claim]:
    environment = "SimplePassage"
    for guidance in ("lazy_prm", "medial_axis"):
        pair = ((environment, guidance), (environment, "rrt"))
        yield Claim(
            f"SimplePassage: {guidance} has lower total SE than rrt", pair, partial(lower_total, *pair)
        )
    others = ("lazy_prm", "medial_axis")
    yield Claim(
        f"SimplePassage: rrt starts level with the others (first {EARLY} samples)",
        tuple((environment, guidance) for guidance in ("rrt", *others)),
        partial(starts_level, environment, "rrt", others),
    )
    yield Claim(
        f"SimplePassage: rrt gets worse as it meets the passage (after its first {EARLY} samples)",
        ((environment, "rrt"),),
        partial(gets_worse, environment, "rrt"),
    )


def _weakness_claims() -> Iterator[Claim]:
    for guidance, hard in (("lazy_prm", "Cup"), ("medial_axis", "Trap")):
        pair = (("SimplePassage", guidance), (hard, guidance))
        yield Claim(
            f"{guidance}'s SE per sample is higher on {hard} than on SimplePassage",
            pair,
            partial(lower_per_sample, *pair),
        )


def _trap_cup_claims() -> Iterator[Claim]:
    environment = "TrapCup"
    for guidance, region in (("medial_axis", "trap"), ("lazy_prm", "cup")):
        yield Claim(
            f"TrapCup: {guidance} has its peak in the {region} (total SE by region of the selected node)",
            ((environment, guidance),),
            partial(peaks_in, environment, guidance, region),
        )
    pair = ((environment, "lazy_prm"), (environment, "medial_axis"))
    low, high = RATIO_RANGE
    yield Claim(
        "TrapCup: lazy_prm and medial_axis need about as many samples "
        f"(ratio of medians within {low} to {high})",
        pair,
        partial(same_samples, *pair),
    )
    for guidance in ("lazy_prm", "medial_axis"):
        pair = ((environment, "hybrid"), (environment, guidance))
        yield Claim(f"TrapCup: hybrid has lower total SE than {guidance}", pair, partial(lower_total, *pair))


def _database_claims() -> Iterator[Claim]:
    keys = tuple((DRAWN, database_label(size)) for size in DATABASE_SIZES)
    sizes = f"{DATABASE_SIZES[0]} to {DATABASE_SIZES[-1]:,} paths"
    columns: tuple[tuple[Column, str], ...] = (
        ("efficiency_per_sample", "SE per sample"),
        ("total_efficiency", "total SE"),
    )
    for column, name in columns:
        yield Claim(
            f"{DRAWN}: path_database's {name} falls as the database grows ({sizes})",
            keys,
            partial(falls, keys, column),
        )
    yield Claim(
        f"{DRAWN}: path_database's time per query rises slower than linearly ({sizes})",
        keys,
        partial(sublinear, keys, DATABASE_SIZES),
    )


def _solved_claims() -> Iterator[Claim]:
    for guidance, problems in SUITED.items():
        label = database_label(DATABASE_SIZES[-1]) if guidance == "path_database" else guidance
        keys = tuple((problem, label) for problem in problems)
        yield Claim(
            f"{label} solves at least {SOLVED_SHARE:.0%} of the seeds on {', '.join(problems)}",
            keys,
            partial(solves, keys),
        )


def _oracle_claims() -> Iterator[Claim]:
    for environment in (*PROBLEMS, DRAWN):
        yield Claim(
            f"{environment}: oracle has the lowest total SE",
            ((environment, "oracle"),),
            partial(lowest_of_all, environment, "oracle"),
        )


def lower_total(first: Key, second: Key, results: Results) -> Outcome:
    """The first group's total SE lies below the second's, intervals apart."""
    return _lower(first, second, "total_efficiency", results)


def lower_per_sample(first: Key, second: Key, results: Results) -> Outcome:
    """The first group's SE per sample lies below the second's, intervals apart."""
    return _lower(first, second, "efficiency_per_sample", results)


def _lower(first: Key, second: Key, column: Column, results: Results) -> Outcome:
    a, b = (bootstrap(results.values(*key, column)) for key in (first, second))
    # What differs between the two groups names them.
    names = (first[1], second[1]) if first[0] == second[0] else (first[0], second[0])
    return Outcome(a.below(b), f"{names[0]} {a.text()}, {names[1]} {b.text()}")


def starts_level(environment: str, guidance: str, others: Sequence[str], results: Results) -> Outcome:
    """SE over the first samples: the guidance's interval meets the range that the others' intervals span."""
    own = bootstrap(_window(results, environment, guidance, 0, EARLY))
    theirs = {other: bootstrap(_window(results, environment, other, 0, EARLY)) for other in others}
    span = Interval(np.nan, min(i.low for i in theirs.values()), max(i.high for i in theirs.values()))
    figures = ", ".join(f"{name} {interval.text()}" for name, interval in theirs.items())
    return Outcome(own.overlaps(span), f"{guidance} {own.text()}, {figures}")


def gets_worse(environment: str, guidance: str, results: Results) -> Outcome:
    """SE per sample after the first samples, while the search lasts, lies above that over the first."""
    first = bootstrap(_window(results, environment, guidance, 0, EARLY))
    later = bootstrap(_window(results, environment, guidance, EARLY, None))
    return Outcome(first.below(later), f"first {first.text()}, later {later.text()}")


def _window(
    results: Results, environment: str, guidance: str, start: int, end: int | None
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(seeds,) mean SE over some samples of each run, NaN where it ended before them."""
    pieces = (run.curve[start:end] for run in results.group(environment, guidance))
    return np.array([piece.mean(dtype=np.float64) if piece.size else np.nan for piece in pieces])


def peaks_in(environment: str, guidance: str, region: str, results: Results) -> Outcome:
    """Total SE spent in one region lies above that in every other, intervals apart."""
    sums = {name: bootstrap(values) for name, values in results.by_region(environment, guidance).items()}
    figures = ", ".join(f"{name} {interval.text()}" for name, interval in sums.items())
    rivals = [interval for name, interval in sums.items() if name != region]
    holds = region in sums and all(rival.below(sums[region]) for rival in rivals)
    return Outcome(holds, figures)


def same_samples(first: Key, second: Key, results: Results) -> Outcome:
    """The ratio of the medians of the samples lies in `RATIO_RANGE`."""
    a, b = (results.values(*key, "samples") for key in (first, second))
    ratio = bootstrap_ratio_of_medians(a, b)
    medians = f"{significant(float(np.median(a)))} against {significant(float(np.median(b)))}"
    return Outcome(RATIO_RANGE[0] <= ratio.estimate <= RATIO_RANGE[1], f"ratio {ratio.text()}: {medians}")


def falls(keys: Sequence[Key], column: Column, results: Results) -> Outcome:
    """A column falls over groups: Page's trend test, and the last interval below the first."""
    values = np.stack([results.values(*key, column) for key in keys], axis=1)
    p = falling_trend(values)
    intervals = [bootstrap(row) for row in values.T]
    means = " → ".join(significant(interval.estimate) for interval in intervals)
    ends = f"first {intervals[0].text()}, last {intervals[-1].text()}"
    chance = "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
    return Outcome(p < SIGNIFICANCE and intervals[-1].below(intervals[0]), f"{means}; {ends}; trend {chance}")


def sublinear(keys: Sequence[Key], sizes: Sequence[int], results: Results) -> Outcome:
    """The time to query the database, chains and indices included, grows with a log-log slope below 1."""
    times = np.stack([results.values(*key, "preparation") for key in keys], axis=1)
    slope = bootstrap_slope(sizes, times)
    means = " → ".join(significant(1e6 * float(mean)) for mean in times.mean(axis=0))
    return Outcome(slope.high < 1, f"slope {slope.text()}; {means} µs")


def solves(keys: Sequence[Key], results: Results) -> Outcome:
    """Every group solves at least `SOLVED_SHARE` of its seeds."""
    shares = {
        environment: float(results.values(environment, label, "solved").mean()) for environment, label in keys
    }
    figures = ", ".join(f"{environment} {100 * share:.3g} %" for environment, share in shares.items())
    return Outcome(min(shares.values()) >= SOLVED_SHARE, figures)


def lowest_of_all(environment: str, guidance: str, results: Results) -> Outcome:
    """Total SE of a guidance lies below that of every other one there, intervals apart."""
    totals = {
        name: bootstrap(results.values(environment, name, "total_efficiency"))
        for name in results.guidances(environment)
    }
    own = totals.pop(guidance)
    if not totals:
        return Outcome(False, f"{guidance} {own.text()}, nothing to compare with")
    rival = min(totals, key=lambda name: totals[name].low)
    return Outcome(
        all(own.below(other) for other in totals.values()),
        f"{guidance} {own.text()}, next {rival} {totals[rival].text()}",
    )
