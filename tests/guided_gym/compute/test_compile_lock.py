"""Processes that find no compiled kernels: each kernel is compiled once, by one of them."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from numba import njit
from numba.core import config, event

from guided_gym.compute import compile_lock, shipped_kernels

PROGRAM = """
import sys
import numpy as np
from numba.core import event
from guided_gym.kernels.metric import interpolate

class Count(event.Listener):
    compiled = 0
    def on_start(self, event): pass
    def on_end(self, event):  # numba's own functions are kept nowhere
        Count.compiled += event.data["dispatcher"].py_func.__module__.startswith("guided_gym.")

sys.stdin.readline()  # all start together
event.register("numba:compile", Count())
metric = (np.ones(3), np.zeros(3))
print(interpolate(np.zeros(3), np.ones(3), 0.5, metric).tolist(), Count.compiled)
"""


@pytest.mark.skipif(compile_lock.locks is None, reason="no file locks here")
@pytest.mark.skipif(
    (shipped_kernels.KERNELS / shipped_kernels.ARCHIVE).exists(),
    reason="this wheel brings its kernels compiled",
)
def test_each_kernel_is_compiled_by_one_of_many_processes(tmp_path):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            text=True,
        )
        for _ in range(4)
    ]
    for process in processes:
        process.stdin.write("\n")
        process.stdin.flush()
    said = [process.communicate(timeout=200)[0].rsplit(" ", 1) for process in processes]
    assert [values for values, _ in said] == ["[0.5, 0.5, 0.5]"] * 4
    assert sum(int(count) for _, count in said) == 3  # interpolate, placed, shortest


@pytest.fixture
def lock():
    lock = compile_lock.CompileLock()
    yield lock
    while lock._depth:
        lock.done()


@pytest.mark.skipif(compile_lock.locks is None, reason="no file locks here")
def test_the_lock_is_held_from_the_outermost_miss_until_it_is_done(lock, tmp_path):
    other = compile_lock.CompileLock()

    def free():
        file = os.open(tmp_path / compile_lock.NAME, os.O_CREAT | os.O_RDWR)
        try:
            compile_lock.locks.flock(file, compile_lock.locks.LOCK_EX | compile_lock.locks.LOCK_NB)
        except BlockingIOError:
            return False
        finally:
            os.close(file)
        return True

    assert free()
    lock.miss(str(tmp_path))
    lock.miss(str(tmp_path))
    lock.done()
    assert not free()
    lock.on_end(ended("guided_gym.kernels.x", failed=True))
    assert free()
    other.miss(str(tmp_path))
    other.on_end(ended("theirs", failed=True))
    other.on_end(ended("guided_gym.kernels.x", failed=False))
    assert not free()
    other.done()
    assert free()


def ended(module, failed):
    data = {"dispatcher": SimpleNamespace(py_func=SimpleNamespace(__module__=module))}
    details = (TypeError, TypeError(), None) if failed else (None, None, None)
    return event.Event("numba:compile", event.EventStatus.END, data, details)


def test_a_folder_that_cannot_be_written_is_no_obstacle(lock, tmp_path):
    (tmp_path / "file").write_text("")
    lock.miss(str(tmp_path / "file" / "below"))
    lock.done()


def test_numba_s_setting_is_another_only_while_kernels_compile(lock, tmp_path, monkeypatch):
    monkeypatch.setattr(config, "LOOP_VECTORIZE", 7)
    lock.miss(str(tmp_path))
    lock.miss(str(tmp_path))
    lock.done()
    assert config.LOOP_VECTORIZE == 0
    lock.done()
    assert config.LOOP_VECTORIZE == 7


def test_numba_s_setting_holds_for_a_marked_kernel_only(lock, tmp_path, monkeypatch):
    monkeypatch.setattr(config, "LOOP_VECTORIZE", 7)
    lock.miss(str(tmp_path))
    lock.miss(str(tmp_path), vectorise=True)
    assert config.LOOP_VECTORIZE == 7
    lock.miss(str(tmp_path))
    assert config.LOOP_VECTORIZE == 0
    lock.done()
    assert config.LOOP_VECTORIZE == 7
    lock.done()
    assert config.LOOP_VECTORIZE == 0
    lock.done()
    assert config.LOOP_VECTORIZE == 7


def test_a_marked_kernel_asks_for_it(monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(
        compile_lock.CompileLock, "miss", lambda self, folder, vectorise: asked.append(vectorise)
    )
    monkeypatch.setattr(compile_lock.CompileLock, "done", lambda self: None)
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    kernel = compile_lock.vectorised(lambda x: x + 1)
    kernel.__module__ = "guided_gym.kernels.none"
    njit(cache=True)(kernel)(1)
    assert asked == [True]


def test_garbage_is_not_looked_for_while_kernels_compile_and_as_before_after(lock, tmp_path):
    assert gc.isenabled()
    lock.miss(str(tmp_path))
    assert not gc.isenabled()
    lock.done()
    assert gc.isenabled()
    gc.disable()
    try:
        lock.miss(str(tmp_path))
        lock.done()
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_what_is_kept_is_told_apart_by_the_sources_of_all_kernels(tmp_path):
    (tmp_path / "a.py").write_text("one")
    (tmp_path / "b.py").write_text("two")
    first = shipped_kernels.sources_stamp(tmp_path)
    assert shipped_kernels.sources_stamp(tmp_path) == first
    (tmp_path / "b.py").write_text("2")
    assert shipped_kernels.sources_stamp(tmp_path) != first


def test_the_stamp_is_part_of_the_key_of_our_kernels_alone():
    from guided_gym.kernels.metric import separation

    stamp = shipped_kernels.sources_stamp(Path(compile_lock.__file__).parents[1] / "kernels")
    codegen = separation.targetctx.codegen()
    assert separation._cache._index_key((), codegen)[-1] == stamp
    theirs = njit(cache=True)(_theirs)
    assert stamp not in theirs._cache._index_key((), codegen)


def _theirs():
    """Stands for a function of somebody else."""
