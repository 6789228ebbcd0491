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
