"""Roadmaps that ignore obstacles, and learn from collisions; and one that does not."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import networkx as nx
import numpy as np
import pytest

from guided_gym.errors import InvalidInputError
from guided_gym.guidance.composed import Composed
from guided_gym.guidance.registry import make_guidance
from guided_gym.guidance.solvers.graph import Graph
from guided_gym.guidance.solvers.roadmap import Roadmap
from guided_gym.kernels.metric import segment_separation
from guided_gym.planning import guided_search
from guided_gym.problems import Problem
from guided_gym.randomness import streams
from guided_gym.search.search import Search

Walled = Callable[[str], Problem]


def fresh_distances(graph: Graph) -> np.ndarray:
    """networkx's Dijkstra on the graph as it stands."""
    found = nx.single_source_dijkstra_path_length(graph.as_networkx(), graph.goal)
    return np.array([found.get(v, np.inf) for v in range(len(graph.points))])


def run(name: str, problem: Problem, samples: int, seed: int = 0, **options: Any) -> tuple[Roadmap, Search]:
    """A search of some samples, and its roadmap."""
    guidance = make_guidance(name, **options)
    assert isinstance(guidance, Composed) and isinstance(guidance.solver, Roadmap)
    search = Search(problem, *streams(seed)[1:])
    search.attach(guidance)
    grow(search, samples)
    return guidance.solver, search


def grow(search: Search, samples: int) -> None:
    guidance: Any = search.listeners[0]
    for _ in range(samples):
        node = guidance.select(search.tree)
        search.expand(node, guidance.propose(search.tree, node))


@pytest.mark.parametrize("robot", ["point", "rectangle"])
def test_lazy__distances_after_failures_equal_a_fresh_dijkstra(walled: Walled, robot: str) -> None:
    solver, search = run("lazy_prm", walled(robot), 0, vertices=250, neighbours=6)
    graph = solver.graph
    assert graph.distance == pytest.approx(fresh_distances(graph))
    before, seen = graph.distance.copy(), 0
    for _ in range(80):
        grow(search, 1)
        if solver.graph is not graph:
            graph, before = solver.graph, np.zeros(0)
        if search.tree.failure_count > seen and search.tree.failure_count % 5 == 1:
            assert solver.graph.distance == pytest.approx(fresh_distances(solver.graph))
        seen = search.tree.failure_count
    assert seen > 3
    assert graph.distance == pytest.approx(fresh_distances(graph))
    if before.size:
        assert (graph.distance >= before - 1e-12).all()  # failures only take away


def test_lazy__ignores_obstacles_at_first(walled: Walled) -> None:
    solver, _ = run("lazy_prm", walled("rectangle"), 0, vertices=1000)
    graph = solver.graph
    assert not walled("rectangle").space.valid(graph.points).all()
    assert np.isfinite(graph.multipliers).all()
    assert graph.points[graph.goal].tolist() == walled("rectangle").task.goal.tolist()
    assert graph.distance[graph.goal] == 0
    assert solver.looks == 0


def test_lazy__a_collision_takes_the_edges_and_anchors_near_it(walled: Walled) -> None:
    problem = walled("rectangle")
    solver, search = run("lazy_prm", problem, 0, vertices=500, reach=0.3)
    search.expand(0, np.array([4.0, 5.0, 0.0]))
    unit = problem.space.scale
    failed = search.expand(1, np.array([4.6, 5.0, 0.0]))
    assert failed.contact is not None
    graph = solver.graph
    # The nearer of two ways round in the angle: an edge across the seam is not where its ends' mean is.
    tails = graph.points[graph.edges[:, 0]]
    heads = tails + problem.space.difference(tails, graph.points[graph.edges[:, 1]])
    away = [
        segment_separation(a, b, failed.contact, problem.space.metric)
        for a, b in zip(tails, heads, strict=True)
    ]
    at_contact = np.array(away) <= 0.3 * unit
    assert at_contact.any()
    assert np.isinf(graph.multipliers[at_contact]).all()
    near = problem.space.distance(graph.points, failed.contact) <= 1.5 * unit
    bad = near & ~problem.space.valid(graph.points)
    assert bad.any()
    assert np.isinf(graph.distance[bad]).all()
    good = problem.space.valid(graph.points) & (
        problem.space.distance(graph.points, failed.contact) > 2 * unit
    )
    assert np.isfinite(graph.distance[good]).mean() > 0.95


