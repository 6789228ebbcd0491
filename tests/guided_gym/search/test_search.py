"""Guided search: what every search must keep to, whoever guides it."""

from __future__ import annotations

import hashlib
import itertools
import math
import os
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
import shapely

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError, NoPathError, UnknownNameError
from guided_gym.guidance.cells import Voronoi
from guided_gym.guidance.registry import make_guidance
from guided_gym.measure.target import Measure
from guided_gym.options import SearchOptions
from guided_gym.planning import SearchResult, guided_search
from guided_gym.problems import Problem, Task
from guided_gym.randomness import streams
from guided_gym.search.search import NO_NODE, Search

Walled = Callable[[str], Problem]


def digest(result: SearchResult) -> str:
    """Every bit of a tree and of the choices that made it."""
    tree = result.tree
    arrays = (tree.configurations, tree.parents, tree.cost_to_come, tree.failed_nodes, tree.failed_targets)
    return hashlib.sha256(b"".join(a.tobytes() for a in (*arrays, result.record.selected))).hexdigest()


def dense_check(problem: Problem, path: np.ndarray) -> None:
    """Shapely alone: no pose of a dense sampling of the path touches an obstacle or leaves the bounds."""
    free = problem.environment.free_space.buffer(1e-9)
    shapely.prepare(free)
    for a, b in itertools.pairwise(path):
        count = 2 + int(problem.space.distance(a, b) / 0.01)
        poses = problem.space.interpolate(a, b, np.linspace(0, 1, count))
        assert all(
            free.contains(problem.robot.placed(q)) or free.covers(problem.robot.placed(q)) for q in poses
        )


@pytest.mark.parametrize("name", ["SimplePassage", "Cup", "Trap", "TrapCup", "RandomSimplePassage"])
@pytest.mark.parametrize("guidance", ["rrt", "lazy_prm", "medial_axis"])
def test_path__is_free_from_start_to_goal(name: str, guidance: str) -> None:
    problem = make_distribution(name).problem(5)
    result = guided_search(problem, guidance, seed=2, max_samples=3000, measure=False)
    assert result.solved
    path = result.path
    assert path is not None
    assert path[0].tolist() == problem.task.start.tolist()
    assert path[-1].tolist() == problem.task.goal.tolist()
    assert problem.space.motions_free(path[:-1], path[1:]).all()
    dense_check(problem, path)


@pytest.mark.parametrize("guidance", ["rrt", "medial_axis", "lazy_prm"])
def test_goal__is_tested_from_each_new_node(walled: Walled, guidance: str) -> None:
    problem = walled("rectangle")
    result = guided_search(problem, guidance, seed=1, max_samples=2000, measure=False)
    assert result.solved
    nodes = result.tree.configurations
    sees = problem.space.motions_free(nodes, np.tile(problem.task.goal, (len(nodes), 1)))
    assert np.flatnonzero(sees).tolist() == [len(nodes) - 1]  # the last node, and no node before it


def test_record__tells_how_the_tree_grew(walled: Walled) -> None:
    result = guided_search(walled("rectangle"), "lazy_prm", seed=3)
    record, tree = result.record, result.tree
    grew = record.child != NO_NODE
    assert result.samples == record.selected.size == len(tree) - 1 + tree.failure_count
    assert (tree.parents[record.child[grew]] == record.selected[grew]).all()
    assert tree.failed_nodes.tolist() == record.selected[~grew].tolist()
    assert record.child[grew].tolist() == list(range(1, len(tree)))
    assert record.nodes.tolist() == (1 + np.cumsum(grew) - grew).tolist()
    assert (record.selected < record.nodes).all()
    assert (record.efficiency >= record.best - 1e-12).all()
    assert (record.efficiency <= math.log(1e4) + 1e-9).all()
    assert result.total_efficiency == pytest.approx(record.efficiency.sum())
    assert (tree.configurations[0] == walled("rectangle").task.start).all()


def test_failures__are_where_the_motion_stops_being_free(walled: Walled) -> None:
    problem = walled("rectangle")
    tree = guided_search(problem, "goal_distance", seed=3, max_samples=100, measure=False).tree
    assert tree.failure_count > 5
    for node, target, contact in zip(tree.failed_nodes, tree.failed_targets, tree.contacts, strict=True):
        q = tree.configurations[node]
        assert not problem.space.motion_free(q, target)
        along = problem.space.distance(q, contact) + problem.space.distance(contact, target)
        assert along == pytest.approx(problem.space.distance(q, target), abs=1e-6)
        assert problem.space.clearance(contact) < 1e-3  # at an obstacle's surface


