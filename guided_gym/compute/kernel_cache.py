"""Where numba keeps what it has compiled; a folder for this run alone if it can write to none."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile

import numba

from guided_gym.errors import StorageError, warn

VARIABLE = "NUMBA_CACHE_DIR"


def ensure_kernel_cache() -> None:
    """Make sure that the kernels can be compiled: numba refuses to if it finds no folder for its cache.

    That is so where the package was installed read-only and the user has no home to write to. A temporary
    folder serves then, private to this process and those that it starts, and gone when it ends.

    Raises:
        StorageError: There is no temporary folder either.
    """
    try:
        numba.njit(cache=True)(_probe)  # the same look for a folder that each kernel is about to take
    except RuntimeError:
        folder = _temporary_folder()
        os.environ[VARIABLE] = folder  # numba reads it anew now and then; workers inherit it
        numba.config.CACHE_DIR = folder  # type: ignore[attr-defined]
        warn(
            "compiled kernels cannot be kept: neither the package's folder nor the user's cache folder can "
            f"be written. They are compiled anew in each run; set {VARIABLE} to a folder to keep them."
        )


def _probe() -> None:
    """Stands for any kernel."""


def _temporary_folder() -> str:
    try:
        folder = tempfile.mkdtemp(prefix="guided-gym-kernels-")
    except OSError as error:
        raise StorageError(
            f"expected a writable folder for compiled kernels, found none ({error}); set {VARIABLE} to one"
        ) from error
    atexit.register(_remove, folder, os.getpid())
    return folder


def _remove(folder: str, owner: int) -> None:
    if os.getpid() == owner:  # not from a fork, while its parent lives
        shutil.rmtree(folder, ignore_errors=True)