def test_lazy__is_renewed_when_everything_is_cut(walled: Walled) -> None:
    solver, search = run("lazy_prm", walled("rectangle"), 3, vertices=100)
    first = solver.graph
    first.raise_edges(np.arange(len(first.edges)), np.inf)
    assert np.isinf(np.delete(first.distance, first.goal)).all()
    values = search.listeners[0].values(search.tree)  # type: ignore[attr-defined]
    assert solver.graph is not first
    assert len(solver.graph.points) > len(first.points)
    assert np.isfinite(values).any()


def test_lazy__renewals_come_to_an_end(closed: Problem) -> None:
    solver, search = run("lazy_prm", closed, 400, vertices=50)
    assert len(solver.graph.points) <= 50 * 1.5**6 + 1
    assert len(search.tree) > 10  # it goes on all the same


def test_lazy__collisions_survive_a_renewal(walled: Walled) -> None:
    solver, search = run("lazy_prm", walled("rectangle"), 30, vertices=300)
    assert search.tree.failure_count > 0
    first, space = solver.graph, walled("rectangle").space
    first.raise_edges(np.arange(len(first.edges)), np.inf)
    checks = search.collision_checks
    grow(search, 1)
    assert solver.graph is not first
    assert search.collision_checks > checks + 10  # what is looked at again counts again
    looked_at = 0
    for contact in search.tree.contacts:
        near = space.distance(solver.graph.points, contact) <= 1.5 * space.scale
        bad = near & ~space.valid(solver.graph.points)
        looked_at += bad.sum()
        assert np.isinf(solver.graph.distance[bad]).all()
    assert looked_at > 0


def test_validated__edges_and_anchors_are_free(walled: Walled) -> None:
    problem = walled("rectangle")
    solver, search = run("prm", problem, 20, vertices=200)
    graph = solver.graph
    assert problem.space.valid(graph.points).all()
    alive = np.isfinite(graph.multipliers)
    a, b = graph.points[graph.edges[:, 0]], graph.points[graph.edges[:, 1]]
    assert problem.space.motions_free(a, b).all()
    assert alive.all()
    assert graph.distance == pytest.approx(fresh_distances(graph))
    anchors = solver.anchor(np.array(search.tree.configurations))
    for i, q in enumerate(search.tree.configurations):
        for v, length in zip(anchors.vertices[i], anchors.lengths[i], strict=True):
            if np.isfinite(length):
                assert problem.space.motion_free(q, graph.points[v])
                assert length == pytest.approx(problem.space.distance(q, graph.points[v]))


def test_values__are_the_best_anchor_plus_its_distance(walled: Walled) -> None:
    problem = walled("point")
    solver, search = run("lazy_prm", problem, 40, vertices=200, expansion_penalty=0.0)
    values = search.listeners[0].values(search.tree)  # type: ignore[attr-defined]
    space, points = problem.space, solver.graph.points
    assert search.tree.failure_count > 0
    for node, q in enumerate(search.tree.configurations):
        least = np.inf
        for v in np.argsort(space.distance(points, q), kind="stable")[:4]:
            refuted = any(
                segment_separation(q, points[v], contact, space.metric) <= 0.2 * space.scale
                for contact in search.tree.contacts
            )
            if not refuted:
                least = min(least, space.distance(points[v], q) + solver.graph.distance[v])
        assert values[node] == pytest.approx(least)


@pytest.mark.parametrize("name", ["prm", "lazy_prm"])
@pytest.mark.parametrize("options", [{"vertices": 1}, {"vertices": 3}, {"vertices": 20, "neighbours": 50}])
def test_roadmap__of_hardly_any_vertices(walled: Walled, name: str, options: dict) -> None:
    result = guided_search(
        walled("rectangle"), make_guidance(name, **options), seed=0, max_samples=40, measure=False
    )
    assert result.samples > 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"vertices": 0},
        {"neighbours": 0},
        {"anchors": 0},
        {"reach": -0.1},
        {"reach": np.nan},
        {"check": -1.0},
        {"factor": 0.5},
        {"factor": np.nan},
        {"node": 3},
    ],
)
def test_lazy__refuses_what_makes_no_sense(wrong: dict) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        make_guidance("lazy_prm", **wrong)
