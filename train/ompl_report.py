"""OMPL's planners beside the paper's guidances: how well they guide, and how many of their paths collide.

Three tables (docs/ompl.md): each planner's guidance, watched, with certified motions; OMPL as its users run
it, with its own check of motions at two resolutions; and the length of the path over time.
"""

from __future__ import annotations

import copy
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from guided_gym.compute.workers import Executor, Workers, executor_of, map_tasks
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.guidance.registry import make_searcher
from guided_gym.planners.ompl import FAMILY, OmplPlanner, planner_names
from guided_gym.planning import guided_search
from guided_gym.storage.whole_file import write_whole
from guided_gym.train.arm_claims import ARM, WAVE
from guided_gym.train.claims import DRAWN, PROBLEMS
from guided_gym.train.evaluation import UNSUITABLE, Plan, checked_seeds, run_plans
from guided_gym.train.results import Results
from guided_gym.train.specs import GuidanceSpec, code_fingerprint
from guided_gym.train.statistics import bootstrap, significant, wilson
from guided_gym.train.table import save, save_records, summarise
from guided_gym.train.terminal import Progress, named
from guided_gym.trajectories import path_length

if TYPE_CHECKING:
    from guided_gym.problems import Problem

ENVIRONMENTS: Final = (*PROBLEMS, DRAWN, "RandomTrapCup", "RandomMaze", ARM)
OURS: Final = ("rrt", "lazy_prm", "medial_axis", "hybrid", "wave(robot=disc)")
CUT: Final = ("AORRTC", "BITstar", "InformedRRTstar", "SORRTstar")  # an arm's joints have to be, for these
OURS_OF_ARMS: Final = ("rrt", "lazy_prm", "medial_axis", "prm", WAVE)  # a disc in an arm is its base
RESOLUTIONS: Final = (0.0, 0.01, 0.0005)  # certified; OMPL's own default; twenty times as fine
BY_STATES: Final = 0.005  # resolution from which OMPL asks state by state: finer ones are quicker in one call
ANYTIME: Final = ("RRTstar", "InformedRRTstar", "SORRTstar", "BITstar", "AORRTC")
SECONDS: Final = 10.0  # that a planner may take unwatched
MOMENTS: Final = (0.03, 0.1, 0.3, 1.0)  # seconds at which lengths are compared
TIMED: Final = ("Cup", "TrapCup")  # on which they are
TIMED_SEEDS: Final = 16
UNWATCHED_FILE: Final = "unwatched.jsonl"


@dataclass(frozen=True)
class Unwatched:
    """One run of OMPL as its users have it, or of ours without the metric.

    Attributes:
        environment: Name of the problem or distribution.
        planner: The planner, or one of our guidances.
        resolution: Of the check of motions, relative to the extent; 0 for certified ones.
        seed: Seed of the run, and of the problem where it is drawn.
        solved: Whether OMPL says that it has an exact path.
        free: Whether the whole of that path is certified free.
        processor: Processor time, seconds.
        looks: States that OMPL looked at.
        ratio: Length of the path over the optimum; NaN without a path.
        code: Version of the package that wrote it.
    """

    environment: str
    planner: str
    resolution: float
    seed: int
    solved: bool
    free: bool
    processor: float
    looks: int
    ratio: float
    code: str

    @property
    def key(self) -> tuple[str, str, float, int]:
        """What it is a run of."""
        return self.environment, self.planner, self.resolution, self.seed


@dataclass(frozen=True)
class OmplReport:
    """The results of the comparison.

    Attributes:
        results: The watched runs, and ours.
        unwatched: OMPL by itself.
        lengths: Environment, who plans, and the median path over the optimum at each of `MOMENTS`.
    """

    results: Results
    unwatched: list[Unwatched]
    lengths: list[dict[str, Any]]


