"""An arm in space before shelves: out of one compartment, into another."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.catalogue.distributions import ProblemDistribution, SampledProblems
from guided_gym.errors import NoPathError
from guided_gym.geometry.solids import Box, Capsule, Cylinder, Solid, SpatialEnvironment
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.geometry.spatial_arms import FIXED, SpatialArm, SpatialBody, SpatialJoint
from guided_gym.problems import Problem, Task

Array = NDArray[np.float64]

REACH: Final = 1.0  # of our arm, from its shoulder to its tool; a world for another arm is as much larger
SHOULDER: Final = 0.3  # its height
BOARD: Final = 0.02  # thickness of a board
TRIES: Final = 100  # worlds, until a task is found in one
_STARTS: Final = 64  # configurations from which a tool is brought to its place
_HAND: Final = 0.15  # how far the wrist is from it at least, likewise
_ROUNDS: Final = 40  # of doing so
_NEAR: Final = 0.03  # how near the tool comes to its place (parts of the reach)


def arm() -> SpatialArm:
    """An arm of seven joints, about z and y in turn, with a hand of two capsules."""
    limits = [None, (-2.0, 2.0), (-2.8, 2.8), (-2.4, 2.4), (-2.8, 2.8), (-2.2, 2.2), (-2.8, 2.8)]
    heights = [SHOULDER, 0.0, 0.22, 0.2, 0.2, 0.18, 0.07]
    joints = tuple(
        SpatialJoint(
            (0.0, 0.0, height), (0.0, float(k % 2), float(1 - k % 2)), limits=limit, name=f"joint{k + 1}"
        )
        for k, (height, limit) in enumerate(zip(heights, limits, strict=True))
    )
    lengths = {1: (0.2, 0.065), 2: (0.18, 0.06), 3: (0.18, 0.055), 4: (0.16, 0.05), 5: (0.05, 0.045)}
    bodies = [SpatialBody(FIXED, Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.12), 0.08), "foot")]
    bodies += [
        SpatialBody(k, Capsule((0.0, 0.0, 0.0), (0.0, 0.0, length), radius), f"link{k + 1}")
        for k, (length, radius) in lengths.items()
    ]
    bodies += [
        SpatialBody(6, Capsule((-0.04, 0.0, 0.03), (0.04, 0.0, 0.03), 0.025), "palm"),
        SpatialBody(6, Capsule((0.0, 0.0, 0.03), (0.0, 0.0, 0.11), 0.02), "finger"),
    ]
    return SpatialArm(
        joints, tuple(bodies), (6, (0.0, 0.0, 0.13)), self_collision=True, name="arm of 7 joints"
    )


def spatial_arm() -> Problem:
    """An arm of seven joints takes its hand out of a shelf's lower compartment and into the upper one."""
    return _drawn(arm(), np.random.default_rng(0), "SpatialArm", plain=True)


def random_spatial_arm(rng: np.random.Generator) -> Problem:
    """Shelves of other heights and depths, things on their boards, and other compartments."""
    return _drawn(arm(), rng, "RandomSpatialArm")


def shelves_for(urdf: str | Path, tip: str | None = None, **options: Any) -> ProblemDistribution:
    """The distribution of shelves, for the arm of a URDF file: they are as large as it reaches.

    Args:
        urdf: The file.
        tip: The link at the end of its chain, where it has several.
        **options: Those of `SpatialArm.from_urdf`.

    Raises:
        InvalidInputError: As `SpatialArm.from_urdf`.
    """
    robot = SpatialArm.from_urdf(urdf, tip, **options)
    return SampledProblems(
        robot.name,
        lambda rng: _drawn(robot, rng, robot.name),
        f"{robot.name} before shelves",
        angles=robot.dimension,
    )


def _drawn(robot: SpatialArm, rng: np.random.Generator, name: str, plain: bool = False) -> Problem:
    """A world in which the tool has places in two compartments.

    Raises:
        NoPathError: In none of many.
    """
    for _ in range(TRIES):
        environment, places = _shelf(rng, robot, plain)
        space = ConfigurationSpace(robot, environment)
        lower, upper = (0, 1) if plain else rng.permutation(len(places))[:2].tolist()
        start, goal = (_reaching(space, rng, places[k]) for k in (lower, upper))
        if start is not None and goal is not None and not space.motion_free(start, goal):
            return Problem(robot, environment, Task(start, goal), name)
    raise NoPathError(f"{name}: expected configurations in two compartments, got none in {TRIES} worlds")


