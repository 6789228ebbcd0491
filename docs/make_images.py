"""Draw the pictures of the README and of these pages: ``python docs/make_images.py``.

With ``arm`` behind it, only that of the arm of two joints.

Run it again when the problems, the guiding spaces or the looks of the figures have changed, and look at what
it wrote. Needs pygame (``pip install '.[render]'``) for the frames of the environment.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from PIL import Image

from guided_gym import (
    GuidingSpace,
    Problem,
    Search,
    build_path_database,
    distribution_names,
    guided_search,
    make_distribution,
    make_guidance,
    smooth,
    streams,
)
from guided_gym.envs.rendering import Renderer
from guided_gym.train import figures
from guided_gym.train import workspace_axes as workspace
from guided_gym.train.style import INK, new_figure, styled
from guided_gym.train.workspace_axes import GOAL, PATH, START

IMAGES = Path(__file__).parent / "images"
DOTS_PER_INCH = 150
FINE_LINES = {"prm": 100, "lazy_prm": 100, "path_database": 100, "hybrid": 90}  # or their files get large
PATHS = 1000
MAX_SAMPLES = 1000
CELLS = 360  # along each joint of the picture of a configuration space

# Guiding space, the problem that it is shown on, the seed, and how much of the search: the page's pictures
# are taken while there is something to learn.
SHOWN = (
    ("uninformed", "SimplePassage", 3, 400),
    ("goal_distance", "Cup", 3, MAX_SAMPLES),
    ("oracle", "TrapCup", 3, MAX_SAMPLES),
    ("rrt", "SimplePassage", 3, MAX_SAMPLES),
    ("prm", "SimplePassage", 3, MAX_SAMPLES),
    ("lazy_prm", "Cup", 3, MAX_SAMPLES),
    ("medial_axis", "Trap", 3, MAX_SAMPLES),
    ("path_database", "RandomSimplePassage", 3, MAX_SAMPLES),
    ("wavefront", "RandomClutter", 6, MAX_SAMPLES),
    ("hybrid", "TrapCup", 3, MAX_SAMPLES),
)
COMPARED = ("lazy_prm", "medial_axis", "hybrid")
README_SEED = 3


def searched(problem: Problem, guidance: GuidingSpace, seed: int, samples: int = MAX_SAMPLES) -> Search:
    """A search as `guided_search` does it, kept whole for the renderer."""
    _, expansion_rng, guidance_rng = streams(seed)
    search = Search(problem, expansion_rng, guidance_rng)
    search.attach(guidance)
    search.run(guidance, samples)
    return search


def save(figure: Figure, name: str, dots_per_inch: int = DOTS_PER_INCH) -> None:
    """Write a figure as PNG, in 256 colours: a third of the size, and looks the same."""
    file = IMAGES / f"{name}.png"
    figure.savefig(file, dpi=dots_per_inch, metadata={"Software": None})
    colours = Image.open(file).convert("RGB").quantize(256, dither=Image.Dither.NONE)
    colours.save(file, optimize=True)
    print(name)


def draw_problems() -> None:
    """Each problem of the catalogue by itself."""
    for name in distribution_names():
        problem = make_distribution(name).problem(0)
        save(figures.environments([problem]), f"environment-{problem.name}")


def draw_distributions() -> None:
    """Four problems of each distribution."""
    for name in distribution_names():
        distribution = make_distribution(name)
        if not distribution.fixed:
            problems = [distribution.problem(seed) for seed in range(4)]
            save(figures.environments(problems), f"distribution-{name}", 90)


def draw_trap_cup() -> None:
    """The README's picture: a hybrid's search; and the three searches of the paper's figure."""
    problem = make_distribution("TrapCup").problem(0)
    hybrid = searched(problem, make_guidance("hybrid"), README_SEED)
    Image.fromarray(Renderer(size=960).frame(hybrid)).save(IMAGES / "trapcup.png", optimize=True)
    items = []
    for name in COMPARED:
        search = searched(problem, make_guidance(name), README_SEED)
        items.append((f"{figures.label_of(name)}, {search.samples} samples", search, problem))
    save(figures.search_trees(items), "trapcup-trees")