def ompl_report(
    *,
    environments: Sequence[str] = ENVIRONMENTS,
    planners: Sequence[str] | None = None,
    seeds: int = 128,
    workers: Workers = 1,
    out: str | Path = "results/ompl",
    progress: Progress | None = None,
) -> OmplReport:
    """Run all three parts; what is in ``out`` already is not run again.

    Args:
        environments: Names from the catalogue.
        planners: Of OMPL; all that its wheel binds if None.
        seeds: Runs of each planner on each environment.
        workers: Processes on this machine, or another executor.
        out: Folder of the results.
        progress: Called with (done, total, what is going on).

    Raises:
        InvalidInputError: OMPL is missing, or a number is out of range.
        StorageError: The folder cannot be read or written.
    """
    wanted, folder, doing = checked_seeds(seeds), Path(out), executor_of(workers)
    planners = planner_names() if planners is None else planners
    plans = [
        Plan(environment, GuidanceSpec(name))
        for environment in environments
        for name in (*ours(environment), *(f"ompl:{expression(environment, name)}" for name in planners))
    ]
    results = run_plans(
        plans, seeds=wanted, workers=doing, out=folder, progress=named(progress, "Watching OMPL")
    )
    tasks = [
        (environment, planner, resolution, seed)
        for environment in environments
        for planner in (*ours(environment), *(expression(environment, name) for name in planners))
        for resolution in ((0.0,) if planner in ours(environment) else RESOLUTIONS)
        for seed in wanted
    ]
    unwatched = _all_unwatched(tasks, folder / UNWATCHED_FILE, doing, named(progress, "OMPL by itself"))
    timed = [name for name in TIMED if name in environments]
    lengths = _lengths(timed, wanted[:TIMED_SEEDS], named(progress, "Lengths over time"))
    return OmplReport(results, unwatched, lengths)


def ours(environment: str) -> tuple[str, ...]:
    """Our guidances that are run beside OMPL's planners on an environment."""
    return OURS_OF_ARMS if environment == ARM else OURS


def expression(environment: str, planner: str) -> str:
    """The expression for a planner of OMPL on an environment."""
    return f"{planner}(angles=cut)" if environment == ARM and planner in CUT else planner


def _all_unwatched(
    tasks: Sequence[tuple[str, str, float, int]],
    file: Path,
    workers: Executor,
    progress: Callable[[int, int], None] | None,
) -> list[Unwatched]:
    """Those that the file has, and the others, which it gets."""
    there = {row.key: row for row in _read(file) if row.code == code_fingerprint()}
    missing = [task for task in tasks if task not in there]
    batches = [missing[i : i + 16] for i in range(0, len(missing), 16)]
    done = len(tasks) - len(missing)
    try:
        with file.open("a", encoding="utf-8") as lines:
            for rows in map_tasks(_unwatched_batch, batches, workers if missing else 1):
                for row in rows:
                    lines.write(json.dumps(asdict(row)) + "\n")
                    there[row.key] = row
                lines.flush()
                done = min(done + 16, len(tasks))
                if progress is not None:
                    progress(done, len(tasks))
    except OSError as error:
        raise StorageError(f"cannot write {file}: {error}") from error
    return [there[task] for task in tasks if task in there]


def _read(file: Path) -> Iterator[Unwatched]:
    """The rows of a file, up to one that a kill has cut off."""
    if not file.exists():
        return
    for line in file.read_text(encoding="utf-8").splitlines():
        try:
            yield Unwatched(**json.loads(line))
        except (ValueError, TypeError):
            continue


def _unwatched_batch(tasks: Sequence[tuple[str, str, float, int]]) -> list[Unwatched]:
    rows = []
    for environment, planner, resolution, seed in tasks:
        try:
            rows.append(unwatched(environment, planner, resolution, seed))
        except UNSUITABLE:
            continue
    return rows


