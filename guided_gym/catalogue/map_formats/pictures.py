"""Pictures: their pixels, with sizes checked before anything is unpacked (pillow, extra ``[maps]``)."""

from __future__ import annotations

import re
import struct
import zlib
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from guided_gym.catalogue.map_formats.raster import Raster, needed
from guided_gym.checks import shown
from guided_gym.errors import GuidedGymError, StorageError
from guided_gym.geometry.occupancy import MOST_CELLS
from guided_gym.storage.foreign_file import read_bytes

FloatArray = npt.NDArray[np.float64]

_PICTURES: Final = ("PNG", "BMP", "JPEG", "PPM")


def picture_raster(path: Path) -> Raster:
    """The cells of a picture: dark is occupied, not drawn is unknown; errors as `read_picture`."""
    colours, alpha = read_picture(path)
    occupancy = 1.0 - colours
    if alpha is not None:
        occupancy = np.where(alpha > 0.5, occupancy, np.nan)
    return Raster(occupancy[::-1])


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
