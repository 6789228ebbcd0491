"""What is compared: how nodes are selected, how they are expanded, or both (paper, Evaluation metric).

A guided search selects a node and expands it. With a protocol, everybody has one of the two in common:

- ``whole``: each guidance selects and expands, as it is meant to. SE is that of the selections.
- ``selection``: each guidance selects; everybody expands by one uniform draw from N_C(v).
- ``expansion``: each guidance expands; everybody selects by the exact cost-to-go (the guidance ``oracle``, so
  that the searches get to the end). SE is that of the expansions: sampled children are added to the tree, and
  the one that the guidance chose is judged as a choice of that node would be.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.registry import make_guidance
from guided_gym.kernels.metric import ball_samples
from guided_gym.measure.target import Measure, entropy
from guided_gym.planning import guided_search
from guided_gym.search.local_planner import LocalPlanner
from guided_gym.search.search import NO_NODE

if TYPE_CHECKING:
    from guided_gym.planning import SearchResult
    from guided_gym.problems import Problem
    from guided_gym.search.watch import WatchedPlanner
    from guided_gym.train.specs import EvaluationSettings

PROTOCOLS: Final = ("whole", "selection", "expansion")
SELECTION: Final = "the protocol 'selection'"
EXPANSION: Final = "the protocol 'expansion'"
SELECTOR: Final = "oracle"  # who selects for everybody where expansions are compared
CHILDREN: Final = 64  # sampled children that an expansion is compared with
ENTROPY_BINS: Final = 8  # along each axis of C
_STREAM: Final = 0x45585041  # of the sampled children, apart from the search's own streams


def search_once(
    problem: Problem,
    guidance: GuidingSpace | WatchedPlanner,
    settings: EvaluationSettings,
    seed: int,
    trace: Path | None = None,
) -> SearchResult:
    """One measured search by the protocol of the settings.

    With the protocol ``expansion``, the SE of the record, and the least of it, are those of the expansions;
    that of a trace is of the selections.

    Raises:
        InvalidInputError: A planner that selects and expands by itself, with a protocol other than ``whole``,
            or to be traced.
    """
    expansion: GuidingSpace | str | None = settings.expansion
    selector = guidance
    if settings.protocol == "selection":
        selector, expansion = guiding_space(guidance, SELECTION), settings.expansion or "uniform"
    elif settings.protocol == "expansion":
        selector, expansion = make_guidance(SELECTOR), guiding_space(guidance, EXPANSION)
    result = guided_search(
        problem,
        selector,
        seed=seed,
        max_samples=settings.max_samples,
        expansion=expansion,
        options=settings.search_options(),
        distributions=settings.distributions,
        trace=trace,
    )
    if settings.protocol != "expansion":
        return result
    efficiency, best = expansion_efficiency(result, seed)
    return replace(result, record=replace(result.record, efficiency=efficiency, best=best))


def guiding_space(searcher: GuidingSpace | WatchedPlanner, what: str) -> GuidingSpace:
    """The guiding space that searches, if it is one.

    Args:
        searcher: Who searches.
        what: What needs a guiding space, for the message.

    Raises:
        InvalidInputError: It is a planner that selects and expands by itself.
    """
    if isinstance(searcher, GuidingSpace):
        return searcher
    raise InvalidInputError(
        f"{what}: expected a guiding space, got {searcher.expression}, a planner that selects and expands by "
        "itself"
    )


def expansion_efficiency(
    result: SearchResult, seed: int, children: int = CHILDREN
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(m,) SE of each expansion of a search, and (m,) the least that a sampled child has, in nats.

    Args:
        result: The search.
        seed: Of the sampled children.
        children: How many are drawn uniformly from N_C(v) at each sample; x_new joins them.

    Raises:
        InvalidInputError: The search was rewired: its trees cannot be told in hindsight.
    """
    if result.tree.rewirings:
        raise InvalidInputError("expansion: expected a search without rewiring, got one that was rewired")
    measure, record = Measure(result), result.record
    rng = np.random.default_rng([seed, _STREAM])
    space = result.problem.space
    step = LocalPlanner(space, rng, result.options.step).step
    configurations, targets = result.tree.configurations, sample_targets(result)
    rows = np.empty((record.selected.size, 2))
    for i, (node, size) in enumerate(zip(record.selected.tolist(), record.nodes.tolist(), strict=True)):
        q = configurations[node].copy()
        normals, radii = rng.standard_normal((children, q.size)), rng.random(children)
        sampled = ball_samples(q, normals, radii, step, space.metric)
        rows[i] = measure.expansion(node, np.vstack([targets[i : i + 1], sampled]), 0, size)
    return rows[:, 0], rows[:, 1]


def sample_targets(result: SearchResult) -> NDArray[np.float64]:
    """(m, d) the configuration x_new of each sample, whether its motion was free or not."""
    child = result.record.child
    failed = child == NO_NODE
    targets = np.empty((child.size, result.problem.space.dimension))
    targets[~failed] = result.tree.configurations[child[~failed]]
    targets[failed] = result.tree.failed_targets[: int(failed.sum())]
    return targets


def sample_entropy(result: SearchResult) -> float:
    """Entropy of a search's samples over C, on a grid of `ENTROPY_BINS` cells an axis; NaN if there are none.

    What was drawn beyond the bounds counts to the cell at the edge.
    """
    space, targets = result.problem.space, sample_targets(result)
    if not len(targets):
        return float("nan")
    inside = np.clip(space.wrap(targets), space.lower, space.upper)
    return entropy(inside, ENTROPY_BINS, np.column_stack([space.lower, space.upper]))


def checked_protocol(protocol: str, expansion: str | None, rewire: bool) -> None:
    """Refuse an unknown protocol, or one that leaves nothing to compare.

    Raises:
        InvalidInputError: It is one of these.
    """
    if protocol not in PROTOCOLS:
        raise InvalidInputError(f"protocol: expected one of {', '.join(PROTOCOLS)}, got {shown(protocol)}")
    if protocol == "expansion" and expansion is not None:
        raise InvalidInputError(
            f"expansion: expected none with the protocol 'expansion', in which each guidance expands; "
            f"got {shown(expansion)}"
        )
    if protocol == "expansion" and rewire:
        raise InvalidInputError(
            "rewire: expected False with the protocol 'expansion', which judges trees in hindsight; got True"
        )
