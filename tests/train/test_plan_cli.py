"""``guided-gym plan``, ``check`` and ``convert``: what they print and write, and how they refuse."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from guided_gym.catalogue.files import load_environment, load_problem, load_problems
from guided_gym.catalogue.inspection import narrow_gaps, nearest_free_pose, robot_widths
from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.guidance.composed import Composed
from guided_gym.guidance.solvers import roadmap, skeleton
from guided_gym.guidance.solvers.wave import Wave
from guided_gym.problems import Problem, Task
from guided_gym.storage.preparations import PreparationStore
from guided_gym.train.cli import app
from guided_gym.train.plan_cli import parse_pose, parse_robot
from guided_gym.train.plans import Planner, read_tasks

GALLERY = Path(__file__).resolve().parents[2] / "examples" / "gallery"


def _run(*words: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


def test_plan__writes_a_certified_path(tmp_path: Path) -> None:
    file = GALLERY / "floor_plan.toml"
    out = {name: tmp_path / f"it.{name}" for name in ("svg", "json", "csv")}
    code, text = _run(
        "plan", file, "--smooth", 50, "--svg", out["svg"], "--json", out["json"], "--csv", out["csv"]
    )
    assert code == 0
    assert "clearance" in text
    problem = load_problem(file)
    (plan,) = json.loads(out["json"].read_text())["plans"]
    path = np.array(plan["waypoints"])
    np.testing.assert_array_equal(path[[0, -1]], [problem.task.start, problem.task.goal])
    assert problem.space.motions_free(path[:-1], path[1:]).all()
    assert plan["length"] == pytest.approx(problem.space.distance(path[:-1], path[1:]).sum())
    assert 0 <= plan["clearance"] <= float(np.asarray(problem.space.clearance(path)).min()) + 1e-12
    rows = list(csv.DictReader(out["csv"].read_text().splitlines()))
    np.testing.assert_array_equal([[float(row[k]) for k in ("x", "y", "theta")] for row in rows], path)
    assert out["svg"].read_text().startswith("<?xml")


def test_plan__is_the_same_again(tmp_path: Path) -> None:
    texts = []
    for name in ("a.csv", "b.csv"):
        _run("plan", GALLERY / "warehouse.json", "--smooth", 20, "--seed", 3, "--csv", tmp_path / name)
        texts.append((tmp_path / name).read_text())
    assert texts[0] == texts[1]


def test_plan__without_a_path_says_so() -> None:
    wide = ("--robot", "rectangle:1.9,1.0", "--start", "3,6.2,0", "--goal", "7.5,6,0")
    code, text = _run("plan", GALLERY / "floor_plan.toml", *wide, "--max-samples", 30)
    assert code == 1
    assert "none found" in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--start", "1,1,90"), "degrees"),
        (("--start", "1,nan,0"), "expected X,Y"),
        (("--start", "0,0,0"), "is free"),
        (("--robot", "tank:3"), "robot: expected"),
        (("--guidance", "nonsense"), "unknown guidance"),
        (("--svg", "it.txt"), "picture"),
        (("--velocity", "1"), "both or none"),
        (("--smooth", "-1"), "smooth"),
        (("--tasks", "missing.csv"), "cannot read"),
    ],
)
def test_plan__refuses_in_one_line(
    words: tuple[str, ...], message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    result = CliRunner().invoke(app, ["plan", str(GALLERY / "floor_plan.toml"), *words])
    said = result.output + capfd.readouterr().err
    assert result.exit_code == 2
    assert message in said
    assert "Traceback" not in said


def test_check__names_what_is_wrong_and_the_narrow_gaps(tmp_path: Path) -> None:
    file = tmp_path / "trap.toml"
    make_distribution("Trap").problem(0).save(file)
    code, text = _run("check", file, "--svg", tmp_path / "it.png")
    assert code == 0
    assert "0.2 at" in text
    assert "too narrow for the robot, which is 0.3 wide" in text
    assert (tmp_path / "it.png").stat().st_size > 1000
    code, text = _run("check", file, "--start", "5,3,0")
    assert code == 1
    assert "WRONG" in text
    assert "obstacle" in text
    assert "is free" in text


def test_check__says_that_there_is_no_path(tmp_path: Path) -> None:
    import shapely

    wall = shapely.box(4.0, 0.0, 4.5, 5.0)
    problem = Problem(Robot.point(), Environment((0, 0, 9, 5), (wall,)), Task((1, 1), (8, 1)))
    problem.save(tmp_path / "it.toml")
    code, text = _run("check", tmp_path / "it.toml")
    assert code == 1
    assert "no path" in text


ERRANDS = """format = "guided-gym problem 1"
name = "errands"
bounds = [0, 0, 9, 5]
start = [1, 1]
goals = [[8, 1], [8, 4], [1, 4]]

[robot]
kind = "point"

