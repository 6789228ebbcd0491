"""Single-step evaluation: how well a guidance selects on trees that others have grown (paper, Axes).

A search grows the tree that suits it, and is judged on that one alone. Here all guidances are judged on the
same trees, harvested from searches at several moments: a guiding space is attached to a search that repeats
what the harvested one did, sample by sample, so that it knows the tree with its failed expansions; at each of
the moments it is asked for its distribution P over the nodes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import integer
from guided_gym.compute.workers import Workers, executor_of, map_tasks
from guided_gym.doors import door
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.measure.target import Measure, sampling_efficiency
from guided_gym.options import SearchOptions
from guided_gym.planning import SearchResult
from guided_gym.problems import Problem
from guided_gym.randomness import streams
from guided_gym.search.search import Search
from guided_gym.train.evaluation import UNSUITABLE, Plan, as_specs, check_plans, checked_seeds, run_once
from guided_gym.train.protocols import guiding_space, sample_targets
from guided_gym.train.specs import EvaluationSettings, GuidanceSpec, import_modules, made
from guided_gym.train.statistics import Interval, bootstrap, paired_difference
from guided_gym.train.table import LEAST_PAIRS

if TYPE_CHECKING:
    from rich.table import Table

SINGLE_STEP = "single-step"
MOMENTS = 4  # at which each search's tree is harvested


@dataclass(frozen=True)
class Harvest:
    """The trees of one search at several moments of it.

    Attributes:
        problem: What was searched.
        options: How nodes were expanded, and what SE is measured by.
        nodes: (m,) node that each sample expanded.
        targets: (m, d) what it was expanded towards.
        moments: (k,) increasing numbers of samples after which the tree is judged, all below m.
    """

    problem: Problem
    options: SearchOptions
    nodes: NDArray[np.int32]
    targets: NDArray[np.float64]
    moments: NDArray[np.int64]

    @classmethod
    def of(cls, result: SearchResult, moments: int = MOMENTS) -> Harvest:
        """The trees of a search at the middles of equal parts of it; a short search has fewer."""
        samples = result.samples
        at = np.unique(((np.arange(moments) + 0.5) * samples / moments).astype(np.int64))
        return cls(
            result.problem, result.options, result.record.selected, sample_targets(result), at[at < samples]
        )


@dataclass(frozen=True)
class Step:
    """How a guidance selects on one tree.

    Attributes:
        efficiency: Expected SE of its choice, the mean of -log Q(v) over v drawn from P, in nats.
        best: -log max Q, the least that any choice has.
        divergence: D_KL(P || Q) of the whole distribution.
    """

    efficiency: float
    best: float
    divergence: float


def steps(harvest: Harvest, guidance: GuidingSpace, seed: int) -> Iterator[Step]:
    """How a guidance selects on each of the harvested trees; the search is repeated for it to learn from.

    Args:
        harvest: The trees.
        guidance: Who is judged.
        seed: Of the guidance's own randomness.
    """
    _, expansion_rng, guidance_rng = streams(seed)
    search = Search(harvest.problem, expansion_rng, guidance_rng, harvest.options)
    measure = Measure(search)
    search.attach(guidance)
    done = 0
    for moment in harvest.moments.tolist():
        for i in range(done, moment):
            search.expand(int(harvest.nodes[i]), harvest.targets[i])
        done = moment
        p, q = guidance.distribution(search.tree), measure.distribution()
        with np.errstate(divide="ignore"):
            surprise = -np.log(q)
        chosen = p > 0
        expected = float(np.sum(p[chosen] * surprise[chosen]))
        yield Step(expected, float(surprise.min()), sampling_efficiency(p, q))


@dataclass(frozen=True)
class SingleStep:
    """A guidance on the harvested trees of an environment; intervals over the problems' seeds.

    Attributes:
        guidance: Its label.
        trees: How many trees.
        efficiency: Mean expected SE of a choice, nats.
        excess: Mean of what it lies above the best possible.
        divergence: Mean D_KL(P || Q).
        values: (seeds,) mean expected SE of each seed's trees, for comparisons in pairs.
    """

    guidance: str
    trees: int
    efficiency: Interval
    excess: Interval
    divergence: Interval
    values: NDArray[np.float64]


@door
def single_step(
    environment: str,
    guidances: Sequence[str | GuidanceSpec],
    *,
    harvesters: Sequence[str | GuidanceSpec] = (),
    seeds: int | Iterable[int] = 32,
    moments: int = MOMENTS,
    workers: Workers = 1,
    settings: EvaluationSettings | None = None,
    imports: Sequence[str] = (),
) -> list[SingleStep]:
    """Judge guidances on the same trees, harvested from searches.

    Args:
        environment: Name from the catalogue.
        guidances: The guidances that are judged.
        harvesters: The guidances whose searches grow the trees; if empty, those that are judged.
        seeds: How many, counted from 0, or which; each is a search of every harvester.
        moments: Trees to take from a search.
        workers: Processes, or another executor, such as `guided_gym.OnRay`.
        settings: Limits, expansion and metric of the searches.
        imports: Modules to import first, here and in the workers.

    Returns:
        One row per guidance, in the order given.

    Raises:
        InvalidInputError: A number out of range, or no problem that can be posed.
        UnknownNameError: No environment or guidance of that name.
    """
    import_modules(imports)
    integer("moments", moments, least=1)
    executor_of(workers)
    specs, growers = as_specs(list(guidances)), as_specs(list(harvesters or guidances))
    settings = settings or EvaluationSettings()
    check_plans([Plan(environment, spec, settings) for spec in specs])
    for spec in (*specs, *growers):
        guiding_space(made(spec), SINGLE_STEP)
    plans = [Plan(environment, spec, settings) for spec in growers]
    check_plans(plans)
    tasks = [(plans, specs, seed, moments) for seed in checked_seeds(seeds)]
    found = dict(map_tasks(_of_seed, tasks, workers, partial(import_modules, tuple(imports))))
    tables = [found[seed] for seed in sorted(found) if found[seed].size]  # whoever is done first
    if not tables:
        raise InvalidInputError(f"{environment}: expected problems that need a search, got none")
    return [
        _row(spec.label, [table[i] for table in tables], sum(len(table[i]) for table in tables))
        for i, spec in enumerate(specs)
    ]


_SeedTask = tuple[list[Plan], list[GuidanceSpec], int, int]


def _of_seed(task: _SeedTask) -> tuple[int, NDArray[np.float64]]:
    """A seed, and (guidances, trees, 3) the figures of `Step` on every tree of it; empty without any."""
    plans, specs, seed, moments = task
    try:
        harvests = [Harvest.of(run_once(plan, seed)[1], moments) for plan in plans]
    except UNSUITABLE:
        return seed, np.zeros((len(specs), 0, 3))
    rows = [
        [
            (step.efficiency, step.best, step.divergence)
            for harvest in harvests
            for step in steps(harvest, guiding_space(made(spec), SINGLE_STEP), seed)
        ]
        for spec in specs
    ]
    return seed, np.array(rows, np.float64).reshape(len(specs), -1, 3)


def _row(label: str, of_seeds: Sequence[NDArray[np.float64]], trees: int) -> SingleStep:
    means = np.array([table.mean(axis=0) for table in of_seeds])  # trees of one seed are no independent draws
    return SingleStep(
        label,
        trees,
        bootstrap(means[:, 0]),
        bootstrap(means[:, 0] - means[:, 1]),
        bootstrap(means[:, 2]),
        means[:, 0],
    )


def single_step_table(rows: Sequence[SingleStep], environment: str) -> Table:
    """For `rich.print`, best first; * marks those that none is known to beat, by paired seeds."""
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    ordered = sorted(rows, key=lambda row: row.efficiency.estimate)
    trees, seeds = ordered[0].trees, ordered[0].values.size
    table = Table(
        title=f"{environment}, single steps on {trees:,} trees of {seeds} seeds", title_justify="left",
        caption="Expected SE of one choice on the same trees, in nats; 95 % intervals over seeds. "
        "* none is known to be better (paired seeds, 95 %).",
        caption_justify="left", box=box.SIMPLE_HEAD, pad_edge=False,
    )  # fmt: skip
    table.add_column("guidance", overflow="fold")
    for title in ("SE of a choice", "excess SE", "D_KL(P‖Q)"):
        table.add_column(title, justify="right")
    for row in ordered:
        difference = paired_difference(row.values, ordered[0].values)
        real = seeds >= LEAST_PAIRS and difference.outside(0.0, 0.0)
        first, *others = (figure.text() for figure in (row.efficiency, row.excess, row.divergence))
        table.add_row(row.guidance, *(escape(text) for text in (first + ("" if real else "*"), *others)))
    return table


def record(row: SingleStep) -> dict[str, Any]:
    """JSON-able."""
    flat: dict[str, Any] = {"guidance": row.guidance, "trees": row.trees, "seeds": int(row.values.size)}
    for name in ("efficiency", "excess", "divergence"):
        interval = getattr(row, name)
        flat |= {name: interval.estimate, f"{name}_low": interval.low, f"{name}_high": interval.high}
    return flat
