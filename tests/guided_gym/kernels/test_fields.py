"""Fields on grids of poses: distances, room of a robot, waves, lookup."""

from __future__ import annotations

import math

import numpy as np
import pytest

from guided_gym.environment import Environment
from guided_gym.kernels import fields

N = 32
ROOMY = np.full((N, N, 1), 9.0, np.float32)


def frame_of(side: float = 1.0, n: int = N, weight: float = 0.0, goal: tuple[float, ...] = (0.5, 0.5, 0.0)):
    cell = side / n
    return np.array([cell / 2, cell / 2, cell, weight, *goal])


def square(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    return np.array([[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]])


def test_signed_distances__outside_agree_with_the_environment() -> None:
    environment = Environment.from_polygons((0, 0, 1, 1), [[(0.4, 0.4), (0.6, 0.4), (0.6, 0.6), (0.4, 0.6)]])
    frame = frame_of()
    found = fields.signed_distances(square(0.4, 0.4, 0.6, 0.6), np.array([0.0, 0.0, 1.0, 1.0]), frame, N)
    centres = frame[0] + frame[2] * np.arange(N)
    points = np.stack(np.meshgrid(centres, centres), axis=-1)
    clearance = environment.clearance(points)
    assert np.allclose(np.maximum(found, 0), clearance, atol=1e-9)
    assert found[N // 2, N // 2] == pytest.approx(-0.1 + frame[2] / 2)


def test_robot_clearances__of_a_rod_depend_on_its_heading() -> None:
    distances = fields.signed_distances(
        np.concatenate([square(0.0, 0.0, 1.0, 0.4), square(0.0, 0.6, 1.0, 1.0)]),
        np.array([0.0, 0.0, 1.0, 1.0]),
        frame_of(),
        N,
    )
    rod = np.array([[x, 0.0, 0.0] for x in np.linspace(-0.2, 0.2, 9)])
    room = fields.robot_clearances(distances, rod, 0.2, 1 / N, 8)
    along, across = room[N // 2, N // 2, 0], room[N // 2, N // 2, 2]
    assert along == pytest.approx((0.1 - 0.5 / N) * N, abs=0.1)
    assert across == pytest.approx((-0.1 - 0.5 / N) * N, abs=0.1)


def test_robot_clearances__outside_the_grid_is_no_room() -> None:
    distances = fields.signed_distances(np.zeros((0, 4)), np.array([0.0, 0.0, 1.0, 1.0]), frame_of(), N)
    rod = np.array([[-0.3, 0.0, 0.0], [0.0, 0.0, 0.0], [0.3, 0.0, 0.0]])
    room = fields.robot_clearances(distances, rod, 0.3, 1 / N, 4)
    assert room[N // 2, 2, 0] < 0 < room[N // 2, 2, 1]


def test_wave__in_the_open_is_the_distance() -> None:
    frame = frame_of()
    found = fields.wave(np.ones((N, N, 1), np.float32), ROOMY, frame)
    exact = fields.goal_distances(N, 1, frame)
    assert np.abs(found - exact).max() < 0.03
    assert (found >= exact - 1e-6).all()


def test_wave__goes_round_a_wall_and_is_slow_through_it() -> None:
    slowness = np.ones((N, N, 1), np.float32)
    slowness[:24, 15:17] = 100.0
    found = fields.wave(slowness, ROOMY, frame_of(goal=(0.8, 0.1, 0.0)))[..., 0]
    around = math.hypot(0.3, 0.65) + math.hypot(0.3, 0.65)
    assert found[3, 6] == pytest.approx(around, rel=0.1)


def test_wave__does_not_begin_behind_a_thin_wall() -> None:
    frame = frame_of(goal=(0.52, 0.5, 0.0))
    wall = square(0.49, 0.0, 0.51, 0.9)
    distances = fields.signed_distances(wall, np.array([0.0, 0.0, 1.0, 1.0]), frame, N)
    room = (distances * N).astype(np.float32)[..., None]
    slowness = np.where(np.abs(np.arange(N) - 15) < 1, 100.0, 1.0)[None, :, None] * np.ones((N, N, 1))
    slowness[29:] = 1.0
    found = fields.wave(slowness.astype(np.float32), room, frame)[..., 0]
    assert found[16, 12] > 0.8


def test_wave__turns_the_short_way_round() -> None:
    frame = frame_of(weight=0.1, goal=(0.5, 0.5, math.pi - 0.01))
    found = fields.wave(np.ones((N, N, 16), np.float32), np.full((N, N, 16), 9.0, np.float32), frame)
    before, after = found[N // 2, N // 2, 7], found[N // 2, N // 2, 9]
    assert before == pytest.approx(after, abs=0.02)
    assert found[N // 2, N // 2, 0] == pytest.approx(0.1 * math.pi, rel=0.15)


def test_look_up__leaves_out_blocked_corners_and_never_undercuts_the_distance() -> None:
    frame = frame_of(n=4, goal=(0.1, 0.1, 0.0))
    field = np.full((4, 4, 1), 2.0, np.float32)
    field[:, 2:] = -50.0
    inside, beside = fields.look_up(np.array([[0.2, 0.5], [0.49, 0.5]]), field, frame)
    assert inside == beside == 2.0
    far = fields.look_up(np.array([[0.95, 0.5]]), field, frame)[0]
    assert far == 50.0
    assert fields.look_up(np.array([[0.9, 0.1]]), np.zeros((4, 4, 1), np.float32), frame)[0] >= 0.8 - 1e-9


def test_look_up__is_periodic_in_the_heading() -> None:
    rng = np.random.default_rng(0)
    field = rng.random((4, 4, 8)).astype(np.float32) + 5
    frame = frame_of(n=4, weight=0.1)
    q = np.array([[0.4, 0.6, 3.1], [0.4, 0.6, 3.1 - 2 * math.pi], [0.4, 0.6, -math.pi], [0.4, 0.6, math.pi]])
    a, b, c, d = fields.look_up(q, field, frame)
    assert a == pytest.approx(b)
    assert c == pytest.approx(d)


def test_least_room__sees_what_lies_on_the_way() -> None:
    room = np.full((N, N, 1), 5.0, np.float32)
    room[:, 15:17] = -3.0
    q, frame = np.array([0.3, 0.5]), frame_of()
    across, along = fields.least_room(q, np.array([[0.7, 0.5], [0.3, 0.9]]), room, frame, 8)
    assert across < 0 < along


def test_crowding__is_one_at_a_point_and_nothing_far_off() -> None:
    points = np.array([[0.0, 0.0, math.pi - 0.01]])
    q = np.array([[0.0, 0.0, -math.pi + 0.01], [2.0, 0.0, 0.0]])
    near, far = fields.crowding(q, points, 0.5, 0.1)
    assert near == pytest.approx(1.0, abs=1e-3)
    assert far == 0.0


def test_corners__are_what_look_up_interpolates() -> None:
    rng = np.random.default_rng(0)
    field = (rng.random((4, 4, 8)) + 5).astype(np.float32)
    field[rng.random(field.shape) < 0.3] *= -1
    frame = frame_of(n=4, weight=0.1)
    q = rng.random((50, 3)) * [1, 1, 6]
    places, shares = fields.corners(q, field, frame)
    some = shares.sum(axis=1) > 0
    mixed = (np.abs(field).ravel()[places] * shares).sum(axis=1)
    assert some.sum() > 40
    assert np.allclose(mixed[some], fields.look_up(q, field, frame)[some], atol=1e-4)
