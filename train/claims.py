"""The paper's claims, and checks of our own: each a small function of the results, with three verdicts.

A claim *holds* or *does not hold* where the 95 % interval of what it is about lies wholly on one side; else
the results leave it *open*. Seeds are paired: the searches of a seed share their random numbers, so what is
estimated are differences seed by seed. What counts as alike was fixed before the searches were run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from guided_gym.doors import door
from guided_gym.train.results import Column, Key, Results
from guided_gym.train.statistics import (
    Interval,
    bootstrap,
    bootstrap_slope,
    falling_trend,
    paired_difference,
    paired_ratio_of_medians,
    significant,
    wilson,
)

PROBLEMS = ("SimplePassage", "Cup", "Trap", "TrapCup")
DRAWN = "RandomSimplePassage"
DATABASE_SIZES = (10, 30, 100, 300, 1000, 3000)
EARLY = 20  # samples that count as the start of a search
MARGIN = 1.0  # nats by which alike may differ: a node e times as likely under Q
SOLVED_SHARE = 0.95
RATIO_RANGE = (0.67, 1.5)
SIGNIFICANCE = 0.05
CENSORED = ("total_efficiency", "samples")  # what grows as long as a search goes on

Verdict = Literal["holds", "does not hold", "open", "not evaluated"]


def database_label(paths: int) -> str:
    """Label of the path database guidance with so many paths."""
    return f"path_database({paths})"


@dataclass(frozen=True)
class Outcome:
    """The outcome of a claim, and the figures behind it."""

    verdict: Verdict
    figures: str


@dataclass(frozen=True)
class Claim:
    """One claim.

    Attributes:
        statement: What is claimed, as it is checked.
        needs: The groups of runs that it is about.
        check: The function that decides; called when all of them are there.
        words: The paper's words; empty for a check of our own.
        why: What is known of the reason where it does not hold, or stays open.
    """

    statement: str
    needs: tuple[Key, ...]
    check: Callable[[Results], Outcome]
    words: str = ""
    why: str = ""


@dataclass(frozen=True)
class ClaimResult:
    """A claim with its outcome."""

    claim: Claim
    outcome: Outcome

    @property
    def verdict(self) -> Verdict:
        """The verdict of the outcome."""
        return self.outcome.verdict

    @property
    def why(self) -> str:
        """The claim's explanation, if one is called for."""
        return self.claim.why if self.verdict in ("does not hold", "open") else ""

    def record(self) -> dict[str, Any]:
        """JSON-able."""
        return {
            "words": self.claim.words,
            "claim": self.claim.statement,
            "verdict": self.verdict,
            "figures": self.outcome.figures,
            "why": self.why,
        }


@door
def check_claims(results: Results, claims: Iterable[Claim]) -> list[ClaimResult]:
    """Check claims against results."""
    there = set(results.pairs())
    checked = []
    for claim in claims:
        if missing := [key for key in claim.needs if key not in there]:
            names = ", ".join(f"{guidance} on {environment}" for environment, guidance in missing)
            checked.append(ClaimResult(claim, Outcome("not evaluated", f"no results of {names}")))
        else:
            checked.append(ClaimResult(claim, claim.check(results)))
    return checked


def paper_claims() -> list[Claim]:
    """Every claim of the paper's experiments, in its order, and nothing else."""
    return [
        *_rrt_claims(),
        *_suited_claims(),
        *_comparable_claims(),
        *_database_claims(),
        *_trap_cup_claims(),
    ]


def own_checks(results: Results, drawn: bool = True) -> list[Claim]:
    """Checks of what the paper does not claim but readers would like to know, of whatever was evaluated.

    Args:
        results: Of the searches.
        drawn: Whether path databases of drawn problems are among them.
    """
    databases = _database_checks() if drawn else ()
    return [*_solved_checks(results), *_oracle_checks(results), *databases]


