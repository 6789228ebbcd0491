"""Readers of maps in common formats: ROS map_server, MovingAI, GeoJSON, pictures and arrays.

A map is bounds and obstacles, an `Environment`; robots and tasks come from problem files
(`guided_gym.catalogue.files`). Nothing that is read can run code, and sizes are checked before anything is
unpacked. Of pictures and YAML, pillow and pyyaml read (extra ``[maps]``).
"""

from __future__ import annotations

import contextlib
import json
import math
import re
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import shapely

from guided_gym.checks import number, shown
from guided_gym.doors import door, doors
from guided_gym.errors import GuidedGymError, InvalidInputError, StorageError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.occupancy import MOST_CELLS, UNKNOWN, covered_cells
from guided_gym.storage.whole_file import write_whole

FloatArray = npt.NDArray[np.float64]

LARGEST: Final = 2**28
"""Bytes of the largest file that is read."""
MOST_NESTED: Final = 32
"""Lists in lists that a file may have."""
EARTH: Final = 6371008.8
"""Mean radius of the earth (m)."""

_LARGEST_YAML: Final = 2**20
_PICTURES: Final = ("PNG", "BMP", "JPEG", "PPM")
_ROS_KEYS: Final = (
    "image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh", "mode",
)  # fmt: skip
_OCCUPIED, _UNKNOWN = 100, -1  # as in ROS


@doors
@dataclass(frozen=True)
class MapOptions:
    """What a map does not say by itself.

    Attributes:
        unknown: ``"occupied"`` or ``"free"``: what unknown cells count as.
        threshold: Probability from which a cell counts as occupied.
        simplify: Boundaries of a raster may move by half of this (length).
        speckles: Parts of fewer cells than this are left out.
        resolution: Side of a cell of a picture or array (length); a map's own value wins.
        bounds: Bounds of a map without any.
        margin: Room around the obstacles of a map without bounds, as a share of their extent.
        geographic: Whether GeoJSON has longitude and latitude; they become metres around the map's centre.
        repair: Whether polygons that cross themselves are mended; else they are refused.
    """

    unknown: str = "occupied"
    threshold: float = 0.5
    simplify: float = 0.0
    speckles: int = 1
    resolution: float | None = None
    bounds: tuple[float, float, float, float] | None = None
    margin: float = 0.05
    geographic: bool = False
    repair: bool = False

    def __post_init__(self) -> None:
        if self.unknown not in UNKNOWN:
            raise InvalidInputError(
                f"unknown: expected one of {', '.join(UNKNOWN)}, got {shown(self.unknown)}"
            )
        number("margin", self.margin, least=0)


DEFAULT_OPTIONS: Final = MapOptions()


@dataclass(frozen=True)
class GridTask:
    """A task of a MovingAI scenario.

    Attributes:
        start: (2,) centre of the start's cell.
        goal: (2,) centre of the goal's cell.
        length: Length of the shortest path over the grid's eight directions, as the scenario has it.
        map_name: The map that it names.
    """

    start: FloatArray
    goal: FloatArray
    length: float
    map_name: str


@door
def read_map(path: str | Path, options: MapOptions = DEFAULT_OPTIONS) -> Environment:
    """The environment of a map file, by its extension: see `MAP_SUFFIXES`.

    Args:
        path: A ROS ``.yaml``, MovingAI ``.map``, ``.geojson``, a picture (``.png``, ``.pgm``, ``.bmp``,
            ``.jpg``) or an array (``.npy``).
        options: What the file does not say.

    Raises:
        StorageError: The file cannot be read, is damaged, or is no such map; names file and place.
        InvalidInputError: Another extension, or options that do not fit.
        GuidedGymError: A package that reads it is not installed.
    """
    path = Path(path)
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InvalidInputError(
            f"{path}: expected a map with one of the extensions {', '.join(_READERS)}, "
            f"got {shown(path.suffix)}"
        )
    try:
        return reader(path, options)
    except InvalidInputError as error:
        raise InvalidInputError(f"{path}: {error}") from None
    except (MemoryError, RecursionError) as error:
        raise StorageError(
            f"{path}: expected a map, got one that is too large or nested too deeply"
        ) from error


