"""``info``: always the same keys and types, none of them the observation's, whatever happens."""

from __future__ import annotations

import math

import gymnasium
import numpy as np
import pytest
import shapely

from guided_gym import GuidedSearchEnv, Problem, make_distribution, make_guidance
from guided_gym.envs.guided_search_env import Areas
from guided_gym.registration import ENVIRONMENTS, SELECTIONS

IDS = [*ENVIRONMENTS, *SELECTIONS]
KINDS = {
    "solved": bool,
    "samples": int,
    "tree_size": int,
    "collision_checks": int,
    "invalid_action": bool,
    "sampling_efficiency": float,
    "best_possible": float,
    "cost": float,
    "region": int,
    "oracle_error": float,
}


@pytest.mark.parametrize("name", IDS)
def test_the_same_keys_and_types_at_reset_and_at_each_step(name, options_of):
    env = gymnasium.make(name, max_samples=6, **options_of(name)).unwrapped
    observation, info = env.reset(seed=0)
    for action in (None, 0, 10**6, 0, 0, 0, 0, 0):
        if action is not None:
            observation, *_, info = env.step(action)
        assert {key: type(value) for key, value in info.items()} == KINDS
        assert not (isinstance(observation, dict) and set(info) & set(observation))


def test_nothing_is_said_as_nan_infinity_and_minus_one():
    env = GuidedSearchEnv("TrapCup", max_nodes=32)
    _, info = env.reset(seed=0)
    assert math.isnan(info["sampling_efficiency"]) and math.isnan(info["best_possible"])
    assert info["cost"] == math.inf and info["region"] == -1
    assert env.step(31)[4]["region"] == -1  # invalid: no node was chosen
    _, _, _, _, info = env.step(0)
    assert list(env.problem.regions)[info["region"]] == "trap"
    assert math.isfinite(info["sampling_efficiency"]) and info["cost"] == math.inf


def test_a_region_is_the_first_that_the_node_lies_in():
    problem = make_distribution("TrapCup").problem(0)
    other = Problem(problem.robot, problem.environment, problem.task, regions={})
    env = GuidedSearchEnv(other, max_nodes=32)
    env.reset(seed=0)
    assert env.step(0)[4]["region"] == -1
    names = list(problem.regions)
    env = GuidedSearchEnv(problem, max_nodes=512, expansion=make_guidance("oracle"))
    env.reset(seed=0)
    done = False
    while not done:
        node = int(np.argmax(env.measure.distribution()))
        xy = env.search.tree.configurations[node, :2]
        *_, done, _, info = env.step(node)
        inside = [name for name in names if problem.regions[name].intersects(shapely.Point(xy))]
        assert info["region"] == (names.index(inside[0]) if inside else -1)
    assert math.isfinite(info["cost"])


def test_one_position_is_looked_up_as_many_are_with_boxes_corners_and_holes():
    shapes = {
        "hole": shapely.box(0, 0, 4, 4).difference(shapely.box(1, 1, 3, 3)),
        "box": shapely.box(2, 2, 6, 3),
        "triangle": shapely.Polygon([(5, 0), (8, 0), (8, 4)]),
    }
    problem = make_distribution("TrapCup").problem(0)
    areas = Areas(Problem(problem.robot, problem.environment, problem.task, regions=shapes))
    xy = np.array([(x, y) for x in np.arange(-1, 10, 0.5) for y in np.arange(-1, 6, 0.5)])
    one_by_one = [areas.of(x, y) for x, y in xy.tolist()]
    assert areas.of_many(xy).tolist() == one_by_one and set(one_by_one) == {-1, 0, 1, 2}
    assert areas.of(2.5, 2.5) == 1 and areas.of(1, 1) == 0 and areas.of(5, 3) == 1 and areas.of(5.5, 1) == -1
