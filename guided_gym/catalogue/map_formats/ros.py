"""ROS map_server: a YAML file and the picture that it names (pyyaml and pillow, extra ``[maps]``)."""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from guided_gym.catalogue.map_formats.pictures import read_picture
from guided_gym.catalogue.map_formats.raster import Raster, needed
from guided_gym.checks import number, shown
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.occupancy import covered_cells
from guided_gym.storage.foreign_file import check_nesting, inside_folder, read_text
from guided_gym.storage.whole_file import write_whole

FloatArray = npt.NDArray[np.float64]

_LARGEST_YAML: Final = 2**20
_OCCUPIED, _UNKNOWN = 100, -1  # as in ROS


def ros_raster(path: Path) -> Raster:
    """The cells of a ROS map: a YAML file and the picture that it names.

    Read as nav2's map_server reads it: rows from the top down, trinary, scale or raw; in trinary mode an
    alpha channel is averaged in with the colours. The picture has to lie in the folder of the YAML file or
    below it.

    Raises:
        StorageError: A file cannot be read or is damaged.
        InvalidInputError: A field is missing, of the wrong type or out of range.
        GuidedGymError: pyyaml or pillow is not installed.
    """
    fields = _ros_fields(path)
    resolution, picture = ros_header(path)
    values = ros_values(
        *read_picture(picture),
        mode=str(fields.get("mode", "trinary")),
        negate=_negate(fields["negate"]),
        occupied_thresh=_yaml_number(fields, "occupied_thresh", 0.0, 1.0),
        free_thresh=_yaml_number(fields, "free_thresh", 0.0, 1.0),
    )
    return Raster(values[::-1], resolution, _ros_origin(fields["origin"]))


def ros_header(path: Path) -> tuple[float, Path]:
    """Resolution (length) and picture of a ROS map; errors as `ros_raster`."""
    fields = _ros_fields(path)
    resolution = number("resolution", _yaml_number(fields, "resolution", 0.0, 1e9), above=0, what="length")
    return resolution, inside_folder(path.parent, str(fields["image"]), path, "image")


def write_ros(path: Path, environment: Environment, resolution: float) -> None:
    """Write an environment as a ROS map: a YAML file, and a PGM picture of the same name beside it.

    A cell is occupied (black) if an obstacle reaches into it or it sticks out of the bounds, else free
    (white, 254): what is free in the map is free in the environment. The map's origin is the lower left
    corner of the bounds, which is that of the picture's lowest row. Of a map read from a raster, the cells
    come back as they were.

    Args:
        path: The YAML file.
        environment: The environment.
        resolution: Side of a cell (length).

    Raises:
        InvalidInputError: A resolution that is not positive, or so small that there are too many cells.
        StorageError: A file cannot be written.
    """
    covered = covered_cells(environment.obstacle_union, environment.bounds, resolution)
    picture = path.with_suffix(".pgm")
    rows, columns = covered.shape
    pixels = np.where(covered[::-1], np.uint8(0), np.uint8(254))
    write_whole(picture, f"P5\n{columns} {rows}\n255\n".encode() + pixels.tobytes())
    x, y = environment.bounds[:2]
    text = (
        f"image: {json.dumps(picture.name, ensure_ascii=False)}\nmode: trinary\n"
        f"resolution: {_yaml_float(resolution)}\norigin: [{_yaml_float(x)}, {_yaml_float(y)}, 0.0]\n"
        "negate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n"
    )
    write_whole(path, text)


