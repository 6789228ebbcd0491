"""Problem files: the same problem comes back, and what is wrong is named by file, line and field."""

from __future__ import annotations

import re
import time
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.catalogue.files import (
    load_environment,
    load_problem,
    load_problems,
    read_problem_file,
    save_problem,
)
from guided_gym.catalogue.table import distribution_names, make_distribution
from guided_gym.errors import GuidedGymError, InvalidInputError, StorageError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.problems import Problem, Task

GALLERY = Path(__file__).resolve().parents[3] / "examples" / "gallery"
SUFFIXES = ("toml", "json")


def _same(one: Problem, other: Problem) -> None:
    assert one.fingerprint == other.fingerprint
    assert (one.name, one.rotation_weight, one.robot.name) == (
        other.name,
        other.rotation_weight,
        other.robot.name,
    )
    assert one.task.start.tobytes() == other.task.start.tobytes()
    assert one.task.goal.tobytes() == other.task.goal.tobytes()
    assert (one.task.tolerance, one.task.by_edge) == (other.task.tolerance, other.task.by_edge)
    assert list(one.regions) == list(other.regions)
    for name in one.regions:
        assert shapely.to_wkb(one.regions[name]) == shapely.to_wkb(other.regions[name])


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("name", distribution_names())
def test_round_trip__of_the_catalogue(name: str, suffix: str, tmp_path: Path) -> None:
    problem = make_distribution(name).problem(3)
    problem.save(tmp_path / f"it.{suffix}")
    _same(problem, Problem.load(tmp_path / f"it.{suffix}"))


ROBOTS = (
    Robot.point(),
    Robot.segment(0.3),
    Robot.rectangle(1 / 3, 0.1),
    Robot.polygon([(-0.2, -0.1), (0.3, -0.1), (0.1, 0.2)], name="wedge"),
    Robot(shapely.LineString([(0, 0), (0.3, 0), (0.3, 0.2)]), name="hook"),
    Robot(shapely.Point(0.1, 0.2), 2),
    Robot(shapely.box(0, 0, 0.3, 0.1), 2, "box\x7f \"quoted\" 'é' \\"),
)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("robot", ROBOTS, ids=lambda robot: robot.name[:8])
def test_round_trip__of_each_robot(robot: Robot, suffix: str, tmp_path: Path) -> None:
    q = (1.0, 1.0, 0.1)[: robot.dimension], (4.0, 1.0, -0.0)[: robot.dimension]
    ring = shapely.box(2, 2, 4, 4).difference(shapely.box(2.5, 2.5, 3, 3))
    problem = Problem(
        robot,
        Environment((0, 0, 5, 5), (ring,)),
        Task(*q, 0.25, False),
        "line\nbreak",
        {'a.b "c"': shapely.Point(1, 1).buffer(0.3), "": shapely.LineString([(0, 0), (1, 1)])},
        0.1 + 0.2,
    )
    save_problem(problem, tmp_path / f"it.{suffix}", length="ft", origin=(1e6, -2.5))
    _same(problem, load_problem(tmp_path / f"it.{suffix}"))
    model = read_problem_file(tmp_path / f"it.{suffix}")
    assert (model.units.length, model.origin) == ("ft", [1e6, -2.5])


coordinate = st.floats(-1e6, 1e6, allow_nan=False)


@given(st.lists(st.tuples(coordinate, coordinate), min_size=3, max_size=3), coordinate, coordinate)
@settings(max_examples=60, deadline=None)
def test_round_trip__of_any_float(
    tmp_path_factory: pytest.TempPathFactory, corners: list[tuple[float, float]], x: float, y: float
) -> None:
    """shapely's own text would change three coordinates in a hundred."""
    triangle = shapely.Polygon(corners)
    if not triangle.is_valid or triangle.area < 1.0:
        return
    bounds = (-2e6, -2e6, 2e6, 2e6)
    problem = Problem(Robot.point(), Environment(bounds, (triangle,)), Task((1.5e6, x), (1.6e6, y)))
    folder = tmp_path_factory.mktemp("files")
    for suffix in SUFFIXES:
        problem.save(folder / f"it.{suffix}")
        _same(problem, load_problem(folder / f"it.{suffix}"))


