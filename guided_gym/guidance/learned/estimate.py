"""The cost-to-go network: how much longer the way to the goal is than the straight line; numpy inference.

It sees both configurations, and the room on the straight motion between them, in a raster of the workspace.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import integer
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.belief import BeliefArchitecture, scene_of
from guided_gym.guidance.learned.weights import Tensors
from guided_gym.kernels.belief import Scene, rooms_along

Floats = NDArray[np.float64]
Field = NDArray[np.float32]

LOOKS: Final = 9  # configurations from a state to the goal, both included
_FAR: Final = 20.0  # natural lengths: what the distance is divided by


@dataclass(frozen=True)
class EstimateArchitecture:
    """Sizes of a cost-to-go network.

    Attributes:
        columns: What it sees of a state: `columns_of` says how many these are.
        hidden: Units of each of two layers.

    Raises:
        InvalidInputError: A size that cannot be.
    """

    columns: int
    hidden: int = 48

    def __post_init__(self) -> None:
        integer("columns", self.columns, least=1)
        integer("hidden", self.hidden, least=1)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of each tensor."""
        h = self.hidden
        sizes = {"0": (h, self.columns), "1": (h, h), "2": (1, h)}
        shapes: dict[str, tuple[int, ...]] = {}
        for name, size in sizes.items():
            shapes[f"{name}.weight"], shapes[f"{name}.bias"] = size, size[:1]
        return shapes

    @classmethod
    def from_card(cls, entry: Any) -> EstimateArchitecture:
        """The architecture that a card names.

        Raises:
            StorageError: The entry is not one that this version can build.
        """
        return weights.architecture(cls, entry, "cost-to-go network")


def columns_of(space: ConfigurationSpace, scene: Scene, states: Floats, goal: Floats) -> Field:
    """(n, columns) what the network sees of states (n, d): distance, angles, room on the straight line."""
    states = np.ascontiguousarray(states)
    n, ends = len(states), np.repeat(goal[None], len(states), axis=0)
    rooms = rooms_along(states, ends, LOOKS, scene, space.metric).reshape(n, -1)
    change = np.atleast_2d(space.difference(states, goal))
    spread = space.distance(states, goal)[:, None] / (_FAR * space.scale)
    turned = [f(x) for x in (states, ends) for f in (np.sin, np.cos)]
    return np.hstack([spread, change, *turned, rooms]).astype(np.float32)


def column_count(space: ConfigurationSpace) -> int:
    """How many columns `columns_of` has for the robot of a space."""
    bodies = len(getattr(space.robot, "bodies", (None,)))
    return 1 + 5 * space.dimension + LOOKS * (bodies + 1)


class EstimateModel:
    """A cost-to-go network, for inference.

    Args:
        architecture: Its sizes.
        tensors: Its tensors, named as in `EstimateArchitecture.shapes`.
    """

    def __init__(self, architecture: EstimateArchitecture, tensors: Tensors) -> None:
        self.architecture = architecture
        self._t = {name: np.ascontiguousarray(t.astype(np.float32).T) for name, t in tensors.items()}

    def excess(self, columns: Field) -> Floats:
        """(n,) by what part the way is longer than the straight line, >= 0."""
        t = self._t
        hidden = np.maximum(columns @ t["0.weight"] + t["0.bias"], 0)
        hidden = np.maximum(hidden @ t["1.weight"] + t["1.bias"], 0)
        out = (hidden @ t["2.weight"] + t["2.bias"])[:, 0].astype(np.float64)
        return np.asarray(np.logaddexp(0.0, out))


class Estimate:
    """What the network takes for the cost-to-go in one space, to one goal.

    Attributes:
        looks: Configurations that were looked at in the raster.
    """

    def __init__(self, model: EstimateModel, belief: BeliefArchitecture, space: ConfigurationSpace) -> None:
        self._model, self.space, self.looks = model, space, 0
        self._scene = scene_of(space, belief)

    def costs(self, states: Floats, goal: Floats) -> Floats:
        """(n,) cost-to-go of states (n, d) (length)."""
        self.looks += LOOKS * len(states)
        columns = columns_of(self.space, self._scene, states, goal)
        straight: Floats = np.asarray(self.space.distance(states, goal))
        return straight * (1.0 + self._model.excess(columns))
