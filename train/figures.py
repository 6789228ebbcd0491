"""The figures of an evaluation: each function returns a matplotlib Figure, `save` writes it.

Nothing here touches pyplot: no window, no global state.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm, PowerNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray

from guided_gym.catalogue.table import distribution_names, make_distribution
from guided_gym.errors import InvalidInputError
from guided_gym.measure.target import Measure
from guided_gym.planning import SearchResult
from guided_gym.search.search import Search
from guided_gym.train import workspace_axes as workspace
from guided_gym.train.curve_figures import (
    EFFICIENCY_LABEL,
    Cost,
    Progress,
    efficiency_over_samples,
    quality_over_cost,
    search_progress,
)
from guided_gym.train.statistics import Interval
from guided_gym.train.style import (
    COLUMN,
    INK,
    MUTED,
    PAGE,
    TARGET_MAP,
    Looks,
    label_of,
    new_figure,
    save,
    styled,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from guided_gym.guidance.base import GuidingSpace
    from guided_gym.problems import Problem

FloatArray = NDArray[np.float64]

PANELS_A_ROW = 4
_WIDE = 30.0  # largest over smallest, from which on bars stand on a logarithmic axis
TITLE_HEIGHT, BAR_HEIGHT, LEGEND_HEIGHT, TALLEST_PANEL = 0.26, 0.34, 0.22, 5.0  # inches


@styled
def environments(problems: Sequence[Problem] | None = None) -> Figure:
    """An overview of problems: obstacles, and the robot at start (blue) and goal (green).

    Args:
        problems: What to show; the whole catalogue, seed 0 of each distribution, by default.
    """
    if problems is None:
        problems = [make_distribution(name).problem(0) for name in distribution_names()]
    figure, panels = _row(problems)
    for axes, problem in zip(panels, problems, strict=True):
        workspace.draw_workspace(axes, problem.environment)
        workspace.draw_task(axes, problem)
        _title(axes, problem.name)
    return figure


def search_tree(
    search: Search | SearchResult,
    problem: Problem,
    *,
    target: FloatArray | None = None,
    title: str | None = None,
) -> Figure:
    """A search tree coloured by its own target Q, its failed expansions, and the path found, in pale red.

    Args:
        search: The search, or what `guided_search` returned.
        problem: The problem that was searched.
        target: (n,) target probabilities; computed by default, which asks the oracle.
        title: Title of the axes; the problem's name by default.
    """
    targets = None if target is None else [target]
    return search_trees([(title or problem.name, search, problem)], targets=targets)


@styled
def search_trees(
    items: Sequence[tuple[str, Search | SearchResult, Problem]], *, targets: list[FloatArray] | None = None
) -> Figure:
    """Search trees as panels on one colour scale: (title, search, problem) of each; see `search_tree`."""
    if targets is None:
        targets = [_target(search) for _, search, problem in items]
    norm = workspace.target_norm(targets)
    figure, panels = _row([problem for _, _, problem in items], bars="common", legend=True)
    for axes, (title, search, problem), target in zip(panels, items, targets, strict=True):
        path = search.path() if isinstance(search, Search) else search.path
        workspace.draw_workspace(axes, problem.environment)
        workspace.draw_failures(axes, search.tree)
        workspace.draw_tree(axes, search.tree, target, norm)
        if path is not None:
            workspace.draw_path(axes, problem, path)
        workspace.draw_task(axes, problem)
        _title(axes, title)
    _bar(figure, panels, ScalarMappable(norm, TARGET_MAP), "target Q")
    figure.legend(
        handles=workspace.tree_legend(), loc="outside lower center", ncols=4, handlelength=1.4, fontsize=6.5
    )
    return figure


@styled
def heat_maps(
    items: Sequence[tuple[str, FloatArray]], problem: Problem, *, fixed: bool = True, label: str
) -> Figure:
    """A quantity by place, as panels over one workspace and on one colour scale.

    Args:
        items: Title and (rows, columns) values of each panel, row by row from below; 0 where nothing was.
        problem: Whose workspace it is.
        fixed: Whether all searches had that problem; else its obstacles are not drawn.
        label: What the colours mean, with its unit.

    Raises:
        InvalidInputError: No panel.
    """
    figure, panels = _row([problem] * len(items), bars="common")
    highest = max(float(np.max(values)) for _, values in items)
    norm = PowerNorm(0.5, 0.0, highest if highest > 0 else 1.0)
    for axes, (title, values) in zip(panels, items, strict=True):
        workspace.draw_heat(axes, problem, values, norm, obstacles=fixed)
        _title(axes, title)
    _bar(figure, panels, ScalarMappable(norm, workspace.HEAT_MAP), label)
    return figure


def _target(search: Search | SearchResult) -> FloatArray:
    return Measure(search).distribution()


def guiding_space(
    guidance: GuidingSpace, search: Search | None = None, *, title: str | None = None
) -> Figure:
    """What guides a search: see `guiding_spaces`."""
    return guiding_spaces([(title or label_of(guidance.name), guidance, search)])


@styled
def guiding_spaces(items: Sequence[tuple[str, GuidingSpace, Search | None]]) -> Figure:
    """What guides, as panels: (title, guiding space, search) of each.

    Drawn are the Voronoi cells of RRT, a roadmap or stored paths (what failures removed in faint red), a
    skeleton with its edges' weights, or else h as a field at the goal's orientation. A hybrid takes a panel
    for each of its guides.

    Args:
        items: The search is the one that the guiding space was last attached to, if None.
    """
    unfolded = [
        (title, part, search or guidance.search)
        for heading, guidance, search in items
        for title, part in _unfolded(heading, guidance)
    ]
    looks = Looks(guidance.name for _, guidance, _ in unfolded)
    figure, panels = _row([search.problem for _, _, search in unfolded], bars="each")
    for axes, (title, guidance, search) in zip(panels, unfolded, strict=True):
        mappable = workspace.draw_guiding_space(axes, guidance, search, looks.colour(guidance.name))
        _title(axes, title)
        if mappable is not None:
            _bar(figure, [axes], mappable, str(mappable.get_label()))
    return figure


def _unfolded(title: str, guidance: GuidingSpace) -> Iterable[tuple[str, GuidingSpace]]:
    guides: Sequence[GuidingSpace] = getattr(guidance, "guides", ())
    if not guides:
        yield title, guidance
    for guide in guides:
        yield f"{title}: {label_of(guide.name)}", guide


def _row(
    problems: Sequence[Problem], *, bars: Literal["common", "each", ""] = "", legend: bool = False
) -> tuple[Figure, list[Axes]]:
    """A figure with a panel per workspace, in even rows of at most four (five, if that is all)."""
    if not problems:
        raise InvalidInputError("expected at least one thing to draw, got none")
    count = len(problems)
    rows = 1 if count <= PANELS_A_ROW + 1 else -(-count // PANELS_A_ROW)
    columns = -(-count // rows)
    width = COLUMN if columns == 1 else PAGE
    tallest = max(_aspect(problem) for problem in problems)
    width = min(width, columns * TALLEST_PANEL / tallest)
    below = BAR_HEIGHT if bars == "each" else 0.0
    height = rows * (width / columns * tallest + TITLE_HEIGHT + below)
    height += (BAR_HEIGHT if bars == "common" else 0.0) + (LEGEND_HEIGHT if legend else 0.0)
    figure = new_figure(width, height)
    grid = list(np.atleast_1d(figure.subplots(rows, columns)).flat)
    for unused in grid[count:]:
        unused.remove()
    for axes in grid[:count]:
        axes.set_anchor("N")
    return figure, grid[:count]


def _title(axes: Axes, text: str) -> None:
    """A panel's title, in a smaller font if it would run into its neighbour's."""
    spec: Any = axes.get_subplotspec()
    figure: Any = axes.figure
    points = 72.0 * figure.get_figwidth() / spec.get_gridspec().ncols
    axes.set_title(text, fontsize=min(8.5, points / (0.6 * max(len(text), 1))))


def _aspect(problem: Problem) -> float:
    xmin, ymin, xmax, ymax = problem.environment.bounds
    return (ymax - ymin) / (xmax - xmin)


def _bar(figure: Figure, panels: list[Axes], mappable: Any, label: str) -> None:
    """A thin colour bar below the panels, or in the margin below a single one."""
    if len(panels) == 1:
        bottom, top = panels[0].get_ylim()
        left, right = panels[0].get_xlim()
        columns: Any = panels[0].get_subplotspec().get_gridspec().ncols  # type: ignore[union-attr]
        inch = (right - left) / (top - bottom) * columns / figure.get_figwidth()  # in heights of the panel
        own = panels[0].inset_axes((0.15, -0.12 * inch, 0.7, 0.05 * inch))
        bar = figure.colorbar(mappable, cax=own, orientation="horizontal")
        _few_ticks(bar, mappable.norm)
    else:
        bar = figure.colorbar(mappable, ax=panels, location="bottom", shrink=0.3, aspect=30, pad=0.02)
    bar.outline.set_visible(False)  # type: ignore[operator]
    bar.ax.tick_params(length=1.5, width=0.4, labelsize=6, pad=1)
    bar.ax.tick_params(which="minor", length=0, labelbottom=False)
    bar.set_label(label, fontsize=6.5, labelpad=1)


def _few_ticks(bar: Any, norm: Any) -> None:
    """About four round numbers: the bar of a panel is narrow."""
    low, high = float(bar.vmin), float(bar.vmax)
    logarithmic = isinstance(norm, LogNorm)
    if logarithmic and high > 100 * low:
        return
    if logarithmic:
        candidates = np.multiply.outer(10.0 ** np.arange(-9, 9), [1, 2, 5]).ravel()
        inside = candidates[(candidates >= low * 0.999) & (candidates <= high * 1.001)]
        few = inside[:: max(1, len(inside) // 4)]
        bar.set_ticks(few, labels=[f"{tick:g}" for tick in few])
    else:
        bar.set_ticks(MaxNLocator(4).tick_values(low, high)[:-1])
        bar.ax.set_xlim(low, high)


@styled
def regions(
    values: Mapping[str, Mapping[str, Interval]], *, title: str | None = None, label: str = EFFICIENCY_LABEL
) -> Figure:
    """Bars with 95 % intervals: a group per region, a bar per guidance.

    Args:
        values: Guidance to region to estimate. A region that a guidance lacks is left out there.
        title: Title of the axes.
        label: What is measured, with its unit.

    Raises:
        InvalidInputError: No guidance or no region.
    """
    names = list(dict.fromkeys(region for of_guidance in values.values() for region in of_guidance))
    if not names:
        raise InvalidInputError("values: expected at least one guidance with a region, got none")
    looks = Looks(values)
    figure = new_figure(max(COLUMN, 0.35 * len(names) * (len(values) + 1)), COLUMN * 0.72)
    axes = figure.subplots()
    width = 0.8 / len(values)
    for i, (guidance, by_region) in enumerate(values.items()):
        known = [(names.index(region), interval) for region, interval in by_region.items()]
        at = np.array([position for position, _ in known]) + (i - (len(values) - 1) / 2) * width
        heights, errors = _with_errors([interval for _, interval in known])
        axes.bar(at, heights, width * 0.92, color=looks.colour(guidance), label=looks.label(guidance))
        axes.errorbar(at, heights, errors, fmt="none", ecolor=INK, elinewidth=0.8, capsize=1.8, capthick=0.8)
    axes.set_xticks(range(len(names)), [name.replace("_", " ") for name in names])
    axes.tick_params(axis="x", length=0)
    axes.set(ylabel=label, title=title)
    estimates = [interval.estimate for of in values.values() for interval in of.values()]
    positive = [estimate for estimate in estimates if estimate > 0]
    if positive and max(positive) > _WIDE * min(positive):
        axes.set(yscale="log", ylim=(0.5 * min(positive), None))
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        axes.yaxis.set_major_formatter(StrMethodFormatter("{x:,g}"))
        axes.yaxis.set_minor_formatter(NullFormatter())
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=1.0)
    return figure


def _with_errors(intervals: Sequence[Interval]) -> tuple[FloatArray, FloatArray]:
    """(k,) estimates and (2, k) distances to the ends of their intervals."""
    rows = np.array([(i.estimate, i.estimate - i.low, i.high - i.estimate) for i in intervals]).T
    return rows[0], np.maximum(rows[1:], 0.0)


@styled
def database(
    sizes: Sequence[int],
    efficiency: Sequence[Interval],
    seconds: Sequence[Interval],
    *,
    baseline: Interval | None = None,
    title: str | None = None,
) -> Figure:
    """SE (left) and time per query (right) over the number of paths in the database, with 95 % intervals.

    Args:
        sizes: (k,) numbers of paths.
        efficiency: (k,) SE per sample.
        seconds: (k,) time per query.
        baseline: SE per sample of RRT, which has no database.
        title: Title of the figure.

    Raises:
        InvalidInputError: The three do not have one length, or are empty.
    """
    if not len(sizes) or not len(sizes) == len(efficiency) == len(seconds):
        raise InvalidInputError(
            "expected one SE and one time per size, got "
            f"{len(sizes)} sizes, {len(efficiency)} SE and {len(seconds)} times"
        )
    looks = Looks(["path_database", "rrt"])
    figure = new_figure(PAGE * 0.8, COLUMN * 0.68)
    left, right = figure.subplots(1, 2)
    milliseconds = [Interval(1e3 * s.estimate, 1e3 * s.low, 1e3 * s.high) for s in seconds]
    if baseline is not None:
        left.axhspan(baseline.low, baseline.high, color=looks.colour("rrt"), alpha=0.18, linewidth=0)
        left.axhline(baseline.estimate, color=looks.colour("rrt"), label="RRT, without a database")
    for axes, intervals in ((left, efficiency), (right, milliseconds)):
        heights, errors = _with_errors(intervals)
        axes.errorbar(
            sizes, heights, errors, color=looks.colour("path_database"), marker="o", markersize=3.5,
            capsize=1.8, elinewidth=0.8, label="PathDatabase",
        )  # fmt: skip
        axes.set(xscale="log", xlabel="paths in the database")
        axes.set_xticks(sizes, [f"{size:,}" for size in sizes])
        axes.minorticks_off()
    linear = milliseconds[0].estimate * np.asarray(sizes) / sizes[0]
    right.plot(sizes, linear, color=MUTED, linewidth=0.8, linestyle=(0, (1, 1.5)), label="linear growth")
    left.set_ylabel("SE per sample (nats)")
    left.set_ylim(bottom=0)
    right.set(ylabel="time per query (ms)", yscale="log")
    right.yaxis.set_major_formatter("{x:g}")
    left.legend()
    right.legend(loc="upper left")
    figure.suptitle(title or "", fontsize=8.5)
    return figure


__all__ = [
    "Cost",
    "Progress",
    "database",
    "efficiency_over_samples",
    "environments",
    "guiding_space",
    "guiding_spaces",
    "heat_maps",
    "label_of",
    "quality_over_cost",
    "regions",
    "save",
    "search_progress",
    "search_tree",
    "search_trees",
]
