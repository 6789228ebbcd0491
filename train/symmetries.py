"""The eight symmetries of the square, on maps with headings: a problem turned is another problem.

A quarter turn moves each heading by a quarter; a mirror (x to -x) takes heading theta to pi - theta. Robots
that have no such symmetry are turned and mirrored along: a field network sees of them only their room.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import torch
from torch import Tensor


class Symmetry(NamedTuple):
    """Mirror or not, then some quarter turns counter-clockwise."""

    mirrored: bool
    quarters: int


SYMMETRIES: Final = tuple(Symmetry(mirrored, quarters) for mirrored in (False, True) for quarters in range(4))


def turned(maps: Tensor, symmetry: Symmetry, headings: int) -> Tensor:
    """Maps (b, groups * T + rest, n, n) after the symmetry; rows are y upwards.

    The first channels come in groups of T headings; the rest, fewer than T, have none.
    """
    groups = maps.shape[1] // headings
    split = groups * headings
    n = maps.shape[-1]
    headed = maps[:, :split].reshape(-1, groups, headings, n, n)
    rest = maps[:, split:]
    if symmetry.mirrored:
        headed = headed.flip(-1).index_select(2, _mirrored(headings).to(maps.device))
        rest = rest.flip(-1)
    headed = _quarter_turned(headed, symmetry.quarters).roll(symmetry.quarters * headings // 4, 2)
    return torch.cat([headed.flatten(1, 2), _quarter_turned(rest, symmetry.quarters)], 1)


def turned_back(maps: Tensor, symmetry: Symmetry) -> Tensor:
    """The inverse of `turned`, for maps (b, T, n, n)."""
    headings = maps.shape[1]
    back = _quarter_turned(maps, -symmetry.quarters).roll(-symmetry.quarters * headings // 4, 1)
    if symmetry.mirrored:
        back = back.flip(-1).index_select(1, _mirrored(headings).to(maps.device))
    return back


def _mirrored(headings: int) -> Tensor:
    return (headings // 2 - torch.arange(headings)) % headings


def _quarter_turned(maps: Tensor, quarters: int) -> Tensor:
    """Rows are y upwards, so counter-clockwise in space is clockwise in the array."""
    return torch.rot90(maps, -quarters, (-2, -1))
