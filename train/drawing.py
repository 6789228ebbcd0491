"""Which figures an evaluation and the paper's reproduction draw, from results and from one seed run again."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from guided_gym.catalogue.table import make_distribution
from guided_gym.guidance.base import GuidingSpace
from guided_gym.train import figures
from guided_gym.train.claims import DATABASE_SIZES, DRAWN, PROBLEMS, database_label
from guided_gym.train.evaluation import ELSEWHERE, Plan, run_once
from guided_gym.train.results import Column, Results, grid_shape
from guided_gym.train.specs import file_label, made
from guided_gym.train.statistics import Interval, bootstrap

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from guided_gym.planning import SearchResult
    from guided_gym.problems import Problem
    from guided_gym.search.watch import WatchedPlanner

SMOOTHING = 10  # samples that a curve is averaged over, to be readable
_PANELS = 8  # trees or guiding spaces in one figure

Named = Iterator[tuple[str, "Figure"]]


@dataclass(frozen=True)
class _Example:
    """One search run again for a picture; the guiding space keeps what it has learnt."""

    title: str
    guidance: GuidingSpace | WatchedPlanner
    problem: Problem
    result: SearchResult


def draw_evaluation(
    results: Results, plans: Sequence[Plan], folder: Path, drawn: Callable[[str], None] | None = None
) -> list[Path]:
    """The figures of an evaluation, per environment: SE over samples, by region and place, its cost, trees.

    Args:
        results: What was found.
        plans: What was run; the first seed of each is searched again for the trees.
        folder: Where the files go.
        drawn: Called with the name of each figure when it is written.

    Returns:
        The files.

    Raises:
        StorageError: The folder cannot be written.
    """
    return _save_all(_evaluation_figures(results, plans), folder, drawn)


def draw_paper(
    results: Results, plans: Sequence[Plan], folder: Path, drawn: Callable[[str], None] | None = None
) -> list[Path]:
    """The paper's figures; same arguments as `draw_evaluation`."""
    return _save_all(_paper_figures(results, plans), folder, drawn)


def _save_all(named: Named, folder: Path, drawn: Callable[[str], None] | None) -> list[Path]:
    written: list[Path] = []
    for name, figure in named:
        written += figures.save(figure, folder / name)
        if drawn is not None:
            drawn(name)
    return written


def _evaluation_figures(results: Results, plans: Sequence[Plan]) -> Named:
    for environment in results.environments():
        guidances = results.guidances(environment)
        name = file_label(environment)
        ceiling = _ceiling([plan for plan in plans if plan.environment == environment])
        yield f"{name}-efficiency", progress(results, environment, guidances, ceiling)
        if any(set(results.by_region(environment, one)) - {ELSEWHERE} for one in guidances):
            yield f"{name}-regions", region_bars(results, environment, guidances)
        yield f"{name}-places", places(results, environment, guidances)
        yield f"{name}-cost", trade_off(results, environment, guidances)
        seed = min(run.seed for run in results.runs if run.environment == environment)
        chosen = [plan for plan in plans if plan.environment == environment][:_PANELS]
        yield from _examples_drawn(f"{name}-", [_example(plan, seed) for plan in chosen])


def _ceiling(plans: Sequence[Plan]) -> float | None:
    """Log 1/epsilon, where the plans agree on it and there is one."""
    floors = {plan.settings.target.epsilon for plan in plans}
    floor = floors.pop() if len(floors) == 1 else 0.0
    return -math.log(floor) if floor > 0 else None


def _paper_figures(results: Results, plans: Sequence[Plan]) -> Named:
    yield "problems", figures.environments()
    ceiling = _ceiling(plans)
    for guidance, problems in (
        ("rrt", PROBLEMS),
        ("lazy_prm", ("Cup", "SimplePassage")),
        ("medial_axis", ("Trap", "SimplePassage")),
    ):
        series = {problem: results.curves(problem, guidance) for problem in problems}
        title = figures.label_of(guidance)
        yield (
            f"{guidance}-efficiency",
            figures.efficiency_over_samples(series, title=title, window=SMOOTHING, ceiling=ceiling),
        )
    trap_cup = ["rrt", "lazy_prm", "medial_axis", "hybrid"]
    yield "TrapCup-efficiency", curves(results, "TrapCup", trap_cup, ceiling)
    yield "TrapCup-progress", progress(results, "TrapCup", trap_cup, ceiling)
    yield "TrapCup-regions", region_bars(results, "TrapCup", trap_cup)
    yield "TrapCup-places", places(results, "TrapCup", trap_cup)
    for environment in results.environments():
        yield f"{environment}-cost", trade_off(results, environment, results.guidances(environment))
    yield "database", _database_figure(results)
    by_key = {(plan.environment, plan.spec.label): plan for plan in plans}
    seed = min(run.seed for run in results.runs)
    shown = (
        ("SimplePassage", "rrt"),
        ("Cup", "lazy_prm"),
        ("Trap", "medial_axis"),
        (DRAWN, database_label(DATABASE_SIZES[-1])),
    )
    yield from _examples_drawn("paper-", [_example(by_key[key], seed, full=True) for key in shown])
    multi = [by_key["TrapCup", guidance] for guidance in trap_cup[1:]]
    yield from _examples_drawn("TrapCup-", [_example(plan, seed) for plan in multi])


