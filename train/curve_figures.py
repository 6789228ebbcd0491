"""Figures with samples or processor time along their axes: SE, who is solved, and what guidance costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError
from guided_gym.train.statistics import Interval, wilson
from guided_gym.train.style import COLUMN, INK, MUTED, PAGE, Looks, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FloatArray = NDArray[np.float64]

EFFICIENCY_LABEL = "sampling efficiency (nats)"
RESAMPLES = 1000
_SPREAD: Final = 4.0  # the longest search over the shortest guidance's, from which on an axis is logarithmic
_DOTTED: Final[Any] = {"linestyle": (0, (1, 1)), "linewidth": 0.9}
_FEWEST: Final = 5  # searches that a mean over those still searching is drawn for


@dataclass(frozen=True)
class Progress:
    """The searches of one guidance, sample by sample.

    Attributes:
        efficiency: (seeds, samples) SE in nats, 0 after a search has ended.
        best: (seeds, samples) the least that each choice could have had, likewise.
        samples: (seeds,) samples that each search drew.
        solved: (seeds,) whether it found a path.
    """

    efficiency: FloatArray
    best: FloatArray
    samples: NDArray[np.int64]
    solved: NDArray[np.bool_]

    def surviving(self) -> FloatArray:
        """(seeds, samples) SE, NaN after the end of a search."""
        drawn = np.arange(self.efficiency.shape[1]) < self.samples[:, None]
        return np.where(drawn, self.efficiency, np.nan)


@styled
def efficiency_over_samples(
    series: Mapping[str, FloatArray],
    *,
    best: Mapping[str, FloatArray] | None = None,
    ceiling: float | None = None,
    title: str | None = None,
    window: int = 1,
) -> Figure:
    """Mean SE at each sample, with the 95 % band of a bootstrap over seeds; a curve per guidance.

    A curve ends with the last search of its guidance. The axis of the samples is logarithmic where some take
    several times as many as others.

    Args:
        series: Name of each guidance to its (seeds, samples) SE in nats, 0 after a search has ended
            (`guided_gym.measure.target.padded`).
        best: Name of each to the least that its choices could have had, in the same shape: a dotted line.
        ceiling: The most that SE can be, log 1/epsilon; drawn if given.
        title: Title of the axes.
        window: Each search's SE is averaged over so many samples first, centred.

    Raises:
        InvalidInputError: No series, one that is not two-dimensional or empty, or a window below 1.
    """
    arrays = _checked(series, window)
    looks = Looks(arrays)
    figure = new_figure(COLUMN * 1.5, COLUMN * 0.85)
    axes = figure.subplots()
    _draw_curves(axes, arrays, looks, window)
    _draw_bounds(axes, best or {}, ceiling, looks, window)
    axes.set(ylabel=_label(window), title=title)
    _sample_axis(axes, [_last_sample(values) for values in arrays.values()])
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def _checked(series: Mapping[str, FloatArray], window: int) -> dict[str, FloatArray]:
    if not series:
        raise InvalidInputError("series: expected at least one guidance, got none")
    if window < 1:
        raise InvalidInputError(f"window: expected at least 1 sample, got {shown(window)}")
    arrays = {name: np.asarray(values, np.float64) for name, values in series.items()}
    for name, array in arrays.items():
        if array.ndim != 2 or not array.size:
            raise InvalidInputError(f"series {name!r}: expected shape (seeds, samples), got {array.shape}")
    return arrays


def _label(window: int) -> str:
    smoothed = "" if window == 1 else f"mean of {window} samples, "
    return f"{EFFICIENCY_LABEL},\n{smoothed}0 once a search has ended"


def _draw_curves(axes: Axes, arrays: Mapping[str, FloatArray], looks: Looks, window: int) -> None:
    for name, values in arrays.items():
        end = min(_last_sample(values) + 1, values.shape[1])
        array = _smoothed(values, window)[:, :end]
        low, high = _band(array)
        x = np.arange(1, end + 1)
        axes.fill_between(x, low, high, color=looks.colour(name), alpha=0.15, linewidth=0)
        style: dict[str, Any] = {"color": looks.colour(name), "linestyle": looks.dash(name)}
        axes.plot(x, array.mean(axis=0), label=looks.label(name), **style)


def _draw_bounds(
    axes: Axes, best: Mapping[str, FloatArray], ceiling: float | None, looks: Looks, window: int
) -> None:
    """Between what SE can lie: the best possible on each guidance's own trees, and the ceiling."""
    for name, values in best.items():
        array = _smoothed(values[:, : _last_sample(values)], window).mean(axis=0)
        axes.plot(np.arange(1, array.size + 1), array, color=looks.colour(name), **_DOTTED)
    if best:
        axes.plot([], [], color=MUTED, label="best possible", **_DOTTED)
    if ceiling is not None:
        axes.axhline(ceiling, color=INK, linewidth=0.6, linestyle=(0, (6, 3)), label="ceiling, log 1/ε")
    axes.set_ylim(bottom=0)


