"""A folder of files that may be lost: safe to delete at any time and to share between processes."""

from __future__ import annotations

import contextlib
import os
import tempfile
import threading
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
import platformdirs
from numpy.typing import NDArray

from guided_gym.compute.workers import before_workers, in_worker
from guided_gym.errors import warn

ENVIRONMENT_VARIABLE = "GUIDED_GYM_CACHE"
"""Names the cache folder; what says no, such as "off" or "0", works without one."""
_NO = ("off", "0", "no", "none", "false")
MAX_BYTES = 512 * 2**20
"""Size above which the files used longest ago are removed."""


class CacheFolder:
    """A folder of files, each named by a key that hashes everything that decides its content.

    Files are written aside and renamed, so a reader or a rival writer sees a whole file or none. Whether what
    a file holds is sound is for subclasses to say: what is truncated, altered or foreign counts as absent and
    is overwritten. If the folder cannot be used, everything works without it, with one warning per process.

    Attributes:
        folder: Where the files lie, or None to keep nothing.
    """

    name: ClassVar[str]  # of the folder, in the user's cache
    suffix: ClassVar[str]  # of its files

    def __init__(self, folder: Path | None, max_bytes: int = MAX_BYTES) -> None:
        self.folder = folder
        self._max_bytes = max_bytes

    @classmethod
    def default(cls) -> Self:
        """The user's cache folder, or what the environment variable GUIDED_GYM_CACHE says."""
        root = cache_root()
        return cls(None if root is None else root / cls.name)

    def trouble(self) -> OSError | None:
        """Why nothing can be kept, found by trying; None if it can be, or if it is not meant to be."""
        if self.folder is None:
            return None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.folder):
                return None
        except OSError as error:
            return error

    def read(self, key: str, size: int | None = None) -> NDArray[np.uint8] | None:
        """The bytes stored under a key (64 hex digits), writable; or None.

        Args:
            key: The key.
            size: How many there have to be; None for any number up to the size of the whole folder.
        """
        if self.folder is None:
            return None
        path = self._path(key)
        try:
            with path.open("rb", buffering=0) as file:
                found = os.fstat(file.fileno()).st_size
                if found != size if size is not None else found > self._max_bytes:
                    return None
                content = np.empty(found, np.uint8)
                if file.readinto(content.data) != found:
                    return None
        except FileNotFoundError:
            return None
        except OSError as error:
            _warn_once(self.folder, error)
            return None
        with contextlib.suppress(OSError):
            os.utime(path)  # used now
        return content

    def write(self, key: str, *parts: bytes) -> None:
        """Store bytes under a key; a failure to do so is no error."""
        if self.folder is None:
            return
        temporary = None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            handle, temporary = tempfile.mkstemp(dir=self.folder, prefix=key[:16], suffix=".part")
            with os.fdopen(handle, "wb") as file:
                for part in parts:
                    file.write(part)
            os.replace(temporary, self._path(key))
        except OSError as error:
            if temporary is not None:
                with contextlib.suppress(OSError):
                    os.unlink(temporary)
            _warn_once(self.folder, error)
            return
        self._trim()

    def _path(self, key: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{key}{self.suffix}"

    def _trim(self) -> None:
        """Remove the files used longest ago, down to nine tenths of the limit; rivals may be faster."""
        assert self.folder is not None
        entries = []
        with contextlib.suppress(OSError):
            for entry in os.scandir(self.folder):
                if entry.name.endswith((self.suffix, ".part")):
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


def cache_root() -> Path | None:
    """The user's cache folder, or what GUIDED_GYM_CACHE says; None for "off" and the like."""
    named = os.environ.get(ENVIRONMENT_VARIABLE, "")
    if named.strip().lower() in _NO:
        return None
    return Path(named).expanduser() if named else Path(platformdirs.user_cache_dir("guided-gym"))


_warned = threading.Event()


def _warn_once(folder: Path, error: OSError) -> None:
    if not (_warned.is_set() or in_worker()):
        _warned.set()
        warn(
            f"the cache folder {folder} cannot be used ({error}); working without it. "
            f"Set {ENVIRONMENT_VARIABLE} to another folder, or to 'off'."
        )


class _AnyFolder(CacheFolder):
    name = ""
    suffix = ""


@before_workers
def warn_before_workers() -> None:
    """Warn here if nothing can be kept, since each worker would find out by itself."""
    root = cache_root()
    if root is not None and (error := _AnyFolder(root).trouble()) is not None:
        _warn_once(root, error)
