"""Scaling pictures down: the smoothing step of an oversampled frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guided_gym.kernels.plain import borrowing


@borrowing
def shrink(pixels: NDArray[np.uint32], factor: int, out: NDArray[np.uint8]) -> None:
    """Average blocks of factor x factor pixels.

    Args:
        pixels: (H * factor, W * factor) uint32, 0x00RRGGBB.
        factor: Side of a block, at most 16.
        out: (H, W, 3) uint8, red, green, blue; overwritten.
    """
    area = np.uint32(factor * factor)
    half = area // np.uint32(2)
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            red, green, blue = half, half, half
            for i in range(row * factor, (row + 1) * factor):
                for j in range(column * factor, (column + 1) * factor):
                    pixel = pixels[i, j]
                    red += (pixel >> np.uint32(16)) & np.uint32(255)
                    green += (pixel >> np.uint32(8)) & np.uint32(255)
                    blue += pixel & np.uint32(255)
            out[row, column, 0] = red // area
            out[row, column, 1] = green // area
            out[row, column, 2] = blue // area
