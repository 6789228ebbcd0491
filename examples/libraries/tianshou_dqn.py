"""tianshou 2: DQN with a mask, from observations with the keys `obs` and `mask`.

python examples/libraries/tianshou_dqn.py --steps 500
"""

from __future__ import annotations

import argparse

import gymnasium
import numpy as np
from tianshou.algorithm.modelfree.dqn import DQN, DiscreteQLearningPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.utils.net.common import Net

import guided_gym


def environment() -> gymnasium.Env:
    """A search whose observation has the keys that tianshou reads."""
    env = gymnasium.make("guided_gym/Cup-v0", max_samples=60, on_invalid="raise")
    return guided_gym.MaskedObservation.for_tianshou(env, parts=("nodes", "start", "goal"))


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=500)
    options = parser.parse_args()
    env = environment()
    nodes = int(env.action_space.n)
    net = Net(state_shape=env.observation_space["obs"].shape, action_shape=nodes, hidden_sizes=[64])
    policy = DiscreteQLearningPolicy(model=net, action_space=env.action_space, eps_training=0.2)
    algorithm = DQN(policy=policy, optim=AdamOptimizerFactory(lr=1e-3))
    envs = DummyVectorEnv([environment] * 2)
    collector = Collector(algorithm, envs, VectorReplayBuffer(10_000, 2), exploration_noise=True)
    collector.reset()
    stats = collector.collect(n_step=options.steps)
    batch, _ = collector.buffer.sample(0)  # all of it
    chosen = batch.obs.mask[np.arange(len(batch)), batch.act]
    print(f"{stats.n_collected_steps} steps, all of them valid: {bool(chosen.all())}")


if __name__ == "__main__":
    main()
