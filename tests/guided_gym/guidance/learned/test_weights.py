"""Agents' files: round trips, and refusals before anything starts."""

from __future__ import annotations

import json
import pickle
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.agent import LearnedAgent
from guided_gym.guidance.learned.field import FieldArchitecture
from guided_gym.guidance.learned.scorer import ScorerArchitecture
from guided_gym.guidance.registry import make_guidance


@settings(max_examples=25)
@given(
    st.dictionaries(
        st.text("abc.", min_size=1, max_size=4),
        hnp.arrays(
            st.sampled_from([np.float16, np.float32, np.float64, np.int32, np.int64, np.uint8]),
            hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
        ),
        max_size=4,
    )
)
def test_tensors_come_back(tensors: dict[str, np.ndarray]) -> None:
    found = weights.unpack_tensors(weights.pack_tensors(tensors))
    assert found.keys() == tensors.keys()
    for name, tensor in tensors.items():
        assert found[name].dtype == tensor.dtype
        assert found[name].shape == tensor.shape
        assert found[name].tobytes() == tensor.tobytes()


def test_views_come_back_as_they_are() -> None:
    """The package alone stores other values of them."""
    whole = np.arange(12.0).reshape(3, 4)
    views = {"turned": whole.T, "every other": whole[:, ::2], "foreign": whole.astype(">f8")}
    found = weights.unpack_tensors(weights.pack_tensors(views))
    assert all(np.array_equal(found[name], view) for name, view in views.items())
    assert all(tensor.flags.writeable for tensor in found.values())


def test_unsupported_types_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="complex"):
        weights.pack_tensors({"a": np.zeros(2, np.complex128)})


class Bomb:
    def __reduce__(self) -> tuple[object, ...]:
        return pytest.fail, ("a pickle was loaded",)


def spoiled(data: bytes) -> dict[str, bytes]:
    header = json.dumps({"a": {"dtype": "F32", "shape": [2], "data_offsets": [0, 999]}}).encode()
    return {
        "empty": b"",
        "a few bytes": b"abc",
        "truncated": data[:-5],
        "longer": data + b"more",
        "half a header": data[:20],
        "a pickle": pickle.dumps(Bomb()),
        "a zip": b"PK\x03\x04" + data,
        "no JSON": (12).to_bytes(8, "little") + b"not json at all",
        "a list": (2).to_bytes(8, "little") + b"[]",
        "offsets beyond the end": len(header).to_bytes(8, "little") + header + bytes(8),
        "a huge header": (2**60).to_bytes(8, "little") + data,
    }


@pytest.mark.parametrize("how", list(spoiled(b"")))
def test_spoiled_files_are_refused(how: str) -> None:
    data = weights.pack_tensors({"a": np.ones(4, np.float32)})
    with pytest.raises(StorageError, match=r"expected|damaged"):
        weights.unpack_tensors(spoiled(data)[how], "weights.safetensors")


def test_an_agent_comes_back(agent_folder: Path) -> None:
    agent = LearnedAgent.load(agent_folder)
    assert agent.card["name"] == "plain"
    assert agent.field.architecture == FieldArchitecture(cells=24, headings=8)


def change_card(folder: Path, **entries: object) -> None:
    card = json.loads((folder / weights.CARD_FILE).read_text())
    card.update(entries)
    (folder / weights.CARD_FILE).write_text(json.dumps(card))


def test_weights_for_other_columns_are_refused(agent_folder: Path) -> None:
    change_card(agent_folder, scorer=asdict(ScorerArchitecture(columns=("remaining", "age"))))
    with pytest.raises(StorageError, match=r"expected weights for the node columns remaining, excess.*age"):
        make_guidance(f"learned:{agent_folder}")


def test_weights_of_another_size_are_refused(agent_folder: Path) -> None:
    change_card(agent_folder, scorer=asdict(ScorerArchitecture(hidden=7)))
    with pytest.raises(StorageError, match=r"scorer\.node\.0.*shape \(7, 8\), got \(32, 8\)"):
        make_guidance(f"learned:{agent_folder}")


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"format": 99}, "card format 1, got 99"),
        ({"kind": "recipe"}, "card of a guided-gym agent"),
        ({"field": {"wings": 2}}, "sizes of a field network"),
        ({"field": {"cells": 3}}, "sizes of a field network"),
        ({"scorer": []}, "sizes of a node scorer"),
        ({"weights_sha256": "0"}, "sha256"),
    ],
)
def test_cards_that_do_not_match_are_refused(
    agent_folder: Path, entries: dict[str, object], message: str
) -> None:
    change_card(agent_folder, **entries)
    with pytest.raises(StorageError, match=message):
        make_guidance(f"learned:{agent_folder}")


def test_files_that_are_not_there_or_not_ours_are_refused(agent_folder: Path) -> None:
    file = agent_folder / weights.WEIGHTS_FILE
    file.write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(StorageError, match="pickle"):
        make_guidance(f"learned:{agent_folder}")
    file.unlink()
    with pytest.raises(StorageError, match="weights at"):
        make_guidance(f"learned:{agent_folder}")
    (agent_folder / weights.CARD_FILE).write_text("{")
    with pytest.raises(StorageError, match="expected JSON"):
        make_guidance(f"learned:{agent_folder}")


def test_nan_in_weights_is_refused(agent_folder: Path) -> None:
    card, tensors = weights.load_agent(agent_folder)
    tensors["scorer.linear.weight"][0, 0] = np.nan
    weights.save_agent(agent_folder, card, tensors)
    with pytest.raises(StorageError, match="finite"):
        make_guidance(f"learned:{agent_folder}")
