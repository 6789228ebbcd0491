"""Reading a trace, as far as it can be read, and growing its search again."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.catalogue.files import problem_of
from guided_gym.checks import shown
from guided_gym.doors import door, doors
from guided_gym.errors import StorageError
from guided_gym.kernels.metric import separation
from guided_gym.options import SearchOptions
from guided_gym.problems import Problem
from guided_gym.search.search import Search
from guided_gym.traces.writing import CERTIFIED, FORMAT, SAMPLED

_FAMILY: Final = "guided-gym trace "
LONGEST_LINE: Final = 2**27  # characters; problems of a million corners have less
NUMBERS: Final = ("h", "s", "b", "t")  # of a sample, where they are known

Row = dict[str, Any]


@dataclass(frozen=True)
class Gain:
    """What the tree of a watched planner gained without a sample.

    Attributes:
        nodes: (parent, configuration) of each new node.
        parents: (node, its new parent) of the edges that were replaced.
    """

    nodes: tuple[tuple[int, NDArray[np.float64]], ...]
    parents: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Sample:
    """One sample of a search.

    Attributes:
        node: The selected node.
        target: (d,) what it was expanded towards.
        contact: (d,) where the motion collided; None if it was free.
        guide: Which of the trace's guides guided; None if there is only one, or all did.
        h: The heuristic at the selected node; NaN if infinite or unknown.
        efficiency: SE of the choice (nats); NaN if it was not measured.
        best: The least SE that any choice could have had, likewise.
        work: d_C from the new node to the goal; NaN if there is none.
        parents: (node, its new parent) of the edges that this sample replaced.
    """

    node: int
    target: NDArray[np.float64]
    contact: NDArray[np.float64] | None
    guide: int | None
    h: float
    efficiency: float
    best: float
    work: float
    parents: tuple[tuple[int, int], ...]


@doors
class Trace:
    """A trace that has been read.

    Attributes:
        path: The file.
        header: Its first line.
        samples: One per sample.
        gains: What the tree gained without a sample, each with the number of samples before it. Only the
            trees of watched planners have such gains.
        end: Its last line; None if the trace ends early.
        trouble: Why the trace ends early; empty if it does not.
    """

    def __init__(self, path: Path) -> None:
        reader = TraceReader(path)
        self.path, self.header = path, reader.header
        self.samples: list[Sample] = []
        self.gains: list[tuple[int, Gain]] = []
        for row in reader:
            if "n" in row:
                self.samples.append(_sample(row))
            elif "also" in row:
                self.gains.append((len(self.samples), _gain(row)))
        self.end, self.trouble = reader.end, reader.trouble

    def __len__(self) -> int:
        return len(self.samples)

    def __repr__(self) -> str:
        ends = f", ends early: {self.trouble}" if self.trouble else ""
        what = f"{self.header.get('guidance')} on {self.header['problem'].get('name')}"
        return f"Trace({what}, {len(self)} samples{ends})"

    @property
    def problem(self) -> Problem:
        """The problem that was searched.

        Raises:
            InvalidInputError: It cannot be used.
        """
        return problem_of(self.header["problem"], self.path)

    def replay(self) -> Search:
        """The search, grown again from the choices: the same tree, rewiring included.

        What a watched planner's tree gained without a sample is taken from the trace. If its motions were
        sampled and not certified, their outcome is taken from the trace, too.

        Raises:
            StorageError: A sample had another outcome than the trace says.
            InvalidInputError: The problem cannot be used.
        """
        rng = np.random.default_rng(0)  # nobody draws from it
        options = SearchOptions(step=self.header["step"], rewire=self.header["rewire"])
        search = Search(self.problem, rng, rng, options)
        search.tree.certified = certified = self.header["watched"] != SAMPLED
        gains = iter([*self.gains, (len(self.samples) + 1, Gain((), ()))])
        due, gain = next(gains)
        for number in range(len(self.samples) + 1):
            while due == number:
                _take(search, gain)
                due, gain = next(gains)
            if number == len(self.samples):
                break
            sample = self.samples[number]
            if not certified:
                _believe(search, sample)
                continue
            before = search.tree.parents.copy()
            expansion = search.expand(sample.node, sample.target)
            parents = before if expansion.failed else np.append(before, np.int32(sample.node))
            for node, parent in sample.parents:
                parents[node] = parent
            same = _same(expansion.contact, sample.contact) and np.array_equal(parents, search.tree.parents)
            if not same:
                raise StorageError(
                    f"{self.path}: expected sample {number} to be what its choice leads to, got another "
                    "outcome: another version of guided-gym wrote the trace, or it was changed"
                )
        return search


@door
def read_trace(path: str | Path) -> Trace:
    """Read a trace; up to the damage, if it is truncated or damaged.

    Raises:
        StorageError: The file cannot be read, or is not a trace of this version.
    """
    return Trace(Path(path))


class TraceReader:
    """The lines of a trace, checked one by one, up to the first that cannot be read.

    Iterate over it once: it gives the rows of samples and of guides' views as they are in the file.

    Args:
        path: The file.
        samples: How many samples are wanted; those beyond are counted, but not read. None for all.

    Attributes:
        header: The first line.
        end: The last line, once it was read; None if the trace ends early.
        trouble: Why the trace ends early; empty if it does not, or has not been read to the end.
        beyond: How many samples there were beyond those that were wanted.

    Raises:
        StorageError: The file cannot be read, or is not a trace of this version.
    """

    def __init__(self, path: str | Path, samples: int | None = None) -> None:
        self.path = Path(path)
        self._wanted = math.inf if samples is None else samples
        self.beyond = 0
        self.end: Row | None = None
        self.trouble = ""
        try:
            with self.path.open(encoding="utf-8") as file:
                line = file.readline(LONGEST_LINE)
        except (OSError, ValueError) as error:
            raise StorageError(f"cannot read {self.path}: {error}") from error
        self.header = _checked_header(self.path, line)
        self.dimension = len(self.header["problem"]["start"])
        self._guides = len(self.header["guides"])

    def __iter__(self) -> Iterator[Row]:
        nodes, number, seen = 1, 1, 0
        try:
            with self.path.open(encoding="utf-8") as file:
                file.readline(LONGEST_LINE)
                while line := file.readline(LONGEST_LINE):
                    number += 1
                    if seen >= self._wanted and not line.startswith('{"end"'):  # nor what comes between
                        self.beyond += line.startswith('{"n"')
                        continue
                    row = self._parsed(line, nodes)
                    if "end" in row:
                        self.end = row["end"]
                        return
                    seen += "n" in row
                    nodes += ("n" in row and "c" not in row) + len(row.get("also", ()))
                    yield row
            self.trouble = f"it stops after line {number}"
        except _UnreadableError as error:
            self.trouble = f"line {number} {error}"
        except (OSError, ValueError) as error:
            self.trouble = f"line {number + 1} cannot be read: {error}"

    def _parsed(self, line: str, nodes: int) -> Row:
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            raise _UnreadableError("is cut off" if not line.endswith("\n") else "is no JSON") from None
        if not isinstance(row, dict):
            raise _UnreadableError("is no JSON object")
        if "n" in row:
            self._check_sample(row, nodes)
        elif "also" in row:
            self._check_gain(row, nodes)
        elif "view" in row:
            if not _index(row["view"], self._guides):
                raise _UnreadableError(f"names a guide that is not there: {row['view']!r}")
        elif not isinstance(row.get("end"), dict):
            raise _UnreadableError("is neither a sample, nor a gain, nor a view, nor the end")
        return row

    def _check_sample(self, row: Row, nodes: int) -> None:
        if not _index(row["n"], nodes):
            raise _UnreadableError(f"selects a node that is not there: {row['n']!r}")
        for key in ("x", "c"):
            if (key == "x" or key in row) and not _vector(row.get(key), self.dimension):
                raise _UnreadableError(f"needs {self.dimension} numbers as {key!r}")
        if any(key in row and not _number(row[key]) for key in NUMBERS):
            raise _UnreadableError("has a text where a number should be")
        if "g" in row and not _index(row["g"], self._guides):
            raise _UnreadableError(f"names a guide that is not there: {row['g']!r}")
        self._check_pairs(row, nodes + ("c" not in row))

    def _check_gain(self, row: Row, nodes: int) -> None:
        added = row["also"]
        if self.header["watched"] is None or not isinstance(added, list):
            raise _UnreadableError("adds nodes that no guided search adds")
        for i, node in enumerate(added):
            if not (isinstance(node, dict) and _index(node.get("n"), nodes + i)):
                raise _UnreadableError("adds a node to one that is not there")
            if not _vector(node.get("x"), self.dimension):
                raise _UnreadableError(f"needs {self.dimension} numbers as 'x'")
            if "t" in node and not _number(node["t"]):
                raise _UnreadableError("has a text where a number should be")
        self._check_pairs(row, nodes + len(added))

    def _check_pairs(self, row: Row, size: int) -> None:
        pairs = row.get("w", [])
        if not isinstance(pairs, list) or not all(
            isinstance(pair, list) and len(pair) == 2 and all(_index(one, size) for one in pair)
            for pair in pairs
        ):
            raise _UnreadableError("rewires nodes that are not there")


def _take(search: Search, gain: Gain) -> None:
    """Let a tree gain what it gained without a sample."""
    tree, metric = search.tree, search.space.metric
    for parent, q in gain.nodes:
        tree.add(q, parent, separation(tree.nodes.configurations[parent], q, metric))
    for node, parent in gain.parents:
        a, b = tree.nodes.configurations[parent], tree.nodes.configurations[node]
        tree.rewire(node, parent, separation(a, b, metric))


def _believe(search: Search, sample: Sample) -> None:
    """Have become of a sample what the trace says: its motion was not certified."""
    tree = search.tree
    search.samples += 1
    if sample.contact is None:
        q = tree.nodes.configurations[sample.node]
        tree.add(sample.target, sample.node, separation(q, sample.target, search.space.metric))
    else:
        tree.add_failure(sample.node, sample.target, sample.contact)


def _same(a: NDArray[np.float64] | None, b: NDArray[np.float64] | None) -> bool:
    return (a is None and b is None) or (a is not None and b is not None and np.array_equal(a, b))


class _UnreadableError(Exception):
    """What is wrong with a line."""


def _checked_header(path: Path, line: str) -> Row:
    try:
        header = json.loads(line)
        form = header["format"]
    except (ValueError, TypeError, KeyError, RecursionError):
        raise StorageError(
            f"{path}: expected a trace, whose first line names its format; got {line[:60]!r}"
        ) from None
    if form != FORMAT:
        kind = "another version of it" if str(form).startswith(_FAMILY) else "something else"
        raise StorageError(f"{path}: expected {FORMAT!r}, got {kind}: {str(form)[:60]!r}")
    problem = header.get("problem")
    start = problem.get("start") if isinstance(problem, dict) else None
    if not (isinstance(start, list) and start and _vector(start, len(start))):
        raise StorageError(f"{path}: expected a problem with a start in the first line, got none")
    if header.setdefault("watched", None) not in (None, CERTIFIED, SAMPLED):
        raise StorageError(
            f"{path}: expected {CERTIFIED!r}, {SAMPLED!r} or null as 'watched', got {header['watched']!r}"
        )
    guides = header.setdefault("guides", [])
    if not (isinstance(guides, list) and all(isinstance(name, str) for name in guides)):
        raise StorageError(f"{path}: expected the guides' names in the first line, got {shown(guides)}")
    if not _number(header.get("step")) or not isinstance(header.get("rewire"), bool):
        raise StorageError(f"{path}: expected step and rewire in the first line, got none")
    return dict(header)


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _index(value: object, size: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < size


def _vector(value: object, size: int) -> bool:
    return isinstance(value, list) and len(value) == size and all(map(_number, value))


def _gain(row: Row) -> Gain:
    nodes = tuple((node["n"], np.array(node["x"], np.float64)) for node in row["also"])
    return Gain(nodes, tuple((node, parent) for node, parent in row.get("w", [])))


def _sample(row: Row) -> Sample:
    h, efficiency, best, work = (float(row.get(key, math.nan)) for key in NUMBERS)
    return Sample(
        row["n"],
        np.array(row["x"], np.float64),
        np.array(row["c"], np.float64) if "c" in row else None,
        row.get("g"),
        h,
        efficiency,
        best,
        work,
        tuple((node, parent) for node, parent in row.get("w", [])),
    )
