"""Guided search as a Gymnasium environment: the tree is observed, a node chosen, the choice rewarded."""

from __future__ import annotations

import copy
import math
import operator
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, SupportsFloat, cast

import gymnasium
import numpy as np
import shapely
from gymnasium import spaces
from numpy.typing import NDArray

from guided_gym.catalogue.distributions import FixedProblem, OtherTasks, ProblemDistribution
from guided_gym.catalogue.problem_set import ProblemSet, open_problem_set
from guided_gym.catalogue.splits import Split, in_split
from guided_gym.catalogue.table import make_distribution
from guided_gym.checks import affordable, flag, integer, shown
from guided_gym.display.notebook import search_html
from guided_gym.display.pages import escaped
from guided_gym.doors import doors
from guided_gym.envs.observations import Observation, Observer, TreeObservation, node_bytes, valid_nodes
from guided_gym.envs.rewards import Choice, Reward, make_reward
from guided_gym.errors import (
    GuidedGymError,
    InvalidInputError,
    UnknownNameError,
    UnknownOptionError,
)
from guided_gym.guidance.base import GuidingSpace, draw
from guided_gym.guidance.registry import make_expander
from guided_gym.measure.target import Measure, sampling_efficiency
from guided_gym.options import (
    DEFAULT_CANDIDATES,
    DEFAULT_ORACLE,
    DEFAULT_TARGET,
    OracleOptions,
    SearchOptions,
    TargetParameters,
)
from guided_gym.problems import Problem, Task
from guided_gym.randomness import copied, spawn
from guided_gym.search.search import Search
from guided_gym.trajectories import path_length

if TYPE_CHECKING:
    from guided_gym.envs.rendering import Renderer

Action = int | NDArray[Any]

DEFAULT_NODES: Final = 256
NO_REGION: Final = -1
ACTIONS: Final = ("node", "distribution")
ON_INVALID: Final = ("noop", "raise")
RESET_OPTIONS: Final = ("problem", "start", "goal", "starts", "goals")
OPTIONS: Final = (
    "distribution",
    "split",
    "problems",
    "max_nodes",
    "max_samples",
    "expansion",
    "action",
    "reward",
    "on_invalid",
    "step",
    "candidates",
    "goal_tolerance",
    "goal_edge",
    "rewire",
    "target",
    "oracle",
    "observe",
    "raster",
    "target_in_info",
    "render_mode",
)


