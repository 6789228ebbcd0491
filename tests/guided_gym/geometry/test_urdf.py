"""Arms from URDF files: what is read, mapped by name, held against other libraries, and refused."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from guided_gym.errors import GuidedGymError, GuidedGymWarning, InvalidInputError
from guided_gym.geometry.solids import Box, Capsule, Cylinder, SpatialEnvironment
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.geometry.spatial_arms import SpatialArm
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task

needs_yourdfpy = pytest.mark.skipif(
    pytest.importorskip("importlib.util").find_spec("yourdfpy") is None, reason="yourdfpy is not installed"
)

ROOM = SpatialEnvironment((-2, -2, -2, 2, 2, 2))
EMPTY = "<collision><geometry/></collision>"
SPHERE = '<collision><geometry><sphere radius="0.05"/></geometry></collision>'


def link(name: str, inside: str = SPHERE) -> str:
    """A link with a collision shape."""
    return f'<link name="{name}">{inside}</link>'


def joint(
    name: str,
    parent: str,
    child: str,
    inside: str = '<limit lower="-1" upper="2" effort="1" velocity="1"/>',
    kind: str = "revolute",
    axis: str = "0 1 0",
) -> str:
    """A joint, 0.3 above its parent."""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 0.3" rpy="0 0 0"/><axis xyz="{axis}"/>{inside}</joint>'
    )


def written(folder: Path, *parts: str, head: str = "") -> Path:
    """A URDF file of those parts."""
    path = folder / "arm.urdf"
    path.write_text(
        f'<?xml version="1.0"?>{head}<robot name="arm">{"".join(parts)}</robot>', encoding="utf-8"
    )
    return path


TWO = (link("base"), link("upper"), link("fore"), joint("a", "base", "upper"), joint("b", "upper", "fore"))


# What is read -----------------------------------------------------------------------------------------------


@needs_yourdfpy
def test_a_chain_by_hand(tmp_path: Path) -> None:
    arm = SpatialArm.from_urdf(written(tmp_path, *TWO), tool=(0.0, 0.0, 0.2), at=(1.0, 0.0, 0.0))
    assert arm.name == "arm"
    assert arm.names == ("a", "b")
    assert [joint.limits for joint in arm.joints] == [(-1.0, 2.0)] * 2
    np.testing.assert_allclose(arm.tool_at(np.zeros(2)), [1, 0, 0.8], atol=1e-12)
    np.testing.assert_allclose(arm.tool_at(np.array([math.pi / 2, 0])), [1.5, 0, 0.3], atol=1e-12)
    assert [(body.link, body.joint) for body in arm.bodies] == [("base", -1), ("upper", 0), ("fore", 1)]


@needs_yourdfpy
def test_joints_keep_the_order_of_the_chain_and_their_names(tmp_path: Path) -> None:
    """Not that of the file, and not that of the alphabet: j10 is behind j9."""
    links = [link(f"l{k}") for k in range(12)]
    joints = [joint(f"j{k}", f"l{k - 1}", f"l{k}") for k in range(1, 12)]
    arm = SpatialArm.from_urdf(written(tmp_path, *links, *joints[::-1]))
    assert arm.names == tuple(f"j{k}" for k in range(1, 12))
    space = ConfigurationSpace(arm, SpatialEnvironment((-5, -5, -5, 5, 5, 5)))
    assert space.valid(np.zeros(11))


@needs_yourdfpy
def test_nine_joints_work(tmp_path: Path) -> None:
    parts = [link(f"l{k}") for k in range(10)]
    parts += [joint(f"j{k}", f"l{k - 1}", f"l{k}", axis="0 1 0" if k % 2 else "1 0 0") for k in range(1, 10)]
    arm = SpatialArm.from_urdf(written(tmp_path, *parts), self_collision=True)
    space = ConfigurationSpace(arm, SpatialEnvironment((-4, -4, -4, 4, 4, 4)))
    assert space.motion_free(np.zeros(9), np.full(9, 0.1))


@needs_yourdfpy
def test_kinds_of_joints(tmp_path: Path) -> None:
    path = written(
        tmp_path,
        *(link(name) for name in "abcdef"),
        joint("turns", "a", "b", "", "continuous", "0 0 2"),
        joint("locked", "b", "c", '<limit lower="0.5" upper="0.5"/>'),
        joint("slides", "c", "d", '<limit lower="0" upper="0.4"/>', "prismatic", "0 0 1"),
        joint(
            "mimics",
            "d",
            "e",
            '<limit lower="-1" upper="1"/><mimic joint="slides" multiplier="2" offset="0.1"/>',
        ),
        joint("stays", "e", "f", "", "fixed"),
    )
    arm = SpatialArm.from_urdf(path)
    space = ConfigurationSpace(arm, SpatialEnvironment((-4, -4, -4, 4, 4, 4)))
    assert space.names == ("turns", "slides")
    np.testing.assert_allclose(space.periods, [2 * math.pi, 0])
    np.testing.assert_allclose([space.lower[1], space.upper[1]], [0, 0.4])
    # The locked joint turns what is behind it by half a radian, the one that mimics by 2 * 0.3 + 0.1 more.
    s1, c1, s2, c2 = math.sin(0.5), math.cos(0.5), math.sin(1.2), math.cos(1.2)
    expected = [0.9 * s1 + 0.3 * s2, 0.0, 0.6 + 0.9 * c1 + 0.3 * c2]
    np.testing.assert_allclose(arm.tool_at(np.array([0.0, 0.3])), expected, atol=1e-12)


@needs_yourdfpy
def test_what_is_beside_the_chain_goes_along(tmp_path: Path) -> None:
    path = written(
        tmp_path, *TWO, link("finger"), joint("f", "upper", "finger", '<limit lower="0.2" upper="1"/>')
    )
    arm = SpatialArm.from_urdf(path, "fore")
    assert arm.names == ("a", "b")
    finger = arm.bodies[-1]
    assert (finger.link, finger.joint) == ("finger", 0)
    np.testing.assert_allclose(finger.shape.start, [0, 0, 0.3], atol=1e-12)  # turned, at its nearest limit
    other = SpatialArm.from_urdf(path, "finger", held={"a": 0.5})
    assert other.names == ("f",)


@needs_yourdfpy
def test_bodies_are_fitted_or_given(tmp_path: Path) -> None:
    def shape(inside: str) -> str:
        return f'<collision><origin xyz="0 0 0.1"/><geometry>{inside}</geometry></collision>'

    path = written(
        tmp_path,
        link("base", shape('<box size="0.2 0.2 0.4"/>')),
        link("upper", shape('<cylinder radius="0.1" length="0.6"/>')),
        joint("a", "base", "upper"),
    )
    arm = SpatialArm.from_urdf(path)
    corner = np.array([0.1, 0.1, 0.2]) * np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T + [0, 0, 0.1]
    base, upper = (body.shape for body in arm.bodies)
    assert max(_outside(base, point) for point in corner) <= 1e-12
    assert base.radius < 0.2
    rim = [(0.1 * math.cos(t), 0.1 * math.sin(t), z) for t in np.linspace(0, 6, 20) for z in (-0.2, 0.4)]
    assert max(_outside(upper, np.array(point)) for point in rim) <= 1e-9
    given = SpatialArm.from_urdf(path, bodies={"upper": [Capsule.sphere((0, 0, 0.1), 0.3)]})
    assert given.bodies[1].shape == Capsule.sphere((0, 0, 0.1), 0.3)


def _outside(capsule: Capsule, point: Any) -> float:
    a, b = np.array(capsule.start), np.array(capsule.end)
    t = np.clip((point - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-300), 0, 1)
    return float(np.linalg.norm(point - a - t * (b - a))) - capsule.radius


@needs_yourdfpy
def test_meshes_are_found_and_fitted(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    folder = tmp_path / "stuff" / "meshes"
    folder.mkdir(parents=True)
    trimesh.creation.box((0.1, 0.1, 0.6)).export(folder / "link.stl")
    mesh = '<collision><geometry><mesh filename="{}" scale="2 1 1"/></geometry></collision>'
    for name in ("package://stuff/meshes/link.stl", "stuff/meshes/link.stl"):
        path = written(tmp_path, link("base"), link("upper", mesh.format(name)), joint("a", "base", "upper"))
        for parts in (1, 3):
            arm = SpatialArm.from_urdf(path, parts=parts)
            shapes = [body.shape for body in arm.bodies if body.link == "upper"]
            assert 1 <= len(shapes) <= parts
            corner = np.array([0.1, 0.05, 0.3])
            assert min(_outside(one, corner) for one in shapes) <= 1e-9
    elsewhere = written(
        tmp_path,
        link("base"),
        link("upper", mesh.format("package://other/link.stl")),
        joint("a", "base", "upper"),
    )
    assert SpatialArm.from_urdf(elsewhere, packages={"other": folder}).dimension == 1


# Bad input --------------------------------------------------------------------------------------------------


BOMB = (
    '<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefgh", "bcdefghi", strict=True))
    + "]>"
)
CYLINDER = "<collision><geometry><cylinder {}/></geometry></collision>"
MESH = '<collision><geometry><mesh filename="{}"/></geometry></collision>'
XY = (link("x"), link("y"))


def limited(inside: str, kind: str = "revolute") -> tuple[str, ...]:
    """Two links and a joint with that inside."""
    return (*XY, joint("j", "x", "y", inside, kind))


def with_mesh(name: str) -> tuple[str, ...]:
    """Two links, one of them a mesh."""
    return (link("x"), link("y", MESH.format(name)), joint("j", "x", "y"))


@needs_yourdfpy
@pytest.mark.parametrize(
    ("parts", "options", "what"),
    [
        ((*TWO, link("hand"), joint("c", "upper", "hand")), {}, "tip='fore' or 'hand'"),
        (TWO, {"tip": "hand"}, "tip: expected a link, 'base', 'upper', 'fore', got 'hand'"),
        (limited(""), {}, "joint 'j' .revolute.: expected lower and upper"),
        (limited("<limit effort='1'/>"), {}, "limits={'j': .low, high.}"),
        (limited("<limit lower='2' upper='1'/>"), {}, "lower <= upper, got 2 and 1"),
        (limited("<limit lower='0' upper='nan'/>"), {}, "joint 'j': a limit"),
        (limited("", "planar"), {}, "got 'planar'"),
        (limited("", "floating"), {}, "got 'floating'"),
        ((*XY, joint("j", "x", "y", axis="0 0 0")), {}, "axis"),
        ((*XY, joint("j", "x", "z")), {}, "a link of the file, got 'z'"),
        ((link("x"), link("y")), {}, "one root, got 'x', 'y'"),
        ((*XY, joint("j", "x", "y"), joint("k", "y", "x")), {}, "in a circle"),
        ((*TWO, joint("c", "base", "fore")), {}, "got 'b' and 'c'"),
        ((link("x"), link("x")), {}, "'x' twice"),
        ((link("x", ""), link("y", ""), joint("j", "x", "y")), {}, "expected collision geometry"),
        ((*XY, joint("j", "x", "y", kind="fixed")), {}, "expected joints that move"),
        ((link("x", CYLINDER.format("radius='-1' length='1'")),), {}, "line 1: cylinder: radius: .*'-1'"),
        ((link("x", CYLINDER.format("length='1'")),), {}, "cylinder: radius: expected a value, got none"),
        ((link("x", CYLINDER.format("radius='nan' length='1'")),), {}, "got 'nan'"),
        ((link("x", SPHERE.replace("0.05", "0")),), {}, "sphere: radius"),
        ((link("x", SPHERE.replace("sphere radius", "box size")),), {}, "box: size: expected 3 positive"),
        ((link("x", SPHERE.replace("sphere", "capsule")),), {}, "line 1: geometry: expected .*got <capsule>"),
        ((link("x", ""), link("y", EMPTY)), {}, "line 1: geometry: expected a box, .*, got none"),
        ((link("x", SPHERE.replace("</g", "<box size='1 1 1'/></g")),), {}, "got sphere and box"),
        (with_mesh("no.stl"), {}, "link 'y': mesh 'no.stl': expected a file"),
        (with_mesh("http://a/no.stl"), {}, "got http://"),
        (with_mesh("arm.urdf"), {}, "mesh 'arm.urdf'"),
        (TWO, {"bodies": {"nose": []}}, "names of links, .* got 'nose'"),
        (TWO, {"limits": {"c": (0, 1)}}, "names of joints, a, b, got 'c'"),
        (TWO, {"parts": 0}, "parts"),
        (("<xacro:include/>",), {}, "xacro first|prefix"),
        (limited("<mimic joint='no'/><limit lower='0' upper='1'/>"), {}, "mimics 'no'"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused(
    tmp_path: Path, parts: tuple[str, ...], options: dict[str, Any], what: str
) -> None:
    with pytest.raises(InvalidInputError, match=what):
        SpatialArm.from_urdf(written(tmp_path, *parts), **options)


def test_bombs_and_giants_are_refused_at_the_door(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="DOCTYPE"):
        SpatialArm.from_urdf(written(tmp_path, link("&i;"), head=BOMB))
    giant = tmp_path / "giant.urdf"
    with giant.open("wb") as file:
        os.truncate(file.fileno(), 5 * 2**30)  # takes no room
    with pytest.raises(InvalidInputError, match="at most 16,777,216 bytes"):
        SpatialArm.from_urdf(giant)
    for path, what in [(tmp_path / "none.urdf", "got none"), (tmp_path, "got a folder")]:
        with pytest.raises(InvalidInputError, match=what):
            SpatialArm.from_urdf(path)


@needs_yourdfpy
def test_what_is_no_urdf_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.urdf"
    for content, what in [
        (b"", "got a file that is none"),
        (b"<robot>", "got a file that is none"),
        (b"<sdf/>", "got <sdf>"),
        (b"<robot/>", "cannot be read"),
        ('<!DOCTYPE robot SYSTEM "file:///etc/passwd"><robot name="a"/>'.encode("utf-16"), "DOCTYPE"),
    ]:
        path.write_bytes(content)
        with pytest.raises(InvalidInputError, match=what):
            SpatialArm.from_urdf(path)


def test_without_the_extra_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "yourdfpy", None)
    with pytest.raises(GuidedGymError, match=r"guided-gym\[urdf\]"):
        SpatialArm.from_urdf(written(tmp_path, *TWO))


@needs_yourdfpy
def test_a_start_beyond_a_limit_names_the_joint(tmp_path: Path) -> None:
    arm = SpatialArm.from_urdf(written(tmp_path, *TWO))
    with pytest.raises(InvalidInputError, match=r"joint 'b' at 2\.5; expected it within its limits, -1 to 2"):
        Problem(arm, ROOM, Task((0.0, 2.5), (0.0, 0.0)))


# Robots that people have, and another library ---------------------------------------------------------------


@pytest.fixture
def robots(reference: Callable[[str], ModuleType]) -> dict[str, tuple[Path, str]]:
    """File and tip of the arms of example-robot-data."""
    found: dict[str, tuple[Path, str]] = reference("example_robots").installed()
    if not found:
        pytest.skip("example-robot-data is not installed")
    return found


@needs_yourdfpy
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_tools_are_where_pinocchio_has_them(name: str, robots: dict[str, tuple[Path, str]]) -> None:
    pin = pytest.importorskip("pinocchio")
    path, tip = robots[name]
    arm = SpatialArm.from_urdf(path, tip)
    model = pin.buildModelFromUrdf(str(path))
    data, space = model.createData(), ConfigurationSpace(arm, ROOM)
    for q in space.sample(np.random.default_rng(0), 20):
        other = pin.neutral(model)
        for joint, value in zip(arm.names, q, strict=True):  # by name
            other[model.joints[model.getJointId(joint)].idx_q] = value
        pin.forwardKinematics(model, data, other)
        pin.updateFramePlacements(model, data)
        np.testing.assert_allclose(arm.tool_at(q), data.oMf[model.getFrameId(tip)].translation, atol=1e-9)


@needs_yourdfpy
def test_the_panda_has_three_tips_and_bodies_that_hold_its_meshes(
    robots: dict[str, tuple[Path, str]],
) -> None:
    trimesh = pytest.importorskip("trimesh")
    path, tip = robots["panda"]
    with pytest.raises(InvalidInputError, match="panda_leftfinger"):
        SpatialArm.from_urdf(path)
    arm = SpatialArm.from_urdf(path, tip, parts=2, self_collision=True)
    assert len(arm.names) == 7
    for number in range(1, 7):
        mesh = trimesh.load(path.parents[1] / f"meshes/collision/link{number}.stl", force="mesh")
        shapes = [body.shape for body in arm.bodies if body.link == f"panda_link{number}"]
        outside = np.min([[_outside(one, point) for point in mesh.vertices[::7]] for one in shapes], axis=0)
        assert outside.max() <= 1e-6


@needs_yourdfpy
def test_poses_and_motions_against_coal(robots: dict[str, tuple[Path, str]]) -> None:
    """The capsules of a UR5 among solids: gaps as coal has them, and no motion wrongly free."""
    coal = pytest.importorskip("coal")
    arm = SpatialArm.from_urdf(*robots["ur5"])
    solids = [
        Box((0.5, 0.2, 0.4), (0.3, 0.4, 0.1), (0.3, 0.2, 0.5)),
        Cylinder((-0.5, 0.3, 0.2), (-0.4, 0.5, 0.9), 0.1),
        Capsule((0.1, -0.6, 0.3), (0.4, -0.5, 0.9), 0.1),
        Capsule.sphere((-0.4, -0.4, 0.6), 0.15),
    ]
    world = SpatialEnvironment((-2, -2, -2, 2, 2, 2), solids)
    space = ConfigurationSpace(arm, world)

    def shape(solid: Any) -> Any:
        """Of coal, and where it is."""
        numbers = solid.numbers()
        made = {
            Box: lambda: coal.Box(*solid.sides),
            Cylinder: lambda: coal.Cylinder(solid.radius, solid.length),
            Capsule: lambda: coal.Capsule(solid.radius, solid.length),
        }[type(solid)]()
        return made, coal.Transform3s(numbers[3:12].reshape(3, 3).T, numbers[:3])

    placed = [shape(solid) for solid in solids]

    def gap(q: Any) -> float:
        gaps = []
        for capsule, body in zip(arm.capsules(q), arm.bodies, strict=True):
            if body.joint < 0:
                continue
            one, at = shape(capsule)
            for other, there in placed:
                found = coal.DistanceResult()  # a fresh one: it keeps what was
                gaps.append(coal.distance(one, at, other, there, coal.DistanceRequest(), found))
        return min(gaps)

    rng = np.random.default_rng(0)
    qs = space.sample(rng, 150)
    gaps = np.array([gap(q) for q in qs])
    told = gaps > -1.0  # 3.0.3 returns -2 and -1.8e308 for some gaps that are nearly 0
    clear = np.asarray(space.clearance(qs))
    assert np.asarray(space.valid(qs))[told].tolist() == (gaps[told] > space.tolerance).tolist()
    np.testing.assert_allclose(clear[told & (clear > 0)], gaps[told & (clear > 0)], atol=1e-5)
    free = qs[clear > 0][:40]
    ends = np.clip(free + 0.4 * rng.normal(size=free.shape), space.lower, space.upper)
    certified = space.motions_free(free, ends)
    assert 5 < certified.sum() < len(free)
    for a, b in zip(free[certified], ends[certified], strict=True):
        assert all(gap(q) > 0 for q in space.interpolate(a, b, np.linspace(0, 1, 30)))


@needs_yourdfpy
def test_links_that_mostly_touch_are_left_out_with_a_word(tmp_path: Path) -> None:
    thick = SPHERE.replace("0.05", "0.5")
    links = [link(name, thick) for name in "abcd"]
    path = written(tmp_path, *links, joint("j", "a", "b"), joint("k", "b", "c"), joint("l", "c", "d"))
    with pytest.warns(GuidedGymWarning, match="a and c, b and d|b and d"):
        arm = SpatialArm.from_urdf(path, self_collision=True)
    assert (0, 2) not in arm.pairs


@needs_yourdfpy
def test_seventeen_joints_are_refused_by_their_number(tmp_path: Path) -> None:
    names = ["base", *(f"l{k}" for k in range(17))]
    joints = [joint(f"j{k}", names[k], names[k + 1]) for k in range(17)]
    arm = SpatialArm.from_urdf(written(tmp_path, *map(link, names), *joints))
    room = SpatialEnvironment((-6, -6, -6, 6, 6, 6))
    problem = Problem(arm, room, Task(np.zeros(17), np.full(17, 0.1)))
    with pytest.raises(InvalidInputError, match="at most 16 dimensions, got 17"):
        guided_search(problem, "prm", seed=0, max_samples=10, measure=False)
