"""One search in OMPL's terms: its space, problem and planner, and the questions that it asks us."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from guided_gym.errors import InvalidInputError
from guided_gym.planners.spaces import StateSpace
from guided_gym.problems import Problem
from guided_gym.search.watch import State, Watch


class Answers(Protocol):
    """What answers OMPL's questions, such as a `Watch`."""

    @property
    def over(self) -> bool:
        """Whether the planner may stop."""

    def look(self, state: State) -> None:
        """Note that a state was looked at."""

    def motion(self, first: State, second: State) -> bool:
        """Whether a motion is free."""


class Questions:
    """The questions that OMPL asks while it plans.

    It holds nothing that refers to OMPL's objects, which hold it: nobody could ever free the two. What goes
    wrong is kept and raised when OMPL has returned: its threads must not be left as they are.

    Attributes:
        watch: Who answers whether motions are free; None where OMPL checks them itself.
        ending: OMPL's condition to end, to be told that the search is over.
        looks: How many states were looked at.
        trouble: What went wrong.
    """

    def __init__(self, states: StateSpace) -> None:
        self._read, self._configuration, self._space = states.read, states.configuration, states.space
        self.watch: Answers | None = None
        self.ending: Any = None
        self.looks = 0
        self.trouble: BaseException | None = None

    def valid(self, state: Any) -> bool:
        """Whether a state is free."""
        self.looks += 1
        try:
            values = self._read(state)
            if self.watch is not None:
                self.watch.look(values)
            return bool(self._space.valid(self._configuration(values)))
        except BaseException as error:
            return self._end(error)

    def free(self, first: Any, second: Any) -> bool:
        """Whether a motion is free."""
        watch = self.watch
        if watch is None or self.trouble is not None:
            return False
        try:
            answer = watch.motion(self._read(first), self._read(second))
        except BaseException as error:
            return self._end(error)
        if watch.over:
            self._end(None)
        return answer

    def _end(self, error: BaseException | None) -> bool:
        self.trouble = self.trouble or error
        if self.ending is not None:
            self.ending.terminate()
        return False


class Query:
    """OMPL's objects for one search, ready to plan.

    Args:
        ompl: The package `ompl`.
        problem: The problem.
        planner: The planner's name.
        parameters: Its setters and their values.
        cut: Whether angles are plain numbers.
        seed: Of OMPL's random numbers.
        resolution: Of OMPL's own check of motions; 0 to have a `Watch` check them.
        first: Whether any path is good enough.

    Raises:
        InvalidInputError: OMPL refuses the space: some planners sample in some kinds of spaces only.
    """

    def __init__(
        self,
        ompl: Any,
        problem: Problem,
        planner: str,
        parameters: Sequence[tuple[str, Any]] = (),
        *,
        cut: bool = False,
        seed: int = 1,
        resolution: float = 0.0,
        first: bool = True,
    ) -> None:
        self._ompl, self._first, base = ompl, first, ompl.base
        self.states = StateSpace(base, problem.space, cut)
        self.questions = Questions(self.states)
        with quiet(ompl):
            ompl.util.RNG.setSeed(seed)  # before anything draws; OMPL complains of a late one, and takes it
            self.information = base.SpaceInformation(self.states.ompl)
            self.information.setStateValidityChecker(self.questions.valid)
            if resolution:
                self.information.setStateValidityCheckingResolution(resolution)
            else:
                kind = _validator(base.MotionValidator)
                self.information.setMotionValidator(kind(self.information, self.questions.free))
            self.information.setup()
            start, goal = self.states.state(problem.task.start), self.states.state(problem.task.goal)
            self.ends = self.states.read(start), self.states.read(goal)
            self.definition = base.ProblemDefinition(self.information)
            near = max(problem.task.tolerance, 1e-9 * problem.space.extent)
            self.definition.setStartAndGoalStates(start, goal, near)
            objective = base.PathLengthOptimizationObjective(self.information)
            objective.setCostThreshold(objective.infiniteCost() if first else base.Cost(0.0))
            self.definition.setOptimizationObjective(objective)
            self.planner = getattr(ompl.geometric, planner)(self.information)
            for setter, value in parameters:
                getattr(self.planner, setter)(value)
            self.planner.setProblemDefinition(self.definition)
            self._checked(self.planner.setup)  # before it can be freed: some planners cannot without

    def solve(self, seconds: float, watch: Answers | None = None) -> NDArray[np.float64] | None:
        """Plan for so long at most; returns the path that OMPL calls exact, if there is one."""
        questions = self.questions
        questions.watch = watch
        base = self._ompl.base
        questions.ending = base.timedPlannerTerminationCondition(seconds)
        if self._first and not isinstance(watch, Watch):  # AORRTC knows no path that is good enough
            questions.ending = base.plannerOrTerminationCondition(
                questions.ending, base.exactSolnPlannerTerminationCondition(self.definition)
            )
        try:
            with quiet(self._ompl):
                self._checked(lambda: self.planner.solve(questions.ending))
        finally:  # OMPL holds the questions, and a condition that looks for a solution holds OMPL's problem
            questions.watch = questions.ending = None
        if questions.trouble is not None:
            raise questions.trouble
        if not self.definition.hasExactSolution():
            return None
        path = self.definition.getSolutionPath()
        states = [self.states.read(path.getState(i)) for i in range(path.getStateCount())]
        return np.array([self.states.configuration(state) for state in states])

    def _checked(self, call: Callable[[], object]) -> None:
        """Call OMPL, which raises where a planner does not know how to sample in the space."""
        try:
            call()
        except RuntimeError as error:
            if self.questions.trouble is None:
                raise InvalidInputError(
                    f"ompl:{self.planner.getName()}: OMPL refuses this robot's space "
                    f"({str(error).partition(chr(10))[0]}); angles=cut makes its angles plain numbers"
                ) from error

    def edges(self) -> list[tuple[State, State]]:
        """The edges of the planner's own data."""
        data = self._ompl.base.PlannerData(self.information)
        self.planner.getPlannerData(data)
        states = [self.states.read(data.getVertex(i).getState()) for i in range(data.numVertices())]
        return [(states[i], states[j]) for i in range(len(states)) for j in data.getEdges(i)]


@cache
def _validator(kind: Any) -> Any:
    """The class of OMPL's motion validator that asks a function of ours; one for all searches."""

    class Validator(kind):  # type: ignore[misc]
        def __init__(self, information: Any, check: Callable[[Any, Any], bool]) -> None:
            super().__init__(information)
            self._check = check

        def checkMotion(self, first: Any, second: Any) -> bool:  # noqa: N802  OMPL's name
            return self._check(first, second)

    return Validator


@contextmanager
def quiet(ompl: Any) -> Iterator[None]:
    """Hold back OMPL's messages, and restore their level afterwards."""
    level = ompl.util.getLogLevel()
    ompl.util.setLogLevel(ompl.util.LOG_NONE)
    try:
        yield
    finally:
        ompl.util.setLogLevel(level)
