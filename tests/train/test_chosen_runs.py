"""Runs to look at: which they are, and that searching them again gives the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from guided_gym import InvalidInputError, read_trace
from guided_gym.train import cli
from guided_gym.train.chosen_runs import check_words, chosen_runs, trace_name, trace_runs
from guided_gym.train.evaluation import Plan, run_plans
from guided_gym.train.results import Run
from guided_gym.train.specs import EvaluationSettings, GuidanceSpec

PLAN = Plan("Cup", GuidanceSpec("goal_distance"), EvaluationSettings(max_samples=40))


@pytest.fixture(scope="module")
def runs() -> list[Run]:
    """Three seeds, of which 0 is solved at a total SE of 9, 1 at 5, and 2 is not, at 1."""
    first = run_plans([PLAN], seeds=1).runs[0]
    told = ((0, True, 9.0), (1, True, 5.0), (2, False, 1.0))
    return [replace(first, seed=k, solved=solved, total_efficiency=se) for k, solved, se in told]


def test_chosen__best_median_worst_and_seeds(runs: list[Run]) -> None:
    assert chosen_runs(runs, ["best", "median", "worst"]) == {1: ("best",), 0: ("median",), 2: ("worst",)}
    assert chosen_runs(runs, ["worst", "2", "0", "2"]) == {2: ("worst", "seed 2"), 0: ("seed 0",)}
    assert chosen_runs(runs[:1], ["best", "median", "worst"]) == {0: ("best", "median", "worst")}


@pytest.mark.parametrize("word", ["beast", "3", "-1", "1.0", "²"])
def test_chosen__refuses_other_words(runs: list[Run], word: str) -> None:
    with pytest.raises(InvalidInputError, match="expected best, median, worst or a seed that was run"):
        chosen_runs(runs, [word])
    with pytest.raises(InvalidInputError, match="expected best, median, worst or a seed that was run"):
        check_words([word], 3)


def test_trace_runs__are_the_runs_again(tmp_path: Path) -> None:
    results = run_plans([PLAN], seeds=3)
    chosen = trace_runs(results, [PLAN], ["best", "2"], tmp_path)
    for one in chosen:
        trace = read_trace(one.path)
        assert one.same and len(trace) == one.run.samples
        assert sum(sample.efficiency for sample in trace.samples) == pytest.approx(one.run.total_efficiency)
    other = replace(results.runs[0], samples=39)
    assert not trace_runs(replace(results, runs=(other,)), [PLAN], ["0"], tmp_path)[0].same


def test_trace_name__is_a_name_and_tells_labels_apart() -> None:
    names = {
        trace_name(Plan("maps/office.toml", GuidanceSpec("rrt", (), label)), 3)
        for label in ("a/b", "a?b", "a_b", "../a", "x" * 300, "x" * 301)
    }
    assert len(names) == 6
    assert all(
        name.endswith("-3") and len(name) < 120 and not set(name) & set('/\\:*?"<>| ') for name in names
    )


def test_evaluate__records_and_replay_plays(tmp_path: Path) -> None:
    runner = CliRunner()
    command = ["evaluate", "--env", "Cup", "--guidance", "goal_distance", "--workers", "1", "--seeds", "2"]
    command += ["--max-samples", "40", "--no-figures", "--out", str(tmp_path)]
    answer = runner.invoke(cli.app, [*command, "--trace", "worst,0"])
    assert answer.exit_code == 0, answer.output
    traces = sorted((tmp_path / "traces").iterdir())
    assert tmp_path / "traces" / "Cup-goal_distance-0.jsonl" in traces
    out = tmp_path / "search.html"
    answer = runner.invoke(cli.app, ["replay", *map(str, traces[:2]), "-o", str(out)])
    assert answer.exit_code == 0 and str(out) in answer.stdout.replace("\n", "")
    assert out.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    answer = runner.invoke(cli.app, ["replay", str(tmp_path / "results.sqlite"), "-o", str(out)])
    assert answer.exit_code == 2 and "guided-gym: error: " in answer.stderr
    answer = runner.invoke(cli.app, [*command, "--trace", "bset"])
    assert answer.exit_code == 2 and "got 'bset'" in answer.stderr
