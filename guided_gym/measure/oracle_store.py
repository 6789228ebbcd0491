"""Solved oracle fields on disk: safe to delete at any time and to share between processes."""

from __future__ import annotations

import contextlib
import math
import os
import struct
import tempfile
import threading
import zlib
from pathlib import Path

import numpy as np
import numpy.typing as npt
import platformdirs

from guided_gym.compute.workers import before_workers, in_worker
from guided_gym.errors import warn

FieldArray = npt.NDArray[np.float32]
LinkArray = npt.NDArray[np.uint8]
FloatArray = npt.NDArray[np.float64]
EdgeArray = npt.NDArray[np.int32]

ENVIRONMENT_VARIABLE = "GUIDED_GYM_CACHE"
"""Names the cache folder; what says no, such as "off" or "0", works without one."""
_NO = ("off", "0", "no", "none", "false")
MAX_BYTES = 512 * 2**20
"""Size above which the files used longest ago are removed."""

# magic, key, vertices, checksum, error (mean, tail); 128 bytes keep the arrays aligned
_HEADER = struct.Struct("<16s64sQI4xdd16x")
_MAGIC = b"guided-gym field"
_ROADMAP = b"guided-gym roads"
_SHAPE = struct.Struct("<QQQ")  # vertices, dimensions, edges
_SUFFIX = ".field"


