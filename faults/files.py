"""Damaged files of every format: one clear error or what was written, no code run, no hang."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import json
import os
import pickle
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import guided_gym as gg
from faults.tally import Overtime, Tally, limited
from guided_gym.catalogue import problem_set
from guided_gym.storage.record_file import RecordFile

_RUNS_CODE = {
    "pickle.find_class",
    "os.system",
    "subprocess.Popen",
    "os.exec",
    "os.posix_spawn",
    "socket.connect",
}
_URDF = """<robot name="arm"><link name="base"/>
<link name="hand"><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="turn" type="revolute"><parent link="base"/><child link="hand"/><axis xyz="0 1 0"/>
<origin xyz="0 0 0.3" rpy="0 0 0"/><limit lower="-1" upper="2" effort="1" velocity="1"/></joint></robot>
"""
_SUMMED = (
    "path database", "checkpoint", "training data", "agent weights.safetensors", "problem set",
    "oracle in the cache",
)  # fmt: skip
"""What carries checksums, or is worked out anew: what is read from it is what was written."""
_seen: list[str] = []


def _watch(event: str, arguments: Any) -> None:
    if event in _RUNS_CODE:
        _seen.append(event)


def _samples(folder: Path) -> dict[str, tuple[Path, Callable[[Path], Any]]]:
    """A sound file of each format, and what reads it."""
    from guided_gym.guidance.learned.agent import LearnedAgent
    from guided_gym.guidance.learned.folders import SHIPPED
    from guided_gym.train.checkpoints import RunFolder, read_config

    problem = gg.make_distribution("Cup").problem(0)
    found: dict[str, tuple[Path, Callable[[Path], Any]]] = {}
    short = gg.EvaluationSettings(max_samples=20)
    gg.evaluate("Cup", "rrt", seeds=2, out=folder / "results", settings=short)
    found["results"] = (
        folder / "results/results.sqlite",
        lambda p: gg.evaluate("Cup", "rrt", seeds=2, out=p.parent, settings=short),
    )
    gg.build_path_database("RandomSimplePassage", folder / "paths.sqlite", 2)
    found["path database"] = folder / "paths.sqlite", _read_database
    for suffix in (".toml", ".json"):
        problem.save(folder / f"problem{suffix}")
        found[f"problem {suffix}"] = folder / f"problem{suffix}", gg.load_problem
    gg.guided_search(problem, "rrt", seed=0, max_samples=20, trace=folder / "trace.jsonl")
    found["trace"] = folder / "trace.jsonl", lambda p: gg.read_trace(p).replay()
    (folder / "config.toml").write_text('environments = ["Cup"]\nseed = 3\nlearning_rate = 0.001\n')
    found["configuration"] = folder / "config.toml", read_config
    run = RunFolder(folder / "run", _options(), "test")
    run.save({"steps": 3}, {"w": np.arange(64.0)})
    found["checkpoint"] = folder / "run/checkpoint.safetensors", RunFolder.read
    run.keep("data/trees-000.safetensors", {"round": 0}, {"w": np.arange(64.0)})
    found["training data"] = folder / "run/data/trees-000.safetensors", RunFolder.read
    gg.build_problem_set(folder / "some.problems", "RandomSimplePassage", 2)
    found["problem set"] = folder / "some.problems", _read_problems
    found["oracle in the cache"] = _cached_oracle(problem, folder / "cache")
    shutil.copytree(SHIPPED / "point", folder / "agent")
    for name in ("card.json", "weights.safetensors"):
        found[f"agent {name}"] = folder / "agent" / name, lambda p: LearnedAgent.load(p.parent)
    walls = np.ones((2, 15, 15))
    walls[:, 1:-1, 1:-1] = 0
    ends = np.full((2, 2), 0.1)
    np.savez(folder / "mazes.npz", maps=walls, init_states=ends, goal_states=-ends)
    found["NEXT mazes"] = folder / "mazes.npz", gg.load_next_mazes
    np.save(folder / "map.npy", walls[0].astype(bool))
    found["array map"] = folder / "map.npy", lambda p: gg.read_map(p, gg.MapOptions(resolution=0.1))
    (folder / "map.map").write_text("type octile\nheight 4\nwidth 4\nmap\n....\n.@@.\n....\n....\n")
    found["MovingAI map"] = folder / "map.map", gg.read_map
    ring = [[0, 0], [4, 0], [4, 4], [0, 4], [0, 0]]
    shape = {"type": "Polygon", "coordinates": [ring]}
    feature = {"type": "Feature", "properties": {"role": "bounds"}, "geometry": shape}
    (folder / "map.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    found["GeoJSON map"] = folder / "map.geojson", gg.read_map
    with contextlib.suppress(ImportError):
        from PIL import Image

        Image.fromarray((255 * (1 - walls[0])).astype(np.uint8)).save(folder / "map.png")
        found["picture"] = folder / "map.png", lambda p: gg.read_map(p, gg.MapOptions(resolution=0.1))
        Image.fromarray((255 * (1 - walls[0])).astype(np.uint8)).save(folder / "map.pgm")
        (folder / "map.yaml").write_text(
            "image: map.pgm\nresolution: 0.1\norigin: [0, 0, 0]\nnegate: 0\n"
            "occupied_thresh: 0.65\nfree_thresh: 0.2\n"
        )
        found["ROS map"] = folder / "map.yaml", gg.read_map
        found["ROS map's picture"] = folder / "map.pgm", lambda p: gg.read_map(p.with_suffix(".yaml"))
    (folder / "map.scen").write_text("version 1\n3\tmap.map\t4\t4\t0\t0\t3\t3\t4.24264069\n")
    found["MovingAI scenario"] = folder / "map.scen", gg.read_scenario
    if importlib.util.find_spec("yourdfpy") is not None:
        (folder / "arm.urdf").write_text(_URDF)
        found["URDF"] = folder / "arm.urdf", gg.SpatialArm.from_urdf
    return found


def _options() -> Any:
    from guided_gym.train.imitation import ImitationConfig

    return ImitationConfig()


def _read_database(path: Path) -> Any:
    with gg.PathDatabase.open(path, readonly=True) as database:
        return database.load()


def _read_problems(path: Path) -> Any:
    problems, records = gg.ProblemSet(path), RecordFile(path, problem_set.WHAT)
    return [(problems[k].fingerprint, records.record(k)) for k in range(len(problems))]


def _cached_oracle(problem: gg.Problem, folder: Path) -> tuple[Path, Callable[[Path], Any]]:
    """What is damaged there is solved again."""

    def read(path: Path) -> Any:
        before = os.environ.get("GUIDED_GYM_CACHE")
        os.environ["GUIDED_GYM_CACHE"] = str(folder)
        try:
            return gg.Oracle(problem.space, problem.task.goal, resolution=(24, 24, 8)).field.tobytes()
        finally:
            if before is None:
                del os.environ["GUIDED_GYM_CACHE"]
            else:
                os.environ["GUIDED_GYM_CACHE"] = before

    read(folder)
    return next(folder.rglob("*.field")), read


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with damage of one of several kinds."""
    kind, size = int(rng.integers(8)), len(data)
    at = int(rng.integers(max(size, 1)))
    if kind <= 2 and size:  # most often: a flipped bit
        out = bytearray(data)
        out[at] ^= 1 << int(rng.integers(8))
        return bytes(out)
    if kind == 3:
        return data[:at]
    if kind == 4:
        return data[:at] + rng.bytes(int(rng.integers(1, 64))) + data[at:]
    if kind == 5:
        length = int(rng.integers(1, 64))
        return data[:at] + bytes(length) + data[at + length :]
    if kind == 6:  # a part of it twice
        other = int(rng.integers(max(size, 1)))
        return data[:at] + data[min(at, other) : max(at, other)] + data[at:]
    return bytes(
        [b"[", b"{", b"9", b'"', b"\x80", b"PK\x03\x04", b""][int(rng.integers(7))]
        * int(rng.integers(1, 20_000))
    )