@doors
class GuidedSearchEnv(gymnasium.Env[Observation, Action]):
    """A growing search tree: choose the node to expand; the reward says how good the choice was.

    Description:
        One episode is one guided search (paper, Algorithm 1) for a problem drawn from a distribution. Each
        step is one sample: the chosen node is expanded towards a configuration in its neighbourhood; if the
        motion is certified free the tree grows by a node, if not the failure is recorded.

    Action space:
        ``action="node"``: ``Discrete(max_nodes)``, the node to expand. The nodes of the tree are valid
        (``observation["action_mask"]``, `action_masks`); there is always one.
        ``action="distribution"``: ``Box(0, 1, (max_nodes,))``, a weight for each node. Weights beyond the
        tree are ignored, the others are normalised to P (all of them zero: P is uniform), and the
        environment draws the node from P.

    Observation space:
        A flat ``Dict`` of padded arrays, see `guided_gym.envs.observations.TreeObservation`; or what
        ``observe`` gives. A PPO buffer over it takes
        ``environments * steps * (max_nodes * (4 * F + 9) + raster**2 + 64)`` bytes, F = 14 features (10 + 4 n
        for a robot of n angles): 341 MB for 8 environments x 2,048 steps at the defaults
        (`guided_gym.envs.observations.rollout_bytes`).

    Rewards:
        ``reward="efficiency"``: -SE, which is -D_KL(P || Q) against the smoothed target Q on the tree as it
        stood, so log Q(u) for a chosen node u. ``"regret"``: best possible - SE, 0 for the best choice.
        ``"jensen_shannon"``: -D_JS(P || Q). ``"sample"``: -1. Weights of several, like
        ``{"regret": 1, "sample": 0.1}``, add them up. 0 after the search has finished.

    Invalid actions:
        A node that does not exist, or weights that are negative or not numbers, count as a sample and change
        nothing. The reward is the worst possible (log epsilon for -SE and the regret), and
        ``info["invalid_action"]`` is True. ``on_invalid="raise"`` raises instead.

    Episode end:
        Terminated when a node has a valid edge to the goal; truncated after ``max_samples`` steps. Further
        steps change nothing and earn 0. If the start of a given problem sees the goal, the search has
        finished before it began: the first step terminates and earns 0. Of a distribution, problems like
        that and problems without a path are drawn again.

    Info:
        Always the same keys, and all are scalars: solved, samples, tree_size (nodes), collision_checks,
        invalid_action; sampling_efficiency and best_possible (-log max Q) of this step, NaN after a reset;
        cost (length of the path found, infinite while there is none); region (of the chosen node: which of
        ``list(problem.regions)``, -1 for none); oracle_error (estimated, relative, on average). With
        ``target_in_info`` also target, the (max_nodes,) Q over the observed tree, padded with zeros: it comes
        from the oracle and is meant for imitation learning.

    Randomness:
        ``reset(seed=k)`` gives the tree that ``guided_search(problem, guidance, seed=k)`` gives, if the same
        nodes are chosen.

    ``reset(options={"problem": problem})`` searches any `Problem`, for one episode. ``options={"start": q,
    "goal": q}`` pose another task in the problem that would be posed, so that one map serves many starts and
    goals; ``"starts"`` and ``"goals"`` are lists of configurations, one of which each reset draws (by its
    seed, if it has one). All of these may be combined.

    Args:
        distribution: Name in the catalogue, a distribution, or a problem.
        split: ``"train"``, ``"validation"`` or ``"test"``: draw from these problems only, and pose number k
            of them with ``reset(seed=k)``; None for the whole distribution.
        problems: A file that ``guided-gym problems build`` has built for this distribution, split and rule of
            ending: its problems are posed, with their oracles, so that no reset has to wait; number k of them
            with ``reset(seed=k)``. None draws and solves them as they are needed.
        max_nodes: Size of the padded arrays and of the action space; None for max_samples + 2, 256 if that
            is None, too.
        max_samples: Steps until truncation; None for max_nodes - 2. ``max_episode_steps`` of
            ``gymnasium.make`` can only make episodes shorter: the environment is not told of it.
        expansion: What proposes the configuration: ``"uniform"`` in the ball around the node, or a guiding
            space (a name, or an instance that is copied).
        action: ``"node"`` or ``"distribution"``.
        reward: A name, weights of names, or an object like `guided_gym.envs.rewards.Reward`.
        on_invalid: ``"noop"`` or ``"raise"``.
        step: Radius of the ball; None for the space's `scale`.
        candidates: Members of the ball that a guided expansion looks at.
        goal_tolerance: The search also ends this near to the goal; None for what the problem says.
        goal_edge: Whether a valid edge to the goal ends the search; None likewise.
        rewire: Rewire the tree as RRT* does.
        target: Parameters of the target distribution Q.
        oracle: Resolution and budget of the oracle behind Q.
        observe: The observer, an object like `guided_gym.envs.observations.Observer` (copied); None for the
            default.
        raster: Cells along each side of the default observation's raster.
        target_in_info: Whether info holds the target.
        render_mode: ``"rgb_array"``, ``"human"`` or None.

    Raises:
        UnknownNameError: An unknown name or option; the nearest one is suggested.
        InvalidInputError: A value that cannot be used.
        StorageError: A problem set that is missing, damaged, unfinished or of another version.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 30}  # noqa: RUF012

    def __init__(
        self,
        distribution: str | ProblemDistribution | Problem = "SimplePassage",
        *,
        split: str | Split | None = None,
        problems: str | Path | None = None,
        max_nodes: int | None = None,
        max_samples: int | None = None,
        expansion: str | GuidingSpace = "uniform",
        action: str = "node",
        reward: str | Mapping[str, float] | Reward = "efficiency",
        on_invalid: str = "noop",
        step: float | None = None,
        candidates: int = DEFAULT_CANDIDATES,
        goal_tolerance: float | None = None,
        goal_edge: bool | None = None,
        rewire: bool = False,
        target: TargetParameters = DEFAULT_TARGET,
        oracle: OracleOptions = DEFAULT_ORACLE,
        observe: Observer | None = None,
        raster: int = 64,
        target_in_info: bool = False,
        render_mode: str | None = None,
        **unknown: object,
    ) -> None:
        for name in unknown:
            raise UnknownOptionError("GuidedSearchEnv()", name, OPTIONS)
        _check_choice("action", action, ACTIONS)
        _check_choice("on_invalid", on_invalid, ON_INVALID)
        _check_choice("render_mode", render_mode, (None, *self.metadata["render_modes"]))
        self.max_nodes, self.max_samples = _checked_sizes(max_nodes, max_samples)
        self.distribution = _as_distribution(distribution)
        if split is not None:
            self.distribution = in_split(self.distribution, split)
        self.options = SearchOptions(
            step, candidates, rewire, _checked_target(target, self.max_nodes), oracle
        )
        Task([0.0], [1.0]).ending(goal_tolerance, goal_edge)  # refuses what is no rule
        self._ending = (goal_tolerance, goal_edge)
        if problems is not None:
            self.distribution = _built(problems, self.distribution, *self._ending)
        self.expansion = expansion  # as it was asked for; `expander` is who does it
        self.expander = _own_expander(expansion)
        self.action = action
        self.target_in_info = flag("target_in_info", target_in_info)
        self.render_mode = render_mode
        self.reward = make_reward(reward)
        self._raises = on_invalid == "raise"
        self.observer = _own_observer(observe, raster, self.distribution.angles)
        self._observed: spaces.Space[Any] = self.observer.build(self.max_nodes, self.max_samples)
        self.action_space = cast("spaces.Space[Action]", _action_space(action, self.max_nodes))
        self._search: Search | None = None
        self._renderer: Renderer | None = None

    @property
    def observation_space(self) -> spaces.Space[Observation]:  # type: ignore[override]
        """What observations look like; a copy, since wrappers (VecNormalize) write into what they get."""
        copied = copy.copy(self._observed)
        if isinstance(copied, spaces.Dict):
            copied.spaces = dict(copied.spaces)
        return cast("spaces.Space[Observation]", copied)

    @observation_space.setter
    def observation_space(self, space: spaces.Space[Observation]) -> None:
        self._observed = space

    # The search, for those who need more than the observation ---------------------------------------------

    @property
    def search(self) -> Search:
        """The search in progress; a new object after each reset.

        Raises:
            GuidedGymError: There was no reset yet.
        """
        if self._search is None:
            raise GuidedGymError("expected a search in progress, got an environment before its first reset()")
        return self._search

    @property
    def problem(self) -> Problem:
        """The problem of this episode."""
        return self.search.problem

    def attach(self, guidance: GuidingSpace) -> None:
        """Prepare a guiding space for this search and let it learn from each step; once is enough."""
        if not any(listener is guidance for listener in self.search.listeners):
            self.search.attach(guidance)

    @property
    def finished(self) -> bool:
        """Whether the episode has ended: further steps change nothing."""
        return self._terminated or self._truncated

    def clone(self) -> GuidedSearchEnv:
        """An environment that goes on as this one does, for tree search; some 100 us at 256 nodes.

        Problem, oracle and spaces are shared; ``copy.deepcopy`` shares nothing, and takes 20 times as long. A
        guiding space that expands is copied with all that it holds.

        Raises:
            GuidedGymError: There was no reset yet.
        """
        search = self.search
        other = copy.copy(self)
        other._search = search.clone()
        if self.expander is not None:
            k = next((k for k, one in enumerate(search.listeners) if one is self.expander), None)
            memo = search.shared_by(other._search)
            held = copy.deepcopy(self.expander, memo) if k is None else other._search.listeners[k]
            other.expander = cast("GuidingSpace", held)
        other.measure = self.measure.clone(other._search)
        observer = self.observer
        if type(observer) is TreeObservation:
            other.observer = observer.clone()
        else:
            other.observer = copy.deepcopy(observer)
        other._np_random = copied(self.np_random)
        other._regions = dict(self._regions)
        other._renderer = None
        return other

    def action_masks(self) -> NDArray[np.bool_]:
        """(max_nodes,) bool, True for the nodes that may be expanded (the name MaskablePPO looks for)."""
        return valid_nodes(self.search, self.max_nodes)

    def _repr_html_(self) -> str:
        """The search as it stands, for notebooks."""
        if self._search is None:
            return f"<div>{escaped(type(self).__name__)}: no search yet, before the first reset()</div>"
        return search_html(self._search)

    # Gymnasium --------------------------------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin a search.

        Args:
            seed: Seed of this and all later episodes; None to go on with the random numbers of the last.
            options: ``problem``, a `Problem` to search instead of drawing one; ``start`` and ``goal``,
                (d,) configurations to take the place of its own; ``starts`` and ``goals``, lists of such, of
                which one is drawn.

        Raises:
            NoPathError: The problem has no path.
            UnknownNameError: An unknown option.
            InvalidInputError: ``options["problem"]`` is not a problem.
        """
        distribution = self.distribution_for(options)
        seed = checked_seed(seed)
        super().reset(seed=seed)
        search = self.begin(distribution, self.np_random, seed)
        self.measure = Measure(search)  # solves the oracle: no path, no episode
        self.observer.reset(search)
        self._search = search
        self._invalid = 0
        self._efficiency = 0.0
        self._terminated, self._truncated = search.solved, False
        self._regions: dict[int, int] = {}
        self._areas = Areas(search.problem)
        if self.render_mode == "human":
            self.render()
        return self.observer.extract(search), self._info()

    def begin(self, distribution: ProblemDistribution, rng: np.random.Generator, seed: int | None) -> Search:
        """A new search for the next problem, or for that of a seed; ``rng`` is that of the episodes.

        Raises:
            NoPathError: No problem with a path could be drawn.
        """
        problem_rng, expansion_rng, guidance_rng = spawn(rng)
        if seed is None:
            problem = distribution.draw(problem_rng, *self._ending)
        else:
            problem = distribution.problem(seed, *self._ending)
        return Search(problem, expansion_rng, guidance_rng, self.options, self.max_nodes)

    def step(self, action: Action) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """One sample: expand the chosen node.

        Raises:
            InvalidInputError: An action of the wrong type or shape; with ``on_invalid="raise"``, an
                invalid one.
            GuidedGymError: There was no reset yet.
        """
        search = self.search
        if self.finished:
            info = self._info(0.0, 0.0)
            return self.observer.extract(search), 0.0, self._terminated, self._truncated, info
        choice = self._choose(search, action)
        if choice is None:
            reward = self.reward.worst(self.options.target)
            self._invalid += 1
            self._efficiency, best = float(-np.log(self.options.target.epsilon)), self.measure.choice(0)[1]
        else:
            reward = self.reward(choice)
            self._efficiency, best = choice.sampling_efficiency, choice.best_possible
            self.observer.update(search, search.expand(choice.node, self._propose(search, choice.node)))
        self._terminated = search.solved
        self._truncated = not search.solved and search.samples + self._invalid >= self.max_samples
        info = self._info(self._efficiency, best, invalid=choice is None)
        if choice is not None and search.problem.regions:
            info["region"] = self._region(search, choice.node)
        if self.render_mode == "human":
            self.render()
        return self.observer.extract(search), float(reward), self._terminated, self._truncated, info

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """A picture of the search: (H, W, 3) uint8 for ``"rgb_array"``, in a window for ``"human"``.

        Raises:
            GuidedGymError: pygame is not installed, or there was no reset yet.
        """
        if self.render_mode is None:
            gymnasium.logger.warn('render() needs a render_mode: gym.make(id, render_mode="rgb_array")')
            return None
        if self._renderer is None:
            from guided_gym.envs.rendering import Renderer

            self._renderer = Renderer(fps=self.metadata["render_fps"])
        if self.render_mode == "human":
            self._renderer.show(self.search, efficiency=self._efficiency)
            return None
        return self._renderer.frame(self.search, efficiency=self._efficiency)

    def close(self) -> None:
        """Close the window, if there is one; may be called again."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    # Parts of a step --------------------------------------------------------------------------------------

    def distribution_for(self, options: dict[str, Any] | None) -> ProblemDistribution:
        """Where the next problem comes from, given the options of `reset`.

        Raises:
            UnknownNameError: An unknown option.
            InvalidInputError: ``options["problem"]`` is not a problem.
        """
        for name in options or ():
            if name not in RESET_OPTIONS:
                raise UnknownNameError("reset option", name, RESET_OPTIONS)
        if not options:
            return self.distribution
        distribution = self.distribution
        if "problem" in options:
            problem = options["problem"]
            if not isinstance(problem, Problem):
                raise InvalidInputError(f"options['problem']: expected a Problem, got {shown(problem)}")
            distribution = FixedProblem(problem)
        starts, goals = _chosen(options, "start"), _chosen(options, "goal")
        return distribution if starts is goals is None else OtherTasks(distribution, starts, goals)

    def _propose(self, search: Search, node: int) -> NDArray[np.float64]:
        if self.expander is None:
            return search.planner.uniform(search.tree.nodes.configurations[node])
        # Attached only now, after whoever selects: `guided_search` does it in this order too.
        if not (search.listeners and search.listeners[-1] is self.expander):
            self.attach(self.expander)
        return self.expander.propose(search.tree, node)

    def _choose(self, search: Search, action: Action) -> Choice | None:
        """The measured choice that an action stands for; None for an invalid one."""
        if self.action == "node":
            node = as_index(action, "a node")
            if not 0 <= node < len(search.tree):
                self.refuse(f"a node from 0 to {len(search.tree) - 1}", node)
                return None
            efficiency, best = self.measure.choice(node)
            return Choice(self.measure, node, None, efficiency, best)
        weights = np.asarray(action, np.float64)
        if weights.shape != (self.max_nodes,):
            raise InvalidInputError(f"action: expected {self.max_nodes} weights, got shape {weights.shape}")
        weights = weights[: len(search.tree)]
        if not (np.isfinite(weights).all() and (weights >= 0).all()):
            self.refuse("finite weights >= 0", action)
            return None
        p = _normalised(weights)
        q = self.measure.distribution()
        return Choice(
            self.measure, draw(p, self.np_random), p, sampling_efficiency(p, q), -float(np.log(q.max()))
        )

    def refuse(self, expected: str, action: object) -> None:
        """Take note that an action is invalid.

        Raises:
            InvalidInputError: With ``on_invalid="raise"``.
        """
        if self._raises:
            raise InvalidInputError(f"action: expected {expected}, got {shown(action)}")

    def _info(
        self, efficiency: float = math.nan, best: float = math.nan, invalid: bool = False
    ) -> dict[str, Any]:
        search = self.search
        info: dict[str, Any] = {
            "solved": search.solved,
            "samples": search.samples + self._invalid,
            "tree_size": len(search.tree),
            "collision_checks": search.collision_checks,
            "invalid_action": invalid,
            "sampling_efficiency": float(efficiency),
            "best_possible": float(best),
            "cost": path_cost(search) if search.solved else math.inf,
            "region": NO_REGION,
            "oracle_error": self.measure.oracle.error.mean,
        }
        if self.target_in_info:
            q = self.measure.distribution()
            info["target"] = np.concatenate([q, np.zeros(self.max_nodes - q.size)])
        return info

    def _region(self, search: Search, node: int) -> int:
        """Index of the region that a node's reference point is in; NO_REGION outside all."""
        if node not in self._regions:
            q = search.tree.nodes.configurations[node]
            x, y = search.problem.robot.position(q).tolist()
            self._regions[node] = self._areas.of(x, y)
        return self._regions[node]


