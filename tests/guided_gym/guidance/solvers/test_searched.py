"""The searched solver: a search in (r', E') that guides the one in C."""

from __future__ import annotations

import numpy as np
import pytest

from guided_gym import guided_search, make_distribution, make_guidance


@pytest.mark.parametrize("seed", range(4))
def test_searched__knows_other_ways_when_the_first_fails(seed: int) -> None:
    """On TrapCup a point fits through the gap in the wall and the stick does not: the way is around it."""
    problem = make_distribution("TrapCup").problem(seed)
    guidance = make_guidance("searched(robot=point, guidance=skeleton)")
    result = guided_search(problem, guidance, seed=seed, max_samples=200, measure=False)
    assert result.solved


def test_searched__joins_nodes_and_states_by_free_motions_only() -> None:
    problem = make_distribution("TrapCup").problem(0)
    guidance = make_guidance("searched(robot=point, guidance=rrt)")
    guided_search(problem, guidance, seed=0, max_samples=1, measure=False)
    space, solver = guidance.query.space, guidance.solver  # type: ignore[attr-defined]
    graph = solver.graph
    assert len(graph.edges) > 3 * len(graph.points)  # more than a tree has
    ends = graph.points[graph.edges]
    assert space.motions_free(ends[:, 0], ends[:, 1]).all()
    assert graph.lengths == pytest.approx(space.distance(ends[:, 0], ends[:, 1]))
    states = space.sample(np.random.default_rng(0), 200)
    anchors = solver.anchor(states)
    joined = np.isfinite(anchors.lengths)
    count = anchors.lengths.shape[1]
    to = graph.points[anchors.vertices]
    free = space.motions_free(np.repeat(states, count, axis=0), to.reshape(-1, 2)).reshape(joined.shape)
    some = free.any(axis=1)
    assert 0 < some.sum() < len(states)
    assert np.array_equal(joined[some], free[some])
    assert joined[~some].all()  # where the tree does not reach, nearness has to do
