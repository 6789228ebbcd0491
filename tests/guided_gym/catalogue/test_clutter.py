"""Random clutter: valid polygons of any shape, start and goal joined but out of sight."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from guided_gym.catalogue import clutter
from guided_gym.catalogue.clutter import APART, POLYGONS, random_clutter
from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import NoPathError
from guided_gym.measure.oracle import Oracle

SEEDS = range(6)


@pytest.mark.parametrize("seed", SEEDS)
def test_clutter__is_never_blocked(seed):
    problem = make_distribution("RandomClutter").problem(seed)
    start, goal = problem.task.start, problem.task.goal
    assert Oracle(problem.space, goal).connects(start)
    assert not problem.space.motion_free(start, goal)
    assert np.hypot(*(goal - start)[:2]) >= APART
    assert POLYGONS[0] <= len(problem.environment.obstacles) <= POLYGONS[1]


def test_clutter__leaves_no_polygon_outside():
    problem = make_distribution("RandomClutter@test").problem(
        1
    )  # in whose first draw a triangle fell outside
    bounds = shapely.box(*problem.environment.bounds)
    assert all(obstacle.intersects(bounds) for obstacle in problem.environment.obstacles)


def test_clutter__poses_the_same_problems_whatever_the_oracle_can_do():
    # A draw is kept if a plain coarse grid has a path: were it the oracle that decides, a better one would
    # turn every seed into another problem.
    problems = [make_distribution("RandomClutter").problem(seed) for seed in range(4)]
    assert [problem.fingerprint[:12] for problem in problems] == [
        "22d2a1d85734",
        "c284955fabf7",
        "73ed065c7949",
        "6f78d3aedf5c",
    ]


def test_clutter__has_convex_polygons_and_others():
    polygons = make_distribution("RandomClutter").problem(0).environment.obstacles
    hollow = [polygon.convex_hull.area > polygon.area * 1.001 for polygon in polygons]
    assert any(hollow) and not all(hollow)


def test_clutter__draws_again_what_is_blocked_but_not_for_ever(monkeypatch):
    asked = []
    monkeypatch.setattr(clutter, "_has_path", lambda problem: len(asked) > 2 or asked.append(problem))
    problem = random_clutter(np.random.default_rng(1))
    assert len(asked) == 3 and problem.fingerprint not in {each.fingerprint for each in asked}
    monkeypatch.setattr(clutter, "_has_path", lambda problem: False)
    monkeypatch.setattr(clutter, "TRIES", 3)
    with pytest.raises(NoPathError, match="RandomClutter: expected a problem that has a path"):
        random_clutter(np.random.default_rng(1))


def test_clutter__follows_the_seed():
    one, same, other = (random_clutter(np.random.default_rng(seed)).fingerprint for seed in (1, 1, 2))
    assert one == same != other