def _rrt_claims() -> Iterator[Claim]:
    keys = tuple((problem, "rrt") for problem in PROBLEMS)
    yield Claim(
        f"rrt's SE over its first {EARLY} samples differs by less than {MARGIN:g} nat between any two of the "
        "four problems",
        keys,
        partial(alike, tuple(combinations(keys, 2))),
        "RRT initially performs similarly on all environments",
        "SE is in units of the optimum, which is 17.3 on TrapCup and 9.2 to 10.1 on the others: with "
        "temperatures of one length its SE there is 2.5 (not 2.0), and the largest difference 1.0. The rest "
        "goes with how far the way leaves the straight line: optimum over distance is 10.1 over 7.0 on Cup, "
        "9.5 over 7.0 on Trap, 9.2 over 9.2 on SimplePassage.",
    )
    yield Claim(
        f"on each of the four, rrt's SE per sample is higher after its first {EARLY} samples than over them",
        keys,
        partial(gets_worse, keys),
        "RRT [is] doing well and then poorly as it struggles to get through narrow passages",
    )


def _suited_claims() -> Iterator[Claim]:
    for guidance, hard, words in (
        ("lazy_prm", "Cup", "LazyPRM performs well on SimplePassage but poorly on Cup"),
        ("medial_axis", "Trap", "MedialAxisGuidance does well on SimplePassage but poorly on Trap"),
    ):
        easy = ("SimplePassage", guidance)
        against_rrt = (easy, ("SimplePassage", "rrt"))
        yield Claim(
            f"well: on SimplePassage, {guidance} has less total SE than rrt",
            against_rrt,
            partial(lower, (against_rrt,), "total_efficiency"),
            words,
        )
        harder = (easy, (hard, guidance))
        yield Claim(
            f"poorly: {guidance}'s SE per sample is higher on {hard} than on SimplePassage",
            harder,
            partial(lower, (harder,), "efficiency_per_sample"),
            words,
        )


def _comparable_claims() -> Iterator[Claim]:
    words = "RRT is comparable to other algorithms initially"
    others = ("lazy_prm", "medial_axis")
    pairs = tuple(((problem, "rrt"), (problem, other)) for problem in PROBLEMS for other in others)
    yield Claim(
        f"over the first {EARLY} samples, rrt's SE differs by less than {MARGIN:g} nat from lazy_prm's and "
        "from medial_axis', on each of the four problems",
        tuple(dict.fromkeys(key for pair in pairs for key in pair)),
        partial(alike, pairs),
        words,
        "The two differ from rrt on Cup, from the first samples on: lazy_prm ignores the cup's walls and "
        "walks into it (rrt is better), and medial_axis' skeleton knows the way around it (rrt is worse).",
    )
    astray = tuple(
        ((problem, "rrt"), (problem, guidance))
        for problem, guidance in (("Cup", "lazy_prm"), ("Trap", "medial_axis"))
    )
    yield Claim(
        f"over the first {EARLY} samples, rrt's SE is at most {MARGIN:g} nat above lazy_prm's on Cup, and "
        "medial_axis' on Trap",
        tuple(key for pair in astray for key in pair),
        partial(no_worse, astray),
        f"{words}, and especially on environments where MedialAxisGuidance or LazyPRM lead the search astray",
    )


def _database_claims() -> Iterator[Claim]:
    keys = tuple((DRAWN, database_label(size)) for size in DATABASE_SIZES)
    sizes = f"{DATABASE_SIZES[0]} to {DATABASE_SIZES[-1]:,} paths"
    yield Claim(
        f"path_database's SE per sample falls as the database grows ({sizes})",
        keys,
        partial(trend, keys, "efficiency_per_sample", falling=True),
        "guidance improves as dataset size increases",
    )
    yield Claim(
        f"path_database's wall time, query and search, rises as the database grows ({sizes})",
        keys,
        partial(trend, keys, "runtime", falling=False),
        "while runtime gets worse (as querying the database takes longer)",
    )