def read_bytes(path: Path, largest: int = LARGEST) -> bytes:
    """The content of a file that is not larger than allowed.

    Raises:
        StorageError: It cannot be read, or is larger.
    """
    try:
        size = path.stat().st_size
        if size > largest:
            raise StorageError(f"{path}: expected a file of at most {largest} bytes, got {size}")
        with path.open("rb") as file:
            content = file.read(largest + 1)  # devices and pipes say no size
    except (OSError, ValueError) as error:
        raise StorageError(f"cannot read {path}: {error}") from error
    if len(content) > largest:
        raise StorageError(f"{path}: expected a file of at most {largest} bytes, got more")
    return content


def read_text(path: Path, largest: int = LARGEST) -> str:
    """The text of a UTF-8 file that is not larger than allowed.

    Raises:
        StorageError: It cannot be read, is larger, or is no UTF-8.
    """
    content = read_bytes(path, largest)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise StorageError(f"{path}, line {line}: expected UTF-8 text, got other bytes") from error


def check_nesting(path: Path, text: str) -> None:
    """Refuse text whose brackets are nested deeper than in any honest file: readers would overflow.

    Raises:
        StorageError: It is.
    """
    depth, quoted = 0, False
    for match in re.finditer(r'\\.|["\[\](){}]', text):
        mark = match.group()
        if mark == '"':
            quoted = not quoted
        elif quoted or mark[0] == "\\":
            continue
        elif mark in "[({":
            depth += 1
            if depth > MOST_NESTED:
                line = text.count("\n", 0, match.start()) + 1
                raise StorageError(
                    f"{path}, line {line}: expected lists nested at most {MOST_NESTED} deep, got more"
                )
        else:
            depth = max(depth - 1, 0)


# ROS map_server ---------------------------------------------------------------------------------------------


