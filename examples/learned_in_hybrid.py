"""Learned guidance in a hybrid, beside a scripted one, and evaluated like any other guiding space.

    python examples/learned_in_hybrid.py AGENT [PROBLEMS]

AGENT is the name of a shipped agent or a folder that `guided-gym train imitation` or `... ppo` wrote.
"""

import sys

import numpy as np

from guided_gym import Hybrid, guided_search, make_distribution, make_guidance, problem_seed

agent = sys.argv[1]
problems = int(sys.argv[2]) if len(sys.argv) > 2 else 16

distribution = make_distribution("RandomSimplePassage")
guidances = {
    "learned": make_guidance(f"learned:{agent}"),
    "medial_axis": make_guidance("medial_axis"),
    # The paper's rule: whoever's guidance led into a collision passes the turn on.
    "both": Hybrid([make_guidance(f"learned:{agent}"), make_guidance("medial_axis")]),
}
for name, guidance in guidances.items():
    results = []
    for i in range(problems):
        problem = distribution.problem(problem_seed("test", i))
        results.append(guided_search(problem, guidance, seed=i, max_samples=300))
    efficiency = np.mean([result.total_efficiency for result in results])
    solved = np.mean([result.solved for result in results])
    samples = np.mean([result.samples for result in results])
    print(f"{name}: total SE {efficiency:.1f}, {samples:.0f} samples, solved {solved:.0%}")
