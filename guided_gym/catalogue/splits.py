"""Train, validation and test problems of a distribution: ranges of seeds that share none."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Protocol, runtime_checkable

from guided_gym.catalogue.distributions import ProblemDistribution, ProblemList
from guided_gym.checks import shown
from guided_gym.doors import door
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.problems import Problem


@dataclass(frozen=True)
class Split:
    """A range of seeds that is kept for one purpose.

    Attributes:
        name: What options call it.
        first: Its first seed.
        size: How many seeds it has.
    """

    name: str
    first: int
    size: int

    def seed(self, index: int) -> int:
        """The seed of problem number ``index``.

        Raises:
            InvalidInputError: The split has no such problem.
        """
        if not 0 <= index < self.size:
            raise InvalidInputError(
                f"{self.name} split: expected an index 0 to {self.size - 1}, got {shown(index)}"
            )
        return self.first + int(index)

    def seeds(self, start: int = 0, count: int | None = None) -> Iterator[int]:
        """The seeds of ``count`` problems (None: all the rest) from number ``start`` on."""
        end = self.size if count is None else min(start + count, self.size)
        return (self.seed(index) for index in range(start, end))


TRAIN: Final = Split("train", 0, 2**30)
VALIDATION: Final = Split("validation", 2**30, 2**29)
TEST: Final = Split("test", 2**30 + 2**29, 2**29)
SPLITS: Final = {split.name: split for split in (TRAIN, VALIDATION, TEST)}
"""Below 2**31 all of them, so that every program that takes seeds takes these."""


def split_named(split: str | Split) -> Split:
    """A split from its name; a `Split` is returned as it is.

    Raises:
        UnknownNameError: No such name; the nearest one is suggested.
    """
    if isinstance(split, Split):
        return split
    if split not in SPLITS:
        raise UnknownNameError("split", split, SPLITS)
    return SPLITS[split]


@door
def problem_seed(split: str | Split, index: int) -> int:
    """The seed of problem number ``index`` of a split: what ``env.reset(seed=...)`` takes without a split.

    Raises:
        UnknownNameError: An unknown split.
        InvalidInputError: The split has no such problem.
    """
    return split_named(split).seed(index)


@runtime_checkable
class HasParts(Protocol):
    """A distribution that decides by itself which of its problems are for training, validation and test."""

    def part(self, split: str) -> ProblemDistribution:
        """Its problems for one purpose."""


class SplitProblems(ProblemList):
    """The problems of one split of a distribution, numbered from 0.

    Problem i is the one that ``env.reset(seed=problem_seed(split, i))`` poses on the whole distribution. An
    environment over this list poses it with ``env.reset(seed=i)``, and draws from this split alone when it
    is reset without a seed.
    """

    def __init__(self, distribution: ProblemDistribution, split: Split) -> None:
        self.name = f"{distribution.name}@{split.name}"
        self.summary = f"{distribution.summary} ({split.name} problems)"
        self.angles = distribution.angles
        self.distribution = distribution
        self.split = split

    def __len__(self) -> int:
        """Number of problems: the size of the split."""
        return self.split.size

    def __getitem__(self, index: int) -> Problem:
        """Problem number ``index``.

        Raises:
            InvalidInputError: There is no such problem.
            NoPathError: No problem with a path could be drawn.
        """
        return self.distribution.problem(self.split.seed(index))

    def part(self, split: str) -> ProblemDistribution:
        """These problems, if that is the split; they hold no others.

        Raises:
            InvalidInputError: Another split.
        """
        if split != self.split.name:
            raise InvalidInputError(f"{self.name}: expected no other split on top of it, got {shown(split)}")
        return self


def in_split(distribution: ProblemDistribution, split: str | Split) -> ProblemDistribution:
    """The problems of one split; a fixed problem is the same in each.

    Raises:
        UnknownNameError: An unknown split.
        InvalidInputError: The distribution has no such part.
    """
    split = split_named(split)
    if distribution.fixed:
        return distribution
    if isinstance(distribution, HasParts):
        return distribution.part(split.name)
    return SplitProblems(distribution, split)
