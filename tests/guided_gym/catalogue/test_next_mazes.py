"""The NEXT benchmark's files: read as they are meant, refused when they are something else."""

from __future__ import annotations

import io
import math
import os
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest

from guided_gym import guided_search
from guided_gym.catalogue.grids import carved
from guided_gym.catalogue.next_mazes import ENVIRONMENT_VARIABLE, NextMazes, load_next_mazes, next_mazes
from guided_gym.catalogue.splits import in_split
from guided_gym.catalogue.table import make_distribution, named_distribution
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.options import SearchOptions

FOLDER = os.environ.get(ENVIRONMENT_VARIABLE, "")
needs_data = pytest.mark.skipif(not FOLDER, reason=f"{ENVIRONMENT_VARIABLE} is not set")
SIDE = 2 / 15


def arrays(n=4, dimension=2, dtype=np.uint8):
    """Mazes of our own in the benchmark's format; starts and goals in the middle of free cells."""
    maps, starts, goals = [], [], []
    for k in range(n):
        rng = np.random.default_rng(k)
        walls = carved(rng, 7, 7, 0.5)
        if dimension == 3:  # room for the stick
            walls[2:5] = walls[10:13] = False
            walls[:, [0, -1]] = True
            walls = walls & ~np.pad(np.ones((3, 3), bool), ((2, 10), (2, 10)))
        cells = np.argwhere(~walls) if dimension == 2 else np.array([[3, 3], [11, 11]])
        places = (cells[[0, -1]] + 0.5) * SIDE - 1
        if dimension == 3:
            places = np.column_stack((places, [-0.4, 0.1]))
        maps.append(walls)
        starts.append(places[0])
        goals.append(places[1])
    return {
        "maps": np.array(maps).astype(dtype),
        "init_states": np.array(starts),
        "goal_states": np.array(goals),
    }


def saved(tmp_path, **content):
    np.savez_compressed(tmp_path / "mazes.npz", **content)
    return tmp_path / "mazes.npz"


@pytest.mark.parametrize("dtype", [np.uint8, np.float64, np.bool_])
@pytest.mark.parametrize(("dimension", "robot"), [(2, "point"), (3, "stick")])
def test_load__gives_the_file_s_problems_in_order(tmp_path, dimension, robot, dtype):
    content = arrays(dimension=dimension, dtype=dtype)
    mazes = load_next_mazes(saved(tmp_path, **content))
    assert len(mazes) == 4 and mazes.robot == robot
    for i in range(4):
        problem = mazes[i]
        assert problem.task.start[:2] == pytest.approx(content["init_states"][i, :2])
        # First index x: the raster has y first.
        assert (content["maps"][i] == problem.environment.raster(15).T).all()
        assert mazes.problem(i + 4).fingerprint == problem.fingerprint
    with pytest.raises(InvalidInputError, match="index 0 to 3, got 4"):
        mazes[4]


def test_the_stick_has_the_benchmark_s_distance(tmp_path):
    space = load_next_mazes(saved(tmp_path, **arrays(dimension=3)))[0].space
    assert space.robot.outline.length == pytest.approx(0.2)
    rng = np.random.default_rng(0)
    a, b = rng.uniform(-1, 1, (2, 50, 3)) * [1, 1, 0.4]
    change = np.abs(a - b)
    change[:, 2] = np.minimum(change[:, 2], 0.8 - change[:, 2])
    radians = [1, 1, math.pi / 0.4]
    assert space.distance(a * radians, b * radians) == pytest.approx(np.linalg.norm(change, axis=1))
    half_turn = space.distance([0, 0, 0], [0, 0, math.pi])
    assert float(half_turn) == pytest.approx(0.4)  # not the same state


def test_problems__end_in_the_goal_region_only():
    walls = np.ones((1, 15, 15), np.uint8)
    walls[0, 1:-1, 1:-1] = 0
    mazes = NextMazes(walls, [[-0.5, 0.0]], [[0.5, 0.0]])  # in sight of each other
    options = SearchOptions(step=0.05)
    result = guided_search(mazes[0], "rrt", seed=0, max_samples=5000, options=options)
    away = mazes[0].space.distance(result.tree.configurations, (0.5, 0.0))
    assert result.solved and away[-1] < 0.05 <= away[:-1].min()
    assert result.samples >= 19 and result.samples == len(result.tree) - 1 + result.tree.failure_count
    assert mazes[0].task.tolerance < 0.05  # the region is open
    assert mazes[0].ending(0.0, by_edge=True).task.by_edge


def test_parts__are_the_last_300_and_the_others():
    content = arrays(4)
    mazes = NextMazes(*(np.tile(array, (80,) + (1,) * (array.ndim - 1)) for array in content.values()))
    train, validation = in_split(mazes, "train"), in_split(mazes, "validation")
    assert (len(train), len(validation)) == (20, 300)
    assert validation[0].fingerprint == mazes[20].fingerprint
    assert train.name == "NextPoint@train"
    with pytest.raises(InvalidInputError, match="file of their own"):
        in_split(mazes, "test")
    with pytest.raises(InvalidInputError, match="more than 300"):
        NextMazes(*content.values()).part("train")


