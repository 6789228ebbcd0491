"""Searches that end in a region around the goal, and only there: the rule of other benchmarks."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from guided_gym.catalogue.distributions import SampledProblems
from guided_gym.errors import InvalidInputError, NoPathError
from guided_gym.planning import guided_search
from guided_gym.problems import Problem
from guided_gym.randomness import streams
from guided_gym.search.search import Search

REGION = (0.8, False)  # tolerance, by_edge


@pytest.mark.parametrize("guidance", ["rrt", "goal_distance"])  # one grows in compiled bursts, one does not
def test_a_visible_goal__is_not_enough(room: Problem, guidance: str) -> None:
    assert guided_search(room, guidance, seed=0).samples == 0  # sees the goal from the start
    result = guided_search(room.ending(*REGION), guidance, seed=0, max_samples=3000)
    assert result.solved and result.samples > 10
    assert result.path is not None
    away = room.space.distance(result.tree.configurations, room.task.goal)
    assert away[-1] <= 0.8 < away[:-1].min()
    assert (result.path[-1] == result.tree.configurations[-1]).all()  # ends in the region
    assert result.collision_checks == result.samples  # nobody looked at the goal


def test_a_start_in_the_region__is_a_path_of_one_node(room: Problem) -> None:
    search = Search(room.ending(20.0, by_edge=False), *streams(0)[1:])
    path = search.path()
    assert path is not None and path.tolist() == [[1.0, 1.0]]


def test_bursts_and_single_samples_agree(walled: Callable[[str], Problem]) -> None:
    problem = walled("point").ending(*REGION)
    burst = guided_search(problem, "rrt", seed=3, measure=False)
    single = guided_search(problem, "rrt", seed=3, measure=False, distributions=True)
    assert burst.samples > 0
    assert (burst.tree.configurations == single.tree.configurations).all()
    assert burst.collision_checks == single.collision_checks


def test_tasks__need_a_way_to_end(room: Problem) -> None:
    with pytest.raises(InvalidInputError, match="without goal_edge"):
        room.task.ending(by_edge=False)
    for tolerance in (-1.0, np.nan, "near"):
        with pytest.raises(InvalidInputError, match="goal_tolerance"):
            room.ending(tolerance)  # type: ignore[arg-type]
    with pytest.raises(InvalidInputError, match="goal_edge"):
        room.ending(by_edge=1)  # type: ignore[arg-type]


def test_draws__keep_problems_whose_goal_is_in_sight_if_that_does_not_solve_them(room: Problem) -> None:
    rooms = SampledProblems("Rooms", lambda rng: room)
    drawn = rooms.draw(np.random.default_rng(0), 0.05, by_edge=False)
    assert drawn.space is room.space and not drawn.task.by_edge
    with pytest.raises(NoPathError, match="needs a search"):
        rooms.draw(np.random.default_rng(0))