[[obstacles]]
box = [4, 0, 5, 4]
"""


def test_goals__are_planned_checked_and_kept(tmp_path: Path) -> None:
    file = tmp_path / "it.toml"
    file.write_text(ERRANDS)
    code, said = _run("plan", file, "--json", tmp_path / "it.json", "--svg", tmp_path / "it.svg")
    assert code == 0 and "3 of 3 solved" in said and "goal 2, [1.0, 4.0]: length 3" in said
    rows = json.loads((tmp_path / "it.json").read_text())["plans"]
    assert [row["goal"] for row in rows] == [[8, 1], [8, 4], [1, 4]]
    code, said = _run("plan", file, "--goal", "8,2")
    assert code == 0 and "waypoints" in said
    code, said = _run("check", file, "--svg", tmp_path / "check.svg")
    assert code == 0 and said.count("path to goals") == 3
    code, _ = _run("convert", file, tmp_path / "again.json")
    assert code == 0
    assert [one.fingerprint for one in load_problems(tmp_path / "again.json")] == [
        one.fingerprint for one in load_problems(file)
    ]


def test_convert__from_each_kind_to_a_problem_and_back(tmp_path: Path) -> None:
    where = ("--robot", "rectangle:2,1", "--start", "3,45,0", "--goal", "73,44,0")
    code, _ = _run("convert", GALLERY / "city_block.geojson", tmp_path / "city.json", *where)
    assert code == 0
    problem = load_problem(tmp_path / "city.json")
    assert problem.robot == Robot.rectangle(2, 1)
    code, _ = _run("convert", tmp_path / "city.json", tmp_path / "city.geojson")
    assert code == 0
    _run("convert", tmp_path / "city.geojson", tmp_path / "again.toml", *where)
    assert load_problem(tmp_path / "again.toml").fingerprint == problem.fingerprint
    code, _ = _run("convert", tmp_path / "city.json", tmp_path / "city.png")
    assert code == 0
    code, _ = _run("convert", GALLERY / "floor_plan.toml", tmp_path / "flat.json")
    before, after = load_problem(GALLERY / "floor_plan.toml"), load_problem(tmp_path / "flat.json")
    assert before.fingerprint == after.fingerprint
    assert list(before.regions) == list(after.regions)


def test_convert__to_a_ros_map_and_back(tmp_path: Path) -> None:
    pytest.importorskip("yaml", reason="the extra [maps] is not installed")
    code, _ = _run("convert", GALLERY / "office.yaml", tmp_path / "office.yaml")
    assert code == 0
    code, _ = _run("convert", tmp_path / "office.yaml", tmp_path / "again.yaml")
    assert code == 0
    assert (tmp_path / "office.pgm").read_bytes() == (tmp_path / "again.pgm").read_bytes()
    assert load_environment(tmp_path / "office.yaml") == load_environment(GALLERY / "office.yaml")
    code, text = _run("convert", GALLERY / "floor_plan.toml", tmp_path / "flat.yaml")
    assert code == 2 and "resolution" in text
    code, _ = _run("convert", GALLERY / "floor_plan.toml", tmp_path / "flat.yaml", "--resolution", "0.05")
    assert code == 0
    flat, walls = load_environment(tmp_path / "flat.yaml"), load_environment(GALLERY / "floor_plan.toml")
    assert walls.obstacle_union.difference(flat.obstacle_union).area < 1e-9
    before = (tmp_path / "flat.pgm").read_bytes()
    code, text = _run("convert", tmp_path / "flat.pgm", tmp_path / "flat.yaml", "--resolution", "0.05")
    assert code == 2 and "another name" in text
    assert (tmp_path / "flat.pgm").read_bytes() == before


def test_planner__tasks_share_what_was_prepared(tmp_path: Path) -> None:
    problem = make_distribution("RandomClutter").problem(1)
    space = problem.space
    rng = np.random.default_rng(0)
    poses = space.sample(rng, 400)
    poses = poses[np.asarray(space.valid(poses))][:12]
    lines = [
        ",".join(map(repr, (*a.tolist(), *b.tolist()))) for a, b in zip(poses[:6], poses[6:], strict=True)
    ]
    (tmp_path / "tasks.csv").write_text("x,y,t,x,y,t\n" + "\n".join(lines) + "\n\n")
    tasks = read_tasks(tmp_path / "tasks.csv", problem)
    assert len(tasks) == 6
    planner = Planner(problem)
    for task in tasks:
        shared, alone = planner.plan(task, seed=1), Planner(problem).plan(task, seed=1)
        assert shared.samples == alone.samples
        if shared.path is not None and alone.path is not None:
            np.testing.assert_array_equal(shared.path, alone.path)
    (tmp_path / "tasks.csv").write_text(lines[0] + "\n1,2,3\n")
    with pytest.raises(InvalidInputError, match=r"line 2: expected 6 finite numbers"):
        read_tasks(tmp_path / "tasks.csv", problem)


@pytest.mark.parametrize(
    "guidance", ["auto", "wavefront", "medial_axis", "roadmap(robot=point,vertices=300)"]
)
def test_planner__finds_what_it_prepared_on_the_disk(guidance: str, tmp_path: Path) -> None:
    """A second process reads what the first one prepared, and plans the same; damage changes nothing."""
    store = PreparationStore(tmp_path)
    first = Planner(Problem.load(GALLERY / "floor_plan.toml"), guidance, store=PreparationStore(None)).plan()

    def again() -> NDArray[np.float64]:
        skeleton._axis.cache_clear()
        skeleton.medial_axis.cache_clear()
        roadmap._net.cache_clear()
        path = Planner(Problem.load(GALLERY / "floor_plan.toml"), guidance, store=store).plan().path
        assert path is not None
        return path

    assert first.path is not None
    np.testing.assert_array_equal(again(), first.path)
    files = sorted(tmp_path.iterdir())
    assert files
    times = [file.stat().st_ino for file in files]
    np.testing.assert_array_equal(again(), first.path)
    assert [file.stat().st_ino for file in files] == times  # read, not written again
    for file in files:
        file.write_bytes(file.read_bytes()[:-1])
    np.testing.assert_array_equal(again(), first.path)


def test_planner__takes_headings_into_account_only_where_the_disc_sees_no_way() -> None:
    """A corridor as wide as the robot is, but not as the circle in which it turns."""
    robot, task = Robot.rectangle(1.0, 0.3), Task((1.0, 2.0, 0.0), (9.0, 2.0, 0.0))
    for width, way in ((0.6, False), (1.6, True)):
        walls = [[(4, 0), (6, 0), (6, 2 - width / 2), (4, 2 - width / 2)]]
        walls.append([(4, 4), (6, 4), (6, 2 + width / 2), (4, 2 + width / 2)])
        room = Environment.from_polygons((0, 0, 10, 4), walls)
        planner = Planner(Problem(robot, room, task, "corridor"), store=PreparationStore(None))
        path, samples, _, _ = planner._search(planner.problem, 0)
        assert path is not None and samples >= 0
        disc = planner.guides[0]
        assert isinstance(disc, Composed) and isinstance(disc.solver, Wave)
        assert disc.solver.sees_way == way


def test_planner__goes_on_and_only_gets_shorter() -> None:
    problem = make_distribution("TrapCup").problem(0)
    planner = Planner(problem, smoothing=30)
    first = planner.plan(seed=0)
    answer = planner.plan(seed=0, seconds=1.0)
    assert answer.searches > 1
    assert answer.length <= first.length + 1e-9
    assert (np.diff(answer.history[:, 2]) < 0).all()
    assert (np.diff(answer.history[:, 0]) > 0).all()
    assert answer.history[-1, 2] == pytest.approx(answer.length)
    assert answer.path is not None
    assert problem.space.motions_free(answer.path[:-1], answer.path[1:]).all()


def test_options__of_robots_and_poses() -> None:
    assert parse_robot("rectangle:1,0.5") == Robot.rectangle(1, 0.5)
    assert parse_robot("segment:2") == Robot.segment(2)
    assert parse_robot("point") == Robot.point()
    assert parse_robot("polygon:0,0;1,0;0,1") == Robot.polygon([(0, 0), (1, 0), (0, 1)])
    assert parse_pose("start", "1,2,-.5") == [1.0, 2.0, -0.5]
    for bad in ("rectangle:1", "point:1", "polygon:0,0", "rectangle:-1,2", ""):
        with pytest.raises(InvalidInputError, match="robot"):
            parse_robot(bad)


def test_robot_widths__by_hand() -> None:
    assert robot_widths(Robot.rectangle(0.8, 0.3)) == pytest.approx((0.3, np.hypot(0.8, 0.3)))
    assert robot_widths(Robot.point()) == (0.0, 0.0)
    assert robot_widths(Robot.segment(2.0)) == (0.0, 2.0)
    triangle = Robot.polygon([(-0.5, -(3**0.5) / 6), (0.5, -(3**0.5) / 6), (0, 3**0.5 / 3)])
    assert robot_widths(triangle)[0] == pytest.approx(3**0.5 / 2)  # the height of an equilateral triangle


def test_narrow_gaps__of_the_trap_are_its_two_passages() -> None:
    problem = make_distribution("Trap").problem(0)
    gaps = narrow_gaps(problem.environment, Robot.rectangle(1.2, 0.3))
    assert [round(gap.width, 9) for gap in gaps] == [0.2, 1.4]
    assert not gaps[0].passable
    assert gaps[1].passable


def test_nearest_free_pose__is_free_and_near() -> None:
    problem = make_distribution("Cup").problem(0)
    q = np.array([6.8, 5.0, 0.0])
    near = nearest_free_pose(problem.space, q)
    assert near is not None
    assert problem.space.valid(near)
    assert problem.space.distance(near, q) < 0.75  # 0.6 to the right it is free
