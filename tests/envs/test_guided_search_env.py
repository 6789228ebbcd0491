"""The environment's contract: actions, rewards, ends of episodes, infos, bad input."""

from __future__ import annotations

import copy
import math
import pickle

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely.geometry import box

from guided_gym import (
    Environment,
    GuidedGymError,
    GuidedSearchEnv,
    GuideSelectionEnv,
    InvalidInputError,
    NoPathError,
    OracleOptions,
    Problem,
    Robot,
    SampledProblems,
    SearchOptions,
    TargetParameters,
    Task,
    UnknownNameError,
    make_guidance,
    sampling_efficiency,
)
from guided_gym.envs.rewards import Choice
from guided_gym.errors import GuidedGymWarning

WALL = box(0.95, 0.0, 1.05, 0.7)


def point_problem(*obstacles, name="room", regions=None):
    """A point robot in a 2 x 1 room, from left to right; a wall with a gap above hides the goal."""
    environment = Environment((0.0, 0.0, 2.0, 1.0), obstacles or (WALL,))
    task = Task((0.3, 0.4), (1.7, 0.4))
    return Problem(Robot.point(), environment, task, name, regions or {})


SEALED = point_problem(box(0.95, 0.0, 1.05, 1.0), name="sealed")
OPEN = Problem(Robot.point(), Environment((0.0, 0.0, 2.0, 1.0), ()), Task((0.3, 0.4), (1.7, 0.4)), "open")


@pytest.fixture(scope="module")
def problem():
    return point_problem()


def make(problem, **options):
    env = GuidedSearchEnv(problem, **{"max_nodes": 32, **options})
    env.reset(seed=0)
    return env


def test_a_step_is_one_sample_rewarded_by_log_q_before_the_expansion(problem):
    env = make(problem)
    for _ in range(8):
        search = env.search
        before = env.measure.distribution()
        node = len(search.tree) - 1
        _, reward, _, _, info = env.step(node)
        assert reward == pytest.approx(math.log(before[node]), abs=1e-9)
        assert info["sampling_efficiency"] == -reward
        assert info["best_possible"] == pytest.approx(-math.log(before.max()), abs=1e-9)
    assert info["samples"] == search.samples == 8
    assert info["tree_size"] == len(search.tree)


@pytest.mark.parametrize("reward", ["efficiency", "jensen_shannon"])
def test_the_best_reward_is_no_negative_zero(problem, reward):
    first = make(problem, reward=reward).step(0)[1]  # the only node there is
    assert first == 0
    assert math.copysign(1.0, first) == 1.0


def test_jensen_shannon_is_between_minus_log_2_and_0(problem):
    env = make(problem, reward="jensen_shannon")
    rewards = [env.step(len(env.search.tree) - 1)[1] for _ in range(10)]
    assert rewards[0] == pytest.approx(0.0)  # one node: P = Q
    assert all(-math.log(2) <= r <= 0 for r in rewards)


@pytest.mark.parametrize("action", [-1, 1, 31, 32, 10**12, np.int64(31)])
def test_an_invalid_action_is_a_noop_that_counts_as_a_sample(problem, action):
    env = make(problem)
    before, _ = env.reset(seed=3)
    after, reward, terminated, truncated, info = env.step(action)
    assert reward == math.log(1e-4)
    assert info["invalid_action"] is True
    assert (info["samples"], info["tree_size"]) == (1, 1)
    assert (terminated, truncated) == (False, False)
    assert all(np.array_equal(before[key], after[key]) for key in before)


def test_invalid_actions_alone_end_an_episode(problem):
    env = make(problem, max_samples=3)
    ends = [env.step(31)[2:4] for _ in range(3)]
    assert ends == [(False, False), (False, False), (False, True)]


def test_on_invalid_raise(problem):
    env = make(problem, on_invalid="raise")
    with pytest.raises(InvalidInputError, match="a node from 0 to 0, got 7"):
        env.step(7)


@pytest.mark.parametrize("action", [1.5, "0", None, np.array([0, 1])])
def test_an_action_of_the_wrong_type_is_refused(problem, action):
    with pytest.raises(InvalidInputError, match="index of a node"):
        make(problem).step(action)