def _yaml_float(value: float) -> str:
    """The same number again, for readers to whom 1e-05 is text."""
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def ros_values(
    colours: FloatArray,
    alpha: FloatArray | None,
    *,
    mode: str = "trinary",
    negate: bool = False,
    occupied_thresh: float = 0.65,
    free_thresh: float = 0.25,
) -> npt.NDArray[np.int16]:
    """The values of a ROS occupancy grid, -1 for unknown, else 0 to 100, of a picture's pixels.

    Args:
        colours: (rows, columns) brightness, 0 to 1: the mean of the colour channels.
        alpha: (rows, columns) opacity, 0 to 1; None where there is no such channel.
        mode: ``"trinary"``, ``"scale"`` or ``"raw"``.
        negate: Whether white is occupied.
        occupied_thresh: A pixel is occupied above it.
        free_thresh: A pixel is free below it.

    Raises:
        InvalidInputError: Another mode, or thresholds in the wrong order.
    """
    if mode not in ("trinary", "scale", "raw"):
        raise InvalidInputError(f"mode: expected trinary, scale or raw, got {shown(mode)}")
    if not free_thresh <= occupied_thresh:
        raise InvalidInputError(
            f"free_thresh: expected at most occupied_thresh, {occupied_thresh:g}, got {free_thresh:g}"
        )
    shade = colours
    if mode == "trinary" and alpha is not None:
        shade = (3.0 * colours + alpha) / 4.0  # so does nav2: an opaque channel makes pixels brighter
    if mode == "raw":
        raw = np.floor(shade * 255.0 + 0.5)
        return np.where(raw <= 100, raw, _UNKNOWN).astype(np.int16)
    occupancy = shade if negate else 1.0 - shade
    between = np.full(shade.shape, float(_UNKNOWN))
    if mode == "scale" and occupied_thresh > free_thresh:
        between = np.rint(np.clip((occupancy - free_thresh) / (occupied_thresh - free_thresh), 0, 1) * 100)
    values = np.where(occupied_thresh < occupancy, _OCCUPIED, np.where(occupancy < free_thresh, 0, between))
    if mode == "scale" and alpha is not None:
        values = np.where(alpha < 1.0, _UNKNOWN, values)
    return values.astype(np.int16)


def _ros_fields(path: Path) -> dict[str, Any]:
    yaml = needed("yaml", "pyyaml")
    text = read_text(path, _LARGEST_YAML)
    check_nesting(path, text)
    try:
        fields = yaml.load(text, Loader=_plain_loader(yaml))
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise StorageError(f"{path}{place}: expected YAML, got: {problem}") from error
    except (ValueError, OverflowError) as error:  # an impossible date, an integer of many digits
        raise StorageError(f"{path}: expected YAML, got: {error}") from error
    if not isinstance(fields, dict):
        raise InvalidInputError(f"expected the fields of a ROS map, got {type(fields).__name__}")
    for name in ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"):
        if name not in fields:
            raise InvalidInputError(f"{name}: a ROS map needs this field, got none")
    if not isinstance(fields["image"], str) or not fields["image"]:
        raise InvalidInputError(f"image: expected the name of a picture, got {fields['image']!r}")
    return fields


def _plain_loader(yaml: ModuleType) -> Any:
    """A loader of plain data that refuses duplicate keys, and references to what was read before."""

    class Loader(yaml.SafeLoader):  # type: ignore[misc, name-defined]
        def compose_node(self, parent: Any, index: Any) -> Any:
            if self.check_event(yaml.events.AliasEvent):
                event = self.peek_event()
                raise yaml.composer.ComposerError(
                    None, None, "a reference (*name), which no map needs", event.start_mark
                )
            return super().compose_node(parent, index)

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            seen: set[str] = set()
            for key, _ in node.value:
                if str(key.value) in seen:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"the key {str(key.value)!r} a second time", key.start_mark
                    )
                seen.add(str(key.value))
            return super().construct_mapping(node, deep)

    return Loader


def _yaml_number(fields: dict[str, Any], name: str, least: float, most: float) -> float:
    value = _as_number(name, fields[name])
    if not least <= value <= most:
        raise InvalidInputError(f"{name}: expected {least:g} to {most:g}, got {shown(value)}")
    return value


def _as_number(name: str, value: object) -> float:
    """A number of a YAML file: ``-.5`` and ``1e-05`` come as text."""
    if isinstance(value, str):
        with contextlib.suppress(ValueError):
            value = float(value)
    return number(name, value)


def _negate(value: object) -> bool:
    if value in (0, 1, True, False, "0", "1"):
        return bool(int(value))  # type: ignore[call-overload]
    raise InvalidInputError(f"negate: expected 0 or 1, got {shown(value)}")


def _ros_origin(value: object) -> list[float]:
    if not isinstance(value, list) or len(value) != 3:
        raise InvalidInputError(f"origin: expected [x, y, yaw], got {shown(value)}")
    pose = [_as_number("origin", part) for part in value]
    if abs(pose[2]) > 2.0 * math.pi:
        raise InvalidInputError(
            f"origin: expected a yaw of -2 pi to 2 pi in radians, got {pose[2]!r} (in degrees?)"
        )
    return pose
