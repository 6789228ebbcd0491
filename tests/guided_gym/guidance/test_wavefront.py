"""Wavefront guidance: the way left on a raster, and what it does where the raster is wrong."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np
import pytest
import shapely

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.guidance.composed import Composed
from guided_gym.guidance.registry import make_guidance
from guided_gym.guidance.solvers import wave
from guided_gym.options import SearchOptions
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


def begun(problem: Problem, *nodes: tuple[float, ...], **options: object) -> tuple[Search, Composed]:
    """A search whose tree is the start and then these nodes, each a child of the start."""
    search = Search(problem, *streams(0)[1:])
    guidance = make_guidance("wavefront", **options)
    assert isinstance(guidance, Composed)
    search.attach(guidance)
    for q in nodes:
        node = np.array(q, np.float64)
        search.tree.add(node, 0, float(problem.space.distance(node, problem.task.start)))
    return search, guidance


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
    assert not searched(
        string, 200, seed, factor=1.0
    ).solved  # learns nothing: in vain, for ever, at the near one


def test_values_and_proposals_of_a_tree_far_larger_than_its_buffers(room: Problem) -> None:
    search, guidance = begun(room)
    for q in search.space.sample(np.random.default_rng(0), 1500):
        search.tree.add(q, 0, 1.0)
    assert guidance.values(search.tree).shape == (1501,)
    assert guidance.propose(search.tree, 1500).shape == (2,)


def test_propose__looks_at_as_many_candidates_as_the_search_says(room: Problem) -> None:
    for told, options, count in ((None, 7, 7), (5, 7, 5), (None, None, 16)):
        searching = SearchOptions() if options is None else SearchOptions(candidates=options)
        search = Search(room, *streams(0)[1:], searching)
        guidance = make_guidance("wavefront", candidates=told)
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
    runs = [searched(problem, 60, seed, detour=0.0) for seed in range(2)]  # what the wave alone sees
    assert max(run.samples for run in runs) <= 40
    # There and back, 16 long, by steps of 0.7: 23 without sight.
    assert min(run.samples for run in runs) <= 20


@pytest.mark.parametrize(
    ("target", "teaches"),
    [
        ((5.3, 5.0), True),  # across the string, of which the raster knows nothing
        ((5.0, 4.3), False),  # into the wall
        ((5.4, 4.2), False),  # through the wall: nearer to the goal by more than the motion is long
        ((4.0, 5.3), True),  # away from all; that it should fail there is news
    ],
)
def test_feedback__of_a_failure_that_was_foreseen_reaches_less_far(
    string: Problem, monkeypatch: pytest.MonkeyPatch, target: tuple[float, float], teaches: bool
) -> None:
    taught: list[float] = []
    monkeypatch.setattr(wave.Wave, "raise_near", lambda solver, state, reach, factor: taught.append(reach))
    for foreseen in (1.0, 0.5, 0.0):
        search, guidance = begun(string, (4.6, 4.2), foreseen=foreseen, reach=1.0)
        looks = search.looks
        guidance.feedback(Expansion(1, np.array(target), NO_NODE, np.array([5.0, 4.9]), False))
        assert search.looks - looks == int(foreseen != 1.0)
    parts = [1.0, 1.0, 1.0] if teaches else [1.0, 0.5]
    assert taught == [part * string.space.scale for part in parts]


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
        ("expansion_penalty", -0.1),
        ("expansion_penalty", np.inf),
        ("candidates", 0),
        ("candidates", 1.5),
        ("detour", -1),
        ("factor", 0.5),
        ("foreseen", -0.1),
    ],
)
def test_options__are_checked(option: str, value: object) -> None:
    with pytest.raises(InvalidInputError, match=option):
        make_guidance("wavefront", **{option: value})


def test_options__say_how_fine_the_raster_is(walled: Walled) -> None:
    _, guidance = begun(walled("rectangle"), cells=24, headings=4)
    assert guidance.solver._now.grid.room.shape == (24, 24, 4)  # type: ignore[attr-defined]
    assert searched(walled("rectangle"), 300, cells=24, headings=12).solved


@pytest.mark.parametrize(
    "name", ["wave(robot=disc)", "wave(robot=point)", "wave(detour=0.5)", "wave(foreseen=0.2)"]
)
def test_wave__grows_the_same_tree_in_bursts_as_sample_by_sample(name: str) -> None:
    """A trace asks sample by sample, with failures in between."""
    failed = 0
    mazes = make_distribution("RandomMaze")
    for seed in range(1, 4):
        problem = mazes.problem(seed)
        bursts, single = (
            guided_search(problem, name, seed=seed, measure=False, trace=trace)
            for trace in (None, io.StringIO())
        )
        for rows in (
            "configurations",
            "parents",
            "cost_to_come",
            "failed_nodes",
            "failed_targets",
            "contacts",
        ):
            assert np.array_equal(getattr(bursts.tree, rows), getattr(single.tree, rows))
        assert np.array_equal(bursts.record.selected, single.record.selected)
        assert np.array_equal(bursts.record.nodes, single.record.nodes)
        assert (bursts.looks, bursts.collision_checks) == (single.looks, single.collision_checks)
        failed += bursts.tree.failure_count
    assert failed > 0
