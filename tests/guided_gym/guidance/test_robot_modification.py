"""The medial axis guides a point through the workspace, and its edges get dearer with failures."""

from __future__ import annotations

from collections.abc import Callable

import networkx as nx
import numpy as np
import pytest

from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.guidance.composed import Composed
from guided_gym.guidance.registry import make_guidance
from guided_gym.guidance.solvers.graph import Graph
from guided_gym.problems import Problem, Task
from guided_gym.randomness import streams
from guided_gym.search.search import Search

Walled = Callable[[str], Problem]


def started(problem: Problem, **options: float) -> tuple[Composed, Search]:
    guidance = make_guidance("medial_axis", **options)
    assert isinstance(guidance, Composed)
    search = Search(problem, *streams(0)[1:])
    search.attach(guidance)
    return guidance, search


def graph_of(guidance: Composed) -> Graph:
    graph = guidance.solver.graph
    assert isinstance(graph, Graph)
    return graph


def test_heuristic__hand_worked_in_a_corridor() -> None:
    # The skeleton's middle line runs from (1, 1) to (19, 1); everything projects onto it.
    corridor = Environment((0.0, 0.0, 20.0, 2.0))
    problem = Problem(Robot.point(), corridor, Task((3.0, 1.5), (15.0, 0.5)))
    guidance, search = started(problem, expansion_penalty=0.0)
    q = np.array([[3.0, 1.5], [10.0, 1.0], [15.0, 1.7], [17.0, 0.4]])
    h = guidance.heuristic(guidance.project(search.tree, q))
    assert h == pytest.approx([12, 5, 0, 2], abs=0.15)
    graph = graph_of(guidance)
    assert graph.points[graph.goal] == pytest.approx([15, 1], abs=0.1)


@pytest.mark.parametrize("robot", ["point", "rectangle"])
def test_weight__rises_after_a_failure_and_only_then(walled: Walled, robot: str) -> None:
    problem = walled(robot)
    guidance, search = started(problem, factor=1.5)
    graph = graph_of(guidance)
    rng = np.random.default_rng(0)
    expected = np.ones(len(graph.edges))
    failures = 0
    for _ in range(60):
        node = int(rng.integers(len(search.tree)))
        step = search.planner.uniform(search.tree.configurations[node])
        if rng.random() < 0.3:
            step = search.space.sample(rng, 1)[0]  # far, and often into something
        edge = guidance.solver.anchor(search.tree.configurations[node : node + 1, :2]).edges[0, 0]
        if search.expand(node, step).failed:
            expected[edge] += 0.5
            failures += 1
        assert graph.multipliers == pytest.approx(expected)
    assert failures > 5
    found = nx.single_source_dijkstra_path_length(graph.as_networkx(), graph.goal)
    fresh = np.array([found.get(v, np.inf) for v in range(len(graph.points))])
    assert graph.distance == pytest.approx(fresh)


def test_values__follow_the_weights(walled: Walled) -> None:
    guidance, search = started(walled("point"), factor=4.0, expansion_penalty=0.0)
    before = guidance.values(search.tree)[0]
    search.expand(0, np.array([5.0, 5.0]))  # into the wall
    assert guidance.values(search.tree)[0] > before


def test_projection__into_an_obstacle_is_no_state(walled: Walled) -> None:
    guidance, search = started(walled("point"))
    h = guidance.heuristic(guidance.project(search.tree, np.array([[5.0, 5.0], [2.0, 5.0]])))
    assert h[0] == np.inf
    assert np.isfinite(h[1])


def test_projection__does_not_ask_for_the_angle(walled: Walled) -> None:
    guidance, search = started(walled("rectangle"))
    q = np.array([[2.0, 4.0, angle] for angle in (-3.0, 0.0, 1.0, 3.0)])
    h = guidance.heuristic(guidance.project(search.tree, q))
    assert (h == h[0]).all()


def test_goal__elsewhere_gives_another_roadmap(walled: Walled) -> None:
    base = walled("point")
    other = Problem(base.robot, base.environment, Task((8.5, 5.0), (1.5, 5.0)))
    guidance, search = started(base, expansion_penalty=0.0)
    there = guidance.values(search.tree)[0]
    guidance, search = started(other, expansion_penalty=0.0)
    assert guidance.values(search.tree)[0] == pytest.approx(there, rel=0.02)  # the same way back


@pytest.mark.parametrize("wrong", [{"factor": 0.9}, {"factor": -1.0}, {"spacing": 0.0}, {"spacing": np.inf}])
def test_medial_axis__refuses_what_makes_no_sense(wrong: dict) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        make_guidance("medial_axis", **wrong)
