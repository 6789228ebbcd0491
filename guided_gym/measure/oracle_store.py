"""Solved oracle fields on disk: safe to delete at any time and to share between processes."""

from __future__ import annotations

import math
import struct
import zlib

import numpy as np
import numpy.typing as npt

from guided_gym.storage.cache_folder import CacheFolder

FieldArray = npt.NDArray[np.float32]
LinkArray = npt.NDArray[np.uint8]
FloatArray = npt.NDArray[np.float64]
EdgeArray = npt.NDArray[np.int32]

# magic, key, vertices, checksum, error (mean, tail); 128 bytes keep the arrays aligned
_HEADER = struct.Struct("<16s64sQI4xdd16x")
_MAGIC = b"guided-gym field"
_ROADMAP = b"guided-gym roads"
_SHAPE = struct.Struct("<QQQ")  # vertices, dimensions, edges


class FieldStore(CacheFolder):
    """A cache folder of fields, one file each; what is truncated, altered or foreign counts as absent."""

    name = "oracle"
    suffix = ".field"

    def load(self, key: str, size: int) -> tuple[FieldArray, LinkArray, tuple[float, float]] | None:
        """The field and links (size,) stored under a key (64 hex digits), and their error; or None."""
        content = self.read(key, _HEADER.size + 5 * size)
        if content is None:
            return None
        body = content[_HEADER.size :]
        *head, checksum, mean, tail = _HEADER.unpack(content[: _HEADER.size].tobytes())
        if head != [_MAGIC, key.encode(), size] or checksum != _checksum(body.data, (mean, tail)):
            return None
        return body[: 4 * size].view(np.float32), body[4 * size :], (mean, tail)

    def save(
        self, key: str, field: FieldArray, links: LinkArray, error: tuple[float, float] = (math.nan, math.nan)
    ) -> None:
        """Store a field, its links and its error (mean, tail) under a key; a failure to do so is no error."""
        body = field.astype("<f4").tobytes() + links.tobytes()
        self._store(key, _MAGIC, field.size, body, error)

    def _store(self, key: str, magic: bytes, size: int, body: bytes, error: tuple[float, float]) -> None:
        self.write(key, _HEADER.pack(magic, key.encode(), size, _checksum(body, error), *error), body)

    def load_arrays(self, key: str) -> tuple[FloatArray, EdgeArray, FloatArray] | None:
        """Vertices (n, d), edges (m, 2) and lengths (m,) of the roadmap stored under a key; or None."""
        content = self.read(key)
        if content is None or len(content) < _HEADER.size + _SHAPE.size:
            return None
        body = content[_HEADER.size :]
        *head, checksum, mean, tail = _HEADER.unpack(content[: _HEADER.size].tobytes())
        if head != [_ROADMAP, key.encode(), len(body)] or checksum != _checksum(body.data, (mean, tail)):
            return None
        n, d, m = _SHAPE.unpack(body[: _SHAPE.size].tobytes())
        if len(body) != _SHAPE.size + 8 * (n * d + 2 * m):
            return None
        numbers = np.frombuffer(body.data, np.float64, n * d + m, _SHAPE.size)
        edges = np.frombuffer(body.data, np.int32, 2 * m, _SHAPE.size + 8 * (n * d + m))
        return numbers[: n * d].reshape(n, d), edges.reshape(m, 2), numbers[n * d :]

    def save_arrays(self, key: str, points: FloatArray, edges: EdgeArray, lengths: FloatArray) -> None:
        """Store a roadmap under a key; a failure to do so is no error."""
        shape = _SHAPE.pack(*points.shape, len(edges))
        parts = points.astype("<f8").tobytes(), lengths.astype("<f8").tobytes(), edges.astype("<i4").tobytes()
        body = b"".join((shape, *parts))
        self._store(key, _ROADMAP, len(body), body, (0.0, 0.0))


def _checksum(body: bytes | memoryview, error: tuple[float, float]) -> int:
    return zlib.crc32(struct.pack("<dd", *error), zlib.crc32(body))
