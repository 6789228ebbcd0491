"""Libraries that are too heavy for the developers' extra; skipped where they are not installed."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import guided_gym  # noqa: F401  registers the ids
from guided_gym.registration import ENVIRONMENTS, SELECTIONS

IDS = [*ENVIRONMENTS, *SELECTIONS]


@pytest.mark.parametrize("name", IDS)
def test_torchrl_makes_every_id(name, options_of):
    gym = pytest.importorskip("torchrl.envs.libs.gym")
    env = gym.GymEnv(name, categorical_action_encoding=True, max_samples=8, **options_of(name))
    steps = env.rollout(4)
    assert steps["next", "reward"].shape == (4, 1)


def test_torchrl_reads_info_of_a_vector():
    gym = pytest.importorskip("torchrl.envs.libs.gym")
    env = gym.GymEnv("guided_gym:guided_gym/Cup-v0", num_envs=2, categorical_action_encoding=True)
    steps = env.rollout(5, break_when_any_done=False)
    assert steps["next", "tree_size"].shape[:2] == (2, 5)
    assert steps["next", "nodes"].shape == (2, 5, 256 * 14)
    env.close()


def test_torchrl_samples_valid_nodes_through_its_mask():
    envs = pytest.importorskip("torchrl.envs")
    env = envs.TransformedEnv(
        envs.GymEnv("guided_gym/Cup-v0", categorical_action_encoding=True, on_invalid="raise"),
        envs.ActionMask(),
    )
    assert env.rollout(30).numel() == 30


@pytest.mark.parametrize("options", [{}, {"target_in_info": True}], ids=str)
def test_minari_data_sets_with_infos_reload(options, tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    pytest.importorskip("h5py")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    env = minari.DataCollector(
        gymnasium.make("guided_gym/Cup-v0", max_nodes=16, **options), record_infos=True
    )
    for seed in range(2):
        observation, _ = env.reset(seed=seed)
        done = False
        while not done:
            action = env.action_space.sample(mask=observation["action_mask"])
            observation, _, terminated, truncated, _ = env.step(action)
            done = terminated or truncated
    env.create_dataset("guided/cup-v0", algorithm_name="random")
    episodes = list(minari.load_dataset("guided/cup-v0").iterate_episodes())
    assert len(episodes) == 2
    for episode in episodes:
        assert len(episode.infos["tree_size"]) == len(episode.rewards) + 1
        assert np.isnan(episode.infos["sampling_efficiency"][0])
        if options:
            assert episode.infos["target"].shape == (len(episode.rewards) + 1, 16)
            assert episode.infos["target"].sum(axis=1) == pytest.approx(1)
    env.close()