def unwatched(environment: str, planner: str, resolution: float, seed: int) -> Unwatched:
    """OMPL by itself on one problem, or one of our guidances, its preparation included, and no metric.

    Raises:
        InvalidInputError: The problem cannot be posed.
        NoPathError: It has no path.
    """
    problem, optimum = _posed(environment, seed)
    problem = unprepared(problem)
    if planner in ours(environment):
        assert problem.space.scale > 0  # the space and the step are known by now, as they are for OMPL
        began = time.process_time()
        result = guided_search(problem, planner, seed=seed, measure=False)
        spent = time.process_time() - began
        return Unwatched(
            environment, planner, 0.0, seed, result.solved, result.solved, spent,
            result.collision_checks + result.looks, result.length / (optimum or 1.0), code_fingerprint(),
        )  # fmt: skip
    watched = make_searcher(f"{FAMILY}:{planner}", resolution=resolution, seconds=SECONDS)
    assert isinstance(watched, OmplPlanner)  # what the family makes
    alone = watched.alone(problem, seed=seed, by_states=resolution >= BY_STATES)
    ratio = math.nan
    if alone.path is not None:
        ratio = path_length(problem.space, alone.path) / (optimum or 1.0)
    return Unwatched(
        environment, planner, resolution, seed, alone.path is not None, alone.free, alone.processor,
        alone.looks, ratio, code_fingerprint(),
    )  # fmt: skip


def unprepared(problem: Problem) -> Problem:
    """The problem in a workspace for which no guiding space has prepared anything yet."""
    return replace(problem, environment=copy.copy(problem.environment))


def _posed(environment: str, seed: int) -> tuple[Problem, float]:
    from guided_gym.catalogue.table import make_distribution
    from guided_gym.measure.oracle import oracle_for

    problem = make_distribution(environment).problem(seed)
    task = problem.task
    return problem, float(oracle_for(problem.space, task.goal, start=task.start).cost_to_go(task.start))


def _lengths(
    environments: Sequence[str], seeds: Sequence[int], progress: Callable[[int, int], None] | None
) -> list[dict[str, Any]]:
    """Median path over the optimum at each moment; our side searches again and keeps the shortest."""
    who = ("hybrid", *(f"ompl:{name}" for name in ANYTIME))
    rows: list[dict[str, Any]] = []
    for environment in environments:
        for name in who:
            ratios = np.array([_ratios(environment, name, seed) for seed in seeds])
            medians = dict(zip(map(str, MOMENTS), np.median(ratios, axis=0).tolist(), strict=True))
            rows.append({"environment": environment, "guidance": name, "seeds": len(seeds), **medians})
            if progress is not None:
                progress(len(rows), len(environments) * len(who))
    return rows


def _ratios(environment: str, name: str, seed: int) -> list[float]:
    """Path over the optimum at each moment; infinite before there is a path."""
    from guided_gym.train.plans import Planner

    problem, optimum = _posed(environment, seed)
    if name.startswith("ompl:"):
        planner = OmplPlanner(name.partition(":")[2], seconds=MOMENTS[-1], first=False)
        result = guided_search(problem, planner, seed=seed, max_samples=10**7, measure=False)
        history = [(seconds + result.preparation, length) for _, seconds, length in planner.history]
    else:
        answer = Planner(problem, name, step=problem.space.scale).plan(seed=seed, seconds=MOMENTS[-1])
        history = [(seconds, length) for seconds, _, length in answer.history.tolist()]
    return [
        min((length for seconds, length in history if seconds <= moment), default=math.inf) / optimum
        for moment in MOMENTS
    ]


# Tables -----------------------------------------------------------------------------------------------------


def guidance_records(results: Results) -> list[dict[str, Any]]:
    """A row per environment and guidance: how well it guides."""
    return [row.record() for row in summarise(results)]


def truth_records(report: OmplReport) -> list[dict[str, Any]]:
    """A row per environment, planner and check of motions: solved, colliding, time, length."""
    records: list[dict[str, Any]] = []
    groups: dict[tuple[str, str, float], list[Unwatched]] = {}
    for row in report.unwatched:
        groups.setdefault((row.environment, row.planner, row.resolution), []).append(row)
    for (environment, planner, resolution), rows in groups.items():
        found = [row for row in rows if row.solved]
        colliding = wilson(sum(not row.free for row in found), len(found)) if found else None
        records.append(
            {
                "environment": environment,
                "guidance": planner if planner in ours(environment) else f"ompl:{planner}",
                "check": f"{100 * resolution:g} %" if resolution else "certified",
                "seeds": len(rows),
                "solved": len(found) / len(rows),
                "colliding": colliding.estimate if colliding else None,
                "colliding_high": colliding.high if colliding else None,
                "processor_ms": 1e3 * bootstrap([row.processor for row in rows], "median").estimate,
                "looks": float(np.median([row.looks for row in rows])),
                "path_ratio": float(np.mean([row.ratio for row in found])) if found else None,
            }
        )
    return sorted(records, key=lambda record: (record["environment"], record["check"] != "certified"))


