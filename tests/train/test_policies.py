"""NodePolicy: by its name in every algorithm, for nodes that there are only, and whatever the padding."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("sb3_contrib")

import gymnasium
import torch
from gymnasium import spaces
from sb3_contrib import MaskablePPO
from stable_baselines3 import A2C, PPO

import guided_gym
import guided_gym.train.policies as policies
from guided_gym.errors import InvalidInputError

FAST = {"n_steps": 32, "device": "cpu", "seed": 0}


def searching(name: str = "guided_gym/SimplePassage-v0", **options) -> gymnasium.Env:
    return gymnasium.make(name, **{"max_samples": 40, **options})


def some(env: gymnasium.Env, steps: int = 25) -> dict[str, np.ndarray]:
    """An observation of a tree that has grown."""
    observation, _ = env.reset(seed=3)
    for i in range(steps):
        observation, *_ = env.step(i // 2 % int(observation["action_mask"].sum()))
    return observation


def tensors(observation: dict[str, np.ndarray], policy) -> dict[str, torch.Tensor]:
    return policy.extract_features(policy.obs_to_tensor(observation)[0])


def woken(policy) -> None:
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(1)))


@pytest.mark.parametrize("algorithm", [PPO, A2C, MaskablePPO])
def test_every_algorithm_knows_the_name_and_learns(algorithm):
    model = algorithm("NodePolicy", searching(on_invalid="raise"), **FAST)
    before = [p.clone() for p in model.policy.parameters()]
    model.learn(64)
    changed = [not torch.equal(a, b) for a, b in zip(before, model.policy.parameters(), strict=True)]
    assert sum(changed) > len(changed) // 2  # a few units may be asleep


@pytest.mark.parametrize("algorithm", [PPO, MaskablePPO])
def test_without_masks_valid_nodes_are_chosen_all_the_same(algorithm):
    env = searching(on_invalid="raise")
    model = algorithm("NodePolicy", env, **FAST)
    woken(model.policy)
    observation, _ = env.reset(seed=0)
    for _ in range(30):
        action, _ = model.predict(observation)  # no masks are handed over
        observation, *_ = env.step(int(action))


def test_it_begins_with_all_nodes_alike():
    env = searching()
    model = MaskablePPO("NodePolicy", env, **FAST)
    logits, _ = model.policy.mlp_extractor(tensors(some(env), model.policy))
    there = some(env)["action_mask"] > 0
    logits = logits[0].detach().numpy()
    assert np.ptp(logits[there]) == 0 and (logits[~there] == np.float32(policies.ABSENT)).all()


@pytest.mark.parametrize("options", [{}, {"picture": 0}, {"hidden": 8, "picture": 3}], ids=str)
def test_weights_and_answers_do_not_depend_on_padding(options):
    """The same tree in a larger array, read by the same weights: the same logits, the same value."""
    answers, states = [], []
    for room in (60, 200):
        env = searching(max_nodes=room)
        model = MaskablePPO("NodePolicy", env, policy_kwargs=options, **FAST)
        woken(model.policy)
        observation = some(env)
        network = model.policy.mlp_extractor
        logits, summary = network(tensors(observation, model.policy))
        n = int(observation["action_mask"].sum())
        answers.append((logits[0, :n].detach().numpy(), summary.detach().numpy()))
        states.append(model.policy.state_dict())
    assert {k: v.shape for k, v in states[0].items()} == {k: v.shape for k, v in states[1].items()}
    assert np.ptp(answers[0][0]) > 1e-3
    np.testing.assert_allclose(answers[0][0], answers[1][0], rtol=0, atol=1e-5)
    np.testing.assert_allclose(answers[0][1], answers[1][1], rtol=0, atol=1e-5)


def test_rubbish_in_the_padding_changes_nothing():
    env = searching()
    model = PPO("NodePolicy", env, **FAST)
    woken(model.policy)
    observation = some(env)
    spoilt = {key: value.copy() for key, value in observation.items()}
    n = int(observation["action_mask"].sum())
    spoilt["nodes"].reshape(-1, 14)[n:] = 0.7
    for one, other in zip(
        model.policy.mlp_extractor(tensors(observation, model.policy)),
        model.policy.mlp_extractor(tensors(spoilt, model.policy)),
        strict=True,
    ):
        assert torch.equal(one, other)


def test_the_order_of_the_nodes_goes_through():
    env = searching()
    model = PPO("NodePolicy", env, **FAST)
    woken(model.policy)
    observation = some(env)
    n = int(observation["action_mask"].sum())
    order = np.random.default_rng(0).permutation(n)
    mixed = {key: value.copy() for key, value in observation.items()}
    table = mixed["nodes"].reshape(-1, 14)
    table[:n] = table[:n][order]
    logits, summary = model.policy.mlp_extractor(tensors(observation, model.policy))
    again, same = model.policy.mlp_extractor(tensors(mixed, model.policy))
    torch.testing.assert_close(again[0, :n], logits[0, :n][torch.as_tensor(order)], rtol=0, atol=1e-5)
    torch.testing.assert_close(same, summary, rtol=0, atol=1e-5)


def test_a_batch_is_read_tree_by_tree():
    env = searching()
    model = PPO("NodePolicy", env, **FAST)
    woken(model.policy)
    trees = [some(env, steps) for steps in (0, 5, 25)]
    batch = {key: np.stack([tree[key] for tree in trees]) for key in trees[0]}
    together = model.policy.mlp_extractor(tensors(batch, model.policy))
    for k, tree in enumerate(trees):
        alone = model.policy.mlp_extractor(tensors(tree, model.policy))
        for one, many in zip(alone, together, strict=True):
            torch.testing.assert_close(one[0], many[k], rtol=0, atol=1e-5)


def test_a_picture_is_seen_where_the_node_is():
    """Two nodes alike but for their place see different parts of the map."""
    network = policies.NodeNetwork(searching().observation_space)
    places = torch.tensor([[[-0.5, -0.5], [0.5, 0.5]]])
    picture = torch.zeros(1, 1, 64, 64)
    picture[..., :32, :32] = 1.0  # row 0 is the bottom, column 0 the left
    assert network.picture is not None
    view = network.picture(picture)
    seen = torch.nn.functional.grid_sample(view, places[:, :, None], align_corners=False)
    empty = network.picture(torch.zeros_like(picture))
    plain = torch.nn.functional.grid_sample(empty, places[:, :, None], align_corners=False)
    assert not torch.allclose(seen[0, :, 0], plain[0, :, 0])
    torch.testing.assert_close(seen[0, :, 1], plain[0, :, 1])


def test_robots_with_joints_have_more_columns():
    observer = guided_gym.TreeObservation(angles=4)
    space = observer.build(max_nodes=12, max_samples=10)
    network = policies.NodeNetwork(space)
    observation = {key: torch.zeros(1, *part.shape) for key, part in space.spaces.items()}
    observation["action_mask"][0, :3] = 1
    assert network.columns == observer.columns == 26
    logits, _ = network(observation)
    there = logits[0, :3].detach().numpy()
    assert np.isfinite(there).all() and (logits[0, 3:] == policies.ABSENT).all()


def test_a_model_is_saved_and_loaded_with_its_sizes(tmp_path):
    env = searching()
    model = MaskablePPO("NodePolicy", env, policy_kwargs={"hidden": 8, "picture": 0}, **FAST)
    woken(model.policy)
    observation = some(env)
    model.save(tmp_path / "model.zip")
    model.policy.save(tmp_path / "policy.pt")
    expected = model.predict(observation, deterministic=True)[0]
    again = MaskablePPO.load(tmp_path / "model.zip", device="cpu")
    policy = policies.MaskableNodePolicy.load(tmp_path / "policy.pt", device="cpu")
    for one in (again, policy):
        assert one.predict(observation, deterministic=True)[0] == expected


@pytest.mark.parametrize(
    ("space", "actions", "words"),
    [
        (spaces.Box(0, 1, (4,)), spaces.Discrete(4), "NodePolicy: expected a Dict with nodes"),
        (
            spaces.Dict({"nodes": spaces.Box(0, 1, (7,)), "action_mask": spaces.Box(0, 1, (4,), np.int8)}),
            spaces.Discrete(4),
            "x and y of each of 4 nodes",
        ),
        (
            spaces.Dict({"nodes": spaces.Box(0, 1, (8,)), "action_mask": spaces.Box(0, 1, (4,), np.int8)}),
            spaces.Discrete(5),
            "one action for each of 4 nodes",
        ),
    ],
)
def test_other_spaces_are_refused(space, actions, words):
    with pytest.raises(InvalidInputError, match=words):
        policies.NodePolicy(space, actions, lambda left: 1e-3)


@pytest.mark.parametrize("sizes", [{"hidden": 0}, {"picture": -1}, {"hidden": "wide"}], ids=str)
def test_sizes_out_of_range_are_refused(sizes):
    with pytest.raises(InvalidInputError, match="expected an integer"):
        PPO("NodePolicy", searching(), policy_kwargs=sizes, **FAST)
