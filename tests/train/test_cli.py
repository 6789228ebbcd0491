"""The command line, through its own front door."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from guided_gym.train import cli
from guided_gym.train.results import RESULTS_FILE

runner = CliRunner()
COMMAND = ["evaluate", "--env", "Cup", "--workers", "1", "--max-samples", "60", "--seeds", "2"]


def invoke(*arguments: object) -> tuple[int, str, str]:
    result = runner.invoke(cli.app, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr


def test_help__names_every_command() -> None:
    code, out, _ = invoke("--help")
    assert code == 0
    for command in ("list", "evaluate", "reproduce", "database", "doctor", "--version"):
        assert command in out


def test_help__imports_nothing_heavy() -> None:
    heavy = ["matplotlib", "networkx", "pygame", "torch", "scipy.stats", "guided_gym.train.evaluation"]
    code = f"import sys, guided_gym.train.cli; print([m for m in {heavy} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_version() -> None:
    code, out, _ = invoke("--version")
    assert code == 0
    assert out.startswith("guided-gym ")


def test_list__names_and_describes() -> None:
    code, out, _ = invoke("list")
    assert code == 0
    for line in ("TrapCup", "First the trap, then the cup", "lazy_prm", "rectangle"):
        assert line in out


def test_doctor__names_versions_and_folders() -> None:
    code, out, _ = invoke("doctor")
    assert code == 0
    assert "numba" in out
    assert "oracle cache" in out


def test_evaluate__prints_the_table_and_writes_the_files(tmp_path: Path) -> None:
    code, out, _ = invoke(*COMMAND, "--guidance", "rrt, goal_distance", "--out", tmp_path, "--no-figures")
    assert code == 0
    for text in ("Cup, 2 seeds", "goal_distance", "SE per sample", "best possible", RESULTS_FILE):
        assert text in out
    rows = json.loads((tmp_path / "table.json").read_text())
    assert [row["guidance"] for row in rows] == ["rrt", "goal_distance"]
    assert rows[0]["samples_mean_low"] <= rows[0]["samples_mean"] <= rows[0]["samples_mean_high"]
    with (tmp_path / "table.csv").open() as file:
        assert [row["environment"] for row in csv.DictReader(file)] == ["Cup", "Cup"]
    again = invoke(*COMMAND, "--guidance", "rrt, goal_distance", "--out", tmp_path, "--no-figures")[1]
    assert again == out  # not even the wall time differs: nothing was computed anew


def test_evaluate__draws(tmp_path: Path) -> None:
    code, out, _ = invoke(*COMMAND, "--guidance", "rrt,hybrid", "--out", tmp_path)
    assert code == 0
    assert "figures/ (8 files)" in out
    drawn = {path.name for path in (tmp_path / "figures").glob("*.png")}
    assert drawn == {f"Cup-{what}.png" for what in ("efficiency", "regions", "trees", "guiding-spaces")}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "--env", "TrapCop"], "did you mean 'TrapCup'"),
        (["evaluate", "--env", "Cup", "--guidance", "lazzy_prm"], "did you mean 'lazy_prm'"),
        (["evaluate", "--env", "Cup", "--delta", "0"], "delta: expected a positive number"),
        (["evaluate", "--env", "Cup", "--seeds", "0"], "seeds: expected at least 1"),
        (["evaluate", "--env", ""], "at least one environment"),
        (["evaluate", "--env", "Cup", "--import", "no_such_module"], "cannot import"),
        (["database", "info", "no-such-file"], "no such file"),
        (["database", "build", "Cupp", "--paths", "1"], "did you mean 'Cup'"),
    ],
)
def test_bad_input__is_one_line_and_code_2(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = invoke(*arguments)
    assert code == cli.EXIT_ERROR
    assert err.count("\n") == 1
    assert err.startswith("guided-gym: error: ")
    assert message in err
    assert list(tmp_path.iterdir()) == []


def test_corrupt_results__are_one_line_and_code_2(tmp_path: Path) -> None:
    (tmp_path / RESULTS_FILE).write_text("these are not results")
    code, _, err = invoke(*COMMAND, "--guidance", "rrt", "--out", tmp_path)
    assert code == cli.EXIT_ERROR
    assert "results file" in err


def test_interrupt__is_code_130(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from guided_gym.train import evaluation

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluation, "run_once", interrupted)
    code, _, err = invoke(*COMMAND, "--guidance", "rrt", "--out", tmp_path)
    assert code == cli.EXIT_INTERRUPTED
    assert "0 of 2 are kept" in err


def test_database__build_and_info(tmp_path: Path) -> None:
    file = tmp_path / "deep" / "paths.sqlite"
    build = ["database", "build", "RandomSimplePassage", "--paths", 3, "--workers", 1, "--out", file]
    assert "3 paths (3 new" in invoke(*build)[1]
    assert "3 paths (0 new" in invoke(*build)[1]
    code, out, _ = invoke("database", "info", file)
    assert code == 0
    assert "RandomSimplePassage" in out
    assert "paths             3" in out


def test_import__registers_names_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_guidance.py").write_text(
        "from guided_gym.guidance import GoalDistance, register_guidance\n"
        "@register_guidance\n"
        "class Mine(GoalDistance):\n"
        "    name = 'mine'\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    arguments = [*COMMAND, "--guidance", "mine", "--import", "my_guidance", "--no-figures"]
    arguments[arguments.index("--workers") + 1] = "2"
    code, out, err = invoke(*arguments)
    assert code == 0, err
    assert "mine" in out
