"""Numbered records of arrays in one file: memory-mapped by any number of readers, whole after any kill.

A file is a header block, records one behind the other, and an index at the end once it is finished. Writers
only add behind the last whole record; a record that was cut off fails its checksum, and is cut off the file
when the next writer opens it. Nothing in such a file is ever run as code.
"""

from __future__ import annotations

import contextlib
import json
import mmap
import os
import struct
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from guided_gym.errors import StorageError

try:
    import fcntl as _fcntl
except ImportError:  # not on Windows: there, two writers of one file are not kept apart
    _fcntl = None  # type: ignore[assignment]

locks: ModuleType | None = _fcntl
FORMAT: Final = 1
Arrays = Mapping[str, NDArray[Any]]

_ALIGNED: Final = 64
_BLOCK: Final = 16_384  # bytes of the header
_MAGIC: Final = b"guided-gym records\n\x00\x00\x00\x00\x00"
_HEAD: Final = struct.Struct("<24sIII")  # magic, format, length and checksum of the text
_RECORD: Final = struct.Struct("<8sQQQII24x")  # magic, key, lengths of text and body, checksums
_INDEX: Final = struct.Struct("<8sQQII")  # magic, offset of the index, keys, checksums
_RECORD_MAGIC: Final = b"ggrecord"
_INDEX_MAGIC: Final = b"ggindex\n"
_TYPES: Final = ("<f8", "<f4", "<i8", "<i4", "|u1", "|b1")


class Record(NamedTuple):
    """One record.

    Attributes:
        meta: What it says, as JSON has it.
        arrays: Its arrays. Those of a mapped file may be written to; the file stays what it is.
    """

    meta: dict[str, Any]
    arrays: Arrays


class RecordFile:
    """A finished file, mapped into memory; records are read, and checked, when they are asked for.

    Args:
        path: The file.
        what: What messages call such a file.

    Attributes:
        header: What the file says of all records.
        keys: (n,) their numbers, ascending.

    Raises:
        StorageError: No such file, a foreign or damaged one, one of another version, or one that is not
            finished.
    """

    def __init__(self, path: Path, what: str) -> None:
        self.path, self._what = path, what
        with _opened(path, what, "rb") as file:
            self.header = _read_header(file, path, what)
            self.keys, self._offsets = _read_index(file, path, what)
            self._map = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_COPY)
        self._checked = np.zeros(len(self.keys), np.bool_)

    def __len__(self) -> int:
        return len(self.keys)

    def record(self, number: int) -> Record:
        """The record at that place in `keys`.

        Raises:
            StorageError: It is damaged.
        """
        offset, checked = int(self._offsets[number]), bool(self._checked[number])
        try:
            record = unpacked(self._map, offset, checked=checked)
        except ValueError as error:
            raise StorageError(
                f"{self.path}: record {int(self.keys[number])} of this {self._what} is damaged ({error}); "
                "build it again: what is whole is kept"
            ) from error
        self._checked[number] = True
        return record


