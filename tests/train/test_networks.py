"""The torch modules and their numpy twins say the same; masks and padding change nothing."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from guided_gym.guidance.learned.field import FieldArchitecture, FieldModel  # noqa: E402
from guided_gym.guidance.learned.scorer import ScorerArchitecture, ScorerColumn, ScorerModel  # noqa: E402
from guided_gym.train import networks  # noqa: E402

FIELD = FieldArchitecture(cells=16, headings=4, widths=(8, 12, 16))
SCORER = ScorerArchitecture(hidden=16)


@pytest.fixture(autouse=True)
def one_thread() -> None:
    torch.set_num_threads(1)
    torch.manual_seed(0)


def shaken(module: torch.nn.Module) -> torch.nn.Module:
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))
    return module


def test_tensors_have_the_names_and_shapes_of_the_architecture() -> None:
    field = networks.field_tensors(networks.Encoder(FIELD), networks.Decoder(FIELD))
    assert {name: t.shape for name, t in field.items()} == FIELD.shapes()
    scorer = networks.scorer_tensors(networks.NodeScorer(SCORER))
    assert {name: t.shape for name, t in scorer.items()} == SCORER.shapes()


def test_the_decoder_in_numpy_is_the_one_in_torch() -> None:
    encoder, decoder = networks.Encoder(FIELD), shaken(networks.Decoder(FIELD))
    model = FieldModel(FIELD, networks.field_tensors(encoder, decoder))
    layers = np.random.default_rng(0).standard_normal((16, 16, 13)).astype(np.float32)
    with torch.no_grad():
        expected = decoder(torch.from_numpy(layers.transpose(2, 0, 1).copy())[None])[0].numpy()
    assert np.allclose(model.correction(layers), expected.transpose(1, 2, 0), atol=1e-4)


def test_tensors_put_back_give_the_same_modules() -> None:
    first = shaken(networks.Encoder(FIELD)), shaken(networks.Decoder(FIELD))
    second = networks.Encoder(FIELD), networks.Decoder(FIELD)
    tensors = networks.field_tensors(*first)
    networks.load_field(*second, tensors)
    again = networks.field_tensors(*second)
    assert all(np.array_equal(tensors[name], again[name]) for name in tensors)


def scores(model: networks.NodeScorer, columns: np.ndarray, padding: int = 0) -> np.ndarray:
    n = len(columns)
    padded = np.full((1, n + padding, columns.shape[1]), 7.0, np.float32)
    padded[0, :n] = columns
    mask = np.arange(n + padding)[None] < n
    with torch.no_grad():
        out = model(torch.from_numpy(padded), torch.from_numpy(mask))[0].numpy()
    assert np.isneginf(out[n:]).all()
    return out[:n]


@pytest.mark.parametrize("nodes", [1, 40, 160])
def test_the_scorer_in_numpy_is_the_one_in_torch__padded_or_not(nodes: int) -> None:
    module = shaken(networks.NodeScorer(SCORER))
    model = ScorerModel(SCORER, networks.scorer_tensors(module))
    columns = np.random.default_rng(0).random((nodes, len(ScorerColumn)), np.float32)
    expected = scores(module, columns)
    assert np.allclose(model.logits(columns), expected, atol=1e-4)
    assert np.allclose(scores(module, columns, padding=25), expected, atol=1e-4)


def test_scores_move_with_the_nodes() -> None:
    module = shaken(networks.NodeScorer(SCORER))
    columns = np.random.default_rng(0).random((30, len(ScorerColumn)), np.float32)
    order = np.random.default_rng(1).permutation(30)
    assert np.allclose(scores(module, columns[order]), scores(module, columns)[order], atol=1e-4)
