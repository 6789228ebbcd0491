"""Arms in space: environments, pictures, problem files, traces and what a browser draws of them."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import shapely
from gymnasium.utils.env_checker import check_env

from guided_gym import (
    GuidedSearchEnv,
    InvalidInputError,
    OracleOptions,
    Problem,
    SpatialArm,
    guided_search,
    make_distribution,
    node_table,
)
from guided_gym.catalogue.files import load_problem, save_problem
from guided_gym.display import scene
from guided_gym.display.svg import problem_picture
from guided_gym.envs import palette
from guided_gym.envs.observations import columns_of, node_columns
from guided_gym.traces.reading import read_trace

QUICK = OracleOptions(resolution=(300,))
EASY = "roadmap(robot=inner, vertices=300)"


@pytest.fixture(scope="module")
def problem() -> Problem:
    """The one that comes with the package."""
    return make_distribution("SpatialArm").problem(0)


def test_gymnasium_takes_it() -> None:
    env = gymnasium.make("guided_gym/SpatialArm-v0", max_nodes=16, oracle=QUICK)
    check_env(env.unwrapped, skip_render_check=True)


def test_stable_baselines_takes_it() -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(gymnasium.make("guided_gym/SpatialArm-v0", max_nodes=16, oracle=QUICK).unwrapped)


def test_columns_are_those_of_seven_angles(problem: Problem) -> None:
    env = GuidedSearchEnv(problem, max_nodes=8, oracle=QUICK)
    observation, _ = env.reset(seed=0)
    names = node_columns(7)
    root = dict(zip(names, node_table(observation, columns_of(7))[0].tolist(), strict=True))
    for k, value in enumerate(problem.task.start, start=1):
        assert root[f"COS_{k}"] == pytest.approx(np.cos(value), abs=1e-6)
        assert root[f"SIN_{k}"] == pytest.approx(np.sin(value), abs=1e-6)
    xmin, ymin, xmax, ymax = problem.environment.bounds
    seen = problem.robot.position(problem.task.start)
    expected = 2 * (seen - [xmin, ymin]) / [xmax - xmin, ymax - ymin] - 1
    np.testing.assert_allclose([root["X"], root["Y"]], expected, atol=1e-6)


def test_frames_show_the_arm(problem: Problem) -> None:
    pytest.importorskip("pygame")
    env = GuidedSearchEnv(problem, max_nodes=16, render_mode="rgb_array", oracle=QUICK)
    env.reset(seed=0)
    before = env.render()
    for _ in range(6):
        env.step(0)
    assert before.ndim == 3 and np.ptp(before) > 100
    assert (env.render() != before).any()
    assert "<path" in problem_picture(problem).text()


def test_random_shelves_are_those_of_their_seed() -> None:
    first, again, other = (
        make_distribution("RandomSpatialArm").sample(np.random.default_rng(k)) for k in (1, 1, 2)
    )
    assert first.fingerprint == again.fingerprint != other.fingerprint
    assert first.space.valid(first.task.start) and not first.begins_solved


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_files_give_the_same_problem(problem: Problem, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"problem{suffix}"
    save_problem(problem, path)
    again = load_problem(path)
    assert again.fingerprint == problem.fingerprint
    assert again.robot == problem.robot and again.environment == problem.environment


def test_files_that_mix_space_and_plane_are_refused(problem: Problem, tmp_path: Path) -> None:
    path = tmp_path / "problem.json"
    save_problem(problem, path)
    content = json.loads(path.read_text())
    for change, what in [
        ({"bounds": [0, 0, 1, 1]}, "room and an arm"),
        ({"units": {"length": "m", "angle": "deg"}}, "units.angle"),
        ({"room": None}, "room"),
        ({"arm": None}, "robot"),
        ({"start": [0.0, 0.0, 9.0, 0.0, 0.0, 0.0, 0.0]}, "joint 'joint3' at 9"),
    ]:
        path.write_text(json.dumps({k: v for k, v in (content | change).items() if v is not None}))
        with pytest.raises(InvalidInputError, match=what):
            load_problem(path)
    content["room"]["solids"][0].pop("sides")
    path.write_text(json.dumps(content))
    with pytest.raises(InvalidInputError, match=r"room.solids\[0\]: a box needs sides"):
        load_problem(path)


def test_traces_replay(problem: Problem, tmp_path: Path) -> None:
    path = tmp_path / "search.jsonl"
    result = guided_search(problem, EASY, seed=0, max_samples=30, measure=False, trace=path)
    again = read_trace(path).replay()
    np.testing.assert_array_equal(again.tree.configurations, result.tree.configurations)


@pytest.mark.skipif(shutil.which("node") is None, reason="Node.js is not installed")
def test_the_browser_draws_bodies_where_they_are(problem: Problem, tmp_path: Path) -> None:
    """The kinematics of view.js, run by Node.js, against the projections in Python."""
    source = (Path(scene.__file__).parent / "web" / "view.js").read_text(encoding="utf-8")
    first, last = source.index("  class SpatialKinematics"), source.index("  const kinematicsOf")
    qs = problem.space.sample(np.random.default_rng(0), 3)
    robot = problem.robot
    program = (
        source[first:last]
        + f"const k = new SpatialKinematics({json.dumps(scene.robot_table(robot))});"
        + f"const out = {json.dumps(qs.tolist())}"
        + ".map((q) => [k.tip(q), k.place(q).map((b) => [...b.points])]);"
        + "console.log(JSON.stringify(out));"
    )
    script = tmp_path / "run.js"
    script.write_text(program, encoding="utf-8")
    said = subprocess.run(["node", script], capture_output=True, text=True, check=True, timeout=60)
    for q, (tip, bodies) in zip(qs, json.loads(said.stdout), strict=True):
        np.testing.assert_allclose(tip, robot.position(q), atol=1e-9)
        for ours, theirs in zip(robot.place(q), bodies, strict=True):
            drawn = shapely.Polygon(np.reshape(theirs, (-1, 2)))
            assert drawn.symmetric_difference(ours).area < 0.05 * ours.area


URDF = """<robot name="two"><link name="base"/><link name="a">{0}</link><link name="b">{0}</link>
<joint name="one" type="revolute"><parent link="base"/><child link="a"/>
<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-2.5" upper="2.5"/></joint>
<joint name="two" type="continuous"><parent link="a"/><child link="b"/>
<origin xyz="0 0 0.4"/><axis xyz="1 0 0"/></joint></robot>"""


def test_a_path_to_a_urdf_file_is_refused_or_taken(tmp_path: Path) -> None:
    pytest.importorskip("yourdfpy")
    with pytest.raises(InvalidInputError, match="got none"):
        gymnasium.make("guided_gym/SpatialArm-v0", urdf=tmp_path / "none.urdf")
    path = tmp_path / "two.urdf"
    shape = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'
    path.write_text(URDF.format(shape))
    env = gymnasium.make("guided_gym/SpatialArm-v0", urdf=path, max_nodes=8, oracle=QUICK)
    assert env.unwrapped.observation_space["start"].shape == (2 + 2 * 2,)
    assert SpatialArm.from_urdf(path).names == ("one", "two")


def test_frames_show_what_is_behind_obstacles() -> None:
    pytest.importorskip("pygame", reason="the extra [render] is not installed")
    env = gymnasium.make("guided_gym/SpatialArm-v0", max_nodes=8, oracle=QUICK, render_mode="rgb_array")
    env.reset(seed=0)
    frame = np.asarray(env.render())
    env.close()
    opaque = (frame == palette.OBSTACLE).all(axis=-1).mean()
    share = 56 / 255  # of the obstacle's colour, once and behind another
    veils = [
        np.subtract(palette.FREE, palette.OBSTACLE) * (1 - share) ** n + palette.OBSTACLE for n in (1, 2)
    ]
    once, twice = (np.abs(frame - veil).max(axis=-1) <= 2 for veil in veils)
    assert opaque < 0.012  # outlines
    assert once.mean() > 0.015
    assert twice.mean() > 0.015
