"""The tree as a graph."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import guided_gym
from guided_gym import GraphObservation, NodeColumn, node_table


@pytest.fixture
def env():
    return gymnasium.make("guided_gym/Cup-v0", max_nodes=64)


def test_the_graph_is_the_tree_without_padding(env):
    graph_env = GraphObservation(env)
    graph, _ = graph_env.reset(seed=0)
    assert graph in graph_env.observation_space
    assert graph.nodes.shape == (1, len(NodeColumn)) and graph.edge_links.shape == (0, 2)
    for _ in range(20):
        n = int(graph.nodes.shape[0])
        graph, *_ = graph_env.step(n - 1)
        assert graph in graph_env.observation_space
    tree = env.unwrapped.search.tree
    assert len(graph.nodes) == len(tree) == len(graph.edge_links) + 1
    assert np.array_equal(graph.edge_links[:, 0], tree.parents[1:])
    assert np.array_equal(graph.edge_links[:, 1], np.arange(1, len(tree)))
    cost = graph.nodes[:, NodeColumn.COST_TO_COME]
    assert np.allclose(cost[tree.parents[1:]] + graph.edges[:, 0], cost[1:], atol=1e-6)


def test_the_graph_has_the_columns_of_the_table(env):
    observation, _ = env.reset(seed=0)
    observation, *_ = env.step(0)
    graph = GraphObservation(env).observation(observation)
    assert np.array_equal(graph.nodes, node_table(observation)[: len(graph.nodes)])


def test_other_observations_are_refused():
    with pytest.raises(guided_gym.InvalidInputError, match="default observation"):
        GraphObservation(gymnasium.make("CartPole-v1"))
