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
from guided_gym.options import SearchOptions, TargetParameters
from guided_gym.planning import guided_search
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
    bounded = figures.efficiency_over_samples(values, best={"rrt": values["rrt"] / 2}, ceiling=9.2).axes[0]
    assert [line.get_label() for line in bounded.lines][-2:] == ["best possible", "ceiling, log 1/ε"]
    assert np.allclose(bounded.lines[3].get_ydata(), values["rrt"].mean(axis=0) / 2)
    for line, band, name in zip(axes.lines, axes.collections, values, strict=True):
        assert np.allclose(line.get_ydata(), values[name].mean(axis=0))
        corners = band.get_paths()[0].vertices
        assert corners[:, 1].max() > values[name].mean(axis=0).max()
    assert "nats" in axes.get_ylabel()
    assert axes.get_xlabel() == "samples"


def test_efficiency_over_samples__says_when_it_is_smoothed():
    axes = figures.efficiency_over_samples(series(), window=7).axes[0]
    assert "mean of 7 samples" in axes.get_ylabel()
    assert "0 once a search has ended" in axes.get_ylabel()
    assert "mean" not in figures.efficiency_over_samples(series()).axes[0].get_ylabel()


def test_efficiency_over_samples__ends_with_the_last_search():
    values = np.zeros((4, 100))
    values[:, :30] = 2.0
    assert figures.efficiency_over_samples({"rrt": values}).axes[0].get_xlim() == (1.0, 30.0)


def test_efficiency_over_samples__window_averages_and_keeps_a_constant():
    values = np.zeros((1, 9))
    values[0, 4] = 3.0
    drawn = figures.efficiency_over_samples({"rrt": values}, window=3).axes[0].lines[0].get_ydata()
    assert np.allclose(drawn, [0, 0, 0, 1, 1, 1])  # the curve ends with the last search
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
    assert len(drawn) == 1  # the path, below the tree
    assert all(np.allclose(line[[0, -1]], ends) for line in drawn)
    assert save(figure, tmp_path / "tree", ["png"])[0].stat().st_size > 5000


def test_search_tree__asks_the_oracle_when_no_target_is_given():
    problem = problem_of(2)
    _, search = searched(problem, "rrt", 20)
    own = figures.search_tree(search, problem)
    nodes = own.axes[0].collections[-1].get_array()
    assert np.allclose(np.sort(nodes), np.sort(Measure(search).distribution()))


def test_search_tree__is_coloured_by_the_searchs_own_target():
    problem = problem_of(2)
    options = SearchOptions(target=TargetParameters(delta=0.7, tau=0.9))
    result = guided_search(problem, "rrt", seed=3, max_samples=30, options=options)
    nodes = figures.search_tree(result, problem).axes[0].collections[-1].get_array()
    assert np.allclose(np.sort(nodes), np.sort(Measure(result).distribution()))
    assert not np.allclose(np.sort(nodes), np.sort(Measure(result, TargetParameters()).distribution()))


def test_search_tree__has_a_legend_and_a_path_that_hides_no_node():
    problem = problem_of(3)
    _, search = searched(problem, "rrt", 400)
    figure = figures.search_tree(search, problem, target=even(search))
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "start", "goal", "path found", "collision"
    ]  # fmt: skip
    path = next(line for line in figure.axes[0].lines if len(line.get_xydata()) > 1)
    assert all(path.get_zorder() < lines.get_zorder() for lines in lines_of(figure))


def test_panels__fill_their_rows():
    problem = problem_of(2)
    _, search = searched(problem, "uninformed", 5)
    for count, rows in ((4, [4]), (5, [5]), (6, [3, 3]), (7, [4, 3]), (8, [4, 4])):
        figure = figures.search_trees([("tree", search, problem)] * count, targets=[even(search)] * count)
        tops = [round(axes.get_position().y0, 3) for axes in figure.axes if axes.get_title()]
        assert [tops.count(top) for top in sorted(set(tops), reverse=True)] == rows