def read_ros(path: Path, options: MapOptions = DEFAULT_OPTIONS) -> Environment:
    """The environment of a ROS map: a YAML file and the picture that it names.

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
    return Environment.from_occupancy(
        values[::-1],
        resolution,
        _ros_origin(fields["origin"]),
        unknown=options.unknown,
        threshold=options.threshold,
        simplify=options.simplify,
        speckles=options.speckles,
    )


def ros_header(path: Path) -> tuple[float, Path]:
    """Resolution (length) and picture of a ROS map; errors as `read_ros`."""
    fields = _ros_fields(path)
    resolution = number("resolution", _yaml_number(fields, "resolution", 0.0, 1e9), above=0, what="length")
    return resolution, inside_folder(path.parent, str(fields["image"]), path)


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


def inside_folder(folder: Path, name: str, path: Path) -> Path:
    """A file named in another, which may not lie outside that one's folder.

    Raises:
        InvalidInputError: It does.
    """
    try:
        target = (folder / name).resolve()
        inside, there = target.is_relative_to(folder.resolve()), target.is_file()
    except (OSError, ValueError, RuntimeError) as error:
        why = getattr(error, "strerror", None) or error  # without the name, which may be long
        raise InvalidInputError(f"image: expected the name of a file, got {shown(name)}: {why}") from None
    if not inside:
        raise InvalidInputError(f"image: expected a file in {folder} or below, got {shown(name)}")
    if not there:
        raise StorageError(f"{path}: image: expected a picture at {target}, but there is no such file")
    return target


# Pictures ---------------------------------------------------------------------------------------------------


def read_picture(path: Path) -> tuple[FloatArray, FloatArray | None]:
    """The pixels of a picture: (rows, columns) mean of the colour channels, 0 to 1, and opacity or None.

    Raises:
        StorageError: It cannot be read, is damaged, or unpacks to more than `MOST_CELLS` pixels.
        GuidedGymError: pillow is not installed.
    """
    if path.suffix.lower() == ".pgm":
        return read_pgm(path), None
    image_module = needed("PIL.Image", "pillow")
    content = read_bytes(path)
    try:
        with image_module.open(path, formats=_PICTURES) as image:
            width, height = image.size
            if width * height > MOST_CELLS:
                raise StorageError(f"{path}: expected at most {MOST_CELLS} pixels, got {width} x {height}")
            if image.format == "PNG":
                _check_png(path, content)
            image.load()
            return _channels(image)
    except GuidedGymError:
        raise
    except Exception as error:  # pillow's readers raise many kinds on damaged files
        raise StorageError(f"{path}: expected a whole picture, got: {error}") from error


_PNG_CHANNELS: Final = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_PNG_PASSES: Final = (
    (0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2),
)  # fmt: skip


def _check_png(path: Path, content: bytes) -> None:
    """Refuse a PNG that has fewer rows than it says: pillow takes the rest for black.

    Raises:
        StorageError: It does.
        struct.error, zlib.error, KeyError: It is damaged in another way.
    """
    width, height, bits, kind, _, _, interlaced = struct.unpack(">IIBBBBB", content[16:29])
    passes = _PNG_PASSES if interlaced else ((0, 0, 1, 1),)
    sizes = [(max(0, -((x - width) // dx)), max(0, -((y - height) // dy))) for x, y, dx, dy in passes]
    wanted = sum(
        rows * (1 + (columns * bits * _PNG_CHANNELS[kind] + 7) // 8) for columns, rows in sizes if columns
    )
    unpacker, place, found = zlib.decompressobj(), 8, 0
    while place + 8 <= len(content) and found < wanted and not unpacker.eof:
        size = int.from_bytes(content[place : place + 4], "big")
        packed = content[place + 8 : place + 8 + size] if content[place + 4 : place + 8] == b"IDAT" else b""
        while packed and found < wanted:
            found += len(unpacker.decompress(packed, 2**20))
            packed = unpacker.unconsumed_tail
        place += 12 + size
    if found < wanted:
        raise StorageError(f"{path}: expected {wanted} bytes of pixels, got {found}")


def _channels(image: Any) -> tuple[FloatArray, FloatArray | None]:
    if image.mode == "P" or "transparency" in image.info:
        image = image.convert("RGBA" if "transparency" in image.info else "RGB")
    elif image.mode in ("1", "CMYK", "YCbCr", "HSV", "LAB"):
        image = image.convert("L" if image.mode == "1" else "RGB")
    pixels = np.asarray(image)
    scale = 65535.0 if image.mode.startswith("I") else 255.0
    if pixels.ndim == 2:
        return pixels / scale, None
    bands = image.getbands()
    alpha = pixels[..., -1] / scale if bands[-1] == "A" else None
    colours = pixels[..., : len(bands) - (alpha is not None)]
    return colours.mean(axis=2) / scale, alpha


def read_pgm(path: Path) -> FloatArray:
    """The pixels of a PGM picture, (rows, columns), 0 to 1: plain or binary, 8 or 16 bits, with comments.

    Raises:
        StorageError: It cannot be read, is damaged or cut off, or is no PGM.
    """
    content = read_bytes(path)
    header: list[int] = []
    magic, place = content[:2], 2
    if magic not in (b"P2", b"P5"):
        raise StorageError(f"{path}: expected a PGM picture (P2 or P5), got one that begins {magic!r}")
    while len(header) < 3:
        match = _PGM_TOKEN.match(content, place)
        if match is None:
            raise StorageError(f"{path}: expected width, height and maximum in the header, got {header}")
        header.append(int(match[1]))
        place = match.end()
    width, height, most = header
    if not (min(width, height) > 0 and width * height <= MOST_CELLS and 0 < most < 65536):
        raise StorageError(
            f"{path}: expected at most {MOST_CELLS} pixels and a maximum of 1 to 65535, "
            f"got {width} x {height} and {most}"
        )
    if magic == b"P2":
        values = _plain_values(path, content[place:], width * height)
    else:
        values = _binary_values(path, content[place:], width * height, 1 if most < 256 else 2)
    if values.max() > most:
        raise StorageError(f"{path}: expected values up to {most}, got {int(values.max())}")
    return np.asarray(values.reshape(height, width) / float(most))


_SPACE: Final = re.compile(rb"\s")
_PIECE: Final = 2**20  # bytes
_PGM_TOKEN: Final = re.compile(rb"(?:\s|#[^\n]*(?:\n|$))*(\d{1,9})(?!\d)")


def _plain_values(path: Path, text: bytes, count: int) -> npt.NDArray[Any]:
    values, found, place = np.empty(count, np.int32), 0, 0
    text = re.sub(rb"#[^\n]*", b"", text)
    while found < count and place < len(text):  # piece by piece: words take many times the room of the text
        space = _SPACE.search(text, place + _PIECE)
        end = space.start() if space else len(text)
        words = text[place:end].split()[: count - found]
        if not all(word.isdigit() and len(word) < 7 for word in words):
            bad = next(word for word in words if not (word.isdigit() and len(word) < 7))
            raise StorageError(f"{path}: expected {count} values, got {shown(bad[:40])} among them")
        values[found : found + len(words)] = list(map(int, words))
        found, place = found + len(words), end
    if found < count:
        raise StorageError(f"{path}: expected {count} values, got {found}")
    return values


def _binary_values(path: Path, content: bytes, count: int, size: int) -> npt.NDArray[Any]:
    pixels = content[1:]  # one white space ends the header
    end = content.find(b"\n")
    if content[:end].strip().startswith(b"#") and len(content) - end - 1 == count * size:
        pixels = content[end + 1 :]  # a comment in the line of the maximum
    if len(pixels) < count * size:
        raise StorageError(f"{path}: expected {count * size} bytes of pixels, got {len(pixels)}")
    return np.frombuffer(pixels, ">u2" if size == 2 else "u1", count)


def _picture_map(path: Path, options: MapOptions) -> Environment:
    colours, alpha = read_picture(path)
    occupancy = 1.0 - colours
    if alpha is not None:
        occupancy = np.where(alpha > 0.5, occupancy, np.nan)  # nothing is drawn there
    return _raster_map(occupancy[::-1], options)


def _array_map(path: Path, options: MapOptions) -> Environment:
    read_bytes(path)
    try:
        header = np.load(path, mmap_mode="r", allow_pickle=False)
        if getattr(header, "ndim", 0) != 2 or header.size > MOST_CELLS:
            shape = getattr(header, "shape", "no array")
            raise StorageError(f"{path}: expected (rows, columns), at most {MOST_CELLS} cells, got {shape}")
        occupancy = np.array(header)
    except GuidedGymError:
        raise
    except Exception as error:  # numpy's reader raises many kinds on damaged files
        raise StorageError(f"{path}: expected an array in numpy's format, got: {error}") from error
    return _raster_map(occupancy, options)


def _raster_map(occupancy: npt.NDArray[Any], options: MapOptions) -> Environment:
    if options.resolution is None:
        raise InvalidInputError(
            "resolution: expected the side of a cell, since this map does not say it; got none"
        )
    return Environment.from_occupancy(
        occupancy,
        options.resolution,
        unknown=options.unknown,
        threshold=options.threshold,
        simplify=options.simplify,
        speckles=options.speckles,
    )


# MovingAI ---------------------------------------------------------------------------------------------------

_PASSABLE: Final = ".GS"
_BLOCKED: Final = "@OTW"


def read_movingai(path: Path, options: MapOptions = DEFAULT_OPTIONS) -> Environment:
    """The environment of a MovingAI ``.map``: cells of side 1, y upwards, so row 0 lies at the top.

    Raises:
        StorageError: It cannot be read, is damaged or cut off.
    """
    occupied = movingai_cells(path)
    return Environment.from_occupancy(
        occupied[::-1],
        1.0 if options.resolution is None else options.resolution,
        simplify=options.simplify,
        speckles=options.speckles,
    )


def movingai_cells(path: Path) -> npt.NDArray[np.bool_]:
    """(rows, columns) whether each cell is blocked, row 0 first in the file.

    Raises:
        StorageError: It cannot be read, is damaged or cut off.
    """
    lines = read_text(path).splitlines()
    header = [line.split() for line in lines[:4]]
    names = [words[0].lower() if words else "" for words in header]
    if names != ["type", "height", "width", "map"]:
        raise StorageError(f"{path}: expected lines type, height, width and map first, got {shown(names)}")
    sizes = []
    for line, words in enumerate(header[1:3], start=2):
        if len(words) != 2 or not words[1].isdecimal() or not 0 < len(words[1]) < 8 or not int(words[1]):
            raise StorageError(
                f"{path}, line {line}: expected a positive integer, got {' '.join(words[1:])!r}"
            )
        sizes.append(int(words[1]))
    height, width = sizes
    rows = lines[4 : 4 + height]
    if height * width > MOST_CELLS or len(rows) < height:
        raise StorageError(f"{path}: expected {height} rows of {width} cells, got {len(rows)} rows")
    for line, row in enumerate(rows, start=5):
        bad = set(row) - set(_PASSABLE + _BLOCKED)
        if len(row) != width or bad:
            what = f"a cell {sorted(bad)[0]!r}" if bad else f"{len(row)} cells"
            raise StorageError(
                f"{path}, line {line}: expected {width} cells of {_PASSABLE + _BLOCKED}, got {what}"
            )
    codes = np.frombuffer("".join(rows).encode("ascii"), np.uint8).reshape(height, width)
    return ~np.isin(codes, np.frombuffer(_PASSABLE.encode(), np.uint8))


@door
def read_scenario(path: str | Path) -> list[GridTask]:
    """The tasks of a MovingAI ``.scen``, in the coordinates of `read_movingai`.

    Raises:
        StorageError: It cannot be read, is damaged or names a cell outside its map.
    """
    path = Path(path)
    lines = read_text(path).splitlines()
    if not lines or lines[0].split()[:1] != ["version"]:
        raise StorageError(f"{path}, line 1: expected 'version 1', got {lines[0][:40] if lines else ''!r}")
    return [_grid_task(path, line, text) for line, text in enumerate(lines[1:], start=2) if text.strip()]


def _grid_task(path: Path, line: int, text: str) -> GridTask:
    words = text.split("\t") if "\t" in text else text.split()
    try:
        width, height, x0, y0, x1, y1 = (int(word) for word in words[2:8])
        length = float(words[8])
    except (ValueError, IndexError):
        raise StorageError(
            f"{path}, line {line}: expected bucket, map, width, height, start x, y, goal x, y and length, "
            f"got {text[:80]!r}"
        ) from None
    for x, y in ((x0, y0), (x1, y1)):
        if not (0 <= x < width and 0 <= y < height):
            raise StorageError(f"{path}, line {line}: expected cells in {width} x {height}, got ({x}, {y})")
    if not (math.isfinite(length) and length >= 0):
        raise StorageError(f"{path}, line {line}: expected a length >= 0, got {words[8]!r}")
    start, goal = (np.array([x + 0.5, height - y - 0.5]) for x, y in ((x0, y0), (x1, y1)))
    return GridTask(start, goal, length, words[1].strip())


# GeoJSON ----------------------------------------------------------------------------------------------------


def read_geojson(path: Path, options: MapOptions = DEFAULT_OPTIONS) -> Environment:
    """The environment of a GeoJSON file: its polygons are obstacles.

    A feature's property ``role`` may say otherwise: ``bounds`` (its bounding box), ``region`` or ``ignore``.

    Raises:
        StorageError: It cannot be read or is no GeoJSON; names the feature.
        InvalidInputError: A polygon that cannot be an obstacle.
    """
    bounds, obstacles = None, []
    shapes = [(label, role, shape) for label, role, shape in geojson_shapes(path)]
    if options.geographic:
        shapes = _projected(path, shapes)
    for label, role, shape in shapes:
        if role == "bounds":
            bounds = shape.bounds
        elif role == "obstacle":
            obstacles += obstacle_polygons(f"{path}, {label}", shape, options.repair)
    if not obstacles and bounds is None and options.bounds is None:
        raise StorageError(f"{path}: expected polygons, got none")
    box = options.bounds or bounds or _around(obstacles, options.margin)
    return Environment(box, tuple(obstacles))


def geojson_shapes(path: Path) -> Iterator[tuple[str, str, shapely.Geometry]]:
    """What each feature is called, its role, and its shape.

    Raises:
        StorageError: It cannot be read or is no GeoJSON; names the feature.
    """
    text = read_text(path)
    check_nesting(path, text)
    content = parsed_json(path, text)
    kind = content.get("type") if isinstance(content, dict) else None
    if kind == "FeatureCollection" and isinstance(content.get("features"), list):
        features = content["features"]
    elif kind == "Feature":
        features = [content]
    else:
        features = [{"type": "Feature", "geometry": content}]
    for index, feature in enumerate(features):
        label = f"feature {index}"
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            raise StorageError(f"{path}, {label}: expected a GeoJSON feature, got {str(feature)[:60]}")
        properties = feature.get("properties")
        properties = properties if isinstance(properties, dict) else {}
        role = properties.get("role", "obstacle")
        if role not in ("obstacle", "bounds", "region", "ignore"):
            raise StorageError(
                f"{path}, {label}: role: expected obstacle, bounds, region or ignore, got {shown(role)}"
            )
        if isinstance(properties.get("name"), str):
            label += f" ({properties['name']!r})"
        if role != "ignore":
            yield label, role, geojson_shape(f"{path}, {label}", feature.get("geometry"))


_DEPTHS: Final = {
    "Point": 1, "MultiPoint": 2, "LineString": 2, "LinearRing": 2, "MultiLineString": 3,
    "Polygon": 3, "MultiPolygon": 4,
}  # fmt: skip


def geojson_shape(place: str, geometry: Any) -> shapely.Geometry:
    """The shape of a GeoJSON geometry.

    Args:
        place: Where it stands, for messages.
        geometry: What JSON made of it.

    Raises:
        InvalidInputError: It is no geometry, or not of finite numbers.
    """
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if kind == "GeometryCollection" and isinstance(geometry.get("geometries"), list):
        return shapely.GeometryCollection([geojson_shape(place, part) for part in geometry["geometries"]])
    if not isinstance(kind, str) or kind not in _DEPTHS:
        known = ", ".join(_DEPTHS)
        raise InvalidInputError(f"{place}: type: expected one of {known}, got {str(kind)[:40]!r}")
    coordinates = geometry.get("coordinates")
    _check_coordinates(place, coordinates, _DEPTHS[kind])
    try:
        return shapely.geometry.shape({"type": kind, "coordinates": coordinates})
    except (ValueError, TypeError, IndexError, shapely.errors.ShapelyError) as error:
        raise InvalidInputError(f"{place}: expected a {kind}, got: {error}") from None


def _check_coordinates(place: str, value: Any, depth: int) -> None:
    if not isinstance(value, list | tuple):
        raise InvalidInputError(f"{place}: coordinates: expected a list, got {str(value)[:40]!r}")
    if depth > 1:
        for part in value:
            _check_coordinates(place, part, depth - 1)
        return
    good = len(value) in (0, 2, 3) and all(type(x) in (int, float) and abs(x) <= 1e12 for x in value)
    if not good:
        raise InvalidInputError(
            f"{place}: coordinates: expected two finite numbers up to 1e12, got {str(value)[:60]}"
        )


def obstacle_polygons(place: str, shape: shapely.Geometry, repair: bool) -> list[shapely.Polygon]:
    """The polygons of an obstacle.

    Raises:
        InvalidInputError: It is a line or a point, or crosses itself.
    """
    parts = [part for part in shapely.get_parts(shape).tolist() if not part.is_empty]
    if any(isinstance(part, shapely.MultiPolygon | shapely.GeometryCollection) for part in parts):
        return [polygon for part in parts for polygon in obstacle_polygons(place, part, repair)]
    for part in parts:
        if not isinstance(part, shapely.Polygon):
            raise InvalidInputError(
                f"{place}: expected polygons, got a {part.geom_type} (role = 'ignore' leaves it out)"
            )
    if repair:
        mended = shapely.make_valid(np.array(parts, object), method="structure", keep_collapsed=False)
        parts = [part for part in shapely.get_parts(mended).tolist() if isinstance(part, shapely.Polygon)]
        return [part for whole in parts for part in shapely.get_parts(whole).tolist()]
    for part in parts:
        if not part.is_valid:
            reason = shapely.is_valid_reason(part)
            raise InvalidInputError(f"{place}: expected a simple polygon, got one with {reason}")
    return parts


def _around(obstacles: list[shapely.Polygon], margin: float) -> tuple[float, float, float, float]:
    xmin, ymin, xmax, ymax = shapely.total_bounds(np.array(obstacles, dtype=object)).tolist()
    room = margin * math.hypot(xmax - xmin, ymax - ymin)
    return (xmin - room, ymin - room, xmax + room, ymax + room)


def _projected(
    path: Path, shapes: Sequence[tuple[str, str, shapely.Geometry]]
) -> list[tuple[str, str, shapely.Geometry]]:
    """Longitude and latitude (degrees) as metres east and north of the map's centre."""
    box = shapely.total_bounds(np.array([shape for _, _, shape in shapes], dtype=object))
    if not (np.abs(box[[0, 2]]) <= 180).all() or not (np.abs(box[[1, 3]]) <= 89).all():
        raise StorageError(f"{path}: expected longitudes and latitudes in degrees, got {box.tolist()}")
    longitude, latitude = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    factors = EARTH * math.radians(1.0) * np.array([math.cos(math.radians(latitude)), 1.0])

    def metres(points: FloatArray) -> FloatArray:
        return np.asarray((points - [longitude, latitude]) * factors)

    return [(label, role, shapely.transform(shape, metres)) for label, role, shape in shapes]


