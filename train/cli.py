"""The command line ``guided-gym``. Commands import what they need when they run, so that help is quick."""

from __future__ import annotations

import os
import shlex
import sys
import warnings
from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from guided_gym.checks import shown
from guided_gym.errors import GuidedGymError, GuidedGymWarning
from guided_gym.train.command_options import WORK, executor_of, takes
from guided_gym.train.lab_cli import register as register_lab
from guided_gym.train.plan_cli import register as register_plans
from guided_gym.train.reinforcement_cli import train_app
from guided_gym.train.replay_cli import register as register_replays
from guided_gym.train.replay_cli import say_report
from guided_gym.train.terminal import (
    console,
    drawing_status,
    end_on_sigterm,
    exit_code,
    interruptions,
    progress_bar,
)

if TYPE_CHECKING:
    from rich.console import Console

    from guided_gym.compute.workers import Executor
    from guided_gym.train.evaluation import Plan
    from guided_gym.train.results import Results

EXIT_ERROR = 2


class _Group(TyperGroup):
    """Errors of ours become one line and exit code 2, Ctrl-C exit code 130; neither shows a traceback."""

    def invoke(self, ctx: Any) -> Any:
        try:
            with interruptions():
                return super().invoke(ctx)
        except GuidedGymError as error:
            print(f"guided-gym: error: {error}", file=sys.stderr)
            ctx.exit(EXIT_ERROR)
        except KeyboardInterrupt as error:
            print("guided-gym: interrupted", file=sys.stderr)
            ctx.exit(exit_code(error))


app = typer.Typer(
    name="guided-gym",
    cls=_Group,
    help="Guided motion planning: evaluate guidances, reproduce the paper, plan on maps, train agents.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
database_app = typer.Typer(help="Build a database of solved paths, or look into one.", no_args_is_help=True)
app.add_typer(database_app, name="database")
problems_app = typer.Typer(
    help="Build a set of problems with their oracles, or look into one.", no_args_is_help=True
)
app.add_typer(problems_app, name="problems")
app.add_typer(train_app, name="train")

Seeds = Annotated[int, typer.Option(help="Searches per environment and guidance, with seeds from 0 on.")]
Figures = Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures.")]
GoalTolerance = Annotated[
    float | None,
    typer.Option(help="Distance at which the goal counts as reached. Default: what the problem says."),
]
GoalEdge = Annotated[
    bool | None,
    typer.Option(
        "--goal-edge/--no-goal-edge",
        help="Whether the goal counts as reached once a node sees it. Default: what the problem says.",
    ),
]
Imports = Annotated[
    list[str] | None,
    typer.Option(
        "--import", help="Module to import first, which registers environments or guidances. May be repeated."
    ),
]


def main() -> None:
    """Entry point of the console script."""
    warnings.formatwarning = _one_line
    end_on_sigterm()
    app()


_usual = warnings.formatwarning


def _one_line(
    message: Warning | str, category: type[Warning], filename: str, lineno: int, line: str | None = None
) -> str:
    """A warning of ours as the line it is; others as usual."""
    if issubclass(category, GuidedGymWarning):
        return f"guided-gym: warning: {message}\n"
    return _usual(message, category, filename, lineno, line)


def _print_version(wanted: bool) -> None:
    if wanted:
        from guided_gym.train.specs import package_version

        print(f"guided-gym {package_version()}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit."),
    ] = False,
) -> None:
    pass


@app.command("list")
def list_names(imports: Imports = None) -> None:
    """List the environments, guidances (learned ones, too) and robots."""
    from guided_gym.train.overview import overview
    from guided_gym.train.specs import import_modules

    import_modules(imports or ())
    screen = console()
    for title, rows in overview().items():
        screen.print(_names_table(title, rows))


