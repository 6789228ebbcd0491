"""The pool of problems: the same ones in the same order, ready before anyone asks, nobody left behind."""

from __future__ import annotations

import importlib
import itertools
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import textwrap
import time

import gymnasium
import pytest

from guided_gym import ProblemPool, make_distribution
from guided_gym.catalogue.distributions import SampledProblems
from guided_gym.errors import GuidedGymError, InvalidInputError, NoPathError, UnknownNameError
from guided_gym.measure import oracle

NAME = "RandomSimplePassage"
DISTRIBUTION = make_distribution(NAME)


def prints(problems):
    return [problem.fingerprint for problem in problems]


def wait_until(condition):
    for _ in range(600):
        if condition():
            return
        time.sleep(0.05)
    raise AssertionError("waited in vain")


# A module of its own: a spawned worker could not import a test from another folder.
HALF_BLOCKED = f"""
from guided_gym import make_distribution
from guided_gym.errors import NoPathError

def draw(rng):
    if rng.integers(2):
        raise NoPathError("no way")
    return make_distribution({NAME!r}).problem(1)
"""


@pytest.fixture
def counted(monkeypatch):
    """Seeds that are prepared in this process."""
    asked = []

    def problem(seed, *ending):
        asked.append(seed)
        return original(seed, *ending)

    original = DISTRIBUTION.problem
    monkeypatch.setattr(DISTRIBUTION, "problem", problem)
    return asked


def test_without_workers__prepares_what_is_asked_for(counted):
    with ProblemPool(NAME, seeds=[4, 2, 9], workers=0) as pool:
        assert pool.name == NAME and pool.ready == 0 and counted == []
        first = pool.take()
        assert counted == [4] and pool.taken == 1
        assert first.fingerprint == DISTRIBUTION.problem(4).fingerprint
        assert len(list(pool)) == 2
        with pytest.raises(GuidedGymError, match="all 3 problems are taken"):
            pool.take()
    with pytest.raises(GuidedGymError, match="closed"):
        pool.take()


def test_workers__give_the_same_problems_in_order_and_stay_ahead(monkeypatch):
    expected = [DISTRIBUTION.problem(seed) for seed in range(7)]
    with ProblemPool(NAME, seeds=range(7), workers=2, ahead=4) as pool:
        wait_until(lambda: pool.ready == 4)  # and no more: nobody has taken any
        monkeypatch.setattr("guided_gym.measure.grid._solved", None)  # nothing is solved in this process
        oracle._remembered.clear()
        first = pool.take()
        assert oracle.oracle_for(first.space, first.task.goal, start=first.task.start)
        assert not first.space.weights.flags.writeable  # as in any problem: kernels compile once
        wait_until(lambda: pool.ready == 4)
        assert prints([first, *pool]) == prints(expected)
        assert pool.taken == 7 and pool.ready == 0
    wait_until(lambda: not multiprocessing.active_children())


def test_an_environment__takes_its_problems_from_a_pool():
    with ProblemPool(f"{NAME}@train", seeds=range(3, 9), workers=0) as pool:
        env = gymnasium.make(f"guided_gym/{NAME}-v0", distribution=pool)
        for k in (3, 4, 5):
            env.reset(seed=0)
            expected = make_distribution(f"{NAME}@train").problem(k)
            assert env.unwrapped.problem.fingerprint == expected.fingerprint


def test_errors_of_a_problem__are_passed_on_and_the_next_one_follows(tmp_path, monkeypatch):
    (tmp_path / "half_blocked.py").write_text(HALF_BLOCKED)
    monkeypatch.syspath_prepend(str(tmp_path))
    distribution = SampledProblems("Half", importlib.import_module("half_blocked").draw)
    outcomes = []
    for workers in (0, 1):
        with ProblemPool(distribution, workers=workers) as pool:
            outcome = []
            for _ in range(6):
                try:
                    outcome.append(pool.take().name)
                except NoPathError as error:
                    outcome.append(str(error))
            outcomes.append(outcome)
    assert outcomes[0] == outcomes[1] and set(outcomes[0]) == {"no way", NAME}


def test_a_worker_that_dies__is_a_clear_error():
    pool = ProblemPool(NAME, workers=1, ahead=2)
    wait_until(lambda: pool.ready == 2)
    for process in multiprocessing.active_children():
        os.kill(process.pid, signal.SIGKILL)
    with pytest.raises(GuidedGymError, match="one died"):
        for _ in range(4):
            pool.take()
    with pytest.raises(GuidedGymError, match="closed"):
        pool.take()
    pool.close()
    wait_until(lambda: not multiprocessing.active_children())


PROGRAM = """
    import multiprocessing, time
    from guided_gym import ProblemPool

    if __name__ == "__main__":
        with ProblemPool("RandomSimplePassage", workers=2, ahead=6) as pool:
            pool.take()
            print(*(process.pid for process in multiprocessing.active_children()), flush=True)
            {then}
"""


def running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.parametrize("kill", [signal.SIGINT, signal.SIGKILL])
def test_no_worker_outlives_its_program(tmp_path, kill):
    file = tmp_path / "program.py"
    file.write_text(textwrap.dedent(PROGRAM.format(then="time.sleep(60)")))
    with subprocess.Popen([sys.executable, file], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as program:
        workers = [int(pid) for pid in program.stdout.readline().split()]
        assert len(workers) == 2
        program.send_signal(kill)
        _, errors = program.communicate(timeout=30)
    assert program.returncode != 0
    if kill == signal.SIGINT:
        assert errors.decode().count("Traceback") == 1  # ours, KeyboardInterrupt; none of the workers
    wait_until(lambda: not any(map(running, workers)))


def test_a_pool_that_nobody_closed__does_not_keep_the_program(tmp_path):
    file = tmp_path / "program.py"
    file.write_text(
        textwrap.dedent("""
        from guided_gym import ProblemPool
        if __name__ == "__main__":
            pool = ProblemPool("RandomSimplePassage", workers=1, ahead=3)
            print(pool.take().name)
        """)
    )
    done = subprocess.run([sys.executable, file], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == [NAME] and done.stderr == ""


@pytest.mark.parametrize("options", [{"workers": -1}, {"ahead": 0}, {"workers": 1.5}, {"ahead": True}])
def test_refuses_impossible_numbers(options):
    with pytest.raises(InvalidInputError, match=next(iter(options))):
        ProblemPool(NAME, **options)


def test_refuses_what_it_cannot_send():
    with pytest.raises(UnknownNameError, match="did you mean"):
        ProblemPool("RandomMazes")
    with pytest.raises(InvalidInputError, match="top level"):
        ProblemPool(SampledProblems("Local", lambda rng: DISTRIBUTION.problem(0)))
    pool = ProblemPool(NAME, itertools.count(), workers=0)
    with pytest.raises(InvalidInputError, match="stay in its process"):
        pickle.dumps(pool)
