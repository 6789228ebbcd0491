"""Arms in space from URDF files: a chain of joints, and capsules around the collision geometry."""

from __future__ import annotations

import importlib
import io
import logging
import math
import xml.parsers.expat
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from guided_gym.checks import integer, number, shown
from guided_gym.doors import door
from guided_gym.errors import GuidedGymError, InvalidInputError, warn
from guided_gym.geometry.fitting import box_corners, capsule_around, capsule_of_cylinder, capsules_around
from guided_gym.geometry.solids import Capsule, SpatialEnvironment, rotation, triple
from guided_gym.geometry.spatial_arms import FIXED, SpatialArm, SpatialBody, SpatialJoint

FloatArray = npt.NDArray[np.float64]

LARGEST_FILE: Final = 16 * 2**20  # bytes of a URDF file
LARGEST_MESH: Final = 256 * 2**20  # bytes of a mesh
_MOVING: Final = ("revolute", "continuous", "prismatic")
_SIZES: Final = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}
_SHAPES: Final = (*_SIZES, "mesh")
_ONE_OF: Final = "a box, cylinder, sphere or mesh"
_TRIED: Final = 400  # configurations in which bodies are looked at that touch


class _Place(NamedTuple):
    """Where a link is: on which joint of the chain, and its frame in that joint's."""

    joint: int
    turned: FloatArray
    offset: FloatArray

    def then(self, turned: FloatArray, offset: FloatArray) -> _Place:
        return _Place(self.joint, self.turned @ turned, self.turned @ offset + self.offset)


@door
def read_arm(
    path: str | Path,
    tip: str | None = None,
    *,
    at: Sequence[float] = (0.0, 0.0, 0.0),
    rpy: Sequence[float] = (0.0, 0.0, 0.0),
    tool: Sequence[float] = (0.0, 0.0, 0.0),
    limits: Mapping[str, tuple[float, float] | None] | None = None,
    held: Mapping[str, float] | None = None,
    bodies: Mapping[str, Sequence[Capsule]] | None = None,
    parts: int = 1,
    packages: Mapping[str, str | Path] | None = None,
    self_collision: bool = False,
    name: str = "",
) -> SpatialArm:
    """An arm of a URDF file: the chain from its root to a tip.

    Joints keep their names and the chain's order. Fixed joints are part of what they carry, and so are
    joints whose limits are equal; a continuous joint turns freely; a joint that mimics one of the chain moves
    with it. Joints beside the chain stay where they are, and what they carry goes along as bodies.

    Args:
        path: The file. Documents with a DOCTYPE (and so with entities) and files above 16 MiB are refused.
        tip: The link at the chain's end; needed where there are several.
        at: Where the root stands in the room (length).
        rpy: Roll, pitch and yaw by which it is turned (radians).
        tool: The point in the tip's frame that stands for the robot.
        limits: Of some joints, by name, instead of the file's; None for one that turns freely.
        held: Values of joints that do not move, by name, on the chain or beside it; those beside it stay at 0
            by default, or at the limit that is nearest to 0.
        bodies: Capsules and spheres by link, in its frame, instead of those around its collision geometry.
        parts: Capsules around each mesh at most; more of them fit more closely.
        packages: Folders by the names of packages, for meshes at ``package://``; by default they are looked
            for beside the file and in the folders above it.
        self_collision: Whether bodies must not touch each other, those of neighbours apart. Pairs that touch
            in more than half of all configurations are left out, with a warning.
        name: For people; the name in the file by default.

    Raises:
        InvalidInputError: A file, or a part of one, that cannot be used; the message names it.
        GuidedGymError: The extra ``urdf`` is not installed.
    """
    model = _Model(_parsed(Path(path)), Path(path), dict(limits or {}), dict(held or {}))
    joints, places, end = model.chain(tip, _Place(FIXED, np.array(rotation(rpy)), np.array(triple("at", at))))
    if not joints:
        raise InvalidInputError(f"{path}: expected joints that move on the way to {end!r}, got none")
    shapes = _Shapes(Path(path), dict(bodies or {}), integer("parts", parts, least=1), dict(packages or {}))
    found: list[SpatialBody] = []
    for link in model.robot.links:
        place = places[link.name]
        found += [
            SpatialBody(place.joint, one.moved(place.turned, place.offset), link.name)
            for one in shapes.of(link)
        ]
    shapes.check_names(places)
    if not any(body.joint >= 0 for body in found):
        raise InvalidInputError(
            f"{path}: expected collision geometry on links that move, got none; "
            "bodies={'link': [Capsule(...)]} gives some"
        )
    last = places[end].then(np.eye(3), np.array(triple("tool", tool)))
    arm = SpatialArm(
        tuple(joints),
        tuple(found),
        (last.joint, triple("tool", last.offset)),
        self_collision=self_collision,
        name=name or str(model.robot.name),
    )
    return _relaxed(arm) if self_collision else arm


