"""The field network: workspace, robot and goal in, a cost-to-go field over (x, y[, theta]) out.

Three parts. An *encoder* says of each pose of a grid how free it seems, from the room that the robot has in
the rasterised workspace. A *wave* runs outwards from the goal, slowly where poses seem blocked (the planning
layer, as in value-iteration networks). A *decoder*, a small U-Net, corrects the wave's arrival times. The
field is evaluated once per problem and looked up at nodes. Here all of it is numpy; `networks` has the torch
modules that train it. No pose or motion is checked for collision.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.errors import InvalidInputError
from guided_gym.guidance.learned import weights
from guided_gym.guidance.solvers.wave import Arrivals, Field, FloatArray, PoseGrid, WaveModel
from guided_gym.kernels import fields, marching
from guided_gym.kernels.fields import CLIP, LEAST

ROOM_COLUMNS: Final = ("room", "room before", "room after", "workspace room")
"""What the encoder sees of a pose: room in cells at its heading and the two beside it, and of a point."""
LAYERS: Final = ("room", "detour", "wave")
"""What the decoder sees, one channel per heading each; "workspace room" comes behind them."""
_DETOUR_CLIP: Final = 4.0


@dataclass(frozen=True)
class FieldArchitecture:
    """Sizes of a field network; all that its tensors' shapes depend on.

    Attributes:
        cells: Cells along each side of the raster, divisible by 8.
        headings: Headings of the grid, divisible by 4.
        hidden: Units of the encoder.
        widths: Channels of the decoder at 1/2, 1/4 and 1/8 of the raster.
        blocked: How many times slower the wave is at most, where a pose is surely blocked.
        planning: Whether there is a wave; without, the decoder corrects the goal's distance d_X.

    Raises:
        InvalidInputError: A size that cannot be.
    """

    cells: int = 56
    headings: int = 16
    hidden: int = 8
    widths: tuple[int, int, int] = (48, 64, 96)
    blocked: float = 300.0
    planning: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "widths", tuple(self.widths))
        if self.cells < 8 or self.cells % 8 or self.headings < 4 or self.headings % 4:
            raise InvalidInputError(
                f"field network: expected cells divisible by 8 and headings by 4, got {self.cells} and "
                f"{self.headings}"
            )
        if self.hidden < 1 or len(self.widths) != 3 or min(self.widths) < 1 or not self.blocked > 0:
            raise InvalidInputError(f"field network: expected positive sizes, got {self}")

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of each tensor."""
        a, b, c = self.widths
        seen = 4 * (len(LAYERS) * self.headings + 1)
        sizes = {
            "encoder.0": (self.hidden, len(ROOM_COLUMNS)),
            "encoder.1": (1, self.hidden),
            "stem": (a, seen, 1, 1),
            "fine": (a, a, 3, 3),
            "down1": (b, 4 * a, 1, 1),
            "middle": (b, b, 3, 3),
            "down2": (c, 4 * b, 1, 1),
            "coarse": (c, c, 3, 3),
            "up1": (b, c + b, 1, 1),
            "middle_up": (b, b, 3, 3),
            "up2": (a, b + a, 1, 1),
            "fine_up": (a, a, 3, 3),
            "head": (4 * self.headings, a, 1, 1),
        }
        shapes: dict[str, tuple[int, ...]] = {}
        for name, size in sizes.items():
            shapes[f"{name}.weight"] = size
            shapes[f"{name}.bias"] = size[:1]
        return shapes

    @classmethod
    def from_card(cls, entry: Any) -> FieldArchitecture:
        """The architecture that a card names.

        Raises:
            StorageError: The entry is not one that this version can build.
        """
        return weights.architecture(cls, entry, "field network")


def plain_tensors(architecture: FieldArchitecture) -> dict[str, Field]:
    """Tensors of a field network that has learned nothing: poses with room are free; the wave is the field.

    Raises:
        InvalidInputError: An encoder of fewer than two units.
    """
    if architecture.hidden < 2:
        raise InvalidInputError(f"field network: expected hidden >= 2, got {architecture.hidden}")
    tensors = {name: np.zeros(shape, np.float32) for name, shape in architecture.shapes().items()}
    tensors["encoder.0.weight"][:2, 0] = 1, -1
    tensors["encoder.1.weight"][0, :2] = 60, -60
    return tensors


def encoder_columns(grid: PoseGrid) -> Field:
    """(n * n * T, columns) what the encoder sees, as in `ROOM_COLUMNS`."""
    room = np.clip(grid.room, LEAST, CLIP)
    point = np.broadcast_to(np.clip(grid.workspace, LEAST, CLIP)[..., None], room.shape)
    stacked = np.stack([room, np.roll(room, 1, 2), np.roll(room, -1, 2), point], axis=-1)
    return stacked.reshape(-1, len(ROOM_COLUMNS))


