"""The node scorer: logits over a tree's nodes, from named columns; numpy inference.

Permutation-equivariant, and independent of padding and of the tree's size: each node is scored by itself,
beside a summary of the tree (attention pooling and the largest of each unit), neither of which counts nodes.
`networks` has the torch module that trains it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.guidance.learned import weights


class ScorerColumn(IntEnum):
    """Columns of what the scorer sees of a node.

    "Unit" is the field's value at the root, the length that the target distribution divides by too.
    """

    REMAINING = 0  # the field's value, in units, clipped at 4
    EXCESS = 1  # cost-to-come + the field's value - the unit, in units, 0 to 4: suboptimality as it seems
    FAILURES = 2  # log(1 + failed expansions)
    CHILDREN = 3  # log(1 + children)
    CONTACTS = 4  # log(1 + known contacts around the node, each by its nearness)
    CLEARANCE = 5  # of the robot, in steps of the local planner, clipped at 2
    DISTANCE = 6  # d_X to the goal, obstacles ignored, in units, clipped at 4
    GAP = 7  # remaining + excess, beyond the least of the tree, clipped at 2


COLUMN_NAMES: Final = tuple(column.name.lower() for column in ScorerColumn)


@dataclass(frozen=True)
class ScorerArchitecture:
    """Sizes of a node scorer.

    Attributes:
        hidden: Units of each layer.
        columns: Names of the columns that it sees, in order.

    Raises:
        InvalidInputError: A size that cannot be.
    """

    hidden: int = 32
    columns: tuple[str, ...] = COLUMN_NAMES

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(self.columns))
        if self.hidden < 1:
            raise InvalidInputError(f"node scorer: expected hidden >= 1, got {shown(self.hidden)}")

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of each tensor."""
        h, f = self.hidden, len(self.columns)
        return {
            "linear.weight": (1, f),
            "node.0.weight": (h, f),
            "node.0.bias": (h,),
            "node.1.weight": (h, h),
            "node.1.bias": (h,),
            "attention.weight": (1, h),
            "score.0.weight": (h, 3 * h),
            "score.0.bias": (h,),
            "score.1.weight": (1, h),
        }

    @classmethod
    def from_card(cls, entry: Any) -> ScorerArchitecture:
        """The architecture that a card names.

        Raises:
            StorageError: The entry is not one that this version can build, or has other columns.
        """
        built = weights.architecture(cls, entry, "node scorer")
        if built.columns != COLUMN_NAMES:
            raise StorageError(
                f"card: expected weights for the node columns {', '.join(COLUMN_NAMES)}; got weights for "
                f"{', '.join(map(str, built.columns))}"
            )
        return built


def plain_tensors(architecture: ScorerArchitecture) -> dict[str, NDArray[np.float32]]:
    """Tensors of a scorer that has learned nothing: the log of the target, if the field were true.

    Q is the softmin of (suboptimality + work remaining) / 0.1, both over the optimum; a failure takes a
    little away.
    """
    tensors = {name: np.zeros(shape, np.float32) for name, shape in architecture.shapes().items()}
    linear = tensors["linear.weight"][0]
    linear[[ScorerColumn.REMAINING, ScorerColumn.EXCESS]] = -10.0
    linear[ScorerColumn.FAILURES] = -1.0
    linear[ScorerColumn.CONTACTS] = -0.3
    return tensors


class ScorerModel:
    """A node scorer as numpy arrays, for inference.

    Args:
        architecture: Its sizes.
        tensors: Its tensors, named as in `ScorerArchitecture.shapes`.
    """

    def __init__(self, architecture: ScorerArchitecture, tensors: dict[str, NDArray[Any]]) -> None:
        self.architecture = architecture
        self._t = {
            name: np.ascontiguousarray(tensor.astype(np.float32).T) for name, tensor in tensors.items()
        }
        self._plain = not (self._t["score.1.weight"].any())

    def logits(self, columns: NDArray[np.float32]) -> NDArray[np.float32]:
        """(n,) logits of nodes from their columns (n, F)."""
        t, h = self._t, self.architecture.hidden
        linear = (columns @ t["linear.weight"])[:, 0]
        if self._plain:
            return np.asarray(linear)
        hidden = np.maximum(columns @ t["node.0.weight"] + t["node.0.bias"], 0)
        hidden = np.maximum(hidden @ t["node.1.weight"] + t["node.1.bias"], 0)
        attention = (hidden @ t["attention.weight"])[:, 0]
        attention = np.exp(attention - attention.max())
        summary = np.concatenate([attention @ hidden / attention.sum(), hidden.max(axis=0)])
        weight = t["score.0.weight"]
        mixed = np.maximum(hidden @ weight[:h] + (summary @ weight[h:] + t["score.0.bias"]), 0)
        return np.asarray(linear + (mixed @ t["score.1.weight"])[:, 0])
