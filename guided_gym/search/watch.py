"""Planners of other libraries: they select and expand by themselves, and are watched while they do.

Whatever such a planner is, it asks whether motions are free. A motion leads from the state that the planner
has selected to the one that it would like to reach: what the paper calls x_min and x_new. So the tree can be
rebuilt from the questions, one by one, and each choice be measured on the tree as it stands.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.compute.warmup import wall_seconds
from guided_gym.kernels.extend import FAILED, GREW, REACHED, REACHED_TOLERANCE, attempt
from guided_gym.kernels.metric import interpolate, separation
from guided_gym.search.search import NO_NODE, Expansion, Search, Watcher
from guided_gym.search.tree import ROOT

State = tuple[float, ...]
"""A state in the other library's own numbers, by which it is known again."""

ELSEWHERE: Final = "elsewhere"
JOINING: Final = "joining"
WITHIN: Final = "within"
JOINED: Final = "joined"
TRIES: Final = (ELSEWHERE, JOINING, WITHIN, JOINED)


class WatchedPlanner(ABC):
    """A planner that selects and expands by itself; `guided_search` takes one in place of a guiding space.

    Attributes:
        name: The name in tables and on the command line.
        expression: The expression that it was made of, for messages.
        certified: Whether the motions that it takes for free are certified.
    """

    name: ClassVar[str] = ""
    expression: str = ""
    certified: bool = True

    @abstractmethod
    def prepare(self, search: Search) -> None:
        """Get ready for a search: all that comes before the first motion."""

    @abstractmethod
    def run(
        self,
        search: Search,
        limit: int,
        *,
        watcher: Watcher | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        """Plan, and rebuild the tree in ``search``; arguments as those of `Search.run`."""


class Watch:
    """What a planner's questions tell about its tree.

    T is the tree from the start. The first state of a motion is the one that the planner has selected, the
    second its x_new; a goal tree passes them the other way round, and has looked at x_new before. So a motion

    - from T to a state that is not in T is a sample: it is measured, and grows T where it is free;
    - with no end in T belongs to a goal tree, or to a part of a roadmap that T has not reached
      (`ELSEWHERE`): it counts apart, and has no SE;
    - from elsewhere to T likewise (`JOINING`); where it is free, T grows all the same;
    - with both ends in T offers another parent, or is one more edge of a roadmap (`WITHIN`): it counts apart,
      and where it makes a way shorter, in the planner's own metric, the tree is rewired.

    Where T reaches a state that has neighbours elsewhere, they become nodes, too (`JOINED`). The search ends
    by the rule of the task, whatever the planner's own is, or when samples and tries elsewhere together are
    as many as the limit.

    Args:
        search: The search; its tree grows.
        limit: Tries to grow after which the planner has to give up.
        states: Start and goal in the planner's numbers.
        configuration: (d,) the configuration that a state stands for.
        check: Whether the motion between two configurations is free. Samples of a tree whose edges are
            certified are looked at by the compiled `attempt` instead, as those of guiding spaces are.
        length: Length of the straight motion between two states in the planner's metric.
        first: Whether to end with the first path.
        watcher: Who measures.
        progress: Called with the number of samples so far.

    Attributes:
        over: Whether the search has ended: every later motion is answered with False.
        history: (tries to grow, seconds, length) of each path that was shorter than the one before.
    """

    def __init__(
        self,
        search: Search,
        limit: int,
        states: tuple[State, State],
        configuration: Callable[[State], NDArray[np.float64]],
        check: Callable[[NDArray[np.float64], NDArray[np.float64]], bool],
        length: Callable[[State, State], float],
        *,
        first: bool = True,
        watcher: Watcher | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> None:
        self._search, self._limit, self._first = search, limit, first
        self._configuration, self._check, self._length = configuration, check, length
        self._watcher, self._progress = watcher, progress
        self._start, self._goal = states
        self._nodes: dict[State, int] = {self._start: ROOT}
        self._states: list[State] = [self._start]
        self._links: dict[State, list[State]] = {}  # free motions with no end in T
        self._looked: State | None = None
        self._left = limit
        self._reached = False  # whether the last sample reached the goal
        self._costs: dict[int, float] = {ROOT: 0.0}  # as far as they were asked for since the last rewiring
        self.over = search.solved and first
        self.history: list[tuple[int, float, float]] = []
        self._began = wall_seconds()
        search.tries = dict.fromkeys(TRIES, 0)

    def look(self, state: State) -> None:
        """The planner has asked whether a state is valid."""
        self._search.looks += 1
        self._looked = None if state == self._start else state

    def motion(self, first: State, second: State) -> bool:
        """The planner asks whether a motion is free; False for every one once the search is over."""
        if self.over:
            return False
        looked, self._looked = self._looked, None
        one, other = self._nodes.get(first), self._nodes.get(second)
        target = self._configuration(second)
        if one is not None and other is None:
            reversed_ = first == looked and (second in self._links or second == self._goal)
            if not reversed_:
                return self._sample(one, second, target)
        search = self._search
        q = self._configuration(first)
        free = self._check(q, target)
        search.collision_checks += 1
        kind = (
            ELSEWHERE
            if one is None and other is None
            else JOINING
            if one is None or other is None
            else WITHIN
        )
        search.tries[kind] += 1
        self._left -= kind != WITHIN
        before = len(search.tree), search.tree.rewirings
        if not free:
            pass
        elif one is not None and other is not None:
            self._shorten(one, other)
        elif one is not None:
            self._join(one, second, target)
        elif other is not None:
            self._join(other, first, q)
        else:
            self._links.setdefault(first, []).append(second)
            self._links.setdefault(second, []).append(first)
        if self._watcher is not None and (len(search.tree), search.tree.rewirings) != before:
            self._watcher.changed()
        self._note()
        return free

    def _sample(self, node: int, state: State, target: NDArray[np.float64]) -> bool:
        """A motion from T to a state that is not in it."""
        search, watcher = self._search, self._watcher
        if watcher is not None:
            watcher.before(node)
        outcome, length, contact = self._attempt(search.tree.nodes.configurations[node], state, target)
        search.samples += 1
        self._left -= 1
        self._reached = False
        if outcome == FAILED:
            search.tree.add_failure(node, target, contact)
            search.last = Expansion(node, target, NO_NODE, contact, False)
        else:
            child = self._join(node, state, target, (length, outcome))
            search.last = Expansion(node, target, child, None, self._reached)
        if watcher is not None:
            watcher.after(search.last)
        if self._progress is not None:
            self._progress(search.samples)
        self._note()
        return outcome != FAILED

    def _attempt(
        self, q: NDArray[np.float64], state: State, target: NDArray[np.float64]
    ) -> tuple[int, float, NDArray[np.float64]]:
        """`guided_gym.kernels.extend.attempt` by the planner's own check of motions."""
        search, space = self._search, self._search.space
        search.collision_checks += 1
        if search.tree.certified:  # all in one call
            tolerance, by_edge = self._rule(state)
            outcome = attempt(q, target, search.goal, tolerance, by_edge, space.geometry, space.metric)
            search.collision_checks += by_edge and outcome[0] in (GREW, REACHED)
            return outcome
        if not self._check(q, target):
            return FAILED, 0.0, interpolate(q, target, space.first_contact(q, target), space.metric)
        return self._outcome(state, target), separation(q, target, space.metric), target

    def _rule(self, state: State) -> tuple[float, bool]:
        """The tolerance at the goal, and whether to look at it, from a state that T gains."""
        task = self._search.task
        if self._first and self._search.solved:
            return 0.0, False
        return task.tolerance, task.by_edge and self._goal not in self._nodes and state != self._goal

    def _outcome(self, state: State, q: NDArray[np.float64]) -> int:
        """Whether a state that T gains reaches the goal, in the words of `attempt`."""
        search = self._search
        tolerance, by_edge = self._rule(state)
        if tolerance > 0 and separation(q, search.goal, search.space.metric) <= tolerance:
            return REACHED_TOLERANCE
        search.collision_checks += by_edge
        return REACHED if by_edge and self._check(q, search.goal) else GREW

    def _join(
        self,
        parent: int,
        state: State,
        q: NDArray[np.float64],
        known: tuple[float, int] | None = None,
    ) -> int:
        """Add a state to T, and all that hangs together with it; returns its node.

        ``known`` is the length of the motion to it, and what `attempt` says of it.
        """
        node = self._add(parent, state, q, known)
        waiting = [state] if self._links else []
        while waiting:
            here = waiting.pop(0)
            for neighbour in self._links.pop(here, ()):
                if neighbour not in self._nodes:
                    self._add(self._nodes[here], neighbour, self._configuration(neighbour))
                    self._search.tries[JOINED] += 1
                    waiting.append(neighbour)
        return node

    def _add(
        self,
        parent: int,
        state: State,
        q: NDArray[np.float64],
        known: tuple[float, int] | None = None,
    ) -> int:
        search = self._search
        if known is None:
            a = search.tree.nodes.configurations[parent]
            known = separation(a, q, search.space.metric), self._outcome(state, q)
        length, outcome = known
        node = search.tree.add(q, parent, length)
        self._nodes[state] = node
        self._states.append(state)
        if self._first and search.solved:
            return node
        if state == self._goal or outcome == REACHED_TOLERANCE:
            self._reach(node)
        elif outcome == REACHED:
            self._see_goal(node, q)
        return node

    def _see_goal(self, node: int, q: NDArray[np.float64]) -> None:
        """A free motion leads from a node to the goal."""
        search = self._search
        if search.tree.certified:
            self._reach(node)
        else:  # by the planner's own check: the path has to keep that edge
            self._reach(search.tree.add(search.goal, node, float(search.space.distance(q, search.goal))))
            self._states.append(self._goal)

    def _reach(self, node: int) -> None:
        self._reached = True
        self._search.reach(node)

    def _note(self) -> None:
        """After a motion: a shorter path, or the end."""
        search = self._search
        if search.solved:
            cost = search.cost
            if not self.history or cost < self.history[-1][-1]:
                spent = wall_seconds() - self._began
                self.history.append((self._limit - self._left, spent, cost))
            self.over = self.over or self._first
        self.over = self.over or self._left <= 0

    def _cost(self, node: int) -> float:
        """Length of the way from the start in the planner's metric, added up from there as planners do."""
        costs, parents, way = self._costs, self._search.tree.nodes.parents, []
        while node not in costs:
            way.append(node)
            node = int(parents[node])
        cost = costs[node]
        for child in reversed(way):
            cost += self._length(self._states[node], self._states[child])
            costs[child], node = cost, child
        return cost

    def _shorten(self, one: int, two: int) -> None:
        """Rewire one of two nodes under the other if that is shorter; the motion between them is free."""
        length = self._length(self._states[one], self._states[two])
        parent, child = (one, two) if self._cost(one) <= self._cost(two) else (two, one)
        if not self._cost(parent) + length < self._cost(child):
            return
        if self._watcher is not None:
            self._watcher.rewiring()
        tree, space = self._search.tree, self._search.space
        a, b = tree.nodes.configurations[parent], tree.nodes.configurations[child]
        tree.rewire(child, parent, separation(a, b, space.metric))
        self._costs = {ROOT: 0.0}