def _shelf(
    rng: np.random.Generator, robot: SpatialArm, plain: bool
) -> tuple[SpatialEnvironment, list[Array]]:
    """A shelf before the arm, of two or three compartments, a table under it, and the middle of each."""
    size = robot.radius / REACH
    front, depth = (0.4, 0.32) if plain else (rng.uniform(0.36, 0.46), rng.uniform(0.24, 0.36))
    half = 0.38 if plain else rng.uniform(0.3, 0.45)
    count = 2 if plain else int(rng.integers(2, 4))
    bottom, room = (0.05, 0.38) if plain else (rng.uniform(0.0, 0.1), rng.uniform(0.3, 0.38))
    levels = bottom + room * np.arange(count + 1)
    back, top = front + depth, float(levels[-1])
    low = -0.12
    boxes = [((-0.35, -0.6, low), (front - 0.02, 0.6, low + 0.04))]  # the table on which the arm stands
    boxes += [((front, -half, z), (back, half, z + BOARD)) for z in levels.tolist()]
    boxes += [((front, y - BOARD, bottom), (back, y, top + BOARD)) for y in (-half, half + BOARD)]
    boxes += [((back, -half, bottom), (back + BOARD, half, top + BOARD))]
    solids: list[Solid] = [Box.between(size * np.array(a), size * np.array(b)) for a, b in boxes]
    places = [np.array([front + 0.45 * depth, 0.0, z + 0.5 * room]) * size for z in levels[:-1]]
    if not plain:
        for _ in range(int(rng.integers(1, 4))):
            solids.append(_thing(rng, size, (front, back), half, float(rng.choice(levels[:-1])) + BOARD))
        for place in places:
            place[1] = size * rng.uniform(-0.6, 0.6) * half
    edge = 1.25 * size
    return SpatialEnvironment((-edge, -edge, low * size, edge, edge, 1.6 * size), solids), places


def _thing(
    rng: np.random.Generator, size: float, deep: tuple[float, float], half: float, floor: float
) -> Solid:
    """A cylinder or a ball on a board."""
    radius = rng.uniform(0.025, 0.05)
    x, y = rng.uniform(deep[0] + radius, deep[1] - radius), rng.uniform(radius - half, half - radius)
    if rng.random() < 0.5:
        return Capsule.sphere((size * np.array([x, y, floor + radius])).tolist(), size * radius)
    ends = [size * np.array([x, y, z]) for z in (floor, floor + rng.uniform(0.08, 0.2))]
    (ax, ay, az), (bx, by, bz) = (end.tolist() for end in ends)
    return Cylinder((ax, ay, az), (bx, by, bz), size * radius)


def _reaching(space: ConfigurationSpace, rng: np.random.Generator, place: Array) -> Array | None:
    """A free configuration whose tool is near a place, the wrist before it; None if no start leads there.

    By damped least squares (Levenberg and Marquardt) on where tool and wrist are.
    """
    robot = space.robot
    assert isinstance(robot, SpatialArm)
    hand = _hand(robot)
    before = np.array([hand[1], 0.0, 0.0])
    wanted = np.concatenate([place, place - before])
    q = space.sample(rng, _STARTS)
    d, small = space.dimension, 1e-5
    for _ in range(_ROUNDS):
        now = _points(robot, q, hand[0])
        change = (_points(robot, q[:, None, :] + small * np.eye(d), hand[0]) - now[:, None, :]) / small
        square = np.einsum("nij,nik->njk", change, change) + 1e-3 * np.eye(6)
        step = np.einsum("nij,nj->ni", change, np.linalg.solve(square, (wanted - now)[..., None])[..., 0])
        longest = np.abs(step).max(axis=1, keepdims=True)
        q = space.wrap(q + step * np.minimum(1.0, 0.4 / np.maximum(longest, 1e-9)))
        q = np.where(space.periods > 0, q, np.clip(q, space.lower, space.upper))
    near = np.linalg.norm(place - robot.tool_at(q), axis=1) < _NEAR * robot.radius
    fit = np.flatnonzero(near & np.asarray(space.valid(np.ascontiguousarray(q))))
    # Rounded as people would write it, which may be a contact: then as it is.
    found = [p for k in fit[:1] for p in (np.round(q[k], 6), q[k]) if space.valid(p)]
    return found[0] if found else None


def _hand(robot: SpatialArm) -> tuple[int, float]:
    """The last joint that is some way from the tool, and how far that is."""
    q = np.array([0.5 * (low + high) for low, high in _ranges(robot)])
    away = np.linalg.norm(robot.frames(q)[0] - robot.tool_at(q), axis=-1)
    joint = int(np.flatnonzero(away >= _HAND * robot.radius).max(initial=0))
    return joint, float(away[joint])


def _ranges(robot: SpatialArm) -> list[tuple[float, float]]:
    names = {joint.name: joint.limits or (-1.0, 1.0) for joint in robot.joints}
    return [names[name] for name in robot.names]


def _points(robot: SpatialArm, q: Array, wrist: int) -> Array:
    """(..., 6) where the tool and a joint are."""
    return np.concatenate([robot.tool_at(q), robot.frames(q)[0][..., wrist, :]], axis=-1)
