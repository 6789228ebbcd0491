"""``guided-gym plan``, ``check`` and ``convert``: problem files and maps on the command line."""

from __future__ import annotations

import csv
import io
import json
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError, NoPathError
from guided_gym.train.command_options import Options, takes
from guided_gym.train.terminal import console

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from guided_gym.catalogue.inspection import Gap
    from guided_gym.catalogue.maps import MapOptions
    from guided_gym.geometry.environment import Environment
    from guided_gym.geometry.robots import Robot
    from guided_gym.geometry.space import ConfigurationSpace
    from guided_gym.problems import Problem
    from guided_gym.train.plans import Answer

EXIT_UNSOLVED = 1

File = Annotated[Path, typer.Argument(help="Problem file (.toml, .json) or map (docs/maps.md).")]
RobotOption = Annotated[
    str | None,
    typer.Option(
        "--robot",
        help="point, segment:LENGTH, rectangle:LENGTH,WIDTH or polygon:X,Y;X,Y;... Default: the file's.",
    ),
]
Start = Annotated[
    str | None,
    typer.Option(help="Coordinates, such as X,Y or X,Y,HEADING (radians). Default: the file's start."),
]
Goal = Annotated[
    str | None,
    typer.Option(help="Coordinates, such as X,Y or X,Y,HEADING (radians). Default: the file's goal."),
]
MAP: Final[Options] = {  # the fields of `MapOptions` that a command line sets
    "unknown": (
        Annotated[str, typer.Option(help="What a raster's unknown cells count as: occupied or free.")],
        "occupied",
    ),
    "threshold": (
        Annotated[float, typer.Option(help="Probability from which on a raster's cell is occupied.")],
        0.5,
    ),
    "simplify": (
        Annotated[
            float, typer.Option(help="Simplify polygons; passages up to this width may open or close.")
        ],
        0.0,
    ),
    "speckles": (
        Annotated[int, typer.Option(help="Leave out a raster's parts of fewer cells than this.")],
        1,
    ),
    "resolution": (
        Annotated[float | None, typer.Option(help="Side of a cell, for a picture or array.")],
        None,
    ),
    "geographic": (
        Annotated[
            bool,
            typer.Option(
                "--geographic", help="Convert GeoJSON from degrees of longitude and latitude to metres."
            ),
        ],
        False,
    ),
    "repair": (
        Annotated[bool, typer.Option("--repair", help="Mend GeoJSON polygons that cross themselves.")],
        False,
    ),
}


def register(app: typer.Typer) -> None:
    """Add the commands of this module to an application."""
    for command in (plan, check, convert):
        app.command()(command)


