"""Sets of problems with their oracles, one file each: solved once, then used by any number of processes."""

from __future__ import annotations

import importlib.metadata
import json
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely

from guided_gym.catalogue.distributions import TRIES, ProblemDistribution, ProblemList
from guided_gym.catalogue.splits import SplitProblems
from guided_gym.catalogue.table import make_distribution
from guided_gym.checks import integer, shown
from guided_gym.compute.workers import Workers, executor_of, map_tasks
from guided_gym.doors import door, doors
from guided_gym.errors import InvalidInputError, NoPathError, StorageError
from guided_gym.geometry.convex import Pieces
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.linkages import Body, Joint, Linkage
from guided_gym.geometry.mechanism import Mechanism
from guided_gym.geometry.robots import Robot
from guided_gym.measure.oracle import Oracle, oracle_for, remember
from guided_gym.measure.solution import Kept
from guided_gym.problems import Problem, Task
from guided_gym.storage.record_file import Record, RecordFile, RecordWriter

WHAT: Final = "problem set"
SUFFIX: Final = ".problems"
_KEPT: Final = 1024  # problems that a set keeps in memory once they were asked for; the oracles stay mapped
_COVER: Final = ("cover_vertices", "cover_ends")

Progress = Callable[[int, int], None]


@doors
class ProblemSet(ProblemList):
    """The problems of a file that `build_problem_set` has built; number i is its i-th, modulo its size.

    What is posed is, to the last bit, what the distribution draws for the seeds that the set was built for,
    with oracles that need no solving. Processes share the file's pages in memory; copies of a set, like those
    that gymnasium makes, are the set itself, and what is sent to another process opens the file there.

    Args:
        path: The file.

    Attributes:
        header: What the file says of all its problems.

    Raises:
        StorageError: No such file, a foreign, truncated or unfinished one, or one of another version.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path).resolve()
        self._file = RecordFile(self.path, WHAT)
        self.header = self._file.header
        self.name = str(self.header["distribution"])
        self.summary = f"{len(self)} problems of {self.name}, from {self.path.name}"
        self._problems: OrderedDict[int, tuple[Problem, Oracle] | str] = OrderedDict()

    def __len__(self) -> int:
        """Number of problems."""
        return len(self._file)

    def __getitem__(self, index: int) -> Problem:
        """Problem number ``index``; `oracle_for` then knows its oracle.

        Raises:
            InvalidInputError: There is no such problem.
            StorageError: It is damaged, or its oracle does not fit.
            NoPathError: The distribution has no problem with a path for this seed.
        """
        if not 0 <= index < len(self):
            raise InvalidInputError(
                f"{self.path}: expected a problem 0 to {len(self) - 1}, got {shown(index)}"
            )
        if index not in self._problems:
            self._problems[index] = self._read(index)
            while len(self._problems) > _KEPT:
                self._problems.popitem(last=False)
        kept = self._problems[index]
        if isinstance(kept, str):
            raise NoPathError(kept)
        problem, oracle = kept
        remember(oracle, problem.task.start)
        return problem

    def _read(self, index: int) -> tuple[Problem, Oracle] | str:
        record = self._file.record(index)
        where = f"{self.path}: problem {int(self._file.keys[index])}"
        try:
            return _unpacked(record)
        except StorageError as error:
            raise StorageError(f"{where}: {error}; build the set again") from error
        except (KeyError, TypeError, ValueError, shapely.errors.ShapelyError) as error:
            raise StorageError(
                f"{where}: expected a problem and its oracle, got something else ({error}); build it again"
            ) from error

    def draw(
        self, rng: np.random.Generator, tolerance: float | None = None, by_edge: bool | None = None
    ) -> Problem:
        """One of the problems, all equally likely; those without a path are passed over.

        Raises:
            NoPathError: None of `TRIES` draws has one.
        """
        for _ in range(TRIES - 1):
            try:
                return self[int(rng.integers(len(self)))].ending(tolerance, by_edge)
            except NoPathError:
                continue
        return self[int(rng.integers(len(self)))].ending(tolerance, by_edge)

    def check(
        self, distribution: ProblemDistribution, tolerance: float | None = None, by_edge: bool | None = None
    ) -> None:
        """Refuse a distribution that the set was not built for.

        Args:
            distribution: The distribution.
            tolerance: The rule of ending that is asked for, see `Problem.ending`.
            by_edge: Likewise.

        Raises:
            InvalidInputError: Another distribution, robot or rule of ending.
        """
        what = f"problems={str(self.path)!r}"
        if distribution.name != self.name:
            raise InvalidInputError(
                f"{what}: expected problems of {distribution.name}, got a set of {self.name}"
            )
        ending = [self.header["goal_tolerance"], self.header["goal_edge"]]
        if ending != [tolerance, by_edge]:
            raise InvalidInputError(
                f"{what}: expected problems for goal_tolerance={tolerance} and goal_edge={by_edge}, got a "
                f"set built for {ending[0]} and {ending[1]}"
            )
        theirs, ours = self.header["robot"], _as_read(_robot_of(distribution))
        if theirs is not None and ours is not None and theirs != ours:
            raise InvalidInputError(f"{what}: expected problems for the robot {ours}, got a set for {theirs}")

    def __deepcopy__(self, memo: dict[int, Any]) -> ProblemSet:
        """The set itself: nothing in it changes."""
        return self

    def __reduce__(self) -> tuple[Any, ...]:
        """Another process opens the file."""
        return open_problem_set, (self.path,)


def open_problem_set(path: str | Path) -> ProblemSet:
    """The set of a file; once for each file in a process, as long as it stays the same.

    Raises:
        StorageError: As `ProblemSet`.
    """
    path = Path(path).resolve()
    status = path.stat() if path.is_file() else None
    stamp = (0, 0, 0) if status is None else (status.st_ino, status.st_mtime_ns, status.st_size)
    return _opened(path, stamp)


@lru_cache(maxsize=8)
def _opened(path: Path, stamp: tuple[int, int, int]) -> ProblemSet:
    return ProblemSet(path)


# Building ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SetReport:
    """What one call of `build_problem_set` found and did.

    Attributes:
        problems: Problems in the set now.
        solved: Problems that this call drew and solved.
        without_path: Problems of the set that have no path.
    """

    problems: int
    solved: int
    without_path: int


@dataclass(frozen=True)
class _Source:
    """What a process needs to draw and solve problems; a name is looked up there."""

    distribution: str | ProblemDistribution
    tolerance: float | None
    by_edge: bool | None

    def record(self, seed: int) -> tuple[int, Record]:
        """The problem of a seed with its oracle."""
        given = self.distribution
        distribution = make_distribution(given) if isinstance(given, str) else given
        try:
            problem = distribution.problem(seed, self.tolerance, self.by_edge)
            oracle = oracle_for(problem.space, problem.task.goal, start=problem.task.start)
        except NoPathError as error:
            return seed, Record({"no_path": str(error)}, {})
        return seed, _packed(problem, oracle)


@door
def build_problem_set(
    path: str | Path,
    distribution: str | ProblemDistribution,
    count: int,
    *,
    first: int = 0,
    goal_tolerance: float | None = None,
    goal_edge: bool | None = None,
    workers: Workers = 1,
    prepare: Callable[[], None] | None = None,
    progress: Progress | None = None,
) -> SetReport:
    """Draw the problems of ``count`` seeds, solve their oracles, and keep both in one file.

    What is in the file depends on the distribution alone, never on the workers or on how often the build was
    stopped: a call goes on where the last one was, after Ctrl-C as after a kill. A larger count adds to a set
    that is finished; damaged problems are solved again.

    Args:
        path: The file; made if there is none.
        distribution: A name (``"RandomMaze@train"``: of one split) or a distribution that can be sent to a
            process.
        count: How many problems.
        first: Seed of the first.
        goal_tolerance: Another rule for reaching a goal than the problems' own, see `Problem.ending`.
        goal_edge: Likewise.
        workers: Processes (with 1, this one does the work), or another executor.
        prepare: Called once in each process, for example to import modules that register distributions.
        progress: Called with (problems done, problems asked for).

    Raises:
        UnknownNameError: No distribution of that name.
        InvalidInputError: A number out of range, or the file holds problems of another distribution, seed or
            rule.
        StorageError: The file is foreign or damaged, cannot be written, or is being written by another
            process.
        GuidedGymError: A worker died.
    """
    path = Path(path)
    count, first = integer("count", count, least=1), integer("first", first, least=0)
    executor = executor_of(workers)
    made = make_distribution(distribution) if isinstance(distribution, str) else distribution
    header = {
        "distribution": made.name,
        "first": first,
        "count": count,
        "goal_tolerance": goal_tolerance,
        "goal_edge": goal_edge,
        "robot": _as_read(_robot_of(made)),
        "package": importlib.metadata.version("guided-gym"),
    }
    with RecordWriter(path, WHAT, header) as writer:
        _check_same(path, writer.header, header)
        there, count = writer.keys, max(count, int(writer.header["count"]))
        if count > writer.header["count"]:
            writer.describe({**writer.header, "count": count})
        missing = [seed for seed in range(first, first + count) if seed not in there]
        done = count - len(missing)
        if progress is not None:
            progress(done, count)
        source = _Source(distribution, goal_tolerance, goal_edge)
        try:
            for seed, record in map_tasks(source.record, missing, executor if missing else 1, prepare):
                writer.add(seed, record)
                done += 1
                if progress is not None:
                    progress(done, count)
        finally:
            if done == count:
                writer.finish()
    whole = ProblemSet(path)
    without = sum("no_path" in whole._file.record(i).meta for i in range(len(whole)))
    return SetReport(len(whole), len(missing), without)


def _check_same(path: Path, there: dict[str, Any], header: dict[str, Any]) -> None:
    for name in ("distribution", "first", "goal_tolerance", "goal_edge", "robot"):
        if there.get(name) != header[name]:
            raise InvalidInputError(
                f"{path}: expected a problem set with {name} {header[name]!r}, got one with "
                f"{there.get(name)!r}; choose another file"
            )


def _robot_of(distribution: ProblemDistribution) -> dict[str, Any] | None:
    """The robot of a distribution's problems; None where two draws have different ones."""
    while isinstance(distribution, SplitProblems):
        distribution = distribution.distribution
    first, second = (_robot_part(distribution.sample(np.random.default_rng(k)).robot) for k in (0, 1))
    return first if first == second else None


