"""The medial axis of rooms whose skeleton is known."""

from __future__ import annotations

from typing import Any

import networkx as nx
import numpy as np
import pytest
import shapely

from guided_gym.catalogue.table import distribution_names, make_distribution
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.registry import make_guidance
from guided_gym.guidance.solvers import skeleton
from guided_gym.guidance.solvers.base import Query
from guided_gym.guidance.solvers.skeleton import Skeleton, medial_axis, skeleton_graph
from guided_gym.randomness import streams
from guided_gym.search.search import Search


def lines(environment: Environment, spacing: float = 0.5) -> shapely.MultiLineString:
    points, edges = medial_axis(environment, spacing)
    return shapely.MultiLineString(list(points[edges]))


def test_rectangle__hand_worked() -> None:
    # Bisectors of the corners meet at (2, 2) and (6, 2), joined by the middle line.
    room = Environment((0.0, 0.0, 8.0, 4.0))
    known = shapely.MultiLineString(
        [[(0, 0), (2, 2)], [(0, 4), (2, 2)], [(8, 0), (6, 2)], [(8, 4), (6, 2)], [(2, 2), (6, 2)]]
    )
    found = lines(room, 0.1)
    spacing = room.extent / 100  # of the samples of the boundary
    assert found.difference(known.buffer(spacing)).length < 1e-9
    missing = known.difference(found.buffer(spacing))
    assert missing.length < 4 * 2 * 2.5 * spacing  # pruned where it runs into the corners
    graph = skeleton_graph(room)
    assert nx.is_connected(graph)
    assert nx.is_tree(graph)
    deepest = max(clearance for _, clearance in graph.nodes(data="clearance"))
    assert deepest == pytest.approx(2, abs=spacing)


def test_corridor_around_an_obstacle__is_a_loop() -> None:
    ring = Environment((0.0, 0.0, 10.0, 10.0), (shapely.box(3, 3, 7, 7),))
    graph = skeleton_graph(ring)
    assert nx.is_connected(graph)
    assert len(nx.cycle_basis(graph)) == 1
    assert lines(ring).distance(shapely.Point(1.5, 5)) < 0.1


def test_rooms_that_are_apart__have_skeletons_apart() -> None:
    apart = Environment((0.0, 0.0, 10.0, 10.0), (shapely.box(4, 0, 6, 10),))
    assert nx.number_connected_components(skeleton_graph(apart)) == 2


@pytest.mark.parametrize("name", distribution_names())
def test_skeleton__lies_in_the_free_space_and_joins_start_to_goal(name: str) -> None:
    problem = make_distribution(name).problem(0)
    environment = problem.environment
    points, edges = medial_axis(environment, 0.5)
    assert edges.dtype == np.int32
    assert (edges[:, 0] != edges[:, 1]).all()
    assert (environment.clearance(points) > 0).all()
    segments = shapely.linestrings(points[edges])
    assert environment.free_space.buffer(0.5).covers(shapely.union_all(segments))
    graph = nx.Graph(edges.tolist())
    assert set(graph) == set(range(len(points)))
    ends = [problem.robot.position(q) for q in (problem.task.start, problem.task.goal)]
    nearest = [int(np.argmin(np.hypot(*(points - xy).T))) for xy in ends]
    assert nx.has_path(graph, *nearest)
    lengths = shapely.length(segments)
    assert lengths.max() < 1.0  # a branch shorter than 1.5 spacings is one edge


def test_clearance__is_the_distance_to_the_boundary() -> None:
    environment = make_distribution("TrapCup").problem(0).environment
    graph = skeleton_graph(environment)
    boundary = environment.free_space.boundary
    for _, data in list(graph.nodes(data=True))[::50]:
        assert data["clearance"] == pytest.approx(boundary.distance(shapely.Point(data["pos"])), abs=1e-6)
    for a, b, length in list(graph.edges(data="length"))[::50]:
        assert length == pytest.approx(
            np.hypot(*np.subtract(graph.nodes[a]["pos"], graph.nodes[b]["pos"])), abs=1e-6
        )


