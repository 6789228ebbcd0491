"""Minari: record episodes of a guiding space as a data set, infos and the oracle's target included.

MINARI_DATASETS_PATH=/tmp/minari python examples/libraries/minari_dataset.py --episodes 2
"""

from __future__ import annotations

import argparse

import gymnasium
import minari

import guided_gym


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=2)
    options = parser.parse_args()
    env = gymnasium.make("guided_gym/TrapCup-v0", max_nodes=128, expansion="lazy_prm", target_in_info=True)
    recorded = minari.DataCollector(env, record_infos=True)
    agent = guided_gym.make_agent("lazy_prm")
    for seed in range(options.episodes):
        observation, info = recorded.reset(seed=seed)
        agent.reset(recorded)
        terminated = truncated = False
        while not (terminated or truncated):
            observation, _, terminated, truncated, info = recorded.step(agent.act(observation, info))
    name = "guided/trapcup-v0"
    if name in minari.list_local_datasets():
        minari.delete_dataset(name)
    recorded.create_dataset(name, algorithm_name="lazy_prm")
    dataset = minari.load_dataset(name)
    print(f"{dataset.total_episodes} episodes, {dataset.total_steps} steps")


if __name__ == "__main__":
    main()