def _trap_cup_claims() -> Iterator[Claim]:
    place = "TrapCup"
    for guidance, region, words in (
        ("medial_axis", "trap", "MedialAxis struggles with the local minima of the first obstacle"),
        ("lazy_prm", "cup", "LazyPRM struggles with the local minima of the second obstacle"),
    ):
        yield Claim(
            f"{guidance} spends more SE in the {region} than in any other region of TrapCup",
            ((place, guidance),),
            partial(peaks_in, (place, guidance), region),
            words,
        )
    parts = tuple(((place, "hybrid"), (place, part)) for part in ("lazy_prm", "medial_axis"))
    keys = tuple(dict.fromkeys(key for pair in parts for key in pair))
    yield Claim(
        "on TrapCup, hybrid has less total SE than lazy_prm, and than medial_axis",
        keys,
        partial(lower, parts, "total_efficiency"),
        "a hybrid guiding space … has overall better guidance",
    )
    yield Claim(
        "on TrapCup, hybrid needs fewer samples than lazy_prm, and than medial_axis",
        keys,
        partial(lower, parts, "samples"),
        "a hybrid guiding space which uses both projections can escape both minima faster",
    )
    low, high = RATIO_RANGE
    pair = ((place, "lazy_prm"), (place, "medial_axis"))
    yield Claim(
        f"on TrapCup, the medians of lazy_prm's and medial_axis' samples have a ratio within {low} to {high}",
        pair,
        partial(same_samples, *pair),
        "MedialAxis and LazyPRM take about the same number of samples to find the goal",
    )


def _solved_checks(results: Results) -> Iterator[Claim]:
    labels = dict.fromkeys(guidance for _, guidance in results.pairs())
    for label in labels:
        keys = tuple(key for key in results.pairs() if key[1] == label)
        yield Claim(
            f"{label} solves at least {SOLVED_SHARE:.0%} of the seeds wherever it was evaluated",
            keys,
            partial(solves, keys),
        )


def _oracle_checks(results: Results) -> Iterator[Claim]:
    for environment in results.environments():
        others = [name for name in results.guidances(environment) if name != "oracle"]
        pairs = tuple(((environment, "oracle"), (environment, other)) for other in others)
        if results.has(environment, "oracle") and pairs:
            yield Claim(
                f"{environment}: the exact cost-to-go (oracle) has less total SE than every other guidance",
                tuple(dict.fromkeys(key for pair in pairs for key in pair)),
                partial(lower, pairs, "total_efficiency"),
            )


def _database_checks() -> Iterator[Claim]:
    keys = tuple((DRAWN, database_label(size)) for size in DATABASE_SIZES)
    yield Claim(
        f"{DRAWN}: path_database's total SE falls as the database grows",
        keys,
        partial(trend, keys, "total_efficiency", falling=True),
    )
    yield Claim(
        f"{DRAWN}: path_database's time per query rises, slower than linearly",
        keys,
        partial(sublinear, keys, DATABASE_SIZES),
    )


Values = NDArray[np.float64]


def paired(results: Results, first: Key, second: Key, values: Callable[[Key], Values]) -> Interval:
    """Mean of first - second over the seeds that both have, with its interval."""
    seeds = [{run.seed: i for i, run in enumerate(results.group(*key))} for key in (first, second)]
    common = [seed for seed in seeds[0] if seed in seeds[1]]
    rows = [[index[seed] for seed in common] for index in seeds]
    return paired_difference(values(first)[rows[0]], values(second)[rows[1]])


def _window(results: Results, start: int, end: int | None, key: Key) -> Values:
    """(seeds,) mean SE over some samples of each run, NaN where it ended before them."""
    pieces = (run.curve[start:end] for run in results.group(*key))
    return np.array([piece.mean(dtype=np.float64) if piece.size else np.nan for piece in pieces])