class FieldModel(WaveModel):
    """A field network as numpy arrays, for inference.

    Args:
        architecture: Its sizes.
        tensors: Its tensors, named as in `FieldArchitecture.shapes`.
        corrected: Whether the decoder corrects the wave; without, the wave alone is the field. A decoder that
            has not been trained is left out in any case: its last layer is zero.
    """

    def __init__(
        self, architecture: FieldArchitecture, tensors: dict[str, NDArray[Any]], *, corrected: bool = True
    ) -> None:
        super().__init__(architecture.cells, architecture.headings, architecture.blocked)
        self.architecture = architecture
        self.plans, self.whole = architecture.planning, True
        self._tensors = {name: _as_matrix(tensor) for name, tensor in tensors.items()}
        self._corrects = corrected and any(self._tensors[f"head.{part}"].any() for part in ("weight", "bias"))

    def free(self, grid: PoseGrid) -> Field:
        """(n, n, T) logit of each pose being free, by the encoder."""
        first, bias = self._tensors["encoder.0.weight"], self._tensors["encoder.0.bias"]
        last = self._tensors["encoder.1.weight"][:, 0].copy()
        offset = float(self._tensors["encoder.1.bias"][0])
        return fields.free_logits(grid.room, grid.workspace, first, bias, last, offset)

    def slowness(self, grid: PoseGrid) -> Field:
        """(n, n, T) 1/p: the expected number of tries."""
        tries = 1 + np.exp(np.minimum(-self.free(grid), 30))
        return np.asarray(np.minimum(tries, self.blocked).astype(np.float32))

    def begin(self, grid: PoseGrid, goal: FloatArray, start: FloatArray | None = None) -> Arrivals:
        """A wave that has run; the decoder's output stands until costs rise."""
        found = super().begin(grid, goal)
        if start is not None:
            values = np.abs(self.field(found).values)
            found.front.known[:] = marching.bordered(values, np.inf)
        return found

    def arrival(self, found: Arrivals) -> Field:
        """(n, n, T) when the wave from the goal arrives."""
        if self.plans:
            return super().arrival(found)
        n, _, turns = found.grid.room.shape
        return fields.goal_distances(n, turns, found.frame)

    def corrected(self, grid: PoseGrid, frame: FloatArray, arrival: Field) -> Field:
        """(n, n, T) cost-to-go from the arrival, by the decoder."""
        if not self._corrects:
            return arrival
        return np.asarray(
            arrival + np.float32(grid.side) * self.correction(decoder_input(grid, frame, arrival))
        )

    def correction(self, layers: Field) -> Field:
        """(n, n, T) what the decoder adds, in sides of the square, from `decoder_input`.

        For a robot that cannot turn the decoder sees T equal headings, and their mean is taken.
        """
        turns = self.architecture.headings
        flat = (layers.shape[-1] - 1) // len(LAYERS) == 1
        if flat:
            layers = np.concatenate([np.repeat(layers[..., :-1], turns, axis=-1), layers[..., -1:]], axis=-1)
        fine = self._conv(self._dense(_unshuffle(layers), "stem"), "fine")
        middle = self._conv(self._dense(_unshuffle(fine), "down1"), "middle")
        coarse = self._conv(self._dense(_unshuffle(middle), "down2"), "coarse")
        middle = self._conv(self._dense(np.concatenate([_double(coarse), middle], -1), "up1"), "middle_up")
        fine = self._conv(self._dense(np.concatenate([_double(middle), fine], -1), "up2"), "fine_up")
        out = _shuffle(fine @ self._tensors["head.weight"] + self._tensors["head.bias"])
        return np.asarray(out.mean(axis=-1, keepdims=True)) if flat else out

    def _dense(self, x: Field, name: str) -> Field:
        return np.asarray(np.maximum(x @ self._tensors[f"{name}.weight"] + self._tensors[f"{name}.bias"], 0))

    def _conv(self, x: Field, name: str) -> Field:
        """3 x 3 convolution with zeros around, then the positive part."""
        n, _, c = x.shape
        padded = np.zeros((n + 2, n + 2, c), np.float32)
        padded[1:-1, 1:-1] = x
        patches = np.empty((n, n, 9, c), np.float32)
        for k in range(9):
            patches[:, :, k] = padded[k // 3 : k // 3 + n, k % 3 : k % 3 + n]
        out = patches.reshape(n * n, 9 * c) @ self._tensors[f"{name}.weight"]
        return np.asarray(np.maximum(out + self._tensors[f"{name}.bias"], 0).reshape(n, n, -1))


def decoder_input(grid: PoseGrid, frame: FloatArray, arrival: Field) -> Field:
    """(n, n, layers * T + 1) what the decoder sees, as in `LAYERS`."""
    n, _, turns = arrival.shape
    side = np.float32(grid.side)
    straight = fields.goal_distances(n, turns, frame)
    layers = (
        np.clip(grid.room, LEAST, CLIP) / CLIP,
        np.minimum((arrival - straight) / side, _DETOUR_CLIP),
        np.minimum(arrival / side, _DETOUR_CLIP),
        np.clip(grid.workspace, LEAST, CLIP)[..., None] / CLIP,
    )
    return np.concatenate(layers, axis=-1).astype(np.float32)


def _as_matrix(tensor: NDArray[Any]) -> Field:
    """Torch's (out, in) and (out, in, k, k) as (in, out) and (k * k * in, out); vectors as they are."""
    tensor = tensor.astype(np.float32)
    if tensor.ndim == 4:
        tensor = tensor.transpose(2, 3, 1, 0).reshape(-1, tensor.shape[0])
    elif tensor.ndim == 2:
        tensor = tensor.T
    return np.ascontiguousarray(tensor)


def _unshuffle(x: Field) -> Field:
    """(n, n, c) to (n / 2, n / 2, 4 c), channels ordered as by torch's pixel_unshuffle."""
    n, _, c = x.shape
    parts: Field = x.reshape(n // 2, 2, n // 2, 2, c).transpose(0, 2, 4, 1, 3)
    return np.asarray(parts.reshape(n // 2, n // 2, 4 * c))


def _shuffle(x: Field) -> Field:
    """The inverse of `_unshuffle`."""
    n, _, c = x.shape
    parts = x.reshape(n, n, c // 4, 2, 2).transpose(0, 3, 1, 4, 2)
    return np.asarray(parts.reshape(2 * n, 2 * n, c // 4))


def _double(x: Field) -> Field:
    return x.repeat(2, axis=0).repeat(2, axis=1)
