"""Building a database: repeatable, resumable, stoppable."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from guided_gym.errors import GuidedGymError, InvalidInputError
from guided_gym.storage.path_build import BuildReport, build_database
from guided_gym.storage.path_file import DatabaseHeader, PathDatabase

HEADER = DatabaseHeader.of("demo", "point", [1.0, 1.0], [0.0, 0.0])
SOLVERS = """
    import os, time
    import numpy as np

    def solve(seed):
        if seed % 3 == 1:
            return None
        return np.random.default_rng(seed).uniform(size=(2 + seed % 5, 2))

    def slow(seed):
        time.sleep(0.05)
        return solve(seed)

    def dies(seed):
        if seed == 5:
            os._exit(9)
        return solve(seed)

    def fails(seed):
        if seed == 5:
            raise ZeroDivisionError("seed 5")
        return solve(seed)

    def wrong(seed):
        return [[0.0, 0.0, 0.0]] if seed == 5 else solve(seed)

    def hopeless(seed):
        return None
"""


@pytest.fixture
def solvers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A module that worker processes can import, which this file is not under every import mode."""
    (tmp_path / "demo_solvers.py").write_text(textwrap.dedent(SOLVERS))
    monkeypatch.syspath_prepend(tmp_path)
    sys.modules.pop("demo_solvers", None)
    import demo_solvers

    return demo_solvers


def content(file: Path) -> dict[int, list]:
    with PathDatabase.open(file) as database:
        database.verify()
        return dict(zip(database.seeds(), (path.tolist() for path in database.paths()), strict=True))


def test_build__stores_the_first_solvable_problems(tmp_path: Path, solvers: ModuleType) -> None:
    seen: list[tuple[int, int]] = []
    report = build_database(
        tmp_path / "x.db", HEADER, solvers.solve, 10, progress=lambda done, total: seen.append((done, total))
    )
    assert report == BuildReport(paths=10, solved=10, unsolved=5)
    expected = [seed for seed in range(15) if seed % 3 != 1]
    assert content(tmp_path / "x.db") == {seed: solvers.solve(seed).tolist() for seed in expected}
    assert seen[0] == (0, 10)
    assert seen[-1] == (10, 10)
    again = build_database(tmp_path / "x.db", HEADER, solvers.dies, 10)
    assert again == BuildReport(paths=10, solved=0, unsolved=0)


def test_build__grows_a_database(tmp_path: Path, solvers: ModuleType) -> None:
    build_database(tmp_path / "x.db", HEADER, solvers.solve, 4)
    build_database(tmp_path / "x.db", HEADER, solvers.solve, 9)
    build_database(tmp_path / "y.db", HEADER, solvers.solve, 9)
    assert content(tmp_path / "x.db") == content(tmp_path / "y.db")


def test_build__workers_give_the_same_content(tmp_path: Path, solvers: ModuleType) -> None:
    build_database(tmp_path / "one.db", HEADER, solvers.solve, 20)
    report = build_database(tmp_path / "two.db", HEADER, solvers.solve, 20, workers=2)
    assert report.paths == 20
    assert content(tmp_path / "one.db") == content(tmp_path / "two.db")


@pytest.mark.parametrize("name", ["fails", "wrong"])
def test_build__keeps_what_was_solved_before_an_error(tmp_path: Path, solvers: ModuleType, name: str) -> None:
    error = {"fails": ZeroDivisionError, "wrong": InvalidInputError}[name]
    with pytest.raises(error, match=r"5|shape"):
        build_database(tmp_path / "x.db", HEADER, getattr(solvers, name), 10)
    assert list(content(tmp_path / "x.db")) == [0, 2, 3]
    assert build_database(tmp_path / "x.db", HEADER, solvers.solve, 10).solved == 7


def test_build__says_so_when_a_worker_dies(tmp_path: Path, solvers: ModuleType) -> None:
    with pytest.raises(GuidedGymError, match="worker processes to live"):
        build_database(tmp_path / "x.db", HEADER, solvers.dies, 10, workers=2)
    assert build_database(tmp_path / "x.db", HEADER, solvers.solve, 10).paths == 10


def test_build__gives_up_on_hopeless_distributions(tmp_path: Path, solvers: ModuleType) -> None:
    with pytest.raises(GuidedGymError, match="unsolved problems"):
        build_database(tmp_path / "x.db", HEADER, solvers.hopeless, 10)


def test_build__refuses_bad_arguments(tmp_path: Path, solvers: ModuleType) -> None:
    file = tmp_path / "x.db"
    with pytest.raises(InvalidInputError, match="workers: expected an integer, at least 1"):
        build_database(file, HEADER, solvers.solve, 1, workers=0)
    with pytest.raises(InvalidInputError, match="top level"):
        build_database(file, HEADER, lambda seed: None, 1, workers=2)
    build_database(file, HEADER, solvers.solve, 1)
    other = DatabaseHeader.of("demo", "disc", [1.0, 1.0], [0.0, 0.0])
    with pytest.raises(InvalidInputError, match="another robot"):
        build_database(file, other, solvers.solve, 2)


PROGRAM = """
    import sys
    from demo_solvers import slow
    from guided_gym.storage.path_file import DatabaseHeader
    from guided_gym.storage.path_build import build_database

    if __name__ == "__main__":
        header = DatabaseHeader.of("demo", "point", [1.0, 1.0], [0.0, 0.0])
        report = lambda done, total: print(done, flush=True)
        try:
            build_database(sys.argv[1], header, slow, 5000, workers=int(sys.argv[2]), progress=report)
        except KeyboardInterrupt:
            print("interrupted", flush=True)
"""


def _interrupt(process: subprocess.Popen[str]) -> None:
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to the workers too


def _kill(process: subprocess.Popen[str]) -> None:
    os.killpg(process.pid, signal.SIGKILL)


def _kill_parent(process: subprocess.Popen[str]) -> None:
    process.kill()


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("stop", [_interrupt, _kill, _kill_parent])
def test_build__stopped_keeps_what_is_done_and_resumes(
    tmp_path: Path, solvers: ModuleType, stop: Callable[[subprocess.Popen[str]], None], workers: int
) -> None:
    (tmp_path / "program.py").write_text(textwrap.dedent(PROGRAM))
    command = [sys.executable, str(tmp_path / "program.py"), str(tmp_path / "x.db"), str(workers)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        done = 0
        while done < 5:
            done = int(process.stdout.readline())
        stopped = time.monotonic()
        stop(process)
        output, errors = process.communicate(timeout=60)  # ends when the workers, who share the pipe, have
    if stop is _interrupt:
        assert output.endswith("interrupted\n"), errors
        assert "Traceback" not in errors
        assert time.monotonic() - stopped < 20  # it did not go on to solve all 5,000
    stored = content(tmp_path / "x.db")
    assert len(stored) >= done
    assert stored == {seed: np.asarray(solvers.solve(seed)).tolist() for seed in stored}
    goal = len(stored) + 3
    build_database(tmp_path / "x.db", HEADER, solvers.solve, goal)
    build_database(tmp_path / "y.db", HEADER, solvers.solve, goal)
    assert content(tmp_path / "y.db").items() <= content(tmp_path / "x.db").items()
