"""Long commands that are killed, starved of room, or run twice at once: nothing is lost, nothing is wrong."""

from __future__ import annotations

import os
import pickle
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from faults.tally import Tally
from guided_gym.catalogue import problem_set
from guided_gym.storage.record_file import RecordFile

_COMMAND = [sys.executable, "-m", "guided_gym.train.cli"]
_LONGEST = 300.0  # seconds that a command may take


def _evaluate(folder: Path, seeds: int = 40) -> list[str]:
    asked = [
        "evaluate",
        "--env",
        "Cup",
        "--guidance",
        "rrt,medial_axis",
        "--seeds",
        str(seeds),
        "--no-figures",
    ]
    return [*_COMMAND, *asked, "--max-samples", "300", "--out", str(folder)]


def _database(folder: Path, paths: int = 30) -> list[str]:
    return [
        *_COMMAND,
        "database",
        "build",
        "RandomSimplePassage",
        "--paths",
        str(paths),
        "--out",
        str(folder / "p.sqlite"),
    ]


def _problems(folder: Path) -> list[str]:
    asked = ["problems", "build", "RandomSimplePassage", "--count", "24"]
    return [*_COMMAND, *asked, "--out", str(folder / "p.problems")]


def _training(kind: str, environment: str, sizes: str) -> Callable[[Path], list[str]]:
    """A command that trains; sizes as on the command line."""

    def command(folder: Path) -> list[str]:
        return [*_COMMAND, "train", kind, environment, *sizes.split(), "--out", str(folder / "run")]

    return command


_FIELD = " --cells 16 --headings 8"
_IMITATION = "--problems 4 --validation 2 --decoder-epochs 1 --rounds 1 --searches 4" + _FIELD
_MOTIONS = (
    "--problems 2 --motions 200 --validation 1 --belief-steps 20 --estimate-steps 20 --rounds 1 --searches 1"
)
_PPO = (
    "--steps 256 --copies 2 --rollout 32 --batch 32 --epochs 1 --validation 2 --validate-every 128 "
    "--max-samples 60 --no-tensorboard"
)


def _rows(folder: Path) -> Any:
    """What an evaluation found, without its times."""
    columns = "environment, guidance, seed, solved, samples, nodes, total_efficiency, path_cost, curve"
    with closing(sqlite3.connect(folder / "results.sqlite")) as connection:
        return connection.execute(f"SELECT {columns} FROM runs ORDER BY 1, 2, 3").fetchall()


def _paths(folder: Path) -> Any:
    with closing(sqlite3.connect(folder / "p.sqlite")) as connection:
        return connection.execute("SELECT seed, waypoints FROM paths ORDER BY seed").fetchall()


def _weights(folder: Path) -> Any:
    return (folder / "run/agent/weights.safetensors").read_bytes()


def _records(folder: Path) -> Any:
    file = RecordFile(folder / "p.problems", problem_set.WHAT)
    return {int(key): pickle.dumps(file.record(index)) for index, key in enumerate(file.keys)}


# What may be called again to go on. `reproduce` is not among them: it builds a database and evaluates.
_COMMANDS: dict[str, tuple[Callable[[Path], list[str]], Callable[[Path], Any]]] = {
    "evaluate": (_evaluate, _rows),
    "database build": (_database, _paths),
    "problems build": (_problems, _records),
    "train imitation": (_training("imitation", "RandomSimplePassage", _IMITATION), _weights),
    "train motions": (_training("motions", "RandomPlanarArm4", _MOTIONS), _weights),
    "train hybrid": (_training("hybrid", "RandomSimplePassage", _PPO), _weights),
    "train ppo": (_training("ppo", "RandomSimplePassage", "--start plain " + _PPO + _FIELD), _weights),
}


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST, check=False)