@app.command()
@takes(WORK)
def evaluate(
    context: typer.Context,
    env: Annotated[
        str,
        typer.Option(
            help="Environments (see `guided-gym list`), separated by commas. NAME@test draws test problems."
        ),
    ],
    guidance: Annotated[
        str,
        typer.Option(
            help="Guidances, separated by commas: name@option=value, a+b for a hybrid, or an expression."
        ),
    ] = "rrt,lazy_prm,medial_axis,hybrid",
    seeds: Seeds = 128,
    out: Annotated[Path | None, typer.Option(help="Folder of the results. Default: results/ENV.")] = None,
    max_samples: Annotated[int, typer.Option(help="A search gives up after so many samples.")] = 1000,
    step: Annotated[
        float | None,
        typer.Option(
            help="Radius of an expansion. Default: chosen for each space, at most 5 % of its diagonal."
        ),
    ] = None,
    candidates: Annotated[int, typer.Option(help="Candidates from which a guided expansion chooses.")] = 16,
    protocol: Annotated[
        str,
        typer.Option(
            help="What to compare: whole guidances, their selection alone, or their expansion alone."
        ),
    ] = "whole",
    expansion: Annotated[
        str | None,
        typer.Option(help="Who proposes expansions: uniform, or a guidance. Default: each guidance itself."),
    ] = None,
    rewire: Annotated[
        bool, typer.Option("--rewire", help="Rewire the tree as it grows, as RRT* does.")
    ] = False,
    goal_tolerance: GoalTolerance = None,
    goal_edge: GoalEdge = None,
    epsilon: Annotated[float, typer.Option(help="Least probability that the target gives a node.")] = 1e-4,
    delta: Annotated[float, typer.Option(help="Temperature of a node's suboptimality in the target.")] = 0.1,
    tau: Annotated[float, typer.Option(help="Temperature of a node's remaining work in the target.")] = 0.1,
    normalisation: Annotated[
        str,
        typer.Option(
            help="What both are divided by: start (the optimum), or tree (their largest values in the tree)."
        ),
    ] = "start",
    resolution: Annotated[
        str,
        typer.Option(help="Vertices of the oracle's grid along each axis, as 128,128,64. Default: chosen."),
    ] = "",
    oracle_budget: Annotated[
        int, typer.Option(help="Most vertices that the oracle's finest grid may have.")
    ] = 4_000_000,
    distributions: Annotated[
        bool,
        typer.Option("--distributions", help="Measure the whole distribution of each guidance, too (slow)."),
    ] = False,
    database: Annotated[Path | None, typer.Option(help="Database of paths that path_database uses.")] = None,
    figures: Figures = True,
    trace: Annotated[
        str,
        typer.Option(
            help="Searches to record for `replay`: best, median, worst or seeds, separated by commas."
        ),
    ] = "",
    report: Annotated[
        bool, typer.Option("--report", help="Make a page of the results, as `guided-gym report FOLDER` does.")
    ] = False,
    imports: Imports = None,
    **given: Any,
) -> None:
    """Evaluate guidances on environments: a table, a results file and figures. Call it again to resume."""
    from guided_gym.options import OracleOptions, TargetParameters
    from guided_gym.train.chosen_runs import check_words
    from guided_gym.train.evaluation import Plan, as_specs
    from guided_gym.train.evaluation import evaluate as run
    from guided_gym.train.report import note_evaluation
    from guided_gym.train.specs import EvaluationSettings, file_label, words

    settings = EvaluationSettings(
        max_samples=max_samples,
        expansion=expansion,
        step=step,
        candidates=candidates,
        goal_tolerance=goal_tolerance,
        rewire=rewire,
        target=TargetParameters(delta, tau, epsilon, normalisation),
        distributions=distributions,
        goal_edge=goal_edge,
        protocol=protocol,
        oracle=OracleOptions(_resolution(resolution), budget=oracle_budget),
    )
    names, guidances = words("env", env), words("guidance", guidance)
    check_words(words("trace", trace), seeds)
    label = "+".join(map(file_label, names))
    folder = out or Path("results") / (label + ("" if protocol == "whole" else f"-{protocol}"))
    with progress_bar(f"Evaluating on {', '.join(names)}", folder) as progress:
        results = run(
            names, guidances, seeds=seeds, workers=executor_of(given), out=folder,
            settings=settings, database=database, imports=imports or (), progress=progress,
        )  # fmt: skip
    plans = [Plan(name, spec, settings) for name in names for spec in as_specs(guidances, database)]
    if _writable(folder):
        note_evaluation(folder, plans, range(seeds), _command_line(context))
    _show(results, plans, folder, figures, trace)
    if report and _writable(folder):
        say_report(folder)


def _writable(folder: Path) -> bool:
    """Whether files of the folder can be written; results can be shown where they can only be read."""
    return os.access(folder, os.W_OK, effective_ids=os.access in os.supports_effective_ids)


def _command_line(context: typer.Context) -> str:
    """The command that is being run, as it can be typed again: what was given, without the defaults."""
    words = ["guided-gym", context.info_name or ""]
    for option in context.command.params:
        value = context.params.get(option.name or "")
        if value is None or value == option.default or (isinstance(value, list) and not value):
            continue
        if value is False and option.secondary_opts:
            words.append(option.secondary_opts[0])
        elif value is True:
            words.append(option.opts[0])
        else:
            for one in value if isinstance(value, list | tuple) else [value]:
                words += [option.opts[0], str(one)]
    return shlex.join(words)