def curves(
    results: Results, environment: str, guidances: Sequence[str], ceiling: float | None = None
) -> Figure:
    """SE over samples, a curve per guidance, with the best possible on its trees."""
    series = {guidance: results.curves(environment, guidance) for guidance in guidances}
    best = {guidance: results.best_curves(environment, guidance) for guidance in guidances}
    return figures.efficiency_over_samples(
        series, best=best, ceiling=ceiling, title=environment, window=SMOOTHING
    )


def progress(
    results: Results, environment: str, guidances: Sequence[str], ceiling: float | None = None
) -> Figure:
    """SE over samples of all searches, of those still searching, and how many are solved."""
    series = {
        guidance: figures.Progress(
            results.curves(environment, guidance),
            results.best_curves(environment, guidance),
            results.values(environment, guidance, "samples").astype(np.int64),
            results.values(environment, guidance, "solved") > 0,
        )
        for guidance in guidances
    }
    label = "SE of expansions (nats)" if results.protocol == "expansion" else "sampling efficiency (nats)"
    return figures.search_progress(
        series, ceiling=ceiling, title=_titled(results, environment), window=SMOOTHING, label=label
    )


def _titled(results: Results, environment: str) -> str:
    return environment if results.protocol == "whole" else f"{environment}, protocol: {results.protocol}"


def places(results: Results, environment: str, guidances: Sequence[str]) -> Figure:
    """Total SE by place of the selected node, a panel per guidance (paper, Axes for Evaluating Guidance)."""
    distribution = make_distribution(environment)
    problem = distribution.problem(results.group(environment, guidances[0])[0].seed)
    shape = grid_shape(problem.environment.bounds)
    items = [
        (figures.label_of(guidance), results.by_cell(environment, guidance, shape)[0])
        for guidance in guidances[:_PANELS]
    ]
    label = "total SE of the nodes selected in a cell (nats), mean over seeds"
    return figures.heat_maps(items, problem, fixed=distribution.fixed, label=label)


def trade_off(results: Results, environment: str, guidances: Sequence[str]) -> Figure:
    """SE over processor time, a point per guidance."""
    costs = {}
    for guidance in guidances:

        def value(column: Column, guidance: str = guidance) -> NDArray[np.float64]:
            return results.values(environment, guidance, column)

        whole = value("processor") + value("preparation")
        costs[guidance] = figures.Cost(
            (bootstrap(value("processor_per_sample")), bootstrap(value("efficiency_per_sample"))),
            (bootstrap(whole), bootstrap(value("total_efficiency"))),
            int((value("solved") == 0).sum()),
        )
    return figures.quality_over_cost(costs, title=_titled(results, environment))


def region_bars(results: Results, environment: str, guidances: Sequence[str]) -> Figure:
    """Total SE by region of the selected node, a bar per guidance."""
    values: dict[str, dict[str, Interval]] = {
        guidance: {
            region: bootstrap(sums) for region, sums in results.by_region(environment, guidance).items()
        }
        for guidance in guidances
    }
    return figures.regions(values, title=environment, label="total SE in the region (nats)")


def _database_figure(results: Results) -> Figure:
    labels = [database_label(size) for size in DATABASE_SIZES]
    efficiency = [bootstrap(results.values(DRAWN, label, "efficiency_per_sample")) for label in labels]
    seconds = [bootstrap(results.values(DRAWN, label, "preparation")) for label in labels]
    baseline = bootstrap(results.values(DRAWN, "rrt", "efficiency_per_sample"))
    return figures.database(DATABASE_SIZES, efficiency, seconds, baseline=baseline, title=DRAWN)


def _example(plan: Plan, seed: int, full: bool = False) -> _Example:
    problem, result = run_once(plan, seed)
    label = figures.label_of(plan.spec.name if full and plan.spec.options else plan.spec.label)
    return _Example(f"{label} on {plan.environment}" if full else label, made(plan.spec), problem, result)


def _examples_drawn(prefix: str, examples: list[_Example]) -> Named:
    yield (
        f"{prefix}trees",
        figures.search_trees([(one.title, one.result, one.problem) for one in examples]),
    )
    spaces = [(one.title, one.guidance, None) for one in examples if isinstance(one.guidance, GuidingSpace)]
    if spaces:  # planners of other libraries have none to draw
        yield f"{prefix}guiding-spaces", figures.guiding_spaces(spaces)