class Areas:
    """The areas of a problem's regions, quick to ask."""

    def __init__(self, problem: Problem) -> None:
        self._shapes = np.array(list(problem.regions.values()), dtype=object)
        shapely.prepare(self._shapes)
        # Most positions are told apart by boxes, which need no geometry.
        boxes = shapely.bounds(self._shapes).tolist()
        whole = [shape.equals(shape.envelope) for shape in self._shapes]
        self._boxes = list(zip(boxes, whole, self._shapes, strict=True))

    def of(self, x: float, y: float) -> int:
        """Which area a position is in, the first one of several; NO_REGION outside all."""
        for number, ((xmin, ymin, xmax, ymax), whole, shape) in enumerate(self._boxes):
            near = xmin <= x <= xmax and ymin <= y <= ymax
            if near and (whole or shapely.intersects_xy(shape, x, y)):
                return number
        return NO_REGION

    def of_many(self, xy: NDArray[np.float64]) -> NDArray[np.int64]:
        """(n,) likewise of (n, 2) positions, in one go."""
        inside = shapely.intersects_xy(self._shapes, xy[:, :1], xy[:, 1:])
        return np.where(inside.any(axis=1), inside.argmax(axis=1), NO_REGION)


def path_cost(search: Search) -> float:
    """Length of the shortest path found; infinite while there is none."""
    path = search.path() if search.solved else None
    return math.inf if path is None else path_length(search.space, path)