def draw_planar_arm() -> None:
    """Figure 1 of the paper: the way that ignores an obstacle, in red, and a search that it guides."""
    problem = make_distribution("PlanarArm2").problem(0)
    without = replace(problem, environment=problem.environment.keeping([0]))
    found = guided_search(without, "oracle", seed=0, measure=False)
    assert found.path is not None
    red = smooth(without.space, found.path, np.random.default_rng(0))
    search = searched(problem, make_guidance("roadmap(environment=without(1))"), 0)
    save(_planar_arm(problem, without, red, search), "planar-arm-2")


@styled
def _planar_arm(problem: Problem, without: Problem, red: np.ndarray, search: Search) -> Figure:
    figure = new_figure(6.6, 3.2)
    left, right = figure.subplots(1, 2)
    workspace.draw_workspace(left, problem.environment)
    for q in workspace.spaced(problem, red)[1:-1]:
        workspace.draw_outline(left, problem.robot, q, PATH, filled=False)
    workspace.draw_task(left, problem)
    for name, obstacle in zip(("o1", "o2"), problem.environment.obstacles, strict=True):
        left.annotate(name, obstacle.centroid.coords[0], ha="center", va="center", color="white")
    turns = np.linspace(-np.pi, np.pi, CELLS, endpoint=False) + np.pi / CELLS
    every = np.stack(np.meshgrid(turns, turns), axis=-1).reshape(-1, 2)
    free = np.asarray(problem.space.valid(every))
    kind = np.where(free, 0, np.where(without.space.valid(every), 1, 2)).reshape(CELLS, CELLS)
    shades = ListedColormap(["white", "#C9CED6", "#8A93A1"])
    right.imshow(kind, shades, origin="lower", extent=(-np.pi, np.pi, -np.pi, np.pi), interpolation="nearest")
    nodes, parents = search.tree.configurations, search.tree.parents
    for child in range(1, len(nodes)):
        _draw_way(right, problem, nodes[[parents[child], child]], INK, 0.5)
    path = search.path()
    if path is not None:
        _draw_way(right, problem, path, START, 1.6)
    _draw_way(right, problem, red, PATH, 1.6)
    for q, colour in ((problem.task.start, START), (problem.task.goal, GOAL)):
        right.plot(*q, "o", color=colour, markersize=5, zorder=5)
    right.set(xlim=(-np.pi, np.pi), ylim=(-np.pi, np.pi), xlabel="first joint", ylabel="second joint")
    right.grid(False)
    left.set_title("Workspace", loc="left")
    right.set_title("Configuration space", loc="left")
    return figure


def _draw_way(axes: Axes, problem: Problem, path: np.ndarray, colour: str, width: float) -> None:
    """A way in C, whose joints turn freely: it may leave the picture on one side and come back on another."""
    space = problem.space
    for a, b in pairwise(path):
        change = space.difference(a, b)
        for line in ((a, a + change), (b - change, b)):
            axes.plot(*np.stack(line).T, color=colour, linewidth=width, solid_capstyle="round")


def draw_guiding_spaces(folder: Path) -> None:
    """What guides, after a search, and the tree that it guided."""
    database = folder / "paths.sqlite"
    build_path_database("RandomSimplePassage", database, PATHS)
    for name, environment, seed, samples in SHOWN:
        options = {"database": database} if name == "path_database" else {}
        guidance = make_guidance(name, **options)
        problem = make_distribution(environment).problem(seed)
        search = searched(problem, guidance, seed, samples)
        label = figures.label_of(name)
        figure = figures.guiding_space(guidance, search, title=f"{label}: what guides")
        save(figure, f"guiding-{name}", FINE_LINES.get(name, DOTS_PER_INCH))
        title = f"{label} on {environment}, {search.samples} samples"
        save(figures.search_tree(search, problem, title=title), f"tree-{name}")


def main() -> None:
    """Draw everything."""
    IMAGES.mkdir(exist_ok=True)
    draw_planar_arm()
    if "arm" in sys.argv[1:]:
        return
    draw_problems()
    draw_distributions()
    draw_trap_cup()
    with tempfile.TemporaryDirectory() as folder:
        draw_guiding_spaces(Path(folder))


if __name__ == "__main__":
    main()
