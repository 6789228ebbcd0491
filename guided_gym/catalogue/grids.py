"""Grids of cells: mazes carved into them, and their walls as few rectangles."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

Cells = NDArray[np.bool_]
Room = tuple[int, int]


def carved(rng: np.random.Generator, columns: int, rows: int, newest: float) -> Cells:
    """A perfect maze: (2 columns + 1, 2 rows + 1) cells, True for walls; one way between any two rooms.

    Rooms are the cells with two odd indices. The tree of passages grows from a random room: from its newest
    room with probability ``newest``, else from any (1: long winding corridors, 0: short branches).

    Args:
        rng: Source of the draws.
        columns: Rooms along the first index.
        rows: Rooms along the second.
        newest: Probability, 0 to 1.
    """
    walls = np.ones((2 * columns + 1, 2 * rows + 1), np.bool_)
    first = (int(rng.integers(columns)), int(rng.integers(rows)))
    walls[2 * first[0] + 1, 2 * first[1] + 1] = False
    active = [first]
    while active:
        k = len(active) - 1 if rng.random() < newest else int(rng.integers(len(active)))
        i, j = active[k]
        closed = [
            (a, b)
            for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1))
            if 0 <= a < columns and 0 <= b < rows and walls[2 * a + 1, 2 * b + 1]
        ]
        if not closed:
            active.pop(k)
            continue
        a, b = closed[int(rng.integers(len(closed)))]
        walls[2 * a + 1, 2 * b + 1] = walls[i + a + 1, j + b + 1] = False
        active.append((a, b))
    return walls


def way(walls: Cells, start: Room, goal: Room) -> list[Room]:
    """Free cells of a shortest way between two, ends included; empty if there is none."""
    came: dict[Room, Room] = {start: start}
    queue = deque([start])
    while queue and goal not in came:
        i, j = queue.popleft()
        for cell in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
            inside = 0 <= cell[0] < walls.shape[0] and 0 <= cell[1] < walls.shape[1]
            if inside and not walls[cell] and cell not in came:
                came[cell] = (i, j)
                queue.append(cell)
    if goal not in came:
        return []
    cells = [goal]
    while cells[-1] != start:
        cells.append(came[cells[-1]])
    return cells[::-1]


def covering(cells: Cells) -> list[tuple[int, int, int, int]]:
    """Few rectangles whose union is exactly the True cells; they may overlap.

    Greedy: of the largest rectangles that fit, always the one that covers most of what is left.

    Args:
        cells: (m, n) bool.

    Returns:
        Half-open index ranges (i0, j0, i1, j1) each.
    """
    fitting = _maximal(cells)
    members = np.zeros((len(fitting), *cells.shape), np.bool_)
    for k, (i0, j0, i1, j1) in enumerate(fitting):
        members[k, i0:i1, j0:j1] = True
    members = members.reshape(len(fitting), cells.size)
    left = cells.ravel().copy()
    chosen = []
    while left.any():
        best = int(np.argmax((members & left).sum(axis=1)))
        left &= ~members[best]
        chosen.append(fitting[best])
    return chosen


def _maximal(cells: Cells) -> list[tuple[int, int, int, int]]:
    """The rectangles of True cells that are in no larger one."""
    found = []
    m, n = cells.shape
    for i0 in range(m):
        full = np.ones(n, np.bool_)
        for i1 in range(i0 + 1, m + 1):
            full &= cells[i1 - 1]
            if not full.any():
                break
            edges = np.flatnonzero(np.diff(np.concatenate(([False], full, [False]))))
            for j0, j1 in edges.reshape(-1, 2).tolist():
                above = i0 > 0 and cells[i0 - 1, j0:j1].all()
                below = i1 < m and cells[i1, j0:j1].all()
                if not (above or below):
                    found.append((i0, j0, i1, j1))
    return found