def _sample_axis(axes: Axes, ends: Sequence[int]) -> None:
    """From the first to the last sample that anybody drew; logarithmic where guidances end far apart."""
    axes.set_xlabel("samples")
    axes.set_xlim(1, max(ends))
    if max(ends) > _SPREAD * min(ends):
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
        axes.xaxis.set_minor_formatter(NullFormatter())


def _last_sample(values: FloatArray) -> int:
    """The last sample that any search drew; at least 2, so that there is an axis."""
    return max(2, int(np.max(np.nonzero(np.asarray(values).any(axis=0))[0], initial=0)) + 1)


def _smoothed(array: FloatArray, window: int) -> FloatArray:
    """Centred running mean along the samples; shorter at the ends, over what there is of NaN."""
    known = np.isfinite(array)
    first = np.maximum(np.arange(array.shape[1]) - (window - 1) // 2, 0)
    last = np.minimum(np.arange(array.shape[1]) + window // 2 + 1, array.shape[1])

    def total(values: FloatArray) -> FloatArray:
        sums = np.cumsum(np.pad(values, ((0, 0), (1, 0))), axis=1)
        return np.asarray(sums[:, last] - sums[:, first])

    counts = total(known.astype(np.float64))
    means = total(np.where(known, array, 0.0)) / np.maximum(counts, 1.0)
    return np.where(known, means, np.nan)


def _band(array: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(samples,) ends of the 95 % percentile bootstrap of the mean over seeds, sample by sample."""
    seeds, known = len(array), np.isfinite(array)
    rng = np.random.default_rng(0)
    weights = rng.multinomial(seeds, np.full(seeds, 1.0 / seeds), RESAMPLES)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = (weights @ np.where(known, array, 0.0)) / (weights @ known)
    low, high = np.nanquantile(means, [0.025, 0.975], axis=0)
    return low, high


@styled
def search_progress(
    series: Mapping[str, Progress],
    *,
    ceiling: float | None = None,
    title: str | None = None,
    window: int = 1,
    label: str = EFFICIENCY_LABEL,
) -> Figure:
    """Three panels over the samples: SE with 0 after the end, SE of those still searching, share solved.

    The first is the paper's, and falls because searches end, too. The second is a mean over ever fewer
    searches, those that take longest. Bands are 95 % intervals over seeds.

    Args:
        series: Name of each guidance to its searches.
        ceiling: The most that SE can be, log 1/epsilon; drawn if given.
        title: Title of the figure.
        window: Each search's SE is averaged over so many samples first, centred.
        label: What SE is of.

    Raises:
        InvalidInputError: No series, one of another shape, or a window below 1.
    """
    arrays = _checked({name: one.efficiency for name, one in series.items()}, window)
    looks = Looks(series)
    figure = new_figure(PAGE, COLUMN * 0.86)
    whole, surviving, solved = figure.subplots(1, 3)
    _draw_curves(whole, arrays, looks, window)
    _draw_bounds(whole, {name: one.best for name, one in series.items()}, ceiling, looks, window)
    _draw_surviving(surviving, series, looks, window)
    _draw_bounds(surviving, {}, ceiling, looks, window)
    _draw_solved(solved, series, looks)
    whole.set_ylim(top=(smoothed_top := max(axes.get_ylim()[1] for axes in (whole, surviving))))
    surviving.set_ylim(top=smoothed_top)
    whole.set_title("all searches, 0 once ended")
    surviving.set_title("those still searching")
    solved.set_title("share solved")
    whole.set_ylabel(label if window == 1 else f"{label},\nmean of {window} samples")
    solved.set_ylim(-0.02, 1.02)
    ends = [int(max(one.samples.max(), 2)) for one in series.values()]
    for axes in (whole, surviving, solved):
        _sample_axis(axes, ends)
    _legend_below(figure, whole)
    figure.suptitle(title or "", fontsize=8.5)
    return figure


def _draw_surviving(axes: Axes, series: Mapping[str, Progress], looks: Looks, window: int) -> None:
    for name, one in series.items():
        array = _smoothed(one.surviving(), window)
        count = np.isfinite(array).sum(axis=0)
        last = int(np.searchsorted(-count, -min(_FEWEST, len(array)), side="right"))
        if not last:
            continue
        array, x = array[:, :last], np.arange(1, last + 1)
        low, high = _band(array)
        axes.fill_between(x, low, high, color=looks.colour(name), alpha=0.15, linewidth=0)
        axes.plot(x, np.nanmean(array, axis=0), color=looks.colour(name), linestyle=looks.dash(name))


def _draw_solved(axes: Axes, series: Mapping[str, Progress], looks: Looks) -> None:
    """The share solved within so many samples; its Wilson interval from the first solved to the last."""
    for name, one in series.items():
        seeds, last, solved = one.solved.size, one.efficiency.shape[1], int(one.solved.sum())
        ends = np.sort(one.samples[one.solved])
        style: dict[str, Any] = {"color": looks.colour(name)}
        if solved:
            shares = [wilson(count, seeds) for count in range(1, solved + 1)]
            low, high = [share.low for share in shares], [share.high for share in shares]
            axes.fill_between(ends, low, high, alpha=0.12, linewidth=0, step="post", **style)
        x, y = [0, *ends, last], [*range(solved + 1), solved]
        axes.step(x, np.array(y) / seeds, where="post", linestyle=looks.dash(name), **style)


@dataclass(frozen=True)
class Cost:
    """What a guidance gives and what it costs: two points of a trade-off, each with its intervals.

    Attributes:
        per_sample: Processor time of a sample (s), and SE of a sample (nats).
        whole: Processor time of a search, its preparation included (s), and total SE (nats).
        unsolved: Searches that were not solved: the whole then is a lower bound.
    """

    per_sample: tuple[Interval, Interval]
    whole: tuple[Interval, Interval]
    unsolved: int


@styled
def quality_over_cost(costs: Mapping[str, Cost], *, title: str | None = None) -> Figure:
    """SE over processor time, of a sample (left) and of a whole search (right), with 95 % intervals.

    The paper's trade-off: guidance that selects better may be dearer to compute. Hollow are guidances some of
    whose searches were not solved.

    Args:
        costs: Name of each guidance to its figures.
        title: Title of the figure.

    Raises:
        InvalidInputError: No guidance.
    """
    if not costs:
        raise InvalidInputError("costs: expected at least one guidance, got none")
    looks = Looks(costs)
    figure = new_figure(PAGE * 0.9, COLUMN * 0.9)
    left, right = figure.subplots(1, 2)
    panels = ((left, "per_sample", 1e6), (right, "whole", 1e3))
    for axes, name_of_pair, scale in panels:
        for i, (name, cost) in enumerate(costs.items()):
            x, y = getattr(cost, name_of_pair)
            if not (np.isfinite(x.estimate) and x.estimate > 0):
                continue
            hollow = cost.unsolved > 0
            axes.errorbar(
                [scale * x.estimate], [y.estimate],
                xerr=[[scale * max(x.estimate - x.low, 0)], [scale * max(x.high - x.estimate, 0)]],
                yerr=[[max(y.estimate - y.low, 0)], [max(y.high - y.estimate, 0)]],
                color=looks.colour(name), marker=_MARKERS[i % len(_MARKERS)], markersize=5,
                markerfacecolor="white" if hollow else looks.colour(name), elinewidth=0.8, linestyle="none",
                label=looks.label(name) + (f" ({cost.unsolved} not solved)" if hollow else ""),
            )  # fmt: skip
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.grid(axis="x", visible=True)
    left.set(xlabel="processor time of a sample (µs)", ylabel="SE of a sample (nats)")
    right.set(xlabel="processor time of a search and its preparation (ms)", ylabel="total SE (nats)")
    right.set_yscale("log")
    left.set_ylim(bottom=0)
    right.yaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
    right.yaxis.set_major_formatter(StrMethodFormatter("{x:,g}"))
    right.yaxis.set_minor_formatter(NullFormatter())
    _legend_below(figure, left)
    figure.suptitle(title or "", fontsize=8.5)
    return figure


def _legend_below(figure: Figure, axes: Axes) -> None:
    """The legend of some axes below the figure, in as many columns as its longest label leaves room for."""
    handles, names = axes.get_legend_handles_labels()
    column = 0.55 + 0.06 * max(map(len, names))  # inches: a handle, and characters of 7 points
    columns = max(1, min(len(names), int(figure.get_figwidth() / column)))
    figure.legend(handles, names, loc="outside lower center", ncols=columns)


_MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p")