def write_geojson(path: Path, environment: Environment) -> None:
    """Write an environment as GeoJSON, from which `read_geojson` makes the same one.

    Raises:
        StorageError: The file cannot be written.
    """
    bounds = shapely.box(*environment.bounds)
    rows = [
        json.dumps(
            {"type": "Feature", "properties": {"role": role}, "geometry": shapely.geometry.mapping(shape)}
        )
        for role, shape in (("bounds", bounds), *(("obstacle", one) for one in environment.obstacles))
    ]
    text = '{"type": "FeatureCollection", "features": [\n' + ",\n".join(rows) + "\n]}\n"
    write_whole(path, text)


# All of them ------------------------------------------------------------------------------------------------


def parsed_json(path: Path, text: str) -> Any:
    """The content of a JSON text without duplicate keys, NaN or infinity.

    Raises:
        StorageError: It is none; names the line.
    """

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        content = dict(pairs)
        if len(content) < len(pairs):
            raise _DuplicateError
        return content

    def refuse(word: str) -> Any:
        raise _ConstantError(word)

    try:
        return json.loads(text, object_pairs_hook=unique, parse_constant=refuse)
    except json.JSONDecodeError as error:
        raise StorageError(f"{path}, line {error.lineno}: expected JSON, got: {error.msg}") from error
    except _DuplicateError:
        line, name = _second_key(text)
        raise StorageError(
            f"{path}, line {line}: expected each key once, got {name[:60]!r} a second time"
        ) from None
    except _ConstantError as error:
        word = str(error.args[0])
        line = text.count("\n", 0, text.find(word)) + 1
        raise StorageError(f"{path}, line {line}: expected finite numbers, got {word}") from None
    except (ValueError, RecursionError) as error:
        raise StorageError(f"{path}: expected JSON, got: {reason(error)}") from error


