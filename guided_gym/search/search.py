"""Guided search (paper, Algorithm 1): select a node, expand it, remember failures.

Nothing here knows a guiding space, the oracle or the metric: who selects is a `Guide`, who measures a
`Watcher`.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import instance, integer, shown
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError
from guided_gym.kernels.extend import FAILED, GREW, REACHED, REACHED_TOLERANCE, attempt, grow_rrt
from guided_gym.options import SearchOptions
from guided_gym.problems import Problem
from guided_gym.randomness import copied
from guided_gym.search.local_planner import LocalPlanner
from guided_gym.search.tree import SearchTree

NO_NODE = -1

Proposer = Callable[[SearchTree, int], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class Expansion:
    """What became of one sample: an expansion of ``node`` towards ``target``.

    Attributes:
        node: The selected node x_min.
        target: (d,) the proposed configuration x_new.
        child: Index of the new node, or NO_NODE if the motion was not free.
        contact: (d,) colliding configuration if the motion failed, else None.
        reached_goal: Whether the new node reaches the goal, by the rule of the task.
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
    """Anything that learns from expansions, above all guiding spaces."""

    def reset(self, search: Search) -> None:
        """Get ready for a new search."""

    def feedback(self, expansion: Expansion) -> None:
        """Take note of an expansion; called after the tree has changed."""


class Guide(Listener, Protocol):
    """Who selects nodes and proposes expansions.

    It may have an attribute ``no_path``: why no path exists in C, once that is proved, and None until then.
    """

    def select(self, tree: SearchTree) -> int:
        """The node to expand, x_min."""

    def propose(self, tree: SearchTree, node: int) -> NDArray[np.float64]:
        """(d,) the configuration to expand it towards, x_new."""

    def burst(self, limit: int) -> NDArray[np.int32] | None:
        """Draw many samples in one go, as `Search.extend_towards` gives them; None to be asked one by one."""


class Watcher(Protocol):
    """An observer that measures a search as it runs."""

    def before(self, node: int) -> None:
        """A node was selected; the tree has not changed yet."""

    def after(self, expansion: Expansion) -> None:
        """The sample has been drawn: what became of it."""

    def take(self, rows: NDArray[np.int32]) -> None:
        """A burst has been drawn: selected node and new node of each sample, in hindsight."""

    def rewiring(self) -> None:
        """A watched planner is about to give a node another parent."""

    def changed(self) -> None:
        """The tree has changed without a sample: nodes, or one new parent, of a watched planner."""