def _column(results: Results, column: Column | Literal["runtime"], key: Key) -> Values:
    if column == "runtime":
        return results.values(*key, "preparation") + results.values(*key, "seconds")
    return results.values(*key, column)


def _conservative(results: Results, column: Column, pair: tuple[Key, Key], key: Key) -> Values:
    values = _column(results, column, key)
    if key == pair[0] and column in CENSORED:
        worst = max(float(_column(results, column, each).max()) for each in pair)
        values[results.values(*key, "solved") == 0] = worst
    return values


def _names(first: Key, second: Key) -> tuple[str, str]:
    """What differs between two groups names them."""
    return (first[1], second[1]) if first[0] == second[0] else (first[0], second[0])


def _all(verdicts: Iterable[Verdict]) -> Verdict:
    """Of a claim about several things: it holds where all do, and does not where one does not."""
    found = list(verdicts)
    if "does not hold" in found:
        return "does not hold"
    return "holds" if found and set(found) == {"holds"} else "open"


def _below(interval: Interval, bound: float) -> Verdict:
    if interval.high < bound:
        return "holds"
    return "does not hold" if interval.low >= bound else "open"


def lower(pairs: Sequence[tuple[Key, Key]], column: Column, results: Results) -> Outcome:
    """In each pair, the first group's column lies below the second's: their difference lies below 0.

    A search of the first that was not solved might have gone on: it counts as the worst of both.
    """
    verdicts, texts = [], []
    for first, second in pairs:
        difference = paired(results, first, second, partial(_conservative, results, column, (first, second)))
        means = [significant(float(_column(results, column, key).mean())) for key in (first, second)]
        names = _names(first, second)
        verdicts.append(_below(difference, 0.0))
        texts.append(f"{names[0]} {means[0]}, {names[1]} {means[1]}: {difference.text()}")
    return Outcome(_all(verdicts), "; ".join(texts))


def alike(pairs: Sequence[tuple[Key, Key]], results: Results) -> Outcome:
    """In each pair, the SE over the first samples differs by less than `MARGIN`: the whole interval does."""
    return _early(pairs, results, lambda difference: _within_margin(difference))


def no_worse(pairs: Sequence[tuple[Key, Key]], results: Results) -> Outcome:
    """In each pair, the first one's SE over the first samples is at most `MARGIN` above the second's."""
    return _early(pairs, results, lambda difference: _below(difference, MARGIN))


def _within_margin(difference: Interval) -> Verdict:
    if difference.within(-MARGIN, MARGIN):
        return "holds"
    return "does not hold" if difference.outside(-MARGIN, MARGIN) else "open"


def _early(
    pairs: Sequence[tuple[Key, Key]], results: Results, judge: Callable[[Interval], Verdict]
) -> Outcome:
    window = partial(_window, results, 0, EARLY)
    verdicts, texts = [], []
    for first, second in pairs:
        difference = paired(results, first, second, window)
        verdicts.append(judge(difference))
        if verdicts[-1] != "holds" or len(pairs) <= 2:
            names = _names(first, second)
            where = f" on {first[0]}" if first[0] == second[0] else ""
            texts.append(f"{names[0]} − {names[1]}{where} {difference.text()}")
    keys = dict.fromkeys(key for pair in pairs for key in pair)
    problems = dict.fromkeys(key[0] for key in keys)
    means = []
    for problem in problems:
        own = {key[1]: float(np.nanmean(window(key))) for key in keys if key[0] == problem}
        means.append(f"{problem}: " + ", ".join(f"{name} {significant(mean)}" for name, mean in own.items()))
    return Outcome(_all(verdicts), "; ".join([*means, *texts]))


def gets_worse(keys: Sequence[Key], results: Results) -> Outcome:
    """In each group, SE per sample after the first samples lies above that over the first, run by run."""
    verdicts, texts = [], []
    for key in keys:
        first, later = _window(results, 0, EARLY, key), _window(results, EARLY, None, key)
        difference = paired_difference(first, later)
        rise = Interval(-difference.estimate, -difference.high, -difference.low)
        verdicts.append(_below(difference, 0.0))
        texts.append(f"{key[0]} {significant(float(np.nanmean(first)))}, then {rise.text()} more")
    return Outcome(_all(verdicts), "; ".join(texts))