def _as_read(part: dict[str, Any] | None) -> Any:
    """As it comes back from a file: tuples have become lists."""
    return json.loads(json.dumps(part))


# Records ----------------------------------------------------------------------------------------------------


def _robot_part(robot: Mechanism) -> dict[str, Any]:
    """What a file says of a robot.

    Raises:
        InvalidInputError: A robot of the caller's own kind.
    """
    if type(robot) is Robot:
        return {"name": robot.name, "dimension": robot.dimension, "outline": _hex(robot.outline)}
    if type(robot) is not Linkage:
        raise InvalidInputError(f"robot: expected a Robot or a Linkage, got {shown(robot)}")
    return {
        "name": robot.name,
        "joints": [asdict(joint) for joint in robot.joints],
        "bodies": [{"joint": body.joint, "outline": _hex(body.outline)} for body in robot.bodies],
        "tool": robot.tool,
        "mobile": robot.mobile,
        "self_collision": robot.self_collision,
    }


def _hex(shape: shapely.Geometry) -> str:
    """A shape to the last bit."""
    return str(shapely.to_wkb(shape, hex=True, byte_order=1))


def _tupled(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


@lru_cache(maxsize=64)
def _robot(content: str) -> Mechanism:
    """The robot of what a file says of it, as JSON; the same object for the problems of a set."""
    part = json.loads(content)
    if "joints" not in part:
        return Robot(shapely.from_wkb(part["outline"]), part["dimension"], part["name"])
    joints = tuple(Joint(**{name: _tupled(value) for name, value in row.items()}) for row in part["joints"])
    bodies = tuple(Body(body["joint"], shapely.from_wkb(body["outline"])) for body in part["bodies"])
    tool, place = part["tool"]
    return Linkage(joints, bodies, (tool, tuple(place)), part["mobile"], part["self_collision"], part["name"])


def _packed(problem: Problem, oracle: Oracle) -> Record:
    """A problem with its oracle, as a record."""
    kept = oracle.kept()
    arrays = {f"oracle.{name}": array for name, array in kept.arrays.items()}
    meta = {
        "fingerprint": problem.fingerprint,
        "oracle": {"kind": kept.kind, "meta": kept.meta},
    }
    environment, task = problem.environment, problem.task
    meta["problem"] = {
        "name": problem.name,
        "robot": _robot_part(problem.robot),
        "bounds": list(environment.bounds),
        "obstacles": [_hex(one) for one in environment.obstacles],
        "regions": {name: _hex(region) for name, region in problem.regions.items()},
        "tolerance": task.tolerance,
        "by_edge": task.by_edge,
        "rotation_weight": problem.rotation_weight,
    }
    own = {"start": task.start, "goal": task.goal}
    cover = dict(zip(_COVER, environment.cover, strict=True))
    return Record(meta, {**own, **cover, **arrays})


def _unpacked(record: Record) -> tuple[Problem, Oracle] | str:
    """The problem and its oracle; of a seed without a path, why."""
    meta, arrays = record
    if "no_path" in meta:
        return str(meta["no_path"])
    problem = _problem(meta["problem"], record)
    if problem.fingerprint != meta["fingerprint"]:
        raise StorageError("expected the problem that the oracle was solved for, got another one")
    prefix = "oracle."
    kept = Kept(
        meta["oracle"]["kind"],
        meta["oracle"]["meta"],
        {name.removeprefix(prefix): a for name, a in arrays.items() if name.startswith(prefix)},
    )
    return problem, Oracle.restored(problem.space, problem.task.goal, kept)


def _problem(part: dict[str, Any], record: Record) -> Problem:
    environment = Environment(tuple(part["bounds"]), tuple(shapely.from_wkb(part["obstacles"])))
    # The same pieces as when it was built, whatever they were made from.
    environment.__dict__["cover"] = Pieces(*(record.arrays[name] for name in _COVER))
    return Problem(
        _robot(json.dumps(part["robot"])),
        environment,
        Task(record.arrays["start"], record.arrays["goal"], part["tolerance"], part["by_edge"]),
        part["name"],
        {name: shapely.from_wkb(region) for name, region in part["regions"].items()},
        part["rotation_weight"],
    )
