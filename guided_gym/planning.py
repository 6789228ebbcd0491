"""Guided search as one call: a problem, a guiding space, and what came of it (paper, Algorithm 1)."""

from __future__ import annotations

import contextlib
import importlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.compute.warmup import processor_seconds, wall_seconds
from guided_gym.doors import door
from guided_gym.errors import InvalidInputError, NoPathError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.registry import make_expander, make_searcher
from guided_gym.measure.target import Measure, jensen_shannon, sampling_efficiency
from guided_gym.options import SearchOptions, checked_samples
from guided_gym.problems import Problem
from guided_gym.randomness import streams
from guided_gym.search.search import NO_NODE, Expansion, Proposer, Search
from guided_gym.search.tree import SearchTree
from guided_gym.search.watch import WatchedPlanner
from guided_gym.trajectories import path_length

if TYPE_CHECKING:
    from guided_gym.traces.writing import TextSink, TraceWriter


@dataclass(frozen=True)
class Record:
    """One row per sample of a search.

    Attributes:
        selected: (m,) int32 node chosen at each sample.
        child: (m,) int32 new node, NO_NODE where the motion failed.
        nodes: (m,) int32 size of the tree when the choice was made.
        efficiency: (m,) SE of the choice, -log Q(u), in nats; NaN if the search was not measured.
        divergence: (m,) D_KL(P || Q) of the guiding space's whole distribution; NaN if not asked for.
        jensen_shannon: (m,) D_JS(P || Q), likewise.
        best: (m,) -log max Q, the least SE that any choice could have had; NaN if not measured.
    """

    selected: NDArray[np.int32]
    child: NDArray[np.int32]
    nodes: NDArray[np.int32]
    efficiency: NDArray[np.float64]
    divergence: NDArray[np.float64]
    jensen_shannon: NDArray[np.float64]
    best: NDArray[np.float64]


# By name: pictures stand above planning.
_NOTEBOOK: Final = "guided_gym.display.notebook"


@dataclass(frozen=True, repr=False)
class SearchResult:
    """What `guided_search` returns.

    Attributes:
        problem: The problem that was searched.
        options: How nodes were expanded, and what SE was measured by.
        tree: The search tree, failed expansions included.
        path: (k, d) certified path from start to goal, None if none was found.
        record: One row per sample.
        collision_checks: Motions checked.
        seconds: Wall time of the search. Oracle, metric, and the compilation of kernels are excluded.
        preparation: Wall time before it, counted in the same way, in which the guiding space built its
            roadmap, queried its database, or whatever it needs.
        processor: Processor time of the search, all threads, counted in the same way.
        looks: How often the guiding space itself looked at the workspace in that time: configurations and
            motions that it had checked (certified ones count among the collision checks, too) or looked up in
            a raster.
        tries: Motions of a watched planner that are no samples, by kind (see `guided_gym.search.watch`);
            empty for guiding spaces.
        colliding: (k, d) path that a planner returned, and that is not free by a certified look; such a
            search is not solved.
    """

    problem: Problem
    options: SearchOptions
    tree: SearchTree
    path: NDArray[np.float64] | None
    record: Record
    collision_checks: int
    seconds: float
    preparation: float
    processor: float
    looks: int
    tries: Mapping[str, int] = field(default_factory=dict)
    colliding: NDArray[np.float64] | None = None

    @property
    def solved(self) -> bool:
        """Whether a path was found."""
        return self.path is not None

    @property
    def samples(self) -> int:
        """Number of samples drawn, failures included."""
        return self.record.selected.size

    @property
    def total_efficiency(self) -> float:
        """Sum of SE over the samples (0 after the search has finished)."""
        return float(self.record.efficiency.sum())

    @property
    def efficiency_per_sample(self) -> float:
        """Mean of SE over the samples; 0 where the start saw the goal and none was drawn."""
        return self.total_efficiency / self.samples if self.samples else 0.0

    @property
    def length(self) -> float:
        """Length of the path, in the space's distance; NaN if none was found."""
        if self.path is None:
            return math.nan
        return path_length(self.tree.space, self.path)

    def __repr__(self) -> str:
        found = f"a path of length {self.length:.4g}" if self.solved else "no path"
        total = self.total_efficiency
        measured = "not measured" if math.isnan(total) else f"total SE {total:.4g} nats"
        return f"SearchResult({found}, {self.samples} samples, {len(self.tree)} nodes, {measured})"

    def _repr_html_(self) -> str:
        """The search, to be played in a notebook."""
        return str(importlib.import_module(_NOTEBOOK).result_html(self))


