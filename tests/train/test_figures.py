"""Figures: each can be made and written, shows what it was given, and refuses what it cannot show."""

from __future__ import annotations

import subprocess
import sys

import matplotlib
import numpy as np
import pytest
import shapely
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.guidance.registry import make_guidance
from guided_gym.measure.target import Measure
from guided_gym.problems import Problem, Task
from guided_gym.randomness import streams
from guided_gym.search.search import Search
from guided_gym.storage.path_library import PathLibrary
from guided_gym.train import figures
from guided_gym.train.statistics import Interval
from guided_gym.train.style import FORMATS, Looks, label_of, save

WALL = shapely.box(3.5, 0.0, 4.5, 2.5)


def problem_of(dimension: int) -> Problem:
    robot = Robot.point() if dimension == 2 else Robot.rectangle(0.8, 0.3)
    start, goal = np.array([1.0, 1.0, 0.0]), np.array([7.0, 1.0, 0.0])
    environment = Environment((0.0, 0.0, 8.0, 4.0), (WALL,))
    return Problem(robot, environment, Task(start[:dimension], goal[:dimension]), name="wall")


def searched(problem: Problem, guidance, samples: int = 60):
    """(guidance, search) after some samples."""
    guidance = make_guidance(guidance)
    _, expansion, rng = streams(1)
    search = Search(problem, expansion, rng)
    search.attach(guidance)
    while not search.solved and search.samples < samples:
        node = guidance.select(search.tree)
        search.expand(node, guidance.propose(search.tree, node))
    return guidance, search


def stored_paths(problem: Problem) -> PathLibrary:
    over = np.array([[1.0, 1.2], [4.0, 3.4], [7.0, 1.2]])
    through = np.array([[1.0, 1.0], [7.0, 1.0]])
    tail = np.zeros((3, problem.space.dimension - 2))
    paths = [np.hstack([over, tail]), np.hstack([through, tail[:2]])]
    return PathLibrary.from_paths(paths, problem.space.weights, problem.space.periods)


def even(search: Search) -> np.ndarray:
    return np.full(len(search.tree), 1.0 / len(search.tree))


def lines_of(figure: Figure) -> list[LineCollection]:
    return [c for c in figure.axes[0].collections if isinstance(c, LineCollection)]


def series() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {name: rng.exponential(4.0, (8, 50)) for name in ("rrt", "lazy_prm", "oracle")}


@pytest.mark.parametrize("name", FORMATS)
def test_save__writes_the_same_bytes_twice(tmp_path, name):
    first = save(figures.efficiency_over_samples(series()), tmp_path / "one" / "curve", [name])
    second = save(figures.efficiency_over_samples(series()), tmp_path / "two" / "curve.png", [name])
    assert [file.name for file in first + second] == [f"curve.{name}"] * 2
    assert first[0].stat().st_size > 1000
    assert first[0].read_bytes() == second[0].read_bytes()


def test_save__refuses_other_formats_and_unwritable_places(tmp_path):
    figure = figures.environments([problem_of(2)])
    with pytest.raises(InvalidInputError, match="bmp"):
        save(figure, tmp_path / "figure", ["bmp"])
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot write"):
        save(figure, tmp_path / "file" / "figure")