def reason(error: Exception) -> str:
    """What a parser says, in words that fit a file."""
    text = str(error)
    return "an integer of thousands of digits" if "integer string conversion" in text else text


class _DuplicateError(Exception):
    """A key a second time."""


class _ConstantError(Exception):
    """NaN or an infinity."""


_JSON_TOKEN: Final = re.compile(r'"(?:\\.|[^"\\])*"|[\[\]{}:,]')


def _second_key(text: str) -> tuple[int, str]:
    """The line of the first key that stands in its object a second time, and that key."""
    keys: list[set[str] | None] = []  # of each object that is open; None for a list
    last = ""
    for match in _JSON_TOKEN.finditer(text):
        token = match.group()
        if token in "{[":
            keys.append(set() if token == "{" else None)
        elif token in "}]":
            keys.pop()
        elif token == ":" and keys and keys[-1] is not None:
            if last in keys[-1]:
                return text.count("\n", 0, match.start()) + 1, str(json.loads(last))
            keys[-1].add(last)
        elif token[0] == '"':
            last = json.dumps(json.loads(token))
    return 1, ""


def needed(module: str, package: str) -> ModuleType:
    """A module of the extra ``[maps]``.

    Raises:
        GuidedGymError: It is not installed.
    """
    import importlib

    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise GuidedGymError(
            f"reading this needs {package}: pip install 'guided-gym[maps]' ({error})"
        ) from error


_READERS: Final[dict[str, Callable[[Path, MapOptions], Environment]]] = {
    ".yaml": read_ros,
    ".yml": read_ros,
    ".map": read_movingai,
    ".geojson": read_geojson,
    ".png": _picture_map,
    ".pgm": _picture_map,
    ".bmp": _picture_map,
    ".jpg": _picture_map,
    ".jpeg": _picture_map,
    ".npy": _array_map,
}
MAP_SUFFIXES: Final = tuple(_READERS)