TEXT = """format = "guided-gym problem 1"
bounds = [0, 0, 10, 10]
start = [1.0, 5.0, 0.0]
goal = [9.0, 5.0, 0.0]

[robot]
kind = "rectangle"
length = 0.8
width = 0.3

[[obstacles]]
name = "column"
polygon = [[4, 4], [6, 4],
  [6, 6], [4, 6]]

[[obstacles]]
wkt = "POLYGON ((2 8, 3 8, 3 9, 2 8))"

[[obstacles]]
type = "Polygon"
coordinates = [[[7, 1], [8, 1], [8, 2], [7, 1]]]

[[obstacles]]
box = [1, 1, 2, 2]
"""


def test_forms__of_obstacles_are_the_same_shapes(tmp_path: Path) -> None:
    (tmp_path / "it.toml").write_text(TEXT)
    problem = Problem.load(tmp_path / "it.toml")
    assert [one.area for one in problem.environment.obstacles] == [4.0, 0.5, 0.5, 1.0]
    assert problem.robot == Robot.rectangle(0.8, 0.3)
    assert problem.name == "problem"


def test_angles__in_degrees_where_the_file_says_so(tmp_path: Path) -> None:
    text = TEXT.replace("[robot]", "[units]\nangle = 'deg'\n[robot]").replace("5.0, 0.0]", "5.0, 90.0]")
    (tmp_path / "it.toml").write_text(text)
    assert Problem.load(tmp_path / "it.toml").task.start[2] == np.pi / 2


WRONG = [
    ("start = [1.0, 5.0, 0.0]", "start = [1.0, 5.0, 90.0]", r"line 3: start: .*90.*degrees"),
    ("start = [1.0, 5.0, 0.0]", "start = [1.0, nan, 0.0]", r"line 3: start\[1\]: expected a finite number"),
    ("start = [1.0, 5.0, 0.0]", "start = [1.0, 5.0]", r"line 3: start: expected 3 numbers"),
    ("start = [1.0, 5.0, 0.0]", "start = true", r"line 3: start: .*got True"),
    ("start = [1.0, 5.0, 0.0]", "start = [5.0, 5.0, 0.0]", r"line 3: start: .*'column'.* is free"),
    ("goal = [9.0, 5.0, 0.0]", "goal = [9.9, 5.0, 0.0]", r"line 4: goal: .*the bounds.* is free"),
    ("start =", "stat =", r"line 3: stat: unknown field; did you mean 'start'"),
    ("bounds = [0, 0, 10, 10]\n", "", r"expected bounds, a map or a room"),
    ("bounds = [0, 0, 10, 10]", "bounds = [20, 20, 30, 30]", r"line 11: obstacles\[0\].*meets the bounds"),
    (
        "bounds = [0, 0, 10, 10]",
        "bounds = [10, 0, 0, 10]",
        r"line 2: bounds: expected \(xmin, ymin, xmax, ymax\)",
    ),
    ("bounds = [0, 0, 10, 10]", "bounds = [0, 0, 1e300, 10]", r"line 2: bounds\[2\]"),
    ("length = 0.8", 'length = "0.8"', r"line 8: robot.length"),
    ("length = 0.8", "length = -1", r"line 8: robot.length: expected greater than 0"),
    ("length = 0.8\n", "", r"line 6: robot: .*needs length"),
    ('kind = "rectangle"', 'kind = "tank"', r"line 7: robot.kind"),
    ("  [6, 6], [4, 6]]", "  [6, 6], [4, '6']]", r"line 14: obstacles\[0\].polygon\[3\]\[1\]"),
    ("  [6, 6], [4, 6]]", "  [4, 6], [6, 6]]", r"line 11: obstacles\[0\] \('column'\).*Self-intersection"),
    ("POLYGON ((2 8, 3 8, 3 9, 2 8))", "POLYGON ((2 8", r"line 16: obstacles\[1\]: wkt"),
    ("POLYGON ((2 8, 3 8, 3 9, 2 8))", "POINT (2 8)", r"line 16: obstacles\[1\].*Point"),
    ("POLYGON ((2 8, 3 8, 3 9, 2 8))", "GEOMETRYCOLLECTION (" * 5000, r"nested"),
    ('type = "Polygon"', 'type = "Cube"', r"line 19: obstacles\[2\].*Cube"),
    (
        "box = [1, 1, 2, 2]",
        "box = [1, 1, 2, 2]\nwkt = 'POINT (1 1)'",
        r"line 23: obstacles\[3\].*box and wkt",
    ),
    ("guided-gym problem 1", "guided-gym problem 9", r"format: expected"),
    ("length = 0.8", "length = 0.8\nlength = 0.9", r"line 9: expected TOML"),
    ("start = [1.0", "start = [1" + "0" * 5000, r"integer of thousands of digits"),
    ("start = [1.0", "start = [1" + "0" * 2000, r"line 3: start\[0\]"),
    ("start = [1.0, 5.0, 0.0]", "start = " + "[" * 100_000, r"line 3: expected lists nested at most"),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG, ids=[str(i) for i in range(len(WRONG))])
