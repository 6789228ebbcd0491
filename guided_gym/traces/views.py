"""What a guiding space sees, as lines of a trace: its graph and what failures took from it, or its h."""

from __future__ import annotations

import base64
import copy
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.geometry.robots import Robot
from guided_gym.guidance.cells import Uninformed, Voronoi

if TYPE_CHECKING:
    from guided_gym.guidance.base import GuidingSpace
    from guided_gym.search.search import Search

Floats = NDArray[np.float64]
Rows = list[dict[str, Any]]

FIELD_CELLS: Final = 72  # along the longer side, of a heuristic shown as a field
_SPARING: Final = 1.15  # a field is written again after so many times as many samples, at the earliest
_DIGITS: Final = 5  # of coordinates that are for the eye alone


def leaf_guides(guide: GuidingSpace | None) -> list[GuidingSpace]:
    """The guiding spaces that a guide consists of: itself, or those of a hybrid, and of hybrids in it."""
    if guide is None:
        return []
    guides = getattr(guide, "guides", None)
    if guides is None:
        return [guide]
    return [leaf for one in guides for leaf in leaf_guides(one)]


def drawing_of(guide: GuidingSpace) -> dict[str, Any]:
    """What a guiding space can show of its view, a graph or a field; empty if it has neither."""
    draw = getattr(guide, "drawing", None)
    return draw(values=False) if draw is not None else {}


class GuideView:
    """The lines that show what one guiding space sees, as it learns.

    Args:
        number: Which of the trace's guides it is.
        guide: The guiding space, prepared.
        search: The search.
    """

    def __init__(self, number: int, guide: GuidingSpace, search: Search) -> None:
        self._number, self._guide, self._search = number, guide, search
        self._points = self._weights = self._field = np.zeros(0)
        self._due = 0.0

    def first(self) -> Rows:
        """The lines before the first sample."""
        drawing = drawing_of(self._guide)
        if drawing:
            return self._shown(drawing)
        if isinstance(self._guide, Uninformed) or not isinstance(self._search.problem.robot, Robot):
            return []  # the coordinates of a robot with joints are no places
        if isinstance(self._guide, Voronoi):
            return [{"view": self._number, "cells": True}]
        return [self._field_row(*heuristic_field(self._guide, self._search, FIELD_CELLS))]

    def changes(self) -> Rows:
        """The lines for what the last sample has changed."""
        drawing = drawing_of(self._guide)
        return self._shown(drawing) if drawing else []

    def _shown(self, drawing: dict[str, Any]) -> Rows:
        if "field" in drawing:
            return self._shown_field(drawing["field"], drawing["bounds"])
        points, edges = drawing["points"], drawing["edges"]
        weights = np.where(drawing["alive"], drawing["weights"], np.inf)
        rows: Rows = []
        if points.shape != self._points.shape or len(weights) != len(self._weights):
            graph = {"points": rounded(points), "edges": edges.tolist()}
            rows.append({"view": self._number, "graph": graph})
            self._weights = np.ones(len(weights))
        self._points = points
        changed = np.flatnonzero(weights != self._weights)
        if changed.size:
            self._weights = weights
            pairs = [
                [e, float(f"{w:.4g}") if np.isfinite(w) else None]
                for e, w in zip(changed.tolist(), weights[changed].tolist(), strict=True)
            ]
            rows.append({"view": self._number, "weights": pairs})
        return rows

    def _shown_field(self, values: Floats, bounds: list[float]) -> Rows:
        """The field, if it has changed, and not more often than a reader needs."""
        samples = self._search.samples
        if samples < self._due or np.array_equal(values, self._field):
            return []
        self._field = values
        self._due = max(samples + 4, samples * _SPARING)
        return [self._field_row(bounds, values)]

    def _field_row(self, bounds: list[float], values: Floats) -> dict[str, Any]:
        """A field as bytes: 0 for the least h, 254 for the largest, 255 where there is no way."""
        finite = np.isfinite(values)
        low, high = (float(values[finite].min()), float(values[finite].max())) if finite.any() else (0.0, 0.0)
        levels = np.full(values.shape, 255, np.uint8)
        levels[finite] = np.rint((values[finite] - low) / max(high - low, 1e-300) * 254)
        field = {
            "rows": values.shape[0],
            "columns": values.shape[1],
            "bounds": [float(f"{v:.7g}") for v in bounds],
            "low": low,
            "high": high,
            "values": base64.b64encode(levels.tobytes()).decode("ascii"),
        }
        return {"view": self._number, "field": field}


def heuristic_field(guide: GuidingSpace, search: Search, cells: int) -> tuple[list[float], Floats]:
    """The field h over the workspace, other coordinates at the goal's; search and guide stay as they are.

    Args:
        guide: The guiding space, prepared.
        search: The search.
        cells: Cells along the longer side.

    Returns:
        The bounds of the cells, and (rows, columns) h at their centres, row by row from below.
    """
    xmin, ymin, xmax, ymax = search.problem.environment.bounds
    cell = max(xmax - xmin, ymax - ymin) / cells
    columns, rows = (max(1, round(side / cell)) for side in (xmax - xmin, ymax - ymin))
    x = xmin + (np.arange(columns) + 0.5) / columns * (xmax - xmin)
    y = ymin + (np.arange(rows) + 0.5) / rows * (ymax - ymin)
    q = np.tile(search.goal, (rows * columns, 1))
    q[:, 0], q[:, 1] = np.tile(x, rows), np.repeat(y, columns)
    counts, state = (
        (search.collision_checks, search.looks),
        copy.deepcopy(search.guidance_rng.bit_generator.state),
    )
    h = np.asarray(guide.heuristic(guide.project(search.tree, q)), np.float64).reshape(rows, columns)
    search.collision_checks, search.looks = counts
    search.guidance_rng.bit_generator.state = state
    return [xmin, ymin, xmax, ymax], h


def rounded(points: Floats) -> list[list[float]]:
    """Points rounded for the eye: to `_DIGITS` digits of their spread."""
    spread = float(np.ptp(points, axis=0).max()) if len(points) else 1.0
    digits = _DIGITS - 1 - int(np.floor(np.log10(spread))) if spread > 0 else _DIGITS
    rows: list[list[float]] = np.round(points, digits).tolist()
    return rows