@pytest.mark.parametrize("guidance", ["rrt", "lazy_prm", "medial_axis", "hybrid", "uninformed"])
def test_seed__gives_the_same_tree_bit_for_bit(guidance: str) -> None:
    problem = make_distribution("TrapCup").problem(0)
    first, again, other = (
        guided_search(problem, guidance, seed=s, max_samples=150, measure=False) for s in (7, 7, 8)
    )
    assert digest(first) == digest(again)
    assert digest(first) != digest(other)


def test_seed__does_not_care_what_is_measured(walled: Walled) -> None:
    for guidance in ("rrt", "lazy_prm", "hybrid"):
        plain = guided_search(walled("rectangle"), guidance, seed=4, max_samples=80, measure=False)
        assert np.isnan(plain.record.efficiency).all()
        for asked in ({}, {"distributions": True}):
            measured = guided_search(walled("rectangle"), guidance, seed=4, max_samples=80, **asked)
            assert digest(measured) == digest(plain)


def test_seed__gives_the_same_tree_in_another_process() -> None:
    code = (
        "from test_search import digest\n"
        "from guided_gym import guided_search\n"
        "from guided_gym.catalogue.table import make_distribution\n"
        "problem = make_distribution('RandomSimplePassage').problem(9)\n"
        "for name in ('rrt', 'lazy_prm', 'medial_axis'):\n"
        "    print(digest(guided_search(problem, name, seed=11, max_samples=120, measure=False)))\n"
    )
    here = os.path.dirname(os.path.abspath(__file__))
    environment = {**os.environ, "PYTHONHASHSEED": "77"}
    there = subprocess.run(
        [sys.executable, "-c", code], cwd=here, env=environment, capture_output=True, text=True, check=True
    )
    problem = make_distribution("RandomSimplePassage").problem(9)
    expected = [
        digest(guided_search(problem, name, seed=11, max_samples=120, measure=False))
        for name in ("rrt", "lazy_prm", "medial_axis")
    ]
    assert there.stdout.split() == expected


def test_bursts__grow_the_same_tree_as_single_samples(walled: Walled) -> None:
    class Plain(Voronoi):
        """Not `Voronoi` itself, so asked sample by sample."""

    for seed in range(6):
        a = guided_search(walled("rectangle"), "rrt", seed=seed, max_samples=700)
        b = guided_search(walled("rectangle"), Plain(), seed=seed, max_samples=700)
        assert digest(a) == digest(b)
        assert a.record.efficiency == pytest.approx(b.record.efficiency, abs=1e-12)
        assert a.collision_checks == b.collision_checks
        assert a.tree.failures.tolist() == b.tree.failures.tolist()


def test_bursts__leave_subclasses_their_own_proposals(walled: Walled) -> None:
    class Short(Voronoi):
        def propose(self, tree, node):
            q = tree.configurations[node]
            return q + 0.1 * (super().propose(tree, node) - q)

    tree = guided_search(walled("point"), Short(), seed=0, max_samples=60, measure=False).tree
    edges = np.diff(tree.cost_to_come[np.stack([tree.parents[1:], np.arange(1, len(tree))])], axis=0)
    assert edges.max() <= 0.1 * 0.05 * walled("point").space.extent + 1e-9


def test_expansion__is_an_option(walled: Walled) -> None:
    problem = walled("rectangle")
    own = guided_search(problem, "lazy_prm", seed=1, measure=False)
    uniform = guided_search(problem, "lazy_prm", seed=1, expansion="uniform", measure=False)
    other = guided_search(problem, "lazy_prm", seed=1, expansion="goal_distance", measure=False)
    assert len({digest(own), digest(uniform), digest(other)}) == 3
    guidance = make_guidance("lazy_prm")
    assert digest(guided_search(problem, guidance, seed=1, expansion=guidance, measure=False)) == digest(own)


def test_search__stops_at_max_samples(closed: Problem) -> None:
    for guidance, limit in (("rrt", 37), ("lazy_prm", 5)):  # soon after that it has proved that none exists
        result = guided_search(closed, guidance, seed=0, max_samples=limit, measure=False)
        assert not result.solved
        assert result.path is None
        assert result.samples == limit