@door
def guided_search(
    problem: Problem,
    guidance: GuidingSpace | WatchedPlanner | str,
    *,
    seed: int | None = None,
    max_samples: int = 1000,
    expansion: GuidingSpace | str | None = None,
    options: SearchOptions | None = None,
    measure: bool = True,
    distributions: bool = False,
    progress: Callable[[int], None] | None = None,
    trace: str | Path | TextSink | None = None,
) -> SearchResult:
    """Guided search (paper, Algorithm 1), without Gymnasium.

    Args:
        problem: The problem to solve.
        guidance: The guiding space that selects nodes, or its name; or a planner that selects and expands by
            itself, such as ``"ompl:RRT"``, which takes no ``expansion`` and has no ``distributions``.
        seed: Seed of every random choice; the same seed gives the same tree.
        max_samples: Samples after which to give up.
        expansion: What proposes x_new: None for ``guidance`` itself, ``"uniform"`` for the ball, or another
            guiding space.
        options: Local planner, termination and metric.
        measure: Whether to compute SE (asks the oracle).
        distributions: Whether to compute D_KL and D_JS of the whole distribution at each sample, too.
        progress: Called with the number of samples so far.
        trace: File in which to record the search, sample by sample, or anything with ``write`` that takes the
            lines (docs/replay.md); the search stays the same.

    Raises:
        InvalidInputError: An argument has the wrong type, max_samples is not a positive integer, the seed is
            not an integer >= 0, or a planner that selects by itself cannot have an option.
        StorageError: The trace cannot be written.
        NoPathError: No path joins start and goal: to the oracle's resolution, if ``measure`` is on, or
            because a guiding space has proved it; then the error has the `SearchResult` as ``result``.
        UnknownNameError: No guiding space has that name.
    """
    max_samples = checked_samples(max_samples)
    guidance = make_searcher(guidance)
    if isinstance(guidance, WatchedPlanner):
        check_watched(guidance, expansion, distributions, options or SearchOptions())
    _, expansion_rng, guidance_rng = streams(seed)
    search = Search(problem, expansion_rng, guidance_rng, options)
    metric = Measure(search) if measure else None  # solves the oracle before the clock starts
    began = wall_seconds()
    # Distribution and trace are asked for sample by sample, so such a search runs in no bursts.
    run = _prepared(search, guidance, expansion, one_by_one=distributions or trace is not None)
    preparation = wall_seconds() - began
    guide = None if isinstance(guidance, WatchedPlanner) else guidance
    labels = {"guidance": _label(guidance), "expansion": None if expansion is None else _label(expansion)}
    with _traced(trace) as writer:
        recorder = _Recorder(search, guide, metric, distributions, writer)
        if writer is not None:
            watched = guidance if isinstance(guidance, WatchedPlanner) else None
            writer.begin(search, guide=guide, planner=watched, measure=metric, seed=seed, labels=labels)
        began, burnt = wall_seconds(), processor_seconds()
        run(max_samples, watcher=recorder, progress=progress)
        whole = wall_seconds() - began
        seconds = whole - recorder.seconds
        # The processor's clock is dear to read at each sample. A busy machine takes as much of the metric as
        # of the search, so that the metric's share of both clocks is the same.
        processor = (processor_seconds() - burnt) * (seconds / whole if whole > 0 else 1.0)
        if writer is not None:
            writer.end(search.path())
    path, colliding = search.path(), None
    if path is not None and not (
        search.tree.certified or search.space.motions_free(path[:-1], path[1:]).all()
    ):
        path, colliding = None, path
    result = SearchResult(
        problem,
        search.options,
        search.tree,
        path,
        recorder.record(),
        search.collision_checks,
        seconds,
        preparation,
        processor,
        search.looks,
        search.tries,
        colliding,
    )
    if search.no_path is not None and path is None:
        proved = NoPathError(f"{problem.name}: no path joins start and goal: {search.no_path}")
        proved.result = result
        raise proved
    return result


def _prepared(
    search: Search,
    guidance: GuidingSpace | WatchedPlanner,
    expansion: GuidingSpace | str | None,
    *,
    one_by_one: bool,
) -> Callable[..., None]:
    """Get all who guide ready; returns what runs the search, of a limit, a watcher and a progress."""
    if isinstance(guidance, WatchedPlanner):
        guidance.prepare(search)
        return partial(guidance.run, search)
    search.attach(guidance)
    propose = proposer(search, expansion)  # another guiding space has to be prepared, too
    if propose is None and one_by_one:
        propose = guidance.propose
    return partial(search.run, guidance, propose=propose)


def _traced(place: str | Path | TextSink | None) -> contextlib.AbstractContextManager[TraceWriter | None]:
    if place is None:
        return contextlib.nullcontext()
    from guided_gym.traces.writing import TraceWriter

    return TraceWriter(place)


