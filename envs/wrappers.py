"""Wrappers: the observation in other shapes and under other libraries' keys, and records of the searches."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, SupportsFloat, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from guided_gym.checks import integer, shown
from guided_gym.doors import doors
from guided_gym.envs.guide_selection_env import GuideSelectionEnv
from guided_gym.envs.guided_search_env import GuidedSearchEnv
from guided_gym.envs.observations import COLUMNS, MAX_COST, NodeColumn, node_table
from guided_gym.errors import InvalidInputError
from guided_gym.traces.writing import TraceWriter

_TABLES = ("nodes", "parents")  # what the graph stands for


@doors
class GraphObservation(
    gymnasium.ObservationWrapper[dict[str, Any], Any, dict[str, NDArray[Any]]], RecordConstructorArgs
):
    """The tree as a ``gymnasium.spaces.Graph``, without padding, beside the rest of the observation.

    ``observation["graph"]`` stands for nodes and parents; action_mask, start, goal and raster are as they
    were. The graph's nodes (n, F) float32 have the columns of `guided_gym.envs.observations.NodeColumn`;
    node i is action i, so every node shown may be chosen. There is an edge (parent, child) for each node but
    the root, in the order of the children, with one feature: its length in the unit of the cost-to-come.

    stable-baselines3 takes no graphs. Vector environments keep them as a tuple, one graph for each
    environment; gymnasium's asynchronous ones need ``vector_kwargs={"shared_memory": False}``.

    Args:
        env: An environment with the default observation.

    Raises:
        InvalidInputError: Another observation.
    """

    def __init__(self, env: gymnasium.Env[dict[str, NDArray[Any]], Any]) -> None:
        RecordConstructorArgs.__init__(self)  # so that `spec.make()` can wrap again
        gymnasium.ObservationWrapper.__init__(self, env)
        space = env.observation_space
        if not (isinstance(space, spaces.Dict) and {*_TABLES, "action_mask"} <= set(space.spaces)):
            raise InvalidInputError(f"GraphObservation: expected the default observation, got {space}")
        nodes = space["nodes"]
        assert isinstance(nodes, spaces.Box)
        columns = nodes.shape[0] // space["parents"].shape[0]
        low, high = nodes.low[:columns], nodes.high[:columns]
        graph = spaces.Graph(
            node_space=spaces.Box(low, high, dtype=np.float32),
            edge_space=spaces.Box(0.0, MAX_COST, (1,), np.float32),
        )
        rest = {key: part for key, part in space.spaces.items() if key not in _TABLES}
        self.observation_space = spaces.Dict({"graph": graph, **rest})

    def observation(self, observation: dict[str, NDArray[Any]]) -> dict[str, Any]:
        """The same with the tree as a graph."""
        rest = {key: value for key, value in observation.items() if key not in _TABLES}
        return {"graph": _graph(observation), **rest}


@doors
class MaskedObservation(
    gymnasium.ObservationWrapper[dict[str, NDArray[Any]], Any, dict[str, NDArray[Any]]], RecordConstructorArgs
):
    """One flat vector and a mask, under the keys that a library looks for.

    ``MaskedObservation(env)`` has RLlib's keys, ``observations`` and ``action_mask`` (float32);
    ``MaskedObservation.for_tianshou(env)`` has ``obs`` and ``mask`` (bool: tianshou negates it).

    Args:
        env: An environment whose observation is a Dict with an ``action_mask``, like the default one.
        vector: Key of the vector.
        mask: Key of the mask.
        boolean: Whether the mask is bool; else float32, 1 for valid.
        parts: Which parts of the observation the vector joins, in this order; all but the mask if None.

    Raises:
        InvalidInputError: Another observation, or no part of that name.
    """

    _keys: tuple[str, str]
    _parts: tuple[str, ...]
    _type: type[np.bool_] | type[np.float32]

    def __init__(
        self,
        env: gymnasium.Env[dict[str, NDArray[Any]], Any],
        vector: str = "observations",
        mask: str = "action_mask",
        *,
        boolean: bool = False,
        parts: Sequence[str] | None = None,
    ) -> None:
        RecordConstructorArgs.__init__(self, vector=vector, mask=mask, boolean=boolean, parts=parts)
        gymnasium.ObservationWrapper.__init__(self, env)
        space = env.observation_space
        if not (isinstance(space, spaces.Dict) and "action_mask" in space.spaces):
            raise InvalidInputError(f"MaskedObservation: expected a Dict with an action_mask, got {space}")
        self._parts = tuple(key for key in space if key != "action_mask") if parts is None else tuple(parts)
        boxes = {key: space.spaces.get(key) for key in self._parts}
        for key, part in boxes.items():
            if not isinstance(part, spaces.Box):
                raise InvalidInputError(f"parts: expected some of {', '.join(space)}, got {shown(key)}")
        ends = [
            (part.low.ravel(), part.high.ravel()) for part in boxes.values() if isinstance(part, spaces.Box)
        ]
        low, high = (np.concatenate(end).astype(np.float32) for end in zip(*ends, strict=True))
        n = int(np.prod(space["action_mask"].shape or ()))
        self._keys, self._type = (vector, mask), np.bool_ if boolean else np.float32
        masks = spaces.MultiBinary(n) if boolean else spaces.Box(0.0, 1.0, (n,), np.float32)
        self.observation_space = spaces.Dict({vector: spaces.Box(low, high, dtype=np.float32), mask: masks})

    @classmethod
    def for_tianshou(
        cls, env: gymnasium.Env[dict[str, NDArray[Any]], Any], parts: Sequence[str] | None = None
    ) -> MaskedObservation:
        """The keys and the type of mask that tianshou looks for."""
        return cls(env, "obs", "mask", boolean=True, parts=parts)

    def observation(self, observation: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """The same as a vector and a mask."""
        vector, mask = self._keys
        flat = np.concatenate([np.asarray(observation[key]).ravel() for key in self._parts])
        return {vector: flat.astype(np.float32), mask: observation["action_mask"].astype(self._type)}


def _graph(observation: dict[str, NDArray[Any]]) -> spaces.GraphInstance:
    n = int(observation["action_mask"].sum())
    nodes = node_table(observation, observation["nodes"].size // observation["parents"].size)[:n].copy()
    children = np.arange(1, n, dtype=np.int32)
    parents = observation["parents"][1:n]
    cost = nodes[:, NodeColumn.COST_TO_COME - COLUMNS]
    lengths = np.maximum(cost[children] - cost[parents], 0.0)[:, np.newaxis]
    return spaces.GraphInstance(nodes, lengths, np.stack([parents, children], axis=1))


@doors
class RecordSearch(gymnasium.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Writes the search of each episode as a trace, which `guided-gym replay` plays (docs/replay.md).

    Episode k goes into ``FOLDER/episode-k.jsonl``, k with six digits, from the first reset on. An episode
    that is cut short leaves a trace that ends early. Invalid actions change nothing: they are not in it.

    Args:
        env: An environment in which a tree is searched.
        folder: Folder of the traces; it is made if there is none. Traces of an earlier run are replaced.
        every: Record every so many episodes, from the first on.
        title: What the pages call the searches.

    Raises:
        InvalidInputError: Another environment, or ``every`` is no positive integer.
        StorageError: A trace cannot be written; raised by `reset` and `step`.
    """

    def __init__(
        self, env: gymnasium.Env[Any, Any], folder: str | Path, *, every: int = 1, title: str = ""
    ) -> None:
        RecordConstructorArgs.__init__(self, folder=str(folder), every=every, title=title)
        gymnasium.Wrapper.__init__(self, env)
        if not isinstance(env.unwrapped, GuidedSearchEnv | GuideSelectionEnv):
            raise InvalidInputError(f"RecordSearch: expected an environment that searches, got {env}")
        self.folder, self.every, self.title = Path(folder), integer("every", every, least=1), title
        self.episodes = 0
        self._writer: TraceWriter | None = None

    @property
    def _searching(self) -> GuidedSearchEnv:
        inner = self.env.unwrapped
        return inner.searching if isinstance(inner, GuideSelectionEnv) else cast("GuidedSearchEnv", inner)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin a search, and its trace."""
        self._finish()
        answer = self.env.reset(seed=seed, options=options)
        if self.episodes % self.every == 0:
            inner, searching = self.env.unwrapped, self._searching
            hybrid = inner.hybrid if isinstance(inner, GuideSelectionEnv) else None
            self._writer = TraceWriter(self.folder / f"episode-{self.episodes:06d}.jsonl")
            labels = {"guidance": "an agent", "title": self.title or f"episode {self.episodes}"}
            self._writer.begin(
                searching.search, guide=hybrid, measure=searching.measure, seed=seed, labels=labels
            )
        self.episodes += 1
        return answer

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """One sample, and its line."""
        writer, searching = self._writer, self._searching
        if writer is None:
            return self.env.step(action)
        before = searching.search.samples
        writer.chosen(None)
        observation, reward, terminated, truncated, info = self.env.step(action)
        search = searching.search
        if search.samples > before and search.last is not None:
            guide = int(action) if isinstance(self.env.unwrapped, GuideSelectionEnv) else None
            writer.became(search.last, info["sampling_efficiency"], info["best_possible"], guide)
        if terminated or truncated:
            writer.end(search.path())
            self._finish()
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Close the trace and the environment."""
        self._finish()
        self.env.close()

    def _finish(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None
