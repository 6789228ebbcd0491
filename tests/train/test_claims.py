"""Claims can come out either way, and say so when they can't be decided."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from guided_gym.train import claims
from guided_gym.train.claims import Outcome, all_claims, check_claims, database_label
from guided_gym.train.results import Results, Run

MakeRun = Callable[..., Run]
Check = Callable[[Results], Outcome]
SEEDS = range(12)


@pytest.fixture
def group(make_run: MakeRun) -> Callable[..., list[Run]]:
    """Runs of several seeds, with a little spread in their SE."""

    def build(environment: str, guidance: str, efficiency: float = 2.0, **changes: object) -> list[Run]:
        return [
            make_run(environment, guidance, seed, efficiency=efficiency * (1 + 0.01 * (seed % 3)), **changes)
            for seed in SEEDS
        ]

    return build


def holds(check: Check, *groups: list[Run]) -> bool:
    return check(Results(tuple(run for runs in groups for run in runs), 100)).holds


@pytest.mark.parametrize("check", [claims.lower_total, claims.lower_per_sample])
def test_lower__needs_intervals_apart(check: Callable[..., Outcome], group: Callable[..., list[Run]]) -> None:
    claim = partial(check, ("Cup", "a"), ("Cup", "b"))
    assert holds(claim, group("Cup", "a", 1.0), group("Cup", "b", 2.0))
    assert not holds(claim, group("Cup", "a", 2.0), group("Cup", "b", 1.0))
    assert not holds(claim, group("Cup", "a", 2.0), group("Cup", "b", 2.001))


def test_starts_level__within_the_span_of_the_others(group: Callable[..., list[Run]]) -> None:
    claim = partial(claims.starts_level, "Cup", "rrt", ("a", "b"))
    others = group("Cup", "a", 1.0), group("Cup", "b", 3.0)
    assert holds(claim, group("Cup", "rrt", 2.0), *others)
    assert not holds(claim, group("Cup", "rrt", 4.0), *others)
    assert not holds(claim, group("Cup", "rrt", 0.5), *others)


def test_starts_level__looks_at_the_first_samples_only(make_run: MakeRun) -> None:
    curve = np.concatenate([np.full(claims.EARLY, 1.0), np.full(30, 9.0)]).astype(np.float32)
    rrt = [make_run("Cup", "rrt", seed, samples=50, curve=curve) for seed in SEEDS]
    other = [make_run("Cup", "a", seed, efficiency=1.0) for seed in SEEDS]
    assert holds(partial(claims.starts_level, "Cup", "rrt", ("a",)), rrt, other)


@pytest.mark.parametrize(("later", "expected"), [(5.0, True), (1.0, False), (0.2, False)])
def test_gets_worse__after_the_first_samples(make_run: MakeRun, later: float, expected: bool) -> None:
    curve = np.concatenate([np.full(claims.EARLY, 1.0), np.full(30, later)]).astype(np.float32)
    runs = [make_run("Cup", "rrt", seed, samples=50, curve=curve) for seed in SEEDS]
    runs.append(make_run("Cup", "rrt", 99, samples=3, efficiency=1.0))  # ended before: says nothing of later
    assert holds(partial(claims.gets_worse, "Cup", "rrt"), runs) is expected


def test_peaks_in__the_region_that_costs_most(make_run: MakeRun) -> None:
    runs = [
        make_run(seed=seed, regions={"trap": (9.0 + seed % 2, 3), "cup": (2.0, 1), "beyond": (0.0, 0)})
        for seed in SEEDS
    ]
    assert holds(partial(claims.peaks_in, "Cup", "rrt", "trap"), runs)
    assert not holds(partial(claims.peaks_in, "Cup", "rrt", "cup"), runs)
    assert not holds(partial(claims.peaks_in, "Cup", "rrt", "moon"), runs)


@pytest.mark.parametrize(("samples", "expected"), [(10, True), (14, True), (16, False), (6, False)])
def test_same_samples__by_the_ratio_of_medians(
    group: Callable[..., list[Run]], samples: int, expected: bool
) -> None:
    claim = partial(claims.same_samples, ("Cup", "a"), ("Cup", "b"))
    assert holds(claim, group("Cup", "a", samples=samples), group("Cup", "b", samples=10)) is expected


def test_falls__needs_a_trend_and_ends_apart(group: Callable[..., list[Run]]) -> None:
    labels = ["a", "b", "c"]
    claim = partial(claims.falls, [("Cup", label) for label in labels], "efficiency_per_sample")

    def ordered(values: list[float]) -> list[list[Run]]:
        return [group("Cup", label, value) for label, value in zip(labels, values, strict=True)]

    assert holds(claim, *ordered([3.0, 2.0, 1.0]))
    assert not holds(claim, *ordered([1.0, 2.0, 3.0]))
    assert not holds(claim, *ordered([2.0, 2.0, 2.0]))


@pytest.mark.parametrize(("power", "expected"), [(0.3, True), (1.1, False)])
def test_sublinear__time_per_query(make_run: MakeRun, power: float, expected: bool) -> None:
    sizes = (10, 100, 1000)
    runs = [
        make_run("Cup", str(size), seed, preparation=4e-3 * size**power * (1 + 0.05 * (seed % 4)))
        for size in sizes
        for seed in SEEDS
    ]
    keys = [("Cup", str(size)) for size in sizes]
    assert holds(partial(claims.sublinear, keys, sizes), runs) is expected


@pytest.mark.parametrize(("failures", "expected"), [(0, True), (1, True), (2, False)])
def test_solves__at_least_95_percent(make_run: MakeRun, failures: int, expected: bool) -> None:
    runs = [make_run(seed=seed, solved=seed >= failures) for seed in range(20)]
    assert holds(partial(claims.solves, [("Cup", "rrt")]), runs) is expected


def test_lowest_of_all__against_whatever_is_there(group: Callable[..., list[Run]]) -> None:
    claim = partial(claims.lowest_of_all, "Cup", "oracle")
    assert holds(claim, group("Cup", "oracle", 1.0), group("Cup", "a", 2.0), group("Trap", "b", 0.1))
    assert not holds(claim, group("Cup", "oracle", 1.0), group("Cup", "a", 2.0), group("Cup", "b", 1.0))
    assert not holds(claim, group("Cup", "oracle", 1.0))


def test_claims__without_runs_are_not_decided() -> None:
    checked = check_claims(Results((), 100))
    assert len(checked) == len(all_claims())
    assert {claim.verdict for claim in checked} == {"not evaluated"}
    assert all("no results of" in claim.figures for claim in checked)


def test_claims__of_the_paper_can_all_fail_and_say_so(group: Callable[..., list[Run]]) -> None:
    needed = dict.fromkeys(key for claim in all_claims() for key in claim.needs)
    same = Results(tuple(run for key in needed for run in group(*key, solved=False)), 100)
    checked = check_claims(same)
    assert {claim.holds for claim in checked} <= {True, False}
    # Nobody differs from anybody: only what asks for likeness, or for no growth, holds.
    kept = [claim.statement for claim in checked if claim.holds]
    assert len(kept) == 3
    assert any("starts level" in text for text in kept)
    assert any("about as many samples" in text for text in kept)
    assert any("slower than linearly" in text for text in kept)
    assert {claim.record()["verdict"] for claim in checked} == {"holds", "does not hold"}


def test_claims__name_each_thing_once() -> None:
    statements = [claim.statement for claim in all_claims()]
    assert len(set(statements)) == len(statements)
    assert any(database_label(3000) in text for text in statements)
