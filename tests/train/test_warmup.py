"""The command that compiles beforehand."""

from __future__ import annotations

from typer.testing import CliRunner

from guided_gym.train import warmup
from guided_gym.train.cli import app


def test_the_command_runs_each_step_and_says_how_long_it_took(monkeypatch):
    ran = []
    monkeypatch.setattr(
        warmup, "steps", lambda: iter([("one", lambda: ran.append(1)), ("two", lambda: ran.append(2))])
    )
    result = CliRunner().invoke(app, ["warmup"])
    assert result.exit_code == 0 and ran == [1, 2]
    assert "one" in result.output and "ready after" in result.output


def test_every_step_can_be_run():
    """The two shortest; the others are searches like these."""
    named = dict(warmup.steps())
    assert len(named) == len(list(warmup.steps())) > 20
    named["rrt on TrapCup"]()
    named["environment over RandomPointMaze"]()
