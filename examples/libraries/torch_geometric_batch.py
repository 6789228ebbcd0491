"""torch-geometric: trees as graphs, in batches.

python examples/libraries/torch_geometric_batch.py
"""

from __future__ import annotations

import gymnasium
import torch
from torch_geometric.data import Batch, Data

import guided_gym


def main() -> None:
    """Run it."""
    env = guided_gym.GraphObservation(gymnasium.make("guided_gym/Cup-v0"))
    graphs = []
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        for node in range(10):
            observation, *_ = env.step(node if observation["action_mask"][node] else 0)
        graph = observation["graph"]
        graphs.append(
            Data(
                torch.from_numpy(graph.nodes),
                torch.from_numpy(graph.edge_links.T).long(),
                torch.from_numpy(graph.edges),
            )
        )
    print(Batch.from_data_list(graphs))


if __name__ == "__main__":
    main()
