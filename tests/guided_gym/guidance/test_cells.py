"""Guiding spaces that modify nothing: hand-worked choices."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from guided_gym.errors import InvalidInputError
from guided_gym.guidance.base import draw
from guided_gym.guidance.cells import Uninformed, Voronoi
from guided_gym.guidance.registry import make_guidance
from guided_gym.measure.oracle import oracle_for
from guided_gym.planning import guided_search
from guided_gym.problems import Problem
from guided_gym.randomness import streams
from guided_gym.search.search import Search

Walled = Callable[[str], Problem]


def started(problem: Problem, guidance: object, *nodes: tuple[float, ...]) -> Search:
    """A search whose tree is the start and then these nodes, each a child of the start."""
    search = Search(problem, *streams(0)[1:])
    search.attach(guidance)  # type: ignore[arg-type]
    for q in nodes:
        search.tree.add(np.array(q), 0, 1.0)
    return search


def test_uninformed__is_uniform(room: Problem) -> None:
    guidance = Uninformed()
    search = started(room, guidance, (2, 2), (3, 3), (4, 4))
    assert guidance.distribution(search.tree).tolist() == [0.25] * 4
    counts = np.bincount([guidance.select(search.tree) for _ in range(4000)], minlength=4)
    assert counts / 4000 == pytest.approx([0.25] * 4, abs=0.04)
    assert guidance.values(search.tree).tolist() == [0, 0, 0, 0]


def test_goal_distance__hand_worked(room: Problem) -> None:
    guidance = make_guidance("goal_distance")
    search = started(room, guidance, (9, 5), (6, 5), (5, 9))
    h = np.hypot(*(search.tree.configurations - [9, 9]).T)
    penalty = 0.1 * search.planner.step
    h[0] += 3 * penalty
    assert guidance.values(search.tree) == pytest.approx(h)
    assert guidance.select(search.tree) == 1  # 4, and the first of the two
    search.expand(1, np.array([9.0, 5.1]))
    assert guidance.values(search.tree)[1] == pytest.approx(4 + penalty)
    assert guidance.select(search.tree) == 4


def test_oracle__is_the_true_distance_and_infinite_in_collision(walled: Walled) -> None:
    problem = walled("point")
    guidance = make_guidance("oracle")
    search = started(problem, guidance, (2, 5), (4, 8))
    oracle = oracle_for(problem.space, problem.task.goal, start=problem.task.start)
    q = np.array([[2.0, 5.0], [5.0, 5.0], [4.0, 8.0]])
    h = guidance.heuristic(guidance.project(search.tree, q))
    assert h[[0, 2]] == pytest.approx(oracle.cost_to_go(q[[0, 2]]))
    assert h[1] == np.inf


def test_voronoi__has_the_volumes_of_its_cells(room: Problem) -> None:
    guidance = Voronoi(cell_samples=20000)
    search = started(room, guidance, (9, 1))  # the cells part at x = 5
    assert guidance.distribution(search.tree) == pytest.approx([0.5, 0.5], abs=0.02)
    search.tree.add(np.array([9.0, 9.0]), 0, 1.0)
    # Bisectors of (1, 1), (9, 1), (9, 9): x = 5, y = 5 and x + y = 10.
    assert guidance.distribution(search.tree) == pytest.approx([0.375, 0.25, 0.375], abs=0.02)
    assert guidance.values(search.tree) == pytest.approx(1 / guidance.distribution(search.tree))


def test_voronoi__selects_the_nearest_and_steers_to_the_sample(room: Problem) -> None:
    guidance = Voronoi()
    search = started(room, guidance, (9, 1), (9, 9), (5, 5))
    for _ in range(50):
        node = guidance.select(search.tree)
        target = guidance.propose(search.tree, node)
        assert search.tree.nearest(target) == node  # half a step cannot leave a cell here
        assert search.space.distance(search.tree.configurations[node], target) <= search.planner.step + 1e-9


def test_voronoi__takes_the_goal_as_often_as_its_bias(walled: Walled) -> None:
    guidance = Voronoi(goal_bias=0.5)
    search = started(walled("point"), guidance)
    towards = 0
    for _ in range(400):
        guidance.propose(search.tree, guidance.select(search.tree))
        towards += int((guidance._sample == search.goal).all())
    assert 150 < towards < 250


def test_voronoi__proposes_within_the_cell_of_a_node_that_another_chose(room: Problem) -> None:
    guidance = Voronoi()
    search = started(room, guidance, (9, 1), (9, 9))
    seen = [guidance.propose(search.tree, 1) for _ in range(30)]
    assert all(search.tree.nearest(q) == 1 for q in seen)


@pytest.mark.parametrize("wrong", [{"goal_bias": 1.0}, {"goal_bias": -0.1}, {"cell_samples": 0}])
def test_voronoi__refuses_what_makes_no_sense(wrong: dict) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        make_guidance("rrt", **wrong)


def test_draw__never_draws_what_has_no_probability() -> None:
    rng = np.random.default_rng(0)
    p = np.array([0.0, 0.25, 0.0, 0.75, 0.0])
    drawn = np.bincount([draw(p, rng) for _ in range(4000)], minlength=5) / 4000
    assert drawn == pytest.approx(p, abs=0.03)
    assert (drawn[p == 0] == 0).all()


def test_oracle_guidance__is_the_best_of_them(walled: Walled) -> None:
    totals = {
        name: np.mean([guided_search(walled("rectangle"), name, seed=s).total_efficiency for s in range(5)])
        for name in ("oracle", "rrt", "goal_distance", "uninformed")
    }
    assert min(totals, key=totals.__getitem__) == "oracle"  # type: ignore[arg-type]