# The file ---------------------------------------------------------------------------------------------------


def _parsed(path: Path) -> Any:
    """The robot of a file, as yourdfpy has it."""
    content = checked_xml(path, LARGEST_FILE)
    _check_document(path, content)
    try:
        yourdfpy = importlib.import_module("yourdfpy")
    except ImportError as error:
        raise GuidedGymError(
            f"reading URDF needs yourdfpy: pip install 'guided-gym[urdf]' ({error})"
        ) from error
    logging.getLogger("yourdfpy.urdf").setLevel(logging.CRITICAL)
    try:
        model = yourdfpy.URDF.load(io.BytesIO(content), build_scene_graph=False, load_meshes=False)
    except Exception as error:  # it raises whatever its parser stumbles over
        raise InvalidInputError(f"{path}: expected a URDF, got one that cannot be read: {error!r}") from error
    return model.robot


def checked_xml(path: Path, largest: int) -> bytes:
    """The bytes of an XML file that is not too large.

    Raises:
        InvalidInputError: No such file, or a larger one.
    """
    try:
        if not path.is_file():
            raise InvalidInputError(f"{path}: expected a file, got {'a folder' if path.is_dir() else 'none'}")
        with path.open("rb") as file:
            content = file.read(largest + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, InvalidInputError):
            raise
        raise InvalidInputError(f"{path}: cannot be read: {error}") from error
    if len(content) > largest:
        raise InvalidInputError(f"{path}: expected at most {largest:,} bytes, got a larger file")
    return content


def _check_document(path: Path, content: bytes, *, urdf: bool = True) -> None:
    """Refuse what no robot needs: a DOCTYPE (entities), broken XML, and sizes that are none.

    Raises:
        InvalidInputError: With the line.
    """
    parser = xml.parsers.expat.ParserCreate()
    seen: list[str] = []
    shapes: list[str] = []  # of the geometry at hand

    def refuse(what: str) -> None:
        raise InvalidInputError(f"{path}, line {parser.CurrentLineNumber}: {what}")

    def doctype(*_: object) -> None:
        refuse("expected no DOCTYPE and no entities, got some")

    def begins(tag: str, attributes: dict[str, str]) -> None:
        if urdf and not seen and tag != "robot":
            refuse(f"expected a robot, got <{tag}>")
        if tag.startswith("xacro:"):
            refuse(f"expected a URDF, got <{tag}>: expand it with xacro first")
        if tag == "origin" and "quat_xyzw" in attributes:
            refuse("expected an origin with rpy, got a quaternion")
        if seen[-1:] == ["geometry"]:
            if urdf and tag not in _SHAPES:
                refuse(f"geometry: expected {_ONE_OF}, got <{tag}>")
            shapes.append(tag)
            for size in _SIZES.get(tag, ()):
                _check_size(f"{path}, line {parser.CurrentLineNumber}: {tag}: {size}", attributes.get(size))
        seen.append(tag)
        if tag == "geometry":
            shapes.clear()

    def ends(_: str) -> None:
        if seen.pop() == "geometry" and urdf and len(shapes) != 1:
            refuse(f"geometry: expected {_ONE_OF}, got {' and '.join(shapes) or 'none'}")

    parser.StartDoctypeDeclHandler = doctype
    parser.StartElementHandler = begins
    parser.EndElementHandler = ends
    try:
        parser.Parse(content, True)
    except xml.parsers.expat.ExpatError as error:
        raise InvalidInputError(f"{path}: expected XML, got a file that is none: {error}") from error


def _check_size(what: str, text: str | None) -> None:
    """Positive numbers, three of them for a box."""
    if text is None:
        raise InvalidInputError(f"{what}: expected a value, got none")
    words = text.replace(",", " ").split()
    count = 3 if what.endswith("size") else 1
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count or not all(0.0 < value < math.inf for value in values):
        many = f"{count} positive numbers" if count > 1 else "a positive number"
        raise InvalidInputError(f"{what}: expected {many}, got {text!r}")


