"""What guiding spaces prepare once for a workspace, kept on disk if that was asked for."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Iterator, Mapping
from contextvars import ContextVar
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.storage.cache_folder import CacheFolder
from guided_gym.storage.record_file import Record, packed, unpacked

Arrays = Mapping[str, NDArray[Any]]


class PreparationStore(CacheFolder):
    """A cache folder of named arrays, one file each, which are read as they were written or not at all."""

    name = "preparations"
    suffix = ".prepared"

    def load(self, key: str) -> Arrays | None:
        """The arrays stored under a key (64 hex digits); or None."""
        content = self.read(key)
        if content is None:
            return None
        try:
            record = unpacked(content)
        except ValueError:
            return None
        return record.arrays if record.meta == {"key": key} else None

    def save(self, key: str, arrays: Arrays) -> None:
        """Store arrays under a key; a failure to do so is no error."""
        self.write(key, packed(0, Record({"key": key}, arrays)))


_NOWHERE: Final = PreparationStore(None)
_store: ContextVar[PreparationStore] = ContextVar("preparations", default=_NOWHERE)


@contextlib.contextmanager
def keeping(store: PreparationStore | None = None) -> Iterator[None]:
    """Within this context, look for preparations on disk, and keep them there.

    Not by default: who searches thousands of drawn problems would fill the disk with what is never asked for
    again.

    Args:
        store: Where; the user's cache folder by default.
    """
    token = _store.set(PreparationStore.default() if store is None else store)
    try:
        yield
    finally:
        _store.reset(token)


def is_keeping() -> bool:
    """Whether preparations are kept on disk now; see `keeping`."""
    return _store.get().folder is not None


def prepared(what: str, of: object, build: Callable[[], Arrays], sound: Callable[[Arrays], bool]) -> Arrays:
    """The arrays that ``build`` makes, from the disk where they are kept; see `keeping`.

    Args:
        what: What they are, and the version of what makes them: raise it with any change that alters them.
        of: All that decides them, as text.
        build: Makes them.
        sound: Whether arrays can be such: of the right names, types and shapes, indices in range.
    """
    store = _store.get()
    if not is_keeping():
        return build()
    key = hashlib.sha256(f"{what} {of}\n".encode()).hexdigest()
    arrays = store.load(key)
    if arrays is None or not _usable(arrays, sound):
        arrays = build()
        store.save(key, arrays)
    return arrays


def _usable(arrays: Arrays, sound: Callable[[Arrays], bool]) -> bool:
    try:
        return sound(arrays)
    except KeyError:  # none of that name
        return False


def fits(array: NDArray[Any], kind: type[np.generic], *shape: int) -> bool:
    """Whether an array is of a type and shape; -1 stands for any length."""
    return (
        array.dtype == kind
        and array.ndim == len(shape)
        and all(want in (-1, got) for want, got in zip(shape, array.shape, strict=True))
    )


def within(array: NDArray[Any], end: int) -> bool:
    """Whether all entries of an array are indices below ``end``."""
    return not array.size or (int(array.min()) >= 0 and int(array.max()) < end)