def kills(seed: int, share: float) -> list[Tally]:
    """Kill each long command at random moments until it comes through; compare with an uninterrupted run."""
    rng, out = np.random.default_rng(seed), []
    for name, (command, result) in _COMMANDS.items():
        tally = Tally(f"kills of {name}", "goes on where it stopped, with the result of an uninterrupted run")
        out.append(tally)
        if name.startswith("train") and _run([sys.executable, "-c", "import torch"]).returncode:
            tally.note = "needs the extra train"
            continue
        with tally.timed(), tempfile.TemporaryDirectory() as place:
            whole, torn = Path(place) / "whole", Path(place) / "torn"
            whole.mkdir()
            torn.mkdir()
            began = time.perf_counter()
            done = _run(command(whole))
            tally.check(done.returncode == 0, f"{name}: {done.stderr[-300:]}")
            usual = time.perf_counter() - began
            for number in range(max(1, round(8 * share))):
                with subprocess.Popen(
                    command(torn), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
                ) as process:
                    how = [signal.SIGKILL, signal.SIGTERM, signal.SIGINT][int(rng.integers(3))]
                    try:
                        process.wait(float(rng.uniform(0.2, 0.8)) * usual)
                    except subprocess.TimeoutExpired:
                        process.send_signal(how)
                    _, errors = process.communicate(timeout=_LONGEST)
                polite = how == signal.SIGKILL or not ("Traceback" in errors or "leaked" in errors)
                tally.check(polite, f"seed {seed}, {name}, kill {number} ({how.name}): {errors[-300:]}")
            done = _run(command(torn))
            same = done.returncode == 0 and result(whole) == result(torn)
            tally.check(same, f"seed {seed}, {name}: another result; {done.stderr[-300:]}")
    return out


@contextmanager
def _small_disk(size: str) -> Iterator[Path | None]:
    """A file system with room for little; None where this user may mount none."""
    with tempfile.TemporaryDirectory() as name:
        mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", name]
        if (
            os.name != "posix"
            or os.geteuid() != 0
            or subprocess.run(mount, capture_output=True, check=False).returncode
        ):
            yield None
            return
        try:
            yield Path(name)
        finally:
            subprocess.run(["umount", "-l", name], capture_output=True, check=False)


def disks(seed: int, share: float) -> list[Tally]:
    """Full and read-only disks: each command on a disk of its own, too small for what it writes."""
    full = Tally("full disks", "one clear error; what was there stays; with room it goes on")
    sealed = Tally("read-only disks", "results that are all there are shown; else one clear error")
    for (name, (command, result)), more in zip(list(_COMMANDS.items())[:2], (41, 31), strict=True):
        with _small_disk("48k") as disk:
            if disk is None:
                full.note = sealed.note = "needs the right to mount a file system"
                return [full, sealed]
            with full.timed():
                done = _run(command(disk))
                full.check(_clear(done), f"{name}: {done.returncode}, {done.stderr[-300:]}")
                _remount(disk, "size=64m")
                done = _run(command(disk))
                whole = done.returncode == 0 and len(result(disk)) > 0
                full.check(whole, f"{name}, with room: {done.stderr[-300:]}")
            with sealed.timed():
                _remount(disk, "ro")
                done = _run(command(disk))
                # An evaluation shows what it has; a database has nothing to show.
                fine = _clear(done) or (done.returncode == 0 and "Traceback" not in done.stderr)
                if name == "evaluate":
                    fine = done.returncode == 0 and "medial_axis" in done.stdout
                sealed.check(fine, f"{name}, all there: {done.stderr[-300:]}")
                done = _run(command(disk, more))  # type: ignore[call-arg]
                sealed.check(_clear(done), f"{name}, one missing: {done.returncode}, {done.stderr[-300:]}")
    return [full, sealed]


def _clear(done: subprocess.CompletedProcess[str]) -> bool:
    """Whether a command ended with one clear error."""
    said = "guided-gym: error:" in done.stderr and "Traceback" not in done.stderr
    return done.returncode == 2 and said


def _remount(disk: Path, options: str) -> None:
    subprocess.run(["mount", "-o", f"remount,{options}", str(disk)], check=True, capture_output=True)


def writers(seed: int, share: float) -> list[Tally]:
    """Two processes that write into the same file."""
    tally = Tally("two writers", "both come through, and the result is that of one")
    for name, (command, result) in list(_COMMANDS.items())[:2]:
        with tally.timed(), tempfile.TemporaryDirectory() as place:
            alone, shared = Path(place) / "alone", Path(place) / "shared"
            alone.mkdir()
            shared.mkdir()
            _run(command(alone))
            both = [
                subprocess.Popen(
                    command(shared), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
                )
                for _ in range(2)
            ]
            errors = [process.communicate(timeout=_LONGEST)[1] for process in both]
            ended = all(process.returncode == 0 for process in both)
            tally.check(
                ended and result(alone) == result(shared), f"{name}: {errors[0][-150:]} {errors[1][-150:]}"
            )
    return [tally]