def _resolution(text: str) -> tuple[int, ...] | None:
    """The counts of ``--resolution``; None if it was not given."""
    from guided_gym.errors import InvalidInputError
    from guided_gym.train.specs import words

    if not text:
        return None
    items = words("resolution", text)
    if not all(item.isascii() and item.isdigit() and len(item) < 10 for item in items):
        raise InvalidInputError(f"resolution: expected counts like 128,128,64, got {shown(text)}")
    return tuple(map(int, items))


@app.command("single-step")
@takes(WORK)
def single_step(
    env: Annotated[str, typer.Option(help="Environment (see `guided-gym list`).")],
    guidance: Annotated[str, typer.Option(help="Guidances to judge, written as for `evaluate`.")],
    harvest: Annotated[
        str, typer.Option("--from", help="Guidances that grow the trees. Default: those that are judged.")
    ] = "",
    seeds: Seeds = 32,
    moments: Annotated[int, typer.Option(help="Trees to take from each search.")] = 4,
    max_samples: Annotated[int, typer.Option(help="A search gives up after so many samples.")] = 1000,
    out: Annotated[Path | None, typer.Option(help="Folder for the table, as CSV and JSON.")] = None,
    imports: Imports = None,
    **given: Any,
) -> None:
    """Judge how guidances select, all on the same trees, which come from searches."""
    from guided_gym.train.single_step import record, single_step_table
    from guided_gym.train.single_step import single_step as run
    from guided_gym.train.specs import EvaluationSettings, words
    from guided_gym.train.table import save_records

    rows = run(
        env, words("guidance", guidance), harvesters=words("from", harvest), seeds=seeds, moments=moments,
        workers=executor_of(given),
        settings=EvaluationSettings(max_samples=max_samples), imports=imports or (),
    )  # fmt: skip
    console().print(single_step_table(rows, env))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        _name_files(console(), out, save_records([record(row) for row in rows], out, "single-step"))


@app.command()
@takes(WORK)
def reproduce(
    context: typer.Context,
    seeds: Seeds = 128,
    out: Annotated[Path, typer.Option(help="Folder for results, figures and tables.")] = Path(
        "results/paper"
    ),
    figures: Figures = True,
    baselines: Annotated[
        bool, typer.Option(help="Evaluate goal_distance and uninformed on every problem, too.")
    ] = False,
    ompl: Annotated[
        bool,
        typer.Option(
            "--ompl", help="Compare OMPL's planners with the paper's guidances instead (docs/ompl.md)."
        ),
    ] = False,
    arms: Annotated[
        bool,
        typer.Option("--arms", help="Check the claims on an arm instead; results go to the subfolder arms."),
    ] = False,
    **given: Any,
) -> None:
    """Run the paper's experiments, draw its figures and check its claims. Call it again to resume."""
    from guided_gym.train.report import note_evaluation
    from guided_gym.train.reproduction import reproduce as run
    from guided_gym.train.reproduction import reproduce_arms, save_report

    doing = executor_of(given)
    if ompl:
        _reproduce_ompl(seeds, doing, out)
        return
    if arms:
        out, figures = out / "arms", False  # the figures are of the plane
        with progress_bar("Asking of an arm", out) as progress:
            report = reproduce_arms(seeds=seeds, workers=doing, out=out, progress=progress)
    else:
        with progress_bar("Reproducing the paper", out) as progress:
            report = run(seeds=seeds, workers=doing, out=out, baselines=baselines, progress=progress)
    with drawing_status(figures) as drawn:
        written = save_report(report, out, figures=figures, drawn=drawn)
    note_evaluation(out, report.plans, range(seeds), _command_line(context))
    screen = console()
    for table in report.tables():
        screen.print(table)
    _name_files(screen, out, written)


def _reproduce_ompl(seeds: int, workers: Executor, out: Path) -> None:
    """OMPL's planners: three tables, in a folder of their own."""
    from guided_gym.train.ompl_report import markdown, ompl_report, save_ompl_report

    folder = out / "ompl"
    with progress_bar("OMPL's planners", folder) as progress:
        report = ompl_report(seeds=seeds, workers=workers, out=folder, progress=progress)
    written = save_ompl_report(report, folder)
    console().print(markdown(report), markup=False)
    _name_files(console(), folder, written)


@database_app.command("build")
@takes(WORK)
def database_build(
    env: Annotated[str, typer.Argument(help="Environment whose problems to solve.")],
    paths: Annotated[int, typer.Option(help="Paths that the database shall hold.")],
    out: Annotated[
        Path | None, typer.Option(help="File of the database. Default: databases/ENV.sqlite.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the first problem.")] = 1_000_000,
    imports: Imports = None,
    **given: Any,
) -> None:
    """Solve an environment's problems and keep the paths. Call it again to resume, or for more paths."""
    from guided_gym.train.paths import build_path_database
    from guided_gym.train.specs import file_label, import_modules

    import_modules(imports or ())
    file = out or Path("databases") / f"{file_label(env)}.sqlite"
    with progress_bar(f"Solving {env}", file) as progress:
        report = build_path_database(
            env, file, paths, workers=executor_of(given), offset=seed,
            imports=tuple(imports or ()), progress=progress,
        )  # fmt: skip
    print(f"{file}: {report.paths} paths ({report.solved} new, {report.unsolved} problems not solved)")


