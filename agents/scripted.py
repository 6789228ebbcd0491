"""Scripted policies: guiding spaces that act in the environment, and random ones for comparison."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

import gymnasium
import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import integer, shown
from guided_gym.doors import door, doors
from guided_gym.envs.guided_search_env import GuidedSearchEnv
from guided_gym.errors import GuidedGymError, InvalidInputError, UnknownOptionError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.registry import check_name, guidance_names, make_guidance, read_guidance
from guided_gym.search.search import Search

Observation = Mapping[str, NDArray[Any]]
Action = int | NDArray[np.float32]


class Agent(Protocol):
    """Anything that acts in the environment."""

    name: str

    def reset(self, env: gymnasium.Env[Any, Any]) -> None:
        """Begin an episode in ``env``, which has been reset."""

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """The action for an observation."""


@doors
class GuidanceAgent:
    """A guiding space that acts: it selects the nodes, as in `guided_search`.

    It needs the search tree itself, not just the observation, and takes it from ``env.unwrapped``: so it
    acts in a `GuidedSearchEnv`, wrapped or not, but not in a vector of them. Given the environment once, it
    notices by itself when that is reset, and gets ready for the new search. Where the environment draws the
    node from weights (``action="distribution"``), it acts with the guiding space's whole distribution P.

    If the environment expands by the same guiding space (its ``expansion`` is the same name or the same
    instance), both are one: what it learns from selecting serves proposing, as in `guided_search`.

    Args:
        guidance: A name (see `guided_gym.make_guidance`) or a guiding space.
        env: The environment to act in; may be given to `reset` instead.
        **options: Options of the guiding space, with a name.

    Raises:
        UnknownNameError: No such guiding space or option.
        InvalidInputError: ``env`` is not a `GuidedSearchEnv`.
    """

    def __init__(
        self, guidance: str | GuidingSpace, /, env: gymnasium.Env[Any, Any] | None = None, **options: Any
    ) -> None:
        self.guidance = self._own = make_guidance(guidance, **options)
        self.name = guidance if isinstance(guidance, str) else self._own.name
        self._asked = None if options else guidance
        self._env: GuidedSearchEnv | None = None if env is None else _unwrapped(env)
        self._search: Search | None = None

    def reset(self, env: gymnasium.Env[Any, Any]) -> None:
        """Get ready for the search in ``env``, which has been reset.

        Raises:
            InvalidInputError: Not a `GuidedSearchEnv`.
            GuidedGymError: The environment was never reset.
        """
        self._env = _unwrapped(env)
        self._begin(self._env)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """The node to expand; where the environment wants weights, (max_nodes,) float32 weights.

        Raises:
            GuidedGymError: The agent was never given an environment.
        """
        if self._env is None:
            raise GuidedGymError(
                f"agent {self.name!r}: expected reset(env) before act(), since it needs the search tree"
            )
        if self._env.search is not self._search:
            self._begin(self._env)
        tree = self._env.search.tree
        if self._env.action == "node":
            return self.guidance.select(tree)
        weights = np.zeros(self._env.max_nodes, np.float32)
        weights[: len(tree)] = self.guidance.distribution(tree)
        return weights

    def _begin(self, env: GuidedSearchEnv) -> None:
        shared = env.expander is not None and _same(self._asked, env.expansion)
        self.guidance = env.expander if shared and env.expander is not None else self._own
        env.attach(self.guidance)
        self._search = env.search


def _same(guidance: str | GuidingSpace | None, expansion: str | GuidingSpace) -> bool:
    if isinstance(guidance, str) and isinstance(expansion, str):
        return read_guidance(guidance) == read_guidance(expansion)
    return guidance is expansion


def _unwrapped(env: gymnasium.Env[Any, Any]) -> GuidedSearchEnv:
    inner = getattr(env, "unwrapped", env)
    if not isinstance(inner, GuidedSearchEnv):
        raise InvalidInputError(f"env: expected a GuidedSearchEnv (wrapped or not), got {shown(inner)}")
    return inner


@doors
class RandomAgent:
    """Samples the action space, or only its valid part.

    Args:
        seed: Seed of the choices.
        masked: Whether to choose among the valid nodes only.
        env: The environment to act in; may be given to `reset` instead.
    """

    def __init__(
        self, *, seed: int | None = None, masked: bool = True, env: gymnasium.Env[Any, Any] | None = None
    ) -> None:
        self.name = "masked_random" if masked else "random"
        self._masked = masked
        self._rng = np.random.default_rng(None if seed is None else integer("seed", seed, least=0))
        self._env: gymnasium.Env[Any, Any] | None = None
        self._weights = False
        if env is not None:
            self.reset(env)

    def reset(self, env: gymnasium.Env[Any, Any]) -> None:
        """Take note of what kind of action ``env`` wants."""
        self._env = env
        self._weights = isinstance(env.action_space, gymnasium.spaces.Box)

    def act(self, observation: Observation, info: Mapping[str, Any]) -> Action:
        """A node or guiding space drawn uniformly, or random weights.

        Raises:
            GuidedGymError: The agent was never given an environment, and the observation has no mask.
        """
        mask = self._mask(observation)
        if self._weights:
            weights = self._rng.random(mask.size, np.float32)
            return weights * mask.astype(np.float32) if self._masked else weights
        nodes = np.flatnonzero(mask)
        return int(self._rng.choice(nodes) if self._masked else self._rng.integers(mask.size))

    def _mask(self, observation: object) -> NDArray[Any]:
        """Which actions are valid: the observation says so, else the environment."""
        if isinstance(observation, Mapping) and "action_mask" in observation:
            return np.asarray(observation["action_mask"])
        if self._env is None:
            raise GuidedGymError(
                f"agent {self.name!r}: expected reset(env) before act(), since the observation has no mask"
            )
        return np.asarray(self._env.get_wrapper_attr("action_masks")())


# Agents that are no guiding spaces: one row each.
AGENTS: Final[dict[str, Callable[..., Agent]]] = {
    "random": lambda **options: RandomAgent(masked=False, **options),
    "masked_random": RandomAgent,
}


@door
def agent_names() -> list[str]:
    """Names that `make_agent` knows: the guiding spaces, then the others."""
    return [*guidance_names(), *AGENTS]


@door
def make_agent(
    agent: str | GuidingSpace, /, env: gymnasium.Env[Any, Any] | None = None, **options: Any
) -> Agent:
    """An agent by name, or a guiding space as an agent.

    Args:
        agent: Name or expression of a guiding space (see `guided_gym.make_guidance`), ``"random"``,
            ``"masked_random"``, or a guiding space.
        env: The environment to act in; without it, call ``agent.reset(env)`` after ``env.reset()``.
        **options: Options of the guiding space or agent.

    Raises:
        UnknownNameError: No such agent or option; the nearest one is suggested.
    """
    if isinstance(agent, str) and agent in AGENTS:
        for option in options:
            if option != "seed":
                raise UnknownOptionError(f"make_agent({agent!r})", option, ["seed"])
        return AGENTS[agent](env=env, **options)
    if isinstance(agent, str):
        check_name("agent", agent, agent_names())
    return GuidanceAgent(agent, env, **options)


@dataclass(frozen=True)
class EpisodeResult:
    """What happened in one episode.

    Attributes:
        solved: Whether a path was found.
        samples: Steps taken, failures and invalid actions included.
        nodes: Size of the tree at the end.
        collision_checks: Motions checked.
        total_reward: Sum of the rewards.
        cost: Length of the path, infinite if there is none.
        rewards: (samples,) reward of each step.
        efficiency: (samples,) SE of each step, in nats.
        best: (samples,) -log max Q at each step, in nats.
    """

    solved: bool
    samples: int
    nodes: int
    collision_checks: int
    total_reward: float
    cost: float
    rewards: NDArray[np.float64]
    efficiency: NDArray[np.float64]
    best: NDArray[np.float64]

    @property
    def total_efficiency(self) -> float:
        """Sum of SE over the episode, in nats."""
        return float(self.efficiency.sum())


@door
def rollout(
    env: gymnasium.Env[Any, Any], agent: Agent, seed: int | None = None, **reset_options: Any
) -> EpisodeResult:
    """One episode of an agent in an environment.

    Args:
        env: A `GuidedSearchEnv`, wrapped or not.
        agent: The agent that acts.
        seed: Seed of the episode.
        **reset_options: Options of ``env.reset``, such as ``problem``.
    """
    observation, info = env.reset(seed=seed, options=reset_options or None)
    agent.reset(env)
    rows: list[tuple[float, float, float]] = []
    terminated = truncated = False
    while not (terminated or truncated):
        if info["solved"]:
            break  # at the very start: there is nothing to search for
        observation, reward, terminated, truncated, info = env.step(agent.act(observation, info))
        rows.append((float(reward), info["sampling_efficiency"], info["best_possible"]))
    table = np.array(rows, np.float64).reshape(-1, 3)
    return EpisodeResult(
        solved=bool(info["solved"]),
        samples=info["samples"],
        nodes=info["tree_size"],
        collision_checks=info["collision_checks"],
        total_reward=float(table[:, 0].sum()),
        cost=info["cost"],
        rewards=table[:, 0].copy(),
        efficiency=table[:, 1].copy(),
        best=table[:, 2].copy(),
    )
