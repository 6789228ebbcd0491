"""Roadmaps that ignore obstacles, and learn from collisions; and one that does not."""

from __future__ import annotations

from collections.abc import Callable

import networkx as nx
import numpy as np
import pytest

from guided_gym.errors import InvalidInputError
from guided_gym.guidance.environment_modification import PRM, LazyPRM
from guided_gym.guidance.registry import make_guidance
from guided_gym.guidance.solvers.roadmap import Roadmap
from guided_gym.planning import guided_search
from guided_gym.problems import Problem
from guided_gym.randomness import streams
from guided_gym.search.search import Search

Walled = Callable[[str], Problem]


def fresh_distances(roadmap: Roadmap) -> np.ndarray:
    """networkx's Dijkstra on the roadmap's public graph."""
    found = nx.single_source_dijkstra_path_length(roadmap.graph(), roadmap.goal)
    return np.array([found.get(v, np.inf) for v in range(len(roadmap.points))])


def run(guidance: LazyPRM | PRM, problem: Problem, samples: int, seed: int = 0) -> Search:
    search = Search(problem, *streams(seed)[1:])
    search.attach(guidance)
    for _ in range(samples):
        node = guidance.select(search.tree)
        search.expand(node, guidance.propose(search.tree, node))
    return search


@pytest.mark.parametrize("robot", ["point", "rectangle"])
def test_lazy_prm__distances_after_failures_equal_a_fresh_dijkstra(walled: Walled, robot: str) -> None:
    guidance = LazyPRM(vertices=250, neighbours=6)
    search = run(guidance, walled(robot), 0)
    roadmap = guidance.roadmap
    assert roadmap.distance == pytest.approx(fresh_distances(roadmap))
    before = roadmap.distance.copy()
    failures = 0
    for _ in range(80):
        node = guidance.select(search.tree)
        failed = search.expand(node, guidance.propose(search.tree, node)).failed
        failures += failed
        if guidance.roadmap is not roadmap:
            roadmap, before = guidance.roadmap, np.zeros(0)
        if failed and failures % 5 == 1:
            assert guidance.roadmap.distance == pytest.approx(fresh_distances(guidance.roadmap))
    assert failures > 3
    assert roadmap.distance == pytest.approx(fresh_distances(roadmap))
    if before.size:
        assert (roadmap.distance >= before - 1e-12).all()  # failures only take away


def test_lazy_prm__ignores_obstacles_at_first(walled: Walled) -> None:
    guidance = LazyPRM(vertices=1000)
    run(guidance, walled("rectangle"), 0)
    space = walled("rectangle").space
    vertices = guidance.roadmap.points
    assert not space.valid(vertices).all()
    assert np.isfinite(guidance.roadmap.multipliers).all()
    assert guidance.roadmap.points[guidance.roadmap.goal].tolist() == walled("rectangle").task.goal.tolist()
    assert guidance.roadmap.distance[guidance.roadmap.goal] == 0


def test_lazy_prm__a_collision_takes_the_edges_and_anchors_near_it(walled: Walled) -> None:
    guidance = LazyPRM(vertices=500)
    problem = walled("rectangle")
    search = run(guidance, problem, 0)
    search.expand(0, np.array([4.0, 5.0, 0.0]))
    step = search.planner.step
    failed = search.expand(1, np.array([4.6, 5.0, 0.0]))
    assert failed.contact is not None
    roadmap = guidance.roadmap
    middles = roadmap.points[roadmap.edges].mean(axis=1)
    straight = np.abs(np.diff(roadmap.points[roadmap.edges][:, :, 2], axis=1)).ravel() < 3
    at_contact = straight & (problem.space.distance(middles, failed.contact) <= 0.1 * step)
    assert np.isinf(roadmap.multipliers[at_contact]).all()
    near = problem.space.distance(roadmap.points, failed.contact) <= 1.5 * step
    bad = near & ~problem.space.valid(roadmap.points)
    assert bad.any()
    assert np.isinf(roadmap.distance[bad]).all()
    good = problem.space.valid(roadmap.points) & (
        problem.space.distance(roadmap.points, failed.contact) > 2 * step
    )
    assert np.isfinite(roadmap.distance[good]).mean() > 0.95


def test_lazy_prm__is_renewed_when_everything_is_cut(walled: Walled) -> None:
    guidance = LazyPRM(vertices=100)
    search = run(guidance, walled("rectangle"), 3)
    first = guidance.roadmap
    first.remove(np.arange(len(first.edges), dtype=np.int32))
    guidance.forget()
    assert np.isinf(np.delete(first.distance, first.goal)).all()
    guidance.select(search.tree)
    assert guidance.rebuilds >= 1
    assert guidance.roadmap is not first
    assert len(guidance.roadmap.points) > len(first.points)
    assert np.isfinite(guidance.values(search.tree)).any()


def test_lazy_prm__renewals_come_to_an_end(closed: Problem) -> None:
    guidance = LazyPRM(vertices=50)
    search = run(guidance, closed, 400)
    assert guidance.rebuilds <= 6
    assert len(guidance.roadmap.points) <= 50 * 1.5**6 + 1
    assert len(search.tree) > 10  # it goes on all the same


def test_lazy_prm__collisions_survive_a_renewal(walled: Walled) -> None:
    guidance = LazyPRM(vertices=300)
    search = run(guidance, walled("rectangle"), 30)
    assert search.tree.failure_count > 0
    guidance._renew()
    space = walled("rectangle").space
    for contact in search.tree.contacts:
        near = space.distance(guidance.roadmap.points, contact) <= 1.5 * search.planner.step
        bad = near & ~space.valid(guidance.roadmap.points)
        assert np.isinf(guidance.roadmap.distance[bad]).all()


def test_prm__edges_and_anchors_are_free(walled: Walled) -> None:
    problem = walled("rectangle")
    guidance = PRM(vertices=200)
    search = run(guidance, problem, 20)
    roadmap = guidance.roadmap
    assert problem.space.valid(roadmap.points).all()
    alive = np.isfinite(roadmap.multipliers)
    a, b = roadmap.points[roadmap.edges[:, 0]], roadmap.points[roadmap.edges[:, 1]]
    assert (problem.space.motions_free(a, b) == alive).all()
    assert roadmap.distance == pytest.approx(fresh_distances(roadmap))
    anchors = guidance.anchor(np.array(search.tree.configurations))
    for i, q in enumerate(search.tree.configurations):
        for v, length in zip(anchors.vertices[i], anchors.lengths[i], strict=True):
            if np.isfinite(length):
                assert problem.space.motion_free(q, roadmap.points[v])
                assert length == pytest.approx(problem.space.distance(q, roadmap.points[v]))


def test_values__are_the_best_anchor_plus_its_distance(walled: Walled) -> None:
    guidance = LazyPRM(vertices=200, expansion_penalty=0.0)
    search = run(guidance, walled("point"), 40)
    values = guidance.values(search.tree)
    anchors = guidance.anchors(search.tree)
    for i in range(len(search.tree)):
        totals = anchors.lengths[i] + guidance.roadmap.distance[anchors.vertices[i]]
        assert values[i] == pytest.approx(totals.min())


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
        {"radius": 0.0},
        {"radius": np.nan},
        {"check": -1.0},
    ],
)
def test_lazy_prm__refuses_what_makes_no_sense(wrong: dict) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        LazyPRM(**wrong)