@pytest.mark.parametrize("scale", [1e-3, 1e4])
def test_skeleton__does_not_depend_on_the_unit_of_length(scale: float) -> None:
    def of(s: float) -> nx.Graph:
        return skeleton_graph(Environment((0.0, 0.0, 10 * s, 10 * s), (shapely.box(4 * s, 0, 5 * s, 7 * s),)))

    small, large = of(1.0), of(scale)
    assert nx.number_connected_components(large) == nx.number_connected_components(small) == 1
    total = sum(length for *_, length in large.edges(data="length")) / scale
    assert total == pytest.approx(sum(length for *_, length in small.edges(data="length")), rel=0.02)


@pytest.mark.parametrize("seed", range(3))
def test_skeleton__among_many_obstacles_has_a_part_for_each_part_and_a_loop_for_each_hole(seed: int) -> None:
    # 400 octagons, in part on top of one another and on the bounds: pockets, and gaps of all widths.
    turns = 2 * np.pi * (np.arange(8) + 0.5) / 8
    centres = np.random.default_rng(seed).uniform(0, 28, (400, 1, 2))
    octagons = centres + 0.5 * np.stack((np.cos(turns), np.sin(turns)), axis=1)
    environment = Environment.from_polygons((0.0, 0.0, 28.0, 28.0), octagons)
    parts = shapely.get_parts(environment.free_space)
    graph = skeleton_graph(environment)
    components = nx.number_connected_components(graph)
    assert components == len(parts) > 1
    holes = int(shapely.get_num_interior_rings(parts).sum())
    assert graph.number_of_edges() - graph.number_of_nodes() + components == holes > 100


