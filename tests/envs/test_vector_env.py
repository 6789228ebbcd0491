"""The native vector environment against gymnasium's own over single environments: bit by bit the same."""

from __future__ import annotations

import copy

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit
from gymnasium.wrappers.vector import RecordEpisodeStatistics

from guided_gym import (
    Environment,
    GuidedGymError,
    GuidedSearchEnv,
    InvalidInputError,
    Problem,
    Robot,
    TargetParameters,
    Task,
    UnknownNameError,
)
from guided_gym.envs.vector_env import GuidedSearchVectorEnv, make_vector, vector_bytes
from guided_gym.errors import GuidedGymWarning
from guided_gym.registration import ENVIRONMENTS

MODES = list(AutoresetMode)


def same(one, other, where=""):
    """Equal in type, shape and each bit, dictionaries in any order; NaN equals NaN."""
    if isinstance(one, dict):
        assert set(one) == set(other), where
        for key in one:
            same(one[key], other[key], f"{where}/{key}")
    elif isinstance(one, np.ndarray) and one.dtype == object:
        for k, (a, b) in enumerate(zip(one, other, strict=True)):
            same(a, b, f"{where}[{k}]")
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype and one.shape == other.shape, (where, one.dtype, other.dtype)
        assert np.array_equal(one, other, equal_nan=one.dtype.kind == "f"), (where, one, other)
    else:
        assert type(one) is type(other) and one == other, where


def pair(count=3, mode=AutoresetMode.NEXT_STEP, limit=None, **options):
    def single():
        env = GuidedSearchEnv(**options)
        return env if limit is None else TimeLimit(env, limit)

    native = make_vector(count, autoreset_mode=mode, max_episode_steps=limit, **options)
    assert isinstance(native, GuidedSearchVectorEnv)
    return native, SyncVectorEnv([single] * count, autoreset_mode=mode)


def compare(native, plain, steps, mode, seed=0, invalid=0.1):
    rng = np.random.default_rng(seed)
    ours, theirs = native.reset(seed=seed), plain.reset(seed=seed)
    same(ours[0], theirs[0]), same(ours[1], theirs[1])
    ends = 0
    for _ in range(steps):
        sizes = ours[0]["action_mask"].sum(axis=1)
        actions = (rng.random(native.num_envs) * sizes).astype(np.int64)
        actions[rng.random(native.num_envs) < invalid] = native.max_nodes - 1
        ours, theirs = native.step(actions), plain.step(actions)
        for k, (a, b) in enumerate(zip(ours, theirs, strict=True)):
            same(a, b, str(k))
        assert ours[0] in native.observation_space
        ended = ours[2] | ours[3]
        ends += ended.sum()
        if mode == AutoresetMode.DISABLED and ended.any():
            given = native.reset(options={"reset_mask": ended}), plain.reset(options={"reset_mask": ended})
            same(given[0][0], given[1][0]), same(given[0][1], given[1][1])
            ours = given[0]
    return ends


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    "options",
    [
        {"distribution": "TrapCup", "max_samples": 25},
        {"distribution": "RandomSimplePassage", "max_samples": 9, "target_in_info": True},
        {"distribution": "RandomPointMaze", "max_samples": 20, "reward": {"regret": 1, "sample": 0.3}},
        {"distribution": "HardStickMaze", "max_samples": 6, "step": 0.2, "goal_tolerance": 0.1},
        {"distribution": "Cup", "max_samples": 12, "target": TargetParameters(0.3, 0.2, 1e-3)},
    ],
    ids=lambda options: options["distribution"],
)
def test_the_same_as_single_environments_with_the_same_seeds(mode, options):
    assert compare(*pair(mode=mode, **options), 45, mode)


@pytest.mark.parametrize("mode", MODES)
def test_searches_that_are_solved(mode):
    """A wide step in an open room: most episodes end at the goal, with a path and its cost."""
    problem = Problem(
        Robot.point(),
        Environment.from_polygons((0, 0, 2, 1), [[(0.95, 0), (1.05, 0), (1.05, 0.7), (0.95, 0.7)]]),
        Task((0.3, 0.4), (1.7, 0.4)),
    )
    native, plain = pair(5, mode, distribution=problem, step=0.8, max_samples=60)
    assert compare(native, plain, 150, mode, invalid=0.02) > 10


def test_a_step_limit_is_kept_and_one_that_cannot_be_is_spoken_of():
    assert (
        compare(*pair(limit=7, distribution="Cup"), 30, AutoresetMode.NEXT_STEP) == 9
    )  # a step in eight is a reset
    with pytest.warns(GuidedGymWarning, match="max_samples=2000"):
        gymnasium.make_vec("guided_gym/Cup-v0", 2, max_episode_steps=2000)


def test_each_id_is_native():
    for name in ENVIRONMENTS:
        envs = gymnasium.make_vec(name, num_envs=2, max_nodes=16)
        assert isinstance(envs.unwrapped, GuidedSearchVectorEnv)
        assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP


@pytest.mark.parametrize(
    "options",
    [
        {"action": "distribution"},
        {"expansion": "goal_distance"},
        {"rewire": True},
        {"reward": "jensen_shannon"},
        {"target": TargetParameters(normalisation="tree")},
        {"render_mode": "rgb_array"},
    ],
    ids=str,
)
def test_what_the_compiled_step_cannot_do_is_done_one_by_one(options):
    envs = make_vector(2, distribution="Cup", max_nodes=16, autoreset_mode="SameStep", **options)
    assert isinstance(envs, SyncVectorEnv)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    envs.reset(seed=0)
    envs.step(np.stack([envs.single_action_space.sample()] * 2))


