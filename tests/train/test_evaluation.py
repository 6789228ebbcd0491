"""Evaluation: figures that add up, nothing computed twice, nothing lost to a kill."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import shapely
from typer.testing import CliRunner

from guided_gym.catalogue import table
from guided_gym.catalogue.distributions import ProblemList
from guided_gym.catalogue.table import make_distribution, named_distribution, register_distribution
from guided_gym.errors import InvalidInputError, NoPathError, StorageError, UnknownNameError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.options import TargetParameters
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task
from guided_gym.train import evaluation
from guided_gym.train.cli import app
from guided_gym.train.evaluation import ELSEWHERE, evaluate, region_sums, run_once
from guided_gym.train.results import RESULTS_FILE, Results, ResultsFile, Run
from guided_gym.train.specs import EvaluationSettings, GuidanceSpec
from guided_gym.train.table import summarise

SHORT = EvaluationSettings(max_samples=60)


def figures(run: Run) -> tuple[object, ...]:
    """A run without its clock."""
    return (run.environment, run.guidance, run.seed, run.samples, run.total_efficiency, run.collision_checks)


def test_runs__are_those_of_guided_search() -> None:
    results = evaluate("Cup", ["rrt", "goal_distance"], seeds=[3, 1], settings=SHORT)
    assert results.pairs() == [("Cup", "rrt"), ("Cup", "goal_distance")]
    assert [run.seed for run in results.group("Cup", "rrt")] == [1, 3]
    problem = make_distribution("Cup").problem(0)
    for run in results.runs:
        search = guided_search(problem, run.guidance, seed=run.seed, max_samples=60)
        assert run.samples == search.samples
        assert run.solved == search.solved
        assert run.nodes == len(search.tree)
        assert run.total_efficiency == search.total_efficiency
        assert run.best_possible == pytest.approx(search.record.best.sum())
        assert run.best_possible <= run.total_efficiency
        np.testing.assert_allclose(run.curve, search.record.efficiency, rtol=1e-6)
        assert sum(total for total, _ in run.regions.values()) == pytest.approx(run.total_efficiency)
        assert sum(count for _, count in run.regions.values()) == run.samples
        assert run.optimum <= run.path_cost * 1.02 if run.solved else np.isnan(run.path_cost)


def test_seed_k__poses_the_problem_of_seed_k() -> None:
    distribution = make_distribution("RandomSimplePassage")
    first, second = (distribution.problem(seed) for seed in (4, 5))
    assert first.fingerprint != second.fingerprint
    assert distribution.problem(4).fingerprint == first.fingerprint
    run = evaluate("RandomSimplePassage", "goal_distance", seeds=[4], settings=SHORT).runs[0]
    search = guided_search(first, "goal_distance", seed=4, max_samples=60)
    assert run.total_efficiency == search.total_efficiency


def test_second_call__computes_only_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = evaluate("Cup", "rrt", seeds=3, out=tmp_path, settings=SHORT)
    computed: list[int] = []

    def counted(plan: evaluation.Plan, seed: int) -> object:
        if plan.settings.max_samples == SHORT.max_samples:
            computed.append(seed)
        return run_once(plan, seed)

    monkeypatch.setattr(evaluation, "run_once", counted)
    again = evaluate("Cup", "rrt", seeds=3, out=tmp_path, settings=SHORT)
    assert computed == []
    assert [run.seconds for run in again.runs] == [run.seconds for run in first.runs]
    steps: list[tuple[int, int]] = []
    more = evaluate(
        "Cup", "rrt", seeds=5, out=tmp_path, settings=SHORT, progress=lambda *now: steps.append(now)
    )
    assert computed == [3, 4]
    assert [run.seed for run in more.runs] == [0, 1, 2, 3, 4]
    assert steps == [(3, 5), (5, 5)]


def test_rows__are_of_the_problem_that_their_seed_poses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The code of a distribution stays the same, and so does its first problem; what it reads does not."""
    lows = tmp_path / "lows.json"
    lows.write_text("[3.0, 3.5, 4.0]")
    named = {"region": shapely.box(0, 0, 5, 10)}

    class FromFile(ProblemList):
        name = "FromFile"

        def __len__(self) -> int:
            return 3

        def __getitem__(self, index: int) -> Problem:
            wall = Environment((0, 0, 10, 10), (shapely.box(4.5, json.loads(lows.read_text())[index], 5, 8),))
            return Problem(Robot.point(), wall, Task((1, 5), (9, 5)), "Wall", dict(named))

    monkeypatch.setattr(table, "_CATALOGUE", table._CATALOGUE | {"FromFile": FromFile})
    computed: list[int] = []

    def counted(plan: evaluation.Plan, seed: int) -> object:
        if plan.settings.max_samples == SHORT.max_samples:
            computed.append(seed)
        return run_once(plan, seed)

    monkeypatch.setattr(evaluation, "run_once", counted)
    before, same, other, split = [], [], [], []
    for rows, content in ((before, "[3, 3.5, 4]"), (same, "[3, 3.5, 4]"), (other, "[3, 3.5, 2]")):
        lows.write_text(content)
        table.named_distribution.cache_clear()
        rows += evaluate("FromFile", "rrt", seeds=3, out=tmp_path / "out", settings=SHORT).runs
        rows += computed
        computed.clear()
    assert before[3:] == [0, 1, 2]
    assert same[3:] == []
    assert other[3:] == [2]
    assert [figures(run) for run in other[:2]] == [figures(run) for run in before[:2]]
    assert other[2].problem != before[2].problem
    named["region"] = shapely.box(0, 0, 6, 10)  # figures are split by it
    table.named_distribution.cache_clear()
    split += evaluate("FromFile", "rrt", seeds=3, out=tmp_path / "out", settings=SHORT).runs
    assert computed == [0, 1, 2]
    assert [run.samples for run in split] == [run.samples for run in other[:3]]
    table.named_distribution.cache_clear()


