"""Reinforcement learning, end to end on a tiny budget: it learns, repeats, resumes and refuses."""

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

from guided_gym.guidance.registry import make_guides

pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")

from guided_gym import guided_search, make_distribution
from guided_gym.errors import InvalidInputError, StorageError, UnknownNameError
from guided_gym.guidance.hybrid import Hybrid
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.rule import LearnedRule
from guided_gym.train.checkpoints import CHECKPOINT_FILE
from guided_gym.train.cli import app
from guided_gym.train.hybrid_rule import HybridConfig, train_hybrid

TINY = HybridConfig(
    environments=("TrapCup",), steps=64, copies=2, rollout=16, batch=16, epochs=1, max_samples=15,
    validation=1, validate_every=32, hidden=(8,),
)  # fmt: skip


def agent_bytes(out: Path) -> bytes:
    return (out / "agent" / weights.WEIGHTS_FILE).read_bytes()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run") / "tiny"
    said: list[str] = []
    train_hybrid(TINY, out, say=said.append)
    assert "rollout buffer: 0.0 MB (2 copies x 16 samples" in said[0]
    return out


def test_the_rule_guides_a_hybrid_and_its_card_says_how_it_came_about(finished):
    rule = LearnedRule(finished / "agent")
    problem = make_distribution("RandomTrapCup").problem(0)
    assert (
        guided_search(problem, Hybrid(make_guides(rule.guides), rule=rule), seed=0, max_samples=20).samples
        <= 20
    )
    assert rule.model.card["training"]["environments"] == ["TrapCup"]
    assert [row["steps"] for row in rule.model.card["metrics"]["history"]] == [0, 32, 64]


def test_the_exported_rule_decides_as_the_policy_did(finished):
    """The network in numpy is the one in torch."""
    import torch
    from stable_baselines3 import PPO

    from guided_gym import GuideSelectionEnv
    from guided_gym.train.hybrid_rule import _HybridTrainee

    env = GuideSelectionEnv(max_samples=10)
    policy = {"net_arch": {"pi": [8], "vf": [8]}}
    model = PPO("MlpPolicy", env, n_steps=4, batch_size=4, policy_kwargs=policy, device="cpu", seed=0)
    trainee = _HybridTrainee(TINY)
    guidance = trainee.guidance(trainee.export(model))
    observation, _ = env.reset(seed=0)
    with torch.no_grad():
        chosen = model.policy.get_distribution(torch.from_numpy(observation[None])).distribution.probs[0]
    logits = guidance.rule.model.logits(observation).astype(np.float64)
    assert np.exp(logits) / np.exp(logits).sum() == pytest.approx(chosen.numpy(), rel=1e-4)


def test_one_seed_gives_the_same_weights_and_another_others(finished, tmp_path):
    train_hybrid(TINY, tmp_path / "again", say=lambda text: None)
    assert agent_bytes(tmp_path / "again") == agent_bytes(finished)
    train_hybrid(replace(TINY, seed=1), tmp_path / "other", say=lambda text: None)
    assert agent_bytes(tmp_path / "other") != agent_bytes(finished)


def test_a_finished_run_is_not_run_again(finished):
    before = (finished / CHECKPOINT_FILE).stat().st_mtime_ns
    train_hybrid(TINY, finished, say=lambda text: None)
    assert (finished / CHECKPOINT_FILE).stat().st_mtime_ns == before


def test_a_killed_run_continues(tmp_path):
    """kill -9 in the middle; the same command goes on from the checkpoint."""
    program = (
        "from guided_gym.train.hybrid_rule import *\n"
        "from pathlib import Path\n"
        f"config = HybridConfig(environments=('TrapCup',), steps=100_000, copies=2, rollout=16, batch=16, "
        "epochs=1, max_samples=15, validation=1, validate_every=32, hidden=(8,))\n"
        f"train_hybrid(config, Path({str(tmp_path / 'run')!r}))\n"
    )
    process = subprocess.Popen([sys.executable, "-c", program], env={**os.environ, "OMP_NUM_THREADS": "1"})
    try:
        deadline = time.monotonic() + 120
        while _steps(tmp_path / "run") < 64 and time.monotonic() < deadline and process.poll() is None:
            time.sleep(0.1)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    reached = _steps(tmp_path / "run")
    assert 64 <= reached < 100_000
    config = replace(TINY, steps=100_000)
    seen: list[int] = []

    def stop(done: int, total: int, what: str) -> None:
        seen.append(done)
        if done > reached + 40:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train_hybrid(config, tmp_path / "run", stop, say=lambda text: None)
    assert reached <= seen[0] <= reached + 2


def _steps(out: Path) -> int:
    from guided_gym.train.checkpoints import RunFolder

    file = out / CHECKPOINT_FILE
    return int(RunFolder.read(file)[0]["steps"]) if file.exists() else -1


def test_what_cannot_work_is_refused_before_anything_is_written(tmp_path, finished):
    out = tmp_path / "none"
    for change, error, match in (
        ({"max_memory": 0.001}, InvalidInputError, "max_memory"),
        ({"environments": ("TrapCupp",)}, UnknownNameError, "TrapCup"),
        ({"guides": ("lazy_pmr", "rrt")}, UnknownNameError, "lazy_prm"),
    ):
        with pytest.raises(error, match=match):
            train_hybrid(replace(TINY, **change), out, say=lambda text: None)
        assert not out.exists()
    with pytest.raises(StorageError, match="another run's"):
        train_hybrid(replace(TINY, seed=5), finished, say=lambda text: None)
    for change in ({"steps": 0}, {"gamma": 1.5}, {"guides": ("rrt",)}, {"environments": ()}):
        with pytest.raises(InvalidInputError):
            replace(TINY, **change)


def test_the_command_records_and_repeats_a_run(tmp_path, finished):
    out = tmp_path / "repeated"
    command = ["train", "hybrid", "--config", str(finished / "config.toml"), "--out", str(out)]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    assert "rollout buffer" in result.output and "learned:" in result.output
    assert agent_bytes(out) == agent_bytes(finished)
    refused = CliRunner().invoke(app, [*command, "--seed", "3"])
    assert refused.exit_code == 2
