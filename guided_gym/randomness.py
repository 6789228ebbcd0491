"""The named streams of random numbers: one seed, and the problem, the expansion and the guidance apart."""

from __future__ import annotations

import numpy as np

from guided_gym.errors import InvalidInputError


def streams(seed: int | None) -> tuple[np.random.Generator, np.random.Generator, np.random.Generator]:
    """Generators for the problem, the expansion and the guiding space, spawned from one seed.

    ``guided_search(seed=k)`` and ``env.reset(seed=k)`` use the same three.
    """
    try:
        return spawn(np.random.default_rng(seed))
    except (TypeError, ValueError) as error:
        raise InvalidInputError(f"seed: expected an integer >= 0 or None, got {seed!r}") from error


def spawn(
    rng: np.random.Generator,
) -> tuple[np.random.Generator, np.random.Generator, np.random.Generator]:
    """Three independent generators from the next number of ``rng``."""
    children = np.random.SeedSequence(int(rng.integers(2**63))).spawn(3)
    problem, expansion, guidance = (np.random.default_rng(child) for child in children)
    return problem, expansion, guidance
