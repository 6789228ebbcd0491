"""The one mechanism: modify robot or environment, solve the easier problem, take its value for h, compose.

Every guiding space of the paper's three categories is a `Composed`, written as an expression such as
``roadmap(robot=disc)``; `guided_gym.guidance.recipes` has those with a name of their own.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import flag, instance, number
from guided_gym.doors import door, doors
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.modifications import SAME, UNCHANGED, EnvironmentModification, RobotModification
from guided_gym.guidance.proof import parted_cells, parted_workspace
from guided_gym.guidance.solvers.base import CostToGo, Doubts, Query
from guided_gym.kernels.extend import FAILED
from guided_gym.kernels.metric import separation, separations
from guided_gym.kernels.turns import charged, least_charged
from guided_gym.kernels.wave_growth import Terms
from guided_gym.options import checked_candidates
from guided_gym.problems import Task
from guided_gym.search.search import NO_NODE, Expansion
from guided_gym.search.tree import SearchTree

Floats = NDArray[np.float64]
Proof = Callable[[ConfigurationSpace, Task], str | None]

_PATIENCE: Final = 500  # samples before the dearer proof is tried
_BURST: Final = 64  # samples in one go
_NO_TREE: Final = -1  # how often a tree has changed that there is not


@doors
@dataclass(frozen=True)
class Lesson:
    """What a failed expansion teaches the solver. Lengths are in units of the space's natural length.

    Attributes:
        node: Whether it is about the node that failed to expand; else about the configuration where it
            collided.
        reach: How far around it ways get costlier; 0 for the way that begins there, alone.
        factor: How many times costlier; infinite forbids.
        check: How far around the collision the ways that run there are validated; 0 for not at all.
        foreseen: What part of the reach a failure has that the solver foresaw; 0 for no lesson. Where
            somebody else proposes, most say only what it knew: a random motion beside an obstacle collides.
    """

    node: bool = False
    reach: float = 0.1
    factor: float = math.inf
    check: float = 0.0
    foreseen: float = 1.0

    def __post_init__(self) -> None:
        flag("node", self.node)
        number("reach", self.reach, least=0)
        number("check", self.check, least=0)
        number("foreseen", self.foreseen, least=0)
        if self.factor != math.inf:
            number("factor", self.factor, least=1)


FORBID = Lesson(reach=0.2, check=2.5)
"""For C' = C without some obstacles: a failure refutes what passes near it, and has more looked at."""
AVOID = Lesson(reach=0.5, factor=3.0)
"""For another robot: a failure says nothing certain of its states, but makes the ways there less likely."""


