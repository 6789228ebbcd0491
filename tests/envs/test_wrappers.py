"""The tree as a graph."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import guided_gym
from guided_gym import GraphObservation, NodeColumn, node_table


@pytest.fixture
def env():
    return gymnasium.make("guided_gym/Cup-v0", max_nodes=64)


def test_the_graph_is_the_tree_without_padding(env):
    graph_env = GraphObservation(env)
    observation, _ = graph_env.reset(seed=0)
    graph = observation["graph"]
    assert observation in graph_env.observation_space
    assert graph.nodes.shape == (1, len(NodeColumn)) and graph.edge_links.shape == (0, 2)
    for _ in range(20):
        n = int(observation["graph"].nodes.shape[0])
        observation, *_ = graph_env.step(n - 1)
        assert observation in graph_env.observation_space
    graph, tree = observation["graph"], env.unwrapped.search.tree
    assert len(graph.nodes) == len(tree) == len(graph.edge_links) + 1
    assert np.array_equal(graph.edge_links[:, 0], tree.parents[1:])
    assert np.array_equal(graph.edge_links[:, 1], np.arange(1, len(tree)))
    cost = graph.nodes[:, NodeColumn.COST_TO_COME]
    assert np.allclose(cost[tree.parents[1:]] + graph.edges[:, 0], cost[1:], atol=1e-6)


def test_the_graph_has_the_columns_of_the_table_and_the_rest_stays(env):
    env.reset(seed=0)
    plain, *_ = env.step(0)
    observation = GraphObservation(env).observation(plain)
    graph = observation.pop("graph")
    assert np.array_equal(graph.nodes, node_table(plain)[: len(graph.nodes)])
    assert set(observation) == {"action_mask", "start", "goal", "raster"}
    assert all(value is plain[key] for key, value in observation.items())


@pytest.mark.filterwarnings("ignore:.*unwrapped version.*")
def test_it_passes_the_checker_and_can_be_made_from_its_spec(env):
    check_env(GraphObservation(env), skip_render_check=True)
    again = GraphObservation(env).spec.make()
    assert isinstance(again, GraphObservation)
    assert again.unwrapped.max_nodes == 64


@pytest.mark.parametrize(
    ("mode", "vector_kwargs"), [("sync", {}), ("async", {"shared_memory": False})], ids=["sync", "async"]
)
def test_vectors_keep_a_graph_of_each_environment(mode, vector_kwargs):
    envs = gymnasium.make_vec(
        "guided_gym/Cup-v0",
        2,
        vectorization_mode=mode,
        wrappers=[GraphObservation],
        vector_kwargs=vector_kwargs,
    )
    try:
        observation, _ = envs.reset(seed=0)
        observation, *_ = envs.step(np.zeros(2, np.int64))
        assert observation in envs.observation_space
        assert isinstance(observation["graph"], tuple) and observation["action_mask"].shape == (2, 256)
    finally:
        envs.close()


def test_other_observations_are_refused():
    with pytest.raises(guided_gym.InvalidInputError, match="default observation"):
        GraphObservation(gymnasium.make("CartPole-v1"))