@database_app.command("info")
def database_info(file: Annotated[Path, typer.Argument(help="Database of paths.")]) -> None:
    """Say what a database of paths holds."""
    from guided_gym.train.overview import database_rows

    console().print(_names_table(str(file), database_rows(file)))


@problems_app.command("build")
@takes(WORK)
def problems_build(
    env: Annotated[
        str, typer.Argument(help="Environment whose problems to draw. NAME@train draws from a split.")
    ],
    count: Annotated[int, typer.Option(help="Problems that the set shall hold.")],
    out: Annotated[Path | None, typer.Option(help="File of the set. Default: problems/ENV.problems.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the first problem.")] = 0,
    goal_tolerance: GoalTolerance = None,
    goal_edge: GoalEdge = None,
    imports: Imports = None,
    **given: Any,
) -> None:
    """Draw problems and solve their oracles, for gym.make(id, problems=FILE). Call it again to resume."""
    from guided_gym.catalogue.problem_set import SUFFIX, build_problem_set
    from guided_gym.train.specs import file_label, import_modules

    prepare = partial(import_modules, tuple(imports or ()))
    prepare()
    file = out or Path("problems") / f"{file_label(env)}{SUFFIX}"
    with progress_bar(f"Drawing {env}", file) as progress:
        report = build_problem_set(
            file, env, count, first=seed, goal_tolerance=goal_tolerance, goal_edge=goal_edge,
            workers=executor_of(given), prepare=prepare, progress=progress,
        )  # fmt: skip
    without = f", {report.without_path} of them without a path" if report.without_path else ""
    print(f"{file}: {report.problems} problems ({report.solved} new{without})")


@problems_app.command("info")
def problems_info(file: Annotated[Path, typer.Argument(help="Set of problems.")]) -> None:
    """Say what a set of problems holds."""
    from guided_gym.train.overview import problem_set_rows

    console().print(_names_table(str(file), problem_set_rows(file)))


@app.command()
def doctor() -> None:
    """Print versions and folders, for a bug report."""
    from guided_gym.train.overview import doctor_rows

    for title, rows in doctor_rows().items():
        console().print(_names_table(title, rows))


@app.command()
def warmup() -> None:
    """Compile all kernels now, so that nobody waits for them later. Once per version and machine."""
    from guided_gym.train.warmup import warm_up

    seconds = warm_up(lambda name, spent: console().print(f"{spent:6.1f} s  {name}"))
    console().print(f"ready after {seconds:.0f} s")


register_plans(app)
register_replays(app)
register_lab(app)


def _names_table(title: str, rows: list[tuple[str, str]]) -> Any:
    from rich.table import Table

    table = Table(title=title, title_justify="left", show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True, style="bold")
    table.add_column(overflow="fold")
    for name, text in rows:
        table.add_row(name, text)
    return table


def _show(results: Results, plans: Sequence[Plan], folder: Path, figures: bool, trace: str) -> None:
    """Print the table and write it, then record searches and draw the figures."""
    from guided_gym.train.chosen_runs import trace_runs
    from guided_gym.train.results import RESULTS_FILE
    from guided_gym.train.specs import words
    from guided_gym.train.table import rich_tables, save, summarise, verdicts

    screen = console()
    rows = summarise(results)
    for table in rich_tables(rows):
        screen.print(table)
    for line in verdicts(results):
        screen.print(line, markup=False)
    if not _writable(folder):
        screen.print(f"\n{folder} cannot be written: tables and figures there stay as they are", markup=False)
        return
    written = [folder / RESULTS_FILE, *save(rows, folder)]
    if trace:
        written += [one.path for one in trace_runs(results, plans, words("trace", trace), folder)]
    if figures:
        from guided_gym.train.drawing import draw_evaluation

        with drawing_status(figures) as drawn:
            written += draw_evaluation(results, plans, folder / "figures", drawn)
    _name_files(screen, folder, written)


def _name_files(screen: Console, folder: Path, written: list[Path]) -> None:
    """Say what lies where; of a folder below, only how many files."""
    names = [path.name for path in written if path.parent == folder]
    below = Counter(path.parent for path in written if path.parent != folder)
    names += [f"{place.relative_to(folder)}/ ({count} files)" for place, count in below.items()]
    screen.print(f"\nIn {folder}: {', '.join(names)}")


if __name__ == "__main__":
    main()