class Composed(GuidingSpace):
    """A guiding space S = (r', E') with h(x) = d_S(P(x), P(t)), as a solver sees it (paper, Section 4).

    Args:
        solver: It gives the cost-to-go of the easier problem.
        robot: The modification r -> r', and the projection.
        environment: The modification E -> E'.
        lesson: What a failure teaches; by default `FORBID` where the robot is the same and E' optimistic,
            `AVOID` elsewhere.
        fallback: The guiding space while the solver sees no way from any node. If None, all nodes are equally
            good then.
        detour: Weight of a node's suboptimality beside its cost-to-go, both as the solver sees them.
        temperature: See `GuidingSpace`.
        expansion_penalty: What each expansion of a node adds to its h, in natural lengths of the space.
        candidates: Members of N_C(v) that a proposal looks at; None for as many as the search's options say.
    """

    name: ClassVar[str] = "composed"

    @door
    def __init__(
        self,
        solver: CostToGo,
        robot: RobotModification = SAME,
        environment: EnvironmentModification = UNCHANGED,
        *,
        lesson: Lesson | None = None,
        fallback: GuidingSpace | None = None,
        detour: float = 0.0,
        temperature: float = 0.0,
        expansion_penalty: float = 0.1,
        candidates: int | None = None,
    ) -> None:
        super().__init__(temperature=temperature, expansion_penalty=expansion_penalty)
        self.solver, self.robot, self.environment, self.fallback = solver, robot, environment, fallback
        if lesson is not None:
            instance("lesson", lesson, Lesson)
        forbids = robot.keeps and environment.optimistic
        self.lesson = (FORBID if forbids else AVOID) if lesson is None else lesson
        self.detour = number("detour", detour, least=0)
        self.candidates = None if candidates is None else checked_candidates(candidates)

    def prepare(self) -> None:
        """Modify the problem, and have the solver begin."""
        self._unit = self.space.scale
        self._penalty = self.expansion_penalty * self._unit
        self._failures: list[tuple[Floats, Floats, float]] = []
        self._seek: tuple[Proof, ...] = (parted_workspace, parted_cells)
        self._begin(self.environment.environment(self.space.environment))
        if self.fallback is not None:
            self.fallback.reset(self.search)

    def _begin(self, environment: Environment) -> None:
        start, goal = self.search.start, self.goal
        try:
            easier = self.robot.space(self.space, environment, start)
            self.query = Query(easier, self._state(start), self._state(goal), self._doubts())
            self.solver.begin(self.query, self.rng, self.planner.step)
        except InvalidInputError as error:
            raise InvalidInputError(f"{error} (guidance {self.expression or self.name!r})") from error
        # How many of a configuration's coordinates are its state, where that is all that P does.
        self._leading = easier.dimension if self.robot.keeps else getattr(self.robot, "leading", None)
        self._states = np.zeros((0, easier.dimension))
        self._projected = 0
        self._least, self._least_of = (0, math.inf), _NO_TREE
        self._count_looks()

    def _doubts(self) -> Doubts | None:
        """What the environment modification believes of motions of r' in E.

        Raises:
            InvalidInputError: It believes something, and the solver cannot take it.
        """
        believe = getattr(self.environment, "doubts", None)
        if believe is None:
            return None
        if not getattr(self.solver, "doubts", False):
            raise InvalidInputError(
                "environment: expected a solver that asks about motions, such as roadmap, got "
                f"{type(self.solver).__name__}"
            )
        doubts: Doubts = believe(self.robot.space(self.space, self.space.environment, self.search.start))
        return doubts

    def _state(self, q: Floats) -> Floats:
        state: Floats = np.ascontiguousarray(self.robot.project(q[None])[0])
        return state

    def _count_looks(self, before: int = 0) -> None:
        """Whatever the solver looked at is counted among the search's collision checks."""
        looks = self.solver.looks - before
        if looks:
            self.search.collision_checks += looks
            self.search.looks += looks

    def project(self, tree: SearchTree, q: Floats) -> Floats:
        """P: (n, d) configurations to (n, d') states of C'."""
        return np.ascontiguousarray(self.robot.project(q))

    def heuristic(self, states: Floats) -> Floats:
        """(n,) the solver's cost-to-go (length)."""
        before = self.solver.looks
        h = self.solver(states)
        if self.solver.looks != before:
            self._count_looks(before)
        if getattr(self.solver, "sees", False):
            self.search.looks += len(states)
        return h

    def costs(self, tree: SearchTree) -> Floats:
        """(n,) the solver's cost-to-go of each node (length)."""
        n, before = len(tree), self.solver.looks
        if self.robot.keeps:
            states = tree.nodes.configurations[:n]
        else:
            if n > len(self._states):
                wider = np.zeros((2 * n, self._states.shape[1]))
                wider[: self._projected] = self._states[: self._projected]
                self._states = wider
            if n > self._projected:
                fresh = tree.nodes.configurations[self._projected : n]
                self._states[self._projected : n] = self.robot.project(fresh)
                self._projected = n
            states = self._states[:n]
        h = self.solver.follow(states)
        if self.solver.looks != before:
            self._count_looks(before)
        return h

    def values(self, tree: SearchTree) -> Floats:
        """(n,) h of each node (length), with its detour and the penalty for its expansions so far."""
        n, nodes = len(tree), tree.nodes
        h = self.costs(tree)
        total: Floats = charged(h, nodes.failures, nodes.children, self._penalty)
        if self.detour > 0 and math.isfinite(h[0]):
            total += self.detour * np.maximum(nodes.costs[:n] + h - h[0], 0.0)
        return total

    def least(self, tree: SearchTree) -> tuple[int, float]:
        """The node of least h, and its h; computed once per sample, however often it is asked for."""
        if self._least_of != tree.changes:
            self._least, self._least_of = self._find_least(tree), tree.changes
        return self._least

    def _find_least(self, tree: SearchTree) -> tuple[int, float]:
        if self.detour > 0 or type(self).values is not Composed.values:  # a subclass may charge otherwise
            return super().least(tree)
        nodes = tree.nodes
        found: tuple[int, float] = least_charged(
            self.costs(tree), nodes.failures, nodes.children, self._penalty
        )
        return found

    def select(self, tree: SearchTree) -> int:
        """The node of least h, or the fallback's choice while no node has a way."""
        if self._seek and (getattr(self.solver, "hopeless", False) or self._lost(tree)):
            self._seek_proof()
        if self.fallback is not None and self._lost(tree):
            return self.fallback.select(tree)
        return super().select(tree)

    def _lost(self, tree: SearchTree) -> bool:
        """Whether no node has a way."""
        return not math.isfinite(self.least(tree)[1])

    def _seek_proof(self) -> None:
        """Where no way is seen: perhaps there is none (see `guided_gym.guidance.proof`).

        Each try is made once, the dearer one only after some samples, beside which its time is small.
        """
        proofs = self._seek[0]
        if proofs is parted_workspace or self.search.samples >= _PATIENCE:
            self.no_path = proofs(self.space, self.search.task)
            self._seek = () if self.no_path else self._seek[1:]

    def distribution(self, tree: SearchTree) -> Floats:
        """(n,) the distribution P over the nodes from which `select` draws."""
        if self.fallback is not None and self._lost(tree):
            return self.fallback.distribution(tree)
        return super().distribution(tree)

    def propose(self, tree: SearchTree, node: int) -> Floats:
        """(d,) the candidate with the least h; the fallback's proposal while the node has no way.

        If the task ends in a region around the goal, a node within a step of the goal tries the goal itself
        first, since few candidates lie deep in the region.
        """
        if self.fallback is not None and not math.isfinite(self.costs(tree)[node]):
            return self.fallback.propose(tree, node)
        q = tree.nodes.configurations[node]
        untried = not (tree.nodes.children[node] or tree.nodes.failures[node])
        if (
            untried
            and not self.search.task.by_edge
            and separation(q, self.goal, self.space.metric) <= self.planner.step
        ):
            return self.goal.copy()
        candidates = self.planner.candidates(q, self.candidates)
        ahead = getattr(self.solver, "ahead", None)
        if ahead is not None and untried and self.robot.keeps:  # the same again would fail again
            candidates = np.vstack([candidates, ahead(self._state(q))])
        if self.query.doubts is not None:
            before = self.solver.looks
            origin, states = self._state(q), self.project(tree, candidates)
            choice: Floats = candidates[self.solver.choose(origin, states)]  # type: ignore[attr-defined]
            self._count_looks(before)
            return choice
        h = self._checked(self.heuristic(self.project(tree, candidates)), len(candidates))
        plausible = getattr(self.solver, "plausible", None)
        if plausible is not None:
            self.costs(tree)  # the solver has seen the node
            likely = plausible(node, separations(candidates, q, self.space.metric))
            h = np.where(likely, h, np.inf) if np.isfinite(h[likely]).any() else h
        best: Floats = candidates[h.argmin()]
        return best

    def burst(self, limit: int) -> NDArray[np.int32] | None:
        """Samples in one go, up to the first that fails, where the solver has a kernel for it.

        Only while nobody else listens to the search, and no proof is sought. A subclass may do otherwise.
        """
        grow, search = getattr(self.solver, "grow", None), self.search
        if (
            grow is None
            or type(self) is not Composed
            or search.listeners != [self]
            or self._leading is None
            or self.temperature > 0
            or self.fallback is not None
            or (self._seek and getattr(self.solver, "hopeless", False))
        ):
            return None
        count = self.planner.candidate_count if self.candidates is None else self.candidates
        terms = Terms(self._leading, count, self._penalty, self.detour)
        grown = grow(search, terms, min(limit, _BURST))
        if grown is None or not len(grown.rows):
            return None
        self._least_of = _NO_TREE
        rows: NDArray[np.int32] = grown.rows
        search.looks += grown.looks
        search.take_rows(rows, grown.outcome)
        if grown.outcome == FAILED:
            tree = search.tree
            last = tree.failed.targets[tree.failure_count - 1], tree.failed.contacts[tree.failure_count - 1]
            self.feedback(Expansion(int(rows[-1, 0]), last[0].copy(), NO_NODE, last[1].copy(), False))
        return rows

    def feedback(self, expansion: Expansion) -> None:
        """Teach the solver what a failure means, or have it begin anew in another E'."""
        self._least_of = _NO_TREE
        part = 1.0
        if expansion.contact is not None and self.lesson.foreseen != 1.0 and self._foresaw(expansion):
            part = self.lesson.foreseen
        if expansion.contact is not None and part > 0.0:
            failure = (self.search.tree.nodes.configurations[expansion.node], expansion.contact, part)
            self._failures.append(failure)
            revised = self.environment.revised(self.space, expansion.contact)
            if revised is None:
                self._teach(*failure)
            else:
                self._begin(revised)
                for earlier in self._failures:
                    self._teach(*earlier)
        if self.fallback is not None:
            self.fallback.feedback(expansion)

    def _foresaw(self, expansion: Expansion) -> bool:
        """Whether the solver would not have tried a motion: it sees no way from its end, or a wall before."""
        origin, target = self.search.tree.configurations[expansion.node], expansion.target[None]
        self.costs(self.search.tree)  # the solver has seen the node
        if not np.isfinite(self.heuristic(self.project(self.search.tree, target))[0]):
            return True
        plausible = getattr(self.solver, "plausible", None)
        length = separations(np.ascontiguousarray(target), origin, self.space.metric)
        return plausible is not None and not plausible(expansion.node, length)[0]

    def _teach(self, node: Floats, contact: Floats, part: float) -> None:
        lesson, before = self.lesson, self.solver.looks
        state = self._state(node if lesson.node else contact)
        if lesson.factor > 1:
            self.solver.raise_near(state, part * lesson.reach * self._unit, lesson.factor)
        if lesson.check > 0 and self.robot.keeps:
            self.solver.inspect(state, lesson.check * self._unit, self._valid)
        self._count_looks(before)

    def _valid(self, states: Floats) -> NDArray[np.bool_]:
        self.search.collision_checks += len(states)
        self.search.looks += len(states)
        valid: NDArray[np.bool_] = np.asarray(self.space.valid(np.ascontiguousarray(states)))
        return valid

    def drawing(self, values: bool = True) -> dict[str, Any]:
        """What a figure shows of the solver: a graph with h as ``values``, a field of h, or nothing."""
        draw = getattr(self.solver, "drawing", None)
        return draw(values) if draw is not None else {}
