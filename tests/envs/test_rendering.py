"""Frames: what is where, the same search the same pixels, and what happens without pygame."""

from __future__ import annotations

import builtins
import sys

import numpy as np
import pytest
import shapely

from guided_gym.envs import palette
from guided_gym.envs.rendering import Renderer, spaced
from guided_gym.errors import GuidedGymError, InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.measure.target import Measure
from guided_gym.problems import Problem, Task
from guided_gym.randomness import streams
from guided_gym.search.search import Search

BOUNDS = (0.0, 0.0, 8.0, 4.0)


def wall_problem(robot: Robot, start: list[float], goal: list[float]) -> Problem:
    environment = Environment(BOUNDS, (shapely.box(3.5, 0.0, 4.5, 2.5),))
    return Problem(robot, environment, Task(start, goal), name="wall")


def point_problem() -> Problem:
    return wall_problem(Robot.point(), [1.0, 1.0], [7.0, 1.0])


def rod_problem() -> Problem:
    return wall_problem(Robot.rectangle(0.8, 0.3), [1.0, 1.0, 0.0], [7.0, 1.0, 1.0])


def begun(problem: Problem, samples: int = 0) -> Search:
    _, expansion, guidance = streams(0)
    search = Search(problem, expansion, guidance)
    grow(search, samples)
    return search


def grow(search: Search, samples: int) -> None:
    rng = np.random.default_rng(search.samples)
    for _ in range(samples):
        node = int(rng.integers(len(search.tree)))
        search.expand(node, search.planner.uniform(search.tree.configurations[node]))


def solved(problem: Problem) -> Search:
    """A search that was led over the wall."""
    search = begun(problem)
    tail = problem.task.start[2:]
    for node, point in enumerate(([2.6, 3.2], [4.0, 3.4], [5.6, 3.2])):
        search.expand(node, np.concatenate([point, tail]))
    assert search.solved
    return search


def even(search: Search) -> np.ndarray:
    return np.full(len(search.tree), 1.0 / len(search.tree))


def pixel(frame: np.ndarray, x: float, y: float) -> tuple[int, ...]:
    """The colour at a workspace point of a frame 640 wide."""
    scale = (640 - 32) / 8.0
    return tuple(frame[round(16 + (4.0 - y) * scale), round(16 + x * scale)].tolist())


def close_to(a: tuple[int, ...], b: tuple[int, ...], within: int = 12) -> bool:
    return max(abs(i - j) for i, j in zip(a, b, strict=True)) <= within


@pytest.fixture(scope="module")
def pygame():
    return pytest.importorskip("pygame", reason="the extra [render] is not installed")


@pytest.fixture(scope="module")
def renderer(pygame) -> Renderer:
    return Renderer()


@pytest.mark.parametrize("make", [point_problem, rod_problem])
def test_frame__is_uint8_rgb_of_even_size_as_wide_as_asked(renderer, make):
    search = begun(make(), 20)
    frame = renderer.frame(search, target=even(search))
    assert frame.dtype == np.uint8
    assert frame.shape == (376, 640, 3)
    assert frame.flags.writeable


def test_frame__tall_workspaces_are_as_tall_as_asked(pygame):
    problem = Problem(Robot.point(), Environment((0, 0, 1, 4)), Task([0.5, 0.5], [0.5, 3.5]))
    search = begun(problem)
    height, width, _ = Renderer(200).frame(search, target=even(search)).shape
    assert (height, width) == (212, 100)


def test_frame__obstacles_and_free_space_are_where_they_belong(renderer):
    search = begun(point_problem())
    frame = renderer.frame(search, target=even(search))
    assert pixel(frame, 4.0, 1.0) == palette.OBSTACLE
    assert pixel(frame, 4.0, 2.3) == palette.OBSTACLE
    assert pixel(frame, 4.0, 2.7) == palette.FREE
    assert pixel(frame, 1.0, 3.0) == palette.FREE
    assert close_to(pixel(frame, *point_problem().task.start), palette.START)
    assert close_to(pixel(frame, *point_problem().task.goal), palette.GOAL)


def test_frame__holes_are_free_and_islands_in_them_are_not(renderer):
    ring = shapely.box(2, 0.5, 5, 3.5).difference(shapely.box(2.5, 1, 4.5, 3))
    environment = Environment(BOUNDS, (ring, shapely.box(3.2, 1.7, 3.8, 2.3)))
    search = begun(Problem(Robot.point(), environment, Task([1.0, 1.0], [7.0, 1.0])))
    frame = renderer.frame(search, target=even(search))
    assert pixel(frame, 2.25, 2.0) == palette.OBSTACLE
    assert pixel(frame, 2.75, 2.0) == palette.FREE
    assert pixel(frame, 3.5, 2.0) == palette.OBSTACLE


