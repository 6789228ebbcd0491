"""The notice while kernels compile."""

from __future__ import annotations

import time
from types import SimpleNamespace

import pytest

from guided_gym.compute import warmup


def compiling(module):
    function = SimpleNamespace(__module__=module)
    return SimpleNamespace(data={"dispatcher": SimpleNamespace(py_func=function)})


@pytest.fixture
def notice(monkeypatch):
    monkeypatch.setattr(warmup, "PATIENCE", 0.05)
    return warmup.CompilationNotice()


def test_one_long_compilation_is_announced_once(notice, capsys):
    for _ in range(2):
        notice.on_start(compiling("guided_gym.kernels.metric"))
        time.sleep(0.15)
        notice.on_end(compiling("guided_gym.kernels.metric"))
    assert capsys.readouterr().err.count("compiling") == 1


def test_many_short_ones_add_up(notice, capsys):
    for _ in range(8):
        notice.on_start(compiling("guided_gym.kernels.metric"))
        time.sleep(0.03)
        notice.on_end(compiling("guided_gym.kernels.metric"))
    assert capsys.readouterr().err.count("compiling") == 1


def test_short_ones_and_other_peoples_are_not(notice, capsys):
    notice.on_start(compiling("guided_gym.kernels.metric"))
    notice.on_end(compiling("guided_gym.kernels.metric"))
    notice.on_start(compiling("their.kernels"))
    time.sleep(0.15)
    notice.on_end(compiling("their.kernels"))
    assert capsys.readouterr().err == ""


def test_clocks_stand_still_while_our_kernels_compile(notice, monkeypatch):
    """A search in which a kernel compiles for the first time takes what it takes the next time."""
    monkeypatch.setattr(warmup, "kernel_clock", notice.clock)
    before = warmup.wall_seconds(), warmup.processor_seconds()
    began = time.perf_counter(), time.process_time()
    notice.on_start(compiling("guided_gym.kernels.metric"))
    notice.on_start(compiling("guided_gym.kernels.turns"))  # compiles within the other
    while time.process_time() - began[1] < 0.2:
        pass
    notice.on_end(compiling("guided_gym.kernels.turns"))
    notice.on_end(compiling("guided_gym.kernels.metric"))
    passed = warmup.wall_seconds() - before[0], warmup.processor_seconds() - before[1]
    assert time.perf_counter() - began[0] >= 0.2
    assert max(passed) < 0.05