def test_search__without_a_path_ends_all_the_same(closed: Problem) -> None:
    guidance = make_guidance("lazy_prm", vertices=200)
    with pytest.raises(NoPathError) as proved:
        guided_search(closed, guidance, seed=0, max_samples=600, measure=False)
    assert 5 < proved.value.result.samples < 600
    assert guidance.solver._finer < 10  # type: ignore[attr-defined]
    with pytest.raises(NoPathError):
        guided_search(closed, "rrt", seed=0)


def test_search__that_sees_its_goal_draws_no_samples(room: Problem) -> None:
    result = guided_search(room, "rrt", seed=0)
    assert result.samples == 0
    assert result.total_efficiency == 0
    assert result.path is not None
    assert result.path.tolist() == [[1, 1], [9, 9]]


def test_search__from_its_goal(walled: Walled) -> None:
    q = walled("rectangle").task.start
    problem = Problem(walled("rectangle").robot, walled("rectangle").environment, Task(q, q))
    assert guided_search(problem, "rrt", seed=0).solved
    search = Search(problem, *streams(0)[1:])
    assert Measure(search).choice(0) == (0, 0)


def test_goal_tolerance__ends_a_search_nearby(walled: Walled) -> None:
    problem = walled("rectangle")
    problem = problem.ending(tolerance=5.0)
    near = guided_search(problem, "uninformed", seed=0, max_samples=2000, measure=False)
    assert near.solved
    assert near.path is not None
    away = problem.space.distance(near.tree.configurations, problem.task.goal)
    assert away[-1] <= 5.0 < away[:-1].min()
    assert problem.space.motions_free(near.path[:-1], near.path[1:]).all()


def test_rewire__shortens_and_keeps_the_tree_sound(walled: Walled) -> None:
    problem = walled("rectangle")
    space = problem.space
    _, expansion, guidance = streams(5)
    plain = Search(problem, expansion, guidance)
    _, expansion, guidance = streams(5)
    better = Search(problem, expansion, guidance, SearchOptions(rewire=True))
    rng = np.random.default_rng(0)
    for _ in range(400):
        node = plain.tree.nearest(sample := space.sample(rng, 1)[0])
        target = plain.planner.steer(plain.tree.configurations[node], sample)
        assert plain.expand(node, target).child == better.expand(node, target).child
    a, b = plain.tree, better.tree
    assert (a.configurations == b.configurations).all()
    assert (b.cost_to_come <= a.cost_to_come + 1e-9).all()
    assert b.cost_to_come.sum() < 0.98 * a.cost_to_come.sum()
    assert b.rewirings > 0
    parents = b.parents[1:]
    assert space.motions_free(b.configurations[parents], b.configurations[1:]).all()
    steps = space.distance(b.configurations[parents], b.configurations[1:])
    assert b.cost_to_come[1:] == pytest.approx(b.cost_to_come[parents] + steps)
    assert b.depths[1:].tolist() == (b.depths[parents] + 1).tolist()
    assert b.children.tolist() == np.bincount(parents, minlength=len(b)).tolist()


def test_rewire__is_seen_by_the_metric(walled: Walled) -> None:
    options = SearchOptions(rewire=True)
    search = Search(walled("rectangle"), *streams(1)[1:], options)
    rng = np.random.default_rng(1)
    for i in range(150):
        node = search.tree.nearest(sample := search.space.sample(rng, 1)[0])
        search.expand(node, search.planner.steer(search.tree.configurations[node], sample))
        if i % 10 == 0:
            chosen = int(rng.integers(len(search.tree)))
            q = Measure(search).distribution()
            assert Measure(search).choice(chosen)[0] == pytest.approx(-math.log(q[chosen]), abs=1e-9)


def test_collision_checks__are_counted(walled: Walled) -> None:
    search = Search(walled("rectangle"), *streams(0)[1:])
    assert search.collision_checks == 1  # the start sees the goal, or not
    search.expand(0, np.array([1.6, 5.0, 0.0]))
    assert search.collision_checks == 3  # its motion, and the goal from there
    search.expand(0, np.array([5.0, 5.0, 0.0]))
    assert search.collision_checks == 4  # its motion
    assert search.samples == 2


def test_listeners__hear_of_every_expansion(walled: Walled) -> None:
    class Ear:
        heard: list = []  # noqa: RUF012

        def feedback(self, expansion) -> None:
            self.heard.append(expansion)

    search = Search(walled("rectangle"), *streams(0)[1:])
    search.listeners.append(Ear())
    grew = search.expand(0, np.array([1.6, 5.0, 0.0]))
    failed = search.expand(1, np.array([5.0, 5.0, 0.0]))
    assert Ear.heard == [grew, failed]
    assert (grew.child, grew.failed, grew.contact) == (1, False, None)
    assert (failed.node, failed.child, failed.failed) == (1, NO_NODE, True)
    assert failed.contact is not None
    assert search.last is failed


