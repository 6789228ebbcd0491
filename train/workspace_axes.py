"""Drawing searches and guiding spaces into one pair of matplotlib axes, in workspace coordinates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PatchCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize, to_hex, to_rgb, to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import PathPatch
from matplotlib.path import Path
from numpy.typing import NDArray

from guided_gym.envs import palette
from guided_gym.envs.rendering import spaced, trace
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.solids import SpatialEnvironment
from guided_gym.guidance.cells import Uninformed, Voronoi
from guided_gym.train.style import INK, TARGET_MAP

if TYPE_CHECKING:
    from guided_gym.geometry.environment import Environment
    from guided_gym.geometry.mechanism import Mechanism
    from guided_gym.guidance.base import GuidingSpace
    from guided_gym.problems import Problem
    from guided_gym.search.search import Search
    from guided_gym.search.tree import SearchTree

FloatArray = NDArray[np.float64]

PATH = palette.hexadecimal(palette.PATH)
FREE = palette.hexadecimal(palette.FREE)
OBSTACLE = palette.hexadecimal(palette.OBSTACLE)
PALE_OBSTACLE = "#b3b8bf"
FIELD = "#0072B2"
START = palette.hexadecimal(palette.START)
GOAL = palette.hexadecimal(palette.GOAL)
FIELD_CELLS = 160  # along the longer side, of a heuristic drawn as a field
FIELD_LEVELS = 12

# From the back to the front.
_CELLS, _OBSTACLES, _PATH, _FAILURES, _EDGES, _NODES, _TASK = range(1, 8)


def draw_workspace(axes: Axes, environment: Environment, colour: str = OBSTACLE) -> None:
    """Draw bounds and obstacles, without ticks: the unit of length means nothing to the reader."""
    xmin, ymin, xmax, ymax = environment.bounds
    axes.set(xlim=(xmin, xmax), ylim=(ymin, ymax), aspect="equal", xticks=[], yticks=[], facecolor=FREE)
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set(visible=True, color=OBSTACLE, linewidth=0.7)
    look: dict[str, Any] = {"facecolor": colour, "edgecolor": "none"}
    if isinstance(environment, SpatialEnvironment):  # let through what is behind them
        look = {"facecolor": to_rgba(colour, 0.22), "edgecolor": colour, "linewidth": 0.7}
    axes.add_collection(PatchCollection(_obstacles(environment), zorder=_OBSTACLES, **look))


def _obstacles(environment: Environment) -> list[PathPatch]:
    """A patch of each obstacle: of those in the plane together, of the shadow of each one in space."""
    spatial = isinstance(environment, SpatialEnvironment)
    parts = environment.obstacles if spatial else shapely.get_parts(environment.obstacle_union)
    return [_patch(part) for part in parts]


def _patch(shape: Any) -> PathPatch:
    """A polygon with its holes, a line or a point's disc as one patch."""
    if isinstance(shape, shapely.Polygon):
        rings = [np.asarray(ring.coords) for ring in (shape.exterior, *shape.interiors)]
        return PathPatch(Path.make_compound_path(*(Path(ring, closed=True) for ring in rings)))
    return PathPatch(Path(np.asarray(shape.coords)))


def draw_robot(axes: Axes, problem: Problem, q: FloatArray, colour: str, *, filled: bool = False) -> None:
    """The robot's outlines at a configuration."""
    draw_outline(axes, problem.robot, q, colour, filled=filled)


def draw_outline(axes: Axes, robot: Mechanism, q: FloatArray, colour: str, *, filled: bool = True) -> None:
    """A robot's outlines at a configuration, free or not."""
    for shape in robot.place(q):
        _draw_body(axes, shape, colour, filled)


def _draw_body(axes: Axes, shape: Any, colour: str, filled: bool) -> None:
    zorder = _TASK if filled else _PATH
    if isinstance(shape, shapely.Point):
        axes.plot(shape.x, shape.y, "o", color=colour, markersize=4.5 if filled else 2.5, zorder=zorder)
        return
    patch = _patch(shape)
    tint = _mixed(colour, 0.35) if filled and isinstance(shape, shapely.Polygon) else "none"
    patch.set(facecolor=tint, edgecolor=colour, linewidth=0.9 if filled else 0.55, zorder=zorder)
    axes.add_patch(patch)


def _mixed(colour: str, share: float) -> tuple[float, float, float]:
    """The colour mixed with white."""
    red, green, blue = (1.0 - share * (1.0 - channel) for channel in to_rgb(colour))
    return red, green, blue


def _shades(colour: str, first: float, last: float) -> LinearSegmentedColormap:
    """From one share of the colour to another, the rest white."""
    return LinearSegmentedColormap.from_list("shades", [_mixed(colour, first), _mixed(colour, last)])


HEAT_MAP = _shades("#B2182B", 0.06, 1.0)
PALE_PATH = to_hex(_mixed(PATH, 0.42))


