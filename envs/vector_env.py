"""Many guided searches at once: a native vector environment, its step compiled over all of them."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from functools import partial
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from guided_gym.checks import affordable, integer, shown
from guided_gym.envs.guided_search_env import (
    NO_REGION,
    Areas,
    GuidedSearchEnv,
    checked_seed,
    path_cost,
)
from guided_gym.envs.observations import (
    MAX_COST,
    TreeObservation,
    columns_of,
    drawn_workspace,
    observed_pose,
    scales_of,
    shown_counts,
)
from guided_gym.envs.rewards import MeasuredReward
from guided_gym.errors import GuidedGymError, InvalidInputError, UnknownNameError, warn
from guided_gym.geometry.environment import Environment
from guided_gym.kernels import many as kernel
from guided_gym.kernels.extend import REACHED, REACHED_TOLERANCE, Failures, Nodes
from guided_gym.kernels.observe import SCALES
from guided_gym.measure.target import Measure
from guided_gym.problems import Problem
from guided_gym.search.search import Search

AHEAD: Final = 32
"""Random expansions that are drawn ahead for each environment."""
UNKNOWN: Final = -2  # a region that nobody has looked up
_MODES: Final = [mode.value for mode in AutoresetMode]
_GIVEN: Final = {  # what a step says, and what there is to say after a reset
    "sampling_efficiency": math.nan,
    "best_possible": math.nan,
    "cost": math.inf,
    "region": NO_REGION,
    "invalid_action": False,
}


def make_vector(
    num_envs: int = 1,
    *,
    autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    max_episode_steps: int | None = None,
    **options: Any,
) -> VectorEnv[Any, Any, Any]:
    """What ``gymnasium.make_vec`` makes of our ids: native where the options allow it, else one by one.

    Native are environments that choose nodes (``action="node"``), expand uniformly, observe the default
    observation and draw no pictures, with a reward that needs SE and the best possible alone. All others are
    a `gymnasium.vector.SyncVectorEnv`, with the same results for the same seeds.

    Args:
        num_envs: How many.
        autoreset_mode: ``"NextStep"``, ``"SameStep"`` or ``"Disabled"``.
        max_episode_steps: Steps until truncation, if fewer than ``max_samples``.
        **options: As in `GuidedSearchEnv`.

    Raises:
        UnknownNameError: An unknown name or option.
        InvalidInputError: A value that cannot be used, or more environments than memory is likely to hold.
    """
    num_envs = integer("num_envs", num_envs, least=1)
    mode = _checked_mode(autoreset_mode)
    limit = None if max_episode_steps is None else integer("max_episode_steps", max_episode_steps, least=1)
    template = GuidedSearchEnv(**options)
    size = vector_bytes(num_envs, template.max_nodes, options.get("raster", 64))
    affordable("num_envs", num_envs, size, "so many environments")
    if limit is not None and limit > template.max_samples:
        warn(
            f"max_episode_steps={limit}, but an episode ends after max_samples={template.max_samples} steps; "
            f"make the environments with max_samples={limit}"
        )
    if is_native(template):
        return GuidedSearchVectorEnv(template, num_envs, mode, limit)
    return SyncVectorEnv([partial(_single, options, limit)] * num_envs, autoreset_mode=mode)


def _single(options: dict[str, Any], limit: int | None) -> gymnasium.Env[Any, Any]:
    env = GuidedSearchEnv(**options)
    return env if limit is None else gymnasium.wrappers.TimeLimit(env, limit)


def is_native(env: GuidedSearchEnv) -> bool:
    """Whether the compiled step can do what this environment does."""
    return (
        env.action == "node"
        and env.expander is None
        and env.render_mode is None
        and type(env.observer) is TreeObservation
        and isinstance(env.reward, MeasuredReward)
        and not env.options.rewire
        and env.options.target.normalisation == "start"
    )


def vector_bytes(
    num_envs: int, max_nodes: int = 256, raster: int = 64, dimension: int = 3, angles: int = 1
) -> int:
    """Bytes that a native vector environment keeps, the problems' oracles apart.

    ``num_envs * (max_nodes * (24 d + 4 F + 61) + raster**2 + 256 (d + 1) + 420 + 32 n)`` for d dimensions
    and F = 10 + 4 n features for n angles; each step hands out a copy of
    ``num_envs * (max_nodes * (4 F + 5) + raster**2 + 32)``. An oracle takes some 0.9 MB; environments on one
    problem share it.
    """
    node = 24 * dimension + 4 * columns_of(angles) + 61
    ahead = 8 * AHEAD * (dimension + 1)
    return int(num_envs) * (int(max_nodes) * node + int(raster) ** 2 + ahead + 420 + 32 * angles)


def _checked_mode(mode: str | AutoresetMode) -> AutoresetMode:
    if isinstance(mode, AutoresetMode):
        return mode
    if mode not in _MODES:
        raise UnknownNameError("autoreset_mode", mode, _MODES)
    return AutoresetMode(mode)


class GuidedSearchVectorEnv(VectorEnv[Any, Any, Any]):
    """Guided searches in step; `make_vector` makes one.

    Bit by bit what so many `GuidedSearchEnv` do that are reset with the same seeds, in all three modes of
    autoreset; ``reset(options={"reset_mask": mask})`` resets some. Observations are copies.

    Args:
        template: An environment of the kind; it is not reset.
        num_envs: How many.
        autoreset_mode: When an environment that has ended begins again.
        limit: Steps until truncation, if fewer than ``max_samples``.
    """

    def __init__(
        self, template: GuidedSearchEnv, num_envs: int, autoreset_mode: AutoresetMode, limit: int | None
    ) -> None:
        self.num_envs = num_envs
        self.metadata = {**template.metadata, "autoreset_mode": autoreset_mode}
        self.render_mode = None
        self.single_observation_space = template.observation_space
        self.single_action_space = template.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.max_nodes, self.max_samples = template.max_nodes, template.max_samples
        self._mode, self._template = autoreset_mode, template
        self._limit = self.max_samples if limit is None else min(limit, self.max_samples)
        assert isinstance(template.reward, MeasuredReward) and isinstance(template.observer, TreeObservation)
        self._reward, self._raster_size = template.reward, template.observer.raster
        target = template.options.target
        self._angles, columns = template.observer.angles, template.observer.columns
        counts = shown_counts(self.max_samples)
        self._shared = kernel.Parameters(target.delta, target.tau, target.epsilon, columns, MAX_COST, counts)
        self._worst = float(self._reward.worst(target))
        self._allocate()

    def _allocate(self) -> None:
        n, m = self.num_envs, self.max_nodes
        self._episodes = _episodes(n, m, columns_of(self._angles))
        self._trees: dict[int, kernel.Trees] = {}  # by dimension
        self._dimension = np.zeros(n, np.int64)  # 0 before the first reset
        self._poses = np.zeros((2, n, 2 + 2 * self._angles), np.float32)
        self._raster = np.zeros((n, 1, self._raster_size, self._raster_size), np.uint8)
        self._drawn: list[tuple[Environment, NDArray[np.uint8]] | None] = [None] * n
        self._searches: list[Search | None] = [None] * n
        self._measures: list[Measure | None] = [None] * n
        self._areas: list[tuple[Problem, Areas] | None] = [None] * n
        self._next_number = 0
        self._rngs: list[np.random.Generator | None] = [None] * n
        self._seeds = [-1] * n
        self._regions = np.full((n, m), UNKNOWN)
        self._area_numbers = np.zeros(n, np.int64)  # the same for environments on one problem
        self._terminated, self._truncated = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
        self._ended = np.zeros(n, np.bool_)  # in the last step: to be reset
        self._said = {key: np.full(n, value) for key, value in _GIVEN.items()}
        self._said["oracle_error"] = np.full(n, math.nan)

    # What there is to ask ---------------------------------------------------------------------------------

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override,misc]
        """The generators of the environments."""
        return tuple(self._rng(i) for i in range(self.num_envs))

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """The seeds of the environments."""
        return tuple(self._seeds)

    def search(self, index: int) -> Search:
        """The search of one environment as it stands; a new object after each of its resets.

        Its arrays are those that the next step changes.

        Raises:
            GuidedGymError: There was no reset yet.
        """
        search = self._searches[index]
        if search is None:
            raise GuidedGymError("expected a search in progress, got an environment before its first reset()")
        counts = self._episodes.counts[index]
        nodes = int(counts[kernel.SIZE]) - len(search.tree)
        failures = int(counts[kernel.FAILURES]) - search.tree.failure_count
        if nodes or failures:
            checks = int(counts[kernel.CHECKS]) - search.collision_checks
            search.take_in(nodes, failures, checks, bool(self._terminated[index]) and not search.solved)
        return search

    def action_masks(self) -> NDArray[np.bool_]:
        """(num_envs, max_nodes) bool, True for the nodes that may be expanded."""
        return self._episodes.mask.astype(np.bool_)

    # Gymnasium --------------------------------------------------------------------------------------------

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Begin a search in each environment, or in some.

        Args:
            seed: One for each environment, or one that is counted up; None to go on with the random numbers.
            options: ``{"problem": Problem}`` to search that one; ``{"reset_mask": mask}``, (num_envs,) bool,
                to reset some. Nothing is taken out of the dictionary.

        Raises:
            InvalidInputError: Seeds or a mask of another form.
            NoPathError: A problem has no path.
        """
        seeds = self._checked_seeds(seed)
        rest = {name: value for name, value in (options or {}).items() if name != "reset_mask"}
        mask = self._checked_mask(options)
        distribution = self._template.distribution_for(rest)
        for i in np.flatnonzero(mask).tolist():
            self._begin(i, distribution, seeds[i])
        return self._observation(), self._infos(mask)

    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[
        dict[str, NDArray[Any]], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]
    ]:
        """One sample in each environment.

        Args:
            actions: (num_envs,) the nodes to expand.

        Raises:
            InvalidInputError: Actions of another form; with ``on_invalid="raise"``, one that is invalid.
            GuidedGymError: There was no reset yet, or an environment that ended was not reset
                (``autoreset_mode="Disabled"``).
        """
        stepped, again = self._who()
        actions = self._checked_actions(actions, stepped)
        self._advance(actions, stepped)
        rewards = self._rewards(stepped)
        infos: dict[str, Any] = {}
        ended = self._terminated | self._truncated
        if self._mode == AutoresetMode.SAME_STEP and ended.any():
            infos = self._final(ended)
            again = np.flatnonzero(ended)
        flags = self._terminated.copy(), self._truncated.copy()
        for i in again.tolist():
            self._begin(i, self._template.distribution, None)
            if self._mode == AutoresetMode.NEXT_STEP:
                flags[0][i] = flags[1][i] = False
                rewards[i] = 0.0
        self._ended = np.logical_or(*flags)
        return self._observation(), rewards, *flags, infos | self._infos(np.ones(self.num_envs, np.bool_))

    def close_extras(self, **kwargs: Any) -> None:
        """Nothing is open."""

    # Parts of a step --------------------------------------------------------------------------------------

    def _who(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(environments to step, environments to reset)."""
        if not self._dimension.all():
            raise GuidedGymError("expected a search in progress, got an environment before its first reset()")
        nobody = np.zeros(0, np.int64)
        if not self._ended.any() or self._mode == AutoresetMode.SAME_STEP:
            return np.arange(self.num_envs), nobody
        if self._mode == AutoresetMode.DISABLED:
            raise GuidedGymError(
                f"expected reset(options={{'reset_mask': mask}}) of the environments that have "
                f"ended, {np.flatnonzero(self._ended).tolist()}; got a step"
            )
        return np.flatnonzero(~self._ended), np.flatnonzero(self._ended)

    def _checked_actions(self, actions: object, stepped: NDArray[np.int64]) -> NDArray[np.int64]:
        array = np.asarray(actions)
        if array.shape != (self.num_envs,) or array.dtype.kind not in "iub":
            raise InvalidInputError(
                f"actions: expected {self.num_envs} indices of nodes, got {array.dtype} of shape "
                f"{array.shape}"
            )
        sizes = self._episodes.counts[:, kernel.SIZE]
        nodes = np.where((array >= 0) & (array < self.max_nodes), array, -1).astype(np.int64)
        wrong = ((nodes < 0) | (nodes >= sizes))[stepped]
        if wrong.any():
            i = int(stepped[np.argmax(wrong)])
            self._template.refuse(f"a node from 0 to {sizes[i] - 1} in environment {i}", int(array[i]))
        return nodes

    def _advance(self, actions: NDArray[np.int64], stepped: NDArray[np.int64]) -> None:
        """Have the kernel step these environments, and finish what it leaves to Python."""
        episodes = self._episodes
        episodes.outcome[self._terminated | self._truncated] = kernel.ENDED
        for d, trees in self._trees.items():
            rows = stepped[self._dimension[stepped] == d]
            for i in rows[episodes.counts[rows, kernel.DRAWN] == AHEAD].tolist():
                self._refill(i, trees)
            kernel.step_many(actions, rows, trees, episodes, self._shared)
            for i in rows[episodes.lost[rows]].tolist():
                self._find(i, trees)
        outcome = episodes.outcome[stepped]
        self._said["invalid_action"][stepped] = outcome == kernel.REFUSED
        self._said["sampling_efficiency"][stepped] = episodes.efficiency[stepped]
        self._said["best_possible"][stepped] = episodes.best[stepped]
        self._terminated[stepped] |= (outcome == REACHED) | (outcome == REACHED_TOLERANCE)
        done = self._samples()[stepped] >= self._limit
        self._truncated[stepped] |= done & ~self._terminated[stepped]
        chosen = stepped[outcome >= 0]
        self._look_up(chosen, actions[chosen])
        self._said["region"][stepped] = NO_REGION
        self._said["region"][chosen] = self._regions[chosen, actions[chosen]]
        for i in stepped[(outcome == REACHED) | (outcome == REACHED_TOLERANCE)].tolist():
            self._said["cost"][i] = path_cost(self.search(i))

    def _refill(self, i: int, trees: kernel.Trees) -> None:
        search = self._searches[i]
        assert search is not None
        kernel.refill(search.planner.rng, trees.normals[i], trees.radii[i])
        self._episodes.counts[i, kernel.DRAWN] = 0

    def _find(self, i: int, trees: kernel.Trees) -> None:
        """The grid knows no way from the newest node: ask the oracle, which has finer ones."""
        measure, episodes = self._measures[i], self._episodes
        assert measure is not None
        n = int(episodes.counts[i, kernel.SIZE]) - 1
        tau = float(measure.oracle.cost_to_go(trees.configurations[i, n]))
        kernel.settle(i, n, int(trees.parents[i, n]), tau, trees, episodes, self._shared)
        episodes.lost[i] = False

    def _look_up(self, rows: NDArray[np.int64], nodes: NDArray[np.int64]) -> None:
        """Which regions the chosen nodes are in, problem by problem; once for each node."""
        new = self._regions[rows, nodes] == UNKNOWN
        rows, nodes = rows[new], nodes[new]
        for number in np.unique(self._area_numbers[rows]).tolist():
            here = self._area_numbers[rows] == number
            i, node = rows[here], nodes[here]
            areas = self._areas[i[0]]
            assert areas is not None
            q = np.empty((i.size, 2))
            for d, trees in self._trees.items():
                own = self._dimension[i] == d
                if own.any():
                    q[own] = areas[0].robot.position(trees.configurations[i[own], node[own]])
            self._regions[i, node] = areas[1].of_many(q)

    def _rewards(self, stepped: NDArray[np.int64]) -> NDArray[np.float64]:
        rewards = np.zeros(self.num_envs)
        episodes = self._episodes
        outcome = episodes.outcome[stepped]
        values = self._reward.of(episodes.efficiency[stepped], episodes.best[stepped])
        values = np.where(outcome == kernel.REFUSED, self._worst, values)
        rewards[stepped] = np.where(outcome == kernel.ENDED, 0.0, values)
        return rewards

    # What is handed out -----------------------------------------------------------------------------------

    def _observation(self) -> dict[str, NDArray[Any]]:
        """Fresh copies of all arrays, in the order of the single environment."""
        episodes = self._episodes
        return {
            "nodes": episodes.nodes.copy(),
            "parents": episodes.parents.copy(),
            "action_mask": episodes.mask.copy(),
            "start": self._poses[0].copy(),
            "goal": self._poses[1].copy(),
            "raster": self._raster.copy(),
        }

    def _samples(self) -> NDArray[np.int64]:
        counts = self._episodes.counts
        samples: NDArray[np.int64] = counts[:, kernel.SAMPLES] + counts[:, kernel.INVALID]
        return samples

    def _infos(self, mask: NDArray[np.bool_]) -> dict[str, Any]:
        """The infos of the environments in the mask, as gymnasium stacks them."""
        counts = self._episodes.counts
        values: dict[str, NDArray[Any]] = {
            "solved": np.isfinite(self._said["cost"]),
            "samples": self._samples(),
            "tree_size": counts[:, kernel.SIZE],
            "collision_checks": counts[:, kernel.CHECKS],
            **{key: self._said[key] for key in ("invalid_action", "sampling_efficiency", "best_possible")},
            **{key: self._said[key] for key in ("cost", "region", "oracle_error")},
        }
        if self._template.target_in_info:
            values["target"] = self._targets(mask)
        everybody = mask.all()
        infos: dict[str, Any] = {}
        for key, value in values.items():
            given = value.copy()
            if not everybody:
                given[~mask] = 0
            infos[key], infos[f"_{key}"] = given, mask.copy()
        return infos

    def _targets(self, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """(num_envs, max_nodes) Q over the trees, padded with zeros."""
        targets = np.zeros((self.num_envs, self.max_nodes))
        for i in np.flatnonzero(mask).tolist():
            self.search(i)
            measure = self._measures[i]
            assert measure is not None
            q = measure.distribution()
            targets[i, : q.size] = q
        return targets

    def _final(self, ended: NDArray[np.bool_]) -> dict[str, Any]:
        """Last observation and info of the environments that have ended, as gymnasium hands them out."""
        whole = self._observation()
        last = np.full(self.num_envs, None, dtype=object)
        for i in np.flatnonzero(ended).tolist():
            last[i] = {key: value[i].copy() for key, value in whole.items()}
        info = self._infos(ended)
        return {
            "final_obs": last,
            "_final_obs": ended.copy(),
            "final_info": info,
            "_final_info": ended.copy(),
        }

    # A new search -----------------------------------------------------------------------------------------

    def _rng(self, i: int) -> np.random.Generator:
        rng = self._rngs[i]
        if rng is None:
            rng, self._seeds[i] = np_random(None)
            self._rngs[i] = rng
        return rng

    def _begin(self, i: int, distribution: Any, seed: int | None) -> None:
        """A new search in environment i."""
        if seed is not None:
            self._rngs[i], self._seeds[i] = np_random(seed)
        search = self._template.begin(distribution, self._rng(i), seed)
        self._template.observer.reset(search)  # refuses robots that it cannot show
        measure = Measure(search)  # solves the oracle: no path, no episode
        d = search.space.dimension
        if d not in self._trees:
            self._trees[d] = _trees(self.num_envs, self.max_nodes, d)
        trees = self._trees[d]
        self._searches[i], self._measures[i], self._dimension[i] = search, measure, d
        self._house(i, search, trees)
        self._describe(i, search, measure)
        self._refill(i, trees)
        tau = float(measure.oracle.cost_to_go(search.start))
        kernel.settle(i, 0, -1, tau, trees, self._episodes, self._shared)
        kernel.observe_node(i, 0, trees, self._episodes, self._shared)
        self._terminated[i], self._truncated[i] = search.solved, False
        self._ended[i] = False
        for key, value in _GIVEN.items():
            self._said[key][i] = value
        self._said["cost"][i] = path_cost(search)
        self._said["oracle_error"][i] = measure.oracle.error.mean

    def _house(self, i: int, search: Search, trees: kernel.Trees) -> None:
        """Let the tree of a new search live in row i."""
        for stacked in trees[2:8]:
            stacked[i] = 0
        tree = search.tree
        old = tree.nodes
        tree.nodes = Nodes(*(stacked[i] for stacked in trees[:6]))
        tree.failed = Failures(*(stacked[i] for stacked in trees[6:9]))
        tree.nodes.configurations[0] = old.configurations[0]
        tree.nodes.parents[0] = old.parents[0]
        trees.goals[i] = search.goal

    def _describe(self, i: int, search: Search, measure: Measure) -> None:
        """Tell the kernel what a search is about."""
        episodes, problem = self._episodes, search.problem
        task, optimum = problem.task, measure.optimum
        episodes.counts[i] = (1, 0, 0, 0, search.collision_checks, AHEAD)
        episodes.rules[i] = search.planner.step, task.tolerance, task.by_edge, optimum, optimum or 1.0
        episodes.scales[i] = scales_of(search, self._angles)
        field, links, frame, _ = measure.oracle.state
        arrays = (*search.space.geometry, field, links, frame, *search.space.metric)
        # By address: an oracle has a million numbers. The search and its measure keep the arrays alive.
        episodes.worlds[i] = [number for array in arrays for number in (array.ctypes.data, array.size)]
        episodes.nodes[i], episodes.parents[i], episodes.mask[i] = 0, -1, 0
        episodes.outcome[i], episodes.lost[i] = 0, False
        self._poses[:, i] = [
            observed_pose(search, q, episodes.scales[i]) for q in (search.start, search.goal)
        ]
        self._raster[i] = self._workspace(i, problem.environment)
        self._regions[i] = UNKNOWN if problem.regions else NO_REGION
        if problem.regions:
            self._share_areas(i, problem)

    def _share_areas(self, i: int, problem: Problem) -> None:
        """Prepare the regions of a problem, unless another environment has them already."""
        for j, known in enumerate(self._areas):
            if known is not None and known[0] is problem:
                self._areas[i], self._area_numbers[i] = known, self._area_numbers[j]
                return
        self._areas[i], self._area_numbers[i] = (problem, Areas(problem)), self._next_number
        self._next_number += 1

    def _workspace(self, i: int, environment: Environment) -> NDArray[np.uint8]:
        drawn = self._drawn[i]
        if drawn is None or drawn[0] is not environment:
            others = (d for d in self._drawn if d is not None and d[0] is environment)
            drawn = next(others, None) or (environment, drawn_workspace(environment, self._raster_size))
            self._drawn[i] = drawn
        return drawn[1]

    # What comes in ----------------------------------------------------------------------------------------

    def _checked_seeds(self, seed: object) -> list[int | None]:
        n = self.num_envs
        if isinstance(seed, Sequence | np.ndarray) and not isinstance(seed, str):
            if len(seed) != n:
                raise InvalidInputError(
                    f"seed: expected {n} seeds, one for each environment, got {len(seed)}"
                )
            return [checked_seed(one) for one in seed]
        first = checked_seed(seed)
        return [None if first is None else first + i for i in range(n)]

    def _checked_mask(self, options: dict[str, Any] | None) -> NDArray[np.bool_]:
        if not options or "reset_mask" not in options:
            return np.ones(self.num_envs, np.bool_)
        mask = options["reset_mask"]
        good = isinstance(mask, np.ndarray) and mask.shape == (self.num_envs,) and mask.dtype == np.bool_
        if not good or not mask.any():
            raise InvalidInputError(
                f"options['reset_mask']: expected ({self.num_envs},) booleans, at least one of them True, "
                f"got {shown(mask)}"
            )
        if not (self._dimension.astype(bool) | mask).all():
            raise GuidedGymError("expected a reset of all environments before a reset of some, got none")
        return copy.copy(mask)


def _episodes(n: int, m: int, columns: int) -> kernel.Episodes:
    return kernel.Episodes(
        counts=np.zeros((n, kernel.COUNTS), np.int64),
        rules=np.zeros((n, kernel.RULES)),
        scales=np.zeros((n, SCALES)),
        worlds=np.zeros((n, kernel.WORLD), np.int64),
        tau=np.zeros((n, m)),
        energy=np.zeros((n, m)),
        nodes=np.zeros((n, m * columns), np.float32),
        parents=np.full((n, m), -1, np.int32),
        mask=np.zeros((n, m), np.int8),
        efficiency=np.zeros(n),
        best=np.zeros(n),
        outcome=np.zeros(n, np.int8),
        lost=np.zeros(n, np.bool_),
    )


def _trees(n: int, m: int, d: int) -> kernel.Trees:
    return kernel.Trees(
        configurations=np.zeros((n, m, d)),
        parents=np.full((n, m), -1, np.int32),
        costs=np.zeros((n, m)),
        depths=np.zeros((n, m), np.int32),
        children=np.zeros((n, m), np.int32),
        failures=np.zeros((n, m), np.int32),
        failed_nodes=np.zeros((n, m), np.int32),
        failed_targets=np.zeros((n, m, d)),
        contacts=np.zeros((n, m, d)),
        goals=np.zeros((n, d)),
        normals=np.zeros((n, AHEAD, d)),
        radii=np.zeros((n, AHEAD)),
    )