def mutate(seed: int, share: float) -> list[Tally]:
    """Read damaged copies of each file."""
    try:
        import torch  # noqa: F401  the configuration of trainings needs it
    except ImportError:
        return [Tally("damaged files", "", note="needs the extra train")]
    sys.addaudithook(_watch)
    out = []
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind, (file, read) in _samples(folder).items():
            tally = Tally(
                f"damaged {kind}",
                "one clear error, or what was written (what it says, without checksums); no code",
            )
            whole = file.read_bytes()
            with tally.timed():
                written = pickle.dumps(read(file)) if kind in _SUMMED else None
                for number in range(max(3, round(100 * share))):
                    file.write_bytes(damaged(whole, rng))
                    for other in (f"{file}-wal", f"{file}-shm"):
                        Path(other).unlink(missing_ok=True)
                    wrong = trouble(read, file, written)
                    tally.check(wrong is None, f"seed {seed}, {kind}, number {number}: {wrong}")
            file.write_bytes(whole)
            out.append(tally)
    return out


def trouble(read: Callable[[Path], Any], file: Path, written: bytes | None = None) -> str | None:
    """What is wrong with how a file is read; None if nothing is, errors of this package included.

    Args:
        read: What reads it.
        file: The file.
        written: What has to come of it, pickled, if anything does; None for anything.
    """
    _seen.clear()
    try:
        with limited(), warnings.catch_warnings(), contextlib.redirect_stderr(io.StringIO()):
            warnings.simplefilter("ignore")
            found = read(file)
    except gg.GuidedGymError as error:
        return (
            None
            if len(str(error)) < 2000 and "\n" not in str(error)
            else f"a long message: {str(error)[:100]}"
        )
    except Overtime:
        return "took longer than 20 s"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    if written is not None and pickle.dumps(found) != written:
        return "was taken for sound, with something else in it"
    return f"ran {_seen[0]}" if _seen else None
