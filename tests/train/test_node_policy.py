"""PPO of the node scorer: what it is trained on is what runs, and it begins and resumes where it should."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")

import torch
from stable_baselines3.common.vec_env import DummyVecEnv

from guided_gym import guided_search, make_distribution
from guided_gym.envs.guided_search_env import GuidedSearchEnv
from guided_gym.errors import InvalidInputError, StorageError, UnknownNameError
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.agent import LearnedAgent, LearnedGuidance
from guided_gym.guidance.learned.scorer import ScorerColumn
from guided_gym.guidance.registry import make_guidance
from guided_gym.train.cli import app
from guided_gym.train.node_policy import SELECTION_REWARD, PPOConfig, _ScorerTrainee, train_ppo
from guided_gym.train.reinforcement import buffer_bytes

TINY = PPOConfig(
    environments=("RandomSimplePassage",), steps=64, copies=2, rollout=16, batch=16, epochs=1, max_samples=20,
    validation=1, validate_every=32, cells=24, headings=8, scorer_hidden=8,
)  # fmt: skip
OPTIONS = {"n_steps": 16, "batch_size": 16, "n_epochs": 1, "device": "cpu", "seed": 0}


def run(config: PPOConfig, out: Path) -> bytes:
    train_ppo(config, out, say=lambda text: None)
    return (out / "agent" / weights.WEIGHTS_FILE).read_bytes()


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("run") / "tiny"
    run(TINY, out)
    return out


def test_the_agent_runs_by_its_name(finished):
    guidance = make_guidance(f"learned:{finished / 'agent'}")
    problem = make_distribution("RandomSimplePassage").problem(0)
    assert guided_search(problem, guidance, seed=0, max_samples=20).samples <= 20


def test_one_seed_gives_the_same_weights(finished, tmp_path):
    assert run(TINY, tmp_path) == (finished / "agent" / weights.WEIGHTS_FILE).read_bytes()


def test_selection_alone__random_draws_expand_and_the_reward_is_the_one_with_a_known_best_policy():
    env = _ScorerTrainee(replace(TINY, selection=True)).environment("RandomSimplePassage")
    plain = GuidedSearchEnv("RandomSimplePassage", split="train", max_samples=20, reward=SELECTION_REWARD)
    env.reset(seed=0)
    plain.reset(seed=0)
    for _ in range(20):
        seen, reward, _, truncated, _ = env.step(0)
        assert reward == plain.step(0)[1]
    assert truncated
    tree = plain.search.tree
    np.testing.assert_array_equal(env.unwrapped.search.tree.configurations, tree.configurations)
    columns = seen["columns"].reshape(-1, len(ScorerColumn) + 1)
    failed = np.log1p(tree.failures[0])
    assert columns[0, ScorerColumn.FAILURES] == pytest.approx(failed) and failed > 0


def test_a_run_of_selection_alone_validates_it(tmp_path):
    run(replace(TINY, selection=True), tmp_path)
    card = json.loads((tmp_path / "agent" / "card.json").read_text())
    assert card["training"]["selection"] is True
    assert card["metrics"]["validation"]["samples"] <= TINY.max_samples


def test_observations_are_those_that_the_space_says():
    env = _ScorerTrainee(TINY).environment("RandomSimplePassage")
    observation, _ = env.reset(seed=0)
    for i in range(20):
        assert env.observation_space.contains(observation)
        assert observation["action_mask"].sum() == len(env.unwrapped.search.tree)
        observation, *_ = env.step(i // 4 % len(env.unwrapped.search.tree))


@pytest.mark.parametrize("start", ["scratch", "plain"])
def test_the_policy_is_the_distribution_of_the_guidance(start):
    """On trees of several sizes: what torch learns on is what numpy runs at temperature 1."""
    trainee = _ScorerTrainee(replace(TINY, start=start))
    env = trainee.environment("RandomSimplePassage")
    model = trainee.model(DummyVecEnv([lambda: env]), dict(OPTIONS))
    model.set_random_seed(0)
    with torch.no_grad():  # not the weights that it begins with
        for parameter in model.policy.scorer.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    agent = trainee.guidance(trainee.export(model)).agent
    observation, _ = env.reset(seed=4)
    for _ in range(12):
        tensors, _ = model.policy.obs_to_tensor(observation)
        mask = env.action_masks()
        with torch.no_grad():
            policy = model.policy.get_distribution(tensors, action_masks=mask).distribution.probs[0].numpy()
        guidance = LearnedGuidance(agent, temperature=1.0)
        search = env.unwrapped.search
        guidance.reset(search)
        p = guidance.distribution(search.tree)
        assert policy[: p.size] == pytest.approx(p, abs=1e-5)
        assert not policy[p.size :].any()
        observation, _, terminated, truncated, _ = env.step(int(np.argmax(p)))
        if terminated or truncated:
            break


def test_it_begins_with_the_weights_of_an_agent(finished, tmp_path):
    trainee = _ScorerTrainee(replace(TINY, start=str(finished / "agent")))
    env = trainee.environment("RandomSimplePassage")
    begun = trainee.export(trainee.model(DummyVecEnv([lambda: env]), dict(OPTIONS)))
    agent = LearnedAgent.load(finished / "agent")
    _, tensors = weights.load_agent(finished / "agent")
    assert all(np.array_equal(tensors[f"scorer.{name}"], t) for name, t in begun.items())
    assert trainee.agent.field.architecture == agent.field.architecture


def test_the_scorer_of_an_agent_of_motions_is_taught_and_selects_in_what_is_written(tmp_path):
    trainee = _ScorerTrainee(replace(TINY, start="planar-arm-4", environments=("RandomPlanarArm4",)))
    env = trainee.environment("RandomPlanarArm4")
    model = trainee.model(DummyVecEnv([lambda: env]), dict(OPTIONS))
    with torch.no_grad():
        for parameter in model.policy.scorer.parameters():
            parameter.mul_(0.5)
    taught = trainee.export(model)
    trainee.write(tmp_path / "agent", {"name": "taught", "training": {}, "metrics": {}}, taught)
    guidance = make_guidance(f"learned:{tmp_path / 'agent'}")
    assert guidance.scored
    observation, _ = env.reset(seed=1)
    own, search = env._guidance, env.unwrapped.search
    own.scorer, own.temperature = guidance.scorer, 1.0  # on the roadmap that this search has drawn
    for _ in range(6):
        assert env.observation_space.contains(observation)
        tensors, _ = model.policy.obs_to_tensor(observation)
        with torch.no_grad():
            policy = model.policy.get_distribution(tensors, action_masks=env.action_masks()).distribution
        p = own.distribution(search.tree)
        assert policy.probs[0].numpy()[: p.size] == pytest.approx(p, abs=1e-5)
        observation, _, terminated, truncated, _ = env.step(int(np.argmax(p)))
        if terminated or truncated:
            break


def test_what_cannot_work_is_refused_before_anything_is_written(finished, tmp_path):
    out = tmp_path / "none"
    for change, error in (
        ({"start": "nowhere"}, UnknownNameError),
        ({"max_memory": 0.001}, InvalidInputError),
    ):
        with pytest.raises(error):
            train_ppo(replace(TINY, **change), out, say=lambda text: None)
        assert not out.exists()
    broken = tmp_path / "broken"
    broken.mkdir()
    for file in (weights.CARD_FILE, weights.WEIGHTS_FILE):
        (broken / file).write_bytes((finished / "agent" / file).read_bytes()[:-5])
    with pytest.raises(StorageError):
        train_ppo(replace(TINY, start=str(broken)), out, say=lambda text: None)
    assert not out.exists()


def test_the_memory_that_is_printed_is_that_of_the_buffer():
    trainee = _ScorerTrainee(TINY)
    environments = DummyVecEnv([lambda: trainee.environment("RandomSimplePassage")] * 2)
    buffer = trainee.model(environments, dict(OPTIONS)).rollout_buffer
    held = sum(array.nbytes for array in buffer.observations.values()) + buffer.action_masks.nbytes
    names = ("actions", "rewards", "returns", "episode_starts", "values", "log_probs", "advantages")
    held += sum(getattr(buffer, name).nbytes for name in names)
    assert held == pytest.approx(buffer_bytes(environments.observation_space, TINY, 22), rel=0.05)


def test_the_command_repeats_a_run(finished, tmp_path):
    command = ["train", "ppo", "--config", str(finished / "config.toml"), "--out", str(tmp_path / "again")]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    name = f"agent/{weights.WEIGHTS_FILE}"
    assert (tmp_path / "again" / name).read_bytes() == (finished / name).read_bytes()
