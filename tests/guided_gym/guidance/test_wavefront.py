"""Wavefront guidance: the way left on a raster, and what it does where the raster is wrong."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.guidance.registry import make_guidance
from guided_gym.guidance.solvers import wave
from guided_gym.guidance.wavefront import Wavefront
from guided_gym.options import SearchOptions, TargetParameters
from guided_gym.planning import SearchResult, guided_search
from guided_gym.problems import Problem, Task
from guided_gym.randomness import streams
from guided_gym.search.search import NO_NODE, Expansion, Search

Walled = Callable[[str], Problem]


@pytest.fixture
def string(monkeypatch: pytest.MonkeyPatch) -> Problem:
    """A wall with two gaps. Across the near one hangs a string too thin for the raster, which is not told."""
    monkeypatch.setattr(wave, "_least_width", lambda robot: np.inf)
    obstacles = (
        shapely.box(4.8, 0, 5.2, 4.5),
        shapely.box(4.999, 4.4, 5.001, 5.6),
        shapely.box(4.8, 5.5, 5.2, 8.3),
        shapely.box(4.8, 9.7, 5.2, 10),
    )
    return Problem(Robot.point(), Environment((0, 0, 10, 10), obstacles), Task((1.5, 5), (8.5, 5)), "String")


def searched(problem: Problem, samples: int = 1500, seed: int = 0, **options: object) -> SearchResult:
    guidance = make_guidance("wavefront", **options)
    return guided_search(problem, guidance, seed=seed, max_samples=samples, measure=False)


def begun(problem: Problem, *nodes: tuple[float, ...], **options: object) -> tuple[Search, Wavefront]:
    """A search whose tree is the start and then these nodes, each a child of the start."""
    search = Search(problem, *streams(0)[1:])
    guidance = Wavefront(**options)  # type: ignore[arg-type]
    search.attach(guidance)
    for q in nodes:
        node = np.array(q, np.float64)
        search.tree.add(node, 0, float(problem.space.distance(node, problem.task.start)))
    return search, guidance


def failure(node: int, contact: tuple[float, ...]) -> Expansion:
    return Expansion(node, np.array(contact), NO_NODE, np.array(contact), False)


def way_left(search: Search, guidance: Wavefront, *q: tuple[float, ...]) -> np.ndarray:
    return guidance.project(search.tree, np.array(q, np.float64))[:, 0]


@pytest.mark.parametrize("name", ["SimplePassage", "Cup", "Trap", "TrapCup"])
def test_solves_the_papers_problems_in_far_fewer_samples_than_rrt(name: str) -> None:
    problem = make_distribution(name).problem(0)
    runs = {
        guidance: [
            guided_search(problem, guidance, seed=s, max_samples=2000, measure=False) for s in range(3)
        ]
        for guidance in ("wavefront", "rrt")
    }
    assert all(run.solved for run in runs["wavefront"])
    assert max(run.samples for run in runs["wavefront"]) <= 60
    assert 3 * sum(r.samples for r in runs["wavefront"]) < sum(r.samples for r in runs["rrt"])


def test_the_same_seed_grows_the_same_tree(string: Problem) -> None:
    first, second = (searched(string, seed=3, temperature=1.0) for _ in range(2))
    other = searched(string, seed=4, temperature=1.0)
    assert np.array_equal(first.tree.configurations, second.tree.configurations)
    assert not np.array_equal(first.tree.configurations[:5], other.tree.configurations[:5])


@pytest.mark.parametrize("seed", range(3))
def test_where_the_raster_is_wrong_the_wave_goes_another_way(string: Problem, seed: int) -> None:
    run = searched(string, 200, seed)
    assert run.solved
    assert run.tree.configurations[:, 1].max() > 8.3  # through the far gap
    assert not searched(string, 200, seed, patience=10**6).solved  # in vain, for ever, at the near one


def test_after_its_patience_the_way_left_grows_where_it_was_in_vain(room: Problem) -> None:
    search, guidance = begun(room, (2.5, 2.5), patience=4)
    guidance.logits(search.tree)
    before, beyond, aside = way_left(search, guidance, (2.8, 2.8), (6.0, 6.0), (6.0, 1.0))
    for _ in range(3):
        guidance.feedback(failure(1, (3.0, 3.0)))
        assert way_left(search, guidance, (2.8, 2.8))[0] == before  # still patient
    guidance.feedback(failure(1, (3.0, 3.0)))
    after, still, there = way_left(search, guidance, (2.8, 2.8), (6.0, 6.0), (6.0, 1.0))
    assert after > before + 0.5
    assert still == pytest.approx(beyond, rel=1e-3)
    assert there == pytest.approx(aside, rel=1e-3)
    for _ in range(4):
        guidance.feedback(failure(1, (3.0, 3.0)))
    assert way_left(search, guidance, (2.8, 2.8))[0] > after  # more, each time


def test_when_the_wave_runs_again_the_nodes_are_looked_up_again(room: Problem) -> None:
    here, aside = (2.5, 2.5), (2.5, 1.0)
    search, guidance = begun(room, here, aside, patience=2)
    assert guidance.select(search.tree) == 1
    before = guidance.logits(search.tree)
    for _ in range(2):
        guidance.feedback(failure(1, here))
    change = guidance.logits(search.tree) - before
    assert change[1] < change[2]
    edge = float(room.space.distance(np.array(here), room.task.start))
    left = guidance._nodes[:3, 0]
    assert left[1] <= left[0] + edge + 1e-9  # there and back along a free edge


def test_progress_renews_the_patience(room: Problem) -> None:
    search, guidance = begun(room, patience=3)
    field = guidance._field
    for target in ((1.5, 1.5), (2.0, 2.0), (2.5, 2.5)):
        for _ in range(2):
            guidance.feedback(failure(0, (5.0, 1.0)))
        assert not search.expand(len(search.tree) - 1, np.array(target)).failed
    assert guidance._field is field
    for _ in range(3):
        guidance.feedback(failure(0, (5.0, 1.0)))
    assert guidance._field is not field


def test_a_child_that_is_no_nearer_is_no_progress(room: Problem) -> None:
    search, guidance = begun(room, patience=3)
    search.expand(0, np.array([1.5, 1.5]))  # progress
    field = guidance._field
    for x in (0.9, 0.8):
        assert not search.expand(0, np.array([x, 1.0])).failed
    assert guidance._field is field
    search.expand(0, np.array([0.7, 1.0]))
    assert guidance._field is not field


def test_a_new_search_forgets_what_was_in_vain(string: Problem) -> None:
    used = Wavefront()
    runs = [guided_search(string, used, seed=0, max_samples=300, measure=False) for _ in range(2)]
    assert np.array_equal(runs[0].tree.configurations, runs[1].tree.configurations)


@given(
    st.lists(
        st.tuples(*[st.floats(0.2, 4.4), st.floats(0.2, 9.8), st.floats(-3.1, 3.1)]), min_size=1, max_size=20
    ),
    st.lists(st.integers(0, 20), max_size=15),
)
@settings(max_examples=30, deadline=None)
def test_values__are_not_negative_and_select_takes_the_least(
    walled: Walled, nodes: list[tuple[float, ...]], failed: list[int]
) -> None:
    search, guidance = begun(walled("rectangle"), *nodes)
    tree = search.tree
    for node in failed:
        tree.add_failure(min(node, len(tree) - 1), tree.configurations[0], tree.configurations[0])
        guidance.values(tree)  # looked at step by step
    values, logits = guidance.values(tree), guidance.logits(tree)
    assert np.isfinite(values).all()
    assert values.min() == 0.0
    assert guidance.select(tree) == int(np.argmin(values)) == int(np.argmax(logits))
    assert guidance.distribution(tree)[guidance.select(tree)] == 1.0
    fresh = Wavefront()
    fresh.reset(search)
    assert np.allclose(fresh.logits(tree), logits)


def test_logits__are_the_targets_of_the_searchs_own_options(room: Problem) -> None:
    def searched_with(target: TargetParameters) -> np.ndarray:
        search = Search(room, *streams(0)[1:], options=SearchOptions(target=target))
        guidance = Wavefront()
        search.attach(guidance)
        for q in (search.start + 0.1, search.start - 0.1):
            search.tree.add(q, 0, float(room.space.distance(q, room.task.start)))
        return guidance.logits(search.tree)

    one, half = (searched_with(TargetParameters(t, t)) for t in (0.1, 0.05))
    # Half the temperature doubles what tells the nodes apart; penalties are the same for both children.
    assert half[1] - half[2] == pytest.approx(2 * (one[1] - one[2]))
    assert one[1] != one[2]


def test_temperature__draws_from_the_softmax_of_the_logits(room: Problem) -> None:
    nodes = [(1.5, 1.5), (1.2, 1.6), (2.0, 1.0), (0.5, 0.5)]
    search, guidance = begun(room, *nodes, temperature=2.0)
    logits = guidance.logits(search.tree)
    expected = np.exp(logits / 2.0) / np.exp(logits / 2.0).sum()
    assert guidance.distribution(search.tree) == pytest.approx(expected)
    drawn = np.bincount([guidance.select(search.tree) for _ in range(4000)], minlength=5) / 4000
    assert drawn == pytest.approx(expected, abs=0.04)
    assert searched(room, 300, temperature=1.0).solved


def test_failures_contacts_and_children_take_from_a_logit(room: Problem) -> None:
    search, guidance = begun(room, (2.0, 2.0), (2.0, 4.0), failure_penalty=0.5)
    tree = search.tree
    before = guidance.logits(tree).copy()
    tree.add_failure(1, np.array([2.4, 2.4]), np.array([2.4, 2.4]))
    after = guidance.logits(tree).copy()
    assert after[1] < before[1] - 0.5 - np.log(2) + 1e-9
    assert after[2] == pytest.approx(before[2])
    penalties = guidance.penalties(tree).copy()
    for x in (2.1, 2.2, 2.3):
        tree.add(np.array([x, 5.0]), 2, 9.0)
    assert guidance.penalties(tree)[2] == pytest.approx(penalties[2] + 0.5 * 3.0 * 2)  # its first is free


def test_propose__looks_at_more_candidates_in_a_crowd(room: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    counts: list[int] = []

    def looked_at(nodes: int, **options: object) -> int:
        search, guidance = begun(room, *[(5.0, 5.0)] * nodes, **options)
        own = search.planner.candidates

        def candidates(q: np.ndarray, count: int) -> np.ndarray:
            counts.append(count)
            return own(q, count)

        monkeypatch.setattr(search.planner, "candidates", candidates)
        guidance.propose(search.tree, nodes)
        return counts[-1]

    assert looked_at(1, candidates=50) == looked_at(6, candidates=50) == 50
    assert looked_at(9, candidates=50) == 4 * 50
    assert looked_at(200, candidates=50) == 2048
    assert looked_at(200, candidates=5000) == 5000


def test_propose__goes_for_the_goal_in_the_open_and_along_a_wall(walled: Walled) -> None:
    problem = walled("point")
    search, guidance = begun(problem, (4.3, 5.0), (6.0, 5.0), candidates=256)
    step = search.planner.step
    on = guidance.propose(search.tree, 2)
    assert on[0] > 6.0 + 0.9 * step
    along = guidance.propose(search.tree, 1)
    assert problem.space.motion_free(np.array([4.3, 5.0]), along)
    assert abs(along[1] - 5.0) > 0.8 * step


def test_project__is_the_way_left_and_the_contacts_at_hand(walled: Walled) -> None:
    problem = walled("point")
    search, guidance = begun(problem)
    search.tree.add_failure(0, np.array([4.6, 5.0]), np.array([4.5, 5.0]))
    states = guidance.project(search.tree, np.array([[1.5, 5.0], [4.5, 5.0], [8.0, 5.0]]))
    over = np.hypot(3.0, 2.5)  # to the wall's upper corner, and again from the other one
    assert states[:, 0] == pytest.approx([over + 1.0 + over, 2.5 + 1.0 + over, 0.5], rel=0.1)
    assert states[:, 1] == pytest.approx([0.0, 1.0, 0.0], abs=1e-9)
    h = guidance.heuristic(states)
    assert h == pytest.approx(states[:, 0] + [0.0, search.planner.step, 0.0])


def test_a_tree_far_larger_than_its_buffers(room: Problem) -> None:
    search, guidance = begun(room)
    for q in search.space.sample(np.random.default_rng(0), 1500):
        search.tree.add(q, 0, 1.0)
    assert guidance.values(search.tree).shape == (1501,)
    assert guidance.propose(search.tree, 1500).shape == (2,)


def test_propose__looks_at_as_many_candidates_as_the_search_says(room: Problem) -> None:
    for told, options, count in ((None, 7, 7), (5, 7, 5), (None, None, 16)):
        searching = SearchOptions() if options is None else SearchOptions(candidates=options)
        search = Search(room, *streams(0)[1:], searching)
        guidance = Wavefront(candidates=told)
        search.attach(guidance)
        state = search.planner.rng.bit_generator.state
        guidance.propose(search.tree, 0)
        after = search.planner.rng.bit_generator.state
        search.planner.rng.bit_generator.state = state
        search.planner.candidates(search.tree.configurations[0], count)
        assert search.planner.rng.bit_generator.state == after


@pytest.mark.parametrize("thickness", [0.5, 0.15, 0.02, 1e-3, 1e-4])
@pytest.mark.parametrize("robot", [Robot.point(), Robot.segment(0.2), Robot.rectangle(0.3, 0.01)])
def test_a_wall_however_thin_is_gone_around(robot: Robot, thickness: float) -> None:
    wall = shapely.box(4.96 - thickness / 2, -1, 4.96 + thickness / 2, 9)
    turn = (0.3,) * (robot.dimension - 2)
    problem = Problem(robot, Environment((0, 0, 10, 10), (wall,)), Task((3, 1, *turn), (7, 1, *turn)))
    runs = [searched(problem, 60, seed, candidates=256) for seed in range(2)]
    assert max(run.samples for run in runs) <= 40
    assert (
        min(run.samples for run in runs) <= 20
    )  # there and back, 16 long, by steps of 0.7: 23 without sight


@pytest.mark.parametrize("scale", [1e-9, 1e-6, 1e6])
def test_the_unit_of_length_does_not_matter(scale: float) -> None:
    def scaled(by: float) -> SearchResult:
        walls = tuple(shapely.box(a * by, b * by, c * by, d * by) for a, b, c, d in [(4, -1, 5, 8)])
        environment = Environment((0, 0, 8 * by, 10 * by), walls)
        robot = Robot.rectangle(0.8 * by, 0.3 * by)
        task = Task((2 * by, 2 * by, 0), (7 * by, 2 * by, 1))
        return searched(Problem(robot, environment, task), 200)

    one, other = scaled(1.0), scaled(scale)
    assert one.solved and other.solved
    assert other.samples == pytest.approx(one.samples, abs=6)
    assert other.length / scale == pytest.approx(one.length, rel=0.15)


@pytest.mark.parametrize("clearance", [1e-1, 1e-3, 3e-5])
@pytest.mark.parametrize("tolerance", [0.05, 0.005])
def test_a_region_around_a_goal_without_room_is_reached(clearance: float, tolerance: float) -> None:
    wall = shapely.box(1.0 + clearance, 0.5, 1.3, 1.5)
    problem = Problem(Robot.point(), Environment((0, 0, 2, 2), (wall,)), Task((0.3, 0.4), (1.0, 1.0)))
    runs = [searched(problem.ending(tolerance, by_edge=False), 400, seed) for seed in range(3)]
    assert all(run.solved for run in runs)
    assert max(run.samples for run in runs) <= 60


def test_a_long_search_in_vain_does_not_slow_down(closed: Problem) -> None:
    search, guidance = begun(closed)
    seconds = []
    for _ in range(2):
        began = time.process_time()
        search.run(guidance, search.samples + 150)
        seconds.append(time.process_time() - began)
        search.run(guidance, 1700)
    assert seconds[1] < 3 * seconds[0] + 0.1


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("cells", 50),
        ("cells", 0),
        ("cells", 8.0),
        ("headings", 6),
        ("headings", -4),
        ("temperature", -1.0),
        ("temperature", np.nan),
        ("failure_penalty", -0.1),
        ("failure_penalty", np.inf),
        ("candidates", 0),
        ("candidates", 1.5),
        ("patience", 0),
        ("patience", True),
    ],
)
def test_options__are_checked(option: str, value: object) -> None:
    with pytest.raises(InvalidInputError, match=option):
        Wavefront(**{option: value})  # type: ignore[arg-type]


def test_options__say_how_fine_the_raster_is(walled: Walled) -> None:
    _, guidance = begun(walled("rectangle"), cells=24, headings=12)
    assert guidance._grid.room.shape == (24, 24, 12)
    assert searched(walled("rectangle"), 300, cells=24, headings=12).solved
