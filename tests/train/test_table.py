"""The table: what was not solved never looks good, and what is best is best beyond chance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from rich.console import Console

from guided_gym.train.results import Results, Run
from guided_gym.train.table import (
    LEAST_PAIRS,
    MEASURES,
    Comparison,
    Measure,
    rich_tables,
    save,
    summarise,
    verdicts,
)

MakeRun = Callable[..., Run]
SEEDS = range(12)
TOTAL = next(measure for measure in MEASURES if measure.key == "total_efficiency")


def results_of(*groups: list[Run], **more: object) -> Results:
    return Results(tuple(run for runs in groups for run in runs), 100, **more)  # type: ignore[arg-type]


@pytest.fixture
def group(make_run: MakeRun) -> Callable[..., list[Run]]:
    """Runs of several seeds; `gap` is added to the SE of each, whose spread is large and shared."""

    def build(guidance: str, gap: float = 0.0, unsolved: int = 0, **changes: object) -> list[Run]:
        rng = np.random.default_rng(0)
        return [
            make_run(
                "Cup",
                guidance,
                seed,
                efficiency=float(rng.uniform(1, 20)) + gap,
                solved=seed >= unsolved,
                **changes,
            )
            for seed in SEEDS
        ]

    return build


def printed(results: Results) -> str:
    console = Console(width=150, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    for table in rich_tables(summarise(results)):
        console.print(table)
    return console.export_text()


def test_rank__is_by_total_se_and_a_small_paired_difference_counts(group: Callable[..., list[Run]]) -> None:
    rows = summarise(results_of(group("worse", 0.5), group("better"), group("same")))
    assert [row.guidance for row in rows] == ["better", "same", "worse"]
    assert [row.rank for row in rows] == [1, 2, 3]
    assert ["total_efficiency" in row.best for row in rows] == [True, True, False]
    # Intervals of the two overlap: only the pairs tell them apart.
    assert rows[0].figures["total_efficiency"].high > rows[2].figures["total_efficiency"].low


def test_unsolved__never_looks_good(make_run: MakeRun, group: Callable[..., list[Run]]) -> None:
    # A search that never leaves its start has one choice, so SE 0 at each sample.
    stuck = [
        make_run("Cup", "stuck", seed, samples=100, efficiency=0.0, solved=False, nodes=1, best_possible=0.0)
        for seed in SEEDS
    ]
    rows = summarise(results_of(stuck, group("good", unsolved=0), group("some", -0.9, unsolved=6)))
    by_name = {row.guidance: row for row in rows}
    assert [row.guidance for row in rows] == ["good", "some", "stuck"]
    assert by_name["stuck"].best == frozenset()
    assert by_name["some"].unsolved == 6
    text = printed(results_of(stuck, group("good")))
    assert "≥ 0" in text
    assert "*" not in next(line for line in text.splitlines() if "stuck" in line)


def test_unsolved__one_of_many_counts_as_the_worst(group: Callable[..., list[Run]]) -> None:
    comparison = Comparison(results_of(group("all"), group("most", unsolved=1)), "Cup")
    assert comparison.reliable == ["all", "most"]  # one failure in twelve may be chance
    scores = comparison.scores(TOTAL)
    assert scores["most"][0] == max(scores["all"].max(), scores["most"].max())
    np.testing.assert_array_equal(scores["all"][1:], scores["most"][1:])


def test_best__of_few_seeds_is_not_known(make_run: MakeRun) -> None:
    few = range(LEAST_PAIRS - 1)
    runs = [
        [make_run("Cup", name, seed, efficiency=se) for seed in few] for name, se in (("a", 1.0), ("b", 9.0))
    ]
    rows = summarise(results_of(*runs))
    assert all("total_efficiency" in row.best for row in rows)
    assert "too few" in verdicts(results_of(*runs))[0]


@pytest.mark.parametrize(
    ("gap", "unsolved", "expected"),
    [(2.0, 0, "b, the next, has more by"), (0.0, 0, "may be chance"), (2.0, 9, "b, the next, solves less")],
)
def test_verdict__says_whether_the_difference_is_real(
    group: Callable[..., list[Run]], gap: float, unsolved: int, expected: str
) -> None:
    assert expected in verdicts(results_of(group("a"), group("b", gap, unsolved)))[0]


def test_ranking__of_selections_is_by_their_regret(make_run: MakeRun) -> None:
    # One has the smaller total, the other the smaller regret.
    small = [make_run("Cup", "small", seed, efficiency=2.0, best_possible=0.0) for seed in SEEDS]
    wise = [make_run("Cup", "wise", seed, efficiency=3.0, best_possible=11.0) for seed in SEEDS]
    assert [row.guidance for row in summarise(results_of(small, wise))] == ["small", "wise"]
    selection = summarise(results_of(small, wise, protocol="selection"))
    assert [row.guidance for row in selection] == ["wise", "small"]


def test_solved__has_wilsons_interval(group: Callable[..., list[Run]]) -> None:
    solved = summarise(results_of(group("a")))[0].figures["solved"]
    assert (solved.estimate, solved.high) == (1.0, 1.0)
    assert 0.7 < solved.low < 0.8  # twelve of twelve do not say more


def test_skipped__are_counted_and_named(group: Callable[..., list[Run]]) -> None:
    results = results_of(group("a"), skipped={"Cup": {7: "start [2.0, 1.0] is in collision", 9: "no path"}})
    assert "2 skipped; the first, seed 7: start [2.0, 1.0] is in collision" in " ".join(
        printed(results).split()
    )
    assert summarise(results)[0].record()["skipped"] == 2


def test_cells__without_a_figure_are_a_dash(group: Callable[..., list[Run]]) -> None:
    lines = printed(results_of(group("a", unsolved=12))).splitlines()
    assert "–" in next(line for line in lines if " a " in line).split()


def test_save__has_every_measure(tmp_path, group: Callable[..., list[Run]]) -> None:
    files = save(summarise(results_of(group("a"))), tmp_path)
    head = files[0].read_text().splitlines()[0].split(",")
    assert {measure.key for measure in MEASURES} < set(head)
    assert {"rank", "unsolved", "skipped", "best"} < set(head)


def test_measures__have_each_a_key_of_their_own() -> None:
    assert len({measure.key for measure in MEASURES}) == len(MEASURES)
    assert isinstance(TOTAL, Measure)