# The chain --------------------------------------------------------------------------------------------------


@dataclass
class _Model:
    """A robot whose joints are looked up by the links that they join."""

    robot: Any
    path: Path
    limits: dict[str, tuple[float, float] | None]
    held: dict[str, float]

    def __post_init__(self) -> None:
        links = [link.name for link in self.robot.links]
        names = [joint.name for joint in self.robot.joints]
        for what, all_names in (("link", links), ("joint", names)):
            twice = sorted({name for name in all_names if all_names.count(name) > 1})
            if twice:
                self._refuse(f"expected {what}s whose names differ, got {twice[0]!r} twice")
        self.above: dict[str, Any] = {}
        self.below: dict[str, list[Any]] = {name: [] for name in links}
        for joint in self.robot.joints:
            for link in (joint.parent, joint.child):
                if link not in self.below:
                    self._refuse(f"joint {joint.name!r}: expected a link of the file, got {link!r}")
            if joint.child in self.above:
                self._refuse(
                    f"link {joint.child!r}: expected one joint that carries it, got "
                    f"{self.above[joint.child].name!r} and {joint.name!r}"
                )
            self.above[joint.child] = joint
            self.below[joint.parent].append(joint)
        for what, given in (("limits", self.limits), ("held", self.held)):
            for name in given:
                if name not in names:
                    self._refuse(f"{what}: expected names of joints, {', '.join(names)}, got {name!r}")

    def _refuse(self, what: str) -> None:
        raise InvalidInputError(f"{self.path}: {what}")

    def chain(self, tip: str | None, base: _Place) -> tuple[list[SpatialJoint], dict[str, _Place], str]:
        """Joints that move on the way to the tip, where all links are, and the tip."""
        roots = [link for link in self.below if link not in self.above]
        if len(roots) != 1:
            self._refuse(
                f"expected one root, got {', '.join(map(repr, roots)) if roots else 'joints in a circle'}"
            )
        end = self._tip(tip)
        way: list[Any] = []
        link = end
        while link in self.above:
            way.append(self.above[link])
            link = way[-1].parent
        way.reverse()
        joints: list[SpatialJoint] = []
        place, places = base, {roots[0]: base}
        moving: dict[str, Any] = {}
        for joint in way:
            place = place.then(*self._origin(joint))
            if self._moves(joint):
                made = self._joint(joint, place, moving)
                moving[joint.name] = made
                joints.append(made)
                place = _Place(len(joints) - 1, np.eye(3), np.zeros(3))
            else:
                place = place.then(*self._stays(joint))
            places[joint.child] = place
        self._place_rest(places, {joint.name for joint in way}, moving)
        return joints, places, end

    def _tip(self, tip: str | None) -> str:
        ends = [link for link, joints in self.below.items() if not joints]
        if tip is None:
            if len(ends) != 1:
                self._refuse(
                    f"expected a tip, since there are {len(ends)}: tip={ends[0]!r}"
                    + "".join(f" or {end!r}" for end in ends[1:])
                )
            return ends[0]
        if tip not in self.below:
            self._refuse(f"tip: expected a link, {', '.join(map(repr, self.below))}, got {shown(tip)}")
        return tip

    def _place_rest(self, places: dict[str, _Place], way: set[str], moving: dict[str, Any]) -> None:
        """Links beside the chain, which go along with the one that carries them."""
        waiting = list(places)
        while waiting:
            link = waiting.pop()
            for joint in self.below[link]:
                if joint.name in way:
                    continue
                if joint.mimic is not None and joint.mimic.joint in moving and joint.name not in self.held:
                    self._refuse(
                        f"joint {joint.name!r} mimics {joint.mimic.joint!r} of the chain, but is beside it: "
                        f"choose a tip behind it, or held={{{joint.name!r}: value}}"
                    )
                place = places[link].then(*self._origin(joint))
                places[joint.child] = place.then(*self._stays(joint))
                waiting.append(joint.child)

    def _origin(self, joint: Any) -> tuple[FloatArray, FloatArray]:
        if joint.origin is None:
            return np.eye(3), np.zeros(3)
        if not np.isfinite(joint.origin).all():
            self._refuse(f"joint {joint.name!r}: expected an origin of finite numbers")
        return joint.origin[:3, :3], joint.origin[:3, 3]

    def _limits(self, joint: Any) -> tuple[float, float] | None:
        """Of a joint that moves; None for one that turns freely."""
        if joint.name in self.limits:
            given = self.limits[joint.name]
            if given is None:
                return None
            low, high = given
        elif joint.type == "continuous":
            return None
        elif joint.limit is None or joint.limit.lower is None or joint.limit.upper is None:
            self._refuse(
                f"joint {joint.name!r} ({joint.type}): expected lower and upper limits, got none; "
                f"limits={{{joint.name!r}: (low, high)}} gives them, None if it turns freely"
            )
        else:
            low, high = joint.limit.lower, joint.limit.upper
        low, high = (number(f"{self.path}: joint {joint.name!r}: a limit", value) for value in (low, high))
        if low > high:
            self._refuse(f"joint {joint.name!r}: expected lower <= upper, got {low:g} and {high:g}")
        return low, high

    def _moves(self, joint: Any) -> bool:
        """Whether a joint of the chain moves: not if it is fixed, held, or its limits are equal."""
        if joint.type == "fixed" or joint.name in self.held:
            return False
        if joint.type not in _MOVING:
            self._refuse(
                f"joint {joint.name!r}: expected a {', '.join(_MOVING)} or fixed joint on the chain, "
                f"got {joint.type!r}"
            )
        limits = self._limits(joint)
        return limits is None or limits[0] < limits[1]

    def _joint(self, joint: Any, place: _Place, before: dict[str, Any]) -> SpatialJoint:
        follows = None
        if joint.mimic is not None:
            if joint.mimic.joint not in before:
                self._refuse(
                    f"joint {joint.name!r} mimics {joint.mimic.joint!r}: expected a joint before it on the "
                    f"chain; held={{{joint.name!r}: value}} holds it"
                )
            follows = (joint.mimic.joint, float(joint.mimic.multiplier), float(joint.mimic.offset))
        rows = [triple("turned", row) for row in place.turned]
        return SpatialJoint(
            triple("offset", place.offset),
            triple(f"{self.path}: joint {joint.name!r}: axis", joint.axis),
            (rows[0], rows[1], rows[2]),
            self._limits(joint),
            joint.type == "prismatic",
            joint.name,
            follows,
        )

    def _stays(self, joint: Any) -> tuple[FloatArray, FloatArray]:
        """How a joint that does not move is turned and moved."""
        if joint.type == "fixed":
            return np.eye(3), np.zeros(3)
        if joint.type not in _MOVING:
            self._refuse(f"joint {joint.name!r}: expected none of type {joint.type!r}")
        value = self._value(joint)
        axis = np.asarray(joint.axis, np.float64)
        length = float(np.linalg.norm(axis))
        if not length > 0.0:
            self._refuse(f"joint {joint.name!r}: expected an axis that is not 0, got {axis.tolist()}")
        axis = axis / length
        if joint.type == "prismatic":
            return np.eye(3), value * axis
        x, y, z = axis
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.eye(3) + math.sin(value) * cross + (1.0 - math.cos(value)) * cross @ cross, np.zeros(3)

    def _value(self, joint: Any) -> float:
        """The value at which a joint stays."""
        if joint.name in self.held:
            return number(f"held: {joint.name!r}", self.held[joint.name])
        if joint.mimic is not None:
            leader = next((one for one in self.robot.joints if one.name == joint.mimic.joint), None)
            if leader is not None and leader is not joint and leader.mimic is None:
                return float(joint.mimic.multiplier) * self._value(leader) + float(joint.mimic.offset)
        known = joint.limit is not None and joint.limit.lower is not None and joint.limit.upper is not None
        if joint.type == "continuous" or not (known or joint.name in self.limits):
            return 0.0
        limits = self._limits(joint)
        return 0.0 if limits is None else min(max(0.0, limits[0]), limits[1])


