"""Named streams of random numbers: from one seed, apart for the problem, the expansion and the guidance."""

from __future__ import annotations

import copy
from typing import Any, Final

import numpy as np
from numpy.random.bit_generator import ISeedSequence

from guided_gym.checks import integer
from guided_gym.doors import door


def seed_of(*numbers: int) -> int:
    """One seed from several numbers."""
    return int(np.random.SeedSequence(numbers).generate_state(1)[0])


@door
def streams(seed: int | None) -> tuple[np.random.Generator, np.random.Generator, np.random.Generator]:
    """Generators for the problem, the expansion and the guiding space, spawned from one seed.

    ``guided_search(seed=k)`` and ``env.reset(seed=k)`` use the same three.
    """
    return spawn(np.random.default_rng(None if seed is None else integer("seed", seed, least=0)))


class _NoSeed(ISeedSequence):
    """The seed of a generator whose state is about to be set: the system's entropy takes its time."""

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> Any:
        return np.zeros(n_words, dtype)


_NO_SEED: Final = _NoSeed()


def copied(rng: np.random.Generator) -> np.random.Generator:
    """A generator that goes on as this one does."""
    if type(rng.bit_generator) is not np.random.PCG64:
        return copy.deepcopy(rng)
    bits = np.random.PCG64(_NO_SEED)  # type: ignore[arg-type]
    bits.state = rng.bit_generator.state
    return np.random.Generator(bits)


def spawn(
    rng: np.random.Generator,
) -> tuple[np.random.Generator, np.random.Generator, np.random.Generator]:
    """Three independent generators from the next number of ``rng``."""
    children = np.random.SeedSequence(int(rng.integers(2**63))).spawn(3)
    problem, expansion, guidance = (np.random.default_rng(child) for child in children)
    return problem, expansion, guidance