@takes(MAP)
def plan(
    file: File,
    robot: RobotOption = None,
    start: Start = None,
    goal: Goal = None,
    tasks: Annotated[
        Path | None, typer.Option(help="CSV file of tasks on this map, one per line: start, then goal.")
    ] = None,
    guidance: Annotated[
        str, typer.Option(help="Guidance; auto is a wave on a grid as fine as the robot needs.")
    ] = "auto",
    seed: Annotated[int, typer.Option(help="Seed of every random choice.")] = 0,
    max_samples: Annotated[int, typer.Option(help="A search gives up after so many samples.")] = 2000,
    smooth: Annotated[
        int, typer.Option(help="Attempts to shorten the path. What they find is certified, too.")
    ] = 0,
    room: Annotated[float, typer.Option(help="Clearance that smoothing keeps to obstacles.")] = 0.0,
    seconds: Annotated[
        float, typer.Option(help="Search on for so many seconds, and keep the shortest path.")
    ] = 0.0,
    velocity: Annotated[
        str | None,
        typer.Option(help="Largest speed, of each coordinate or of all. Adds times (needs toppra)."),
    ] = None,
    acceleration: Annotated[str | None, typer.Option(help="Largest acceleration, given likewise.")] = None,
    svg: Annotated[
        Path | None, typer.Option(help="Draw the plan into this file (.svg, .png or .pdf).")
    ] = None,
    history: Annotated[
        Path | None,
        typer.Option(help="Draw the path's length over time into this file (.svg, .png or .pdf)."),
    ] = None,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write the whole plan into this file.")
    ] = None,
    csv_file: Annotated[
        Path | None, typer.Option("--csv", help="Write the waypoints into this file.")
    ] = None,
    **given: Any,
) -> None:
    """Plan a path on a map, or many paths, and print their length, clearance, samples and time."""
    from guided_gym.catalogue.maps import MapOptions
    from guided_gym.train.plans import Planner, read_tasks

    check_outputs(svg, history)
    began = time.perf_counter()
    options = MapOptions(**given)
    first = None if tasks is None else _first_task(tasks)
    problems = _problems(file, robot, start or (first and first[0]), goal or (first and first[1]), options)
    problem = problems[0]
    planner = Planner(problem, guidance, max_samples=max_samples, smoothing=smooth, room=room)
    loaded = time.perf_counter() - began
    wanted = [one.task for one in problems] if tasks is None else read_tasks(tasks, problem)
    answers = [planner.plan(task, seed=seed, seconds=seconds) for task in wanted]
    limits = _limits(velocity, acceleration)
    _print_plan(problem, answers, loaded)
    if json_file is not None:
        _write_json(json_file, file, planner.space, answers, limits)
    if csv_file is not None:
        _write(csv_file, _csv(planner.space, answers, limits))
    if svg is not None:
        from guided_gym.train.plan_figures import plan_figure

        _draw(plan_figure(problem, answers), svg)
    if history is not None and answers[0].solved:
        from guided_gym.train.plan_figures import history_figure

        _draw(history_figure(answers[0]), history)
    if not all(answer.solved for answer in answers):
        raise typer.Exit(EXIT_UNSOLVED)


@takes(MAP)
def check(
    file: File,
    robot: RobotOption = None,
    start: Start = None,
    goal: Goal = None,
    svg: Annotated[
        Path | None, typer.Option(help="Draw what was found into this file (.svg, .png or .pdf).")
    ] = None,
    path: Annotated[bool, typer.Option(help="Look whether there is a path at all.")] = True,
    **given: Any,
) -> None:
    """Say what is wrong with a problem or map, draw it, and name gaps that are narrow for the robot."""
    from guided_gym.catalogue.inspection import narrow_gaps, robot_widths
    from guided_gym.catalogue.maps import MapOptions
    from guided_gym.geometry.space import ConfigurationSpace

    check_outputs(svg)
    options = MapOptions(**given)
    environment, body, poses, weight = _parts(file, robot, start, goal, options)
    rows = [("workspace", _size_of(environment))]
    gaps: list[Gap] = []
    placed: list[tuple[str, Sequence[float], bool]] = []
    wrong = False
    if body is not None:
        least, turning = robot_widths(body)
        rows.append(("robot", f"{body.name}: {least:.4g} wide, turns in a circle of {turning:.4g}"))
        space = ConfigurationSpace(body, environment, weight)
        for label, q in poses.items():
            free, text = _pose_row(space, label, q)
            placed.append((label, q, free))
            rows.append((label, text))
            wrong |= not free
        goals = [name for name in poses if name != "start"]
        if "start" in poses and not wrong and path:
            for name in goals:
                found, text = _path_row(space, poses["start"], poses[name])
                rows.append(("path" if len(goals) == 1 else f"path to {name}", text))
                wrong |= not found
        gaps = narrow_gaps(environment, body)
    screen = console()
    _print_rows(str(file), rows)
    if gaps:
        _print_rows(
            "Narrow gaps",
            [
                (str(k), f"{gap.width:.4g} at ({gap.middle[0]:.4g}, {gap.middle[1]:.4g}): {gap.verdict}")
                for k, gap in enumerate(gaps, start=1)
            ],
        )
    elif body is not None:
        screen.print("No narrow gaps.")
    if svg is not None:
        from guided_gym.train.plan_figures import check_figure

        _draw(check_figure(environment, body, placed, gaps, file.name), svg)
    if wrong:
        raise typer.Exit(EXIT_UNSOLVED)


