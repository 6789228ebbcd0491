"""Kernels that come compiled with a wheel."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import zipfile
from types import SimpleNamespace

import pytest

from guided_gym.compute import shipped_kernels
from guided_gym.compute.shipped_kernels import ShippedKernels, made_with, pack_kernels
from guided_gym.errors import StorageError

PROGRAM = """
import sys
from guided_gym.compute import shipped_kernels
shipped_kernels.ARCHIVE = sys.argv[1]
import numpy as np
from numba.core import event
from guided_gym.kernels.metric import interpolate

class Count(event.Listener):
    compiled = 0
    def on_start(self, event): pass
    def on_end(self, event):  # numba's own functions are kept nowhere
        Count.compiled += event.data["dispatcher"].py_func.__module__.startswith("guided_gym.")

event.register("numba:compile", Count())
metric = (np.ones(3), np.zeros(3))
print(interpolate(np.zeros(3), np.ones(3), 1 / 3, metric).tolist(), Count.compiled)
"""
KERNELS = 3  # interpolate, placed, shortest
GENERIC = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}


def ran(archive, folder, **more):
    """What the program said: the values, and how many of our kernels it compiled."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder), **more}
    command = [sys.executable, "-c", PROGRAM, str(archive)]
    output = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
    values, compiled = output.rsplit(" ", 1)
    return values, int(compiled)


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("generic")
    assert ran(folder / "none.zip", folder, **GENERIC)[1] == KERNELS
    assert pack_kernels(folder, folder / "kernels.zip") == KERNELS
    return folder / "kernels.zip"


def test_a_machine_that_never_ran_them_compiles_nothing(archive, tmp_path):
    values, compiled = ran(archive, tmp_path / "a")
    assert compiled == 0
    assert ran(tmp_path / "none.zip", tmp_path / "b") == (values, KERNELS)  # the same bits


def test_an_archive_that_does_not_fit_is_not_looked_at(archive, tmp_path):
    other = tmp_path / "other.zip"
    for name, value in made_with().items():
        with zipfile.ZipFile(archive) as source, zipfile.ZipFile(other, "w") as out:
            for entry in source.namelist():
                stamp = json.dumps({**made_with(), name: f"not {value}"})
                out.writestr(entry, stamp if entry.endswith(".json") else source.read(entry))
        with zipfile.ZipFile(archive) as source:
            kernels = [entry for entry in source.namelist() if not entry.endswith(".json")]
        assert len(kernels) == KERNELS
        assert ShippedKernels(other)._archive is None
    assert ShippedKernels(archive)._archive is not None


@pytest.mark.parametrize("left", [0, 10, 0.5, 0.99])
def test_a_damaged_archive_is_no_obstacle(archive, tmp_path, left):
    whole = archive.read_bytes()
    damaged = tmp_path / "damaged.zip"
    damaged.write_bytes(whole[: left if isinstance(left, int) else int(left * len(whole))])
    assert ShippedKernels(damaged).load("any", ("a", "b", "c", "d")) is None


def test_damage_within_an_entry_is_found_by_its_checksum(archive, tmp_path):
    content = bytearray(archive.read_bytes())
    content[len(content) // 2] ^= 0xFF
    (tmp_path / "damaged.zip").write_bytes(content)
    assert ran(tmp_path / "damaged.zip", tmp_path)[1] > 0


def test_no_damaged_byte_is_an_obstacle(archive, tmp_path, monkeypatch):
    content, damaged, stamp = archive.read_bytes(), tmp_path / "damaged.zip", made_with()
    with zipfile.ZipFile(archive) as source:
        whole = {name: source.read(name) for name in source.namelist() if not name.endswith(".json")}
    # Entries go by their own names here, and what they hold stays packed.
    monkeypatch.setattr(shipped_kernels, "_entry", lambda name, key: name)
    monkeypatch.setattr(shipped_kernels, "made_with", lambda: stamp)
    monkeypatch.setattr(shipped_kernels, "pickle", SimpleNamespace(loads=bytes))
    lists = content.index(b"PK\x01\x02")
    missed = 0
    for place in {*range(60), *range(0, lists, 97), *range(lists, len(content))}:
        changed = bytearray(content)
        changed[place] ^= 0xFF
        damaged.write_bytes(changed)
        kernels = ShippedKernels(damaged)
        for name, held in whole.items():
            found = kernels.load(name, ())
            assert found in (None, held), place
            missed += found is None
    assert missed > 0


def test_kernels_for_one_processor_alone_are_not_packed(tmp_path):
    ran(tmp_path / "none.zip", tmp_path)
    with pytest.raises(StorageError, match="for any processor"):
        pack_kernels(tmp_path, tmp_path / "kernels.zip")
    with pytest.raises(StorageError, match="expected a cache of compiled kernels"):
        pack_kernels(tmp_path / "nothing", tmp_path / "kernels.zip")


def test_this_checkout_s_archive_is_looked_for_beside_the_sources():
    assert (shipped_kernels.KERNELS / "plain.py").exists()
