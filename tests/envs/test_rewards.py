"""Rewards: what each is of the two numbers of a choice, alone and added up."""

from __future__ import annotations

import math

import numpy as np
import pytest

from guided_gym import GuidedSearchEnv, TargetParameters
from guided_gym.envs.rewards import REWARDS, MeasuredReward, WeightedReward, make_reward

TARGET = TargetParameters()


def steps(reward, count=40):
    env = GuidedSearchEnv("TrapCup", max_nodes=64, reward=reward)
    env.reset(seed=3)
    for k in range(count):
        q = env.measure.distribution()
        node = int(np.argmax(q)) if k % 2 else k % len(q)
        _, value, *_, info = env.step(node)
        yield value, info, node == int(np.argmax(q))


def test_regret_is_what_a_choice_loses_beside_the_best():
    for value, info, best in steps("regret"):
        assert value == pytest.approx(info["best_possible"] - info["sampling_efficiency"], abs=1e-12)
        assert value <= 0 and math.copysign(1.0, value or 1.0) == (-1.0 if value else 1.0)
        assert value == 0 or not best


def test_the_best_node_loses_nothing():
    assert all(value == 0 for value, _, best in steps("regret") if best)


def test_weights_add_rewards_up():
    weights = {"efficiency": 0.5, "regret": 2.0, "jensen_shannon": 3.0, "sample": 0.25}
    rows = zip(steps(weights), *(steps(name) for name in weights), strict=True)
    for (total, *_), *parts in rows:
        expected = sum(w * part[0] for w, part in zip(weights.values(), parts, strict=True))
        assert total == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("reward", [*REWARDS, {"regret": 1, "sample": 0.1}], ids=str)
def test_no_choice_is_worse_than_an_invalid_one(reward):
    worst = make_reward(reward).worst(TARGET)
    assert all(value >= worst - 1e-12 for value, *_ in steps(reward))


def test_those_of_two_numbers_take_many_choices_at_once():
    efficiency, best = np.array([0.5, 3.0, 9.0]), np.array([0.5, 1.0, 2.0])
    for name, expected in (
        ("efficiency", [-0.5, -3, -9]),
        ("regret", [0, -2, -7]),
        ("sample", [-1, -1, -1]),
        ({"regret": 2, "sample": 0.5}, [-0.5, -4.5, -14.5]),
    ):
        reward = make_reward(name)
        assert isinstance(reward, MeasuredReward)
        assert reward.of(efficiency, best).tolist() == expected
    assert not isinstance(make_reward({"jensen_shannon": 1.0}), MeasuredReward)
    assert isinstance(make_reward({"jensen_shannon": 1.0}), WeightedReward)