@pytest.mark.parametrize("action", [0, np.int32(0), np.array(0), np.array([0]), False])
def test_anything_that_is_an_index_is_an_action(problem, action):
    assert make(problem).step(action)[4]["invalid_action"] is False


def test_terminates_at_the_goal_with_the_cost_of_the_path(problem):
    env = make(problem, max_nodes=512, expansion="oracle")
    done = False
    while not done:
        q = env.measure.distribution()
        _, _, done, truncated, info = env.step(int(np.argmax(q)))
    assert info["solved"] and not truncated
    path = env.search.path()
    assert info["cost"] == pytest.approx(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def test_steps_after_the_end_change_nothing_and_earn_nothing(problem):
    env = make(problem, max_samples=1)
    first = env.step(0)
    again = env.step(0)
    assert first[3] is True and again[3] is True
    assert again[1] == 0.0 and again[4]["samples"] == 1
    assert all(np.array_equal(first[0][key], again[0][key]) for key in first[0])


def test_truncates_at_max_samples_with_the_tree_within_the_arrays(problem):
    env = make(problem, max_nodes=12, max_samples=11)
    for k in range(11):
        observation, _, terminated, truncated, _ = env.step(0)
        assert observation in env.observation_space
        assert truncated is (k == 10 and not terminated)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**31), st.lists(st.integers(-2, 40), min_size=1, max_size=25))
def test_there_is_always_a_valid_action(seed, actions):
    env = GuidedSearchEnv(point_problem(), max_nodes=32)
    observation, _ = env.reset(seed=seed)
    for action in actions:
        mask = env.action_masks()
        assert mask.dtype == np.bool_ and mask.any()
        assert np.array_equal(observation["action_mask"], mask)
        assert observation in env.observation_space
        observation, reward, terminated, truncated, info = env.step(action)
        assert info["invalid_action"] == (not (0 <= action < 32 and mask[action]))
        assert math.log(1e-4) - 1e-9 <= reward <= 0
        if terminated or truncated:
            break


# A distribution over the nodes as the action ------------------------------------------------------


def test_a_distribution_is_masked_and_normalised_and_rewarded_by_its_divergence(problem):
    env = make(problem, action="distribution")
    for _ in range(5):
        env.step(np.ones(32, np.float32))
    n = len(env.search.tree)
    weights = np.linspace(0, 1, 32, dtype=np.float32)
    q = env.measure.distribution()
    p = weights[:n].astype(float) / weights[:n].astype(float).sum()
    _, reward, _, _, info = env.step(weights)
    assert reward == pytest.approx(-sampling_efficiency(p, q))
    assert info["sampling_efficiency"] == -reward


def test_weights_that_are_all_zero_stand_for_the_uniform_distribution(problem):
    envs = [make(problem, action="distribution") for _ in range(2)]
    weights = np.zeros(32, np.float32), np.ones(32, np.float32)
    for _ in range(10):
        (a, b) = (env.step(w) for env, w in zip(envs, weights, strict=True))
        assert a[1] == b[1] and np.array_equal(a[0]["nodes"], b[0]["nodes"])


def test_all_weight_on_a_node_chooses_it(problem):
    env = make(problem, action="distribution")
    weights = np.zeros(32, np.float32)
    weights[0] = 1
    for _ in range(6):
        env.step(weights)
    assert set(env.search.tree.parents[1:].tolist()) <= {0}
    assert set(env.search.tree.failed_nodes.tolist()) <= {0}


@pytest.mark.parametrize("largest", [5e-324, 1e-300, 1.0, 1e300, np.finfo(np.float64).max])
def test_weights_of_any_size_mean_the_same(problem, largest):
    envs = [make(problem, action="distribution", max_nodes=32) for _ in range(2)]
    for env in envs:
        for _ in range(6):
            env.step(np.ones(32))
    weights = np.where(np.arange(32) % 2, 1.0, 0.5) if largest > 1e-310 else np.ones(32)
    expected, got = envs[0].step(weights), envs[1].step(weights * largest)
    assert got[1] == pytest.approx(expected[1]) and got[4]["invalid_action"] is False
    assert got[4]["sampling_efficiency"] >= 0