@pytest.mark.parametrize(
    "other",
    [
        EvaluationSettings(max_samples=61),
        EvaluationSettings(max_samples=60, step=0.5),
        EvaluationSettings(max_samples=60, expansion="uniform"),
        EvaluationSettings(max_samples=60, target=TargetParameters(delta=0.2)),
    ],
)
def test_settings__that_differ_have_rows_of_their_own(tmp_path: Path, other: EvaluationSettings) -> None:
    evaluate("Cup", "rrt", seeds=1, out=tmp_path, settings=SHORT)
    evaluate("Cup", "rrt", seeds=1, out=tmp_path, settings=other)
    with ResultsFile.in_folder(tmp_path) as file:
        assert file._connection.execute("SELECT count(*) FROM runs").fetchone() == (2,)
        assert file._connection.execute("SELECT count(*) FROM settings").fetchone() == (2,)


def test_workers__change_nothing_but_the_clock() -> None:
    alone, together = (
        evaluate(["Cup", "RandomSimplePassage"], ["rrt", "goal_distance"], seeds=3, workers=n, settings=SHORT)
        for n in (1, 2)
    )
    assert list(map(figures, alone.runs)) == list(map(figures, together.runs))


def test_distributions__are_measured_on_request() -> None:
    plain = evaluate("Cup", "rrt", seeds=2, settings=SHORT)
    whole = evaluate(
        "Cup",
        ["rrt", "goal_distance"],
        seeds=2,
        settings=EvaluationSettings(max_samples=60, distributions=True),
    )
    assert np.isnan(plain.values("Cup", "rrt", "divergence")).all()
    np.testing.assert_array_equal(
        plain.values("Cup", "rrt", "total_efficiency"), whole.values("Cup", "rrt", "total_efficiency")
    )
    # Where P is one-hot, D_KL(P || Q) is the choice's SE; D_JS is at most log 2.
    np.testing.assert_allclose(
        whole.values("Cup", "goal_distance", "divergence"),
        whole.values("Cup", "goal_distance", "efficiency_per_sample"),
        rtol=1e-6,
    )
    assert (whole.values("Cup", "rrt", "jensen_shannon") < np.log(2)).all()
    assert {"divergence", "jensen_shannon"} <= set(summarise(whole)[0].figures)
    assert "divergence" not in summarise(plain)[0].figures