@takes(MAP)
def convert(
    source: Annotated[Path, typer.Argument(help="Problem file or map.")],
    target: Annotated[
        Path,
        typer.Argument(
            help="Problem file (.toml, .json), GeoJSON (.geojson), ROS map (.yaml, with a .pgm beside it) or "
            "picture (.svg, .png, .pdf)."
        ),
    ],
    robot: RobotOption = None,
    start: Start = None,
    goal: Goal = None,
    task: Annotated[int, typer.Option(help="Number of the task in a MovingAI scenario, from 0 on.")] = 0,
    **given: Any,
) -> None:
    """Convert a map or problem into a problem file, GeoJSON, a ROS map or a picture."""
    from guided_gym.catalogue.files import file_of, map_file, write_problem_file
    from guided_gym.catalogue.map_formats.geojson import write_geojson
    from guided_gym.catalogue.map_formats.ros import write_ros
    from guided_gym.catalogue.maps import MapOptions

    suffix = target.suffix.lower()
    if suffix not in (".toml", ".json", ".geojson", ".yaml", ".yml", ".svg", ".png", ".pdf"):
        raise InvalidInputError(
            f"{target}: expected .toml, .json, .geojson, .yaml, .svg, .png or .pdf, "
            f"got {shown(target.suffix)}"
        )
    options = MapOptions(**given)
    body: Robot | None
    poses: dict[str, list[float]] = {}
    if source.suffix.lower() == ".scen":
        from guided_gym.catalogue.file_problems import ScenarioProblems
        from guided_gym.geometry.robots import rigid

        problems = ScenarioProblems(source)
        if not 0 <= task < len(problems):
            raise InvalidInputError(f"task: expected 0 to {len(problems) - 1}, got {task}")
        problem = problems[task]
        model = file_of(problem)
        environment, body = problem.environment, rigid(problem.robot, "convert")
    else:
        environment, body, poses, weight = _parts(source, robot, start, goal, options)
        model = map_file(source, environment, body, poses, weight)
    if suffix in (".toml", ".json"):
        write_problem_file(model, target)
    elif suffix == ".geojson":
        write_geojson(target, environment)
    elif suffix in (".yaml", ".yml"):
        write_ros(target, environment, _raster_resolution(source, target, options))
    else:
        from guided_gym.train.plan_figures import check_figure

        placed = [(label, q, True) for label, q in poses.items()]
        _draw(check_figure(environment, body, placed, (), source.name), target)
    console().print(f"{target}: {_size_of(environment)}")


def _raster_resolution(source: Path, target: Path, options: MapOptions) -> float:
    """The side of a cell of a ROS map to be written: that of the options, or of the raster that was read."""
    from guided_gym.catalogue.map_formats.ros import ros_header

    resolution, read = options.resolution, source
    if source.suffix.lower() in (".yaml", ".yml"):
        own, read = ros_header(source)
        resolution = own if resolution is None else resolution
    elif source.suffix.lower() in (".map", ".scen") and resolution is None:
        resolution = 1.0
    picture = target.with_suffix(".pgm")
    if picture.resolve() in (source.resolve(), read.resolve()):
        raise InvalidInputError(
            f"{target}: expected another name, since its picture would replace {picture}, which was read"
        )
    if resolution is None:
        raise InvalidInputError(f"resolution: expected the side of a cell for a raster of {source}, got none")
    return resolution


# What the options say ---------------------------------------------------------------------------------------