@pytest.mark.parametrize("bad", [-1.0, np.nan, np.inf])
def test_weights_that_mean_nothing_are_an_invalid_action(problem, bad):
    env = make(problem, action="distribution")
    weights = np.ones(32, np.float32)
    weights[0] = bad
    _, reward, *_, info = env.step(weights)
    assert reward == math.log(1e-4) and info["invalid_action"]


def test_weights_of_the_wrong_shape_are_refused(problem):
    with pytest.raises(InvalidInputError, match=r"expected 32 weights, got shape \(3,\)"):
        make(problem, action="distribution").step(np.ones(3))


# Problems at reset --------------------------------------------------------------------------------


def test_reset_takes_any_problem_for_one_episode(problem):
    env = GuidedSearchEnv("SimplePassage", max_nodes=32)
    env.reset(seed=0, options={"problem": problem})
    assert env.problem is problem and env.search.space.dimension == 2
    observation, *_ = env.step(0)
    assert observation in env.observation_space
    env.reset()
    assert env.problem.name == "SimplePassage"


def test_a_problem_solved_at_once_terminates_with_the_first_step():
    env = GuidedSearchEnv(OPEN, max_nodes=32)
    observation, info = env.reset(seed=0)
    assert info["solved"] and info["cost"] == pytest.approx(1.4)
    assert env.action_masks().any() and observation in env.observation_space
    _, reward, terminated, truncated, info = env.step(0)
    assert (reward, terminated, truncated, info["samples"]) == (0.0, True, False, 0)


def test_a_problem_without_a_path_is_refused_at_reset(problem):
    env = GuidedSearchEnv(SEALED, max_nodes=32)
    with pytest.raises(NoPathError):
        env.reset(seed=0)
    _, info = env.reset(options={"problem": problem})
    assert not info["solved"]


def test_distributions_draw_again_until_there_is_something_to_search(problem):
    drawn = []

    def draw(rng):
        drawn.append([OPEN, SEALED, problem][min(len(drawn), 2)])
        return drawn[-1]

    env = GuidedSearchEnv(SampledProblems("mixed", draw), max_nodes=32)
    env.reset(seed=0)
    assert env.problem is problem and len(drawn) == 3


def test_a_distribution_of_nothing_but_sealed_rooms_says_so():
    env = GuidedSearchEnv(SampledProblems("hopeless", lambda rng: OPEN), max_nodes=32)
    with pytest.raises(NoPathError, match=r"hopeless.*100 draws"):
        env.reset(seed=0)


# What is in info ----------------------------------------------------------------------------------


def test_info_says_in_which_region_the_chosen_node_is():
    regions = {"left": box(0, 0, 1, 1), "right": box(1, 0, 1.5, 1)}
    env = make(point_problem(regions=regions))
    *_, info = env.step(0)
    assert info["region"] == 0


def test_info_says_how_well_the_oracle_knows_what_is_rewarded(problem):
    said = []
    for oracle in (OracleOptions(), OracleOptions(resolution=(8, 8, 4)[: problem.space.dimension])):
        env = GuidedSearchEnv(problem, max_nodes=32, oracle=oracle)
        _, info = env.reset(seed=0)
        assert info["oracle_error"] == env.measure.oracle.error.mean == env.step(0)[4]["oracle_error"]
        assert env.measure.oracle.options == oracle
        said.append(info["oracle_error"])
    assert 0 < said[0] < 0.01 and said[0] < 0.5 * said[1]


def test_target_in_info_is_q_over_the_observed_tree(problem):
    env = GuidedSearchEnv(problem, max_nodes=32, target_in_info=True)
    _, info = env.reset(seed=0)
    for _ in range(5):
        n = len(env.search.tree)
        assert info["target"].shape == (32,) and info["target"].sum() == pytest.approx(1)
        assert np.array_equal(info["target"][:n], env.measure.distribution())
        assert not info["target"][n:].any()
        *_, info = env.step(n - 1)


def test_nothing_of_the_oracle_is_observed(problem):
    """The same search with another target gives the same observations."""
    sharp, flat = make(problem), make(problem, target=TargetParameters(delta=5.0, tau=5.0))
    for _ in range(10):
        a, b = sharp.step(0), flat.step(0)
        assert all(np.array_equal(a[0][key], b[0][key]) for key in a[0])
    assert "target" not in a[4]