def test_heat_maps__show_values_from_below_and_nothing_where_nothing_was():
    values = np.zeros((2, 4))
    values[0, 3] = 5.0
    figure = figures.heat_maps([("rrt", values), ("prm", 2 * values)], problem_of(2), label="SE")
    image = figure.axes[0].images[0]
    assert image.get_extent() == [0.0, 8.0, 0.0, 4.0]
    assert image.origin == "lower"
    assert image.get_array().count() == 1
    assert figure.axes[0].images[0].norm is figure.axes[1].images[0].norm


def progress_of(samples: list[int], solved: list[bool], limit: int = 20, se: float = 2.0) -> figures.Progress:
    drawn = np.arange(limit) < np.array(samples)[:, None]
    efficiency, best = np.where(drawn, se, 0.0), np.where(drawn, 1.0, 0.0)
    return figures.Progress(efficiency, best, np.array(samples), np.array(solved))


def test_search_progress__counts_zeros_survivors_and_the_solved():
    one = progress_of([4, 8, 8, 8, 8, 20], [True, True, True, True, True, False])
    figure = figures.search_progress({"rrt": one}, ceiling=9.2)
    whole, surviving, solved = figure.axes
    assert whole.lines[0].get_ydata()[5] == pytest.approx(2.0 * 5 / 6)  # one has ended, and counts as 0
    assert np.allclose(surviving.lines[0].get_ydata(), 2.0)  # whoever is left has 2
    assert len(surviving.lines[0].get_ydata()) == 8  # one search alone is no mean; five are
    x, y = solved.lines[0].get_data()
    assert np.asarray(x).tolist() == [0, 4, 8, 8, 8, 8, 20]
    assert np.asarray(y) * 6 == pytest.approx([0, 1, 2, 3, 4, 5, 5])
    assert "0 once ended" in whole.get_title()
    said = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"best possible", "ceiling, log 1/ε"} <= said


def test_samples__are_on_a_logarithmic_axis_where_searches_end_far_apart():
    short, long = progress_of([3, 4], [True, True], 90), progress_of([80, 90], [True, True], 90)
    assert figures.search_progress({"a": short, "rrt": long}).axes[0].get_xscale() == "log"
    assert figures.search_progress({"rrt": long}).axes[0].get_xscale() == "linear"


def test_quality_over_cost__marks_what_was_not_solved():
    known = Interval(3.0, 2.5, 3.75), Interval(2.0, 1.5, 2.5)
    costs = {"rrt": figures.Cost(known, known, 0), "lazy_prm": figures.Cost(known, known, 3)}
    figure = figures.quality_over_cost(costs)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["RRT", "LazyPRM (3 not solved)"]
    filled, hollow = (container.lines[0] for container in figure.axes[0].containers)
    assert hollow.get_markerfacecolor() == "white" != filled.get_markerfacecolor()
    with pytest.raises(InvalidInputError, match="at least one"):
        figures.quality_over_cost({})


def test_legends_below__show_every_name():
    known = Interval(3.0, 2.5, 3.75), Interval(2.0, 1.5, 2.5)
    names = ["rrt", "oracle", *(f"path_database({size})" for size in (10, 30, 100, 300, 1000, 3000))]
    figure = figures.quality_over_cost({name: figures.Cost(known, known, 3) for name in names})
    figure.canvas.draw()
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.x1
    looks = Looks(names)
    assert len({looks.colour(name) for name in names}) == len(names)


def test_looks__tell_five_lines_apart_without_colours():
    names = ["rrt", "lazy_prm", "medial_axis", "hybrid", "wavefront"]
    many, few = Looks(names), Looks(names[:4])
    assert len({str(many.dash(name)) for name in names}) == 5
    assert {few.dash(name) for name in names[:4]} == {"-"}
    assert many.colour("rrt") == few.colour("rrt")


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