def test_problems_of_another_dimension_may_come_and_go():
    problem = Problem(Robot.point(), Environment((0.0, 0.0, 2.0, 1.0)), Task((0.3, 0.5), (1.7, 0.5)))
    native, plain = pair(2, distribution="Cup", max_samples=5)
    for envs in (native, plain):
        envs.reset(seed=0)
    ours, theirs = (envs.reset(seed=0, options={"problem": problem}) for envs in (native, plain))
    same(ours[0], theirs[0]), same(ours[1], theirs[1])
    for _ in range(9):  # it is solved at once, and the next ones are those of the distribution
        for a, b in zip(native.step(np.zeros(2, int)), plain.step(np.zeros(2, int)), strict=True):
            same(a, b)


def test_a_partial_reset_leaves_the_others_and_the_callers_options_alone():
    native, _ = pair(3, AutoresetMode.DISABLED, distribution="RandomSimplePassage", max_samples=9)
    native.reset(seed=0)
    before, *_ = native.step(np.zeros(3, int))
    options = {"reset_mask": np.array([False, True, False])}
    after, info = native.reset(seed=[None, 7, None], options=options)
    assert list(options) == ["reset_mask"]
    assert info["_samples"].tolist() == [False, True, False]
    for key, value in after.items():
        assert np.array_equal(value[[0, 2]], before[key][[0, 2]])
    single, _ = GuidedSearchEnv("RandomSimplePassage", max_samples=9).reset(seed=7)
    assert all(np.array_equal(after[key][1], single[key]) for key in single)


def test_a_search_of_a_vector_is_the_search_of_a_single_environment():
    native, _ = pair(2, distribution="TrapCup", max_samples=60)
    native.reset(seed=3)
    env = GuidedSearchEnv("TrapCup", max_samples=60)
    env.reset(seed=4)
    for k in range(50):
        node = k % len(native.search(1).tree)
        native.step(np.array([0, node]))
        env.step(node)
    ours, theirs = native.search(1), env.search
    for name in ("configurations", "parents", "cost_to_come", "depths", "children", "failures", "contacts"):
        assert np.array_equal(getattr(ours.tree, name), getattr(theirs.tree, name)), name
    assert (ours.samples, ours.collision_checks) == (theirs.samples, theirs.collision_checks)
    assert ours.tree.failure_count and np.array_equal(ours.tree.failed_targets, theirs.tree.failed_targets)


def test_copies_are_handed_out():
    native, _ = pair(2, distribution="Cup", max_samples=9)
    first, _ = native.reset(seed=0)
    kept = copy.deepcopy(first)
    second, *_ = native.step(np.zeros(2, int))
    same(first, kept)
    assert not any(np.shares_memory(first[key], second[key]) for key in first)


def test_statistics_of_episodes_are_recorded_over_it():
    envs = RecordEpisodeStatistics(gymnasium.make_vec("guided_gym/Cup-v0", 3, max_samples=6))
    envs.reset(seed=0)
    for _ in range(6):
        *_, info = envs.step(np.zeros(3, int))
    assert info["episode"]["l"].tolist() == [6, 6, 6]


@pytest.mark.parametrize("count", [0, -1, 2.0, True, "2"])
def test_numbers_of_environments_that_are_none_are_refused(count):
    with pytest.raises(InvalidInputError, match="num_envs"):
        make_vector(count, distribution="Cup")


def test_a_million_environments_are_refused_with_what_they_would_take():
    with pytest.raises(InvalidInputError, match=r"num_envs: .* GB of memory at 1000000"):
        gymnasium.make_vec("guided_gym/Cup-v0", num_envs=1_000_000)


def test_the_formula_for_memory_is_what_is_kept():
    native, _ = pair(7, distribution="TrapCup", max_nodes=40, raster=40)
    native.reset(seed=0)
    arrays = [*native._episodes, *native._trees[3], native._raster, native._poses, native._regions]
    kept = sum(array.nbytes for array in arrays)
    assert kept <= vector_bytes(7, 40, 40) <= 1.05 * kept


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda envs: envs.step(np.zeros(3, int)), "actions: expected 2"),
        (lambda envs: envs.step(np.zeros(2)), "actions: expected 2"),
        (lambda envs: envs.reset(seed=[1, 2, 3]), "seed: expected 2"),
        (lambda envs: envs.reset(seed=True), "seed"),
        (lambda envs: envs.reset(options={"reset_mask": [True, False]}), "reset_mask"),
        (lambda envs: envs.reset(options={"reset_mask": np.zeros(2, bool)}), "reset_mask"),
        (lambda envs: envs.reset(options={"problem": 3}), "problem"),
    ],
)
def test_bad_input_is_refused(call, message):
    native, _ = pair(2, distribution="Cup", max_nodes=16)
    native.reset(seed=0)
    with pytest.raises(InvalidInputError, match=message):
        call(native)


def test_what_cannot_be_stepped_says_so():
    native, _ = pair(2, AutoresetMode.DISABLED, distribution="Cup", max_samples=2)
    with pytest.raises(GuidedGymError, match="before its first reset"):
        native.step(np.zeros(2, int))
    with pytest.raises(GuidedGymError, match="all environments before a reset of some"):
        native.reset(options={"reset_mask": np.array([True, False])})
    native.reset(seed=0)
    native.step(np.zeros(2, int)), native.step(np.zeros(2, int))
    with pytest.raises(GuidedGymError, match=r"reset_mask.*have ended"):
        native.step(np.zeros(2, int))
    with pytest.raises(UnknownNameError, match="autoreset_mode"):
        make_vector(2, autoreset_mode="NextSteps")


def test_an_invalid_action_can_raise():
    native = make_vector(2, distribution="Cup", on_invalid="raise")
    native.reset(seed=0)
    with pytest.raises(InvalidInputError, match="in environment 1, got 9"):
        native.step(np.array([0, 9]))