# Bad input ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"distribution": "TrapCap"}, "did you mean 'TrapCup'"),
        ({"expansion": "lazy_prn"}, "did you mean 'lazy_prm'"),
        ({"action": "nodes"}, "did you mean 'node'"),
        ({"reward": "eficiency"}, "did you mean 'efficiency'"),
        ({"on_invalid": "no-op"}, "did you mean 'noop'"),
        ({"render_mode": "rgb_arrays"}, "did you mean 'rgb_array'"),
        ({"max_node": 10}, "did you mean 'max_nodes'"),
        ({"reward": {"regert": 1}}, "did you mean 'regret'"),
    ],
)
def test_unknown_names_come_with_the_nearest(options, message):
    with pytest.raises(UnknownNameError, match=message):
        GuidedSearchEnv(**options)


@pytest.mark.parametrize("cls", [GuidedSearchEnv, GuideSelectionEnv])
def test_an_unknown_option_is_a_type_error_in_the_words_of_python_too(cls):
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'") as caught:
        cls(frameskip=4)
    assert isinstance(caught.value, UnknownNameError)
    with pytest.raises(UnknownNameError, match="unexpected keyword argument 'frameskip'"):
        gymnasium.make(f"guided_gym/{'Cup' if cls is GuidedSearchEnv else 'GuideSelection'}-v0", frameskip=4)
    again = pickle.loads(pickle.dumps(caught.value))
    assert type(again) is type(caught.value) and str(again) == str(caught.value)


def test_the_arrays_follow_the_number_of_samples():
    assert GuidedSearchEnv("Cup", max_samples=1000).max_nodes == 1002
    assert (GuidedSearchEnv("Cup").max_nodes, GuidedSearchEnv("Cup").max_samples) == (256, 254)
    assert GuidedSearchEnv("Cup", max_nodes=12).max_samples == 10


def test_what_a_wrapper_writes_into_the_space_stays_its_own(problem):
    env = make(problem)
    env.observation_space.spaces["raster"] = gymnasium.spaces.Box(-10, 10, (1, 64, 64), np.float32)
    assert env.observation_space["raster"].dtype == np.uint8
    assert env.reset(seed=0)[0] in env.observation_space


def test_a_raster_too_small_for_the_default_network_is_spoken_of():
    with pytest.warns(GuidedGymWarning, match="NatureCNN.*at least 36 cells"):
        GuidedSearchEnv("Cup", raster=35)


@pytest.mark.parametrize("seed", [np.int64(5), np.uint8(5)])
def test_seeds_of_numpy_are_seeds(problem, seed):
    env, other = make(problem), make(problem)
    env.reset(seed=seed)
    other.reset(seed=5)
    assert np.array_equal(env.step(0)[0]["nodes"], other.step(0)[0]["nodes"])
    GuideSelectionEnv(max_samples=5).reset(seed=seed)


@pytest.mark.parametrize("seed", [True, -1, 1.5, "5"])
def test_what_is_no_seed_is_refused(problem, seed):
    for env in (make(problem), GuideSelectionEnv(max_samples=5)):
        with pytest.raises(InvalidInputError, match="seed: expected an integer"):
            env.reset(seed=seed)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"raster": 10**5}, "raster: .*640 GB of memory at 100000.*at most 4 GB; GUIDED_GYM_MAX_MEMORY"),
        ({"candidates": 10**9}, "candidates: .*96 GB"),
        ({"max_samples": 10**30}, "max_nodes: .*more than"),
        ({"max_nodes": 10**9, "target": TargetParameters(epsilon=1e-12)}, "max_nodes: .*61 GB"),
    ],
)
def test_sizes_that_no_memory_holds_are_refused_at_the_door(options, message):
    with pytest.raises(InvalidInputError, match=message):
        GuidedSearchEnv("Cup", **options)


