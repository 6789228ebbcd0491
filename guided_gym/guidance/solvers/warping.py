"""Dynamic time warping between paths, by dtaidistance (an extra: a well-kept library beats our own code)."""

from __future__ import annotations

import numpy as np

from guided_gym.errors import GuidedGymError
from guided_gym.guidance.solvers.base import Floats


def warped(a: Floats, b: Floats) -> float:
    """Least sum of distances between two paths (n, d) and (m, d), in the order of both.

    Raises:
        GuidedGymError: dtaidistance is not installed.
    """
    try:
        from dtaidistance import dtw_ndim
    except ImportError as error:
        raise GuidedGymError(
            "retrieval by dynamic time warping needs dtaidistance: pip install 'guided-gym[dtw]'"
        ) from error
    # Without pruning: with it, near copies came out as infinitely far.
    return float(dtw_ndim.distance_fast(np.ascontiguousarray(a), np.ascontiguousarray(b), use_pruning=False))
