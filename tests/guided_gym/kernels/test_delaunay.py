"""Delaunay triangulations: no circle holds a point, and their Voronoi vertices are Qhull's."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import Voronoi, cKDTree

from guided_gym.kernels.delaunay import CORNERS, box_of, circle_centres, insert, triangulate


def _grid() -> NDArray[np.float64]:
    return np.stack(np.meshgrid(np.arange(12.0), np.arange(8.0)), axis=-1).reshape(-1, 2) * 0.1


def _sets() -> dict[str, NDArray[np.float64]]:
    rng = np.random.default_rng(0)
    drawn = rng.uniform(0, 10, (300, 2))
    turns = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    return {
        "drawn": drawn,
        "far from the origin": drawn + np.array([391_000.0, 5_820_000.0]),
        "a grid": _grid(),
        "on a circle": np.stack((np.cos(turns), np.sin(turns)), axis=1),
        "twice each": np.concatenate([drawn, drawn]),
        "on a line": np.outer(np.arange(9.0), (1.0, 0.3)),
        "one": np.ones((1, 2)),
    }


@pytest.mark.parametrize("name", _sets())
def test_triangulate__covers_the_square_and_no_circle_holds_a_point(name: str) -> None:
    points = _sets()[name]
    corners, beyond = triangulate(points)
    distinct = len(np.unique(points, axis=0))
    assert len(corners) == 2 + 2 * distinct
    assert set(np.unique(corners).tolist()) >= set(range(CORNERS))
    for t, k in np.argwhere(beyond >= 0).tolist():  # sides are common sides, turned round
        side = corners[t, (k + 1) % 3], corners[t, (k + 2) % 3]
        back = beyond[beyond[t, k]].tolist().index(t)
        other = corners[beyond[t, k]]
        assert (other[(back + 2) % 3], other[(back + 1) % 3]) == side
    centres = circle_centres(points, corners)
    real = np.flatnonzero(np.isfinite(centres).all(axis=1))
    radii = np.hypot(*(centres[real] - points[corners[real, 0] - CORNERS]).T)
    nearest, _ = cKDTree(points).query(centres[real])
    extent = max(np.ptp(points, axis=0).max(), 1.0)
    near = radii < 10 * extent
    assert (radii[near] - nearest[near] < 1e-7 * extent).all()


@pytest.mark.parametrize("name", ["drawn", "a grid"])
def test_circle_centres__are_the_voronoi_vertices_of_qhull(name: str) -> None:
    points = _sets()[name]
    found = circle_centres(points, triangulate(points)[0])
    expected = Voronoi(points).vertices
    low, high = points.min(axis=0), points.max(axis=0)
    inside = expected[((expected > low) & (expected < high)).all(axis=1)]
    distances, _ = cKDTree(found[np.isfinite(found).all(axis=1)]).query(inside)
    assert len(inside) > 50
    assert distances.max() < 1e-6


@pytest.mark.parametrize("name", ["drawn", "a grid", "twice each", "far from the origin"])
def test_insert__comes_to_the_triangles_of_all_points_and_keeps_the_places_of_those_it_leaves(
    name: str,
) -> None:
    points = _sets()[name]
    box, some = box_of(points), len(points) // 2
    few = np.concatenate([points[:some], box.reshape(2, 2)])
    points = np.concatenate([few, points[some:]])
    first = triangulate(few)
    kept = first[0].copy()
    corners, _ = insert(points, len(few), box, *first)
    assert np.array_equal(first[0], kept)
    once = triangulate(points)
    assert len(corners) == len(once[0])
    same = (corners[: len(kept)] == kept).all(axis=1)
    found, expected = (circle_centres(points, c) for c in (corners, once[0]))
    assert np.array_equal(found[: len(kept)][same], circle_centres(few, kept)[same], equal_nan=True)
    inside = expected[np.isfinite(expected).all(axis=1)]
    inside = inside[((inside > box[:2]) & (inside < box[2:])).all(axis=1)]
    distances, _ = cKDTree(found[np.isfinite(found).all(axis=1)]).query(inside)
    assert distances.max() < 1e-6
