from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from guided_gym.kernels import eikonal
from guided_gym.kernels.eikonal import LINK_THETA, LINK_X, LINK_Y, PAD, improve, march


def linked(free):
    """Links of a grid (columns, rows, angles) between neighbours that are both free, with padding."""
    free = np.pad(free, ((PAD, PAD), (PAD, PAD), (0, 0)))
    links = np.zeros(free.shape, dtype=np.uint8)
    links[:-1] |= np.where(free[:-1] & free[1:], LINK_X, 0).astype(np.uint8)
    links[:, :-1] |= np.where(free[:, :-1] & free[:, 1:], LINK_Y, 0).astype(np.uint8)
    links |= np.where(free & np.roll(free, -1, axis=2), LINK_THETA, 0).astype(np.uint8)
    return links


def solve(links, spacing, source, sight=0.0):
    """The field without its padding; exact values within `sight` of the source, in a grid without walls."""
    shape = links.shape
    index = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1) - [PAD, PAD, 0]
    offsets = index - np.array(source)
    offsets[..., 2] = (offsets[..., 2] + shape[2] // 2) % shape[2] - shape[2] // 2
    exact = np.linalg.norm(offsets * spacing, axis=-1)
    seeds = np.flatnonzero((exact <= sight) & (links > 0))
    field = march(
        links.ravel(), shape[1] * shape[2], shape[2], np.array(spacing), seeds, exact.ravel()[seeds]
    )
    inner = (slice(PAD, -PAD), slice(PAD, -PAD))
    return field.reshape(shape)[inner], exact[inner]


@pytest.mark.parametrize(("shape", "axis"), [((30, 1, 1), 0), ((1, 30, 1), 1), ((1, 1, 30), 2)])
def test_along_one_axis_distances_are_exact(shape, axis):
    field, exact = solve(linked(np.ones(shape, dtype=bool)), (0.5, 0.25, 0.125), (0, 0, 0))
    np.testing.assert_allclose(field, exact, rtol=1e-6)
    assert field.max() == pytest.approx({0: 14.5, 1: 7.25, 2: 15 * 0.125}[axis])


@pytest.mark.parametrize("shape", [(60, 60, 1), (30, 30, 24)])
def test_in_the_open_the_error_is_a_small_part_of_a_link(shape):
    source = (shape[0] // 3, shape[1] // 2, 0)
    field, exact = solve(linked(np.ones(shape, dtype=bool)), (0.1, 0.12, 0.08), source, sight=0.6)
    assert np.abs(field - exact).max() < 0.03
    assert np.abs(field - exact).mean() < 0.006


def test_the_wave_crosses_links_only():
    links = linked(np.ones((9, 9, 1), dtype=bool))
    links[PAD + 4] &= ~np.uint8(LINK_X)  # columns 4 and 5 are free, but not joined
    field, _ = solve(links, (1.0, 1.0, 1.0), (0, 0, 0))
    assert np.isfinite(field[:5]).all()
    assert np.isinf(field[5:]).all()


def test_seeds_keep_their_values():
    links = linked(np.ones((5, 5, 1), dtype=bool))
    middle = np.flatnonzero(links.ravel())[12]
    field = march(links.ravel(), 9, 1, np.ones(3), np.array([middle, middle + 1]), np.array([0.0, 7.0]))
    assert field[middle] == 0.0
    assert field[middle + 1] == 7.0


def test_no_seed_gives_no_finite_value():
    links = linked(np.ones((5, 5, 4), dtype=bool))
    none = np.empty(0, dtype=np.int64)
    assert np.isinf(march(links.ravel(), 36, 4, np.ones(3), none, np.empty(0))).all()


def waves(links, spacing, seeds, nearer):
    """A field, and the same after a wave from a vertex that came nearer."""
    grid = (links.ravel(), links.shape[1] * links.shape[2], links.shape[2], np.array(spacing))
    field = march(*grid, seeds, np.linspace(0.0, 0.3, seeds.size))
    improved = field.copy()
    improve(*grid, improved, np.array([nearer]), np.array([0.01]))
    return field, improved


@pytest.mark.parametrize("shape", [(40, 30, 1), (14, 12, 8)])
def test_room_for_what_waits_grows_where_it_is_short_and_changes_nothing(shape, monkeypatch):
    free = np.random.default_rng(7).random(shape) > 0.2
    links = linked(free)
    inside = np.flatnonzero(links.ravel())
    asked = (links, (0.1, 0.12, 0.3), inside[::40], inside[-1])
    expected = waves(*asked)
    assert (expected[1] < expected[0]).any()
    grown, march_on = [], eikonal._march

    def watched(*arguments):
        done = march_on(*arguments)
        grown.extend([1] * (not done))
        return done

    monkeypatch.setattr(eikonal, "_march", watched)
    monkeypatch.setattr(eikonal, "_FRONT", 0.0)
    found = waves(*asked)
    assert len(grown) > 2
    for ours, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_wave_takes_little_memory_beside_its_field():
    """What waits is a front: its entries were 144 bytes for each vertex, more than all else together."""
    links = linked(np.ones((60, 60, 24), dtype=bool))
    grid = (links.ravel(), links.shape[1] * links.shape[2], links.shape[2], np.array([0.1, 0.1, 0.1]))
    seed = (np.flatnonzero(links.ravel())[:1], np.zeros(1))
    march(*grid, *seed)
    tracemalloc.start()
    try:
        march(*grid, *seed)
        most = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert most < 12 * links.size  # the field, what is tried and the fans take 9