def draw_task(axes: Axes, problem: Problem) -> None:
    """The robot at start and goal."""
    draw_robot(axes, problem, problem.task.start, START, filled=True)
    draw_robot(axes, problem, problem.task.goal, GOAL, filled=True)


def draw_tree(axes: Axes, tree: SearchTree, target: FloatArray | None, norm: Normalize) -> None:
    """Edges and nodes coloured by the target (n,), the likeliest on top; in one colour if it is None."""
    points, parents = tree.space.robot.position(tree.configurations), tree.parents
    order = np.arange(len(tree)) if target is None else np.argsort(target, kind="stable")
    children = order[parents[order] >= 0]
    edges = np.stack([points[parents[children]], points[children]], axis=1)
    if target is None:
        axes.add_collection(LineCollection(list(edges), colors=INK, linewidths=0.5, zorder=_EDGES))
        axes.scatter(points[:, 0], points[:, 1], s=2.0, c=INK, linewidths=0, zorder=_NODES)
        return
    style: dict[str, Any] = {"cmap": TARGET_MAP, "norm": norm}
    lines = LineCollection(list(edges), array=target[children], linewidths=0.7, zorder=_EDGES, **style)
    axes.add_collection(lines)
    x, y = points[order].T
    axes.scatter(x, y, s=3.5, c=target[order], linewidths=0, zorder=_NODES, **style)


def draw_failures(axes: Axes, tree: SearchTree) -> None:
    """Where expansions collided."""
    points = tree.space.robot.position(tree.contacts)
    axes.scatter(points[:, 0], points[:, 1], s=3.0, c=PATH, alpha=0.25, linewidths=0, zorder=_FAILURES)


def draw_path(axes: Axes, problem: Problem, path: FloatArray, *, alone: bool = False) -> None:
    """The path found, with the robot along it: wide and pale, and below the tree, whose colours mean more.

    Where there is no tree, it stands ``alone``: thin and strong.
    """
    colour, width = (PATH, 1.4) if alone else (PALE_PATH, 4.0)
    axes.plot(
        *trace(problem.space, path).T, color=colour, linewidth=width, zorder=_PATH, solid_joinstyle="round"
    )
    for q in spaced(problem, path)[1:-1]:
        draw_robot(axes, problem, q, colour)


def tree_legend() -> list[Line2D]:
    """What the marks of a tree's picture mean, for a legend."""

    def mark(label: str, colour: str, **style: Any) -> Line2D:
        return Line2D([], [], color=colour, label=label, linestyle="none", **style)

    return [
        mark("start", START, marker="s", markersize=5, markerfacecolor=_mixed(START, 0.35)),
        mark("goal", GOAL, marker="s", markersize=5, markerfacecolor=_mixed(GOAL, 0.35)),
        Line2D([], [], color=PALE_PATH, linewidth=4.0, label="path found"),
        mark("collision", PATH, marker="o", markersize=2.5, alpha=0.4, markeredgewidth=0),
    ]


def draw_heat(
    axes: Axes, problem: Problem, values: FloatArray, norm: Normalize, *, obstacles: bool = True
) -> None:
    """Values (rows, columns) on a grid over the workspace, row by row from below; none where they are 0."""
    environment = problem.environment
    xmin, ymin, xmax, ymax = environment.bounds
    draw_workspace(axes, environment if obstacles else Environment(environment.bounds), PALE_OBSTACLE)
    axes.imshow(
        np.ma.masked_equal(values, 0.0), cmap=HEAT_MAP, norm=norm, origin="lower", zorder=_EDGES,
        extent=(xmin, xmax, ymin, ymax), interpolation="nearest",
    )  # fmt: skip
    if obstacles:
        _outline_obstacles(axes, environment)
        draw_task(axes, problem)


def target_norm(targets: list[FloatArray]) -> LogNorm:
    """One logarithmic colour scale for several targets, from the least to the largest probability."""
    values = np.concatenate(targets) if targets else np.array([1e-4, 1.0])
    low = max(float(values.min()), 1e-6)
    return LogNorm(low, max(float(values.max()), 10 * low), clip=True)


def draw_guiding_space(axes: Axes, guidance: GuidingSpace, search: Search, colour: str) -> Any:
    """What guides: the graph that the guiding space walks on, the tree's cells, or h as a field.

    Returns:
        The artist to make a colour bar for, with its meaning in ``get_label``; None if there is none.
    """
    draw_workspace(axes, search.problem.environment, PALE_OBSTACLE)
    draw = getattr(guidance, "drawing", None)
    drawing = draw() if draw is not None else {}
    mappable = None
    if "edges" in drawing:
        mappable = _draw_graph(axes, drawing, colour)
        _outline_obstacles(axes, search.problem.environment)
    elif "field" in drawing and not isinstance(search.problem.robot, Robot):
        mappable = _draw_levels(axes, drawing["field"], *drawing["bounds"])
    elif not isinstance(search.problem.robot, Robot):
        mappable = None  # h of joint angles is no field over the workspace
    elif isinstance(guidance, Voronoi):
        mappable = _draw_cells(axes, guidance, search, colour)
    elif not isinstance(guidance, Uninformed):
        mappable = _draw_field(axes, guidance, search)
    if "edges" not in drawing:
        draw_tree(axes, search.tree, None, Normalize())
    draw_task(axes, search.problem)
    return mappable


