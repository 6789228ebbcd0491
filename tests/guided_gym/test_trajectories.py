"""Paths made shorter, the room beside them, and times within the limits."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import shapely

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.planning import guided_search
from guided_gym.trajectories import (
    headings,
    path_clearance,
    path_length,
    smooth,
    spaced_path,
    time_path,
)

needs_toppra = pytest.mark.skipif(importlib.util.find_spec("toppra") is None, reason="needs toppra")


def _corridor() -> ConfigurationSpace:
    """An L-shaped way of a point around the corner (6, 4)."""
    return ConfigurationSpace(Robot.point(), Environment((0.0, 0.0, 10.0, 10.0), (shapely.box(0, 4, 6, 10),)))


def test_smooth__shortens_to_near_the_optimum_and_stays_free() -> None:
    space = _corridor()
    path = np.array([[1.0, 1.0], [2.0, 3.0], [5.0, 0.5], [9.0, 3.0], [7.0, 9.0]])
    short = smooth(space, path, np.random.default_rng(0), 300)
    assert space.motions_free(short[:-1], short[1:]).all()
    np.testing.assert_array_equal(short[[0, -1]], path[[0, -1]])
    optimum = np.hypot(5, 3) + np.hypot(1, 5)  # over the corner, by hand
    assert optimum <= path_length(space, short) < 1.02 * optimum
    again = smooth(space, path, np.random.default_rng(0), 300)
    np.testing.assert_array_equal(short, again)


def test_smooth__keeps_the_room_that_was_asked_for() -> None:
    space = _corridor()
    path = np.array([[1.0, 2.0], [8.0, 2.0], [8.0, 9.0]])  # 2 from everything
    for room in (0.0, 0.5, 1.0):
        short = smooth(space, path, np.random.default_rng(0), 200, room=room)
        assert path_clearance(space, short) >= 0.88 * room
        assert path_length(space, short) <= path_length(space, path)


@pytest.mark.parametrize("seed", range(4))
def test_smooth__of_searches_is_certified_and_not_longer(seed: int) -> None:
    problem = make_distribution("RandomMaze").problem(seed)
    path = guided_search(problem, "wavefront", seed=seed, measure=False, max_samples=3000).path
    assert path is not None
    short = smooth(problem.space, path, np.random.default_rng(seed))
    assert problem.space.motions_free(short[:-1], short[1:]).all()
    assert path_length(problem.space, short) <= path_length(problem.space, path) + 1e-9


def test_smooth__refuses_what_is_no_free_path() -> None:
    space = _corridor()
    with pytest.raises(InvalidInputError, match="from waypoint 0"):
        smooth(space, np.array([[1.0, 1.0], [7.0, 9.0], [1.0, 3.0]]), np.random.default_rng(0))
    for bad in ([[1.0, 1.0]], [1.0, 2.0], "path", [[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]):
        with pytest.raises(InvalidInputError, match="path: expected"):
            smooth(space, bad, np.random.default_rng(0))  # type: ignore[arg-type]


def test_path_clearance__is_that_of_a_fine_sampling_and_never_above() -> None:
    problem = make_distribution("TrapCup").problem(0)
    path = guided_search(problem, "wavefront", seed=0, measure=False).path
    assert path is not None
    fine = spaced_path(problem.space, path, 1e-3)
    sampled = float(np.asarray(problem.space.clearance(fine)).min())
    found = path_clearance(problem.space, path, 1e-4)
    assert sampled - 2e-3 <= found <= sampled + 1e-12
    corner = path_clearance(_corridor(), np.array([[1.0, 3.0], [8.0, 3.0], [8.0, 9.0]]), 1e-3)
    assert 1.0 - 1e-3 <= corner <= 1.0  # by hand: 1 below the obstacle


def test_spaced_path__has_no_longer_steps_and_the_same_length() -> None:
    space = ConfigurationSpace(Robot.rectangle(1.0, 0.5), Environment((0.0, 0.0, 10.0, 10.0)))
    path = np.array([[1.0, 1.0, 3.0], [4.0, 5.0, -3.0], [4.0, 5.0, 0.0]])
    fine = spaced_path(space, path, 0.1)
    steps = space.distance(fine[:-1], fine[1:])
    assert steps.max() <= 0.1 + 1e-12
    assert path_length(space, fine) == pytest.approx(path_length(space, path))


def test_headings__of_travel() -> None:
    space = ConfigurationSpace(Robot.rectangle(1.0, 0.5), Environment((0.0, 0.0, 10.0, 10.0)))
    path = np.array([[1, 1, 0], [1, 1, 1], [2, 1, 1], [2, 1, 2], [2, 3, 2.0]], float)
    np.testing.assert_allclose(headings(space, path), [0, 0, 0, np.pi / 2, np.pi / 2])


@needs_toppra
@pytest.mark.parametrize(("name", "seed"), [("TrapCup", 0), ("RandomMaze", 1), ("HardPointMaze", 2)])
def test_time_path__keeps_the_limits_and_stays_free(name: str, seed: int) -> None:
    """toppra's default parametrizer exceeds the acceleration by a quarter; here nothing is exceeded."""
    problem = make_distribution(name).problem(seed)
    space = problem.space
    path = guided_search(problem, "wavefront", seed=0, measure=False, max_samples=4000).path
    assert path is not None
    path = smooth(space, path, np.random.default_rng(0))
    velocity, acceleration = 0.7, 0.5
    timed = time_path(space, path, velocity, acceleration, interval=0.002)
    assert (np.diff(timed.times) > 0).all()
    assert np.abs(timed.velocities).max() <= velocity * (1 + 1e-9)
    assert np.abs(timed.accelerations).max() <= acceleration * (1 + 1e-9)
    assert np.abs(timed.accelerations).max() > 0.8 * acceleration  # as fast as they allow
    # Independently, from positions alone.
    step = np.diff(timed.times)
    moved = space.difference(timed.configurations[:-1], timed.configurations[1:]) / step[:, None]
    assert np.abs(moved).max() <= velocity * (1 + 1e-6)
    even = np.abs(step - 0.002) < 1e-9
    change = np.diff(moved, axis=0)[even[1:] & even[:-1]] / 0.002
    assert np.abs(change).max() <= acceleration * (1 + 1e-3)
    assert np.asarray(space.valid(timed.configurations)).all()
    np.testing.assert_allclose(timed.configurations[[0, -1]], path[[0, -1]], atol=1e-9)
    np.testing.assert_allclose(timed.velocities[[0, -1]], 0.0, atol=1e-9)