@pytest.mark.parametrize("seed", [2, 4, 6])
def test_skeleton__among_needles_is_in_one_piece_by_free_ties(seed: int) -> None:
    """Needles much thinner than the samples are apart leave crumbs, which finer drawings only multiply."""
    rng = np.random.default_rng(seed)
    centres, turns = rng.uniform(0, 12, (60, 1, 2)), rng.uniform(0, np.pi, 60)
    along = rng.uniform(0.5, 2.5, 60)[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    across = 10 ** rng.uniform(-3.5, -1.5, 60)[:, None] * np.stack([-np.sin(turns), np.cos(turns)], axis=1)
    corners = np.stack([-along - across, along - across, along + across, across - along], axis=1)
    environment = Environment.from_polygons((0.0, 0.0, 12.0, 12.0), centres + corners)
    graph, parts = skeleton_graph(environment), shapely.get_parts(environment.free_space)
    components = nx.number_connected_components(graph)
    holes = int(shapely.get_num_interior_rings(parts).sum())
    assert components == len(parts) > 1
    assert graph.number_of_edges() - graph.number_of_nodes() + components == holes
    points = np.array([graph.nodes[v]["pos"] for v in graph])
    assert shapely.contains(environment.free_space, shapely.linestrings(points[np.array(graph.edges)])).all()


def test_skeleton__holes_that_touch_have_one_loop_and_cost_no_further_drawing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cells = np.zeros((8, 10), bool)  # the first two touch at a corner
    for row, column in [(2, 2), (3, 3), (5, 7)]:
        cells[row, column] = True
    environment = Environment.from_occupancy(cells, 1.0, unknown="free")
    assert int(shapely.get_num_interior_rings(shapely.get_parts(environment.free_space)).sum()) == 3
    drawings, inner = [], skeleton._drawn

    def drawn(*words: Any) -> Any:
        drawings.append(words)
        return inner(*words)

    monkeypatch.setattr(skeleton, "_drawn", drawn)
    graph = skeleton_graph(environment)
    components = nx.number_connected_components(graph)
    assert (components, graph.number_of_edges() - graph.number_of_nodes() + components) == (1, 2)
    assert len(drawings) == 1


def test_skeleton__says_when_there_is_no_room() -> None:
    full = Environment((0.0, 0.0, 10.0, 10.0), (shapely.box(-1, -1, 11, 11),))
    with pytest.raises(InvalidInputError, match="too small"):
        skeleton_graph(full)


def begun(
    environment: Environment, goal: tuple[float, float], step: float = 0.5, **options: float
) -> Skeleton:
    space = ConfigurationSpace(Robot.point(), environment)
    solver = Skeleton(**options)
    solver.begin(Query(space, np.array(goal), np.array(goal)), np.random.default_rng(0), step)
    return solver


CORRIDOR = Environment((0.0, 0.0, 20.0, 2.0))  # the skeleton's middle line runs from (1, 1) to (19, 1)


def test_skeleton_solver__hand_worked_in_a_corridor() -> None:
    solver = begun(CORRIDOR, (15.0, 0.5))
    q = np.array([[3.0, 1.5], [10.0, 1.0], [15.0, 1.7], [17.0, 0.4], [17.0, 3.0]])
    assert solver(q) == pytest.approx([12, 5, 0, 2, np.inf], abs=0.15)


def test_skeleton_solver__a_failure_adds_a_share_to_the_nearest_edge() -> None:
    solver = begun(CORRIDOR, (15.0, 1.0), spacing=1.0)
    q = np.array([[3.0, 1.0], [13.0, 1.0]])
    before = solver(q)
    edge = solver.graph.lengths[solver.anchor(np.array([[8.2, 1.0]])).edges[0, 0]]
    for k in range(1, 4):  # shares add up
        solver.raise_near(np.array([8.2, 1.3]), 0.0, 1.1)
        assert solver(q) - before == pytest.approx([0.1 * k * edge, 0.0])
    solver.raise_near(np.array([8.2, 1.3]), 0.0, np.inf)
    assert solver(q).tolist() == [np.inf, pytest.approx(2.0, abs=0.1)]


def test_skeleton_solver__with_a_reach_all_edges_within_it_rise() -> None:
    solver = begun(CORRIDOR, (15.0, 1.0), spacing=1.0)
    graph = solver.graph
    segments = shapely.linestrings(graph.points[graph.edges])
    within = shapely.distance(segments, shapely.Point(6.0, 1.2)) <= 2.0
    solver.raise_near(np.array([6.0, 1.2]), 2.0, 3.0)
    assert 3 < within.sum() < len(within)
    assert np.array_equal(graph.multipliers, np.where(within, 3.0, 1.0))


def test_skeleton_solver__nodes_follow_and_costs_only_rise() -> None:
    problem = make_distribution("TrapCup").problem(0)
    solver = begun(problem.environment, tuple(problem.task.goal[:2]))
    rng = np.random.default_rng(0)
    nodes = rng.uniform(0, 10, (300, 2))
    before = solver.follow(nodes[:20]).copy()
    for k in range(40):
        solver.raise_near(nodes[k], rng.choice([0.0, 0.4]), rng.choice([1.1, 3.0, 3.0, np.inf]))
        values = solver.follow(nodes[: 20 + 7 * k])
        assert np.array_equal(values, solver(nodes[: 20 + 7 * k]))
        assert (values[: len(before)] >= before).all()
        before = values.copy()
    with pytest.raises(ValueError, match="read-only"):
        values[0] = 0.0


def test_skeleton_solver__values_are_those_of_the_medial_axis_guidance() -> None:
    problem = make_distribution("TrapCup").problem(0)
    search = Search(problem, *streams(0)[1:])
    guidance = make_guidance("medial_axis", expansion_penalty=0.0)
    search.attach(guidance)
    solver = begun(problem.environment, tuple(problem.task.goal[:2]), search.planner.step)
    q = problem.space.sample(np.random.default_rng(0), 500)
    expected = guidance.heuristic(guidance.project(search.tree, q))
    assert np.array_equal(solver(np.ascontiguousarray(q[:, :2])), expected)


def test_skeleton_solver__refuses_other_spaces_and_options() -> None:
    space = make_distribution("TrapCup").problem(0).space
    with pytest.raises(InvalidInputError, match="skeleton: expected a guiding space of 2 dimensions, got 3"):
        Skeleton().begin(Query(space, np.zeros(3), np.zeros(3)), np.random.default_rng(0), 1.0)
    with pytest.raises(InvalidInputError, match="spacing"):
        Skeleton(spacing=0.0)