def test_options__are_part_of_a_guidance() -> None:
    spec = GuidanceSpec.parse("rrt@goal_bias=0.5@cell_samples=16")
    assert spec == GuidanceSpec.of("rrt", cell_samples=16, goal_bias=0.5)
    assert spec.label == "rrt@cell_samples=16@goal_bias=0.5"
    results = evaluate("Cup", ["rrt", spec], seeds=2, settings=SHORT)
    assert results.guidances("Cup") == ["rrt", spec.label]
    assert (
        results.values("Cup", "rrt", "nodes").tolist() != results.values("Cup", spec.label, "nodes").tolist()
    )


def test_regions__the_first_that_holds_a_node_counts() -> None:
    problem = make_distribution("Cup").problem(0)
    result = guided_search(problem, "rrt", seed=0, max_samples=60)
    everywhere, left = shapely.box(0, 0, 10, 10), shapely.box(0, 0, 2, 10)
    # A problem without regions has one, and what lies outside all regions has its own.
    object.__setattr__(problem, "regions", {})
    assert set(region_sums(problem, result)) == {ELSEWHERE}
    object.__setattr__(problem, "regions", {"left": left, "all": everywhere})
    sums = region_sums(problem, result)
    at = result.tree.configurations[result.record.selected, 0]
    assert sums["left"][1] == (at <= 2).sum()
    assert sums["left"][1] + sums["all"][1] == result.samples
    named_distribution.cache_clear()


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"environments": "TrapCop"}, UnknownNameError, "did you mean 'TrapCup'"),
        ({"guidances": "lazyprm"}, UnknownNameError, "did you mean 'lazy_prm'"),
        ({"guidances": "rrt@goal_bais=0.1"}, UnknownNameError, "did you mean 'goal_bias'"),
        ({"guidances": "rrt@goal_bias"}, InvalidInputError, "name@option=value"),
        (
            {"guidances": ["rrt", GuidanceSpec.of("rrt", label="rrt", goal_bias=0.1)]},
            InvalidInputError,
            "labels",
        ),
        ({"guidances": "path_database"}, InvalidInputError, "database"),
        ({"guidances": []}, InvalidInputError, "at least one"),
        ({"seeds": 0}, InvalidInputError, "seeds"),
        ({"seeds": [-1]}, InvalidInputError, "seeds"),
        ({"workers": 0}, InvalidInputError, "workers"),
        ({"database": "no/such.sqlite"}, StorageError, "no such file"),
        ({"imports": ["no_such_module_at_all"]}, InvalidInputError, "cannot import"),
        ({"settings": EvaluationSettings(expansion="uniformly")}, UnknownNameError, "uniformly"),
    ],
)
def test_bad_input__is_refused_before_anything_is_written(
    tmp_path: Path, arguments: dict[str, object], error: type[Exception], message: str
) -> None:
    call = {"environments": "Cup", "guidances": "rrt", "seeds": 1, "settings": SHORT} | arguments
    with pytest.raises(error, match=message):
        evaluate(out=tmp_path / "out", **call)  # type: ignore[arg-type]
    if message != "workers":
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "setting",
    [{"max_samples": 0}, {"step": 0.0}, {"candidates": 0}, {"goal_tolerance": -1.0}, {"goal_edge": False}],
)
def test_settings__out_of_range(setting: dict[str, float]) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(setting))):
        EvaluationSettings(**setting)  # type: ignore[arg-type]