@pytest.mark.parametrize("node", [-1, 1, 300])
def test_expand__refuses_nodes_that_are_not_there(walled: Walled, node: int) -> None:
    search = Search(walled("rectangle"), *streams(0)[1:])
    with pytest.raises(InvalidInputError, match="node"):
        search.expand(node, np.array([1.6, 5.0, 0.0]))
    assert (len(search.tree), search.tree.failure_count, search.samples) == (1, 0, 0)


@pytest.mark.parametrize("target", [[1.6, 5.0], [math.nan, 5, 0], [math.inf, 5, 0], [[1.6, 5, 0]], 3.0])
def test_expand__refuses_targets_that_are_no_configurations(walled: Walled, target: object) -> None:
    search = Search(walled("rectangle"), *streams(0)[1:])
    with pytest.raises(InvalidInputError, match="target"):
        search.expand(0, np.array(target, float))
    assert (len(search.tree), search.tree.failure_count, search.samples) == (1, 0, 0)


def test_expand__takes_lists_and_other_arrays(walled: Walled) -> None:
    search = Search(walled("rectangle"), *streams(0)[1:])
    strided = np.array([[1.6, 5.0, 0.0], [0, 0, 0]]).repeat(2, axis=1)[0, ::2]
    for target in ([1.6, 5, 0], np.array([2, 5, 0]), strided):
        assert not search.expand(0, target).failed  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"max_samples": 0}, "max_samples"),
        ({"max_samples": math.nan}, "max_samples"),
        ({"max_samples": 2.5}, "max_samples"),
        ({"seed": -1}, "seed"),
        ({"seed": "a"}, "seed"),
        ({"options": {"step": 1.0}}, "options: expected a SearchOptions"),
        ({"problem": 3}, "problem: expected a Problem, got 3"),
    ],
)
def test_guided_search__refuses_what_makes_no_sense(walled: Walled, wrong: dict, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        guided_search(**{"problem": walled("rectangle"), "guidance": "rrt", **wrong})


def test_guided_search__suggests_names(walled: Walled) -> None:
    with pytest.raises(UnknownNameError, match="lazy_prm"):
        guided_search(walled("rectangle"), "lazyprm")
    with pytest.raises(UnknownNameError, match="uninformed"):
        guided_search(walled("rectangle"), "rrt", expansion="unifrmed")
    with pytest.raises(UnknownNameError, match="expansion 'unifrom'; did you mean 'uniform'"):
        guided_search(walled("rectangle"), "rrt", expansion="unifrom")


@pytest.mark.parametrize(
    "wrong",
    [
        {"step": 0.0},
        {"step": "long"},
        {"candidates": 2.5},
        {"candidates": 0},
        {"rewire": "yes"},
        {"target": (0.1, 0.1)},
    ],
)
def test_options__refuse_what_makes_no_sense(wrong: dict) -> None:
    with pytest.raises(InvalidInputError, match=f"{next(iter(wrong))}: expected"):
        SearchOptions(**wrong)


def test_result__says_what_was_found(walled: Walled) -> None:
    found = guided_search(walled("rectangle"), "oracle", seed=0, measure=False)
    assert found.path is not None
    assert found.length == pytest.approx(
        found.tree.cost_to_come[-1] + found.tree.space.distance(found.path[-2], found.path[-1])
    )
    assert repr(found).startswith(
        f"SearchResult(a path of length {found.length:.4g}, {found.samples} samples"
    )
    assert repr(found.tree).startswith(f"SearchTree({len(found.tree)} nodes")
    lost = guided_search(walled("rectangle"), "rrt", seed=0, max_samples=3)
    assert math.isnan(lost.length)
    assert repr(lost).startswith("SearchResult(no path, 3 samples")
    assert "not measured" in repr(found)
    assert f"total SE {lost.total_efficiency:.4g} nats" in repr(lost)


def test_progress__is_told_the_samples(walled: Walled) -> None:
    seen: list[int] = []
    result = guided_search(walled("rectangle"), "hybrid", seed=0, progress=seen.append, measure=False)
    assert seen == list(range(1, result.samples + 1))
