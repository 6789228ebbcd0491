"""Worker processes: every result once, clear errors, nobody left behind."""

from __future__ import annotations

import math
import multiprocessing
import operator
import os
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest

from guided_gym.compute.workers import map_tasks, worker_pool
from guided_gym.errors import GuidedGymError, InvalidInputError


def test_one_worker__works_here_and_in_order() -> None:
    seen: list[str] = []
    results = list(map_tasks(lambda task: (task, os.getpid()), range(3), 1, lambda: seen.append("prepared")))
    assert results == [(0, os.getpid()), (1, os.getpid()), (2, os.getpid())]
    assert seen == ["prepared"]


def test_workers__give_every_result_once_and_serve_several_maps() -> None:
    with worker_pool(2) as run:
        assert sorted(run(math.factorial, range(20))) == [math.factorial(n) for n in range(20)]
        assert sorted(run(partial(operator.add, 1), range(3))) == [1, 2, 3]
        assert list(run(math.factorial, [])) == []
    assert multiprocessing.active_children() == []


def test_workers__pass_errors_on_and_stop() -> None:
    with pytest.raises(ValueError, match="negative"):
        list(map_tasks(math.factorial, [1, -1, 2], 2))
    for process in multiprocessing.active_children():
        process.join(10)
    assert multiprocessing.active_children() == []


def test_workers__say_when_one_dies() -> None:
    with pytest.raises(GuidedGymError, match="one died"):
        list(map_tasks(os._exit, [9], 2))


def test_workers__refuse_what_they_cannot_run() -> None:
    with pytest.raises(InvalidInputError, match="workers: expected an integer, at least 1, got 0"):
        list(map_tasks(abs, [1], 0))
    with pytest.raises(InvalidInputError, match="top level"):
        list(map_tasks(lambda task: task, [1], 2))
    with pytest.raises(InvalidInputError, match="top level"):
        list(map_tasks(abs, [1], 2, prepare=lambda: None))


def test_names__that_workers_do_not_know_come_with_what_to_do(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "from guided_gym import EvaluationSettings, FixedProblem, evaluate, make_distribution\n"
        "from guided_gym import register_distribution, register_guidance\n"
        "from guided_gym.guidance.cells import Uninformed\n"
        "if __name__ == '__main__':\n"
        "    @register_guidance\n"
        "    class Mine(Uninformed):\n"
        "        name = 'mine'\n"
        "    problem = make_distribution('Cup').problem(0)\n"
        "    register_distribution('Own', lambda: FixedProblem(problem))\n"
        "    for names in (('Cup', 'mine'), ('Own', 'rrt')):\n"
        "        try:\n"
        "            evaluate(*names, seeds=2, workers=2, settings=EvaluationSettings(max_samples=9))\n"
        "        except ValueError as error:\n"
        "            print(error)\n"
    )
    run = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)
    lines = run.stdout.splitlines()
    for line, name in zip(lines, ("guidance 'mine'", "environment 'Own'"), strict=True):
        assert line.startswith(f"{name}: expected a name that the worker processes know")
        assert "--import" in line and "imports=[...]" in line
