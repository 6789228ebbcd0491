"""Writing a trace: what a search does, a JSON line per sample, in the format of docs/replay.md."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Final, Protocol, TextIO, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from guided_gym.catalogue.files import problem_content
from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.search.search import Expansion
from guided_gym.traces.views import GuideView, leaf_guides

if TYPE_CHECKING:
    from guided_gym.guidance.base import GuidingSpace
    from guided_gym.search.search import Search
    from guided_gym.search.watch import WatchedPlanner

FORMAT: Final = "guided-gym trace 1"
CERTIFIED: Final = "certified"
SAMPLED: Final = "sampled"
"""How a watched planner's motions were checked."""


@runtime_checkable
class TextSink(Protocol):
    """Anything that lines can be written to: an open file, or an object that passes them on to a viewer."""

    def write(self, text: str, /) -> object:
        """Take one line, its newline included."""


class Work(Protocol):
    """Something that knows the work remaining: of a search's metric, a trace needs no more than this."""

    optimum: float

    @property
    def work_remaining(self) -> NDArray[np.float64]:
        """(n,) d_C(v, t) of each node (length)."""


class TraceWriter:
    """Writes the trace of one search, line by line; written lines stay, whatever happens next.

    Call `begin` once guide and search are ready, `chosen` when a node has been selected, `became` with what
    became of it, and `end`; or use it as a context, which closes the file.

    Args:
        place: The file, replaced if there is one (its folder is made), or what takes the lines.

    Raises:
        StorageError: The file cannot be written.
        InvalidInputError: ``place`` is neither.
    """

    def __init__(self, place: str | Path | TextSink) -> None:
        self._path = Path(place) if isinstance(place, str | Path) else None
        self._file: TextIO | None = None
        if self._path is None:
            if not isinstance(place, TextSink):
                raise InvalidInputError(
                    f"trace: expected a file or something to write to, got {shown(place)}"
                )
            self._sink: TextSink = place
        else:
            try:
                self._path.parent.mkdir(parents=True, exist_ok=True)
                self._sink = self._file = self._path.open("w", encoding="utf-8", newline="\n")
            except (OSError, ValueError) as error:
                raise StorageError(f"cannot write {self._path}: {error}") from error

    def __enter__(self) -> TraceWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; safe to call twice.

        Raises:
            StorageError: What was left could not be written.
        """
        file, self._file = self._file, None
        if file is not None:
            try:
                file.close()
            except OSError as error:
                raise StorageError(f"cannot write {self._path}: {error}") from error

    def begin(
        self,
        search: Search,
        *,
        guide: GuidingSpace | None = None,
        planner: WatchedPlanner | None = None,
        measure: Work | None = None,
        seed: int | None = None,
        labels: Mapping[str, str | None] | None = None,
    ) -> None:
        """Write the first line: the problem, and how it is searched.

        Args:
            search: The search, before its first sample.
            guide: Who selects, prepared; None where nobody can be asked.
            planner: Who selects and expands by itself, watched; None for a guide. Its tree may change without
                a sample; call `gained` when it has.
            measure: The metric, for the work remaining of the nodes; None where nothing is measured.
            seed: Seed of the search, for people.
            labels: What else to say, for people: ``guidance``, ``expansion``, ``title``.
        """
        self._search, self._guide, self._measure = search, guide, measure
        self._rewired, self._parents = search.tree.rewirings, np.zeros(0, np.int32)
        self._known, self._watched = len(search.tree), planner is not None
        self._chosen: dict[str, Any] = {}
        self._leaves = leaf_guides(guide)
        space, target = search.space, search.options.target
        header = {
            "format": FORMAT,
            "version": version("guided-gym"),
            **({} if labels is None else labels),
            "seed": None if seed is None else int(seed),
            "guides": [label_of(leaf) for leaf in self._leaves],
            "step": float(search.planner.step),
            "rewire": search.options.rewire,
            "watched": None if planner is None else CERTIFIED if planner.certified else SAMPLED,
            "metric": {"weights": space.weights.tolist(), "periods": space.periods.tolist()},
            "target": vars(target) if measure is not None else None,
            "optimum": float(measure.optimum) if measure is not None else None,
            "work": float(measure.work_remaining[0]) if measure is not None else None,
            "problem": problem_content(search.problem),
        }
        self._write(header)
        self._views = [GuideView(number, leaf, search) for number, leaf in enumerate(self._leaves)]
        for view in self._views:
            self._write_all(view.first())

    def chosen(self, node: int | None) -> None:
        """A node was selected; the tree has not changed yet. None if only `became` will say which."""
        search, guide = self._search, self._guide
        self._chosen = {"n": node}
        if search.options.rewire or self._watched:
            self._parents = search.tree.parents.copy()
        if guide is None or node is None:
            return
        turn = turn_of(guide, self._leaves)
        if turn is not None and len(self._leaves) > 1:
            self._chosen["g"] = turn
        counts = search.collision_checks, search.looks  # what a trace asks is no part of the search
        h = float(guide.values(search.tree)[node])
        search.collision_checks, search.looks = counts
        if math.isfinite(h):
            self._chosen["h"] = h

    def became(
        self,
        expansion: Expansion,
        efficiency: float = math.nan,
        best: float = math.nan,
        guide: int | None = None,
    ) -> None:
        """Write the line of this sample: what became of the selected node.

        Args:
            expansion: The expansion.
            efficiency: SE of the choice (nats); NaN if it was not measured.
            best: The least SE that any choice could have had (nats), likewise.
            guide: Which of the guides selected, where `chosen` could not tell.
        """
        row = self._chosen
        row["n"] = int(expansion.node)
        if guide is not None and len(self._leaves) > 1:
            row["g"] = guide
        row["x"] = expansion.target.tolist()
        if expansion.contact is not None:
            row["c"] = expansion.contact.tolist()
        elif self._measure is not None:
            row["t"] = float(self._measure.work_remaining[expansion.child])
        for key, value in (("s", efficiency), ("b", best)):
            if math.isfinite(value):
                row[key] = float(value)
        if self._search.tree.rewirings != self._rewired:
            row["w"] = self._new_parents(np.append(self._parents, np.int32(expansion.node)))
        if expansion.reached_goal:
            row["r"] = 1
        self._write(row)
        self._known += expansion.contact is None
        if self._watched:
            self.gained()
        for view in self._views:
            self._write_all(view.changes())

    def gained(self) -> None:
        """Write what the tree of a watched planner has gained since the last line: nodes, or a new parent."""
        tree = self._search.tree
        row: dict[str, Any] = {"also": [self._node(i) for i in range(self._known, len(tree))]}
        if tree.rewirings != self._rewired:
            row["w"] = self._new_parents(np.append(self._parents, tree.parents[self._parents.size :]))
        if row["also"] or "w" in row:
            self._write(row)
        self._known, self._parents = len(tree), tree.parents.copy()

    def _node(self, node: int) -> dict[str, Any]:
        """A node that no sample added."""
        tree = self._search.tree
        row = {"n": int(tree.parents[node]), "x": tree.configurations[node].tolist()}
        if self._measure is not None:
            row["t"] = float(self._measure.work_remaining[node])
        return row

    def _new_parents(self, before: NDArray[np.int32]) -> list[list[int]]:
        """(node, its new parent) of each edge that was replaced, of all parents as they were."""
        tree = self._search.tree
        self._rewired = tree.rewirings
        changed = np.flatnonzero(before != tree.parents)
        return [[int(node), int(tree.parents[node])] for node in changed]

    def end(self, path: NDArray[np.float64] | None = None) -> None:
        """Write the last line: how the search ended."""
        search = self._search
        content = {
            "solved": search.solved,
            "samples": search.samples,
            "nodes": len(search.tree),
            "cost": search.cost if search.solved else None,
            "path": None if path is None else path.tolist(),
        }
        self._write({"end": content})

    def _write_all(self, rows: Sequence[Mapping[str, Any]]) -> None:
        for row in rows:
            self._write(row)

    def _write(self, row: Mapping[str, Any]) -> None:
        try:
            self._sink.write(json.dumps(row, separators=(",", ":"), allow_nan=False) + "\n")
        except OSError as error:
            raise StorageError(f"cannot write {self._path or 'the trace'}: {error}") from error


def label_of(guide: GuidingSpace) -> str:
    """What people call a guiding space."""
    return str(getattr(guide, "expression", "") or guide.name or type(guide).__name__)


def turn_of(guide: GuidingSpace, leaves: Sequence[GuidingSpace]) -> int | None:
    """Which of a hybrid's guiding spaces guides the next sample; None if all of them do."""
    while (guides := getattr(guide, "guides", None)) is not None:
        if getattr(getattr(guide, "rule", None), "joint", False):
            return None
        guide = guides[guide.current]  # type: ignore[attr-defined]
    return next(number for number, leaf in enumerate(leaves) if leaf is guide)
