"""The tree as a graph."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import guided_gym
from guided_gym import (
    GraphObservation,
    InvalidInputError,
    MaskedObservation,
    NodeColumn,
    RecordSearch,
    node_table,
    read_trace,
)


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


@pytest.mark.parametrize("rewire", [False, True])
def test_record__the_trace_of_an_episode_is_its_search(env, tmp_path, rewire):
    env = RecordSearch(gymnasium.make("guided_gym/Cup-v0", max_nodes=64, rewire=rewire), tmp_path)
    env.reset(seed=3)
    rewards, over, rng = [], False, np.random.default_rng(0)
    while not over:
        action = int(rng.integers(len(env.unwrapped.search.tree)))
        _, reward, terminated, truncated, _ = env.step(action)
        rewards.append(reward)
        over = terminated or truncated
    trace, tree = read_trace(tmp_path / "episode-000000.jsonl"), env.unwrapped.search.tree
    assert trace.trouble == "" and len(trace) == env.unwrapped.search.samples
    again = trace.replay().tree
    assert np.array_equal(again.parents, tree.parents) and np.array_equal(again.contacts, tree.contacts)
    assert np.array_equal(again.cost_to_come, tree.cost_to_come)
    assert [-sample.efficiency for sample in trace.samples] == rewards
    assert trace.header["seed"] == 3


def test_record__episodes_cut_short_invalid_actions_and_every_other_one(env, tmp_path):
    env = RecordSearch(env, tmp_path, every=2, title="mine")
    for _ in range(3):
        env.reset(seed=0)
        env.step(0)
        env.step(60)  # there is no such node
    env.close()
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "episode-000000.jsonl",
        "episode-000002.jsonl",
    ]
    trace = read_trace(tmp_path / "episode-000002.jsonl")
    assert len(trace) == 1 and "stops after line 2" in trace.trouble and trace.header["title"] == "mine"


def test_record__who_guides_is_told(tmp_path):
    env = RecordSearch(gymnasium.make("guided_gym/GuideSelection-v0"), tmp_path)
    env.reset(seed=0)
    for action in (0, 1, 1, 0):
        env.step(action)
    env.close()
    trace = read_trace(tmp_path / "episode-000000.jsonl")
    assert [sample.guide for sample in trace.samples] == [0, 1, 1, 0]
    assert trace.header["guides"] == list(env.unwrapped.guides)


def test_record__can_be_made_from_its_spec_and_refuses_other_environments(env, tmp_path):
    again = RecordSearch(env, tmp_path, every=3).spec.make()
    assert isinstance(again, RecordSearch) and again.every == 3 and again.folder == tmp_path
    with pytest.raises(InvalidInputError, match="expected an environment that searches"):
        RecordSearch(gymnasium.make("CartPole-v1"), tmp_path)


@pytest.mark.parametrize("options", [{}, {"raster": 8}], ids=str)
def test_the_vector_and_the_mask_hold_what_the_observation_holds(options):
    plain = gymnasium.make("guided_gym/Cup-v0", max_nodes=16, **options)
    for wrapped, keys, kind in (
        (MaskedObservation(plain), ["action_mask", "observations"], np.float32),
        (MaskedObservation.for_tianshou(plain), ["mask", "obs"], np.bool_),
    ):
        check_env(wrapped, skip_render_check=True)
        assert sorted(wrapped.observation_space) == keys
        observation, _ = wrapped.reset(seed=0)
        for _ in range(5):
            observation, *_ = wrapped.step(0)
        assert observation in wrapped.observation_space
        theirs = plain.unwrapped.observer.extract(plain.unwrapped.search)
        mask, vector = (observation[key] for key in keys)
        assert mask.dtype == kind and np.array_equal(mask, theirs["action_mask"])
        assert vector.dtype == np.float32
        parts = [theirs[key].ravel() for key in plain.observation_space if key != "action_mask"]
        assert np.array_equal(vector, np.concatenate(parts).astype(np.float32))


def test_the_vector_may_hold_some_parts_in_any_order(env):
    wrapped = MaskedObservation(env, parts=("goal", "start"))
    observation, _ = wrapped.reset(seed=0)
    plain, _ = env.reset(seed=0)
    assert np.array_equal(observation["observations"], np.concatenate([plain["goal"], plain["start"]]))
    assert wrapped.spec.make().observation_space == wrapped.observation_space
    for parts in (("rooster",), ("action_mask", "none")):
        with pytest.raises(InvalidInputError, match="parts"):
            MaskedObservation(env, parts=parts)
    with pytest.raises(InvalidInputError, match="action_mask"):
        MaskedObservation(gymnasium.make("guided_gym/GuideSelection-v0"))
