"""Imitation, end to end on a tiny budget: it learns, repeats, resumes and refuses."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

torch = pytest.importorskip("torch")

from guided_gym.errors import InvalidInputError, StorageError, UnknownNameError  # noqa: E402
from guided_gym.guidance.learned import weights  # noqa: E402
from guided_gym.guidance.registry import make_guidance  # noqa: E402
from guided_gym.train.checkpoints import AGENT_FOLDER, CHECKPOINT_FILE, RunFolder  # noqa: E402
from guided_gym.train.cli import app  # noqa: E402
from guided_gym.train.imitation import ImitationConfig, train_imitation  # noqa: E402

TINY = ImitationConfig(
    problems=4,
    validation=2,
    poses=64,
    encoder_steps=40,
    decoder_epochs=2,
    batch=2,
    rounds=2,
    searches=3,
    scorer_steps=10,
    cells=24,
    headings=8,
    max_samples=60,
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run") / "tiny"
    train_imitation(TINY, out)
    return out


def agent_bytes(out: Path) -> bytes:
    return (out / AGENT_FOLDER / weights.WEIGHTS_FILE).read_bytes()


def test_the_agent_guides_and_its_card_says_how_it_came_about(finished: Path) -> None:
    make_guidance(f"learned:{finished / AGENT_FOLDER}")
    card = weights.load_card(finished / AGENT_FOLDER)
    assert card["training"]["environments"] == ["RandomSimplePassage"]
    assert card["training"]["seed"] == 0
    assert {"encoder", "decoder", "scorer"} <= {row["what"] for row in card["metrics"]["history"]}
    assert card["metrics"]["validation"]["solved"] >= 0


def test_the_encoder_has_learned_what_is_valid(finished: Path) -> None:
    history = weights.load_card(finished / AGENT_FOLDER)["metrics"]["history"]
    assert next(row["accuracy"] for row in history if row["what"] == "encoder") > 0.9


def test_the_same_seed_gives_the_same_weights(finished: Path, tmp_path: Path) -> None:
    train_imitation(TINY, tmp_path / "again")
    assert agent_bytes(tmp_path / "again") == agent_bytes(finished)


class StopError(Exception):
    pass


@pytest.mark.parametrize("after", [1, 5, 7, 9])
def test_a_run_that_was_stopped_ends_with_the_same_weights(
    finished: Path, tmp_path: Path, after: int
) -> None:
    def progress(done: int, total: int, what: str) -> None:
        if done >= after:
            raise StopError

    with pytest.raises(StopError):
        train_imitation(TINY, tmp_path / "run", progress)
    train_imitation(TINY, tmp_path / "run")
    first, second = (RunFolder.read(out / CHECKPOINT_FILE)[1] for out in (finished, tmp_path / "run"))
    assert all(np.array_equal(first[name], second[name]) for name in first)
    assert agent_bytes(tmp_path / "run") == agent_bytes(finished)


def test_a_finished_run_is_not_run_again(finished: Path) -> None:
    before = agent_bytes(finished), (finished / CHECKPOINT_FILE).stat().st_mtime_ns
    train_imitation(TINY, finished)
    assert (agent_bytes(finished), (finished / CHECKPOINT_FILE).stat().st_mtime_ns) == before


def test_a_killed_run_goes_on(finished: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    command = [sys.executable, "-m", "guided_gym.train.cli", "train", "imitation", "--config"]
    process = subprocess.Popen(
        [*command, str(finished / "config.toml"), "--out", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    deadline = time.monotonic() + 120
    while not (out / CHECKPOINT_FILE).exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    train_imitation(TINY, out)
    assert agent_bytes(out) == agent_bytes(finished)


def test_the_command_line_repeats_a_run_from_its_configuration(finished: Path, tmp_path: Path) -> None:
    arguments = [
        "train",
        "imitation",
        "--config",
        str(finished / "config.toml"),
        "--out",
        str(tmp_path / "run"),
    ]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert agent_bytes(tmp_path / "run") == agent_bytes(finished)
    result = CliRunner().invoke(app, [*arguments, "--seed", "5"])
    assert result.exit_code == 2
    assert agent_bytes(tmp_path / "run") == agent_bytes(finished)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"device": "tpu"}, InvalidInputError, "'cpu' or 'cuda'"),
        ({"device": "cuda"}, InvalidInputError, "CUDA"),
        ({"environments": ("Nowhere",)}, UnknownNameError, "Nowhere"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_is_written(
    tmp_path: Path, changes: dict[str, object], error: type[Exception], message: str
) -> None:
    if changes.get("device") == "cuda" and torch.cuda.is_available():
        pytest.skip("there is a CUDA device")
    with pytest.raises(error, match=message):
        train_imitation(replace(TINY, **changes), tmp_path / "run")  # type: ignore[arg-type]
    assert not (tmp_path / "run").exists()


def test_the_folder_of_another_run_is_refused(finished: Path) -> None:
    before = agent_bytes(finished)
    with pytest.raises(StorageError, match="seed = 0; seed = 1"):
        train_imitation(replace(TINY, seed=1), finished)
    assert agent_bytes(finished) == before


@pytest.mark.parametrize(
    "changes",
    [
        {"problems": 0},
        {"rounds": -1},
        {"divergence": "sideways"},
        {"learning_rate": 0.0},
        {"environments": ()},
    ],
)
def test_options_out_of_range_are_refused(changes: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(changes))):
        replace(TINY, **changes)  # type: ignore[arg-type]


def test_without_planning_and_with_a_robot_that_cannot_turn(tmp_path: Path) -> None:
    config = replace(TINY, environments=("RandomPointMaze",), planning=False, divergence="reverse", rounds=1)
    card = train_imitation(config, tmp_path / "run")
    assert np.isfinite([row["loss"] for row in card["metrics"]["history"] if "loss" in row]).all()
