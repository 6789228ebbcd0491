"""Scripted agents: for the same seed, the same tree and the same SE as `guided_search`."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

from guided_gym import (
    GuidanceAgent,
    GuidedGymError,
    InvalidInputError,
    UnknownNameError,
    agent_names,
    guided_search,
    make_agent,
    make_guidance,
    rollout,
)
from guided_gym.guidance.registry import guidance_names
from guided_gym.randomness import streams
from guided_gym.storage.path_library import PathLibrary

NAMES = [name for name in guidance_names() if name not in ("path_database", "paths")]  # a test of their own
NEEDED = {"skeleton": "skeleton(robot=point)", "searched": "searched(guidance=goal_distance, samples=200)"}
SAMPLES = 60


def environment(name="TrapCup", **options):
    return gymnasium.make(f"guided_gym/{name}-v0", max_samples=SAMPLES, **options)


def assert_same(env, episode, result):
    tree = env.unwrapped.search.tree
    assert np.array_equal(tree.configurations, result.tree.configurations)
    assert np.array_equal(tree.parents, result.tree.parents)
    assert np.array_equal(tree.contacts, result.tree.contacts)
    assert np.array_equal(episode.efficiency, result.record.efficiency)
    assert np.array_equal(episode.rewards, -result.record.efficiency)
    assert np.array_equal(episode.best, result.record.best)
    assert episode.collision_checks == result.collision_checks
    assert (episode.solved, episode.samples) == (result.solved, result.samples)


def test_experience_grows_the_same_tree_too():
    env = environment("SimplePassage")
    env.reset(seed=0)
    problem = env.unwrapped.problem
    paths = [guided_search(problem, "oracle", seed=seed, max_samples=400).path for seed in range(3)]
    library = PathLibrary.from_paths(paths, problem.space.weights, problem.space.periods)
    guidance = make_guidance("path_database", database=library)
    for expansion in ("uniform", guidance):
        env = environment("SimplePassage", expansion=expansion)
        episode = rollout(env, make_agent(guidance), seed=5)
        in_search = None if expansion is guidance else expansion
        fresh = make_guidance("path_database", database=library)
        result = guided_search(problem, fresh, seed=5, max_samples=SAMPLES, expansion=in_search)
        assert_same(env, episode, result)


@pytest.mark.parametrize("expansion", ["uniform", "same", "rrt"])
@pytest.mark.parametrize("name", NAMES)
def test_an_agent_grows_the_tree_that_guided_search_grows(name, expansion):
    name = NEEDED.get(name, name)
    in_env = name if expansion == "same" else expansion
    in_search = None if in_env == name else expansion
    env = environment(expansion=in_env)
    episode = rollout(env, make_agent(name), seed=5)
    problem = env.unwrapped.problem
    result = guided_search(problem, name, seed=5, max_samples=SAMPLES, expansion=in_search)
    assert_same(env, episode, result)


def test_the_problem_of_a_seed_is_the_first_stream_s():
    env = environment("RandomSimplePassage")
    episode = rollout(env, make_agent("rrt"), seed=9)
    problem = env.unwrapped.distribution.draw(streams(9)[0])
    assert problem.fingerprint == env.unwrapped.problem.fingerprint
    assert_same(env, episode, guided_search(problem, "rrt", seed=9, max_samples=SAMPLES, expansion="uniform"))


def test_an_instance_can_serve_selection_and_expansion():
    guidance = make_guidance("goal_distance", temperature=1.0)
    env = environment(expansion=guidance)
    episode = rollout(env, make_agent(guidance), seed=2)
    fresh = make_guidance("goal_distance", temperature=1.0)
    assert_same(env, episode, guided_search(env.unwrapped.problem, fresh, seed=2, max_samples=SAMPLES))


def test_options_are_not_lost_to_the_environments_guiding_space():
    env = environment(expansion="goal_distance")
    agent = make_agent("goal_distance", temperature=3.0)
    rollout(env, agent, seed=2)
    assert agent.guidance.temperature == 3.0
    assert agent.guidance is not env.unwrapped.expander


def test_the_agent_notices_a_reset():
    env = environment()
    agent = make_agent("rrt")
    expected = [rollout(env, agent, seed=seed).efficiency for seed in (1, 2)]
    observation, info = env.reset(seed=1)
    agent.reset(env)
    for seed, efficiency in zip((1, 2), expected, strict=True):
        if seed == 2:
            observation, info = env.reset(seed=2)  # the agent is not told
        seen = []
        for _ in efficiency:
            observation, *_, info = env.step(agent.act(observation, info))
            seen.append(info["sampling_efficiency"])
        assert np.array_equal(seen, efficiency)


def test_the_environment_can_be_given_at_once():
    env = environment()
    agent = make_agent("lazy_prm", env)
    observation, info = env.reset(seed=0)
    assert agent.act(observation, info) == 0


def test_an_agent_without_an_environment_says_what_it_needs():
    env = environment()
    observation, info = env.reset(seed=0)
    with pytest.raises(GuidedGymError, match=r"agent 'rrt': expected reset\(env\) before act\(\)"):
        make_agent("rrt").act(observation, info)


def test_other_environments_are_refused():
    with pytest.raises(InvalidInputError, match="expected a GuidedSearchEnv"):
        make_agent("rrt").reset(gymnasium.make("CartPole-v1"))
    envs = gymnasium.make_vec("guided_gym/Cup-v0", 1, vectorization_mode="sync")
    with pytest.raises(InvalidInputError, match="expected a GuidedSearchEnv"):
        make_agent("rrt").reset(envs)


def test_unknown_agents_and_options_come_with_the_nearest():
    with pytest.raises(UnknownNameError, match="did you mean 'masked_random'"):
        make_agent("masked_randm")
    with pytest.raises(UnknownNameError, match="did you mean 'temperature'"):
        make_agent("goal_distance", temprature=1.0)
    with pytest.raises(UnknownNameError, match="did you mean 'seed'"):
        make_agent("random", sed=1)
    assert {"rrt", "random", "masked_random"} <= set(agent_names())


def test_an_agent_acts_with_its_whole_distribution_where_weights_are_asked_for():
    env = environment(action="distribution")
    agent = make_agent("goal_distance", temperature=1.0)
    observation, info = env.reset(seed=0)
    agent.reset(env)
    for _ in range(10):
        weights = agent.act(observation, info)
        assert weights in env.action_space
        p = agent.guidance.distribution(env.unwrapped.search.tree)
        assert np.allclose(weights[: p.size], p, atol=1e-6)
        observation, *_, info = env.step(weights)
        assert not info["invalid_action"]


@pytest.mark.parametrize("action", ["node", "distribution"])
def test_random_agents(action):
    env = environment(action=action)
    masked = rollout(env, make_agent("masked_random", seed=1), seed=0)
    again = rollout(env, make_agent("masked_random", seed=1), seed=0)
    assert np.array_equal(masked.rewards, again.rewards)
    rollout(env, make_agent("random", seed=1), seed=0)


def test_the_masked_random_agent_never_chooses_an_invalid_node():
    env = environment()
    agent = make_agent("masked_random", seed=0)
    observation, info = env.reset(seed=0)
    agent.reset(env)
    for _ in range(40):
        observation, *_, info = env.step(agent.act(observation, info))
        assert not info["invalid_action"]


def test_a_hybrid_by_name():
    agent = make_agent("lazy_prm+medial_axis")
    assert isinstance(agent, GuidanceAgent) and agent.name == "lazy_prm+medial_axis"
    env = environment("Cup")
    episode = rollout(env, agent, seed=0)
    assert episode.samples == episode.rewards.size <= SAMPLES
    assert episode.total_efficiency == pytest.approx(-episode.total_reward)