@needs_toppra
def test_time_path__of_a_straight_line_by_hand() -> None:
    space = ConfigurationSpace(Robot.point(), Environment((0.0, 0.0, 10.0, 10.0)))
    timed = time_path(space, np.array([[1.0, 1.0], [9.0, 1.0]]), 2.0, 1.0)
    # 2 s to 2 m/s over 2 m, 4 m at 2 m/s, 2 s to a stop.
    assert timed.duration == pytest.approx(6.0, rel=0.01)
    assert timed.stops == 0


@needs_toppra
def test_time_path__stops_at_each_corner_where_it_may_not_round() -> None:
    space = ConfigurationSpace(Robot.point(), Environment((0.0, 0.0, 10.0, 10.0)))
    path = np.array([[1.0, 1.0], [5.0, 1.0], [5.0, 5.0], [9.0, 5.0]])
    sharp = time_path(space, path, 2.0, 1.0, blend=0.0)
    assert sharp.stops == 2
    assert time_path(space, path, 2.0, 1.0).duration < sharp.duration
    passed = np.abs(sharp.configurations - path[1]).max(axis=1).min()
    assert passed < 1e-9


@needs_toppra
def test_time_path__refuses_limits_that_are_none() -> None:
    space = ConfigurationSpace(Robot.point(), Environment((0.0, 0.0, 10.0, 10.0)))
    path = np.array([[1.0, 1.0], [5.0, 1.0]])
    for velocity, acceleration in ((0.0, 1.0), (1.0, float("nan")), ([1.0, 1.0, 1.0], 1.0), (1.0, -1.0)):
        with pytest.raises(InvalidInputError):
            time_path(space, path, velocity, acceleration)