def test_frame__nodes_take_the_colour_of_their_target(renderer):
    search = begun(point_problem())
    search.expand(0, np.array([1.0, 1.5]))
    search.expand(1, np.array([1.0, 2.0]))
    search.expand(2, np.array([1.3, 2.4]))
    frame = renderer.frame(search, target=np.array([1e-4, 1e-4, 0.9, 1e-4]))
    # The last selected node (2) carries the robot's outline; its edge keeps its colour.
    assert close_to(pixel(frame, 1.0, 1.75), tuple(palette.TARGET_COLOURS[-1].tolist()), 40)
    assert close_to(pixel(frame, 1.0, 1.35), tuple(palette.TARGET_COLOURS[0].tolist()), 40)


def test_frame__failed_expansions_leave_a_red_mark(renderer):
    search = begun(point_problem())
    before = renderer.frame(search, target=even(search))
    search.expand(0, np.array([4.0, 1.0]))
    assert search.tree.failure_count == 1
    after = renderer.frame(search, target=even(search))
    x, y = search.tree.contacts[0]
    red, green, blue = pixel(after, x - 0.02, y)
    assert red > 60 + max(green, blue) / 2
    assert pixel(before, x - 0.02, y) != (red, green, blue)


@pytest.mark.parametrize("make", [point_problem, rod_problem])
def test_frame__a_path_found_is_drawn_in_red(renderer, make):
    search = solved(make())
    frame = renderer.frame(search, target=even(search))
    path = search.path()
    assert path is not None
    x, y = (0.6 * path[-2] + 0.4 * path[-1])[:2]  # between nodes
    assert close_to(pixel(frame, x, y), palette.PATH, 20)


@pytest.mark.parametrize("make", [point_problem, rod_problem])
def test_frame__depends_on_nothing_but_the_search(pygame, make):
    watched, search = Renderer(), begun(make())
    for _ in range(8):
        grow(search, 5)
        kept = watched.frame(search, target=even(search))
    fresh = Renderer().frame(search, target=even(search))
    assert np.array_equal(kept, fresh)
    assert np.array_equal(fresh, Renderer().frame(begun_again(make), target=even(search)))


def begun_again(make) -> Search:
    search = begun(make())
    for _ in range(8):
        grow(search, 5)
    return search


def test_frame__another_search_starts_from_a_clean_sheet(renderer):
    first, second = begun(point_problem(), 40), begun(rod_problem(), 3)
    renderer.frame(first, target=even(first))
    frame = renderer.frame(second, target=even(second))
    assert np.array_equal(frame, Renderer().frame(second, target=even(second)))


def test_frame__asks_the_search_for_its_target(renderer):
    search = begun(point_problem(), 10)
    own = Measure(search).distribution()
    assert np.array_equal(renderer.frame(search), renderer.frame(search, target=own))


def test_frame__the_caption_shows_the_efficiency_when_given(renderer):
    search = begun(point_problem())
    without = renderer.frame(search, target=even(search))
    with_it = renderer.frame(search, target=even(search), efficiency=5.3)
    changed = np.nonzero((without != with_it).any(axis=(1, 2)))[0]
    assert changed.size
    assert changed.min() > 336  # below the workspace


def test_frame__refuses_a_target_of_another_length(renderer):
    search = begun(point_problem(), 5)
    with pytest.raises(InvalidInputError, match=r"expected shape"):
        renderer.frame(search, target=np.ones(len(search.tree) + 1))


@pytest.mark.parametrize("arguments", [{"size": 8}, {"fps": 0}])
def test_renderer__refuses_sizes_and_rates_that_make_no_picture(arguments):
    with pytest.raises(InvalidInputError, match="expected"):
        Renderer(**arguments)


def test_renderer__without_pygame_names_the_extra(monkeypatch):
    real = builtins.__import__

    def missing(name, *rest):
        if name.startswith("pygame"):
            raise ImportError(f"No module named {name!r}")
        return real(name, *rest)

    for name in [name for name in sys.modules if name.partition(".")[0] == "pygame"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(GuidedGymError, match=r"\.\[render\]"):
        Renderer()


def test_show__opens_one_window_and_closes_twice(pygame, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    renderer, search = Renderer(fps=1000), begun(point_problem(), 5)
    renderer.show(search, target=even(search))
    grow(search, 5)
    renderer.show(search, target=even(search))
    renderer.close()
    renderer.close()


def test_show__stays_away_once_closed_by_hand(pygame, monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    renderer, search = Renderer(fps=1000), begun(point_problem(), 5)
    renderer.show(search, target=even(search))
    pygame.event.post(pygame.event.Event(pygame.QUIT))
    renderer.show(search, target=even(search))
    assert not pygame.display.get_init()
    renderer.show(search, target=even(search))
    assert not pygame.display.get_init()


def test_spaced__keeps_the_ends_and_an_even_gap():
    problem = rod_problem()
    path = np.array([[1.0, 1.0, 0.0], [1.0, 3.0, 0.0], [1.0, 3.0, 0.0], [5.0, 3.0, 0.0]])
    rows = spaced(problem, path, gap=0.5)
    assert np.allclose(rows[[0, -1]], path[[0, -1]])
    assert np.allclose(problem.space.distance(rows[:-1], rows[1:]), 0.5)
    assert len(rows) == 13