def test_the_limit_of_memory_can_be_raised_and_lowered(monkeypatch):
    monkeypatch.setenv("GUIDED_GYM_MAX_MEMORY", "1e4")
    with pytest.raises(InvalidInputError, match="raster"):
        GuidedSearchEnv("Cup", max_nodes=16)
    monkeypatch.setenv("GUIDED_GYM_MAX_MEMORY", "1e12")
    SearchOptions(candidates=10**9)
    monkeypatch.setenv("GUIDED_GYM_MAX_MEMORY", "much")
    with pytest.raises(InvalidInputError, match="GUIDED_GYM_MAX_MEMORY: expected a number"):
        SearchOptions(candidates=10)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"observe": "a"}, "observe: expected an object with a method build"),
        ({"target_in_info": "a"}, "target_in_info: expected True or False"),
        ({"reward": {}}, "reward: expected names with weights"),
        ({"reward": {"regret": -1}}, "reward"),
        ({"raster": 40.0}, "raster"),
        ({"max_nodes": 10, "max_samples": 10}, "expected at least max_samples \\+ 1 = 11.*got 10"),
        ({"max_nodes": 1}, "max_nodes"),
        ({"max_nodes": 10_000}, "fewer than 1 / epsilon = 10000, got 10000"),
        ({"max_nodes": 8.0}, "max_nodes"),
        ({"max_samples": 0}, "max_samples"),
        ({"raster": 0}, "raster"),
        ({"distribution": 3}, "distribution"),
        ({"expansion": None}, "expansion"),
        ({"reward": 3}, "reward"),
        ({"target": 0.1}, "TargetParameters"),
        ({"target": TargetParameters(epsilon=0)}, "epsilon"),
    ],
)
def test_values_that_cannot_be_used_are_refused(options, message):
    with pytest.raises(InvalidInputError, match=message):
        GuidedSearchEnv(**options)


@pytest.mark.parametrize("options", [{"step": -1.0}, {"step": math.nan}, {"candidates": 0}])
def test_search_options_are_refused_at_reset_at_the_latest(options):
    with pytest.raises(InvalidInputError):
        GuidedSearchEnv("SimplePassage", **options).reset(seed=0)


def test_reset_options_are_checked_before_anything_changes(problem):
    env = make(problem)
    search = env.search
    with pytest.raises(UnknownNameError, match="did you mean 'problem'"):
        env.reset(options={"problems": problem})
    with pytest.raises(InvalidInputError, match="expected a Problem"):
        env.reset(options={"problem": "TrapCup"})
    assert env.search is search


def test_nothing_works_before_the_first_reset():
    env = GuidedSearchEnv(max_nodes=8)
    for use in (lambda: env.step(0), env.action_masks, lambda: env.search):
        with pytest.raises(GuidedGymError, match="reset"):
            use()
    env.close()
    env.close()


# Injected parts -----------------------------------------------------------------------------------


class Constant:
    """The least reward and the least observer: what a user has to write."""

    def __call__(self, choice: Choice) -> float:
        return 1.0 if choice.node == 0 else 2.0

    def worst(self, target: TargetParameters) -> float:
        return -1.0


class TreeSize:
    def build(self, max_nodes, max_samples):
        return gymnasium.spaces.Dict({"nodes": gymnasium.spaces.Discrete(max_nodes + 1)})

    def reset(self, search):
        self.size = 1

    def update(self, search, expansion):
        self.size = len(search.tree)

    def extract(self, search):
        return {"nodes": np.int64(self.size)}


def test_reward_and_observation_can_be_injected(problem):
    env = GuidedSearchEnv(problem, max_nodes=8, reward=Constant(), observe=TreeSize())
    observation, _ = env.reset(seed=0)
    assert observation == {"nodes": 1}
    assert env.step(0)[1] == 1.0
    assert env.step(7)[1] == -1.0


def test_each_environment_has_an_expander_of_its_own(problem):
    guidance = make_guidance("rrt")
    envs = [GuidedSearchEnv(problem, max_nodes=16, expansion=guidance) for _ in range(2)]
    for env in envs:
        env.reset(seed=1)
    trees = []
    for env in envs:
        for _ in range(10):
            env.step(0)
        trees.append(env.search.tree.configurations)
    assert np.array_equal(*trees)