class RecordWriter:
    """Adds records to a file, which it makes if there is none; a context.

    Args:
        path: The file.
        what: What messages call such a file.
        header: What it says of all records, if it is made.

    Attributes:
        header: What the file says.
        keys: Numbers of the records that are whole.

    Raises:
        StorageError: The file is foreign, of another version, cannot be written, or has another writer.
    """

    def __init__(self, path: Path, what: str, header: Mapping[str, Any]) -> None:
        self.path, self._what = path, what
        self._end = _BLOCK  # of the last record that is whole
        if not path.exists():
            _make(path, what, header)
        self._file = _opened(path, what, "r+b")
        try:
            self._lock()
            self.header = _read_header(self._file, path, what)
            self._offsets = self._scan()
        except BaseException:
            self._file.close()
            raise

    @property
    def keys(self) -> set[int]:
        """Numbers of the records that are whole."""
        return set(self._offsets)

    def describe(self, header: Mapping[str, Any]) -> None:
        """Change what the file says about all records. It counts as unfinished until `finish`."""
        with _writing(self.path, self._what):
            self._cut()
            self._file.seek(0)
            self._file.write(_header_block(header))
            self._file.flush()
        self.header = dict(header)

    def add(self, key: int, record: Record) -> None:
        """Write a record, whole or not at all."""
        if key in self._offsets:
            return
        with _writing(self.path, self._what):
            self._cut()
            self._file.seek(self._end)
            self._file.write(packed(key, record))
            self._file.flush()
        self._offsets[key] = self._end
        self._end = self._file.tell()

    def finish(self) -> None:
        """Write the index: now the file can be read."""
        keys = np.array(sorted(self._offsets), "<u8")
        offsets = np.array([self._offsets[int(key)] for key in keys], "<u8")
        body = keys.tobytes() + offsets.tobytes()
        with _writing(self.path, self._what):
            self._cut()
            self._file.seek(self._end)
            self._file.write(body + _index_footer(self._end, len(keys), zlib.crc32(body)))
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file; may be called again."""
        self._file.close()

    def __enter__(self) -> RecordWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _lock(self) -> None:
        if locks is not None:
            try:
                locks.flock(self._file.fileno(), locks.LOCK_EX | locks.LOCK_NB)
            except OSError as error:
                raise StorageError(
                    f"{self.path}: expected nobody else to be writing this {self._what}, but another process "
                    "is: wait for it, or stop it"
                ) from error

    def _scan(self) -> dict[int, int]:
        """Offsets of the whole records by key; what is behind the last one that can be passed is no file."""
        found: dict[int, int] = {}
        size, offset = os.fstat(self._file.fileno()).st_size, _BLOCK
        while offset + _RECORD.size <= size:
            self._file.seek(offset)
            try:
                head = _record_head(self._file.read(_RECORD.size), offset, size)
            except (ValueError, struct.error):
                break
            if zlib.crc32(self._file.read(head.length)) == head.checksum:
                found[head.key] = offset
            offset += _RECORD.size + head.length
        self._end = offset
        return found

    def _cut(self) -> None:
        """Take away the index, or what a kill has left."""
        if os.fstat(self._file.fileno()).st_size > self._end:
            self._file.truncate(self._end)


class _Head(NamedTuple):
    """The first bytes of a record."""

    key: int
    text: int
    body: int
    checksum: int

    @property
    def length(self) -> int:
        """Number of bytes that follow."""
        return _padded(self.text) + self.body


def _padded(length: int) -> int:
    return -(-length // _ALIGNED) * _ALIGNED


def packed(key: int, record: Record) -> bytes:
    """The bytes of a record, as they lie in a file.

    Raises:
        StorageError: An array of a type that records do not have.
    """
    rows, blocks, offset = [], [], 0
    for name, values in record.arrays.items():
        array = np.ascontiguousarray(values)
        kind = array.dtype.newbyteorder("<").str
        if kind not in _TYPES:
            raise StorageError(f"array {name}: expected one of {', '.join(_TYPES)}, got {array.dtype}")
        data = array.astype(kind, copy=False).tobytes()
        rows.append([name, kind, list(array.shape), offset])
        blocks.append(data.ljust(_padded(len(data)), b"\0"))
        offset += len(blocks[-1])
    text = json.dumps({"meta": record.meta, "arrays": rows}, ensure_ascii=False).encode()
    content = text.ljust(_padded(len(text)), b"\0") + b"".join(blocks)
    fields = _RECORD_MAGIC, key, len(text), offset, zlib.crc32(content)
    return _RECORD.pack(*fields, zlib.crc32(struct.pack("<8sQQQI", *fields))) + content


def unpacked(content: Any, offset: int = 0, *, checked: bool = False) -> Record:
    """The record that begins at a place of a buffer; its arrays share the buffer's memory.

    Args:
        content: The buffer.
        offset: The place.
        checked: Whether the checksum is known to be right.

    Raises:
        ValueError: It is damaged.
    """
    try:
        head = _record_head(bytes(content[offset : offset + _RECORD.size]), offset, len(content))
        if not checked and not _sound(content, offset, head):
            raise ValueError("its checksum is wrong")
        text = offset + _RECORD.size
        meta = json.loads(bytes(content[text : text + head.text]))
        arrays = _arrays(content, text + _padded(head.text), head.body, meta["arrays"])
        return Record(meta["meta"], arrays)
    except (KeyError, TypeError, struct.error) as error:
        raise ValueError(str(error)) from error


def _record_head(data: bytes, offset: int, size: int) -> _Head:
    magic, key, text, body, checksum, own = _RECORD.unpack(data)
    if magic != _RECORD_MAGIC or own != zlib.crc32(struct.pack("<8sQQQI", magic, key, text, body, checksum)):
        raise ValueError("it does not begin as a record does")
    head = _Head(key, text, body, checksum)
    if offset + _RECORD.size + head.length > size:
        raise ValueError("it is cut off")
    return head


def _sound(content: Any, offset: int, head: _Head) -> bool:
    first = offset + _RECORD.size
    with memoryview(content) as view, view[first : first + head.length] as body:
        return zlib.crc32(body) == head.checksum


def _arrays(content: Any, first: int, length: int, rows: Any) -> dict[str, NDArray[Any]]:
    arrays = {}
    for name, kind, shape, offset in rows:
        if kind not in _TYPES or min([0, *shape]) < 0:
            raise ValueError(f"array {name!r} is of no known type")
        count = int(np.prod(shape, dtype=np.int64))
        if not 0 <= offset <= length - count * np.dtype(kind).itemsize:
            raise ValueError(f"array {name!r} does not fit")
        flat = np.frombuffer(content, np.dtype(kind), count, first + offset)
        arrays[str(name)] = flat.reshape(shape)
    return arrays


def _header_block(header: Mapping[str, Any]) -> bytes:
    text = json.dumps(header, ensure_ascii=False).encode()
    if len(text) > _BLOCK - _HEAD.size:
        raise StorageError(f"expected at most {_BLOCK - _HEAD.size} bytes of header, got {len(text)}")
    return (_HEAD.pack(_MAGIC, FORMAT, len(text), zlib.crc32(text)) + text).ljust(_BLOCK, b"\0")


def _read_header(file: Any, path: Path, what: str) -> dict[str, Any]:
    file.seek(0)
    block = file.read(_BLOCK)
    if block[: len(_MAGIC)] != _MAGIC:
        raise StorageError(f"{path}: expected a {what}, got a file of another kind")
    _, version, length, checksum = _HEAD.unpack(block[: _HEAD.size])
    if version != FORMAT:
        raise StorageError(
            f"{path}: expected a {what} of format {FORMAT}, got one of format {version}, from another "
            "version of guided-gym: build it again"
        )
    text = block[_HEAD.size : _HEAD.size + length]
    if len(block) < _BLOCK or zlib.crc32(text) != checksum:
        raise StorageError(f"{path}: the header of this {what} is damaged; build it again")
    header: dict[str, Any] = json.loads(text)
    return header


def _index_footer(offset: int, count: int, checksum: int) -> bytes:
    fields = _INDEX_MAGIC, offset, count, checksum
    return _INDEX.pack(*fields, zlib.crc32(struct.pack("<8sQQI", *fields)))


def _read_index(file: Any, path: Path, what: str) -> tuple[NDArray[np.uint64], NDArray[np.uint64]]:
    size = os.fstat(file.fileno()).st_size
    file.seek(max(size - _INDEX.size, 0))
    footer = file.read(_INDEX.size)
    if len(footer) == _INDEX.size:
        _, offset, count, checksum, _ = _INDEX.unpack(footer)
        if footer == _index_footer(offset, count, checksum) and offset + 16 * count + _INDEX.size == size:
            file.seek(offset)
            body = file.read(16 * count)
            if zlib.crc32(body) == checksum:
                keys, offsets = np.frombuffer(body, "<u8").reshape(2, count)
                return keys.astype(np.uint64), offsets.astype(np.uint64)
    raise StorageError(
        f"{path}: expected a finished {what}, got one that was stopped, or truncated; build it again: what "
        "is whole is kept"
    )


def _make(path: Path, what: str, header: Mapping[str, Any]) -> None:
    """A file without records; it appears whole, and never in the place of another."""
    block = _header_block(header)
    with _writing(path, what):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(block)
            os.chmod(name, 0o644)
            with contextlib.suppress(FileExistsError):  # somebody was faster
                os.link(name, path)
        finally:
            os.unlink(name)


def _opened(path: Path, what: str, mode: str) -> Any:
    if not path.is_file():
        raise StorageError(f"{path}: expected a {what}, but there is no such file")
    try:
        return path.open(mode, buffering=0) if mode == "rb" else path.open(mode)
    except OSError as error:
        raise StorageError(f"cannot open {path}: {error}") from error


@contextlib.contextmanager
def _writing(path: Path, what: str) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise StorageError(f"cannot write the {what} {path}: {error}") from error