def test_corrupt_file__is_refused_and_left_alone(tmp_path: Path) -> None:
    (tmp_path / RESULTS_FILE).write_bytes(b"not a database" * 100)
    with pytest.raises(StorageError, match="results file"):
        evaluate("Cup", "rrt", seeds=1, out=tmp_path, settings=SHORT)
    assert (tmp_path / RESULTS_FILE).read_bytes() == b"not a database" * 100


@pytest.mark.parametrize(
    "error", [UnknownNameError("guidance", "x", ["y"]), NoPathError("a"), StorageError("b")]
)
def test_errors__come_back_whole_from_a_worker(error: Exception) -> None:
    import pickle

    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error)
    assert str(copy) == str(error)


LONG = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # whoever runs the tests may ignore it
from guided_gym.train.cli import main
if __name__ == "__main__":
    main()
"""


def start(folder: Path, seeds: int) -> subprocess.Popen[str]:
    arguments = ["evaluate", "--env", "Cup", "--guidance", "rrt", "--seeds", str(seeds), "--workers", "2"]
    return subprocess.Popen(
        [sys.executable, "-c", LONG, *arguments, "--out", str(folder), "--no-figures"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for_runs(folder: Path, process: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and process.poll() is None:
        if (folder / RESULTS_FILE).exists() and stored(folder):
            return
        time.sleep(0.02)
    raise AssertionError("no run was stored while the evaluation ran")


def stored(folder: Path) -> dict[int, float]:
    import sqlite3

    connection = sqlite3.connect(folder / RESULTS_FILE, timeout=30)
    try:
        return dict(connection.execute("SELECT seed, seconds FROM runs"))
    except sqlite3.OperationalError:  # not made yet
        return {}
    finally:
        connection.close()


def resumed(folder: Path, seeds: int, before: dict[int, float]) -> Results:
    results = evaluate("Cup", "rrt", seeds=seeds, out=folder)
    assert [run.seed for run in results.runs] == list(range(seeds))
    assert {run.seed: run.seconds for run in results.runs if run.seed in before} == before
    return results


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_kill__loses_nothing_that_was_stored(tmp_path: Path) -> None:
    process = start(tmp_path, 120)
    wait_for_runs(tmp_path, process)
    os.kill(process.pid, signal.SIGKILL)
    process.communicate(timeout=60)
    before = stored(tmp_path)
    assert 0 < len(before) < 120
    resumed(tmp_path, 120, before)


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_interrupt__keeps_what_is_done_and_says_how_to_go_on(tmp_path: Path) -> None:
    process = start(tmp_path, 120)
    wait_for_runs(tmp_path, process)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "The same command goes on from there" in errors
    assert "Traceback" not in errors
    assert 0 < len(stored(tmp_path)) < 120


class Blemished(ProblemList):
    """Of four problems, the first starts in collision and the third has no path."""

    name = "Blemished"
    summary = "Two of four are no use."

    def __len__(self) -> int:
        return 4

    def __getitem__(self, index: int) -> Problem:
        walls = [shapely.box(1.5, -0.1, 2.5, 4.1 if index == 2 else 3.0)]
        start = (2.0, 1.0) if index == 0 else (1.0, 1.0)
        return Problem(
            Robot.point(), Environment((0, 0, 4, 4), tuple(walls)), Task(start, (3, 1)), "Blemished"
        )


def test_problems_that_are_no_use__are_skipped_counted_and_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table, "_CATALOGUE", dict(table._CATALOGUE))  # gone after this test
    register_distribution("Blemished", Blemished, replace=True)
    for _ in range(2):  # the second time, from the file
        results = evaluate("Blemished", ["rrt", "goal_distance"], seeds=4, settings=SHORT, out=tmp_path)
        assert [(run.guidance, run.seed) for run in results.runs] == [
            ("rrt", 1), ("rrt", 3), ("goal_distance", 1), ("goal_distance", 3)
        ]  # fmt: skip
        assert list(results.skipped["Blemished"]) == [0, 2]
        assert "in collision" in results.skipped["Blemished"][0]
        assert "path" in results.skipped["Blemished"][2]
    with pytest.raises(InvalidInputError, match="in collision"):  # nothing is left
        evaluate("Blemished", "rrt", seeds=[0, 2], settings=SHORT, out=tmp_path / "none")
    assert not (tmp_path / "none").exists()


def test_runs__say_what_they_cost_and_where(tmp_path: Path) -> None:
    results = evaluate("Cup", ["rrt", "lazy_prm", "oracle"], seeds=2, settings=SHORT)
    for run in results.runs:
        assert run.excess_efficiency == pytest.approx(run.total_efficiency - run.best_possible)
        assert run.best.shape == run.cells.shape == run.curve.shape == (run.samples,)
        assert run.best.sum() == pytest.approx(run.best_possible, rel=1e-5)
        assert run.processor >= 0
        assert 0 < run.entropy <= np.log(run.samples)
        assert run.cells.max() < 24 * 24
    assert (results.values("Cup", "rrt", "looks") == 0).all()
    assert (results.values("Cup", "oracle", "looks") > 0).all()
    total, excess = results.by_cell("Cup", "rrt", (24, 24))
    assert total.sum() == pytest.approx(results.values("Cup", "rrt", "total_efficiency").mean(), rel=1e-5)
    assert excess.sum() == pytest.approx(results.values("Cup", "rrt", "excess_efficiency").mean(), rel=1e-5)


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX signals")
def test_sigterm__ends_as_an_interrupt_does_and_leaves_nothing(tmp_path: Path) -> None:
    process = start(tmp_path, 120)
    wait_for_runs(tmp_path, process)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 143
    assert "The same command goes on from there" in errors
    assert "leaked" not in errors
    assert "Traceback" not in errors


ASKED = ["evaluate", "--env", "Cup", "--guidance", "rrt", "--seeds", "2", "--workers", "1"]
ASKED += ["--max-samples", str(SHORT.max_samples), "--out"]


@pytest.fixture
def sealed() -> Iterator[Path]:
    """A folder with results that nobody here may write to, root neither."""
    folder = Path(tempfile.mkdtemp())
    done = CliRunner().invoke(app, [*ASKED, str(folder), "--no-figures"])  # imports what another user may not
    assert done.exit_code == 0, done.output
    files = [folder, *folder.iterdir()]
    for file in files:
        file.chmod(0o555 if file.is_dir() else 0o444)
    root = hasattr(os, "geteuid") and os.geteuid() == 0
    if root:
        os.seteuid(65534)
    try:
        if os.access(folder, os.W_OK, effective_ids=os.access in os.supports_effective_ids):
            pytest.skip("needs a folder that cannot be written")
        yield folder
    finally:
        if root:
            os.seteuid(0)
        folder.chmod(0o755)
        shutil.rmtree(folder)


def test_read_only_folder__that_holds_all_results_gives_them(sealed: Path) -> None:
    assert [run.seed for run in evaluate("Cup", "rrt", seeds=2, out=sealed, settings=SHORT).runs] == [0, 1]
    with pytest.raises(StorageError, match="cannot open the guided-gym results file"):
        evaluate("Cup", "rrt", seeds=3, out=sealed, settings=SHORT)


def test_read_only_folder__the_command_prints_the_table(sealed: Path) -> None:
    done = CliRunner().invoke(app, [*ASKED, str(sealed)])
    assert done.exit_code == 0, done.output
    assert "rrt" in done.output
    assert "cannot be written" in done.output


def test_a_damaged_schema_is_one_clear_error(tmp_path: Path) -> None:
    evaluate("Cup", "rrt", seeds=1, out=tmp_path, settings=SHORT)
    file = tmp_path / RESULTS_FILE
    damaged = bytearray(file.read_bytes())
    damaged[damaged.find(b"skipped")] = 0xFF
    file.write_bytes(damaged)
    with pytest.raises(StorageError, match="expected a sound, accessible guided-gym results file"):
        evaluate("Cup", "rrt", seeds=1, out=tmp_path, settings=SHORT)
