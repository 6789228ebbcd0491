"""Ray's executor: the same results as here, and nothing lost when a node is."""

from __future__ import annotations

import importlib
import math
import socket
import sys
from functools import partial

import pytest

from guided_gym.compute import on_ray
from guided_gym.compute.on_ray import OnRay
from guided_gym.compute.workers import Local, executor_of, map_tasks, worker_pool
from guided_gym.errors import GuidedGymError, InvalidInputError
from guided_gym.train.evaluation import evaluate
from guided_gym.train.specs import EvaluationSettings

try:
    from ray.cluster_utils import Cluster
except ImportError:
    Cluster = None

needs_ray = pytest.mark.skipif(Cluster is None, reason="needs guided-gym[ray]")
pytestmark = pytest.mark.filterwarnings("ignore")  # Ray's own


WORK = """
import os, pathlib, time
from guided_gym.compute.workers import in_worker
from guided_gym.errors import UnknownNameError

def noted(folder, task):
    "Leave a mark for each time that a task is done."
    (pathlib.Path(folder) / f"{task}-{os.getpid()}-{time.monotonic_ns()}").touch()
    time.sleep(0.1)
    return task, in_worker()

def unknown(task):
    raise UnknownNameError("guidance", "rtt", ["rrt"])
"""


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("modules")
    (folder / "work_on_ray.py").write_text(WORK)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))  # here
        patch.setenv("PYTHONPATH", str(folder))  # on the nodes
        yield from _cluster()


def _cluster():
    made = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    yield made
    made.shutdown()


@needs_ray
def test_on_ray__gives_every_result_once_and_raises_what_workers_raise(cluster) -> None:
    with worker_pool(OnRay(cluster.address)) as run:
        assert sorted(run(math.factorial, range(20))) == [math.factorial(n) for n in range(20)]
        with pytest.raises(ValueError, match="negative"):
            list(run(math.factorial, [1, -1, 2]))
        with pytest.raises(InvalidInputError, match="--import"):
            list(run(importlib.import_module("work_on_ray").unknown, [0]))
        with pytest.raises(InvalidInputError, match="top level"):
            list(run(lambda task: task, [0]))


@needs_ray
def test_on_ray__a_node_that_dies_loses_nothing_and_what_was_done_is_not_done_again(
    cluster, tmp_path
) -> None:
    node = cluster.add_node(num_cpus=1)
    cluster.wait_for_nodes()
    finished: dict[int, int] = {}
    work = partial(importlib.import_module("work_on_ray").noted, tmp_path)
    for task, there in map_tasks(work, range(24), OnRay(cluster.address)):
        assert there and task not in finished
        finished[task] = len(list(tmp_path.glob(f"{task}-*")))
        if len(finished) == 6:
            cluster.remove_node(node, allow_graceful=False)
    assert sorted(finished) == list(range(24))
    again = [task for task in finished if len(list(tmp_path.glob(f"{task}-*"))) > finished[task]]
    assert again == []


@needs_ray
def test_on_ray__tables_are_those_of_this_process_and_a_stop_goes_on(cluster, tmp_path) -> None:
    asked = {"seeds": 4, "settings": EvaluationSettings(max_samples=40)}
    here = evaluate("SimplePassage", ["rrt", "goal_distance"], **asked)

    def stop(done: int, total: int) -> None:
        if done >= 4:
            raise KeyboardInterrupt

    there = OnRay(cluster.address)
    with pytest.raises(KeyboardInterrupt):
        evaluate(
            "SimplePassage", ["rrt", "goal_distance"], workers=there, out=tmp_path, progress=stop, **asked
        )
    seen: list[int] = []
    results = evaluate(
        "SimplePassage", ["rrt", "goal_distance"], workers=there, out=tmp_path,
        progress=lambda done, total: seen.append(done), **asked,
    )  # fmt: skip
    assert seen[0] >= 4
    for ours, theirs in zip(here.runs, results.runs, strict=True):
        assert (ours.seed, ours.guidance, ours.problem) == (theirs.seed, theirs.guidance, theirs.problem)
        assert (
            ours.curve.tobytes() == theirs.curve.tobytes()
            and ours.total_efficiency == theirs.total_efficiency
        )


@needs_ray
def test_on_ray__refuses_a_node_with_another_version(cluster, monkeypatch) -> None:
    monkeypatch.setattr(on_ray, "fingerprint", lambda: ("0.0.9", "an older one"))
    with pytest.raises(GuidedGymError, match=r"expected guided-gym 0\.0\.9 .* has guided-gym"):
        list(map_tasks(abs, [1], OnRay(cluster.address)))


@needs_ray
def test_on_ray__says_when_nobody_answers() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
    with pytest.raises(GuidedGymError, match="nobody answers"):
        list(map_tasks(abs, [1], OnRay(f"127.0.0.1:{port}")))
    for address in ("", ":6379", "host:port"):
        with pytest.raises(InvalidInputError, match="HOST:PORT"):
            list(map_tasks(abs, [1], OnRay(address)))


def test_on_ray__says_when_ray_is_not_installed(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(GuidedGymError, match=r"guided-gym\[ray\]"):
        list(map_tasks(abs, [1], OnRay()))
    with pytest.raises(InvalidInputError, match="workers"):
        OnRay(workers=0)


def test_executor_of__takes_numbers_and_executors() -> None:
    assert executor_of(3) == Local(3) and not Local(3).alone and Local(1).alone
    assert executor_of(OnRay()) == OnRay()
    for wrong in (0, -1, 1.5, "2", None, object()):
        with pytest.raises(InvalidInputError, match="workers"):
            executor_of(wrong)  # type: ignore[arg-type]