def test_errors__name_file_line_and_field(old: str, new: str, message: str, tmp_path: Path) -> None:
    assert old in TEXT
    (tmp_path / "it.toml").write_text(TEXT.replace(old, new, 1))
    began = time.perf_counter()
    with pytest.raises(GuidedGymError, match=message) as caught:
        Problem.load(tmp_path / "it.toml")
    assert time.perf_counter() - began < 10.0
    assert str(caught.value).startswith(str(tmp_path / "it.toml"))
    assert len(str(caught.value)) < 1000
    assert "\n" not in str(caught.value)


ARM = """
[robot]
kind = "linkage"
tool = [0.0, 0.0]
[[robot.joints]]
offset = [5.0, 5.0]
[[robot.bodies]]
joint = 0
[robot.bodies.outline]
type = "LineString"
coordinates = [[0.0, 0.0], [1.0, 0.0]]
"""
ROBOTS = [
    ("offset = [5.0, 5.0]", "ofset = [5.0, 5.0]", r"line 9: robot.joints\[0\].ofset: .*'offset'.*parent"),
    ("offset = [5.0, 5.0]", "limits = [1.0, 0.0]", r"line 8: robot.joints\[0\]: .*limits low < high"),
    ("joint = 0", "joint = 1", r"line 5: robot: a body's joint: expected 0 to 0, got 1"),
    ("LineString", "Line", r"line 12: robot.bodies\[0\].outline: type: expected one of"),
    ("LineString", "MultiLineString", r"line 12: robot.bodies\[0\].outline: coordinates"),
    ("tool = [0.0, 0.0]", "tool = [0.0]", r"line 7: robot.tool: expected at least 2 items, got"),
    ("[robot]", '[map]\nfile = "../it.png"\n[robot]', r"line 6: map.file: expected a file in .* or below"),
    ("[robot]", '[map]\nfile = "no.png"\n[robot]', r"map.file: .*no such file"),
]


@pytest.mark.parametrize(("old", "new", "message"), ROBOTS, ids=[str(i) for i in range(len(ROBOTS))])
def test_errors__of_robots_and_maps_name_the_field(old: str, new: str, message: str, tmp_path: Path) -> None:
    text = f'format = "guided-gym problem 1"\nstart = [0.0]\ngoal = [1.0]\nbounds = [0, 0, 10, 10]{ARM}'
    assert text.count(old) == 1
    file = tmp_path / "it.toml"
    file.write_text(text.replace(old, new))
    with pytest.raises(GuidedGymError, match=message):
        Problem.load(file)


