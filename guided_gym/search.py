"""Guided search (paper, Algorithm 1): select a node, expand it, remember failures."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import flag, instance, integer, number
from guided_gym.efficiency import DEFAULT_TARGET, TargetParameters, jensen_shannon, sampling_efficiency
from guided_gym.errors import InvalidInputError
from guided_gym.kernels.extend import FAILED, GREW, REACHED, REACHED_TOLERANCE, attempt, grow_rrt
from guided_gym.kernels.metric import separation
from guided_gym.local_planner import DEFAULT_CANDIDATES, LocalPlanner
from guided_gym.problems import Problem
from guided_gym.target import TargetTracker
from guided_gym.tree import SearchTree

if TYPE_CHECKING:
    from guided_gym.guidance.base import GuidingSpace

NO_NODE = -1


@dataclass(frozen=True)
class SearchOptions:
    """How a search expands, ends and is measured; independent of who chooses the nodes.

    Attributes:
        step: Radius of the local planner's ball; None for 5 % of the workspace's diagonal.
        candidates: Members of N_C(v) that a guided expansion looks at.
        goal_tolerance: The search also ends when a node is this near to the goal; 0 for the paper's rule
            alone, a valid edge from the new node to t.
        rewire: RRT*-style: a new node takes the best parent within one step, then becomes one itself.
        target: Parameters of the target distribution Q.
        goal_edge: Whether the paper's rule holds. Without it a search ends only where `goal_tolerance` says,
            and its path ends at that node: the rule of benchmarks with a goal region.

    Raises:
        InvalidInputError: A value of the wrong type or out of range, or no rule by which to end.
    """

    step: float | None = None
    candidates: int = DEFAULT_CANDIDATES
    goal_tolerance: float = 0.0
    rewire: bool = False
    target: TargetParameters = DEFAULT_TARGET
    goal_edge: bool = True

    def __post_init__(self) -> None:
        if self.step is not None:
            number("step", self.step, above=0, what="length")
        integer("candidates", self.candidates, least=1)
        number("goal_tolerance", self.goal_tolerance, least=0, what="length")
        flag("rewire", self.rewire)
        flag("goal_edge", self.goal_edge)
        instance("target", self.target, TargetParameters)
        if not self.goal_edge and self.goal_tolerance == 0:
            raise InvalidInputError("goal_tolerance: expected a length > 0 without goal_edge, got 0")


@dataclass(frozen=True, slots=True)
class Expansion:
    """What became of one sample: an expansion of ``node`` towards ``target``.

    Attributes:
        node: The selected node x_min.
        target: (d,) the proposed configuration x_new.
        child: Index of the new node, or NO_NODE if the motion was not free.
        contact: (d,) colliding configuration if the motion failed, else None.
        reached_goal: Whether the search ended with the new node: it has a valid edge to the goal.
    """

    node: int
    target: NDArray[np.float64]
    child: int
    contact: NDArray[np.float64] | None
    reached_goal: bool

    @property
    def failed(self) -> bool:
        """Whether the motion was not free."""
        return self.child == NO_NODE


class Listener(Protocol):
    """Anything that learns from expansions: guiding spaces, above all."""

    def feedback(self, expansion: Expansion) -> None:
        """Take note of an expansion; called after the tree has changed."""


def streams(seed: int | None) -> tuple[np.random.Generator, np.random.Generator, np.random.Generator]:
    """Generators for the problem, the expansion and the guiding space, spawned from one seed.

    ``guided_search(seed=k)`` and ``env.reset(seed=k)`` use the same three.
    """
    try:
        return spawn(np.random.default_rng(seed))
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"seed: expected an integer >= 0 or None, got {seed!r}") from error


def spawn(
    rng: np.random.Generator,
) -> tuple[np.random.Generator, np.random.Generator, np.random.Generator]:
    """Three independent generators from the next number of ``rng``."""
    children = np.random.SeedSequence(int(rng.integers(2**63))).spawn(3)
    problem, expansion, guidance = (np.random.default_rng(child) for child in children)
    return problem, expansion, guidance


class Search:
    """One search in progress: the problem, its tree, and the step that grows it.

    Whoever selects nodes (`guided_search`, the Gymnasium environment, a user's own loop) calls `expand`.

    Args:
        problem: The problem to solve.
        expansion_rng: Source of random expansions.
        guidance_rng: Source of the guiding space's own randomness.
        options: Expansion, termination and metric.
    """

    def __init__(
        self,
        problem: Problem,
        expansion_rng: np.random.Generator,
        guidance_rng: np.random.Generator,
        options: SearchOptions | None = None,
        capacity: int = 256,
    ) -> None:
        self.problem = instance("problem", problem, Problem)
        self.space = problem.space
        self.options = SearchOptions() if options is None else instance("options", options, SearchOptions)
        # Writable copies: the kernels would compile once more for read-only arrays.
        self.start, self.goal = problem.task.start.copy(), problem.task.goal.copy()
        self._metric = (self.space.weights, self.space.periods)
        self.tree = SearchTree(self.space, self.start, capacity)
        self.planner = LocalPlanner(self.space, expansion_rng, self.options.step, self.options.candidates)
        self.guidance_rng = guidance_rng
        self.listeners: list[Listener] = []
        self.samples = 0
        self.collision_checks = 0
        self.goal_node = NO_NODE
        self.last: Expansion | None = None  # what became of the latest sample
        self._tracker: TargetTracker | None = None
        self._try_goal(0)

    @property
    def solved(self) -> bool:
        """Whether some node has a valid edge to the goal."""
        return self.goal_node != NO_NODE

    @property
    def tracker(self) -> TargetTracker:
        """The target distribution over the tree; asks the oracle, so solves it on first use."""
        if self._tracker is None:
            self._tracker = TargetTracker(self.problem, self.tree, self.options.target)
        return self._tracker

    def attach(self, guidance: GuidingSpace) -> None:
        """Prepare a guiding space for this search and let it learn from every expansion."""
        guidance.reset(self)
        self.listeners.append(guidance)

    def motion_free(self, a: NDArray[np.float64], b: NDArray[np.float64]) -> bool:
        """Whether the straight motion is free, counted among the collision checks."""
        self.collision_checks += 1
        return self.space.motion_free(a, b)

    def expand(self, node: int, target: NDArray[np.float64]) -> Expansion:
        """One sample: try the motion from ``node`` to ``target``, grow the tree or record the failure.

        Raises:
            InvalidInputError: There is no such node, or the target is no configuration.
        """
        target = self._checked(node, target)
        q = self.tree._configurations[node]
        tolerance, by_edge = self.options.goal_tolerance, self.options.goal_edge
        outcome, length, contact = attempt(
            q, target, self.goal, tolerance, by_edge, self.space.geometry, self._metric
        )
        self.samples += 1
        if outcome == FAILED:
            self.collision_checks += 1
            self.tree.add_failure(node, target, contact)
            expansion = Expansion(node, target, NO_NODE, contact, False)
        else:
            self.collision_checks += 2 if by_edge and outcome != REACHED_TOLERANCE else 1
            child = self.tree.add(target, node, length)
            if self.options.rewire:
                self._rewire(child)
            if outcome != GREW:
                self.goal_node = child
            expansion = Expansion(node, target, child, None, self.solved)
        self.last = expansion
        for listener in self.listeners:
            listener.feedback(expansion)
        return expansion

    def check_node(self, node: int) -> None:
        """Refuse what is no node of the tree; kernels would read beyond it.

        Raises:
            InvalidInputError: It is none.
        """
        if not ((type(node) is int or isinstance(node, int | np.integer)) and 0 <= node < len(self.tree)):
            raise InvalidInputError(f"node: expected an integer, 0 to {len(self.tree) - 1}, got {node!r}")

    def _checked(self, node: int, target: NDArray[np.float64]) -> NDArray[np.float64]:
        """``target`` as the kernels take it; they check no bounds."""
        self.check_node(node)
        if not (type(target) is np.ndarray and target.dtype == np.float64 and target.flags.carray):
            target = np.require(target, np.float64, ["C", "W"])
        if target.shape != self.start.shape or not all(map(math.isfinite, target.tolist())):
            raise InvalidInputError(f"target: expected {self.start.size} finite numbers, got {target!r}")
        return target

    def extend_towards(self, samples: NDArray[np.float64]) -> NDArray[np.int32]:
        """RRT's loop, compiled: the same as select, propose and expand for one sample after another.

        For searches in which nobody listens and nothing is rewired. Stops when the goal is reached.

        Args:
            samples: (m, d) samples of C.

        Returns:
            (k, 2) selected node and new node (NO_NODE after a failure) of each of the k <= m samples used.
        """
        tree, options = self.tree, self.options
        count = len(samples)
        index = tree.index
        index.reserve(count)
        tree.reserve(count)
        record = np.empty(count, np.int32), np.empty(count, np.int32)
        used, outcome = grow_rrt(
            samples,
            (len(tree), tree.failure_count),
            tree.node_arrays,
            tree.failure_arrays,
            index.state,
            self.goal,
            (self.planner.step, options.goal_tolerance, options.goal_edge),
            self.space.geometry,
            self._metric,
            record,
        )
        rows = np.stack(record, axis=1)[:used]
        grown = int(np.count_nonzero(rows[:, 1] != NO_NODE))
        tree.grown(grown, used - grown)
        self.samples += used
        looks = grown - (outcome == REACHED_TOLERANCE) if options.goal_edge else 0  # at the goal
        self.collision_checks += used + looks
        if outcome in (REACHED_TOLERANCE, REACHED):
            self.goal_node = len(tree) - 1
        return rows

    def _try_goal(self, node: int) -> None:
        q = self.tree._configurations[node]
        tolerance = self.options.goal_tolerance
        near = tolerance > 0 and separation(q, self.goal, *self._metric) <= tolerance
        if near or (self.options.goal_edge and self.motion_free(q, self.goal)):
            self.goal_node = node

    def _rewire(self, child: int) -> None:
        """RRT*'s two passes over the nodes within one step: best parent for the child, then it for others."""
        tree, space = self.tree, self.space
        q = tree.configurations[child]
        near = [int(i) for i in tree.index.within(q, self.planner.step) if i != child]
        lengths = np.atleast_1d(space.distance(tree.configurations[near], q)) if near else np.zeros(0)
        through = tree.cost_to_come[near] + lengths
        for j in np.argsort(through, kind="stable"):
            if through[j] >= tree.cost_to_come[child] - 1e-12:
                break
            if self.motion_free(tree.configurations[near[j]], q):
                tree.rewire(child, near[j], float(lengths[j]))
                break
        for i, length in zip(near, lengths, strict=True):
            if tree.cost_to_come[child] + length < tree.cost_to_come[i] - 1e-12 and self.motion_free(
                q, tree.configurations[i]
            ):
                tree.rewire(i, child, float(length))

    def path(self) -> NDArray[np.float64] | None:
        """(k, d) the path found, start and goal included; None while there is none.

        Where only nearness counts (no valid edge from the last node, or ``goal_edge`` off) it ends there.
        """
        if not self.solved:
            return None
        nodes = self.tree.configurations[self.tree.path_to(self.goal_node)]
        if self.options.goal_edge and self.space.motion_free(nodes[-1], self.goal):
            nodes = np.vstack([nodes, self.goal])
        return nodes


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


@dataclass(frozen=True, repr=False)
class SearchResult:
    """What `guided_search` returns.

    Attributes:
        tree: The search tree, failed expansions included.
        path: (k, d) certified path from start to goal, None if none was found.
        record: One row per sample.
        collision_checks: Motions checked.
        seconds: Wall time of the search, oracle and metric excluded.
        preparation: Wall time before it, in which the guiding space built its roadmap, queried its
            database, or whatever it needs.
    """

    tree: SearchTree
    path: NDArray[np.float64] | None
    record: Record
    collision_checks: int
    seconds: float
    preparation: float

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
        return float(self.tree.space.distance(self.path[:-1], self.path[1:]).sum())

    def __repr__(self) -> str:
        found = f"a path of length {self.length:.4g}" if self.solved else "no path"
        total = self.total_efficiency
        measured = "not measured" if math.isnan(total) else f"total SE {total:.4g} nats"
        return f"SearchResult({found}, {self.samples} samples, {len(self.tree)} nodes, {measured})"


def guided_search(
    problem: Problem,
    guidance: GuidingSpace | str,
    *,
    seed: int | None = None,
    max_samples: int = 1000,
    expansion: GuidingSpace | str | None = None,
    options: SearchOptions | None = None,
    measure: bool = True,
    distributions: bool = False,
    progress: Callable[[int], None] | None = None,
) -> SearchResult:
    """Guided search (paper, Algorithm 1), without Gymnasium.

    Args:
        problem: The problem to solve.
        guidance: The guiding space that selects nodes, or its name.
        seed: Seed of every random choice; the same seed gives the same tree.
        max_samples: Samples after which to give up.
        expansion: Who proposes x_new: None for ``guidance`` itself, ``"uniform"`` for the ball, or another
            guiding space.
        options: Local planner, termination and metric.
        measure: Whether to compute SE (asks the oracle).
        distributions: Whether to compute D_KL and D_JS of the whole distribution at each sample too.
        progress: Called with the number of samples so far.

    Raises:
        InvalidInputError: An argument of the wrong type, max_samples no positive integer, or the seed no
            integer >= 0.
        NoPathError: ``measure`` is on and no path joins start and goal.
        UnknownNameError: No guiding space has that name.
    """
    from guided_gym.guidance import make_guidance

    max_samples = integer("max_samples", max_samples, least=1)
    guidance = make_guidance(guidance)
    _, expansion_rng, guidance_rng = streams(seed)
    search = Search(problem, expansion_rng, guidance_rng, options)
    if measure:
        search.tracker.optimum  # noqa: B018  solve the oracle before the clock starts
    began = time.perf_counter()
    search.attach(guidance)
    preparation = time.perf_counter() - began
    propose = proposer(search, guidance, expansion)
    recorder = _Recorder(search, guidance, measure, distributions)
    began = time.perf_counter()
    in_bursts = expansion is None and not distributions and not search.options.rewire
    while not search.solved and search.samples < max_samples:
        burst = guidance.burst(max_samples - search.samples) if in_bursts else None
        if burst is not None:
            recorder.take(burst)
        else:
            node = guidance.select(search.tree)
            search.check_node(node)
            recorder.before(node)
            recorder.after(search.expand(node, propose(node)))
        if progress is not None:
            progress(search.samples)
    seconds = time.perf_counter() - began - recorder.seconds
    return SearchResult(
        search.tree, search.path(), recorder.record(), search.collision_checks, seconds, preparation
    )


def proposer(
    search: Search, guidance: GuidingSpace | None, expansion: GuidingSpace | str | None
) -> Callable[[int], NDArray[np.float64]]:
    """The function from a node to x_new that an ``expansion`` option stands for (see `guided_search`)."""
    from guided_gym.guidance import make_expander

    if expansion is None:
        if guidance is None:
            raise InvalidInputError("expansion: expected 'uniform' or a guiding space, got None")
        chosen = guidance
    else:
        expander = make_expander(expansion)
        if expander is None:
            return lambda node: search.planner.uniform(search.tree._configurations[node])
        chosen = expander
        if chosen is not guidance:  # else it is attached already, and would learn everything twice
            search.attach(chosen)
    return lambda node: chosen.propose(search.tree, node)


class _Recorder:
    """Collects the rows of a `Record`, and the time that this took."""

    def __init__(self, search: Search, guidance: GuidingSpace, measure: bool, distributions: bool) -> None:
        self._search, self._guidance = search, guidance
        self._measure, self._distributions = measure, distributions and measure
        self._blocks: list[NDArray[np.float64]] = []  # (k, 7) each, columns in the order of `Record`
        self._rows: list[list[float]] = []  # not in a block yet
        self.seconds = 0.0

    def before(self, node: int) -> None:
        """The choice of ``node``, measured on the tree as it stands."""
        began = time.perf_counter()
        row = [node, NO_NODE, len(self._search.tree), np.nan, np.nan, np.nan, np.nan]
        if self._measure:
            tracker = self._search.tracker
            row[3], row[6] = tracker.choice(node)
            if self._distributions:
                p, q = self._guidance.distribution(self._search.tree), tracker.distribution()
                row[4], row[5] = sampling_efficiency(p, q), jensen_shannon(p, q)
        self._rows.append(row)
        self.seconds += time.perf_counter() - began

    def after(self, expansion: Expansion) -> None:
        """What became of it."""
        self._rows[-1][1] = expansion.child

    def take(self, burst: NDArray[np.int32]) -> None:
        """Rows of a burst of samples: what each would have been measured at, in hindsight."""
        began = time.perf_counter()
        self._close_block()
        grew = burst[:, 1] != NO_NODE
        block = np.full((len(burst), 7), np.nan)
        block[:, :2] = burst
        block[:, 2] = len(self._search.tree) - int(grew.sum()) + np.cumsum(grew) - grew
        if self._measure:
            tracker = self._search.tracker
            for row in block:
                row[3], row[6] = tracker.choice(int(row[0]), int(row[2]))
        self._blocks.append(block)
        self.seconds += time.perf_counter() - began

    def _close_block(self) -> None:
        self._blocks.append(np.array(self._rows, np.float64).reshape(-1, 7))
        self._rows = []

    def record(self) -> Record:
        """The rows so far."""
        self._close_block()
        columns = np.concatenate(self._blocks).T.copy()
        return Record(*columns[:3].astype(np.int32), *columns[3:])