def parse_robot(text: str) -> Robot:
    """The robot of the option ``--robot``.

    Raises:
        InvalidInputError: Another form, or numbers out of range.
    """
    from guided_gym.geometry.robots import Robot

    kind, _, rest = text.partition(":")
    try:
        if kind == "point" and not rest:
            return Robot.point()
        if kind == "segment":
            return Robot.segment(float(rest))
        if kind == "rectangle":
            length, width = map(float, rest.split(","))
            return Robot.rectangle(length, width)
        if kind == "polygon":
            return Robot.polygon([[float(v) for v in corner.split(",")] for corner in rest.split(";")])
    except InvalidInputError as error:
        raise InvalidInputError(f"robot: {error}") from None
    except ValueError:
        pass
    raise InvalidInputError(
        "robot: expected point, segment:LENGTH, rectangle:LENGTH,WIDTH or polygon:X,Y;X,Y;..., "
        f"got {shown(text)}"
    )


def parse_pose(name: str, text: str) -> list[float]:
    """The configuration of an option: numbers with commas.

    Raises:
        InvalidInputError: No two or three finite numbers, or a heading that can only be in degrees.
    """
    from guided_gym.train.plans import check_heading

    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (2, 3) or not all(map(math.isfinite, values)):
        raise InvalidInputError(f"{name}: expected X,Y or X,Y,HEADING, got {shown(text)}")
    check_heading(name, values)
    return values


def check_outputs(*files: Path | None) -> None:
    """Refuse pictures of a kind that is not drawn, before anything is worked out.

    Raises:
        InvalidInputError: One is.
    """
    for file in files:
        if file is not None and file.suffix.lower() not in (".svg", ".png", ".pdf"):
            raise InvalidInputError(
                f"{file}: expected a picture (.svg, .png or .pdf), got {shown(file.suffix)}"
            )


def _limits(velocity: str | None, acceleration: str | None) -> tuple[list[float], list[float]] | None:
    if velocity is None and acceleration is None:
        return None
    if velocity is None or acceleration is None:
        raise InvalidInputError("velocity, acceleration: expected both or none, got one of them")
    try:
        return [float(v) for v in velocity.split(",")], [float(v) for v in acceleration.split(",")]
    except ValueError:
        raise InvalidInputError(
            f"velocity, acceleration: expected numbers, got {shown(velocity)} and {acceleration!r}"
        ) from None


def _parts(
    file: Path, robot: str | None, start: str | None, goal: str | None, options: MapOptions
) -> tuple[Environment, Robot | None, dict[str, list[float]], float | None]:
    """The workspace of a file, the robot, start and goal if there are any, and the rotation weight."""
    from guided_gym.catalogue.files import PROBLEM_SUFFIXES, load_environment, read_problem_file
    from guided_gym.geometry.robots import rigid

    environment = load_environment(file, options)
    given = {"start": start, "goal": goal}
    poses = {name: parse_pose(name, text) for name, text in given.items() if text is not None}
    body = None if robot is None else parse_robot(robot)
    weight = None
    if file.suffix.lower() in PROBLEM_SUFFIXES:
        model = read_problem_file(file)
        weight = model.metric.rotation_weight
        if body is None and model.robot is not None:
            body = rigid(model.robot.robot(), "convert")
        for name, q in model.configurations().items():
            if given[name.partition("s[")[0]] is None:
                poses[name] = q
    for name, q in poses.items():
        if body is not None and len(q) != body.dimension:
            raise InvalidInputError(
                f"{name}: expected {body.dimension} numbers for {body.name!r}, got {len(q)}"
            )
    return environment, body, dict(sorted(poses.items(), key=lambda row: row[0] != "start")), weight


