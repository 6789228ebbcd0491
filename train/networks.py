"""The torch modules behind learned guidance, for training; `field` and `scorer` run the same in numpy.

Import this module on demand only: torch comes with the extra ``[train]``.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from guided_gym.guidance.learned.field import LAYERS, ROOM_COLUMNS, FieldArchitecture
from guided_gym.guidance.learned.scorer import ScorerArchitecture, plain_tensors


class Layers(nn.Module):
    """Linear layers of these sizes with the positive part between them: (..., first) to (...)."""

    def __init__(self, *sizes: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList([nn.Linear(a, b) for a, b in pairwise(sizes)])

    def forward(self, x: Tensor) -> Tensor:
        """The one number of each row."""
        for layer in self.layers[:-1]:
            x = torch.relu(layer(x))
        out: Tensor = self.layers[-1](x)
        return out[..., 0]

    def tensors(self, names: tuple[str, ...]) -> dict[str, NDArray[Any]]:
        """Its weights and biases, under these names."""
        found: dict[str, NDArray[Any]] = {}
        for name, layer in zip(names, self.layers, strict=True):
            found[f"{name}.weight"] = layer.weight.detach().numpy().copy()  # type: ignore[operator, union-attr]
            found[f"{name}.bias"] = layer.bias.detach().numpy().copy()  # type: ignore[operator, union-attr]
        return found

    def load(self, names: tuple[str, ...], tensors: dict[str, NDArray[Any]]) -> None:
        """Take in what `tensors` gave."""
        with torch.no_grad():
            for name, layer in zip(names, self.layers, strict=True):
                layer.weight.copy_(torch.from_numpy(tensors[f"{name}.weight"]))  # type: ignore[operator, union-attr]
                layer.bias.copy_(torch.from_numpy(tensors[f"{name}.bias"]))  # type: ignore[operator, union-attr]


class Encoder(Layers):
    """How free each pose seems: (..., columns) to (...) logits; columns as in `ROOM_COLUMNS`."""

    def __init__(self, architecture: FieldArchitecture) -> None:
        super().__init__(len(ROOM_COLUMNS), architecture.hidden, 1)


class Decoder(nn.Module):
    """What to add to the wave's arrival: (b, layers * T + 1, n, n) to (b, T, n, n), in sides of the square.

    A U-Net of three resolutions; zero at first.
    """

    def __init__(self, architecture: FieldArchitecture) -> None:
        super().__init__()
        a, b, c = architecture.widths
        turns = architecture.headings
        self.stem = nn.Conv2d(4 * (len(LAYERS) * turns + 1), a, 1)
        self.fine = nn.Conv2d(a, a, 3, padding=1)
        self.down1 = nn.Conv2d(4 * a, b, 1)
        self.middle = nn.Conv2d(b, b, 3, padding=1)
        self.down2 = nn.Conv2d(4 * b, c, 1)
        self.coarse = nn.Conv2d(c, c, 3, padding=1)
        self.up1 = nn.Conv2d(c + b, b, 1)
        self.middle_up = nn.Conv2d(b, b, 3, padding=1)
        self.up2 = nn.Conv2d(b + a, a, 1)
        self.fine_up = nn.Conv2d(a, a, 3, padding=1)
        self.head = nn.Conv2d(a, 4 * turns, 1)
        nn.init.zeros_(self.head.weight)
        assert self.head.bias is not None
        nn.init.zeros_(self.head.bias)

    def forward(self, layers: Tensor) -> Tensor:
        """The correction."""

        def layer(module: nn.Conv2d, x: Tensor) -> Tensor:
            return functional.relu(module(x))

        fine = layer(self.fine, layer(self.stem, functional.pixel_unshuffle(layers, 2)))
        middle = layer(self.middle, layer(self.down1, functional.pixel_unshuffle(fine, 2)))
        coarse = layer(self.coarse, layer(self.down2, functional.pixel_unshuffle(middle, 2)))
        middle = layer(self.middle_up, layer(self.up1, torch.cat([_double(coarse), middle], 1)))
        fine = layer(self.fine_up, layer(self.up2, torch.cat([_double(middle), fine], 1)))
        out: Tensor = functional.pixel_shuffle(self.head(fine), 2)
        return out


def _double(x: Tensor) -> Tensor:
    out: Tensor = functional.interpolate(x, scale_factor=2, mode="nearest")
    return out


class NodeScorer(nn.Module):
    """Logits over nodes from their columns (see `ScorerColumn`), masked.

    Begins as the log of the target, were the field the truth (`scorer.plain_tensors`).
    """

    def __init__(self, architecture: ScorerArchitecture) -> None:
        super().__init__()
        h, f = architecture.hidden, len(architecture.columns)
        self.linear = nn.Linear(f, 1, bias=False)
        self.node = nn.ModuleList([nn.Linear(f, h), nn.Linear(h, h)])
        self.attention = nn.Linear(h, 1, bias=False)
        self.score = nn.ModuleList([nn.Linear(3 * h, h), nn.Linear(h, 1, bias=False)])
        with torch.no_grad():
            self.linear.weight.copy_(torch.from_numpy(plain_tensors(architecture)["linear.weight"]))
            self.score[1].weight.zero_()  # type: ignore[operator, union-attr]

    def forward(self, columns: Tensor, mask: Tensor) -> Tensor:
        """(b, n) logits from columns (b, n, F); minus infinity where the mask (b, n) is False."""
        hidden = torch.relu(self.node[1](torch.relu(self.node[0](columns))))
        absent = ~mask[..., None]
        attention = torch.softmax(self.attention(hidden).masked_fill(absent, -torch.inf), dim=1)
        pooled = (attention * hidden).sum(1)
        largest = hidden.masked_fill(absent, -torch.inf).amax(1)
        summary = torch.cat([pooled, largest], -1)[:, None].expand(-1, hidden.shape[1], -1)
        mixed = torch.relu(self.score[0](torch.cat([hidden, summary], -1)))
        logits = (self.linear(columns) + self.score[1](mixed))[..., 0]
        out: Tensor = logits.masked_fill(~mask, -torch.inf)
        return out


_ENCODER = "layers."
_FIELD_ENCODER = "encoder."


def field_tensors(encoder: Encoder, decoder: Decoder) -> dict[str, NDArray[Any]]:
    """The tensors of a field network, named as in `FieldArchitecture.shapes`."""
    tensors = {name.replace(_ENCODER, _FIELD_ENCODER): _numpy(t) for name, t in encoder.state_dict().items()}
    tensors.update({name: _numpy(t) for name, t in decoder.state_dict().items()})
    return tensors


def load_field(encoder: Encoder, decoder: Decoder, tensors: dict[str, NDArray[Any]]) -> None:
    """Put the tensors of a field network into its modules."""
    parts = {name: torch.from_numpy(np.asarray(t, np.float32)) for name, t in tensors.items()}
    encoder.load_state_dict(
        {n.replace(_FIELD_ENCODER, _ENCODER): t for n, t in parts.items() if n.startswith(_FIELD_ENCODER)}
    )
    decoder.load_state_dict({n: t for n, t in parts.items() if not n.startswith(_FIELD_ENCODER)})


def scorer_tensors(scorer: NodeScorer) -> dict[str, NDArray[Any]]:
    """The tensors of a node scorer, named as in `ScorerArchitecture.shapes`."""
    return {name: _numpy(t) for name, t in scorer.state_dict().items()}


def load_scorer(scorer: NodeScorer, tensors: dict[str, NDArray[Any]]) -> None:
    """Put tensors into a node scorer."""
    scorer.load_state_dict({name: torch.from_numpy(np.asarray(t, np.float32)) for name, t in tensors.items()})


def _numpy(tensor: Tensor) -> NDArray[Any]:
    return tensor.detach().cpu().numpy().astype(np.float32)


def adam(module: nn.Module, rate: float, steps: int) -> tuple[torch.optim.Optimizer, Any]:
    """AdamW, and the schedule by which its rate falls to nothing along a cosine."""
    optimizer = torch.optim.AdamW(module.parameters(), rate, weight_decay=1e-4)
    return optimizer, torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(steps, 1))


def descend(loss: Tensor, optimizer: torch.optim.Optimizer, schedule: Any = None) -> float:
    """One step down the gradient of a loss; the loss as a number."""
    optimizer.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimizer.step()
    if schedule is not None:
        schedule.step()
    return float(loss.detach())
