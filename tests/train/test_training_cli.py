"""What the commands of ``guided-gym train`` refuse, before anything starts."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from guided_gym.train.cli import EXIT_ERROR, app

pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")

TRAININGS = ("imitation", "hybrid", "ppo")


def refusal(folder: Path, monkeypatch: pytest.MonkeyPatch, *arguments: str) -> str:
    """The one line with which a training refuses, nothing written."""
    monkeypatch.chdir(folder)
    result = CliRunner().invoke(app, ["train", *arguments])
    assert result.exit_code == EXIT_ERROR, result.output
    assert result.stdout == ""
    assert list(folder.iterdir()) == []
    assert result.stderr.startswith("guided-gym: error: ")
    assert result.stderr.count("\n") == 1
    return result.stderr


@pytest.mark.parametrize("training", TRAININGS)
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("TrapCup,,Cup", "environments: expected names separated by commas, got an empty one"),
        ("TrapCup,", "environments: expected names separated by commas, got an empty one"),
        ("", "environments: expected at least one, got none"),
    ],
)
def test_lists_with_empty_items_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, training: str, text: str, message: str
) -> None:
    assert message in refusal(tmp_path, monkeypatch, training, text)


@pytest.mark.parametrize(
    ("text", "message"),
    [("rrt,,prm", "guides: expected names separated by commas"), ("", "guides: expected at least two")],
)
def test_lists_of_guides_with_empty_items_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, message: str
) -> None:
    assert message in refusal(tmp_path, monkeypatch, "hybrid", "TrapCup", "--guides", text)
