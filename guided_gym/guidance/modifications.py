"""Modifications of robot and environment: what makes a problem easier (paper, Categories of Guidance).

A guiding space is C' = (r', E'). A robot modification gives r' and the projection P : C -> C'; an environment
modification gives E', where P is the identity. One joins by adding a row to `ROBOTS` or `ENVIRONMENTS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.checks import instance, integer, number, shown
from guided_gym.errors import InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.linkages import Linkage
from guided_gym.geometry.mechanism import Mechanism
from guided_gym.geometry.robots import Robot, rigid
from guided_gym.geometry.solids import Capsule, SpatialEnvironment
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.geometry.spatial_arms import SpatialArm, point_in_space
from guided_gym.guidance.learned.belief import Belief, BeliefModel
from guided_gym.guidance.learned.motion_agent import load_motion_agent
from guided_gym.guidance.solvers.base import Floats
from guided_gym.guidance.subspace import Subspace
from guided_gym.storage.path_file import PathDatabase
from guided_gym.storage.path_library import PathLibrary

_CORNERS: Final = 32  # of a polygon that stands for a disc


class RobotModification(Protocol):
    """r -> r', and the projection P : C -> C'.

    Attributes:
        keeps: Whether C' = C: then a failure in C says of the same state of C' that it is invalid.

    A modification whose states are the first coordinates of a configuration may say how many, as an attribute
    ``leading`` once `space` was asked for: then searches that a wave guides are compiled (`Composed.burst`).
    """

    keeps: bool

    def space(self, space: ConfigurationSpace, environment: Environment, start: Floats) -> ConfigurationSpace:
        """C' = (r', E') for the robot of a space and the environment E'.

        Raises:
            InvalidInputError: A robot that cannot be modified in this way.
        """

    def project(self, q: Floats) -> Floats:
        """(n, d) configurations to (n, d') states of C'."""


class EnvironmentModification(Protocol):
    """E -> E'.

    Attributes:
        optimistic: Whether E' has no obstacle where E has none: then failures in C may refute what is seen in
            C', and are taught to the solver as such.
    """

    optimistic: bool

    def environment(self, environment: Environment) -> Environment:
        """E' at the beginning of a search."""

    def revised(self, space: ConfigurationSpace, contact: Floats) -> Environment | None:
        """Another E' after a failure at a configuration of C; None if E' stays as it is."""


# Robots -----------------------------------------------------------------------------------------------------


class SameRobot:
    """r' = r."""

    keeps = True

    def space(self, space: ConfigurationSpace, environment: Environment, start: Floats) -> ConfigurationSpace:
        """The space itself, or that of the same robot in E'."""
        return space if environment is space.environment else _space(space, space.robot, environment)

    def project(self, q: Floats) -> Floats:
        """The identity."""
        return q


class Point:
    """r' is the robot's reference point, or an arm's tool; the rest does not collide (paper, Figure 1 d).

    Optimistic where that point is part of the robot; one in a notch of it may be inside an obstacle.
    """

    keeps = False

    def space(self, space: ConfigurationSpace, environment: Environment, start: Floats) -> ConfigurationSpace:
        """The workspace."""
        self._robot = space.robot
        self.leading = 2 if isinstance(space.robot, Robot) else None
        if isinstance(environment, SpatialEnvironment):
            return _space(space, _point_in_space(environment), environment)
        return _space(space, _body(Robot.point), environment)

    def project(self, q: Floats) -> Floats:
        """(n, 2) positions: of an arm, of its tool; (n, 3) in space."""
        return self._robot.tool_at(q) if isinstance(self._robot, SpatialArm) else self._robot.position(q)


class Disc(Point):
    """r' is a disc around the reference point (bounding volumes).

    Args:
        outer: The circumscribed disc, which is conservative: where it goes, the robot may turn as it likes.
            Otherwise the inscribed one, which is optimistic: where the robot goes, it goes.
    """

    def __init__(self, *, outer: bool = False) -> None:
        self.outer = outer

    def space(self, space: ConfigurationSpace, environment: Environment, start: Floats) -> ConfigurationSpace:
        """The space of the disc; of a point where the robot has no room for one."""
        self._robot, self.leading = space.robot, 2
        return _space(space, _disc_of(rigid(space.robot, "disc"), self.outer), environment)


class Body:
    """r' moves like r, with other bodies (inner and outer bodies): C' has the states of C.

    Args:
        change: Outline to the one in its place.
    """

    keeps = True

    def __init__(self, change: Callable[[Any], Any]) -> None:
        self.change = change

    def space(self, space: ConfigurationSpace, environment: Environment, start: Floats) -> ConfigurationSpace:
        """The space of the robot with the other bodies."""
        return _space(space, _with_bodies(space.robot, self.change), environment)

    def project(self, q: Floats) -> Floats:
        """The identity."""
        return q


class Inner(Body):
    """r' has thin bodies, the middle line of each. It is optimistic: it can go wherever the robot can."""

    def __init__(self) -> None:
        super().__init__(_middle_line)


class Outer(Body):
    """r' has larger bodies. It is conservative: the robot can go wherever it can.

    Args:
        margin: By how much they are larger than the convex hulls of the robot's (length).
    """

    def __init__(self, margin: float = 0.0) -> None:
        self.margin = number("margin", margin, least=0)
        super().__init__(partial(_larger, margin=self.margin))


class Links:
    """r' is the first links of an arm or snake, as if the others could not collide. It is optimistic.

    The links behind are the easier to move the farther behind they are; what is hard is decided by the first
    ones. In contrast to ``subset``, the others are not frozen but gone.

    Args:
        links: How many; as many as there are joints is the robot itself.
    """

    keeps = False

    def __init__(self, links: int = 2) -> None:
        self.links = integer("links", links, least=1)

    def space(self, space: ConfigurationSpace, environment: Environment, start: Floats) -> ConfigurationSpace:
        """The space of the shorter arm.

        Raises:
            InvalidInputError: A robot without joints, or one with fewer.
        """
        robot = space.robot
        if not (isinstance(robot, Linkage | SpatialArm) and self.links <= len(robot.joints)):
            joints = len(robot.joints) if isinstance(robot, Linkage | SpatialArm) else 0
            raise InvalidInputError(
                f"links: expected a robot with at least {self.links} joints, "
                f"got {shown(robot.name)} with {joints}"
            )
        shorter = _first_links(robot, self.links)
        self._kept = shorter.dimension
        return _space(space, shorter, environment)

    def project(self, q: Floats) -> Floats:
        """(n, d') the first coordinates."""
        return q[:, : self._kept]


class Subset:
    """r' has some of the degrees of freedom; the others stay as they are at the start (freezing joints).

    Args:
        dimensions: Which coordinates; the first so many, if it is a number.
    """

    keeps = False

    def __init__(self, dimensions: int | Sequence[int] = 2) -> None:
        if not isinstance(dimensions, Sequence):
            dimensions = range(integer("dimensions", dimensions, least=1))
        self.dimensions = tuple(integer("dimensions", i, least=0) for i in dimensions)
        if not self.dimensions or len(set(self.dimensions)) != len(self.dimensions):
            raise InvalidInputError(f"dimensions: expected different coordinates, got {shown(dimensions)}")

    def space(self, space: ConfigurationSpace, environment: Environment, start: Floats) -> ConfigurationSpace:
        """The slice of C through the start."""
        if max(self.dimensions) >= space.dimension:
            raise InvalidInputError(
                f"subset: expected coordinates 0 to {space.dimension - 1}, got {list(self.dimensions)}"
            )
        whole = SAME.space(space, environment, start)
        self._slice: Subspace | None = None
        robot = space.robot
        if self.dimensions == (0, 1) and isinstance(robot, Robot):
            if space.dimension == 2:
                return whole
            # A body that keeps its heading: a space that every solver takes.
            return _space(space, _turned(robot, float(start[2])), environment)
        basis = np.eye(space.dimension)[list(self.dimensions)]
        self._slice = Subspace(whole, start, basis)
        return self._slice

    def project(self, q: Floats) -> Floats:
        """(n, d') the coordinates that are kept."""
        return q[:, :2] if self._slice is None else self._slice.project(q)


class Principal:
    """r' moves in the linear subspace in which stored paths vary most: PCA of paths.

    Args:
        database: A `PathLibrary` or the file of one.
        dimensions: Dimensions of the subspace.
    """

    keeps = False

    def __init__(self, database: PathLibrary | str | Path | None = None, *, dimensions: int = 2) -> None:
        if isinstance(database, str | Path):
            with PathDatabase.open(database, readonly=True) as store:
                database = store.load()
        self.library = instance("database", database, PathLibrary)
        self.dimensions = integer("dimensions", dimensions, least=1)

    def space(self, space: ConfigurationSpace, environment: Environment, start: Floats) -> ConfigurationSpace:
        """The plane through the mean of the waypoints, along their main directions in the metric."""
        if self.library.dimension != space.dimension or self.dimensions > space.dimension:
            raise InvalidInputError(
                f"principal: expected paths of dimension {space.dimension} and at most as many directions, "
                f"got paths of dimension {self.library.dimension} and {self.dimensions}"
            )
        points = self.library.waypoints
        mean = points[0] + space.difference(points[0], points).mean(axis=0)
        deviations = space.difference(mean, points) * space.weights
        directions = np.linalg.svd(deviations, full_matrices=False)[2][: self.dimensions]
        self._slice = Subspace(SAME.space(space, environment, start), mean, directions / space.weights)
        return self._slice

    def project(self, q: Floats) -> Floats:
        """(n, d') coordinates along the main directions."""
        return self._slice.project(q)


SAME: Final = SameRobot()


def _space(space: ConfigurationSpace, robot: Mechanism, environment: Environment) -> ConfigurationSpace:
    """(r', E') with the metric of C, as far as r' has its coordinates; kept, since problems come again."""
    if isinstance(robot, Robot):
        return _kept_space(robot, environment, float(space.weights[2]) if robot.dimension == 3 else None)
    weights = tuple(space.weights[: robot.dimension].tolist())
    return _kept_space(robot, environment, space.rotation_weight, weights)


@lru_cache(maxsize=64)
def _kept_space(
    robot: Mechanism,
    environment: Environment,
    weight: float | None,
    weights: tuple[float, ...] | None = None,
) -> ConfigurationSpace:
    made = ConfigurationSpace(robot, environment, weight)
    if weights is not None and weights != tuple(
        made.weights.tolist()
    ):  # other bodies reach less far, or farther
        made.weights = np.array(weights)
        made.weights.flags.writeable = False
        made.metric = made.weights, made.periods
    return made


@lru_cache(maxsize=8)
def _body(make: Callable[[], Robot]) -> Robot:
    return make()


def _middle_line(outline: Any) -> Any:
    """The longest part of the middle line of the narrowest rectangle around a polygon; a capsule's axis."""
    if isinstance(outline, Capsule):
        return replace(outline, radius=0.0)
    if not isinstance(outline, shapely.Polygon):
        return outline
    corners = shapely.get_coordinates(outline.minimum_rotated_rectangle)[:4]
    if math.dist(corners[0], corners[1]) < math.dist(corners[1], corners[2]):
        corners = np.roll(corners, -1, axis=0)
    ends = 0.5 * (corners[[0, 1]] + corners[[3, 2]])
    inside = shapely.get_parts(outline.intersection(shapely.LineString(ends)))
    return max(inside, key=lambda part: part.length)


def _larger(outline: Any, margin: float) -> Any:
    if isinstance(outline, Capsule):
        return replace(outline, radius=outline.radius + margin)
    hull = outline.convex_hull
    return hull.buffer(margin, quad_segs=2) if margin > 0 else hull


@lru_cache(maxsize=64)
def _with_bodies(robot: Mechanism, change: Callable[[Any], Any]) -> Mechanism:
    if isinstance(robot, Linkage):
        bodies = tuple(replace(body, outline=change(body.outline)) for body in robot.bodies)
        return replace(robot, bodies=bodies)
    if isinstance(robot, SpatialArm):
        return replace(robot, bodies=tuple(replace(body, shape=change(body.shape)) for body in robot.bodies))
    if isinstance(robot, Robot):
        return replace(robot, outline=change(robot.outline))
    raise InvalidInputError(f"bodies: expected another robot, got {shown(robot.name)}")


@lru_cache(maxsize=64)
def _first_links(robot: Linkage | SpatialArm, links: int) -> Linkage | SpatialArm:
    """The robot without the joints behind the first ones; its tool is where the next one would be."""
    if links == len(robot.joints):
        return robot
    name = f"first {links} links of {robot.name}"
    if isinstance(robot, SpatialArm):
        return robot.shortened(links, name)
    after = robot.joints[links]
    tool = (after.parent, after.offset) if after.parent >= 0 else (links - 1, (0.0, 0.0))
    if robot.tool[0] < links:
        tool = robot.tool
    bodies = tuple(body for body in robot.bodies if body.joint < links)
    return replace(robot, joints=robot.joints[:links], bodies=bodies, tool=tool, name=name)


@lru_cache(maxsize=8)
def _point_in_space(environment: SpatialEnvironment) -> SpatialArm:
    return point_in_space(environment)


@lru_cache(maxsize=64)
def _turned(robot: Robot, heading: float) -> Robot:
    """The robot with that heading, which it keeps."""
    return Robot(robot.placed((0.0, 0.0, heading)), dimension=2, name=f"{robot.name} that does not turn")


@lru_cache(maxsize=64)
def _disc_of(robot: Robot, outer: bool) -> Robot:
    """A regular polygon around the disc around the robot, or inside the disc inside it."""
    radius = robot.radius / math.cos(math.pi / _CORNERS) if outer else robot.inner_radius
    if radius == 0.0:
        return _body(Robot.point)
    angles = 2.0 * math.pi * np.arange(_CORNERS) / _CORNERS
    corners = radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return Robot(shapely.Polygon(corners), dimension=2, name="outer disc" if outer else "inner disc")


# Environments -----------------------------------------------------------------------------------------------


class SameEnvironment:
    """E' = E."""

    optimistic = False

    def environment(self, environment: Environment) -> Environment:
        """The environment itself."""
        return environment

    def revised(self, space: ConfigurationSpace, contact: Floats) -> Environment | None:
        """Never."""
        return None


class Nothing(SameEnvironment):
    """E' = {}: lazy planning, which looks at obstacles only where it fails."""

    optimistic = True

    def environment(self, environment: Environment) -> Environment:
        """The bounds alone."""
        return environment.keeping(())


class Without(SameEnvironment):
    """E' leaves out some obstacles (paper, Figure 1).

    Args:
        obstacles: Their numbers in `Environment.obstacles`.
    """

    optimistic = True

    def __init__(self, *obstacles: int) -> None:
        self.obstacles = tuple(integer("obstacle", i, least=0) for i in obstacles)

    def environment(self, environment: Environment) -> Environment:
        """The others."""
        if self.obstacles and max(self.obstacles) >= len(environment.obstacles):
            raise InvalidInputError(
                f"without: expected obstacles 0 to {len(environment.obstacles) - 1}, "
                f"got {list(self.obstacles)}"
            )
        return environment.keeping([i for i in range(len(environment.obstacles)) if i not in self.obstacles])


class Shrunk(SameEnvironment):
    """E' has obstacles that are smaller all around, grown back as failures come (iterative relaxation).

    Args:
        margin: By how much (length); by default half of the radius of the largest disc in the thinnest one,
            so that something is left of each.
        patience: Failures after which the margin is halved; 0 for never.
    """

    optimistic = True

    def __init__(self, margin: float | None = None, *, patience: int = 10) -> None:
        self.margin = None if margin is None else number("margin", margin, above=0)
        self.patience = integer("patience", patience, least=0)

    def environment(self, environment: Environment) -> Environment:
        """What is left of the obstacles."""
        self._failures = 0
        self._margin = 0.25 * environment.thinnest if self.margin is None else self.margin
        return environment.shrunk(self._margin)

    def revised(self, space: ConfigurationSpace, contact: Floats) -> Environment | None:
        """Shrink the obstacles half as much, after each so many failures."""
        self._failures += 1
        if self.patience == 0 or self._failures % self.patience or self._failures > 8 * self.patience:
            return None
        self._margin /= 2.0
        return space.environment.shrunk(self._margin)


class Hulls(SameEnvironment):
    """E' has the convex hull of each obstacle: more constraints, and simpler ones."""

    def environment(self, environment: Environment) -> Environment:
        """The hulls."""
        return environment.hulls()


class Boxes(SameEnvironment):
    """E' has the bounding box of each obstacle."""

    def environment(self, environment: Environment) -> Environment:
        """The boxes."""
        return environment.boxes()


class Revealed(SameEnvironment):
    """E' is empty at first, and has each obstacle of E from the first failure at it on."""

    optimistic = True

    def environment(self, environment: Environment) -> Environment:
        """The bounds alone."""
        self._known: set[int] = set()
        return environment.keeping(())

    def revised(self, space: ConfigurationSpace, contact: Floats) -> Environment | None:
        """With the obstacle that the robot hit."""
        away = space.robot.gaps(contact, space.environment)
        if not away.size:
            return None
        hit = int(np.argmin(away))
        if hit in self._known:
            return None
        self._known.add(hit)
        return space.environment.keeping(sorted(self._known))


class Predicted(Nothing):
    """E' is empty, and a learned p(free) of each motion, from the workspace, tells what is in the way.

    A motion of probability p counts as long as it would be tried: ``effort`` times its length for each time
    that it is expected to fail, (1 - p) / p.

    Args:
        agent: A shipped agent's name, a folder, or a belief network (`guided_gym.guidance.learned.belief`).
        effort: What a failure costs, in lengths of the motion.
        least: p below which a motion is not believed in at all.
    """

    def __init__(
        self, agent: str | BeliefModel = "planar-arm-4", *, effort: float = 1.0, least: float = 0.1
    ) -> None:
        self.model = agent if isinstance(agent, BeliefModel) else load_motion_agent(agent).belief
        self.effort = number("effort", effort, least=0)
        self.least = number("least", least, above=0, below=1)

    def doubts(self, space: ConfigurationSpace) -> Expected:
        """What is believed of the motions of a space.

        Raises:
            InvalidInputError: A robot that is not planar, or a plane through its space.
        """
        if isinstance(space, Subspace):
            raise InvalidInputError(
                f"predicted: expected the configuration space of a body, got a plane of {space.dimension} "
                "dimensions through one"
            )
        return Expected(self.model.on(space), self.effort, self.least)


class Expected:
    """A belief as factors on lengths, which may be checked."""

    def __init__(self, belief: Belief, effort: float, least: float) -> None:
        self._belief, self._effort, self._least = belief, effort, least
        self._checked: ConfigurationSpace | None = None
        self._checks = 0

    @property
    def looks(self) -> int:
        """Configurations that were looked at in the raster, and motions that were checked."""
        return self._belief.looks + self._checks

    @property
    def checking(self) -> bool:
        """Whether motions are checked before a way takes them."""
        return self._checked is not None

    def check_in(self, space: ConfigurationSpace) -> None:
        """Check motions in a space from now on, before a way takes them."""
        self._checked = space

    def refuted(self, starts: Floats, ends: Floats) -> NDArray[np.bool_]:
        """(n,) whether motions were checked and are not free."""
        if self._checked is None:
            return np.zeros(len(starts), np.bool_)
        self._checks += len(starts)
        free = self._checked.motions_free(np.ascontiguousarray(starts), np.ascontiguousarray(ends))
        return np.asarray(~free)

    def factors(self, starts: Floats, ends: Floats) -> Floats:
        """(n,) expected number of tries of each motion, weighted; infinite if it is held not to be free."""
        p = self._belief.motions(starts, ends, self._least)
        with np.errstate(divide="ignore"):
            return np.where(p >= self._least, 1.0 + self._effort * (1.0 / p - 1.0), np.inf)

    def likely(self, starts: Floats, ends: Floats) -> Floats:
        """(n,) p(free) of each motion."""
        return self._belief.motions(starts, ends)


UNCHANGED: Final = SameEnvironment()


# One row per modification: the words of ``robot=...`` and ``environment=...``.
ROBOTS: Final[dict[str, Callable[..., Any]]] = {
    "same": SameRobot,
    "point": Point,
    "disc": Disc,
    "inner": Inner,
    "outer": Outer,
    "links": Links,
    "subset": Subset,
    "principal": Principal,
}
ENVIRONMENTS: Final[dict[str, Callable[..., Any]]] = {
    "same": SameEnvironment,
    "nothing": Nothing,
    "without": Without,
    "shrunk": Shrunk,
    "hulls": Hulls,
    "boxes": Boxes,
    "revealed": Revealed,
    "predicted": Predicted,
}
