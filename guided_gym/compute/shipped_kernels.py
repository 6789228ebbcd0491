"""Kernels that a wheel brings compiled, so that nobody waits for them on a machine of its kind.

A plain archive beside the kernels' sources, as `make wheel` puts it there; a checkout has none. Machine code
for the oldest processor of an architecture runs on all later ones, and gives the same bits: numba neither
contracts nor reorders arithmetic unless it is told to. What numba pickles is of one version of everything,
so an archive from other versions, another system or other sources is not looked at, and all compiles as ever.

    python -m guided_gym.compute.shipped_kernels NUMBA_CACHE ARCHIVE
"""

from __future__ import annotations

import hashlib
import json
import pickle
import platform
import struct
import sys
import zipfile
import zlib
from functools import cache
from pathlib import Path
from typing import Any, Final

import llvmlite
import numba

from guided_gym.errors import StorageError

KERNELS: Final = Path(__file__).parents[1] / "kernels"
ARCHIVE: Final = "compiled.zip"
_STAMP: Final = "made-with.json"
_DAMAGED: Final = (  # what reading an archive raises if a byte of it is another, in its lists or in an entry
    OSError,
    KeyError,
    EOFError,
    ValueError,
    RuntimeError,
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
    pickle.UnpicklingError,
)


def sources_stamp(folder: Path) -> str:
    """A digest of all sources in a folder.

    numba keeps a kernel until its own file changes; what it calls is compiled into it, from other files, too.
    """
    digest = hashlib.sha256()
    for path in sorted(folder.glob("*.py")):
        digest.update(path.name.encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def made_with() -> dict[str, str]:
    """All that an archive has to agree with."""
    return {
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
        "python": f"{sys.implementation.cache_tag}",
        "system": sys.platform,
        "machine": platform.machine(),
        "kernels": sources_stamp(KERNELS),
    }


class ShippedKernels:
    """What an archive holds; nothing where there is none, or one that does not fit.

    Args:
        path: The archive.
    """

    def __init__(self, path: Path) -> None:
        self._archive: zipfile.ZipFile | None = None
        try:
            archive = zipfile.ZipFile(path)
            if json.loads(archive.read(_STAMP)) == made_with():
                self._archive = archive
        except _DAMAGED:
            pass  # no archive, or a damaged one: kernels compile

    def load(self, name: str, key: tuple[Any, ...]) -> Any:
        """What numba keeps of a kernel, None where the archive has not got it.

        Args:
            name: Under which numba keeps it, with its line.
            key: Its signature, what it is compiled for, digests of its code.
        """
        if self._archive is None:
            return None
        try:
            return pickle.loads(self._archive.read(_entry(name, key)))
        except _DAMAGED:
            return None


@cache
def shipped_kernels() -> ShippedKernels:
    """Those of this installation."""
    return ShippedKernels(KERNELS / ARCHIVE)


def pack_kernels(folder: Path, archive: Path) -> int:
    """Put all kernels of one of numba's caches into an archive; returns how many there are.

    Args:
        folder: The cache, written by these versions with NUMBA_CPU_NAME=generic and no NUMBA_CPU_FEATURES.
        archive: The file to write.

    Raises:
        StorageError: The cache holds no kernel, or one for the processor of this machine alone.
    """
    entries: dict[str, Path] = {}
    for index in sorted(folder.rglob("*.nbi")):
        with index.open("rb") as file:
            pickle.load(file)  # numba's version
            _, overloads = pickle.loads(file.read())
        for key, data in overloads.items():
            if key[1][1:] != ("generic", ""):
                raise StorageError(
                    f"{index}: expected kernels compiled for any processor (NUMBA_CPU_NAME=generic, "
                    f"NUMBA_CPU_FEATURES=), got some for {key[1][1]}"
                )
            entries[_entry(index.stem, key)] = index.parent / data
    if not entries:
        raise StorageError(f"{folder}: expected a cache of compiled kernels, found none")
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as out:
        out.writestr(_STAMP, json.dumps(made_with()))
        for name, path in sorted(entries.items()):
            out.write(path, name)
    return len(entries)


def _entry(name: str, key: tuple[Any, ...]) -> str:
    """The name of a kernel in an archive: all but the processor, and the stamp that the archive has once."""
    return hashlib.sha256(f"{name} {key[0]} {key[2]}".encode()).hexdigest()


if __name__ == "__main__":
    print(pack_kernels(Path(sys.argv[1]), Path(sys.argv[2])), "kernels")
