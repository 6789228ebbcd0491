"""Fields on grids of poses: distances, room of a robot, waves, lookup."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from guided_gym.kernels import fields, marching
from guided_gym.kernels.fields import FINE

OPEN = np.zeros((0, 0, 0), np.uint8)  # links
N = 32
UNIT = np.array([0.0, 0.0, 1.0, 1.0])


def frame_of(side: float = 1.0, n: int = N, weight: float = 0.0, goal: tuple[float, ...] = (0.5, 0.5, 0.0)):
    cell = side / n
    return np.array([cell / 2, cell / 2, cell, weight, *goal])


def waved(slowness: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """A wave from the poses around the goal, as if nothing were in between."""
    places, _, values = fields.poses_near_goal(slowness.shape, frame, 2)
    return marched(slowness, places, values, frame)


def marched(
    slowness: np.ndarray,
    places: np.ndarray,
    values: np.ndarray,
    frame: np.ndarray,
    target: tuple[float, ...] = (),
) -> np.ndarray:
    """A wave over poses of a slowness, everywhere; what it does not come to is infinite."""
    flat, shape = marching.bordered(slowness.astype(np.float32), np.inf), slowness.shape
    limits = (float(slowness[np.isfinite(slowness)].max()),) * 2
    front = marching.begin(
        flat, np.ones_like(flat), shape, OPEN.reshape(-1), limits, places, values, frame, np.array(target)
    )
    ground = ground_of(np.zeros((0, 4)), np.zeros((1, 3)), 0.0, shape[2], frame, shape[0])
    marching.reach(front, ground, np.flatnonzero(np.isfinite(flat)))
    return front.known.reshape(shape[0] + 2, shape[1] + 2, shape[2])[1:-1, 1:-1]


def ground_of(
    edges: np.ndarray,
    body: np.ndarray,
    radius: float,
    turns: int,
    frame: np.ndarray | None = None,
    n: int = N,
) -> fields.Ground:
    frame = frame_of() if frame is None else frame
    return fields.unseen(edges, UNIT, frame, n, turns, np.asarray(body, np.float64), radius, FINE)


def distances_of(edges: np.ndarray, frame: np.ndarray | None = None, n: int = N) -> np.ndarray:
    ground = ground_of(edges, np.zeros((1, 3)), 0.0, 1, frame, n)
    fields.look_everywhere(ground)
    return ground.distances


def room_of(edges: np.ndarray, body: np.ndarray, radius: float, turns: int) -> np.ndarray:
    ground = ground_of(edges, body, radius, turns)
    fields.look_everywhere(ground)
    return ground.room


def square(x0: float, y0: float, x1: float, y1: float) -> np.ndarray:
    return np.array([[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]])


def random_obstacles(rng: np.random.Generator) -> shapely.MultiPolygon:
    """The union of rings with holes, slivers and triangles, some of which overlap or stick out."""
    parts = []
    for _ in range(5):
        middle = shapely.Point(rng.uniform(0, 1, 2))
        parts.append(middle.buffer(rng.uniform(0.1, 0.25), quad_segs=3) - middle.buffer(0.08, quad_segs=2))
        parts.append(shapely.Polygon(rng.uniform(-0.1, 1.1, 2) + rng.uniform(-0.15, 0.15, (3, 2))))
    x, y = rng.uniform(0, 1, 2)
    parts.append(shapely.box(x, y, x + 0.3, y + 0.004))
    union = shapely.union_all(parts)
    return union if isinstance(union, shapely.MultiPolygon) else shapely.MultiPolygon([union])


def edges_of(rng: np.random.Generator, obstacles: shapely.MultiPolygon) -> np.ndarray:
    """Their edges, in no order."""
    rings = [ring for p in obstacles.geoms for ring in (p.exterior, *p.interiors)]
    corners = [shapely.get_coordinates(ring) for ring in rings]
    edges = np.concatenate([np.hstack([part[:-1], part[1:]]) for part in corners])
    return np.ascontiguousarray(rng.permutation(edges))


def test_signed_distances__by_hand() -> None:
    found = distances_of(square(0.4, 0.4, 0.6, 0.6))
    assert found.shape == (FINE * N, FINE * N)
    sample = 0.5 / FINE  # of a cell, from the middle of the square or the rim of the bounds
    assert found[FINE * N // 2, FINE * N // 2] == pytest.approx(-0.1 * N + sample)
    assert found[0, FINE * N // 2] == pytest.approx(sample)
    assert found[FINE * N // 2, FINE * N // 4] == pytest.approx((0.4 - 0.25) * N - sample, rel=1e-5)


@pytest.mark.parametrize("seed", range(6))
def test_signed_distances__agree_with_shapely(seed: int) -> None:
    rng = np.random.default_rng(seed)
    obstacles = random_obstacles(rng)
    n = 24
    frame = np.array([-0.2, 0.1, 1.5 / n, 0, 0, 0, 0])  # reaches beyond the bounds on two sides
    found = distances_of(edges_of(rng, obstacles), frame, n).astype(np.float64) * frame[2]
    offsets = ((np.arange(n * FINE) + 0.5) / FINE - 0.5) * frame[2]
    x, y = np.meshgrid(frame[0] + offsets, frame[1] + offsets)
    points = shapely.points(x, y)
    inside = shapely.contains_properly(obstacles, points)
    distance = np.where(inside, -1, 1) * shapely.distance(obstacles.boundary, points)
    spare = np.minimum(np.minimum(x, 1 - x), np.minimum(y, 1 - y))
    assert inside.any()
    assert np.allclose(found, np.minimum(distance, spare), atol=1e-6)


def test_signed_distances__without_obstacles_are_those_to_the_bounds() -> None:
    found = distances_of(np.zeros((0, 4)))
    assert found.max() == pytest.approx(N / 2 - 0.5 / FINE)
    assert (found > 0).all()


def test_robot_clearances__of_a_rod_depend_on_its_heading() -> None:
    walls = np.concatenate([square(0.0, 0.0, 1.0, 0.4), square(0.0, 0.6, 1.0, 1.0)])
    rod = np.array([[x, 0.0, 0.0] for x in np.linspace(-0.07, 0.07, 9) * N])
    room = room_of(walls, rod, 0.07 * N, 8)
    assert room.shape == (N, N, 8)
    along, across = room[N // 2, N // 2, 0], room[N // 2, N // 2, 2]
    assert along == pytest.approx(fields.CLIP, abs=1.0)  # (0.1 - 0.5 / N) * N, more than the clip
    assert along >= fields.CLIP
    assert across == pytest.approx((0.03 - 0.5 / N) * N, abs=0.1)


def test_robot_clearances__outside_the_grid_is_no_room() -> None:
    rod = np.array([[-0.3, 0.0, 0.0], [0.0, 0.0, 0.0], [0.3, 0.0, 0.0]]) * N
    room = room_of(np.zeros((0, 4)), rod, 0.3 * N, 4)
    assert room[N // 2, 2, 0] < 0 < room[N // 2, 2, 1]


@pytest.mark.parametrize("seed", range(3))
def test_robot_clearances__are_the_room_at_each_pose_of_the_grid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    edges = edges_of(rng, random_obstacles(rng))
    distances = distances_of(edges)
    body = np.column_stack([rng.uniform(-2.5, 2.5, (12, 2)), rng.uniform(0, 0.7, 12)])
    radius = float(np.max(np.hypot(body[:, 0], body[:, 1]) + body[:, 2]))
    turns = 8
    found = room_of(edges, body, radius, turns)
    for r, c, t in rng.integers((N, N, turns), size=(4000, 3)):
        theta = 2 * math.pi * t / turns
        at = float(c), float(r), math.cos(theta), math.sin(theta)
        room = fields._room(distances, FINE, *at, body, -np.inf)
        if fields.LEAST < found[r, c, t] < fields.CLIP:
            assert found[r, c, t] == pytest.approx(room, abs=0.005)  # float32 shares
        elif found[r, c, t] <= fields.LEAST:
            assert room <= fields.LEAST + 0.005
        else:
            assert room >= fields.CLIP - math.sqrt(0.5) / FINE  # looked up at the sample beside the centre


@pytest.mark.parametrize("seed", range(3))
def test_robot_clearances__of_a_disc_are_its_distance_less_its_radius(seed: int) -> None:
    """One sample a cell tells it, in part of the grid as in all of it."""
    rng = np.random.default_rng(seed)
    obstacles = random_obstacles(rng)
    disc = np.array([[0.0, 0.0, 0.7]])
    made = [fields.unseen(edges_of(rng, obstacles), UNIT, frame_of(), N, 1, disc, 0.7, 1) for _ in range(2)]
    fields.look_everywhere(made[0])
    fields.look(made[1], N // 2, N // 3)
    part = np.isfinite(made[1].room)
    assert 0 < part.sum() < part.size
    assert np.array_equal(made[1].room[part], made[0].room[part])
    fine = distances_of(edges_of(rng, obstacles))
    middles = fine.reshape(N, FINE, N, FINE)[
        :, FINE // 2 - 1 : FINE // 2 + 1, :, FINE // 2 - 1 : FINE // 2 + 1
    ]
    assert np.abs(made[0].room[:, :, 0] + 0.7 - middles.mean(axis=(1, 3))).max() < math.sqrt(0.5) / FINE


def test_robot_clearances__of_a_fork_astride_a_post() -> None:
    """The reference point lies deep in the post, and the body does not."""
    prongs = np.array([[x, y, 0.0] for x in (-5.0, 5.0) for y in np.linspace(-4, 4, 9)])
    room = room_of(square(0.4, 0.4, 0.6, 0.6), prongs, 6.5, 4)
    assert room[N // 2, N // 2, 0] == pytest.approx(5 - 0.1 * N, abs=0.6)


def test_wave__in_the_open_is_the_distance() -> None:
    frame = frame_of()
    found = waved(np.ones((N, N, 1)), frame)
    exact = fields.goal_distances(N, 1, frame)
    assert np.abs(found - exact).max() < 0.03
    assert (found >= exact - 1e-6).all()


def test_wave__goes_round_a_wall_and_is_slow_through_it() -> None:
    slowness = np.ones((N, N, 1), np.float32)
    slowness[:24, 15:17] = 100.0
    found = waved(slowness, frame_of(goal=(0.8, 0.1, 0.0)))[..., 0]
    around = math.hypot(0.3, 0.65) + math.hypot(0.3, 0.65)
    assert found[3, 6] == pytest.approx(around, rel=0.1)


def test_wave__begins_where_it_is_told() -> None:
    places, frame = np.array([3 * N + 5, 30 * N + 30]), frame_of()
    ones = np.ones((N, N, 1), np.float32)
    found = marched(ones, places, np.array([2.0, 2.5]), frame)[..., 0]
    assert found[3, 5] == found.min() == 2.0
    assert found[30, 30] == 2.5
    assert found[3, 15] == pytest.approx(2.0 + 10 / N)
    assert found[30, 20] == pytest.approx(2.5 + 10 / N)


def test_look__finds_a_block_as_looking_everywhere_does() -> None:
    rng = np.random.default_rng(1)
    edges, body = edges_of(rng, random_obstacles(rng)), np.array([[-1.5, 0.0, 0.2], [1.5, 0.0, 0.2]])
    whole = room_of(edges, body, 1.7, 4)
    ground = ground_of(edges, body, 1.7, 4)
    fields.look(ground, 9, 20)
    seen = ~np.isnan(ground.room)
    assert 0 < seen.sum() < seen.size / 4
    assert seen[9, 20].all()
    assert np.array_equal(ground.room[seen], whole[seen])


def test_wave__towards_a_target_comes_there_before_it_looks_elsewhere() -> None:
    """And no more than a few percent late, wherever it comes; never early."""
    slowness = np.ones((N, N, 8), np.float32)
    slowness[:20, 15:17] = 100.0
    frame = frame_of(weight=0.1, goal=(0.8, 0.2, 0.3))
    places, _, values = fields.poses_near_goal(slowness.shape, frame, 2)
    flat, doors = marching.bordered(slowness, np.inf), OPEN.reshape(-1)
    rest = (slowness.shape, doors, (100.0, 100.0), places, values, frame)
    ground = ground_of(np.zeros((0, 4)), np.zeros((1, 3)), 0.0, 8, frame)
    plain = marching.begin(flat, np.ones_like(flat), *rest, np.zeros(0))
    ahead = marching.begin(flat, np.ones_like(flat), *rest, np.array([0.2, 0.2, 0.3]))
    target = np.array([((6 + 1) * (N + 2) + 6 + 1) * 8])
    for front in (plain, ahead):
        marching.reach(front, ground, target)
    both = np.isfinite(plain.known) & np.isfinite(ahead.known)
    assert both[target[0]]
    assert np.isfinite(ahead.known).sum() < 0.8 * np.isfinite(plain.known).sum()
    ratio = ahead.known[both] / np.maximum(plain.known[both], 0.1)
    assert ratio.max() < 1.1
    assert (ahead.known[both] >= plain.known[both] - 0.3 / N).all()  # the queue is a little untidy
    before = ahead.known[both].copy()
    marching.reach(ahead, ground, np.flatnonzero(np.isfinite(flat)))
    assert np.isfinite(ahead.known[np.isfinite(flat)]).all()
    assert np.array_equal(ahead.known[both], before)  # what has been told stands


def test_poses_near_goal__are_the_cells_around_it_and_the_headings_beside() -> None:
    frame = frame_of(weight=0.1, goal=(0.5, 0.02, -0.1))
    places, poses, distances = fields.poses_near_goal((N, N, 8), frame, 2)
    rows, columns, headings = np.unravel_index(places, (N, N, 8))
    assert len(set(places.tolist())) == len(places) == len(poses)
    assert sorted(set(rows)) == [0, 1, 2, 3]  # there are none below
    assert sorted(set(columns)) == list(range(13, 19))
    assert sorted(set(headings)) == [0, 7]
    expected = np.column_stack([(columns + 0.5) / N, (rows + 0.5) / N, 2 * math.pi * headings / 8])
    assert poses == pytest.approx(expected)
    turn = 0.1 * np.angle(np.exp(1j * (expected[:, 2] + 0.1)))
    assert distances == pytest.approx(np.hypot(np.hypot(expected[:, 0] - 0.5, expected[:, 1] - 0.02), turn))
    places, poses, _ = fields.poses_near_goal((N, N, 1), frame, 0)
    assert places.tolist() == [0 * N + 15, 0 * N + 16, 1 * N + 15, 1 * N + 16]
    assert (poses[:, 2] == frame[fields.GOAL + 2]).all()


def test_wave__turns_the_short_way_round() -> None:
    frame = frame_of(weight=0.1, goal=(0.5, 0.5, math.pi - 0.01))
    found = waved(np.ones((N, N, 16)), frame)
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


def walled_field(gap: slice, turns: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """The way to the right end of a grid, blocked in column 15 but for a gap in it; what seems free."""
    free = np.ones((N, N, turns), bool)
    free[:, 15] = False
    free[gap, 15] = True
    arrival = waved(np.where(free, 1.0, 300.0), frame_of(goal=(0.9, 0.5, 0.0)))
    return arrival, np.where(free, 1.0, -1.0).astype(np.float32)


@pytest.mark.parametrize("turns", [1, 8])
def test_blocked_on_way__counts_what_a_wall_blocks(turns: int) -> None:
    q, frame = np.array([0.1, 0.5, 1.0])[: 2 if turns == 1 else 3], frame_of(weight=0.1, goal=(0.9, 0.5, 0.0))
    assert fields.blocked_on_way(q, *walled_field(slice(0, 0), turns), OPEN, frame) == 1
    assert fields.blocked_on_way(q, *walled_field(slice(28, 31), turns), OPEN, frame) == 0
    behind = np.array([0.7, 0.5, 1.0])[: q.size]
    assert fields.blocked_on_way(behind, *walled_field(slice(0, 0), turns), OPEN, frame) == 0


def test_blocked_on_way__leaves_out_where_it_begins() -> None:
    field, seems = walled_field(slice(0, 0))
    frame = frame_of(goal=(0.9, 0.5, 0.0))
    between = np.array([frame[0] + 14.5 * frame[2], 0.5])
    assert fields.blocked_on_way(between, field, -np.abs(seems), OPEN, frame) > 10  # all seems blocked
    seems[:, :14] *= -1  # blocked far to the left only
    beside = np.array([frame[0] + 15.5 * frame[2], 0.5])  # among the wall and what is free behind it
    assert fields.blocked_on_way(beside, field, seems, OPEN, frame) == 0


def test_blocked_on_way__counts_a_way_that_the_wave_has_not_come() -> None:
    frame = frame_of(goal=(0.9, 0.5, 0.0))
    field, seems = np.full((N, N, 1), 9.0, np.float32), np.ones((N, N, 1), np.float32)
    assert fields.blocked_on_way(np.array([0.1, 0.5]), field, seems, OPEN, frame) == 1
    assert fields.blocked_on_way(np.array([0.9, 0.5]), field, seems, OPEN, frame) == 0


@pytest.mark.parametrize("turns", [1, 5, 8])
def test_look__gives_a_body_the_least_room_of_its_discs__opposite_of_each_other_or_not(turns: int) -> None:
    edges = square(0.2, 0.3, 0.45, 0.6)
    body = np.array(
        [[1.3, 0.4, 0.1], [-1.3, -0.4, 0.1], [0.2, -0.9, 0.3], [1.1, 0.6, 0.2], [-1.1, -0.6, 0.3]]
    )
    rooms = []
    for discs in (body, *body[:, None]):  # one disc has none opposite
        ground = ground_of(edges, discs, 2.0, turns)
        fields.look_everywhere(ground)
        rooms.append(ground.room)
    assert rooms[0] == pytest.approx(np.min(rooms[1:], axis=0), abs=1e-6)


def test_crowding__is_one_at_a_point_and_nothing_far_off() -> None:
    points = np.array([[0.0, 0.0, math.pi - 0.01]])
    q = np.array([[0.0, 0.0, -math.pi + 0.01], [2.0, 0.0, 0.0]])
    near, far = fields.crowding(q, points, np.array([1.0]), 0.5, 0.1)
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


@pytest.mark.parametrize("weight", [0.0, 0.001, 0.1, 30.0])
def test_wave__is_the_same_at_every_heading_where_nothing_blocks(weight: float) -> None:
    """However much a turn costs: more than the buckets of the queue go round, or nothing."""
    frame = frame_of(weight=weight, goal=(0.9, 0.5, 0.0))
    free = np.ones((N, N, 8), bool)
    free[:20, 15] = False
    found = waved(np.where(free, 1.0, 300.0), frame)[free]
    flat = waved(np.where(free[..., :1], 1.0, 300.0), frame_of(goal=(0.9, 0.5, 0.0)))[free[..., 0]]
    assert np.allclose(found.reshape(-1, 8).min(axis=1), flat[:, 0], atol=0.02)
    turned = found.reshape(-1, 8)[:, 4] - found.reshape(-1, 8)[:, 0]
    assert (turned <= weight * math.pi + 1e-3).all()


def test_spare_room__sees_two_obstacles_that_touch_at_a_corner() -> None:
    corner = np.concatenate([square(0.2, 0.5, 0.5, 0.8), square(0.5, 0.2, 0.8, 0.5)])
    ground = ground_of(corner, np.zeros((1, 3)), 0.0, 1)
    fields.look_everywhere(ground)
    q, ends = np.array([0.45, 0.44]), np.array([[0.55, 0.56], [0.3, 0.44], [0.45, 0.3]])
    through, along, back = fields.spare_room(q, ends, ground, frame_of(), 32)
    assert through < 0 <= min(along, back)


def test_look_up__does_not_mix_the_two_sides_of_a_thin_wall() -> None:
    field = np.full((4, 4, 1), 1.0, np.float32)
    field[:, 2:] = 5.0  # no pose lies in the wall
    frame = frame_of(n=4, goal=(0.1, 0.1, 0.0))
    left, right = fields.look_up(np.array([[0.45, 0.5], [0.55, 0.5]]), field, frame)
    assert (left, right) == (1.0, 5.0)
