"""Stored paths guide, are filtered by collisions, and RRT helps out while none is in sight."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from guided_gym.errors import GuidedGymError, InvalidInputError, StorageError
from guided_gym.guidance.composed import Composed
from guided_gym.guidance.registry import make_guidance
from guided_gym.planning import guided_search
from guided_gym.problems import Problem
from guided_gym.randomness import streams
from guided_gym.search.search import Search
from guided_gym.storage.path_file import DatabaseHeader
from guided_gym.storage.path_file import PathDatabase as Store
from guided_gym.storage.path_library import PathLibrary

Walled = Callable[[str], Problem]
OVER = [[1.5, 5.0], [3.0, 8.5], [7.0, 8.5], [8.5, 5.0]]  # over the wall
UNDER = [[1.5, 5.0], [3.0, 1.5], [7.0, 1.5], [8.5, 5.0]]
THROUGH = [[1.5, 5.0], [8.5, 5.0]]
FAR_AWAY = [[1.5, 9.5], [1.0, 9.5]]


def library(problem: Problem, *paths: list) -> PathLibrary:
    padding = problem.space.dimension - 2
    arrays = [np.pad(np.array(path), ((0, 0), (0, padding))) for path in paths]
    return PathLibrary.from_paths(arrays, problem.space.weights, problem.space.periods)


def stored(database: PathLibrary | str | Path, **options: object) -> Composed:
    guidance = make_guidance("path_database", database=database, **options)
    assert isinstance(guidance, Composed)
    return guidance


def started(problem: Problem, *paths: list, **options: object) -> tuple[Composed, Search]:
    guidance = stored(library(problem, *paths), **options)
    search = Search(problem, *streams(0)[1:])
    search.attach(guidance)
    return guidance, search


def grow(search: Search, guidance: Composed, samples: int) -> None:
    for _ in range(samples):
        node = guidance.select(search.tree)
        search.expand(node, guidance.propose(search.tree, node))


def test_value__is_the_rest_of_the_path_hand_worked(walled: Walled) -> None:
    guidance, search = started(walled("point"), OVER, expansion_penalty=0.0)
    rest = 2 * np.hypot(1.5, 3.5) + 4
    assert guidance.values(search.tree)[0] == pytest.approx(rest)
    search.tree.add(np.array([5.0, 8.7]), 0, 5.0)  # 0.2 above the middle of the path
    assert guidance.values(search.tree)[1] == pytest.approx(np.hypot(1.5, 3.5) + 2.2, abs=0.2)


def test_paths__are_followed(walled: Walled) -> None:
    for way, side in ((OVER, 1), (UNDER, -1)):
        result = guided_search(
            walled("rectangle"),
            stored(library(walled("rectangle"), way)),
            seed=0,
            measure=False,
        )
        assert result.solved
        assert result.samples < 100
        assert result.path is not None
        assert (side * (result.path[:, 1] - 5)).max() > 2.5


def test_rrt__helps_out_until_a_node_sees_a_path(walled: Walled) -> None:
    problem = walled("point")
    options = {"similar": 1, "reach": 0.1}
    guidance, search = started(problem, [[7.0, 1.0], [8.5, 5.0]], **options)  # starts on the far side
    assert not np.isfinite(guidance.values(search.tree)).any()
    plain = guided_search(problem, "rrt", seed=5, max_samples=2000, measure=False)
    helped = guided_search(problem, guidance, seed=5, max_samples=2000, measure=False)
    same = 0
    for a, b in zip(plain.tree.configurations, helped.tree.configurations, strict=False):
        if (a != b).any():
            break
        same += 1
    assert same >= 10  # sample by sample RRT's tree, until a path comes in sight
    seen = problem.space.distance(helped.tree.configurations[: same - 1], np.array([7.0, 1.0])).min()
    assert seen > 0.05 * problem.space.extent or same == len(plain.tree)


def test_empty_library__is_rrt(walled: Walled) -> None:
    a = guided_search(walled("rectangle"), "rrt", seed=1, measure=False)
    b = guided_search(walled("rectangle"), stored(library(walled("rectangle"))), seed=1, measure=False)
    assert (a.tree.configurations == b.tree.configurations).all()


def test_collision__filters_the_paths_near_it(walled: Walled) -> None:
    guidance, search = started(walled("point"), THROUGH, OVER)
    assert guidance.solver._alive.tolist() == [True, True]
    search.tree.add(np.array([4.3, 5.0]), 0, 2.8)
    assert search.expand(1, np.array([4.7, 5.0])).failed
    assert guidance.solver.filtered == 1
    assert np.count_nonzero(guidance.solver._alive) == 1
    assert np.isinf(guidance.values(search.tree)[1])  # it saw the straight path only
    assert np.isfinite(guidance.values(search.tree)[0])  # the start sees the other


def test_query__goes_on_when_all_paths_are_filtered(walled: Walled) -> None:
    guidance, search = started(walled("rectangle"), THROUGH, THROUGH, OVER, similar=1)
    assert guidance.solver.queried == 1
    grow(search, guidance, 200)
    assert guidance.solver.queried == 3
    assert guidance.solver.filtered >= 2
    assert search.solved


def test_query__of_a_new_block_knows_the_collisions_so_far(walled: Walled) -> None:
    guidance, search = started(walled("point"), THROUGH, THROUGH, THROUGH, THROUGH, similar=1)
    search.tree.add(np.array([4.3, 5.0]), 0, 2.8)
    search.expand(1, np.array([4.7, 5.0]))
    guidance.select(search.tree)
    assert guidance.solver.queried == 4
    assert guidance.solver.filtered == 4  # by the one collision
    assert not guidance.solver._alive.any()


@pytest.mark.parametrize("paths", [[[[1.5, 5.0]]], [[[1.5, 5.0], [2.5, 5.0]]], [[[8.5, 5.0]]], [FAR_AWAY]])
def test_paths__that_end_short_of_the_goal_do_not_hold_a_search_for_ever(walled: Walled, paths: list) -> None:
    problem = walled("rectangle")
    for seed in range(3):
        guidance = stored(library(problem, *paths))
        result = guided_search(problem, guidance, seed=seed, max_samples=2000, measure=False)
        assert result.solved


def test_values__match_a_walk_over_the_graph(walled: Walled) -> None:
    import networkx as nx

    guidance, search = started(walled("rectangle"), THROUGH, OVER, UNDER)
    grow(search, guidance, 60)
    graph = guidance.solver.graph
    found = nx.single_source_dijkstra_path_length(graph.as_networkx(), graph.goal)
    assert graph.distance == pytest.approx(np.array([found.get(v, np.inf) for v in range(len(graph.points))]))


def test_dimension__of_another_robot_is_refused(walled: Walled) -> None:
    guidance = stored(library(walled("point"), OVER))
    with pytest.raises(InvalidInputError, match="dimension 3"):
        guided_search(walled("rectangle"), guidance, measure=False)


def test_database__is_read_from_its_file(walled: Walled, tmp_path: Path) -> None:
    problem = walled("rectangle")
    paths = library(problem, OVER, UNDER, THROUGH)
    file = tmp_path / "paths.db"
    with Store.create_or_open(file, DatabaseHeader.for_space("Walled", problem.space)) as store:
        store.append_many((i, paths.path(i)) for i in range(3))
    from_file = guided_search(problem, stored(file), seed=2, measure=False)
    from_memory = guided_search(problem, stored(paths), seed=2, measure=False)
    assert (from_file.tree.configurations == from_memory.tree.configurations).all()
    assert len(stored(str(file), paths=2).solver.library) == 2
    assert len(stored(paths, paths=1).solver.library) == 1


def test_database__that_is_missing_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="guided-gym database build"):
        make_guidance("path_database")
    with pytest.raises(GuidedGymError, match="nowhere"):
        stored(tmp_path / "nowhere.db")
    foreign = tmp_path / "foreign.db"
    foreign.write_bytes(b"no database at all" * 100)
    with pytest.raises(StorageError):
        stored(foreign)


@pytest.mark.parametrize("wrong", [{"similar": 0}, {"reach": -0.1}, {"check": np.nan}])
def test_path_database__refuses_what_makes_no_sense(walled: Walled, wrong: dict) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        stored(library(walled("point"), OVER), **wrong)
