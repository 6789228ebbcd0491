"""The page of an evaluation: what it says is what the results say, and it repeats by its own command."""

from __future__ import annotations

import json
import re
import shlex
import shutil
from dataclasses import replace
from html import unescape
from pathlib import Path

import pytest
from typer.testing import CliRunner

from guided_gym.train import cli
from guided_gym.train.report import (
    EVALUATION_FILE,
    Evaluation,
    read_evaluation,
    report_page,
    results_of,
    write_report,
)
from guided_gym.train.results import Results
from guided_gym.train.table import summarise

runner = CliRunner()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An evaluation on Cup with a report, in which no search of goal_distance is solved."""
    folder = tmp_path_factory.mktemp("evaluation")
    command = ["evaluate", "--env", "Cup", "--guidance", "goal_distance,medial_axis", "--workers", "1"]
    command += ["--seeds", "3", "--max-samples", "50", "--no-figures", "--report", "--out", str(folder)]
    answer = runner.invoke(cli.app, command)
    assert answer.exit_code == 0, answer.output
    assert "The report: " in answer.stdout
    return folder


def texts(page: str, tag: str) -> list[str]:
    found = re.findall(rf"<{tag}[^>]*>(.*?)</{tag}>", page, re.DOTALL)
    return [unescape(re.sub(r"<[^>]+>", " ", text)).strip() for text in found]


def test_report__the_table_is_that_of_the_results(folder: Path) -> None:
    page = (folder / "report.html").read_text(encoding="utf-8")
    results = results_of(folder, read_evaluation(folder))
    rows = summarise(results)
    values = [float(value) for value in re.findall(r'<td data-value="([^"]+)"', page)]
    for row in rows:
        for key, interval in row.figures.items():
            if interval.estimate == interval.estimate:
                assert interval.estimate in values, key
    heads = re.findall(r'<th scope="row">(.*?)</th>', page)
    assert heads[: len(rows)] == [row.guidance for row in rows]
    assert "Differences from medial_axis" in texts(page, "h3")


def test_report__says_what_was_not_solved_and_why(folder: Path) -> None:
    page = (folder / "report.html").read_text(encoding="utf-8")
    unsolved = [text for text in texts(page, "li") if text.startswith("goal_distance, seed")]
    assert len(unsolved) == 3
    assert all("gave up after 50 samples" in text and "collided" in text for text in unsolved)


def test_report__its_command_repeats_it(folder: Path) -> None:
    command = shlex.split(read_evaluation(folder).command)
    assert command[:2] == ["guided-gym", "evaluate"]
    before = (folder / EVALUATION_FILE).read_text(encoding="utf-8")
    answer = runner.invoke(cli.app, command[1:])
    assert answer.exit_code == 0, answer.output
    assert (folder / EVALUATION_FILE).read_text(encoding="utf-8") == before


def test_report__what_was_run_is_read_back(folder: Path) -> None:
    evaluation = read_evaluation(folder)
    assert [plan.spec.label for plan in evaluation.plans] == ["goal_distance", "medial_axis"]
    assert {plan.settings.max_samples for plan in evaluation.plans} == {50}
    assert evaluation.seeds == (0, 1, 2)
    assert len(results_of(folder, evaluation)) == 6


def test_report__names_with_script_are_shown_as_text(folder: Path) -> None:
    evaluation = read_evaluation(folder)
    results = results_of(folder, evaluation)
    script = "</script><script>alert(1)</script>"
    runs = tuple(replace(run, environment=script, guidance=script + run.guidance) for run in results.runs)
    results = Results(runs, results.max_samples, {script: {7: script}})
    page = report_page(folder, replace(evaluation, command=script, version=script), results)
    assert script not in page and page.count("&lt;script&gt;alert(1)") > 5


def test_report__a_search_that_went_otherwise_says_so(folder: Path, tmp_path: Path) -> None:
    from guided_gym.train.chosen_runs import trace_runs

    evaluation = read_evaluation(folder)
    results = results_of(folder, evaluation)
    run = replace(results.runs[0], samples=49)
    other = replace(results, runs=(run,))
    chosen = trace_runs(other, evaluation.plans, ["best"], tmp_path)
    assert "the code has changed since the evaluation" in report_page(folder, evaluation, other, chosen)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "that `guided-gym evaluate` has written"),
        ("{", "cannot read"),
        ('{"format": "guided-gym evaluation 9"}', "expected 'guided-gym evaluation 1'"),
        ('{"format": "guided-gym evaluation 1"}', "is damaged"),
        ("[]", "is damaged"),
    ],
)
def test_report__bad_folders(folder: Path, tmp_path: Path, content: str | None, message: str) -> None:
    shutil.copy(folder / "results.sqlite", tmp_path)
    if content is not None:
        (tmp_path / EVALUATION_FILE).write_text(content, encoding="utf-8")
    answer = runner.invoke(cli.app, ["report", str(tmp_path)])
    assert answer.exit_code == 2 and message in answer.stderr


def test_report__without_rows(folder: Path, tmp_path: Path) -> None:
    shutil.copy(folder / EVALUATION_FILE, tmp_path)
    answer = runner.invoke(cli.app, ["report", str(tmp_path)])
    assert answer.exit_code == 2 and "there is no results.sqlite" in answer.stderr
    content = json.loads((folder / EVALUATION_FILE).read_text(encoding="utf-8"))
    for plan in content["plans"]:
        plan["fingerprint"] = "another"
    (tmp_path / EVALUATION_FILE).write_text(json.dumps(content), encoding="utf-8")
    shutil.copy(folder / "results.sqlite", tmp_path)
    answer = runner.invoke(cli.app, ["report", str(tmp_path)])
    assert answer.exit_code == 2 and "got none" in answer.stderr


def test_report__without_replays(folder: Path, tmp_path: Path) -> None:
    out = write_report(folder, tmp_path / "page.html", replays=False)
    assert "<h3>Searches</h3>" not in out.read_text(encoding="utf-8")
    assert isinstance(read_evaluation(folder), Evaluation)