@doors
class Search:
    """One search in progress: the problem, its tree, and the step that grows it.

    `run` is the whole of Algorithm 1. A caller that selects by other means (the Gymnasium environment, a
    user's own loop) calls `expand`.

    Args:
        problem: The problem to solve; its task says what ends the search.
        expansion_rng: Source of random expansions.
        guidance_rng: Source of the guiding space's own randomness.
        options: How nodes are expanded.
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
        self.space, self.task = problem.space, problem.task
        self.options = SearchOptions() if options is None else instance("options", options, SearchOptions)
        # Writable copies: the kernels would compile once more for read-only arrays.
        self.start, self.goal = problem.task.start.copy(), problem.task.goal.copy()
        self.tree = SearchTree(self.space, self.start, capacity)
        self.planner = LocalPlanner(self.space, expansion_rng, self.options.step, self.options.candidates)
        self.guidance_rng = guidance_rng
        self.listeners: list[Listener] = []
        self.samples = 0
        self.collision_checks = 0
        self.looks = 0  # of the guiding space at the workspace, or at a raster of it
        self.tries: dict[str, int] = {}  # motions of a watched planner that are no samples, by kind
        self.no_path: str | None = None  # why none exists, where a guide has proved it
        self.last: Expansion | None = None  # what became of the latest sample
        self._reached: list[tuple[int, float]] = []  # nodes that reach the goal, and the way from there
        if problem.begins_solved:
            self.reach(0)
        self.collision_checks += self.task.by_edge

    def clone(self) -> Search:
        """An independent copy that will draw the same random numbers, as tree search over searches needs it.

        Problem and space are shared. Guiding spaces that learn from this search are copied with it, which
        takes longer the more they hold; without any, it takes some 50 us.
        """
        other = copy.copy(self)
        other.tree = self.tree.clone()
        other.planner = copy.copy(self.planner)
        other.planner.rng = copied(self.planner.rng)
        other.guidance_rng = copied(self.guidance_rng)
        other.tries = dict(self.tries)
        other._reached = list(self._reached)
        if self.listeners:
            other.listeners = copy.deepcopy(self.listeners, self.shared_by(other))
        else:
            other.listeners = []
        return other

    def shared_by(self, other: Search) -> dict[int, Any]:
        """The memo for deep copies of what belongs to this search, so that the copies belong to its clone."""
        ours = (self, self.tree, self.planner, self.planner.rng, self.guidance_rng)
        theirs = (other, other.tree, other.planner, other.planner.rng, other.guidance_rng)
        same = (self.problem, self.space, self.space.environment, self.space.robot)
        return dict(zip(map(id, (*ours, *same)), (*theirs, *same), strict=True))

    @property
    def solved(self) -> bool:
        """Whether some node reaches the goal."""
        return bool(self._reached)

    @property
    def goal_node(self) -> int:
        """The node from which the shortest path found so far reaches the goal; NO_NODE if there is none."""
        if not self._reached:
            return NO_NODE
        return min(self._reached, key=lambda end: self.tree.nodes.costs[end[0]] + end[1])[0]

    @property
    def cost(self) -> float:
        """Length of the shortest path found so far; infinite if there is none."""
        return min((self.tree.nodes.costs[node] + rest for node, rest in self._reached), default=math.inf)

    def attach(self, listener: Listener) -> None:
        """Prepare a guiding space for this search and let it learn from every expansion."""
        listener.reset(self)
        self.listeners.append(listener)

    def run(
        self,
        guide: Guide,
        limit: int,
        *,
        propose: Proposer | None = None,
        watcher: Watcher | None = None,
        progress: Callable[[int], None] | None = None,
        stop: Callable[[], bool] | None = None,
    ) -> None:
        """Select and expand until the goal is reached or ``limit`` samples are drawn, earlier ones included.

        It also ends if the guide has proved that there is no path; then `no_path` says why.

        Args:
            guide: What selects the nodes; attached already.
            limit: Samples after which to give up.
            propose: What proposes x_new; the guide itself if None, in bursts where it can.
            watcher: What measures the search.
            progress: Called with the number of samples so far.
            stop: Asked before each sample or burst whether to end, in place of whether the goal is reached.
        """
        stop = (lambda: self.solved) if stop is None else stop
        in_bursts = propose is None and not self.options.rewire
        propose = guide.propose if propose is None else propose
        while not stop() and self.samples < limit:
            rows = guide.burst(limit - self.samples) if in_bursts else None
            if rows is not None:
                if watcher is not None:
                    watcher.take(rows)
            else:
                node = guide.select(self.tree)
                self.no_path = getattr(guide, "no_path", None)
                if self.no_path is not None:
                    return
                self.check_node(node)
                if watcher is not None:
                    watcher.before(node)
                expansion = self.expand(node, propose(self.tree, node))
                if watcher is not None:
                    watcher.after(expansion)
            if progress is not None:
                progress(self.samples)

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
        q = self.tree.nodes.configurations[node]
        tolerance, by_edge = self.task.tolerance, self.task.by_edge
        outcome, length, contact = attempt(
            q, target, self.goal, tolerance, by_edge, self.space.geometry, self.space.metric
        )
        self.samples += 1
        kept = self.space.configuration(target)  # of few turns
        if outcome == FAILED:
            self.collision_checks += 1
            self.tree.enter_failure(node, kept, contact)
            expansion = Expansion(node, target, NO_NODE, contact, False)
        else:
            self.collision_checks += 2 if by_edge and outcome != REACHED_TOLERANCE else 1
            child = self.tree.enter(kept, node, length)
            if self.options.rewire:
                self._rewire(child)
            if outcome != GREW:
                self.reach(child)
            expansion = Expansion(node, target, child, None, outcome != GREW)
        self.last = expansion
        for listener in self.listeners:
            listener.feedback(expansion)
        return expansion

    def check_node(self, node: int) -> None:
        """Refuse anything but a node of the tree: kernels would read beyond the tree.

        Raises:
            InvalidInputError: It is not one.
        """
        self.tree.check_node(node)

    def _checked(self, node: int, target: NDArray[np.float64]) -> NDArray[np.float64]:
        """``target`` as the kernels take it; they check no bounds."""
        self.tree.check_node(node)
        if not (type(target) is np.ndarray and target.dtype == np.float64 and target.flags.carray):
            target = np.require(target, np.float64, ["C", "W"])
        if target.shape != self.start.shape or not all(map(math.isfinite, target.tolist())):
            raise InvalidInputError(f"target: expected {self.start.size} finite numbers, got {shown(target)}")
        return target

    def extend_towards(self, samples: NDArray[np.float64]) -> NDArray[np.int32]:
        """RRT's loop, compiled: the same as select, propose and expand for one sample after another.

        For searches without listeners and without rewiring. Stops when the goal is reached.

        Args:
            samples: (m, d) samples of C.

        Returns:
            (k, 2) selected node and new node (NO_NODE after a failure) of each of the k <= m samples used.

        Raises:
            InvalidInputError: The samples have another shape.
        """
        samples = self.space.batch(samples)
        tree, task = self.tree, self.task
        count = len(samples)
        index = tree.index
        index.reserve(count)
        tree.reserve(count)
        record = np.empty(count, np.int32), np.empty(count, np.int32)
        used, outcome = grow_rrt(
            samples,
            (len(tree), tree.failure_count),
            tree.nodes,
            tree.failed,
            index.state,
            self.goal,
            (self.planner.step, task.tolerance, task.by_edge),
            self.space.geometry,
            self.space.metric,
            record,
        )
        rows = np.stack(record, axis=1)[:used]
        self.take_rows(rows, outcome)
        return rows

    def take_rows(self, rows: NDArray[np.int32], outcome: int) -> None:
        """`take_in` for a kernel that drew its samples by `guided_gym.kernels.extend.attempt`.

        Args:
            rows: (k, 2) selected node and new node (NO_NODE after a failure) of each sample.
            outcome: Of the last one.
        """
        grown = int(np.count_nonzero(rows[:, 1] != NO_NODE))
        looks = grown - (outcome == REACHED_TOLERANCE) if self.task.by_edge else 0  # at the goal
        reached = outcome in (REACHED_TOLERANCE, REACHED)
        self.take_in(grown, len(rows) - grown, len(rows) + looks, reached)

    def take_in(self, nodes: int, failures: int, checks: int, reached: bool) -> None:
        """Take in samples that a kernel has drawn and written behind the last nodes and failures.

        Args:
            nodes: How many nodes it wrote.
            failures: How many failures.
            checks: How many motions it looked at.
            reached: Whether the last node reaches the goal.

        Raises:
            InvalidInputError: There is no room for so many.
        """
        checks = integer("checks", checks, least=0)
        self.tree.grown(nodes, failures)
        self.samples += nodes + failures
        self.collision_checks += checks
        if reached:
            self.reach(len(self.tree) - 1)

    def reach(self, node: int) -> None:
        """Note that a node reaches the goal, by the rule of the task.

        Raises:
            InvalidInputError: There is no such node.
        """
        self.check_node(node)
        q, task = self.tree.nodes.configurations[node], self.task
        # By nearness alone the path ends at the node.
        joined = task.by_edge and (task.tolerance == 0 or self.space.motion_free(q, self.goal))
        self._reached.append((node, float(self.space.distance(q, self.goal)) if joined else 0.0))

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

        It is the shortest of those found. Where only nearness counts (no valid edge from the last node to the
        goal, or a task without ``by_edge``), it ends at the last node.
        """
        if not self.solved:
            return None
        nodes = self.tree.configurations[self.tree.path_to(self.goal_node)]
        there = bool((nodes[-1] == self.goal).all())
        if self.task.by_edge and not there and self.space.motion_free(nodes[-1], self.goal):
            nodes = np.vstack([nodes, self.goal])
        return nodes
