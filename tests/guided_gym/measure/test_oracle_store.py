from __future__ import annotations

import os
import shutil
import subprocess
import sys
import warnings

import numpy as np
import pytest

from guided_gym.errors import GuidedGymWarning
from guided_gym.measure.oracle_store import FieldStore
from guided_gym.storage import cache_folder

KEY, OTHER = "a" * 64, "b" * 64
FIELD = np.linspace(0, 1, 1000, dtype=np.float32)
LINKS = np.arange(1000, dtype=np.uint8)


@pytest.fixture
def store(tmp_path):
    return FieldStore(tmp_path / "fields")


@pytest.fixture(autouse=True)
def may_warn_again():
    cache_folder._warned.clear()


def assert_stored(store, key=KEY):
    field, links, _ = store.load(key, 1000)
    np.testing.assert_array_equal(field, FIELD)
    np.testing.assert_array_equal(links, LINKS)
    assert field.flags.carray
    assert links.flags.carray


def test_what_was_saved_is_loaded(store):
    assert store.load(KEY, 1000) is None
    store.save(KEY, FIELD, LINKS)
    assert_stored(store)


def damage(path, how):
    content = bytearray(path.read_bytes())
    if how == "truncated":
        content = content[:-7]
    elif how == "longer":
        content += b"x"
    elif how == "empty":
        content = bytearray()
    elif how == "flipped bit":
        content[700] ^= 1
    elif how == "foreign":
        content[:] = os.urandom(len(content))
    path.write_bytes(content)


@pytest.mark.parametrize("how", ["truncated", "longer", "empty", "flipped bit", "foreign"])
def test_a_damaged_file_counts_as_absent_and_is_overwritten(store, how):
    store.save(KEY, FIELD, LINKS)
    damage(store._path(KEY), how)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert store.load(KEY, 1000) is None
        store.save(KEY, FIELD, LINKS)
    assert_stored(store)


def test_a_file_under_the_wrong_key_or_of_another_size_counts_as_absent(store):
    store.save(KEY, FIELD, LINKS)
    shutil.copy(store._path(KEY), store._path(OTHER))
    assert store.load(OTHER, 1000) is None
    assert store.load(KEY, 999) is None


def test_the_folder_may_be_deleted_at_any_time(store):
    store.save(KEY, FIELD, LINKS)
    shutil.rmtree(store.folder)
    assert store.load(KEY, 1000) is None
    store.save(KEY, FIELD, LINKS)
    assert_stored(store)


def test_an_unusable_folder_costs_one_warning(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    store = FieldStore(tmp_path / "file" / "fields")
    with pytest.warns(RuntimeWarning, match="GUIDED_GYM_CACHE") as caught:
        for _ in range(3):
            store.save(KEY, FIELD, LINKS)
            assert store.load(KEY, 1000) is None
    assert len(caught) == 1


def test_an_unusable_folder__is_found_out_by_trying(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("not a folder")
    assert FieldStore(tmp_path / "new" / "fields").trouble() is None
    assert FieldStore(None).trouble() is None
    assert FieldStore(tmp_path / "file" / "fields").trouble() is not None
    monkeypatch.setenv("GUIDED_GYM_CACHE", str(tmp_path / "file"))
    with pytest.warns(GuidedGymWarning) as caught:
        for _ in range(2):
            cache_folder.warn_before_workers()
    assert len(caught) == 1


def test_workers_do_not_warn_again(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    code = (
        "from guided_gym.compute.workers import map_tasks\n"
        "from guided_gym.measure.oracle_store import FieldStore\n"
        "import numpy as np\n"
        "from functools import partial\n"
        "if __name__ == '__main__':\n"
        "    save = FieldStore.default().save\n"
        "    save = partial(save, field=np.zeros(8, np.float32), links=np.zeros(8, np.uint8))\n"
        "    list(map_tasks(save, ['a' * 64, 'b' * 64, 'c' * 64], 2))\n"
    )
    (tmp_path / "program.py").write_text(code)
    environment = {**os.environ, "GUIDED_GYM_CACHE": str(tmp_path / "file")}
    program = [sys.executable, str(tmp_path / "program.py")]
    run = subprocess.run(program, env=environment, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    assert run.stderr.count("GUIDED_GYM_CACHE") == 1
    assert run.stderr.count("\n") == 1  # no line of the source


@pytest.mark.parametrize("value", ["OFF", "0", "no", " False "])
def test_off_keeps_nothing(value, monkeypatch):
    monkeypatch.setenv("GUIDED_GYM_CACHE", value)
    store = FieldStore.default()
    assert store.folder is None
    store.save(KEY, FIELD, LINKS)
    assert store.load(KEY, 1000) is None


def test_the_variable_names_the_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("GUIDED_GYM_CACHE", str(tmp_path / "mine"))
    FieldStore.default().save(KEY, FIELD, LINKS)
    assert list((tmp_path / "mine").rglob(f"{KEY}*"))


def test_the_files_used_longest_ago_go_first(tmp_path):
    store = FieldStore(tmp_path, max_bytes=6 * 5200)
    keys = [c * 64 for c in "abcdef"]
    for age, key in enumerate(keys):
        store.save(key, FIELD, LINKS)
        os.utime(store._path(key), (1e9 + age, 1e9 + age))
    assert store.load(keys[0], 1000) is not None  # used now, so the second is the oldest
    store.save("9" * 64, FIELD, LINKS)
    kept = {path.stem for path in tmp_path.iterdir()}
    assert keys[1] not in kept
    assert {keys[0], keys[5], "9" * 64} <= kept


# A program of its own: a spawned worker could not import a test module from another folder.
WRITER = """
import sys
from pathlib import Path
import numpy as np
from guided_gym.measure.oracle_store import FieldStore
store, wrong = FieldStore(Path(sys.argv[1])), 0
field, links = np.linspace(0, 1, 1000, dtype=np.float32), np.arange(1000, dtype=np.uint8)
for _ in range(150):
    store.save("a" * 64, field, links)
    loaded = store.load("a" * 64, 1000)
    wrong += loaded is None or not np.array_equal(loaded[0], field)
sys.exit(wrong)
"""


def test_two_processes_writing_one_key_never_see_half_a_file(tmp_path):
    writers = [subprocess.Popen([sys.executable, "-c", WRITER, str(tmp_path)]) for _ in range(2)]
    assert [writer.wait(timeout=120) for writer in writers] == [0, 0]
    assert [path.name for path in tmp_path.iterdir()] == [f"{KEY}.field"]
