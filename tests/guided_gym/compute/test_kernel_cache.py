"""Kernels compile wherever the package is installed."""

from __future__ import annotations

import os
import stat
import warnings
from pathlib import Path

import numba
import pytest

from guided_gym.compute import kernel_cache
from guided_gym.errors import GuidedGymWarning, StorageError


def refuse(**_):
    def decorate(function):
        raise RuntimeError("cannot cache function '_probe': no locator available")

    return decorate


@pytest.fixture(autouse=True)
def settings_stay(monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", numba.config.CACHE_DIR)
    monkeypatch.setenv(kernel_cache.VARIABLE, "")
    monkeypatch.delenv(kernel_cache.VARIABLE)


def test_a_folder_that_can_be_written_is_left_alone():
    before = numba.config.CACHE_DIR
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        kernel_cache.ensure_kernel_cache()
    assert before == numba.config.CACHE_DIR


def test_without_any_a_private_one_serves_until_the_end(monkeypatch):
    monkeypatch.setattr(numba, "njit", refuse)
    with pytest.warns(GuidedGymWarning, match="NUMBA_CACHE_DIR") as caught:
        kernel_cache.ensure_kernel_cache()
    assert len(caught) == 1
    folder = Path(os.environ[kernel_cache.VARIABLE])  # for workers
    assert str(folder) == numba.config.CACHE_DIR
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    kernel_cache._remove(str(folder), os.getpid() + 1)
    assert folder.is_dir()  # a fork leaves it to its parent
    kernel_cache._remove(str(folder), os.getpid())
    assert not folder.exists()


def test_nowhere_to_write_at_all_is_said(monkeypatch):
    def fail(**_):
        raise FileNotFoundError("no usable temporary directory found")

    monkeypatch.setattr(numba, "njit", refuse)
    monkeypatch.setattr(kernel_cache.tempfile, "mkdtemp", fail)
    with pytest.raises(StorageError, match="NUMBA_CACHE_DIR"):
        kernel_cache.ensure_kernel_cache()
