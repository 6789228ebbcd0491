"""The command line, through its own front door."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from guided_gym.errors import GuidedGymWarning
from guided_gym.guidance.learned.folders import agent_folder, shipped_agents
from guided_gym.registration import SELECTIONS
from guided_gym.train import cli
from guided_gym.train.results import RESULTS_FILE, ResultsFile
from guided_gym.train.terminal import EXIT_INTERRUPTED

runner = CliRunner()
COMMAND = ["evaluate", "--env", "Cup", "--workers", "1", "--max-samples", "60", "--seeds", "2"]


def invoke(*arguments: object) -> tuple[int, str, str]:
    result = runner.invoke(cli.app, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.stdout, result.stderr


def test_help__names_every_command() -> None:
    code, out, _ = invoke("--help")
    assert code == 0
    for command in ("list", "evaluate", "single-step", "reproduce", "database", "doctor", "--version"):
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


def test_list__names_what_was_learned_and_on_what() -> None:
    rows = {line.split()[0]: line for line in invoke("list")[1].splitlines()}
    for name in shipped_agents():
        training = json.loads((agent_folder(name) / "card.json").read_text())["training"]
        assert all(problems in rows[f"learned:{name}"] for problems in training["environments"])
    assert "lazy_prm and medial_axis" in rows["learned:trap-cup-hybrid"]
    for name, problems in SELECTIONS.items():
        assert problems in rows[name]


def test_doctor__names_versions_and_folders() -> None:
    code, out, _ = invoke("doctor")
    assert code == 0
    assert "numba" in out
    assert "oracle cache" in out


def test_evaluate__prints_the_table_and_writes_the_files(tmp_path: Path) -> None:
    code, out, _ = invoke(*COMMAND, "--guidance", "rrt, goal_distance", "--out", tmp_path, "--no-figures")
    assert code == 0
    for text in (
        "Cup, 2 seeds, oracle error 0.",
        "goal_distance",
        "SE per sample",
        "best possible",
        RESULTS_FILE,
    ):
        assert text in out
    rows = json.loads((tmp_path / "table.json").read_text())
    assert {row["guidance"] for row in rows} == {"rrt", "goal_distance"}
    assert [row["rank"] for row in rows] == [1, 2]
    assert rows[0]["samples_mean_low"] <= rows[0]["samples_mean"] <= rows[0]["samples_mean_high"]
    with (tmp_path / "table.csv").open() as file:
        assert [row["environment"] for row in csv.DictReader(file)] == ["Cup", "Cup"]
    again = invoke(*COMMAND, "--guidance", "rrt, goal_distance", "--out", tmp_path, "--no-figures")[1]
    assert again == out  # not even the wall time differs: nothing was computed anew


def test_evaluate__draws(tmp_path: Path) -> None:
    code, out, _ = invoke(*COMMAND, "--guidance", "rrt,hybrid", "--out", tmp_path)
    assert code == 0
    assert "figures/ (12 files)" in out
    drawn = {path.name for path in (tmp_path / "figures").glob("*.png")}
    kinds = ("efficiency", "regions", "places", "cost", "trees", "guiding-spaces")
    assert drawn == {f"Cup-{what}.png" for what in kinds}


def test_evaluate__by_a_protocol_rewired_and_normalised_by_the_tree(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    command = [*COMMAND, "--guidance", "rrt,oracle", "--protocol", "selection", "--no-figures"]
    oracle = "--resolution", "32,32,16", "--oracle-budget", "50000"
    code, out, _ = invoke(*command, "--rewire", "--normalisation", "tree", *oracle)
    assert code == 0
    assert "Least excess SE" in " ".join(out.split())
    assert (tmp_path / "results" / "Cup-selection" / RESULTS_FILE).exists()
    with ResultsFile.in_folder(tmp_path / "results" / "Cup-selection") as file:
        (content,) = file._connection.execute("SELECT DISTINCT content FROM settings LIMIT 1").fetchone()
    settings = json.loads(content)["settings"]
    assert (settings["protocol"], settings["rewire"]) == ("selection", True)
    assert settings["target"]["normalisation"] == "tree"
    assert (settings["oracle"]["resolution"], settings["oracle"]["budget"]) == ([32, 32, 16], 50_000)
    rows = json.loads((tmp_path / "results" / "Cup-selection" / "table.json").read_text())
    assert all(0.005 < row["oracle_error"] < 0.2 for row in rows)  # a grid as coarse as that
    assert invoke(*COMMAND, "--guidance", "rrt", "--protocol", "expansion", "--no-figures")[0] == 0


def test_single_step__prints_and_writes(tmp_path: Path) -> None:
    command = ["single-step", "--env", "Cup", "--guidance", "rrt,oracle", "--from", "uninformed"]
    options = ["--seeds", 2, "--workers", 1, "--max-samples", 40, "--out", tmp_path]
    code, out, _ = invoke(*command, *options)
    assert code == 0
    assert "single steps on 8 trees of 2 seeds" in out
    rows = json.loads((tmp_path / "single-step.json").read_text())
    assert [row["guidance"] for row in rows] == ["rrt", "oracle"]


def test_help__names_the_extra() -> None:
    assert "needs the extra 'train'" in " ".join(invoke("train", "--help")[1].split())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["evaluate", "--env", "TrapCop"], "did you mean 'TrapCup'"),
        (["evaluate", "--env", "Cup", "--guidance", "lazzy_prm"], "did you mean 'lazy_prm'"),
        (["evaluate", "--env", "Cup", "--delta", "0"], "delta: expected a positive number"),
        (["evaluate", "--env", "Cup", "--seeds", "0"], "seeds: expected an integer, at least 1"),
        (["evaluate", "--env", ""], "at least one environment"),
        (["evaluate", "--env", "Cup", "--import", "no_such_module"], "cannot import"),
        (["evaluate", "--env", "Cup,,Trap"], "env: expected names separated by commas"),
        (["evaluate", "--env", "Cup", "--guidance", "rrt,"], "guidance: expected names separated by commas"),
        (["evaluate", "--env", "Cup", "--guidance", "rrt+"], "names joined by '+'"),
        (["evaluate", "--env", "Cup", "--guidance", "rrt@goal_bias=nan"], "goal_bias: expected a finite"),
        (["evaluate", "--env", "Cup", "--guidance", "lazy_prm@vertices=abc"], "expected an integer"),
        (["evaluate", "--env", "Cup", "--expansion", "unifrom"], "did you mean 'uniform'"),
        (["evaluate", "--env", "Cup", "--protocol", "both"], "protocol: expected one of whole, selection"),
        (["evaluate", "--env", "Cup", "--normalisation", "none"], "normalisation: expected 'start' or"),
        (["evaluate", "--env", "Cup", "--resolution", "32,x"], "resolution: expected counts like"),
        (
            ["evaluate", "--env", "Cup", "--resolution", "2,2,2"],
            "resolution: expected an integer, at least 4",
        ),
        (["evaluate", "--env", "Cup", "--oracle-budget", "5"], "budget: expected an integer, at least 10000"),
        (["evaluate", "--env", "Cup", "--workers", "0"], "workers: expected an integer, at least 1"),
        (["evaluate", "--env", "Cup", "--guidance", "rrt", "--database", __file__], "expected path_database"),
        (["reproduce", "--seeds", "0"], "seeds: expected an integer, at least 1"),
        (["reproduce", "--workers", "0"], "workers: expected an integer, at least 1"),
        (["database", "build", "Cup", "--paths", "0"], "paths: expected an integer, at least 1"),
        (["database", "build", "Cup", "--paths", "1", "--workers", "0"], "workers: expected an integer"),
        (["list", "--import", "no_such_module"], "cannot import"),
        (["database", "info", "no-such-file"], "no such file"),
        (["problems", "build", "Cup", "--count", "0"], "count: expected an integer, at least 1"),
        (["problems", "build", "Cupp", "--count", "1"], "did you mean 'Cup'"),
        (["problems", "info", __file__], "expected a problem set, got a file of another kind"),
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
    assert err.count("\n") == 1
    assert "b'" not in err


def test_empty_results__count_as_new(tmp_path: Path) -> None:
    (tmp_path / RESULTS_FILE).touch()
    assert invoke(*COMMAND, "--guidance", "rrt", "--out", tmp_path, "--no-figures")[0] == 0


def test_no_path__leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "walled.py").write_text(
        "from guided_gym import Environment, FixedProblem, Problem, Robot, Task\n"
        "from guided_gym import register_distribution\n"
        "walls = Environment.from_polygons((0, 0, 4, 4), [[(2, -1), (2.5, -1), (2.5, 5), (2, 5)]])\n"
        "problem = Problem(Robot.point(), walls, Task((1, 1), (3, 3)), 'Walled')\n"
        "register_distribution('Walled', lambda: FixedProblem(problem))\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    code, _, err = invoke("evaluate", "--env", "Walled", "--import", "walled", "--seeds", "1", "--workers", 1)
    assert code == cli.EXIT_ERROR
    assert err.startswith("guided-gym: error: ")
    assert not (tmp_path / "results").exists()


def test_warnings_of_ours__are_one_line() -> None:
    ours = cli._one_line(GuidedGymWarning("slow"), GuidedGymWarning, "file.py", 3)
    assert ours == "guided-gym: warning: slow\n"
    assert "UserWarning: other" in cli._one_line(UserWarning("other"), UserWarning, "file.py", 3)


def test_interrupt__is_code_130(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from guided_gym.train import evaluation

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluation, "run_once", interrupted)
    code, _, err = invoke(*COMMAND, "--guidance", "rrt", "--out", tmp_path)
    assert code == EXIT_INTERRUPTED
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


def test_problems__build_and_info(tmp_path: Path) -> None:
    file = tmp_path / "passages.problems"
    build = ["problems", "build", "RandomSimplePassage@test", "--count", 2, "--workers", 1, "--out", file]
    for new in (2, 0):
        code, out, _ = invoke(*build)
        assert code == 0 and f"{file}: 2 problems ({new} new)" in out.replace("\n", "")
    code, out, _ = invoke("problems", "info", file)
    assert code == 0 and "RandomSimplePassage@test" in out and "2, of the seeds 0 to 1" in out


def test_import__registers_names_of_ones_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_guidance.py").write_text(
        "from guided_gym import register_guidance\n"
        "from guided_gym.guidance.cells import Uninformed\n"
        "@register_guidance\n"
        "class Mine(Uninformed):\n"
        "    name = 'mine'\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    arguments = [*COMMAND, "--guidance", "mine", "--import", "my_guidance", "--no-figures"]
    arguments[arguments.index("--workers") + 1] = "2"
    code, out, err = invoke(*arguments)
    assert code == 0, err
    assert "mine" in out
