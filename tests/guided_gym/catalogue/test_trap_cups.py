"""Random traps and cups: of every kind, on every side, and always with a way through."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from guided_gym.catalogue.table import make_distribution
from guided_gym.catalogue.trap_cups import ORDERS
from guided_gym.measure.oracle import Oracle

DISTRIBUTION = make_distribution("RandomTrapCup")
PROBLEMS = [DISTRIBUTION.problem(seed) for seed in range(40)]


def test_every_order_is_drawn():
    assert sum(share for _, share in ORDERS) == pytest.approx(1)
    kinds = {tuple(name for name in ("trap", "cup") if name in problem.regions) for problem in PROBLEMS}
    assert kinds == {("trap", "cup"), ("trap",), ("cup",)}


def test_every_side_is_drawn():
    ways = np.array([problem.task.goal[:2] - problem.task.start[:2] for problem in PROBLEMS])
    along = np.abs(ways).argmax(axis=1)
    assert {(int(axis), bool(way[axis] > 0)) for axis, way in zip(along, ways, strict=True)} == {
        (axis, forward) for axis in (0, 1) for forward in (True, False)
    }


@pytest.mark.parametrize("problem", PROBLEMS[:6])
def test_there_is_a_path(problem):
    oracle = Oracle(problem.space, problem.task.goal)
    assert oracle.connects(problem.task.start)


def test_a_point_fits_where_the_robot_does_not():
    for problem in PROBLEMS:
        for wall in shapely.get_parts(problem.regions.get("trap", shapely.MultiPolygon())):
            gaps = shapely.get_parts(problem.environment.free_space.intersection(wall))
            x0, y0, x1, y1 = shapely.bounds(gaps[shapely.area(gaps) > 1e-9]).T
            along_x = np.ptp(wall.bounds[::2]) > np.ptp(wall.bounds[1::2])
            widths = x1 - x0 if along_x else y1 - y0
            assert (widths < 0.3).any() and (widths >= 0.9).sum() == 1


@pytest.mark.parametrize("problem", PROBLEMS[:10])
def test_regions_share_out_the_workspace(problem):
    areas = list(problem.regions.values())
    assert sum(area.area for area in areas) == pytest.approx(100)
    assert shapely.union_all(areas).area == pytest.approx(100)


def test_the_seed_decides():
    assert DISTRIBUTION.problem(3).fingerprint == PROBLEMS[3].fingerprint
    assert len({problem.fingerprint for problem in PROBLEMS}) == len(PROBLEMS)
