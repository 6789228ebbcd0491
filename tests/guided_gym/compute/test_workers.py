"""Worker processes: every result once, clear errors, nobody left behind."""

from __future__ import annotations

import math
import multiprocessing
import operator
import os
from functools import partial

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
