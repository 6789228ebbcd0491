"""Wrappers: the observation in other shapes."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from numpy.typing import NDArray

from guided_gym.envs.observations import COLUMNS, MAX_COST, NodeColumn, node_table
from guided_gym.errors import InvalidInputError

_TABLES = ("nodes", "parents")  # what the graph stands for


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


def _graph(observation: dict[str, NDArray[Any]]) -> spaces.GraphInstance:
    n = int(observation["action_mask"].sum())
    nodes = node_table(observation, observation["nodes"].size // observation["parents"].size)[:n].copy()
    children = np.arange(1, n, dtype=np.int32)
    parents = observation["parents"][1:n]
    cost = nodes[:, NodeColumn.COST_TO_COME - COLUMNS]
    lengths = np.maximum(cost[children] - cost[parents], 0.0)[:, np.newaxis]
    return spaces.GraphInstance(nodes, lengths, np.stack([parents, children], axis=1))
