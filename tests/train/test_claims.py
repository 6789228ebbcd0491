"""Claims can come out either way or stay open, and say so when they can't be decided."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from guided_gym.train import claims
from guided_gym.train.claims import (
    EARLY,
    MARGIN,
    Outcome,
    check_claims,
    database_label,
    own_checks,
    paper_claims,
)
from guided_gym.train.results import Results, Run

MakeRun = Callable[..., Run]
Group = Callable[..., list[Run]]
Check = Callable[[Results], Outcome]
SEEDS = range(12)
A, B, C = ("Cup", "a"), ("Cup", "b"), ("Cup", "c")


@pytest.fixture
def group(make_run: MakeRun) -> Group:
    """Runs of several seeds; their SE varies much, and alike in each group, and a little by itself."""

    def build(environment: str, guidance: str, efficiency: float = 2.0, **changes: object) -> list[Run]:
        own = np.random.default_rng(len(guidance) + ord(guidance[-1]))
        return [
            make_run(
                environment,
                guidance,
                seed,
                efficiency=efficiency * (1 + 0.3 * (seed % 5) + 0.01 * float(own.normal())),
                **changes,
            )
            for seed in SEEDS
        ]

    return build


def verdict(check: Check, *groups: list[Run]) -> str:
    return check(Results(tuple(run for runs in groups for run in runs), 100)).verdict


@pytest.mark.parametrize("column", ["total_efficiency", "efficiency_per_sample"])
def test_lower__is_by_pairs(column: str, group: Group) -> None:
    claim = partial(claims.lower, ((A, B),), column)
    assert verdict(claim, group(*A, 1.0), group(*B, 2.0)) == "holds"
    assert verdict(claim, group(*A, 2.0), group(*B, 1.0)) == "does not hold"
    assert verdict(claim, group(*A, 2.0), group(*B, 2.0)) == "open"
    # The seeds differ by far more than the groups do: only the pairs tell.
    assert verdict(claim, group(*A, 1.9), group(*B, 2.0)) == "holds"


def test_lower__of_several_pairs_fails_with_one(group: Group) -> None:
    claim = partial(claims.lower, ((A, B), (A, C)), "total_efficiency")
    assert verdict(claim, group(*A, 1.0), group(*B, 2.0), group(*C, 3.0)) == "holds"
    assert verdict(claim, group(*A, 1.0), group(*B, 2.0), group(*C, 0.5)) == "does not hold"
    assert verdict(claim, group(*A, 1.0), group(*B, 2.0), group(*C, 1.0)) == "open"


def test_lower__an_unsolved_search_counts_as_the_worst(group: Group) -> None:
    claim = partial(claims.lower, ((A, B),), "total_efficiency")
    stuck = group(*A, 0.01, solved=False)
    assert verdict(claim, stuck, group(*B, 2.0)) == "does not hold"
    assert verdict(claim, group(*A, 1.0), group(*B, 2.0, solved=False)) == "holds"


def test_lower__compares_the_seeds_that_both_have(group: Group, make_run: MakeRun) -> None:
    claim = partial(claims.lower, ((A, B),), "total_efficiency")
    odd = [make_run(*A, 99, efficiency=1e6)]
    assert verdict(claim, group(*A, 1.0) + odd, group(*B, 2.0)) == "holds"


@pytest.mark.parametrize(
    ("difference", "expected"),
    [(0.0, "holds"), (0.9 * MARGIN, "holds"), (1.5 * MARGIN, "does not hold"), (MARGIN, "open")],
)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_alike__within_a_margin_stated_in_advance(
    make_run: MakeRun, difference: float, expected: str, sign: float
) -> None:
    def runs(key: tuple[str, str], shift: float) -> list[Run]:
        own = np.random.default_rng(ord(key[1]))
        return [make_run(*key, seed, efficiency=9.0 + shift + 0.05 * own.normal()) for seed in SEEDS]

    assert verdict(partial(claims.alike, ((A, B),)), runs(A, sign * difference), runs(B, 0.0)) == expected


def test_no_worse__may_be_better(group: Group) -> None:
    claim = partial(claims.no_worse, ((A, B),))
    assert verdict(claim, group(*A, 0.1), group(*B, 5.0)) == "holds"
    assert verdict(claim, group(*A, 5.0), group(*B, 0.1)) == "does not hold"


def test_alike__looks_at_the_first_samples_only(make_run: MakeRun) -> None:
    curve = np.concatenate([np.full(EARLY, 1.0), np.full(30, 9.0)]).astype(np.float32)
    long = [make_run(*A, seed, samples=50, curve=curve) for seed in SEEDS]
    short = [make_run(*B, seed, efficiency=1.0) for seed in SEEDS]
    assert verdict(partial(claims.alike, ((A, B),)), long, short) == "holds"


@pytest.mark.parametrize(("later", "expected"), [(5.0, "holds"), (0.2, "does not hold")])
def test_gets_worse__after_the_first_samples(make_run: MakeRun, later: float, expected: str) -> None:
    curve = np.concatenate([np.full(EARLY, 1.0), np.full(30, later)]).astype(np.float32)
    runs = [make_run(*A, seed, samples=50, curve=curve) for seed in SEEDS]
    runs.append(make_run(*A, 99, samples=3, efficiency=1.0))  # ended before: says nothing of later
    assert verdict(partial(claims.gets_worse, (A,)), runs) == expected


def test_peaks_in__the_region_that_costs_most(make_run: MakeRun) -> None:
    runs = [
        make_run(*A, seed, regions={"trap": (9.0 + seed % 2, 3), "cup": (2.0, 1), "beyond": (0.0, 0)})
        for seed in SEEDS
    ]
    assert verdict(partial(claims.peaks_in, A, "trap"), runs) == "holds"
    assert verdict(partial(claims.peaks_in, A, "cup"), runs) == "does not hold"
    assert verdict(partial(claims.peaks_in, A, "moon"), runs) == "does not hold"


@pytest.mark.parametrize(
    ("samples", "expected"), [(10, "holds"), (14, "holds"), (16, "does not hold"), (6, "does not hold")]
)
def test_same_samples__by_the_ratio_of_medians(group: Group, samples: int, expected: str) -> None:
    claim = partial(claims.same_samples, A, B)
    assert verdict(claim, group(*A, samples=samples), group(*B, samples=10)) == expected


def test_same_samples__wants_the_whole_interval(make_run: MakeRun) -> None:
    runs = [make_run(*A, seed, samples=4 + 8 * (seed % 2)) for seed in SEEDS]
    others = [make_run(*B, seed, samples=8) for seed in SEEDS]
    assert verdict(partial(claims.same_samples, A, B), runs, others) == "open"  # the estimate is 1


def test_trend__needs_a_trend_and_ends_apart(group: Group) -> None:
    keys = (A, B, C)
    falls = partial(claims.trend, keys, "efficiency_per_sample", falling=True)

    def ordered(values: list[float]) -> list[list[Run]]:
        return [group(*key, value) for key, value in zip(keys, values, strict=True)]

    assert verdict(falls, *ordered([3.0, 2.0, 1.0])) == "holds"
    assert verdict(falls, *ordered([1.0, 2.0, 3.0])) == "does not hold"
    assert verdict(falls, *ordered([2.0, 2.0, 2.0])) == "open"


def test_trend__of_the_runtime_rises_with_query_and_search(make_run: MakeRun) -> None:
    def runs(times: list[tuple[float, float]]) -> list[list[Run]]:
        return [
            [
                make_run(*key, seed, preparation=query, seconds=search * (1 + 0.01 * (seed % 3)))
                for seed in SEEDS
            ]
            for key, (query, search) in zip((A, B, C), times, strict=True)
        ]

    rises = partial(claims.trend, (A, B, C), "runtime", falling=False)
    assert verdict(rises, *runs([(1.0, 1.0), (2.0, 1.0), (3.0, 1.0)])) == "holds"
    # The query takes longer, but saves more of the search: the runtime got better.
    assert verdict(rises, *runs([(1.0, 9.0), (2.0, 6.0), (3.0, 1.0)])) == "does not hold"


@pytest.mark.parametrize(
    ("power", "expected"), [(0.3, "holds"), (1.1, "does not hold"), (-0.5, "does not hold")]
)
def test_sublinear__time_per_query(make_run: MakeRun, power: float, expected: str) -> None:
    sizes = (10, 100, 1000)
    runs = [
        make_run("Cup", str(size), seed, preparation=4e-3 * size**power * (1 + 0.05 * (seed % 4)))
        for size in sizes
        for seed in SEEDS
    ]
    keys = [("Cup", str(size)) for size in sizes]
    assert verdict(partial(claims.sublinear, keys, sizes), runs) == expected


@pytest.mark.parametrize(
    ("failures", "seeds", "expected"),
    [(0, 128, "holds"), (5, 128, "open"), (20, 128, "does not hold"), (0, 20, "open")],
)
def test_solves__by_wilsons_interval(make_run: MakeRun, failures: int, seeds: int, expected: str) -> None:
    runs = [make_run(*A, seed, solved=seed >= failures) for seed in range(seeds)]
    assert verdict(partial(claims.solves, [A]), runs) == expected


def test_claims__without_runs_are_not_decided() -> None:
    checked = check_claims(Results((), 100), paper_claims())
    assert len(checked) == len(paper_claims())
    assert {each.verdict for each in checked} == {"not evaluated"}
    assert all("no results of" in each.outcome.figures for each in checked)


def test_claims__of_the_paper_can_all_fail(group: Group) -> None:
    needed = dict.fromkeys(key for claim in paper_claims() for key in claim.needs)
    same = Results(tuple(run for key in needed for run in group(*key, solved=True)), 100)
    kept = [each for each in check_claims(same, paper_claims()) if each.verdict == "holds"]
    # Nobody differs from anybody: only what asks for likeness holds.
    assert len(kept) == 4
    assert all("differ" in each.claim.statement or "ratio" in each.claim.statement
               or "at most" in each.claim.statement for each in kept)  # fmt: skip


def test_why__is_said_where_a_claim_does_not_hold(group: Group) -> None:
    claim = claims.Claim("a below b", (A, B), partial(claims.lower, ((A, B),), "samples"), why="since so")
    holds = check_claims(Results((*group(*A, samples=3), *group(*B, samples=5)), 100), [claim])[0]
    fails = check_claims(Results((*group(*A, samples=5), *group(*B, samples=3)), 100), [claim])[0]
    assert (holds.why, fails.why) == ("", "since so")
    assert fails.record()["why"] == "since so"


def test_claims__are_the_papers_words_and_ours_are_not(group: Group) -> None:
    statements = [claim.statement for claim in paper_claims()]
    assert len(set(statements)) == len(statements)
    assert all(claim.words for claim in paper_claims())
    results = Results((*group("Cup", "oracle"), *group("Cup", "rrt")), 100)
    own = own_checks(results)
    assert not any(claim.words for claim in own)
    assert sum("solves at least" in claim.statement for claim in own) == 2  # of whatever was evaluated
    needed = {key[1] for claim in paper_claims() for key in claim.needs}
    assert database_label(3000) in needed
    assert "oracle" not in needed