def checked_seed(seed: object) -> int | None:
    """A seed as gymnasium takes it.

    Raises:
        InvalidInputError: It is no integer >= 0 (a boolean is none), nor None.
    """
    return None if seed is None else integer("seed", seed, least=0)


def _normalised(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) probabilities of finite weights >= 0; uniform if all of them are 0."""
    largest = weights.max()
    if largest == 0:
        return np.full(weights.size, 1 / weights.size)
    scaled = weights / largest  # their sum may be too large for a number
    p: NDArray[np.float64] = scaled / scaled.sum()
    return p


def _check_choice(option: str, value: object, known: tuple[str | None, ...]) -> None:
    if value not in known:
        raise UnknownNameError(option, value, [str(name) for name in known])


def _checked_sizes(max_nodes: int | None, max_samples: int | None) -> tuple[int, int]:
    if max_samples is not None:
        max_samples = integer("max_samples", max_samples, least=1)
    if max_nodes is None:
        max_nodes = DEFAULT_NODES if max_samples is None else max(max_samples + 2, 3)
    max_nodes = integer("max_nodes", max_nodes, least=3)
    affordable("max_nodes", max_nodes, node_bytes(max_nodes), "the observation of a tree")
    if max_samples is None:
        return max_nodes, max_nodes - 2
    if max_nodes < max_samples + 1:
        raise InvalidInputError(
            f"max_nodes: expected at least max_samples + 1 = {max_samples + 1} (the root and a node per "
            f"sample), got {max_nodes}"
        )
    return max_nodes, max_samples


def _checked_target(target: TargetParameters, max_nodes: int) -> TargetParameters:
    if not isinstance(target, TargetParameters):
        raise InvalidInputError(f"target: expected TargetParameters, got {shown(target)}")
    if target.epsilon == 0:
        raise InvalidInputError("target: expected epsilon > 0 (log epsilon is a reward), got 0")
    if target.epsilon * max_nodes >= 1:
        # The target would be uniform there, and its SE worse than what an invalid action costs.
        raise InvalidInputError(
            f"max_nodes (max_samples + 2 unless given): expected fewer than 1 / epsilon = "
            f"{1 / target.epsilon:g}, got {max_nodes}"
        )
    return target


def _own_observer(observe: Observer | None, raster: int, angles: int) -> Observer:
    """The observer of one environment: a copy, since ``gym.make_vec`` gives all of them the same one."""
    if observe is None:
        return TreeObservation(raster, angles)
    for method in ("build", "reset", "update", "extract"):
        if not callable(getattr(observe, method, None)):
            raise InvalidInputError(
                f"observe: expected an object with a method {method}, got {shown(observe)}"
            )
    return copy.deepcopy(observe)


def _action_space(action: str, max_nodes: int) -> spaces.Space[Any]:
    if action == "node":
        return spaces.Discrete(max_nodes)
    return spaces.Box(0.0, 1.0, (max_nodes,), np.float32)


def _as_distribution(distribution: str | ProblemDistribution | Problem) -> ProblemDistribution:
    if isinstance(distribution, str):
        return make_distribution(distribution)
    if isinstance(distribution, Problem):
        return FixedProblem(distribution)
    if not isinstance(distribution, ProblemDistribution):
        raise InvalidInputError(
            f"distribution: expected a name, a ProblemDistribution or a Problem, got {shown(distribution)}"
        )
    return distribution


def _chosen(options: Mapping[str, Any], name: str) -> list[Any] | None:
    """The configurations that `reset` is given under ``name`` and its plural, of which one is posed."""
    several = f"{name}s"
    if name not in options and several not in options:
        return None
    if name in options and several in options:
        raise InvalidInputError(f"options: expected {name} or {several}, got both")
    given = options[several] if several in options else [options[name]]
    if isinstance(given, str | bytes | Mapping) or not hasattr(given, "__len__") or not len(given):
        raise InvalidInputError(
            f"options[{several!r}]: expected configurations, at least one, got {shown(given)}"
        )
    return list(given)


def _built(
    path: str | Path, distribution: ProblemDistribution, tolerance: float | None, by_edge: bool | None
) -> ProblemSet:
    """The problem set of a file, if it is one of that distribution."""
    if not isinstance(path, str | Path):
        raise InvalidInputError(f"problems: expected the name of a problem set's file, got {shown(path)}")
    problems = open_problem_set(path)
    problems.check(distribution, tolerance, by_edge)
    return problems


def _own_expander(expansion: str | GuidingSpace) -> GuidingSpace | None:
    """The guiding space that proposes; None for uniform.

    An instance is copied, since ``gym.make_vec`` gives one and the same to each of its environments.
    """
    if not isinstance(expansion, str | GuidingSpace):
        raise InvalidInputError(
            f"expansion: expected 'uniform' or a guiding space or its name, got {shown(expansion)}"
        )
    return make_expander(expansion) if isinstance(expansion, str) else copy.deepcopy(expansion)


def as_index(action: object, of: str) -> int:
    """An action as an integer; arrays of one element are taken, too.

    Raises:
        InvalidInputError: It is none.
    """
    if isinstance(action, np.ndarray) and action.size == 1:
        action = action.item()
    try:
        return operator.index(action)  # type: ignore[arg-type]
    except TypeError:
        raise InvalidInputError(f"action: expected the index of {of}, got {shown(action)}") from None