def change(**changes):
    return {**arrays(), **changes}


def blocked():
    states = arrays()["goal_states"]
    states[2] = -0.99
    return states


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (change(maps=np.zeros((4, 14, 15))), r"maps: expected shape \(n, 15, 15\), got \(4, 14, 15\)"),
        (change(maps=arrays()["maps"] * 2), "other values"),
        (change(maps=arrays()["maps"] * np.nan), "other values"),
        (change(maps=np.zeros((4, 15, 15))), "map 0 is open"),
        (change(init_states=np.zeros((3, 2))), r"init_states: expected shape \(4, 2\)"),
        (change(init_states=np.full((4, 2), np.nan)), "init_states: expected states within"),
        (change(goal_states=np.full((4, 3), 0.7)), "row 0"),
        (change(goal_states=blocked()), "row 2 is in an obstacle"),
        (change(goal_states=arrays(dimension=3)["goal_states"]), r"goal_states: expected shape \(4, 2\)"),
        (change(init_states=np.array(["a", "b"])), "expected numbers"),
        ({"maps": arrays()["maps"]}, "maps, init_states, goal_states"),
        (change(maps=np.array([{}], dtype=object)), "npz file"),  # needs pickle
    ],
)
def test_load__refuses_other_content(tmp_path, content, message):
    with pytest.raises(StorageError, match=message):
        load_next_mazes(saved(tmp_path, **content))


def test_load__refuses_other_files(tmp_path):
    whole = saved(tmp_path, **arrays()).read_bytes()
    middle = len(whole) // 2
    files = {
        "truncated": whole[:middle],
        "altered": whole[: middle - 200] + bytes(400) + whole[middle + 200 :],
        "empty": b"",
        "text": b"maps: 1, 2, 3",
        "pickle": pickle.dumps(arrays()),
    }
    for name, content in files.items():
        path = tmp_path / f"{name}.npz"
        path.write_bytes(content)
        with pytest.raises(StorageError, match=name):
            load_next_mazes(path)
    np.save(tmp_path / "single.npy", np.zeros(3))
    for other in (tmp_path / "single.npy", tmp_path / "no_such.npz", tmp_path):
        with pytest.raises(StorageError):
            load_next_mazes(other)


def test_next_mazes__are_found_by_the_environment_variable(tmp_path, monkeypatch):
    np.savez(tmp_path / "mazes_15_2_train.npz", **arrays())
    monkeypatch.setenv(ENVIRONMENT_VARIABLE, str(tmp_path))
    named_distribution.cache_clear()
    assert len(make_distribution("NextPoint")) == len(next_mazes("point")) == 4
    with pytest.raises(StorageError, match="found none"):
        make_distribution("NextStick")
    monkeypatch.delenv(ENVIRONMENT_VARIABLE)
    named_distribution.cache_clear()
    with pytest.raises(StorageError, match=ENVIRONMENT_VARIABLE):
        make_distribution("NextPoint")
    with pytest.raises(InvalidInputError, match="'car'"):
        next_mazes("car")


@needs_data
@pytest.mark.parametrize(("robot", "visible"), [("point", 0.28), ("stick", 0.22)])
def test_the_published_data(robot, visible):
    mazes = next_mazes(robot, Path(FOLDER))
    assert len(mazes) == 2000
    problems = [mazes[i] for i in range(0, 2000, 10)]
    free = [p.space.motion_free(p.task.start, p.task.goal) for p in problems]
    assert np.mean(free) == pytest.approx(visible, abs=0.06)
    for problem in problems[:3]:
        result = guided_search(problem, "oracle", seed=0, max_samples=300, options=SearchOptions(step=0.1))
        assert result.solved


def _npy(shape: object) -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return stream.getvalue()


def test_damaged_headers_and_impossible_shapes_are_one_clear_error(tmp_path: Path) -> None:
    walls = np.ones((2, 15, 15))
    walls[:, 1:-1, 1:-1] = 0
    stream = io.BytesIO()
    np.save(stream, walls)
    sound = stream.getvalue()
    flipped = [
        bytes(b ^ (1 << bit) if i == at else b for i, b in enumerate(sound))
        for at in range(128)
        for bit in (0, 7)
    ]
    for content in [*flipped, _npy((10**12, 15, 15)), _npy((2**62, 2**62)), _npy((-1, 15, 15)), b""]:
        with zipfile.ZipFile(tmp_path / "m.npz", "w") as archive:
            archive.writestr("maps.npy", content)
            for key in ("init_states", "goal_states"):
                stream = io.BytesIO()
                np.save(stream, np.full((2, 2), 0.1))
                archive.writestr(f"{key}.npy", stream.getvalue())
        try:
            load_next_mazes(tmp_path / "m.npz")
        except StorageError as error:
            assert "m.npz" in str(error)
