"""Every id under the checkers and wrappers of Gymnasium and stable-baselines3, every warning an error."""

from __future__ import annotations

import sys
import types
from itertools import pairwise

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers import FlattenObservation, RecordEpisodeStatistics, RecordVideo

from guided_gym import Environment, Problem, Robot, Task, make_distribution, rollout_bytes
from guided_gym.registration import ENVIRONMENTS

IDS = list(ENVIRONMENTS)

# One problem of a hard maze may spend the oracle's budget, which is said once.
pytestmark = pytest.mark.filterwarnings(
    "error", "ignore:.*pkg_resources.*:", "ignore:the oracle's estimated error"
)


def has_pygame():
    try:
        import pygame  # noqa: F401
    except ImportError:
        return False
    return True


def test_the_ids_are_the_catalogue():
    assert {name: make_distribution(distribution).name for name, distribution in ENVIRONMENTS.items()} == (
        ENVIRONMENTS
    )


def test_gym_make_imports_the_package_by_itself():
    assert gymnasium.make("guided_gym:guided_gym/TrapCup-v0").unwrapped.distribution.name == "TrapCup"


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_check_env(name, monkeypatch, options_of):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gymnasium.make(name, disable_env_checker=True, **options_of(name)).unwrapped
    check_env(env, skip_render_check=not has_pygame())


@pytest.mark.parametrize(
    "options",
    [
        {"action": "distribution"},
        {"reward": "jensen_shannon"},
        {"expansion": "rrt"},
        {"rewire": True},
        {"target_in_info": True},
    ],
    ids=str,
)
def test_gymnasium_check_env_with_options(options):
    env = gymnasium.make("guided_gym/RandomSimplePassage-v0", disable_env_checker=True, **options).unwrapped
    check_env(env, skip_render_check=True)


@pytest.mark.parametrize("name", IDS)
def test_stable_baselines3_check_env(name, options_of):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gymnasium.make(name, **options_of(name)), warn=True, skip_render_check=True)


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_make_vec(mode):
    envs = gymnasium.make_vec("guided_gym/SimplePassage-v0", 2, vectorization_mode=mode, max_samples=5)
    try:
        observation, _ = envs.reset(seed=[3, 4])
        for _ in range(8):  # past the end of the episodes: they reset by themselves
            assert observation in envs.observation_space
            observation, reward, *_ = envs.step(np.zeros(2, np.int64))
            assert reward.shape == (2,) and np.isfinite(reward).all()
    finally:
        envs.close()


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_a_vector_can_be_given_a_problem(mode):
    problem = Problem(Robot.point(), Environment((0.0, 0.0, 2.0, 1.0)), Task((0.3, 0.5), (1.7, 0.5)))
    envs = gymnasium.make_vec("guided_gym/Cup-v0", 2, vectorization_mode=mode, max_samples=5)
    try:
        _, info = envs.reset(seed=0, options={"problem": problem})
        assert info["solved"].all()
        *_, terminated, _, _ = envs.step(np.zeros(2, np.int64))
        assert terminated.all()
    finally:
        envs.close()


def test_flatten_observation():
    env = FlattenObservation(gymnasium.make("guided_gym/Trap-v0", max_nodes=8))
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space and observation.ndim == 1
    assert env.step(0)[0] in env.observation_space


def test_record_episode_statistics():
    env = RecordEpisodeStatistics(gymnasium.make("guided_gym/Cup-v0", max_samples=6))
    env.reset(seed=0)
    total, truncated = 0.0, False
    while not truncated:
        _, reward, _, truncated, info = env.step(0)
        total += reward
    assert info["episode"]["l"] == 6
    assert info["episode"]["r"] == pytest.approx(total, rel=1e-5)


@pytest.mark.filterwarnings("ignore")
def test_record_video(tmp_path, monkeypatch):
    """The frames that Gymnasium hands to moviepy, which is not pinned: it wants a pillow with known holes."""
    pytest.importorskip("pygame")
    clips = []

    class Clip:
        def __init__(self, frames, fps):
            self.frames, self.fps = frames, fps

        def write_videofile(self, path, logger=None):
            clips.append((path, self.frames, self.fps))

    module = types.ModuleType("moviepy.video.io.ImageSequenceClip")
    module.ImageSequenceClip = Clip
    for name in ("moviepy", "moviepy.video", "moviepy.video.io"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    monkeypatch.setitem(sys.modules, module.__name__, module)
    env = gymnasium.make("guided_gym/TrapCup-v0", render_mode="rgb_array", max_samples=4)
    env = RecordVideo(
        env, str(tmp_path / "videos"), episode_trigger=lambda episode: True, disable_logger=True
    )
    env.reset(seed=0)
    truncated = False
    while not truncated:
        _, _, _, truncated, _ = env.step(0)
    env.close()
    [(path, frames, fps)] = clips
    assert path.endswith(".mp4") and fps == env.metadata["render_fps"] and len(frames) == 5
    assert {(frame.dtype.name, frame.ndim, frame.shape[2]) for frame in frames} == {("uint8", 3, 3)}
    assert len({frame.shape for frame in frames}) == 1
    assert all((a != b).any() for a, b in pairwise(frames))  # each step shows


def test_human_mode_shows_each_step(monkeypatch):
    pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gymnasium.make("guided_gym/Cup-v0", render_mode="human")
    env.reset(seed=0)
    env.step(0)
    assert env.render() is None
    env.close()


@pytest.mark.filterwarnings("default")
def test_the_formula_for_the_buffer_is_what_maskable_ppo_allocates():
    buffers = pytest.importorskip("sb3_contrib.common.maskable.buffers")
    env = gymnasium.make("guided_gym/Cup-v0", max_nodes=16, raster=40)
    buffer = buffers.MaskableDictRolloutBuffer(10, env.observation_space, env.action_space, n_envs=3)
    buffer.reset()
    arrays = [*buffer.observations.values(), *(v for v in vars(buffer).values() if isinstance(v, np.ndarray))]
    assert sum(array.nbytes for array in arrays) == rollout_bytes(16, 40, environments=3, steps=10)


@pytest.mark.filterwarnings("default")
def test_maskable_ppo_learns_a_few_steps_on_valid_actions_only():
    contrib = pytest.importorskip("sb3_contrib")
    invalid = []

    class Watch(gymnasium.Wrapper):
        def step(self, action):
            result = self.env.step(action)
            invalid.append(result[4]["invalid_action"])
            return result

    env = Watch(gymnasium.make("guided_gym/SimplePassage-v0", max_nodes=16, raster=36))
    model = contrib.MaskablePPO("MultiInputPolicy", env, n_steps=32, batch_size=16, n_epochs=1, seed=0)
    model.learn(64)
    assert len(invalid) == 64 and not any(invalid)
