from __future__ import annotations

import numpy as np
import pytest

from guided_gym.kernels.pixels import shrink


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_shrink__averages_blocks_channel_by_channel(factor):
    rgb = np.random.default_rng(0).integers(0, 256, (4 * factor, 5 * factor, 3)).astype(np.uint32)
    out = np.empty((4, 5, 3), np.uint8)
    shrink(np.ascontiguousarray(rgb[..., 0] << 16 | rgb[..., 1] << 8 | rgb[..., 2]), factor, out)
    means = rgb.reshape(4, factor, 5, factor, 3).mean(axis=(1, 3))
    assert np.abs(out - means).max() <= 0.5 + 1e-9
