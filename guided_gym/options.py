"""Options: how a search expands and how it is measured, for planning, environments and evaluation alike."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from guided_gym.checks import affordable, count, flag, instance, integer, number, shown
from guided_gym.doors import doors
from guided_gym.errors import InvalidInputError

DEFAULT_CANDIDATES = 16

# Bytes of one, rounded up: what a search or an oracle keeps of it.
_VERTEX = 50  # of the oracle's grid: value, links, and what solving takes
_OF_ROADMAP = 200  # as much as so many of a grid: a vertex of its roadmap
_CANDIDATE = 96  # normal numbers, radii, configurations and states: about three rows of numbers
_SAMPLE = 200  # its row of the record, and a node or a failure of the tree


def checked_candidates(value: object) -> int:
    """The number of candidates that a choice looks at, checked.

    Raises:
        InvalidInputError: It is no integer, not positive, or would take more memory than is allowed.
    """
    return count("candidates", value, least=1, each=_CANDIDATE, what="a choice among so many")


def checked_samples(value: object) -> int:
    """The number of samples after which a search gives up, checked.

    Raises:
        InvalidInputError: It is no integer, not positive, or would take more memory than is allowed.
    """
    return count("max_samples", value, least=1, each=_SAMPLE, what="a search of so many samples")


def checked_resolution(resolution: Sequence[int]) -> tuple[int, ...]:
    """Vertices of the oracle's grid along each axis, or of its roadmap.

    Raises:
        InvalidInputError: They are no 1 to 3 counts of at least 4, or would take more memory than is allowed.
    """
    if not isinstance(resolution, tuple | list) or len(resolution) not in (1, 2, 3):
        raise InvalidInputError(
            "resolution: expected 2 or 3 vertex counts, one for each axis, or (n,) for a roadmap, "
            f"got {shown(resolution)}"
        )
    counts = tuple(integer("resolution", n, least=4) for n in resolution)
    size = _VERTEX * math.prod(counts) * (_OF_ROADMAP if len(counts) == 1 else 1)
    affordable("resolution", counts, size, "the oracle's grid or roadmap")
    return counts


@doors
@dataclass(frozen=True)
class TargetParameters:
    """Parameters of the target distribution Q (paper, Sampling Efficiency).

    Attributes:
        delta: Temperature of the suboptimality, in units of ``normalisation``.
        tau: Temperature of the work remaining, in the same units.
        epsilon: Smallest probability of a node under the smoothed target.
        normalisation: ``"start"`` divides delta_v and tau_v by d_C(s, t); ``"tree"`` by the largest value
            in the tree, each by its own.

    Raises:
        InvalidInputError: A temperature that is not positive, an epsilon outside [0, 1), another word.
    """

    delta: float = 0.1
    tau: float = 0.1
    epsilon: float = 1e-4
    normalisation: str = "start"

    def __post_init__(self) -> None:
        for name in ("delta", "tau"):
            number(name, getattr(self, name), above=0)
        number("epsilon", self.epsilon, least=0, below=1)
        if self.normalisation not in ("start", "tree"):
            raise InvalidInputError(
                f"normalisation: expected 'start' or 'tree', got {shown(self.normalisation)}"
            )


DEFAULT_TARGET = TargetParameters()


@doors
@dataclass(frozen=True)
class OracleOptions:
    """How exact the oracle's d_C has to be, and what it may spend on that.

    Attributes:
        resolution: Vertices of its grid along each axis of the configuration space, or ``(n,)`` for those of
            its roadmap; None chooses them, and refines until the estimated error is as small as asked.
        mean: Estimated relative error that is asked for on average over free poses; None for 1 % of a grid,
            2 % of a roadmap.
        tail: Likewise at the 99th percentile; None for 5 % of a grid, 20 % of a roadmap.
        budget: Vertices of its finest grid, at most. A million of them take some 0.5 s on one core and 50 MB;
            a count, not a time, so that a problem has the same oracle on every machine. A vertex of a roadmap
            counts as 200, since its motions have to be checked.
        method: ``"grid"`` or ``"roadmap"``; None for a grid in 2 and 3 dimensions, a roadmap in more.

    Raises:
        InvalidInputError: Another method, a resolution that is not 1 to 3 counts of at least 4, an error that
            is not positive, or a budget below 10,000.
    """

    resolution: tuple[int, ...] | None = None
    mean: float | None = None
    tail: float | None = None
    budget: int = 4_000_000
    method: str | None = None

    def __post_init__(self) -> None:
        if self.method not in (None, "grid", "roadmap"):
            raise InvalidInputError(f"method: expected 'grid', 'roadmap' or None, got {shown(self.method)}")
        if self.resolution is not None:
            object.__setattr__(self, "resolution", checked_resolution(self.resolution))
        for name in ("mean", "tail"):
            if getattr(self, name) is not None:
                number(name, getattr(self, name), above=0)
        count("budget", self.budget, least=10_000, each=_VERTEX, what="an oracle's grid of so many vertices")

    def excess(self, error: tuple[float, float], usual: tuple[float, float]) -> float:
        """How many times larger an error (mean, tail) is than what is asked for, or than the default."""
        asked = (self.mean, self.tail)
        return max(e / (u if a is None else a) for e, a, u in zip(error, asked, usual, strict=True))


DEFAULT_ORACLE = OracleOptions()


@doors
@dataclass(frozen=True)
class SearchOptions:
    """How a search expands and is measured; independent of who chooses the nodes.

    The task says where a search ends: see `Task`.

    Attributes:
        step: Radius of the local planner's ball; None for the `scale` of the configuration space: 5 % of the
            diagonal of the bounds, or less where the free space is narrow.
        candidates: Members of N_C(v) that a guided expansion looks at.
        rewire: RRT*-style: a new node takes the best parent within one step, then becomes one itself.
        target: Parameters of the target distribution Q.
        oracle: Resolution and budget of the oracle by which SE is measured.

    Raises:
        InvalidInputError: A value of the wrong type or out of range.
    """

    step: float | None = None
    candidates: int = DEFAULT_CANDIDATES
    rewire: bool = False
    target: TargetParameters = DEFAULT_TARGET
    oracle: OracleOptions = DEFAULT_ORACLE

    def __post_init__(self) -> None:
        if self.step is not None:
            number("step", self.step, above=0, what="length")
        checked_candidates(self.candidates)
        flag("rewire", self.rewire)
        instance("target", self.target, TargetParameters)
        instance("oracle", self.oracle, OracleOptions)
