"""Environments with arms: what is observed of joints, the same one by one and compiled, and pictures."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
import pytest
import shapely

from guided_gym import (
    Environment,
    GuidedSearchEnv,
    InvalidInputError,
    Linkage,
    OracleOptions,
    Problem,
    Task,
    guided_search,
    make_distribution,
    node_table,
)
from guided_gym.envs.observations import columns_of, node_columns
from guided_gym.guidance.registry import make_guidance

QUICK = OracleOptions(resolution=(1000,))


def test_columns_have_names_for_any_number_of_angles():
    assert len(node_columns(1)) == 14 and node_columns(1)[:4] == ("X", "Y", "COS", "SIN")
    names = node_columns(4)
    assert len(names) == len(set(names)) == columns_of(4) == 26
    assert names[:4] == ("X", "Y", "COS_1", "SIN_1") and names[-6] == "GOAL_DISTANCE"


def test_each_column_by_hand():
    arm = Linkage.arm([2.0, 1.0], base=(5.0, 5.0), limits=[None, 2.0])
    wall = shapely.box(8.5, 4.0, 9.0, 6.0)
    problem = Problem(arm, Environment((0, 0, 10, 10), (wall,)), Task((0.0, 0.0), (math.pi / 2, 1.0)))
    env = GuidedSearchEnv(problem, max_nodes=8, oracle=QUICK)
    observation, _ = env.reset(seed=0)
    root = dict(zip(node_columns(2), node_table(observation, columns_of(2))[0].tolist(), strict=True))
    goal = arm.position(np.array([math.pi / 2, 1.0]))
    assert (root["X"], root["Y"]) == pytest.approx((0.6, 0.0))  # the tool, at (8, 5)
    assert (root["GOAL_X"], root["GOAL_Y"]) == pytest.approx(tuple((goal - [8.0, 5.0]) / 10.0))
    assert [root[f"{f}_{k}"] for k in (1, 2) for f in ("COS", "SIN")] == [1.0, 0.0, 1.0, 0.0]
    assert root["GOAL_SIN_1"] == pytest.approx(1.0) and root["GOAL_COS_2"] == pytest.approx(math.cos(1.0))
    # Joint 1 turns by half a turn at most, joint 2 has limits 4 apart; weights 3 and 1.
    diameter = math.hypot(3.0 * math.pi, 1.0 * 4.0)
    assert root["GOAL_DISTANCE"] == pytest.approx(math.hypot(3.0 * math.pi / 2, 1.0) / diameter)
    assert root["CLEARANCE"] == pytest.approx(0.5 / 5.0)
    assert observation["start"] == pytest.approx([0.6, 0.0, 1.0, 0.0, 1.0, 0.0])


@pytest.mark.parametrize("name", ["PlanarArm4", "RandomPlanarArm4"])
def test_compiled_environments_do_the_same(name):
    plain = [GuidedSearchEnv(name, max_nodes=48, oracle=QUICK) for _ in range(2)]
    envs = gymnasium.make_vec(f"guided_gym/{name}-v0", 2, max_nodes=48, oracle=QUICK)
    seen, _ = envs.reset(seed=[3, 4])
    each = [env.reset(seed=seed)[0] for env, seed in zip(plain, (3, 4), strict=True)]
    rng = np.random.default_rng(0)
    for _ in range(30):
        for i, observation in enumerate(each):
            for key, value in observation.items():
                np.testing.assert_array_equal(seen[key][i], value, err_msg=key)
        actions = rng.integers([int(observation["action_mask"].sum()) for observation in each])
        seen, rewards, *_ = envs.step(actions)
        steps = [env.step(int(action)) for env, action in zip(plain, actions, strict=True)]
        each = [step[0] for step in steps]
        assert rewards.tolist() == [step[1] for step in steps]
    envs.close()


def test_an_environment_for_fewer_angles_says_so():
    problem = make_distribution("PlanarArm4").problem(0)
    env = gymnasium.make("guided_gym/Cup-v0", oracle=QUICK).unwrapped
    with pytest.raises(InvalidInputError, match=r"at most 1 angles.*TreeObservation\(angles=4\)"):
        env.reset(options={"problem": problem})
    rigid = make_distribution("Cup").problem(0)
    observation, _ = GuidedSearchEnv("PlanarArm4").reset(options={"problem": rigid})
    assert observation["start"].shape == (10,)  # one angle, and three that it does not have
    assert observation["start"][4:].tolist() == [1.0, 0.0] * 3


def test_an_arm_of_nine_links_works():
    arm = Linkage.arm([0.5] * 9, 0.05, base=(5.0, 5.0), limits=2.5)
    environment = Environment((0, 0, 10, 10), (shapely.box(6, 6, 7, 7),))
    problem = Problem(arm, environment, Task(np.zeros(9), np.full(9, -0.3)))
    env = GuidedSearchEnv(problem, max_nodes=16, oracle=QUICK)
    observation, _ = env.reset(seed=0)
    assert observation in env.observation_space
    assert env.step(0)[0] in env.observation_space


def test_figure_1_leads_astray_but_finds_the_way():
    """The way without the second obstacle collides with it; who takes its length for h still gets there."""
    problem = make_distribution("PlanarArm2").problem(0)
    space, task = problem.space, problem.task
    without = Environment(problem.environment.bounds, problem.environment.obstacles[:1])
    assert not space.motion_free(task.start, task.goal)
    assert Problem(problem.robot, without, task).space.motion_free(task.start, task.goal)
    result = guided_search(
        problem, "roadmap(environment=without(1))", seed=0, max_samples=2000, measure=False
    )
    assert result.path is not None
    assert space.motions_free(result.path[:-1], result.path[1:]).all()


def test_frames_show_the_arm():
    pytest.importorskip("pygame")
    env = GuidedSearchEnv("PlanarArm4", max_nodes=16, render_mode="rgb_array", oracle=QUICK)
    env.reset(seed=0)
    before = env.render()
    for _ in range(10):
        env.step(0)
    after = env.render()
    assert before.shape == after.shape and (before != after).any()
    env.close()


def test_figures_show_the_arm():
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure

    from guided_gym.train.workspace_axes import draw_guiding_space, draw_path

    problem = make_distribution("PlanarArm2").problem(0)
    guidance = make_guidance("goal_distance")
    result = guided_search(problem, "prm", seed=0, max_samples=500, measure=False)
    assert result.path is not None
    axes = Figure().subplots()
    draw_path(axes, problem, result.path)
    assert len(axes.lines) == 1 and len(axes.patches) >= 2  # two links at a time
    env = GuidedSearchEnv(problem, max_nodes=16, oracle=QUICK)
    env.reset(seed=0)
    env.attach(guidance)
    assert draw_guiding_space(Figure().subplots(), guidance, env.search, "red") is None
