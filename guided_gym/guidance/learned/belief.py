"""A learned belief: how likely configurations and motions are free, from a raster of the workspace.

No grid over C: the network sees the room that each body has, at places close together along a motion, and
serves robots of any number of joints. `guided_gym.guidance.modifications.Predicted` makes an environment
modification of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.checks import integer, number
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.linkages import Linkage
from guided_gym.geometry.mechanism import Mechanism
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.weights import Tensors
from guided_gym.guidance.solvers.wave import obstacle_edges, square_frame
from guided_gym.kernels import belief, fields

Floats = NDArray[np.float64]

_POINTS: Final = 3  # along a body, at least
_ROBOTS: Final = 8  # whose tables are kept
_SURE: Final = 20.0  # logit of a unit of room, where nothing is learned


@dataclass(frozen=True)
class BeliefArchitecture:
    """Sizes of a belief network, and how closely it looks.

    Attributes:
        cells: Cells along each side of the raster, each of `fields.FINE` samples squared.
        hidden: Units of the network.
        unit: What room and moves are measured in, in natural lengths of the space.
        spacing: How far a configuration that is looked at is from the next one, in natural lengths.

    Raises:
        InvalidInputError: A size that cannot be.
    """

    cells: int = 32
    hidden: int = 16
    unit: float = 0.5
    spacing: float = 0.5

    def __post_init__(self) -> None:
        integer("cells", self.cells, least=4)
        integer("hidden", self.hidden, least=1)
        number("unit", self.unit, above=0)
        number("spacing", self.spacing, above=0)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of each tensor."""
        h = self.hidden
        return {
            "first.weight": (h, belief.COLUMNS),
            "first.bias": (h,),
            "last.weight": (1, h),
            "last.bias": (1,),
        }

    @classmethod
    def from_card(cls, entry: Any) -> BeliefArchitecture:
        """The architecture that a card names.

        Raises:
            StorageError: The entry is not one that this version can build.
        """
        return weights.architecture(cls, entry, "belief network")


class BeliefModel:
    """A belief network, for inference.

    Args:
        architecture: Its sizes.
        tensors: Its tensors, named as in `BeliefArchitecture.shapes`.
    """

    def __init__(self, architecture: BeliefArchitecture, tensors: Tensors) -> None:
        self.architecture = architecture
        t = {name: np.ascontiguousarray(tensor, np.float64) for name, tensor in tensors.items()}
        self.net = belief.Net(
            t["first.weight"], t["first.bias"], t["last.weight"][0].copy(), float(t["last.bias"][0])
        )

    def on(self, space: ConfigurationSpace) -> Belief:
        """The belief about a space.

        Raises:
            InvalidInputError: A robot that is not planar.
        """
        return Belief(self, space)


class Belief:
    """What is believed about the motions of one space.

    Attributes:
        looks: Configurations that were looked at in the raster.
    """

    def __init__(self, model: BeliefModel, space: ConfigurationSpace) -> None:
        self.space, self.looks = space, 0
        self._net = model.net
        self._scene = scene_of(space, model.architecture)

    def motions(self, starts: Floats, ends: Floats, least: float = 0.0) -> Floats:
        """(n,) p(free) of the straight motions between (n, d) configurations.

        Args:
            starts: Where they begin.
            ends: Where they end; the same for configurations.
            least: What is less likely is not looked at to its end: its p is at most this.
        """
        starts, ends = np.ascontiguousarray(starts), np.ascontiguousarray(ends)
        lowest = math.log(least) if least > 0.0 else belief.NEVER
        found, looks = belief.motions_likely(starts, ends, self._scene, self._net, self.space.metric, lowest)
        self.looks += looks
        return np.asarray(np.exp(found))


def plain_tensors(architecture: BeliefArchitecture) -> Tensors:
    """Tensors that have learned nothing: a motion is free if both ends have room, whatever lies between."""
    tensors = {name: np.zeros(shape, np.float32) for name, shape in architecture.shapes().items()}
    tensors["first.weight"][0, 0] = 1.0
    tensors["first.bias"][0] = belief.FAR
    tensors["last.weight"][0, 0], tensors["last.bias"][0] = _SURE, -_SURE * belief.FAR
    return tensors