def _outline_obstacles(axes: Axes, environment: Environment) -> None:
    """The obstacles' edges, on top of a roadmap that may cover them."""
    shapes = _obstacles(environment)
    outline = PatchCollection(shapes, facecolor="none", edgecolor=OBSTACLE, linewidth=0.6, zorder=_NODES)
    axes.add_collection(outline)


def _draw_graph(axes: Axes, drawing: dict[str, NDArray[Any]], colour: str) -> Any:
    """Edges alive, coloured by their weight if weights differ, else by h; removed ones in red."""
    ends = drawing["points"][drawing["edges"]]
    alive, weights = drawing["alive"], drawing["weights"]
    width = 1.6 if len(ends) < 500 else 0.5 if len(ends) < 5000 else 0.3
    lines = LineCollection(list(ends[alive]), linewidths=width, zorder=_EDGES)
    faint = 0.8 if (~alive).sum() < 500 else 0.3
    removed = LineCollection(list(ends[~alive]), colors=PATH, linewidths=0.35, alpha=faint, zorder=_NODES)
    axes.add_collection(lines)
    axes.add_collection(removed)
    if (weights[alive] != 1.0).any():
        order = np.argsort(weights[alive], kind="stable")  # the heaviest on top
        lines.set(segments=list(ends[alive][order]), array=weights[alive][order], cmap=TARGET_MAP)
        lines.set(norm=LogNorm(1.0, float(weights[alive].max())), label="edge weight")
        return lines
    values = drawing.get("values")
    if values is None or len(ends) < 500:
        lines.set_color(colour)
        return None
    h = values[drawing["edges"][alive]].mean(axis=1)
    lines.set(array=np.ma.masked_invalid(h), cmap=_shades(colour, 1.0, 0.3), label="h (length)")
    return lines


def _draw_cells(axes: Axes, guidance: Voronoi, search: Search, colour: str) -> Any:
    """The workspace's tessellation around the nodes, shaded by the share of C that each one is nearest to."""
    points = search.tree.configurations[:, :2]
    bounds = shapely.box(*search.problem.environment.bounds)
    cells = shapely.voronoi_polygons(shapely.multipoints(points), extend_to=bounds)
    parts = np.array([cell.intersection(bounds) for cell in shapely.get_parts(cells)])
    parts = parts[~shapely.is_empty(parts)]
    index = shapely.STRtree(shapely.points(points))
    node = index.nearest(shapely.centroid(parts))
    inside_cell, inside_node = index.query(parts, predicate="intersects")
    node[inside_cell] = inside_node
    share = 100 * guidance.distribution(search.tree)[node]
    patches = PatchCollection(
        [_patch(part) for part in parts], cmap=_shades(colour, 0.04, 0.6), zorder=_CELLS
    )
    patches.set(edgecolor="white", linewidth=0.4, array=share, label="share of C (%)")
    patches.set_clim(0.0, max(float(share.max()), 1e-12))
    axes.add_collection(patches)
    return patches


def _draw_field(axes: Axes, guidance: GuidingSpace, search: Search) -> Any:
    """The heuristic over the workspace, its other coordinates held at the goal's."""
    xmin, ymin, xmax, ymax = search.problem.environment.bounds
    cell = max(xmax - xmin, ymax - ymin) / FIELD_CELLS
    x = np.arange(xmin + cell / 2, xmax, cell)
    y = np.arange(ymin + cell / 2, ymax, cell)
    q = np.tile(search.goal, (x.size * y.size, 1))
    q[:, 0], q[:, 1] = np.tile(x, y.size), np.repeat(y, x.size)
    h = np.asarray(guidance.heuristic(guidance.project(search.tree, q)), np.float64).reshape(y.size, x.size)
    return _draw_levels(axes, h, xmin, ymin, xmin + x.size * cell, ymin + y.size * cell)


def _draw_levels(
    axes: Axes, h: NDArray[np.float64], xmin: float, ymin: float, xmax: float, ymax: float
) -> Any:
    """A heuristic (rows, columns), row by row from below, in shades over the bounds of its cells."""
    rows, columns = h.shape
    x = xmin + (np.arange(columns) + 0.5) / columns * (xmax - xmin)
    y = ymin + (np.arange(rows) + 0.5) / rows * (ymax - ymin)
    shades = _shades(FIELD, 0.7, 0.03)
    field = axes.contourf(x, y, np.ma.masked_invalid(h), FIELD_LEVELS, cmap=shades, zorder=_CELLS)
    field.set_label("h (length)")
    return field
