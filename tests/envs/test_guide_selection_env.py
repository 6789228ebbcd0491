"""The environment in which the action is the guiding space: same search, same reward, a small choice."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from guided_gym import GuideSelectionEnv, guided_search, make_agent, make_distribution, rollout
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.guidance.hybrid import Hybrid
from guided_gym.guidance.learned.turns import COLUMN_NAMES, GuideColumn, SearchColumn, observed_size
from guided_gym.guidance.registry import make_guides
from guided_gym.registration import SELECTIONS

IDS = list(SELECTIONS)


class Alternate:
    """0, 0, 1, 0, 0, 1, ... whatever comes."""

    def begin(self, guides, search):
        self.samples = 0

    def weights(self):
        return np.eye(2)[int(self.samples % 3 == 2)]

    def learn(self, guide, expansion):
        self.samples += 1


def play(env, actions, seed=0):
    observations, rewards = [env.reset(seed=seed)[0]], []
    for action in actions:
        observation, reward, terminated, truncated, _ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
        if terminated or truncated:
            break
    return np.array(observations), np.array(rewards)


@pytest.mark.filterwarnings("error", "ignore:.*pkg_resources.*:")
@pytest.mark.parametrize("name", IDS)
def test_gymnasium_check_env(name):
    check_env(gymnasium.make(name, disable_env_checker=True).unwrapped, skip_render_check=True)


@pytest.mark.filterwarnings("error", "ignore:.*pkg_resources.*:")
@pytest.mark.parametrize("name", IDS)
def test_stable_baselines_check_env(name):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gymnasium.make(name, disable_env_checker=True), warn=True)


def test_plain_learners_of_stable_baselines_train_on_it():
    sb3 = pytest.importorskip("stable_baselines3")
    env = gymnasium.make(IDS[0], max_samples=30)
    sb3.PPO("MlpPolicy", env, n_steps=32, batch_size=32, n_epochs=1, device="cpu").learn(32)
    sb3.DQN("MlpPolicy", env, learning_starts=8, buffer_size=100, device="cpu").learn(32)


def test_same_choices_same_tree_and_reward_as_a_hybrid():
    problem = make_distribution("RandomTrapCup").problem(3)
    result = guided_search(
        problem, Hybrid(make_guides(["lazy_prm", "medial_axis"]), rule=Alternate()), seed=3, max_samples=90
    )
    env = GuideSelectionEnv("RandomTrapCup", max_samples=90)
    _, rewards = play(env, (int(i % 3 == 2) for i in range(90)), seed=3)
    assert np.array_equal(env.search.tree.configurations, result.tree.configurations)
    assert rewards == pytest.approx(-result.record.efficiency)


def test_observations_stay_within_bounds_with_three_guides():
    env = GuideSelectionEnv("RandomTrapCup", guides=("lazy_prm", "medial_axis", "rrt"), max_samples=60)
    rng = np.random.default_rng(0)
    for seed in range(2):
        observations, _ = play(env, rng.integers(0, 3, 60), seed)
        assert observations.shape[1] == observed_size(3)
        assert all(env.observation_space.contains(o) for o in observations)
    assert len(COLUMN_NAMES) == len(SearchColumn) + len(GuideColumn)


def test_observation_tells_who_guided_and_what_became_of_it():
    env = GuideSelectionEnv(max_samples=60)
    env.reset(seed=0)
    uses = np.zeros(2)
    for i in range(40):
        action = i // 5 % 2
        observation = env.step(action)[0]
        uses[action] += 1
        guides = observation[len(SearchColumn) :].reshape(2, len(GuideColumn))
        failed = env.search.last.failed
        assert guides[:, GuideColumn.CURRENT].tolist() == [action == 0, action == 1]
        assert guides[action, GuideColumn.LAST_FAILED] == observation[SearchColumn.FAILED] == failed
        assert guides[:, GuideColumn.USE] == pytest.approx(uses / (i + 1))
        assert guides[action, GuideColumn.WAITING] == 0


def test_observation_tells_of_each_guides_favourite():
    env = GuideSelectionEnv(max_samples=60)
    env.reset(seed=0)
    tree, space = env.search.tree, env.search.space
    root = [guide.values(tree)[0] for guide in env.hybrid.guides]
    far, lagging = space.distance(env.search.start, env.search.goal), np.ones(2)
    for i in range(40):
        observation = env.step(i % 2)[0]
        guides = observation[len(SearchColumn) :].reshape(2, len(GuideColumn))
        values = [guide.values(tree) for guide in env.hybrid.guides]
        nodes = np.array([np.argmin(v) for v in values])
        h = np.minimum([v.min() / r for v, r in zip(values, root, strict=True)], 2)
        q, tries = tree.configurations[nodes], tree.failures[nodes] + tree.children[nodes]
        expected = {
            GuideColumn.REMAINING: h,
            GuideColumn.TREND: np.clip(4 * (lagging - h), -1, 1),
            GuideColumn.TRIES: np.log1p(tries) / np.log(101),
            GuideColumn.NODE_FAILURES: np.log1p(tree.failures[nodes]) / np.log(101),
            GuideColumn.CLEARANCE: np.minimum(space.clearance(q) / env.search.planner.step / 2, 1),
            GuideColumn.DISTANCE: np.minimum(space.distance(q, env.search.goal) / far / 2, 1),
            GuideColumn.AGREES: nodes == nodes[i % 2],
            GuideColumn.AGE: 1 - nodes / (len(tree) - 1),
        }
        for column, value in expected.items():
            assert guides[:, column] == pytest.approx(np.asarray(value, float), abs=1e-6), column
        lagging = 0.9 * lagging + 0.1 * h
        nearest = space.distance(tree.configurations, env.search.goal).min() / far
        assert observation[SearchColumn.NEAREST] == pytest.approx(nearest)


def test_steps_after_the_end_change_nothing():
    env = GuideSelectionEnv(max_samples=3)
    env.reset(seed=0)
    for _ in range(3):
        *_, truncated, _ = env.step(0)
    assert truncated
    observation, reward, *_ = env.step(1)
    assert reward == 0 and env.search.samples == 3
    assert np.array_equal(observation, env.step(0)[0])


@pytest.mark.parametrize("action", [0.5, "lazy_prm", None, np.array([0, 1])])
def test_what_is_no_index_is_refused(action):
    env = GuideSelectionEnv(max_samples=5)
    env.reset(seed=0)
    with pytest.raises(InvalidInputError, match="index of a guiding space"):
        env.step(action)


@pytest.mark.parametrize("action", [1, np.int32(1), np.array(1), np.array([1]), True])
def test_anything_that_is_an_index_is_an_action(action):
    env = GuideSelectionEnv(max_samples=5)
    env.reset(seed=0)
    assert env.step(action)[4]["invalid_action"] is False and env.hybrid.current == 1


@pytest.mark.parametrize("action", [-1, 2, 10**12])
def test_a_guide_that_there_is_not_counts_as_a_sample(action):
    env = GuideSelectionEnv(max_samples=3)
    before, _ = env.reset(seed=0)
    for k in range(3):
        after, reward, terminated, truncated, info = env.step(action)
        assert reward == np.log(1e-4) and info["invalid_action"] and info["samples"] == k + 1
        assert np.array_equal(before, after) and not terminated and truncated is (k == 2)
    env = GuideSelectionEnv(max_samples=3, on_invalid="raise")
    env.reset(seed=0)
    with pytest.raises(InvalidInputError, match="0 to 1"):
        env.step(action)


def test_all_guides_may_be_chosen_at_any_time():
    env = GuideSelectionEnv(max_samples=3)
    env.reset(seed=0)
    assert env.action_masks().tolist() == [True, True] and env.action_masks().dtype == bool


@pytest.mark.parametrize("name", ["random", "masked_random"])
def test_random_agents_act_in_it(name):
    env = gymnasium.make(IDS[0], max_samples=20)
    episode = rollout(env, make_agent(name, seed=1), seed=0)
    assert episode.samples == 20 and episode.nodes > 1
    assert set(env.unwrapped.search.tree.parents.tolist()) != {-1}


def test_bad_options_are_refused():
    with pytest.raises(UnknownNameError, match="max_samples"):
        GuideSelectionEnv(max_sample=5)
    with pytest.raises(UnknownNameError):
        GuideSelectionEnv(expansion="rrt")
    with pytest.raises(UnknownNameError, match="lazy_prm"):
        GuideSelectionEnv(guides=("lazy_pmr",))
    with pytest.raises(InvalidInputError, match="max_samples"):
        GuideSelectionEnv(max_samples=0)