def fastest(records: Sequence[dict[str, Any]], environment: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """The fastest of the paper's guidances, and the fastest of OMPL's planners that may be trusted.

    Those count that solve at least 95 % of the problems; of OMPL's, where at most 1 % of the paths collide.

    Raises:
        InvalidInputError: There is none.
    """
    here = [r for r in records if r["environment"] == environment and r["solved"] >= 0.95]
    mine = [r for r in here if r["guidance"] in ours(environment)]
    theirs = [r for r in here if r["guidance"].startswith(f"{FAMILY}:") and r["colliding"] <= 0.01]
    if not mine or not theirs:
        raise InvalidInputError(f"{environment}: expected planners that solve 95 % of the searches, got none")
    return min(mine, key=_time), min(theirs, key=_time)


def _time(record: dict[str, Any]) -> float:
    return float(record["processor_ms"])


def save_ompl_report(report: OmplReport, folder: Path) -> list[Path]:
    """Write the tables as CSV, JSON and one Markdown page; returns the files.

    Raises:
        StorageError: The folder cannot be written.
    """
    truth = truth_records(report)
    written = save(summarise(report.results), folder, "guidance")
    written += save_records(truth, folder, "truth")
    written += save_records(report.lengths, folder, "lengths")
    page = folder / "ompl.md"
    write_whole(page, markdown(report))
    return [*written, page]


def markdown(report: OmplReport) -> str:
    """The tables as Markdown."""
    parts = []
    truth = truth_records(report)
    for environment in report.results.environments():
        rows = [row for row in summarise(report.results) if row.environment == environment]
        keys = (
            "solved", "samples_median", "efficiency_per_sample", "excess_efficiency", "collision_checks",
            "path_ratio",
        )  # fmt: skip
        cells = [
            [
                row.guidance,
                *(significant(row.figures[key].estimate * (100 if key == "solved" else 1)) for key in keys),
            ]
            for row in rows
        ]
        head = [
            "guidance",
            "solved %",
            "samples",
            "SE per sample",
            "excess SE",
            "motions",
            "path over optimum",
        ]
        parts += [f"### {environment}, {rows[0].seeds} seeds", _table(head, cells)]
        here = [r for r in truth if r["environment"] == environment]
        truths = [
            [
                r["guidance"],
                r["check"],
                _percent(r["solved"]),
                _percent(r["colliding"]),
                *(_short(r[key]) for key in ("processor_ms", "looks", "path_ratio")),
            ]
            for r in sorted(here, key=_time)
        ]
        head = [
            "guidance",
            "check",
            "solved %",
            "of these collide %",
            "processor ms",
            "looks",
            "path over optimum",
        ]
        parts += [_table(head, truths), _verdict(truth, environment)]
    if report.lengths:
        head = ["environment", "guidance", *(f"{moment:g} s" for moment in MOMENTS)]
        times = [
            [r["environment"], r["guidance"], *(_short(r[str(m)]) for m in MOMENTS)] for r in report.lengths
        ]
        parts += [
            f"### Path over optimum over time, median of {report.lengths[0]['seeds']} seeds",
            _table(head, times),
        ]
    return "\n\n".join(parts) + "\n"


def _verdict(truth: Sequence[dict[str, Any]], environment: str) -> str:
    try:
        ours, theirs = fastest(truth, environment)
    except InvalidInputError as error:
        return str(error)
    return (
        f"Fastest with at most 1 % of paths colliding: {ours['guidance']} {_short(_time(ours))} ms, "
        f"{theirs['guidance']} at {theirs['check']} {_short(_time(theirs))} ms."
    )


def _percent(share: float | None) -> str:
    return "–" if share is None else significant(100 * share)


def _short(value: float | None) -> str:
    return "–" if value is None else significant(value)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])