# Bodies -----------------------------------------------------------------------------------------------------


@dataclass
class _Shapes:
    """Capsules of links, given or around their collision geometry."""

    path: Path
    given: dict[str, Sequence[Capsule]]
    parts: int
    packages: dict[str, str | Path]

    def check_names(self, links: Mapping[str, object]) -> None:
        """Refuse bodies for links that are not there."""
        for name in self.given:
            if name not in links:
                raise InvalidInputError(
                    f"bodies: expected names of links, {', '.join(map(repr, links))}, got {name!r}"
                )

    def of(self, link: Any) -> list[Capsule]:
        """In the link's frame."""
        if link.name in self.given:
            return list(self.given[link.name])
        found: list[Capsule] = []
        for collision in link.collisions:
            origin = np.eye(4) if collision.origin is None else collision.origin
            if collision.geometry is None:
                raise InvalidInputError(
                    f"{self.path}: link {link.name!r}: expected a collision with geometry, got none"
                )
            shapes = self._around(link.name, collision.geometry)
            found += [one.moved(origin[:3, :3], origin[:3, 3]) for one in shapes]
        return found

    def _around(self, link: str, geometry: Any) -> list[Capsule]:
        if geometry.sphere is not None:
            return [Capsule.sphere((0.0, 0.0, 0.0), geometry.sphere.radius)]
        if geometry.cylinder is not None:
            return [capsule_of_cylinder(geometry.cylinder.radius, geometry.cylinder.length)]
        if geometry.box is not None:
            return [capsule_around(box_corners(triple("size", geometry.box.size)))]
        return capsules_around(self._triangles(link, geometry.mesh), self.parts)

    def _triangles(self, link: str, mesh: Any) -> FloatArray:
        """(n, 3, 3) of a mesh."""
        what = f"{self.path}: link {link!r}: mesh {mesh.filename!r}"
        file = self._found(what, str(mesh.filename))
        if file.stat().st_size > LARGEST_MESH:
            raise InvalidInputError(f"{what}: expected at most {LARGEST_MESH:,} bytes, got a larger file")
        if file.suffix.lower() in (".dae", ".xml", ".x3d", ".3mf"):
            _check_document(file, checked_xml(file, LARGEST_MESH), urdf=False)
        trimesh = importlib.import_module("trimesh")
        try:
            loaded = trimesh.load(file, force="mesh", process=False)
            triangles = np.asarray(loaded.triangles, np.float64)
        except Exception as error:  # of any of its readers
            raise InvalidInputError(f"{what}: cannot be read: {error!r}") from error
        scale = 1.0 if mesh.scale is None else mesh.scale
        triangles = triangles * scale
        if not (triangles.size and np.isfinite(triangles).all()):
            raise InvalidInputError(f"{what}: expected triangles of finite numbers, got {len(triangles)}")
        return triangles

    def _found(self, what: str, name: str) -> Path:
        """The file of a mesh."""
        scheme, _, rest = name.rpartition("://")
        if scheme not in ("", "file", "package", "model"):
            raise InvalidInputError(f"{what}: expected a file or package://, got {scheme}://")
        folders = [self.path.resolve().parent, *self.path.resolve().parents]
        tried = [folder / rest for folder in folders]
        if scheme in ("package", "model"):
            package, _, inner = rest.partition("/")
            if package in self.packages:
                tried = [Path(self.packages[package]) / inner]
            else:
                tried += [folder / inner for folder in folders]
        for file in tried:
            if file.is_file():
                return file
        raise InvalidInputError(
            f"{what}: expected a file, got none; packages={{'name': 'folder'}} says where packages are, and "
            f"bodies={{'link': [Capsule(...)]}} replaces geometry"
        )


def _relaxed(arm: SpatialArm) -> SpatialArm:
    """The arm without the pairs of links that mostly touch, for fitted bodies are larger than the links."""
    lower, upper = (
        np.array(side) for side in arm.coordinates(SpatialEnvironment((-1, -1, -1, 1, 1, 1)))[1:3]
    )
    rng = np.random.default_rng(0)
    links = [(arm.bodies[i].link, arm.bodies[k].link) for i, k in arm.pairs]
    touching = dict.fromkeys(links, 0)
    for q in lower + rng.random((_TRIED, arm.dimension)) * (upper - lower):
        for pair in {links[n] for n in np.flatnonzero(arm.own_gaps(q) <= 0.0)}:
            touching[pair] += 1
    left = [pair for pair, count in touching.items() if count > 0.5 * _TRIED]
    if not left:
        return arm
    said = ", ".join(f"{one} and {two}" for one, two in left)
    warn(f"{arm.name}: not checked against each other, since they touch in most configurations: {said}")
    return replace(arm, ignored=frozenset(p for p, two in zip(arm.pairs, links, strict=True) if two in left))