def test_figures__leave_matplotlib_as_it_was():
    script = (
        "import sys; from guided_gym.train import figures as f; import matplotlib as m, numpy as n\n"
        "m.rcParams['font.size'] = 31; f.efficiency_over_samples({'rrt': n.ones((3, 9))})\n"
        "assert m.rcParams['font.size'] == 31 and 'matplotlib.pyplot' not in sys.modules"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


def test_efficiency_over_samples__draws_the_mean_within_its_band():
    values = series()
    axes = figures.efficiency_over_samples(values).axes[0]
    assert [line.get_label() for line in axes.lines] == ["RRT", "LazyPRM", "Oracle"]
    for line, band, name in zip(axes.lines, axes.collections, values, strict=True):
        assert np.allclose(line.get_ydata(), values[name].mean(axis=0))
        corners = band.get_paths()[0].vertices
        assert corners[:, 1].max() > values[name].mean(axis=0).max()
    assert "nats" in axes.get_ylabel()
    assert axes.get_xlabel() == "samples"


def test_efficiency_over_samples__says_when_it_is_smoothed():
    axes = figures.efficiency_over_samples(series(), window=7).axes[0]
    assert "mean of 7 samples" in axes.get_ylabel()
    assert "mean" not in figures.efficiency_over_samples(series()).axes[0].get_ylabel()


def test_efficiency_over_samples__ends_with_the_last_search():
    values = np.zeros((4, 100))
    values[:, :30] = 2.0
    assert figures.efficiency_over_samples({"rrt": values}).axes[0].get_xlim() == (1.0, 30.0)


def test_efficiency_over_samples__window_averages_and_keeps_a_constant():
    values = np.zeros((1, 9))
    values[0, 4] = 3.0
    drawn = figures.efficiency_over_samples({"rrt": values}, window=3).axes[0].lines[0].get_ydata()
    assert np.allclose(drawn, [0, 0, 0, 1, 1, 1, 0, 0, 0])
    flat = figures.efficiency_over_samples({"rrt": np.full((2, 9), 5.0)}, window=4).axes[0].lines[0]
    assert np.allclose(flat.get_ydata(), 5.0)


@pytest.mark.parametrize(
    ("values", "window"), [({}, 1), ({"rrt": np.ones(4)}, 1), ({"rrt": np.ones((2, 4))}, 0)]
)
def test_efficiency_over_samples__refuses_what_is_no_curve(values, window):
    with pytest.raises(InvalidInputError, match="expected"):
        figures.efficiency_over_samples(values, window=window)


def test_environments__shows_the_whole_catalogue():
    figure = figures.environments()
    assert {"SimplePassage", "Cup", "Trap", "TrapCup"} <= {axes.get_title() for axes in figure.axes}


@pytest.mark.parametrize("dimension", [2, 3])
def test_search_tree__shows_every_edge_and_the_path(tmp_path, dimension):
    problem = problem_of(dimension)
    _, search = searched(problem, "rrt", 400)
    assert search.solved
    figure = figures.search_tree(search, problem, target=even(search))
    assert sum(len(lines.get_segments()) for lines in lines_of(figure)) == len(search.tree) - 1
    ends = np.array([problem.task.start[:2], problem.task.goal[:2]])
    drawn = [line.get_xydata() for line in figure.axes[0].lines if len(line.get_xydata()) > 1]
    assert len(drawn) == 2  # the path and its casing
    assert all(np.allclose(line[[0, -1]], ends) for line in drawn)
    assert save(figure, tmp_path / "tree", ["png"])[0].stat().st_size > 5000


def test_search_tree__asks_the_oracle_when_no_target_is_given():
    problem = problem_of(2)
    _, search = searched(problem, "rrt", 20)
    own = figures.search_tree(search, problem)
    nodes = own.axes[0].collections[-1].get_array()
    assert np.allclose(np.sort(nodes), np.sort(Measure(search).distribution()))


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(
    "name", ["rrt", "lazy_prm", "prm", "medial_axis", "goal_distance", "uninformed", "lazy_prm+medial_axis"]
)
def test_guiding_space__has_a_picture_of_each(tmp_path, name, dimension):
    guidance, _ = searched(problem_of(dimension), name, 30)
    figure = figures.guiding_space(guidance)
    assert len([axes for axes in figure.axes if axes.get_title()]) == name.count("+") + 1
    assert save(figure, tmp_path / "space", ["png"])[0].stat().st_size > 2000


def test_guiding_space__stored_paths_that_were_filtered_out_are_red():
    problem = problem_of(3)
    guidance, search = searched(problem, make_guidance("path_database", database=stored_paths(problem)), 0)
    before = [len(lines.get_segments()) for lines in lines_of(figures.guiding_space(guidance))]
    search.expand(0, np.array([3.6, 1.0, 0.0]))
    after = lines_of(figures.guiding_space(guidance))
    assert before[1] == 0
    assert len(after[1].get_segments()) > 0
    assert len(after[0].get_segments()) + len(after[1].get_segments()) == sum(before)
    assert np.allclose(after[1].get_colors()[0][:3], to_rgb("#d52c14"))


def test_regions__one_bar_per_guidance_and_region():
    known = Interval(3.0, 2.5, 3.75)
    figure = figures.regions({"lazy_prm": {"trap": known, "cup": known}, "medial_axis": {"trap": known}})
    axes = figure.axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["trap", "cup"]
    assert [patch.get_height() for patch in axes.patches] == [3.0] * 3
    with pytest.raises(InvalidInputError, match="at least one"):
        figures.regions({})


def test_database__has_one_point_per_size():
    intervals = [Interval(x, x - 0.1, x + 0.1) for x in (3.0, 2.0, 1.0)]
    figure = figures.database([10, 30, 100], intervals, intervals, baseline=intervals[0])
    left, right = figure.axes
    assert np.allclose(left.containers[0].lines[0].get_ydata(), [3, 2, 1])
    assert np.allclose(right.containers[0].lines[0].get_ydata(), [3000, 2000, 1000])
    with pytest.raises(InvalidInputError, match="2 SE"):
        figures.database([10, 30, 100], intervals[:2], intervals)


def test_looks__a_guidance_keeps_its_colour_and_no_two_share_one():
    names = ["rrt", "lazy_prm", "lazy_prm:vertices=500", "lazy_prm+medial_axis", "mine", "rrt"]
    looks = Looks(names)
    colours = [looks.colour(name) for name in names[:-1]]
    assert len(set(colours)) == len(colours)
    assert Looks(["medial_axis", "rrt"]).colour("rrt") == looks.colour("rrt")
    assert looks.label("lazy_prm") == label_of("lazy_prm") == "LazyPRM"
    assert looks.label("mine") == "mine"


def test_style__uses_a_font_that_comes_with_matplotlib():
    from matplotlib import font_manager

    assert matplotlib.get_data_path() in font_manager.findfont("DejaVu Sans", fallback_to_default=False)