GOALS = [
    ("[[9.0, 5.0, 0.0], [9.0, 1.0, 0.0]]", None),
    ("[[9.0, 5.0, 0.0], [5.0, 5.0, 0.0]]", r"line 4: goals\[1\]: .*'column'.* is free"),
    ("[[9.0, 5.0, 0.0], [9.0, 1.0, 90.0]]", r"line 4: goals\[1\]: .*degrees"),
    ("[[9.0, 5.0, 0.0], [9.0, 1.0]]", r"line 4: goals\[1\]: expected 3 numbers"),
    ("[[9.0, 5.0, 0.0], 7]", r"line 4: goals\[1\]"),
    ("[]", r"line 4: goals: "),
    ("[[9.0, 5.0, 0.0]]\ngoal = [9.0, 5.0, 0.0]", r"line 4: goals: expected goal or goals, got both"),
]


@pytest.mark.parametrize(("goals", "message"), GOALS, ids=[goals for goals, _ in GOALS])
def test_goals__are_a_task_each(goals: str, message: str | None, tmp_path: Path) -> None:
    file = tmp_path / "it.toml"
    file.write_text(TEXT.replace("goal = [9.0, 5.0, 0.0]", f"goals = {goals}"))
    if message is not None:
        with pytest.raises(InvalidInputError, match=message):
            load_problems(file)
        return
    first, second = load_problems(file)
    assert (first.task.goal[1], second.task.goal[1]) == (5.0, 1.0)
    assert first.space is second.space and first.task.start.tolist() == second.task.start.tolist()
    assert first.fingerprint != second.fingerprint and first.name != second.name
    distribution = make_distribution(str(file))
    assert not distribution.fixed
    assert [distribution.problem(k).fingerprint for k in (0, 1, 2)] == [
        one.fingerprint for one in (first, second, first)
    ]
    with pytest.raises(InvalidInputError, match="expected one goal"):
        Problem.load(file)
    env = gym.make("guided_gym/ProblemFile-v0", path=file, max_nodes=16)
    env.reset(seed=1)
    assert env.unwrapped.problem.task.goal[1] == 1.0  # type: ignore[attr-defined]


def test_goals__of_degrees_and_of_one(tmp_path: Path) -> None:
    file = tmp_path / "it.toml"
    text = TEXT.replace("goal = [9.0, 5.0, 0.0]", "goals = [[9.0, 5.0, 90.0]]")
    file.write_text(text.replace("[robot]", '[units]\nangle = "deg"\n\n[robot]', 1))
    assert Problem.load(file).task.goal[2] == pytest.approx(np.pi / 2)
    assert make_distribution(str(file)).fixed


WRONG_JSON = [
    ('"bounds"', '"name": "x", "name": "y", "bounds"', r"line \d+: expected each key once, got 'name'"),
    ("[1.5,", "[NaN,", r"line 5: expected finite numbers, got NaN"),
    ("[1.5,", "[-Infinity,", r"line 5: expected finite numbers, got -Infinity"),
    ("[1.5,", "[null,", r"line 5: start\[0\]"),
    ("[1.5,", "[" * 100_000, r"nested at most"),
    ("[7.0, 3.0], [7.0, 7.0]", "[7.0, 3.0], [7.0, {}]", r"line 11: obstacles\[2\].polygon\[1\]\[1\]"),
    ("}\n", "", r"expected JSON"),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG_JSON, ids=[m for *_, m in WRONG_JSON])