def _problems(
    file: Path, robot: str | None, start: str | None, goal: str | None, options: MapOptions
) -> list[Problem]:
    """The problem that a file and the options make together, or one for each goal of the file."""
    import numpy as np

    from guided_gym.catalogue.files import PROBLEM_SUFFIXES, load_problems, read_problem_file
    from guided_gym.catalogue.inspection import pose_trouble
    from guided_gym.geometry.space import ConfigurationSpace
    from guided_gym.problems import Problem, Task

    whole = robot is None and start is None and goal is None
    if file.suffix.lower() == ".scen":
        from guided_gym.catalogue.file_problems import file_distribution

        return [file_distribution(str(file)).problem(0)]
    if file.suffix.lower() in PROBLEM_SUFFIXES and whole:
        return load_problems(file)
    environment, body, poses, weight = _parts(file, robot, start, goal, options)
    goals = [q for name, q in poses.items() if name != "start"]
    for name, there in (("robot", body is not None), ("start", "start" in poses), ("goal", bool(goals))):
        if not there:
            raise InvalidInputError(f"{name}: expected it in {file} or as --{name}, got none")
    assert body is not None
    space = ConfigurationSpace(body, environment, weight)
    for name, q in poses.items():
        if not space.valid(q):
            trouble = pose_trouble(space, np.array(q))
            raise InvalidInputError(f"{name}: expected a free pose, got {trouble}")
    tolerance, by_edge = 0.0, True
    if file.suffix.lower() in PROBLEM_SUFFIXES:
        rule = read_problem_file(file).goal_rule
        tolerance, by_edge = rule.tolerance, rule.by_edge
    tasks = [Task(poses["start"], q, tolerance, by_edge) for q in goals]
    problem = Problem(body, environment, tasks[0], file.stem, rotation_weight=weight)
    problem.__dict__["space"] = space
    return [problem.asking(task) for task in tasks]


def _first_task(tasks: Path) -> tuple[str, str] | None:
    """Start and goal of the first task, in which the space is made; None where the line is no task."""
    from guided_gym.storage.foreign_file import read_text

    for row in csv.reader(read_text(tasks).splitlines()[:2]):
        cells = [cell.strip() for cell in row]
        half = len(cells) // 2
        try:
            [float(cell) for cell in cells]
        except ValueError:
            continue
        if half in (2, 3) and len(cells) == 2 * half:
            return ",".join(cells[:half]), ",".join(cells[half:])
    return None


# What is said and written -----------------------------------------------------------------------------------


def _size_of(environment: Environment) -> str:
    xmin, ymin, xmax, ymax = environment.bounds
    count = len(environment.obstacles)
    return f"{xmax - xmin:.6g} x {ymax - ymin:.6g}, {count} obstacle{'s' * (count != 1)}"


def _pose_row(space: ConfigurationSpace, label: str, q: Sequence[float]) -> tuple[bool, str]:
    import numpy as np

    from guided_gym.catalogue.inspection import pose_trouble

    if space.valid(q):
        return True, f"{[round(v, 6) for v in q]}, free, clearance {float(space.clearance(q)):.4g}"
    return False, f"WRONG: expected a free pose, got {pose_trouble(space, np.array(q))}"


def _path_row(space: ConfigurationSpace, start: Sequence[float], goal: Sequence[float]) -> tuple[bool, str]:
    from guided_gym.measure.oracle import Oracle

    try:
        oracle = Oracle(space, goal, start=start)
    except NoPathError as error:
        return False, f"WRONG: {error}"
    return True, f"there is one, of length {float(oracle.cost_to_go(start)):.4g} (to about 1 %)"


def _print_rows(title: str, rows: list[tuple[str, str]]) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(title), title_justify="left", show_header=False, box=None, padding=(0, 2, 0, 0))
    table.add_column(no_wrap=True, style="bold")
    table.add_column(overflow="fold")
    for name, text in rows:
        table.add_row(name, Text(text))
    console().print(table)


