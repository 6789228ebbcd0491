"""What the best policy of each reward does, computed: ``python examples/best_policies.py``.

A world of two ways to the goal: a short one, of which the first edge is a gap that few expansions pass, and a
longer one that is open. A tree that has `short` nodes on the one and `long` on the other can only go on at
its two ends, so the best policy is found exactly, from the goal backwards. A failed expansion changes
nothing, so whoever tries a node goes on until it works.
"""

from __future__ import annotations

import argparse
from functools import cache
from typing import NamedTuple

import numpy as np

from guided_gym import target

SHORT, LONG = 6, 9  # edges of either way
OPEN = 0.25  # share of expansions that go on, where nothing is in the way
# What a choice costs under each reward: weights of its SE, of its regret, and of a sample.
REWARDS = {
    "efficiency": (1.0, 0.0, 0.0),
    "regret": (0.0, 1.0, 0.0),
    "sample": (0.0, 0.0, 1.0),
    "regret + 0.01 sample": (0.0, 1.0, 0.01),
    "regret + 0.1 sample": (0.0, 1.0, 0.1),
    "regret + sample": (0.0, 1.0, 1.0),
}


class Outlook(NamedTuple):
    """What is expected until the goal, from a tree on; sums."""

    loss: float
    samples: float
    efficiency: float
    regret: float
    short: float  # probability that the short way gets there


def efficiencies(short: int, long: int) -> tuple[float, float, float]:
    """SE of the end of the short way and of the long one, and the best possible; of a tree, in nats."""
    on_short, on_long = np.arange(short + 1), np.arange(1, long + 1)
    cost_to_come = np.concatenate([on_short, on_long]).astype(float)
    cost_to_go = np.concatenate([SHORT - on_short, np.minimum(LONG - on_long, SHORT + on_long)]).astype(float)
    q = target(np.maximum(cost_to_come + cost_to_go - SHORT, 0.0), cost_to_go, SHORT)
    return float(-np.log(q[short])), float(-np.log(q[-1 if long else 0])), float(-np.log(q.max()))


def best_policy(costs: tuple[float, float, float], gap: float) -> Outlook:
    """What the best policy of a reward is to expect, from the start on.

    Args:
        costs: What a choice costs: weights of its SE, of its regret, and of a sample.
        gap: Share of the expansions at the start that pass the gap of the short way.
    """

    @cache
    def outlook(short: int, long: int) -> Outlook:
        if short == SHORT or long == LONG:
            return Outlook(0.0, 0.0, 0.0, 0.0, float(short == SHORT))
        at_short, at_long, best = efficiencies(short, long)
        if short == 0 and long == 0:  # one node for both: either way may open
            ways = [(at_short, ((gap, (1, 0)), (OPEN, (0, 1))))]
        else:
            ways = [(at_short, ((OPEN if short else gap, (short + 1, long)),))]
            ways.append((at_long, ((OPEN, (short, long + 1)),)))
        choices = []
        for efficiency, ends in ways:
            passes = sum(share for share, _ in ends)
            after = np.array([outlook(*tree) for _, tree in ends])
            later = np.average(after, axis=0, weights=[share for share, _ in ends])
            cost = float(np.dot(costs, (efficiency, efficiency - best, 1.0)))
            now = np.array([cost, 1.0, efficiency, efficiency - best, 0.0])
            choices.append(Outlook(*(now / passes + later)))
        return min(choices, key=lambda choice: (choice.loss, choice.samples))

    return outlook(0, 0)


def main() -> None:
    """Print a table: gaps by rewards."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gaps", type=float, nargs="+", default=[0.25, 0.05, 0.01, 0.001])
    arguments = parser.parse_args()
    print(f"{'reward':20} {'gap':>6} {'short way':>9} {'samples':>8} {'total SE':>9} {'regret':>7}")
    for name, costs in REWARDS.items():
        for gap in arguments.gaps:
            o = best_policy(costs, gap)
            print(f"{name:20} {gap:6} {o.short:9.2f} {o.samples:8.1f} {o.efficiency:9.1f} {o.regret:7.1f}")


if __name__ == "__main__":
    main()