class FieldStore:
    """A folder of fields, one file each, named by a key that hashes everything that decides the content.

    Files are written aside and renamed, so a reader or a rival writer sees a whole file or none. A file that
    is truncated, altered or foreign counts as absent and is overwritten. If the folder cannot be used,
    everything works without it, with one warning per process.

    Attributes:
        folder: Where the files lie, or None to keep nothing.
    """

    def __init__(self, folder: Path | None, max_bytes: int = MAX_BYTES) -> None:
        self.folder = folder
        self._max_bytes = max_bytes

    @classmethod
    def default(cls) -> FieldStore:
        """The user's cache folder, or what the environment variable GUIDED_GYM_CACHE says."""
        named = os.environ.get(ENVIRONMENT_VARIABLE, "")
        if named.strip().lower() in _NO:
            return cls(None)
        folder = Path(named).expanduser() if named else Path(platformdirs.user_cache_dir("guided-gym"))
        return cls(folder / "oracle")

    def trouble(self) -> OSError | None:
        """Why nothing can be kept, found out by trying; None where it can be, or is not meant to be."""
        if self.folder is None:
            return None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.folder):
                return None
        except OSError as error:
            return error

    def load(self, key: str, size: int) -> tuple[FieldArray, LinkArray, tuple[float, float]] | None:
        """The field and links (size,) stored under a key (64 hex digits), and their error; or None."""
        if self.folder is None:
            return None
        path = self._path(key)
        content = np.empty(_HEADER.size + 5 * size, dtype=np.uint8)
        try:
            with path.open("rb", buffering=0) as file:
                if (
                    os.fstat(file.fileno()).st_size != content.size
                    or file.readinto(content.data) != content.size
                ):
                    return None
        except FileNotFoundError:
            return None
        except OSError as error:
            _warn_once(self.folder, error)
            return None
        body = content[_HEADER.size :]
        *head, checksum, mean, tail = _HEADER.unpack(content[: _HEADER.size].tobytes())
        if head != [_MAGIC, key.encode(), size] or checksum != _checksum(body.data, (mean, tail)):
            return None
        with contextlib.suppress(OSError):
            os.utime(path)
        return body[: 4 * size].view(np.float32), body[4 * size :], (mean, tail)

    def save(
        self, key: str, field: FieldArray, links: LinkArray, error: tuple[float, float] = (math.nan, math.nan)
    ) -> None:
        """Store a field, its links and its error (mean, tail) under a key; failing to is no error."""
        body = field.astype("<f4").tobytes() + links.tobytes()
        self._write(key, _MAGIC, field.size, body, error)

    def _write(self, key: str, magic: bytes, size: int, body: bytes, error: tuple[float, float]) -> None:
        if self.folder is None:
            return
        header = _HEADER.pack(magic, key.encode(), size, _checksum(body, error), *error)
        temporary = None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            handle, temporary = tempfile.mkstemp(dir=self.folder, prefix=key[:16], suffix=".part")
            with os.fdopen(handle, "wb") as file:
                file.write(header)
                file.write(body)
            os.replace(temporary, self._path(key))
        except OSError as error:
            if temporary is not None:
                with contextlib.suppress(OSError):
                    os.unlink(temporary)
            _warn_once(self.folder, error)
            return
        self._trim()

    def load_arrays(self, key: str) -> tuple[FloatArray, EdgeArray, FloatArray] | None:
        """Vertices (n, d), edges (m, 2) and lengths (m,) of the roadmap stored under a key; or None."""
        if self.folder is None:
            return None
        try:
            content = self._path(key).read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            _warn_once(self.folder, error)
            return None
        if len(content) < _HEADER.size + _SHAPE.size:
            return None
        body = memoryview(bytearray(content[_HEADER.size :]))  # writable: kernels compile once
        *head, checksum, mean, tail = _HEADER.unpack(content[: _HEADER.size])
        if head != [_ROADMAP, key.encode(), len(body)] or checksum != _checksum(body, (mean, tail)):
            return None
        n, d, m = _SHAPE.unpack(body[: _SHAPE.size])
        if len(body) != _SHAPE.size + 8 * (n * d + 2 * m):
            return None
        numbers = np.frombuffer(body, np.float64, n * d + m, _SHAPE.size)
        edges = np.frombuffer(body, np.int32, 2 * m, _SHAPE.size + 8 * (n * d + m))
        with contextlib.suppress(OSError):
            os.utime(self._path(key))
        return numbers[: n * d].reshape(n, d), edges.reshape(m, 2), numbers[n * d :]

    def save_arrays(self, key: str, points: FloatArray, edges: EdgeArray, lengths: FloatArray) -> None:
        """Store a roadmap under a key; failing to is no error."""
        shape = _SHAPE.pack(*points.shape, len(edges))
        parts = points.astype("<f8").tobytes(), lengths.astype("<f8").tobytes(), edges.astype("<i4").tobytes()
        body = b"".join((shape, *parts))
        self._write(key, _ROADMAP, len(body), body, (0.0, 0.0))

    def _path(self, key: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{key}{_SUFFIX}"

    def _trim(self) -> None:
        """Remove the files used longest ago, down to nine tenths of the limit; rivals may be faster."""
        assert self.folder is not None
        entries = []
        with contextlib.suppress(OSError):
            for entry in os.scandir(self.folder):
                if entry.name.endswith((_SUFFIX, ".part")):
                    with contextlib.suppress(OSError):
                        status = entry.stat()
                        entries.append((status.st_mtime, status.st_size, entry.path))
        total = sum(size for _, size, _ in entries)
        if total <= self._max_bytes:
            return
        for _, size, path in sorted(entries):
            with contextlib.suppress(OSError):
                os.unlink(path)
            total -= size
            if total <= 0.9 * self._max_bytes:
                return


def _checksum(body: bytes | memoryview, error: tuple[float, float]) -> int:
    return zlib.crc32(struct.pack("<dd", *error), zlib.crc32(body))


_warned = threading.Event()


def _warn_once(folder: Path, error: OSError) -> None:
    if not (_warned.is_set() or in_worker()):
        _warned.set()
        warn(
            f"the cache folder {folder} cannot be used ({error}); working without it. "
            f"Set {ENVIRONMENT_VARIABLE} to another folder, or to 'off'."
        )


@before_workers
def warn_before_workers() -> None:
    """Warn here if nothing can be kept: the workers would each find out."""
    store = FieldStore.default()
    if store.folder is not None and (error := store.trouble()) is not None:
        _warn_once(store.folder, error)