@pytest.mark.parametrize("snapshot", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_as_the_original_does(problem, snapshot):
    env = make(problem, expansion="lazy_prm")
    for _ in range(5):
        env.step(0)
    other = snapshot(env)
    for k in range(10):
        ours, theirs = env.step(k % 3), other.step(k % 3)
        assert ours[1:] == theirs[1:]
        assert all(np.array_equal(ours[0][key], theirs[0][key]) for key in ours[0])


@pytest.mark.parametrize("options", [{}, {"expansion": "lazy_prm"}, {"rewire": True}], ids=str)
def test_a_clone_goes_on_as_the_original_does_and_neither_touches_the_other(problem, options):
    env, reference = make(problem, **options), make(problem, **options)
    for _ in range(5):
        env.step(0), reference.step(0)
    clones = [env.clone() for _ in range(2)]
    assert clones[0].problem is env.problem and clones[0].measure.oracle is env.measure.oracle
    for k in range(8):
        clones[0].step(k % 2)  # elsewhere, and first
    for k in range(10):
        steps = [one.step(k % 3) for one in (reference, env, clones[1])]
        for other in steps[1:]:
            assert other[1:] == steps[0][1:]
            assert all(np.array_equal(steps[0][0][key], other[0][key]) for key in other[0])
    assert env.search.listeners == [] or env.search.listeners[0] is not clones[1].search.listeners[0]
    again = [one.reset() for one in (reference, env, clones[1])]
    assert len({one[0]["nodes"].tobytes() for one in again}) == 1


def test_search_options_reach_the_search(problem):
    env = make(problem, step=0.05, candidates=3, goal_tolerance=0.01, rewire=True)
    assert env.search.options == SearchOptions(0.05, 3, True)
    assert (env.problem.task.tolerance, env.problem.task.by_edge) == (0.01, True)
    assert env.search.planner.step == 0.05


def test_rendering_without_a_mode_warns_and_draws_nothing(problem):
    with pytest.warns(UserWarning, match="render_mode"):
        assert make(problem).render() is None


@pytest.mark.parametrize("cls", [GuidedSearchEnv, GuideSelectionEnv])
@pytest.mark.parametrize("snapshot", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_can_be_made_after_rendering(cls, snapshot):
    pytest.importorskip("pygame")
    env = cls("Cup", max_samples=10, render_mode="rgb_array")
    env.reset(seed=0)
    env.step(0)
    first = env.render()
    other = snapshot(env)
    assert np.array_equal(other.render(), first)
    env.step(0), other.step(0)
    assert np.array_equal(other.render(), env.render())
    env.close(), other.close()


def test_rgb_array_is_a_picture(problem):
    pytest.importorskip("pygame")
    env = make(problem, render_mode="rgb_array")
    frame = env.render()
    assert frame.dtype == np.uint8 and frame.ndim == 3 and frame.shape[2] == 3
    env.close()
    env.close()


def test_one_map_serves_many_starts_and_goals():
    env = GuidedSearchEnv("TrapCup", max_nodes=16)
    map_, (start, goal) = env.distribution.problem(0), ([1.0, 2.0, 0.5], [9.0, 8.0, -1.0])
    env.reset(seed=0, options={"start": start, "goal": goal})
    assert env.problem.space is map_.space
    assert np.array_equal(env.problem.task.start, start) and np.array_equal(env.problem.task.goal, goal)
    env.reset(seed=0, options={"goal": goal})
    assert np.array_equal(env.problem.task.start, map_.task.start)
    env.reset(seed=0)
    assert env.problem.fingerprint == map_.fingerprint  # for one episode
    goals = [[9.0, 8.0, 0.0], [9.0, 2.0, 0.0]]
    seen = []
    for seed in (0, 1, 2, 3, 4, 0):
        env.reset(seed=seed, options={"goals": goals})
        seen.append(tuple(env.problem.task.goal))
    assert seen[0] == seen[-1] and set(seen) == set(map(tuple, goals))
    assert {tuple(env.problem.task.goal) for _ in range(8) if env.reset(options={"goals": goals})} == set(
        seen
    )


@pytest.mark.parametrize(
    "options",
    [
        {"goal": [0.0, 0.0, 0.0]},  # touches the bounds
        {"goal": [1.0, 2.0]},
        {"goals": []},
        {"goals": "here"},
        {"goal": [9.0, 8.0, 0.0], "goals": [[9.0, 8.0, 0.0]]},
        {"start": None},
    ],
    ids=str,
)
def test_tasks_that_cannot_be_posed_are_refused(options):
    env = GuidedSearchEnv("TrapCup", max_nodes=16)
    with pytest.raises(InvalidInputError):
        env.reset(seed=0, options=options)