def _print_plan(problem: Problem, answers: Sequence[Answer], loaded: float) -> None:
    solved = [answer for answer in answers if answer.solved]
    if len(answers) == 1:
        one = answers[0]
        rows = [("workspace", _size_of(problem.environment)), ("samples", str(one.samples))]
        if one.path is not None:
            rows += [("length", f"{one.length:.6g}"), ("clearance", f"{one.clearance:.4g}")]
            rows.append(("waypoints", str(len(one.path))))
        else:
            why = f"there is none: {one.no_path}" if one.no_path else "`guided-gym check` may say why"
            rows.append(("path", f"none found in {one.samples} samples; {why}"))
        if one.searches > 1:
            first, last = one.history[0, 2], one.history[-1, 2]
            rows.append(("searches", f"{one.searches}; length {first:.6g} at first, {last:.6g} at last"))
        rows.append(
            ("seconds", f"{loaded:.2f} to load, {one.preparation:.2f} to prepare, {one.seconds:.2f} in all")
        )
    else:
        total = sum(answer.seconds for answer in answers)
        lengths = [answer.length for answer in solved]
        rows = [("workspace", _size_of(problem.environment))]
        rows.append(("tasks", f"{len(solved)} of {len(answers)} solved"))
        if lengths:
            rows.append(("length", f"{sum(lengths) / len(lengths):.6g} on average"))
            near = min(
                range(len(answers)), key=lambda k: answers[k].length if answers[k].solved else math.inf
            )
            where = [round(v, 6) for v in answers[near].task.goal.tolist()]
            rows.append(("nearest", f"goal {near}, {where}: length {answers[near].length:.6g}"))
        rows.append(("samples", str(sum(answer.samples for answer in answers))))
        rows.append(
            ("seconds", f"{loaded:.2f} to load, {total:.2f} to plan, {total / len(answers):.3f} a task")
        )
    _print_rows(problem.name, rows)


def _trajectory(
    space: ConfigurationSpace, answer: Answer, limits: tuple[list[float], list[float]] | None
) -> Any:
    if limits is None or answer.path is None:
        return None
    from guided_gym.trajectories import time_path

    velocity, acceleration = (row[0] if len(row) == 1 else row for row in limits)
    return time_path(space, answer.path, velocity, acceleration)


def _csv(
    space: ConfigurationSpace, answers: Sequence[Answer], limits: tuple[list[float], list[float]] | None
) -> str:
    """Waypoints with headings, or rows of the trajectory with times and velocities."""
    from guided_gym.trajectories import headings

    names = ["x", "y", "theta"][: space.dimension]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    if limits is None:
        writer.writerow(["task", "waypoint", *names, "heading"])
    else:
        writer.writerow(["task", "time", *names, *(f"v_{n}" for n in names), *(f"a_{n}" for n in names)])
    for number, answer in enumerate(answers):
        timed = _trajectory(space, answer, limits)
        if timed is not None:
            columns = (timed.times[:, None], timed.configurations, timed.velocities, timed.accelerations)
            for row in zip(*columns, strict=True):
                writer.writerow([number, *(repr(v) for part in row for v in part.tolist())])
        elif answer.path is not None:
            travel = headings(space, answer.path).tolist()
            for k, (q, angle) in enumerate(zip(answer.path.tolist(), travel, strict=True)):
                writer.writerow([number, k, *map(repr, q), repr(angle)])
    return out.getvalue()


def _write_json(
    target: Path,
    source: Path,
    space: ConfigurationSpace,
    answers: Sequence[Answer],
    limits: tuple[list[float], list[float]] | None,
) -> None:
    plans = []
    for answer in answers:
        row = answer.row(space)
        timed = _trajectory(space, answer, limits)
        if timed is not None:
            row["trajectory"] = {
                "duration": timed.duration,
                "stops": timed.stops,
                "times": timed.times.tolist(),
                "configurations": timed.configurations.tolist(),
                "velocities": timed.velocities.tolist(),
                "accelerations": timed.accelerations.tolist(),
            }
        plans.append(row)
    _write(target, json.dumps({"file": source.name, "plans": plans}, indent=1) + "\n")


def _write(target: Path, text: str) -> None:
    from guided_gym.storage.whole_file import write_whole

    write_whole(target, text)


def _draw(figure: Figure, target: Path) -> None:
    from guided_gym.train.style import save

    save(figure, target, (target.suffix.lower()[1:],))
