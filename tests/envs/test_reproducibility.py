"""The same seed is the same rollout, bit for bit: alone, in a vector, in another process."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import gymnasium
import numpy as np
import pytest

import guided_gym  # noqa: F401  registers the ids

STEPS = 30


def digest(observation, reward):
    content = hashlib.sha256(np.float64(reward).tobytes())
    for key in sorted(observation):
        content.update(np.ascontiguousarray(observation[key]).tobytes())
    return content.hexdigest()


def actions(observation, k):
    """Any rule that depends on nothing but the observation and the step."""
    return (7 * k) % int(observation["action_mask"].sum())


def rollout(name, seed, **options):
    env = gymnasium.make(name, **options)
    observation, _ = env.reset(seed=seed)
    rows = [digest(observation, 0.0)]
    for k in range(STEPS):
        observation, reward, terminated, truncated, _ = env.step(actions(observation, k))
        rows.append(digest(observation, reward))
        if terminated or truncated:
            observation, _ = env.reset()
    return rows


CASES = [
    ("guided_gym/TrapCup-v0", {}),
    ("guided_gym/RandomSimplePassage-v0", {}),
    ("guided_gym/Cup-v0", {"expansion": "lazy_prm", "max_nodes": 12}),
]


@pytest.mark.parametrize(("name", "options"), CASES)
def test_twins_are_equal_and_other_seeds_differ(name, options):
    assert rollout(name, 11, **options) == rollout(name, 11, **options)
    assert rollout(name, 11, **options)[1:] != rollout(name, 12, **options)[1:]


@pytest.mark.parametrize("mode", ["sync", "async"])
@pytest.mark.parametrize(("name", "options"), CASES[:2])
def test_a_vector_repeats_what_each_does_alone(name, options, mode):
    envs = gymnasium.make_vec(name, 2, vectorization_mode=mode, **options)
    try:
        observation, _ = envs.reset(seed=[11, 12])
        reward, rows = np.zeros(2), [[], []]
        for k in range(STEPS + 1):
            single = [{key: value[i] for key, value in observation.items()} for i in (0, 1)]
            for i in (0, 1):
                rows[i].append(digest(single[i], reward[i]))
            observation, reward, *_ = envs.step(np.array([actions(o, k) for o in single]))
    finally:
        envs.close()
    for i, seed in enumerate((11, 12)):
        assert rows[i] == rollout(name, seed, **options)


@pytest.mark.parametrize(("name", "options"), CASES)
def test_another_process_repeats_it(name, options):
    program = f"import sys; sys.path.insert(0, {str(__file__).rsplit('/', 1)[0]!r})\n" + (
        f"from test_reproducibility import rollout\nprint(*rollout({name!r}, 11, **{options!r}))"
    )
    output = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert output.stdout.split() == rollout(name, 11, **options)