def test_errors__in_json(old: str, new: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "it.json"
    make_distribution("Cup").problem(0).save(file)
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(GuidedGymError, match=message):
        Problem.load(file)


def test_errors__of_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="cannot read"):
        Problem.load(tmp_path / "missing.toml")
    with pytest.raises(InvalidInputError, match="expected a problem file"):
        Problem.load(tmp_path / "it.txt")
    with pytest.raises(StorageError, match="cannot read"):
        Problem.load("nul\0.toml")
    (tmp_path / "it.toml").write_bytes(b"\xff\xfe" + TEXT.encode("utf-16-le"))
    with pytest.raises(StorageError, match="UTF-8"):
        Problem.load(tmp_path / "it.toml")
    (tmp_path / "big.toml").write_bytes(b"#" * (2**24 + 1))
    with pytest.raises(StorageError, match="at most"):
        Problem.load(tmp_path / "big.toml")
    (tmp_path / "long.toml").write_text("name = 1" + 10_000 * "0")
    with pytest.raises(StorageError, match="integer of thousands of digits"):
        Problem.load(tmp_path / "long.toml")
    (tmp_path / "[1].toml").write_text("[")
    with pytest.raises(StorageError, match=re.escape("[1].toml")):
        Problem.load(tmp_path / "[1].toml")


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_fuzz__damaged_files_give_one_of_our_errors(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Cut, overwritten and doubled: a problem or one of our errors comes of it, and nothing else."""
    suffix = data.draw(st.sampled_from(SUFFIXES))
    file = tmp_path_factory.getbasetemp() / f"fuzz.{suffix}"
    make_distribution("Trap").problem(0).save(file)
    content = bytearray(file.read_bytes())
    for _ in range(data.draw(st.integers(1, 3))):
        first = data.draw(st.integers(0, len(content)))
        last = min(len(content), first + data.draw(st.integers(0, 30)))
        tokens = [
            b"",
            b"nan",
            b"-",
            b"[",
            b"]]",
            b"{",
            b'"',
            b"1e999",
            b"\x00",
            b"\xff",
            b"=",
            b"#",
            b"true",
            b"\n",
        ]
        piece = data.draw(st.sampled_from(tokens) | st.binary(max_size=6))
        content[first:last] = piece + (bytes(content[first:last]) if data.draw(st.booleans()) else b"")
    file.write_bytes(bytes(content))
    try:
        Problem.load(file)
    except GuidedGymError as error:
        assert str(file) in str(error)


def test_make_distribution__takes_a_file_and_sees_that_it_changed(tmp_path: Path) -> None:
    file = tmp_path / "it.toml"
    file.write_text(TEXT)
    assert make_distribution(str(file)).problem(0).fingerprint == Problem.load(file).fingerprint
    assert make_distribution(str(file)).fixed
    file.write_text(TEXT.replace("9.0, 5.0", "9.0, 5.25"))
    assert make_distribution(str(file)).problem(0).task.goal[1] == 5.25
    with pytest.raises(StorageError, match="cannot read"):
        make_distribution(str(tmp_path / "missing.toml"))
    with pytest.raises(InvalidInputError, match="convert"):
        make_distribution(str(GALLERY / "office.yaml"))


def test_gym_make__takes_a_file() -> None:
    env = gym.make("guided_gym/ProblemFile-v0", path=GALLERY / "floor_plan.toml", max_nodes=64)
    observation, _ = env.reset(seed=0)
    assert env.unwrapped.problem.name == "FloorPlan"  # type: ignore[attr-defined]
    env.step(int(np.flatnonzero(observation["action_mask"])[0]))
    env = gym.make("guided_gym/Trap-v0", distribution=str(GALLERY / "floor_plan.toml"))
    env.reset(seed=0)


@pytest.mark.parametrize("name", ["floor_plan.toml", "office.toml", "warehouse.json"])
def test_gallery__loads(name: str) -> None:
    pytest.importorskip("yaml")
    problem = load_problem(GALLERY / name)
    assert not problem.begins_solved
    assert load_environment(GALLERY / name).obstacles == problem.environment.obstacles


def test_map__outside_the_folder_is_refused(tmp_path: Path) -> None:
    text = TEXT.replace("[robot]", '[map]\nfile = "../office.yaml"\n[robot]', 1)
    (tmp_path / "it.toml").write_text(text)
    with pytest.raises(InvalidInputError, match=r"or below"):
        Problem.load(tmp_path / "it.toml")


def test_asking__another_task_in_the_same_space() -> None:
    problem = make_distribution("Cup").problem(0)
    other = problem.asking(Task((1.0, 1.0, 7.0), (9.0, 9.0, 0.0)))
    assert other.space is problem.space
    assert other.fingerprint != problem.fingerprint
    assert other.task.start[2] == pytest.approx(7.0 - 2 * np.pi)
    with pytest.raises(InvalidInputError, match="collision"):
        problem.asking(Task((6.8, 5.0, 0.0), (9.0, 9.0, 0.0)))
