"""The solution behind an oracle: distances to one goal, over a grid or over a roadmap."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from guided_gym.compute.workers import in_worker
from guided_gym.errors import InvalidInputError, warn
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.kernels.cost_query import OracleState

FloatArray = NDArray[np.float64]
Configurations = FloatArray | Sequence[float] | Sequence[Sequence[float]]


class OracleError(NamedTuple):
    """Estimated relative error of an oracle over free poses, from a coarser grid or roadmap.

    Attributes:
        mean: On average.
        tail: At the 99th percentile.
    """

    mean: float
    tail: float

    def __str__(self) -> str:
        return f"{100 * self.mean:.2f} % on average, {100 * self.tail:.2f} % at the 99th percentile"


class Kept(NamedTuple):
    """What a file keeps of a solution, so that other processes need not solve it.

    Attributes:
        kind: Which of the ways to solve it is from.
        meta: Numbers and lists, as JSON has them.
        arrays: What is large.
    """

    kind: str
    meta: dict[str, Any]
    arrays: Mapping[str, NDArray[Any]]


class Solution(Protocol):
    """Distances to the goal of one task, solved over a grid or a roadmap."""

    @property
    def resolution(self) -> tuple[int, ...]:
        """Vertices along each axis of a grid; the number of vertices of a roadmap."""

    @property
    def state(self) -> OracleState:
        """What `guided_gym.kernels.cost_query.cost_to_go_one` takes; without a grid, no way is known."""

    @property
    def error(self) -> OracleError:
        """The estimated error."""

    def cost(self, q: FloatArray) -> float:
        """Distance to the goal of one configuration (d,); infinite where no way is known."""

    def costs(self, qs: FloatArray) -> FloatArray:
        """(n,) distances to the goal of configurations (n, d)."""

    def connects(self, q: FloatArray) -> bool:
        """Whether a valid configuration is joined to the goal without anything finer being tried."""

    def kept(self) -> Kept:
        """What a file keeps of it."""


def valid_configuration(space: ConfigurationSpace, q: Configurations, what: str) -> FloatArray:
    """A configuration as an array (d,) of its own.

    Raises:
        InvalidInputError: It has another shape, or is not valid.
    """
    pose = np.array(q, dtype=np.float64)
    if pose.shape != (space.dimension,):
        raise InvalidInputError(f"expected a {what} of shape ({space.dimension},), got shape {pose.shape}")
    if not space.valid(pose):
        raise InvalidInputError(
            f"the {what} {pose.tolist()} is not a valid configuration: in collision or out of bounds"
        )
    return pose


def free_poses(space: ConfigurationSpace, rng: np.random.Generator, count: int) -> FloatArray:
    """(<= count, d) free poses, drawn uniformly; fewer where hardly a pose is free."""
    found = np.empty((0, space.dimension))
    for _ in range(32):
        poses = space.sample(rng, count)
        found = np.concatenate([found, poses[space.valid(poses)]])
        if len(found) >= count:
            break
    return found[:count]


_warned = threading.Event()


def warn_of(error: OracleError, what: str, budget: int) -> None:
    """Say once per process that an oracle is less exact than was asked for.

    Args:
        error: Its error.
        what: What it was solved over, like "on a grid of 64 x 64 poses".
        budget: What it was allowed.
    """
    if not (_warned.is_set() or in_worker()):
        _warned.set()
        warn(
            f"the oracle's estimated error is {error}, {what}: its budget of {budget:,} "
            "vertices is spent. OracleOptions takes a larger budget, or allows a larger error; Oracle.error "
            "is the error of each problem."
        )