def peaks_in(key: Key, region: str, results: Results) -> Outcome:
    """Total SE spent in one region lies above that in every other, run by run."""
    sums = results.by_region(*key)
    figures = ", ".join(f"{name} {bootstrap(values).text()}" for name, values in sums.items())
    rivals = [values for name, values in sums.items() if name != region]
    if region not in sums or not rivals:
        return Outcome("does not hold", figures)
    return Outcome(_all(_below(paired_difference(rival, sums[region]), 0.0) for rival in rivals), figures)


def same_samples(first: Key, second: Key, results: Results) -> Outcome:
    """The ratio of the medians of the samples lies in `RATIO_RANGE`, with its whole interval."""
    a, b = (results.values(*key, "samples") for key in (first, second))
    ratio = paired_ratio_of_medians(a, b)
    medians = f"{significant(float(np.median(a)))} against {significant(float(np.median(b)))}"
    verdict: Verdict = "open"
    if ratio.within(*RATIO_RANGE):
        verdict = "holds"
    elif ratio.outside(*RATIO_RANGE):
        verdict = "does not hold"
    return Outcome(verdict, f"ratio {ratio.text()}: {medians}")


def trend(
    keys: Sequence[Key], column: Column | Literal["runtime"], results: Results, *, falling: bool
) -> Outcome:
    """A column falls (or rises) over groups: Page's trend test, and the last less the first."""
    values = np.stack([_column(results, column, key) for key in keys], axis=1)
    sign, unit = (1.0, "") if falling else (-1.0, " ms")
    p = falling_trend(sign * values)
    change = paired_difference(sign * values[:, -1], sign * values[:, 0])
    scale = 1.0 if falling else 1e3
    means = " → ".join(significant(scale * float(mean)) for mean in values.mean(axis=0))
    ends = paired_difference(scale * values[:, -1], scale * values[:, 0])
    chance = "p < 0.001" if p < 0.001 else f"p = {p:.3f}"
    verdict = _below(change, 0.0)
    if verdict == "holds" and p >= SIGNIFICANCE:
        verdict = "open"
    return Outcome(verdict, f"{means}{unit}; last less first {ends.text()}{unit}; trend {chance}")


def sublinear(keys: Sequence[Key], sizes: Sequence[int], results: Results) -> Outcome:
    """The time to query the database, chains and indices included: its log-log slope lies in 0 to 1."""
    times = np.stack([results.values(*key, "preparation") for key in keys], axis=1)
    slope = bootstrap_slope(sizes, times)
    means = " → ".join(significant(1e6 * float(mean)) for mean in times.mean(axis=0))
    verdict: Verdict = "open"
    if slope.low > 0 and slope.high < 1:
        verdict = "holds"
    elif slope.outside(0.0, 1.0):
        verdict = "does not hold"
    return Outcome(verdict, f"slope {slope.text()}; {means} µs")


def solves(keys: Sequence[Key], results: Results) -> Outcome:
    """Every group solves at least `SOLVED_SHARE` of its seeds, by the whole Wilson interval."""
    verdicts, texts = [], []
    for key in keys:
        solved = results.values(*key, "solved")
        share = wilson(int(solved.sum()), solved.size)
        verdict: Verdict = "open"
        if share.low >= SOLVED_SHARE:
            verdict = "holds"
        elif share.high < SOLVED_SHARE:
            verdict = "does not hold"
        verdicts.append(verdict)
        percent = Interval(100 * share.estimate, 100 * share.low, 100 * share.high)
        texts.append(f"{key[0]} {percent.text()} %")
    return Outcome(_all(verdicts), ", ".join(texts))