def _label(guidance: GuidingSpace | WatchedPlanner | str) -> str:
    if isinstance(guidance, str):
        return guidance
    return guidance.expression or guidance.name or type(guidance).__name__


def check_watched(
    planner: WatchedPlanner, expansion: object, distributions: bool, options: SearchOptions
) -> None:
    """Refuse options that have no meaning for a planner that selects and expands by itself.

    Raises:
        InvalidInputError: There is such an option.
    """
    for option, given in (
        ("expansion", expansion is not None),
        ("distributions", distributions),
        ("rewire", options.rewire),
    ):
        if given:
            raise InvalidInputError(
                f"{option}: expected a guiding space beside it, got {planner.expression or planner.name}, a "
                "planner that selects and expands by itself"
            )


def proposer(search: Search, expansion: GuidingSpace | str | None) -> Proposer | None:
    """The proposer of x_new that an ``expansion`` option stands for (see `guided_search`).

    Another guiding space than those that listen already is attached to the search.
    """
    if expansion is None:
        return None
    expander = make_expander(expansion)
    if expander is None:
        return lambda tree, node: search.planner.uniform(tree.nodes.configurations[node])
    if not any(listener is expander for listener in search.listeners):  # else it would learn everything twice
        search.attach(expander)
    return expander.propose


class _Recorder:
    """Collects the rows of a `Record`, and the time that this took."""

    def __init__(
        self,
        search: Search,
        guidance: GuidingSpace | None,
        metric: Measure | None,
        distributions: bool,
        trace: TraceWriter | None = None,
    ) -> None:
        self._search, self._guidance, self._metric = search, guidance, metric
        self._distributions, self._trace = distributions, trace
        # Choices can be measured together later, unless somebody asks now or the tree changes its costs.
        self._hindsight = not distributions and trace is None and not search.options.rewire
        self._blocks: list[NDArray[np.float64]] = []  # (k, 7) each, columns in the order of `Record`
        self._rows: list[list[float]] = []  # not in a block yet
        self.seconds = 0.0

    def before(self, node: int) -> None:
        """Measure the choice of ``node`` on the tree as it stands."""
        row = [node, NO_NODE, len(self._search.tree), np.nan, np.nan, np.nan, np.nan]
        self._rows.append(row)
        if self._hindsight:
            return
        began = wall_seconds()
        if self._metric is not None:
            row[3], row[6] = self._metric.choice(node)
            if self._distributions and isinstance(self._guidance, GuidingSpace):
                p, q = self._guidance.distribution(self._search.tree), self._metric.distribution()
                row[4], row[5] = sampling_efficiency(p, q), jensen_shannon(p, q)
        if self._trace is not None:
            self._trace.chosen(node)
        self.seconds += wall_seconds() - began

    def after(self, expansion: Expansion) -> None:
        """Record what became of the sample."""
        row = self._rows[-1]
        row[1] = expansion.child
        if self._trace is not None:
            began = wall_seconds()
            self._trace.became(expansion, row[3], row[6])
            self.seconds += wall_seconds() - began

    def take(self, burst: NDArray[np.int32]) -> None:
        """Record a burst of samples: what each would have measured, in hindsight."""
        began = wall_seconds()
        self._close_block()
        grew = burst[:, 1] != NO_NODE
        block = np.full((len(burst), 7), np.nan)
        block[:, :2] = burst
        block[:, 2] = len(self._search.tree) - int(grew.sum()) + np.cumsum(grew) - grew
        self._measure(block)
        self._blocks.append(block)
        self.seconds += wall_seconds() - began

    def changed(self) -> None:
        """Pass on to the trace what the tree has gained without a sample."""
        if self._trace is not None:
            began = wall_seconds()
            self._trace.gained()
            self.seconds += wall_seconds() - began

    def rewiring(self) -> None:
        """Measure earlier choices, since a watched planner is about to give a node another parent."""
        if self._hindsight and self._rows:
            began = wall_seconds()
            self._close_block()
            self.seconds += wall_seconds() - began

    def _close_block(self) -> None:
        block = np.array(self._rows, np.float64).reshape(-1, 7)
        if self._hindsight:
            self._measure(block)
        self._blocks.append(block)
        self._rows = []

    def _measure(self, block: NDArray[np.float64]) -> None:
        """Rows of choices, in hindsight."""
        if self._metric is not None:
            block[:, [3, 6]] = self._metric.choices(block[:, 0], block[:, 2])

    def record(self) -> Record:
        """The rows so far."""
        self._close_block()
        columns = np.concatenate(self._blocks).T.copy()
        return Record(*columns[:3].astype(np.int32), *columns[3:])
