"""Record files: what was written comes back, whatever was cut off or altered."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from guided_gym.errors import StorageError
from guided_gym.storage.record_file import Record, RecordFile, RecordWriter

WHAT = "test file"


def a_record(key: int) -> Record:
    arrays = {
        "x": np.arange(key + 1, dtype=np.float64),
        "y": np.full((2, key), key, np.uint8),
        "empty": np.zeros((0, 3), np.float32),
    }
    return Record({"key": key, "name": "Ünïcode"}, arrays)


def written(path: Path, keys: range = range(5)) -> Path:
    with RecordWriter(path, WHAT, {"a": 1}) as writer:
        for key in keys:
            writer.add(key, a_record(key))
        writer.finish()
    return path


def check(path: Path, keys: range = range(5)) -> None:
    file = RecordFile(path, WHAT)
    assert file.header == {"a": 1} and file.keys.tolist() == list(keys)
    for number, key in enumerate(keys):
        meta, arrays = file.record(number)
        expected = a_record(key)
        assert meta == expected.meta and list(arrays) == list(expected.arrays)
        for name, array in expected.arrays.items():
            assert arrays[name].dtype == array.dtype and np.array_equal(arrays[name], array)


def test_record_file__gives_back_what_was_written_and_arrays_that_kernels_take(tmp_path):
    path = written(tmp_path / "deep" / "file")
    check(path)
    content = path.read_bytes()
    array = RecordFile(path, WHAT).record(3).arrays["x"]
    assert array.flags.writeable and array.ctypes.data % 64 == 0
    array[:] = -1  # a page of this process alone
    assert path.read_bytes() == content
    check(path)


def test_record_writer__goes_on_wherever_the_file_was_cut_off(tmp_path):
    content = written(tmp_path / "whole").read_bytes()
    header = 16_384
    for length in (header, header + 1, header + 70, (header + len(content)) // 2, len(content) - 1):
        path = tmp_path / f"cut-{length}"
        path.write_bytes(content[:length])
        with pytest.raises(StorageError, match="finished test file"):
            RecordFile(path, WHAT)
        with RecordWriter(path, WHAT, {"a": 2}) as writer:
            assert writer.header == {"a": 1} and writer.keys == set(range(len(writer.keys)))
        written(path)  # adds those that are missing
        check(path)
        assert path.stat().st_size == len(content)


def test_record_writer__adds_to_a_finished_file_which_counts_as_unfinished_meanwhile(tmp_path):
    path = written(tmp_path / "file")
    with RecordWriter(path, WHAT, {}) as writer:
        writer.add(7, a_record(7))
        with pytest.raises(StorageError, match="finished"):
            RecordFile(path, WHAT)
        writer.finish()
    assert RecordFile(path, WHAT).keys.tolist() == [0, 1, 2, 3, 4, 7]


def test_record_file__an_altered_byte_is_found_and_only_its_record_written_again(tmp_path):
    path = written(tmp_path / "file")
    content = bytearray(path.read_bytes())
    place = content.rindex(np.arange(5, dtype=np.float64).tobytes())
    content[place + 3] ^= 1
    path.write_bytes(content)
    file = RecordFile(path, WHAT)
    file.record(3)
    with pytest.raises(StorageError, match="record 4 of this test file is damaged"):
        file.record(4)
    with RecordWriter(path, WHAT, {}) as writer:
        assert writer.keys == {0, 1, 2, 3}
    check(written(path))


def test_record_file__refuses_what_is_none(tmp_path):
    with pytest.raises(StorageError, match="no such file"):
        RecordFile(tmp_path / "none", WHAT)
    path = tmp_path / "file"
    for content in (b"", b"hello", bytes(20_000)):
        path.write_bytes(content)
        for kind in (lambda: RecordFile(path, WHAT), lambda: RecordWriter(path, WHAT, {})):
            with pytest.raises(StorageError, match="another kind"):
                kind()
        assert path.read_bytes() == content
    content = bytearray(written(tmp_path / "good").read_bytes())
    content[24] += 1
    path.write_bytes(content)
    with pytest.raises(StorageError, match="format 2"):
        RecordFile(path, WHAT)


@pytest.mark.skipif(os.name == "nt", reason="no file locks there")
def test_record_writer__is_the_only_one(tmp_path):
    path = written(tmp_path / "file")
    with RecordWriter(path, WHAT, {}), pytest.raises(StorageError, match="another process"):
        RecordWriter(path, WHAT, {})


@pytest.mark.skipif(os.name == "nt", reason="no such signal there")
def test_record_writer__a_kill_loses_no_whole_record(tmp_path):
    program = (
        "import sys, pathlib, numpy as np\n"
        "from guided_gym.storage.record_file import Record, RecordWriter\n"
        "writer = RecordWriter(pathlib.Path(sys.argv[1]), 'test file', {'a': 1})\n"
        "for key in range(10**9):\n"
        "    writer.add(key, Record({}, {'x': np.full(1000, float(key))}))\n"
        "    print(key, flush=True)\n"
    )
    path = tmp_path / "file"
    process = subprocess.Popen([sys.executable, "-c", program, str(path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    said = -1
    while said < 20:
        said = int(process.stdout.readline())
    process.kill()
    process.communicate()
    with RecordWriter(path, WHAT, {}) as writer:
        assert writer.keys >= set(range(said + 1))
        writer.finish()
    file = RecordFile(path, WHAT)
    for number, key in enumerate(file.keys.tolist()):
        assert (file.record(number).arrays["x"] == key).all()
