"""Evaluation: searches over seeds, resumable, on several processes (paper, Experiments)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.checks import integer, shown
from guided_gym.compute.workers import Workers, executor_of, map_tasks
from guided_gym.doors import door
from guided_gym.errors import GuidedGymError, InvalidInputError, NoPathError, StorageError
from guided_gym.planning import SearchResult, check_watched
from guided_gym.problems import Problem
from guided_gym.search.watch import WatchedPlanner
from guided_gym.train.identity import problem_identity
from guided_gym.train.protocols import guiding_space, sample_entropy, search_once
from guided_gym.train.results import RESULTS_FILE, Results, ResultsFile, Run, Skipped, grid_cells
from guided_gym.train.specs import (
    DATABASE_GUIDANCE,
    EvaluationSettings,
    GuidanceSpec,
    fingerprint,
    import_modules,
    made,
    settings_content,
)

if TYPE_CHECKING:
    from guided_gym.measure.oracle import Oracle

ELSEWHERE = "elsewhere"  # the region of nodes that lie in no region of their problem

Progress = Callable[[int, int], None]
"""Called with (runs done, runs asked for) at the start and after each batch."""

# What is wrong with one problem, and says nothing against the next one of a list.
UNSUITABLE = (InvalidInputError, NoPathError)

_RUNS_PER_BATCH = 8  # what a kill loses at most, per worker
_WARM_UP_SAMPLES = 50


@dataclass(frozen=True)
class Plan:
    """One group of runs: an environment and a guidance under some settings.

    Attributes:
        environment: Name of a problem or distribution of the catalogue.
        spec: The guidance.
        settings: Everything else.
    """

    environment: str
    spec: GuidanceSpec
    settings: EvaluationSettings = field(default_factory=EvaluationSettings)


@dataclass(frozen=True)
class _Group:
    """A plan with the fingerprint that its rows carry."""

    plan: Plan
    fingerprint: str


_Task = tuple[_Group, int]  # one run: a group and a seed


@door
def evaluate(
    environments: str | Sequence[str],
    guidances: str | GuidanceSpec | Sequence[str | GuidanceSpec],
    *,
    seeds: int | Iterable[int] = 128,
    workers: Workers = 1,
    out: str | Path | None = None,
    settings: EvaluationSettings | None = None,
    database: str | Path | None = None,
    imports: Sequence[str] = (),
    progress: Progress | None = None,
) -> Results:
    """Run guided searches over seeds and collect their figures.

    Runs that the results file of ``out`` holds already, for the same code and settings, are not computed
    again: a call continues where the last one stopped, after Ctrl-C as after a kill.

    With several workers, a script must call this under ``if __name__ == "__main__":``, because its processes
    are spawned.

    Args:
        environments: Names from the catalogue.
        guidances: Names (with options, see `GuidanceSpec.parse`) or specs.
        seeds: How many, from 0 on, or which ones. Seed k poses the problem of ``env.reset(seed=k)``.
        workers: Processes, or another executor, such as `guided_gym.OnRay`.
        out: Folder of the results file; None keeps nothing.
        settings: Limits, expansion and metric.
        database: Path database for the guidances that need one and name none.
        imports: Modules to import first, here and in the workers; they register names of your own.
        progress: Called with (runs done, runs asked for).

    Returns:
        The results of exactly what was asked for.

    Raises:
        UnknownNameError: No environment, guidance or option of that name.
        InvalidInputError: A seed, a setting or a number of workers is out of range.
        StorageError: The results file or database is corrupt, foreign or not accessible.
        NoPathError: The only problem of an environment, or every problem that was asked for, has no path.
    """
    import_modules(imports)
    names = [environments] if isinstance(environments, str) else list(dict.fromkeys(environments))
    specs = as_specs(guidances, database)
    settings = settings or EvaluationSettings()
    plans = [Plan(name, spec, settings) for name in names for spec in specs]
    return run_plans(plans, seeds=seeds, workers=workers, out=out, imports=imports, progress=progress)


def run_plans(
    plans: Sequence[Plan],
    *,
    seeds: int | Iterable[int],
    workers: Workers = 1,
    out: str | Path | None = None,
    imports: Sequence[str] = (),
    progress: Progress | None = None,
) -> Results:
    """`evaluate` for any list of (environment, guidance, settings); same arguments, same errors."""
    wanted = checked_seeds(seeds)
    executor = executor_of(workers)
    if not plans or not wanted:
        raise InvalidInputError("expected at least one environment, one guidance and one seed, got none")
    check_plans(plans)
    groups = [_Group(plan, fingerprint(_content(plan))) for plan in plans]
    if out is None or not (Path(out) / RESULTS_FILE).exists():
        _pose_first(plans, wanted)  # what has no path leaves no file either
    with ResultsFile.in_folder(None if out is None else Path(out)) as file:
        for group in groups:
            file.describe(group.fingerprint, _content(group.plan))
        _drop_stale(file, groups, wanted)
        batches, missing = _batches(groups, wanted, file)
        if batches:
            file.require_writing()  # now, and not after the first of them
        done, total = len(groups) * len(wanted) - missing, len(groups) * len(wanted)
        if progress is not None:
            progress(done, total)
        if not executor.alone and batches:
            _compile_here([group.plan for group in groups], wanted)
        prepare = partial(import_modules, tuple(imports))
        for runs, skipped in map_tasks(_run_batch, batches, executor if missing else 1, prepare):
            file.add(runs)
            file.skip(skipped)
            done += len(runs) + len(skipped)
            if progress is not None:
                progress(done, total)
        stored = [_stored(file, group, wanted) for group in groups]
        skipped_seeds = _skipped(file, groups, wanted)
    return Results(
        tuple(itertools.chain.from_iterable(stored)),
        max(plan.settings.max_samples for plan in plans),
        skipped_seeds,
        _common_protocol(plans),
    )


def as_specs(
    guidances: str | GuidanceSpec | Sequence[str | GuidanceSpec], database: str | Path | None = None
) -> list[GuidanceSpec]:
    """Guidance specs from names or specs; a database fills in where a guidance needs one.

    Raises:
        StorageError: There is no such database.
        InvalidInputError: There is a database, but no guidance that uses one.
    """
    if isinstance(guidances, str | GuidanceSpec):
        guidances = [guidances]
    specs = [GuidanceSpec.parse(item) if isinstance(item, str) else item for item in guidances]
    if database is not None and not Path(database).is_file():
        raise StorageError(f"expected a path database at {database}, but there is no such file")
    if database is not None:
        if not any(spec.uses(DATABASE_GUIDANCE) for spec in specs):
            raise InvalidInputError(
                f"database: expected {DATABASE_GUIDANCE} among the guidances, which uses it; "
                f"got {', '.join(spec.label for spec in specs)}"
            )
        specs = [spec.with_default(DATABASE_GUIDANCE, "database", str(database)) for spec in specs]
    return list(dict.fromkeys(specs))


def check_plans(plans: Sequence[Plan]) -> None:
    """Refuse what cannot work before anything starts.

    Raises:
        GuidedGymError: Of the kind that says what is wrong: an unknown name, a bad option, no database.
    """
    from guided_gym.catalogue.table import make_distribution
    from guided_gym.guidance.registry import make_expander

    for plan in plans:
        make_distribution(plan.environment)
        searcher = made(plan.spec)
        if isinstance(searcher, WatchedPlanner):
            settings = plan.settings
            if settings.protocol != "whole":
                guiding_space(searcher, f"the protocol {settings.protocol!r}")
            check_watched(searcher, settings.expansion, settings.distributions, settings.search_options())
        if plan.settings.expansion is not None:
            make_expander(plan.settings.expansion)
    labels = [(plan.environment, plan.spec.label) for plan in plans]
    if len(set(labels)) < len(labels):
        raise InvalidInputError(f"expected plans with different labels, got {labels}")


def run_once(plan: Plan, seed: int, trace: Path | None = None) -> tuple[Problem, SearchResult]:
    """One measured search of a plan, recorded in a trace if one is named, and the problem that it solved."""
    from guided_gym.catalogue.table import make_distribution

    settings = plan.settings
    distribution = make_distribution(plan.environment)
    problem = distribution.problem(seed, settings.goal_tolerance, settings.goal_edge)
    return problem, search_once(problem, made(plan.spec), settings, seed, trace)


def _content(plan: Plan) -> dict[str, object]:
    return settings_content(plan.environment, plan.spec, plan.settings)


def _pose_first(plans: Sequence[Plan], seeds: Sequence[int]) -> None:
    """Pose a problem of each environment, and solve its oracle, which the searches need anyway.

    Raises:
        GuidedGymError: None of an environment's problems can be posed and has a path: what the first lacks.
    """
    for plan in {plan.environment: plan for plan in plans}.values():
        first = _first_that_works(plan, seeds)
        if isinstance(first, GuidedGymError):
            raise first


def _first_that_works(plan: Plan, seeds: Sequence[int]) -> int | GuidedGymError:
    """The first seed whose problem can be posed and has a path; if there is none, what the first lacks."""
    from guided_gym.catalogue.table import make_distribution

    settings, distribution = plan.settings, make_distribution(plan.environment)
    trouble: GuidedGymError | None = None
    for seed in seeds:
        try:
            _oracle(distribution.problem(seed, settings.goal_tolerance, settings.goal_edge), settings)
            return seed
        except UNSUITABLE as error:
            trouble = trouble or error
            if distribution.fixed:
                break
    return trouble or InvalidInputError("expected at least one seed, got none")


def checked_seeds(seeds: int | Iterable[int]) -> list[int]:
    """The seeds, each once, in order; for a number, so many seeds from 0 on.

    Raises:
        InvalidInputError: One is no integer in [0, 2**63), or their number is not positive.
    """
    if not isinstance(seeds, Iterable):
        seeds = range(integer("seeds", seeds, least=1))
    wanted = list(dict.fromkeys(seeds))
    for seed in wanted:
        if not isinstance(seed, int | np.integer) or isinstance(seed, bool) or not 0 <= seed < 2**63:
            raise InvalidInputError(f"seeds: expected integers in [0, 2**63), got {shown(seed)}")
    return [int(seed) for seed in wanted]


def _drop_stale(file: ResultsFile, groups: Sequence[_Group], seeds: Sequence[int]) -> None:
    """Drop the rows of problems that their seeds pose no longer: what a distribution reads may change."""
    from guided_gym.catalogue.table import make_distribution

    @cache
    def posed(environment: str, seed: int, tolerance: float | None, by_edge: bool | None) -> str:
        try:
            return problem_identity(make_distribution(environment).problem(seed, tolerance, by_edge))
        except (InvalidInputError, NoPathError):  # there was a row, so there was none of these
            return ""

    for group in groups:
        environment, settings = group.plan.environment, group.plan.settings
        key = (environment, group.plan.spec.label, group.fingerprint)
        rule = (settings.goal_tolerance, settings.goal_edge)
        fixed, there = make_distribution(environment).fixed, file.problems(*key)
        known = [seed for seed in seeds if seed in there]
        file.discard(*key, [s for s in known if there[s] != posed(environment, 0 if fixed else s, *rule)])


def _batches(
    groups: Sequence[_Group], seeds: Sequence[int], file: ResultsFile
) -> tuple[list[list[_Task]], int]:
    """What is missing, in batches that share what is dear: a fixed problem's oracle, or a drawn problem's."""
    from guided_gym.catalogue.table import make_distribution

    batches: list[list[_Task]] = []
    drawn: dict[tuple[str, int], list[_Task]] = {}
    missing = 0
    for group in groups:
        environment = group.plan.environment
        there = file.seeds(environment, group.plan.spec.label, group.fingerprint)
        tasks = [(group, seed) for seed in seeds if seed not in there]
        missing += len(tasks)
        if make_distribution(environment).fixed:
            batches.extend(list(batch) for batch in _batched(tasks, _RUNS_PER_BATCH))
        else:
            for task in tasks:
                drawn.setdefault((environment, task[1]), []).append(task)
    return batches + list(drawn.values()), missing


def _batched(tasks: Sequence[_Task], size: int) -> Iterator[Sequence[_Task]]:
    return (tasks[i : i + size] for i in range(0, len(tasks), size))


def _stored(file: ResultsFile, group: _Group, seeds: Sequence[int]) -> list[Run]:
    return file.runs(group.plan.environment, group.plan.spec.label, group.fingerprint, seeds)


def _mean(values: NDArray[np.float64]) -> float:
    return float(values.mean()) if values.size else np.nan


_warm: set[tuple[str, GuidanceSpec]] = set()


def _run_batch(tasks: Sequence[_Task]) -> tuple[list[Run], list[Skipped]]:
    """The runs of some tasks, and those whose problems cannot be posed or have no path."""
    runs: list[Run] = []
    skipped: list[Skipped] = []
    for group, seed in tasks:
        try:
            _pose(group.plan, seed)
        except UNSUITABLE as error:
            skipped.append(
                (group.plan.environment, group.plan.spec.label, seed, group.fingerprint, str(error))
            )
            continue
        runs.append(_run(group, seed))
    return runs, skipped


def _pose(plan: Plan, seed: int) -> None:
    """Pose a problem of a list or distribution, and solve its oracle; one and the same problem works for all.

    Raises:
        InvalidInputError: It cannot be posed: its start is in collision, say.
        NoPathError: It has no path.
    """
    from guided_gym.catalogue.table import make_distribution

    distribution, settings = make_distribution(plan.environment), plan.settings
    if not distribution.fixed:
        _oracle(distribution.problem(seed, settings.goal_tolerance, settings.goal_edge), settings)


def _skipped(file: ResultsFile, groups: Sequence[_Group], seeds: Sequence[int]) -> dict[str, dict[int, str]]:
    """Environment to seed to why its problem was left out, of those that were asked for."""
    wanted = set(seeds)
    out: dict[str, dict[int, str]] = {}
    for group in groups:
        environment = group.plan.environment
        found = file.skipped(environment, group.plan.spec.label, group.fingerprint)
        if chosen := {seed: reason for seed, reason in found.items() if seed in wanted}:
            out.setdefault(environment, {}).update(chosen)
    return {environment: dict(sorted(found.items())) for environment, found in out.items()}


def _common_protocol(plans: Sequence[Plan]) -> str:
    protocols = dict.fromkeys(plan.settings.protocol for plan in plans)
    return " and ".join(protocols)


def _run(group: _Group, seed: int) -> Run:
    plan = group.plan
    _warm_up(plan, seed)
    problem, result = run_once(plan, seed)
    oracle = _oracle(problem, plan.settings)
    efficiency = result.record.efficiency
    positions = problem.robot.position(result.tree.configurations[result.record.selected])
    return Run(
        environment=plan.environment,
        guidance=plan.spec.label,
        seed=seed,
        settings=group.fingerprint,
        problem=problem_identity(problem),
        solved=result.solved,
        samples=result.samples,
        nodes=len(result.tree),
        total_efficiency=result.total_efficiency,
        best_possible=float(result.record.best.sum()),
        collision_checks=result.collision_checks,
        seconds=result.seconds,
        preparation=result.preparation,
        processor=result.processor,
        looks=result.looks,
        path_cost=result.length,
        optimum=float(oracle.cost_to_go(problem.task.start)),
        oracle_error=oracle.error.mean,
        oracle_tail=oracle.error.tail,
        divergence=_mean(result.record.divergence),
        jensen_shannon=_mean(result.record.jensen_shannon),
        entropy=sample_entropy(result),
        regions=region_sums(problem, result),
        curve=efficiency.astype(np.float32),
        best=result.record.best.astype(np.float32),
        cells=grid_cells(positions, problem.environment.bounds),
    )


def _warm_up(plan: Plan, seed: int) -> None:
    """Load what numba has compiled, once per process and group, so that no clock runs meanwhile."""
    if (plan.environment, plan.spec) not in _warm:
        _warm.add((plan.environment, plan.spec))
        short = EvaluationSettings(**{**vars(plan.settings), "max_samples": _WARM_UP_SAMPLES})
        run_once(Plan(plan.environment, plan.spec, short), seed)


def _compile_here(plans: Sequence[Plan], seeds: Sequence[int]) -> None:
    """Compile before there are workers: each of them would compile the same, and say so."""
    for plan in {plan.spec.name: plan for plan in plans}.values():
        seed = _first_that_works(plan, seeds)
        if isinstance(seed, int):
            _warm_up(plan, seed)


def _oracle(problem: Problem, settings: EvaluationSettings) -> Oracle:
    """The oracle that measures the searches of a problem.

    Raises:
        NoPathError: It finds no path.
    """
    from guided_gym.measure.oracle import oracle_for

    task = problem.task
    return oracle_for(problem.space, task.goal, start=task.start, options=settings.oracle)


def region_sums(problem: Problem, result: SearchResult) -> dict[str, tuple[float, int]]:
    """Region of the selected node to (sum of SE, samples); the first region that holds a node counts."""
    positions = problem.robot.position(result.tree.configurations[result.record.selected])
    sums: dict[str, tuple[float, int]] = {}
    left: NDArray[np.bool_] = np.ones(len(positions), bool)
    for name, region in problem.regions.items():
        inside = left & shapely.intersects_xy(region, positions[:, 0], positions[:, 1])
        sums[name] = (float(result.record.efficiency[inside].sum()), int(inside.sum()))
        left &= ~inside
    if left.any() or not sums:
        sums[ELSEWHERE] = (float(result.record.efficiency[left].sum()), int(left.sum()))
    return sums
