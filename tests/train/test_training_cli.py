"""The commands of ``guided-gym train``: what they refuse before anything starts, and TensorBoard's files."""

from __future__ import annotations

import dataclasses
import importlib.util
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from guided_gym.train.cli import EXIT_ERROR, app

pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")
pytest.importorskip("cmaes")

import torch

from guided_gym.train.hybrid_rule import HybridConfig
from guided_gym.train.imitation import ImitationConfig
from guided_gym.train.motions import MotionConfig
from guided_gym.train.node_policy import PPOConfig
from guided_gym.train.reinforcement_cli import _HYBRID, _SCORER
from guided_gym.train.selection import SelectionConfig
from guided_gym.train.training_cli import _OPTIONS, _SELECTION_OPTIONS, LISTS, OptionTable

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


@pytest.mark.parametrize("training", TRAININGS)
def test_a_cuda_device_that_is_not_there_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, training: str
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    arguments = (training, "RandomSimplePassage", "--device", "cuda")
    assert "device: expected a CUDA device" in refusal(tmp_path, monkeypatch, *arguments)


@pytest.mark.parametrize(
    ("table", "kind"),
    [
        (_OPTIONS, ImitationConfig),
        (_SELECTION_OPTIONS, SelectionConfig),
        (_HYBRID, HybridConfig),
        (_SCORER, PPOConfig),
    ],
)
def test_options_are_those_of_the_configuration(table: OptionTable, kind: type) -> None:
    fields = {field.name: type(field.default) for field in dataclasses.fields(kind)}
    for name, (wanted, text) in table.items():
        assert fields[name] is (tuple if name in LISTS else wanted)
        assert text.endswith(".")


@pytest.fixture
def hide(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Makes a package look as if it were not installed."""

    def hide(name: str) -> None:
        found = importlib.util.find_spec
        monkeypatch.setattr(
            importlib.util, "find_spec", lambda n, *rest: None if n == name else found(n, *rest)
        )

    return hide


@pytest.mark.parametrize("training", TRAININGS)
def test_tensorboard_that_is_not_there_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hide: Callable[[str], None], training: str
) -> None:
    hide("tensorboard")
    said = refusal(tmp_path, monkeypatch, training, "RandomSimplePassage", "--tensorboard")
    assert "pip install '.[train]'" in said


@pytest.mark.parametrize("training", TRAININGS)
def test_torch_that_is_not_there_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hide: Callable[[str], None], training: str
) -> None:
    hide("torch")
    said = refusal(tmp_path, monkeypatch, training, "RandomSimplePassage")
    assert "pip install '.[train]'" in said


REINFORCEMENT = """
environments = ["RandomSimplePassage"]
steps = 64
copies = 2
rollout = 16
batch = 16
epochs = 1
max_samples = 15
validation = 1
validate_every = 32
"""
OPTIONS = {
    "hybrid": REINFORCEMENT + "hidden = [8]",
    "ppo": REINFORCEMENT + "cells = 24\nheadings = 8\nscorer_hidden = 8",
    "imitation": """
problems = 4
validation = 2
poses = 32
encoder_steps = 10
decoder_epochs = 1
batch = 2
rounds = 1
searches = 3
scorer_steps = 10
max_samples = 20
cells = 24
headings = 8
""",
}


@pytest.mark.parametrize(
    ("training", "curves"),
    [
        ("hybrid", {"validation/solved": [0, 32, 64], "train/value_loss": [32, 64]}),
        ("ppo", {"validation/solved": [0, 32, 64], "train/value_loss": [32, 64]}),
        ("imitation", {"validation/solved": None, "decoder/loss": None, "scorer/loss": None}),
    ],
)
def test_tensorboard_gets_the_curves(
    tmp_path: Path, training: str, curves: dict[str, list[int] | None]
) -> None:
    """Of reinforcement learning each at the samples that the weights had learned from."""
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    (tmp_path / "options.toml").write_text(OPTIONS[training])
    arguments = ["--config", str(tmp_path / "options.toml"), "--out", str(tmp_path / "run"), "--tensorboard"]
    result = CliRunner().invoke(app, ["train", training, *arguments])
    assert result.exit_code == 0, result.output
    (file,) = (tmp_path / "run" / "tensorboard").rglob("events.*")
    events = EventAccumulator(str(file))
    events.Reload()
    for name, steps in curves.items():
        found = [event.step for event in events.Scalars(name)]
        assert found == steps if steps is not None else found


@pytest.mark.parametrize(
    ("training", "config"),
    [("imitation", ImitationConfig), ("motions", MotionConfig), ("hybrid", HybridConfig), ("ppo", PPOConfig)],
)
def test_the_help_names_the_defaults_that_hold(training: str, config: type) -> None:
    shown = CliRunner().invoke(app, ["train", training, "--help"], env={"COLUMNS": "200"}).stdout
    text = " ".join(shown.replace("│", " ").split())
    assert f"Default: {','.join(config().environments)}." in text
    assert f"Default: runs/{training}-ENV." in text
