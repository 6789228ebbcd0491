"""The local planner: which configurations can be reached from a node, N_C(v) (paper, Preliminaries)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import integer, number
from guided_gym.doors import doors
from guided_gym.errors import warn
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.kernels.metric import ball_samples, steer
from guided_gym.options import DEFAULT_CANDIDATES, checked_candidates

_LONG = 1.5
"""Steps longer than this times what the free space suits are warned of."""


@doors
class LocalPlanner:
    """Straight motions of at most ``step``: N_C(v) is the ball of that radius around v.

    Args:
        space: The configuration space.
        rng: Source of every random expansion.
        step: Radius of the ball, in the space's distance; None for the space's own `scale`.
        candidates: How many members of N_C(v) a guided choice looks at.

    Raises:
        InvalidInputError: A step that is not positive, or no candidates.
    """

    def __init__(
        self,
        space: ConfigurationSpace,
        rng: np.random.Generator,
        step: float | None = None,
        candidates: int = DEFAULT_CANDIDATES,
    ) -> None:
        self.space = space
        self.rng = rng
        if step is None:
            self.step = space.scale
        else:
            self.step = number("step", step, above=0, what="length")
            if self.step > _LONG * space.room:
                warn(
                    f"a step of {self.step:.3g} is long for this world: most motions of that length collide "
                    f"where it is narrow. Its free space suits steps of up to {space.room:.3g}, and the "
                    f"default is {space.scale:.3g}"
                )
        self.candidate_count = integer("candidates", candidates, least=1)

    def candidates(self, q: NDArray[np.float64], count: int | None = None) -> NDArray[np.float64]:
        """(k, d) configurations drawn uniformly from the ball N_C(q).

        Raises:
            InvalidInputError: ``q`` is no configuration, or the count no positive integer.
        """
        return self._drawn(q, self.candidate_count if count is None else checked_candidates(count))

    def _drawn(self, q: NDArray[np.float64], k: int) -> NDArray[np.float64]:
        q = self.space.configuration(q)
        normals, radii = self.rng.standard_normal((k, q.size)), self.rng.random(k)
        return ball_samples(q, normals, radii, self.step, self.space.metric)

    def uniform(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """(d,) one configuration drawn uniformly from N_C(q)."""
        candidate: NDArray[np.float64] = self._drawn(q, 1)[0]
        return candidate

    def steer(self, q: NDArray[np.float64], towards: NDArray[np.float64]) -> NDArray[np.float64]:
        """(d,) the configuration of N_C(q) nearest to ``towards`` on the straight motion to it.

        Raises:
            InvalidInputError: One of the two is no configuration.
        """
        q, towards = self.space.configuration(q), self.space.configuration(towards)
        return steer(q, towards, self.step, self.space.metric)