def scene_of(space: ConfigurationSpace, architecture: BeliefArchitecture) -> belief.Scene:
    """The bodies of a space's robot as points, and its obstacles as a raster.

    Raises:
        InvalidInputError: A robot that is not planar.
    """
    joints, offsets, base, bodies, points, sizes, pairs = _table(space.robot)
    raster, frame = _raster(space, architecture.cells)
    scale = space.scale
    return belief.Scene(
        joints, offsets, base, bodies, points, sizes, pairs, raster, frame,
        architecture.unit * scale, architecture.spacing * scale,
    )  # fmt: skip


def _raster(space: ConfigurationSpace, cells: int) -> tuple[Any, tuple[float, float, float]]:
    """Samples of the distance to obstacles and bounds (length), and where they lie."""
    environment = space.environment
    xmin, ymin, xmax, ymax = environment.bounds
    frame = square_frame(environment.bounds, max(xmax - xmin, ymax - ymin), cells)
    cell = float(frame[fields.CELL])
    edges, bounds = obstacle_edges(environment), np.array(environment.bounds)
    point = np.zeros((1, 3)), 0.0
    ground = fields.unseen(edges, bounds, frame, cells, 1, *point, fields.FINE)
    fields.look_everywhere(ground)
    step = cell / fields.FINE
    low = [float(frame[i]) - cell / 2 + step / 2 for i in (fields.ORIGIN_X, fields.ORIGIN_Y)]
    return (ground.distances * np.float32(cell)).astype(np.float32), (low[0], low[1], step)


@lru_cache(maxsize=_ROBOTS)
def _table(robot: Mechanism) -> tuple[Any, ...]:
    """A robot as `belief.Scene` has it: joints, offsets, base, bodies, points, sizes and pairs."""
    if isinstance(robot, Linkage):
        first = 2 * robot.mobile
        joints = [(joint.parent, first + k) for k, joint in enumerate(robot.joints)]
        offsets = [(*joint.offset, joint.heading) for joint in robot.joints]
        outlines = [(body.joint, body.outline) for body in robot.bodies]
        base = robot.mobile
    elif isinstance(robot, Robot):
        joints, offsets = [(-1, 2 if robot.dimension == 3 else -1)], [(0.0, 0.0, 0.0)]
        outlines, base = [(0, robot.outline)], True
    else:
        raise InvalidInputError(f"predicted: expected a planar robot, got {robot.name!r}")
    points = [_points(outline) for _, outline in outlines]
    lasts = np.cumsum([len(own) for own in points])
    bodies = [
        (joint, last - len(own), last) for (joint, _), own, last in zip(outlines, points, lasts, strict=True)
    ]
    return (
        np.array(joints, np.int64),
        np.array(offsets, np.float64),
        base,
        np.array(bodies, np.int64),
        np.concatenate(points),
        np.array([_size(own) for own in points]),
        np.array(robot.pairs, np.int64).reshape(-1, 2),
    )


def _size(points: Floats) -> float:
    """How far from the middle one of some points any of their discs reaches."""
    away = points[:, :2] - points[len(points) // 2, :2]
    return float((np.hypot(*away.T) + points[:, 2]).max())


def _points(outline: shapely.Geometry) -> Floats:
    """(k, 3) points x, y along the middle of the narrowest rectangle around an outline, and their radius."""
    corners = shapely.get_coordinates(outline.minimum_rotated_rectangle)
    if len(corners) < 5:  # a point or a line
        ends, radius = corners[[0, -1]], 0.0
    else:
        sides = np.diff(corners[:3], axis=0)
        if np.hypot(*sides[0]) < np.hypot(*sides[1]):
            corners = np.roll(corners[:4], -1, axis=0)
        ends = 0.5 * (corners[[0, 1]] + corners[[3, 2]])
        radius = 0.5 * float(np.hypot(*sides.T).min())
    length = float(np.hypot(*(ends[1] - ends[0])))
    if length == 0.0:
        return np.array([[*ends[0], radius]])
    inset = min(0.5 * radius, 0.5 * length)
    count = max(_POINTS, math.ceil((length - 2.0 * inset) / max(2.0 * radius, length / 8.0)) + 1)
    along = np.linspace(inset, length - inset, count) / length
    places = ends[0] + along[:, None] * (ends[1] - ends[0])
    return np.column_stack([places, np.full(count, radius)])
