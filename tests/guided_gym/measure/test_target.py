"""The metric of a search agrees with the formulas, however the tree has grown."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from guided_gym.errors import InvalidInputError, NoPathError
from guided_gym.measure.oracle import oracle_for
from guided_gym.measure.target import Measure, suboptimality, target
from guided_gym.options import TargetParameters
from guided_gym.problems import Problem
from guided_gym.randomness import streams
from guided_gym.search.search import Search

Walled = Callable[[str], Problem]


def grown(problem: Problem, samples: int) -> Search:
    search = Search(problem, *streams(3)[1:])
    rng = np.random.default_rng(3)
    for _ in range(samples):
        node = search.tree.nearest(sample := search.space.sample(rng, 1)[0])
        search.expand(node, search.planner.steer(search.tree.configurations[node], sample))
    return search


@pytest.mark.parametrize("robot", ["point", "rectangle"])
@pytest.mark.parametrize("normalisation", ["start", "tree"])
def test_measure__agrees_with_the_formulas(walled: Walled, robot: str, normalisation: str) -> None:
    problem = walled(robot)
    parameters = TargetParameters(0.2, 0.3, 1e-3, normalisation)
    search = grown(problem, 120)
    tree, measure = search.tree, Measure(search, parameters)
    oracle = oracle_for(problem.space, problem.task.goal, start=problem.task.start)
    tau = measure.work_remaining
    assert (tau <= oracle.cost_to_go(np.array(tree.configurations)) + 1e-12).all()
    assert np.median(tau / oracle.cost_to_go(np.array(tree.configurations))) == pytest.approx(1, abs=1e-6)
    delta = suboptimality(tree.cost_to_come, tau, measure.optimum)
    assert measure.suboptimality == pytest.approx(delta)
    assert delta[0] == 0
    expected = target(delta, tau, measure.optimum, parameters)
    assert measure.distribution() == pytest.approx(expected)
    for node in (0, 5, len(tree) - 1):
        chosen, best = measure.choice(node)
        assert chosen == pytest.approx(-math.log(expected[node]))
        assert best == pytest.approx(-math.log(expected.max()))


def test_work_remaining__changes_by_no_more_than_an_edge(walled: Walled) -> None:
    search = grown(walled("rectangle"), 150)
    tree, tau = search.tree, Measure(search).work_remaining
    edges = tree.cost_to_come[1:] - tree.cost_to_come[tree.parents[1:]]
    assert (tau[1:] <= tau[tree.parents[1:]] + edges + 1e-9).all()


def test_measure__keeps_up_with_the_tree(walled: Walled) -> None:
    search = grown(walled("rectangle"), 60)
    early = Measure(search)
    before = early.choice(3)
    rng = np.random.default_rng(4)
    n = len(search.tree)
    for _ in range(400):  # beyond its first capacity
        node = search.tree.nearest(sample := search.space.sample(rng, 1)[0])
        search.expand(node, search.planner.steer(search.tree.configurations[node], sample))
    late = Measure(search)
    assert early.distribution() == pytest.approx(late.distribution())
    assert early.choice(3, n) == pytest.approx(before)  # the tree as it stood


def test_measure__refuses_a_problem_without_a_path(closed: Problem) -> None:
    with pytest.raises(NoPathError):
        Measure(Search(closed, *streams(0)[1:]))


@pytest.mark.parametrize(("node", "size"), [(-1, None), (10**6, None), (5, 5), (0, 10**6), (0, 0)])
def test_choice__of_no_node(walled: Walled, node: int, size: int | None) -> None:
    measure = Measure(grown(walled("point"), 30))
    with pytest.raises(InvalidInputError, match="expected a node"):
        measure.choice(node, size)
