"""A tenth of the campaign, and that it finds what it looks for."""

from __future__ import annotations

import pickle
import sys
from pathlib import Path

import numpy as np
import pytest

import guided_gym as gg

pytest.importorskip("mpmath")
pytest.importorskip("torch")
sys.path.append(str(Path(__file__).resolve().parents[2]))  # last: the installed package comes first

from faults import api, files, references
from faults.__main__ import table
from faults.tally import Overtime, Tally, limited

PARTS = (
    references.motions,
    references.numbers,
    references.distances,
    references.proofs,
    references.trees,
    files.mutate,
)


@pytest.mark.parametrize("part", PARTS, ids=lambda part: part.__name__)
def test_a_tenth_of_the_campaign_finds_nothing(part, record_property):
    seed = 1  # the campaign itself draws others, each night
    record_property("seed", seed)
    tallies = part(seed, 0.1)
    assert all(tally.tried for tally in tallies)
    assert not [failure for tally in tallies for failure in tally.failures]


def test_calls_raise_no_errors_but_ours():
    """A fortieth of the calls: each public function and method once or twice."""
    seed = 1
    tally = api.fuzz(seed, 0.025)[0]
    assert tally.tried > 100
    assert not tally.failures, f"seed {seed}"


def test_a_wrongly_free_motion_is_found(monkeypatch):
    monkeypatch.setattr(gg.ConfigurationSpace, "motions_free", lambda self, a, b: np.ones(len(a), bool))
    free, _ = references.motions(0, 0.01)
    assert free.failures


def test_a_wrong_number_is_found(monkeypatch):
    monkeypatch.setattr(references.gg, "target", lambda delta, tau, scale: np.full(len(tau), 1 / len(tau)))
    assert references.numbers(0, 0.05)[0].failures


def test_another_tree_is_found(monkeypatch):
    seeds = iter(range(100))
    monkeypatch.setattr(references, "_tree", lambda problem, guidance, seed: next(seeds))
    [tally] = references.trees(0, 0.01)
    assert len(tally.failures) == tally.tried > 0


def test_another_error_than_ours_and_a_hang_are_found(tmp_path):
    def breaks(path: Path) -> None:
        raise KeyError("x")

    assert "KeyError" in str(files.trouble(breaks, tmp_path))
    with pytest.raises(Overtime), limited(0.05):
        while True:
            pass


def test_damage_that_is_taken_for_sound_is_found(tmp_path):
    file = tmp_path / "some"
    file.write_bytes(b"another")
    assert "something else" in str(files.trouble(Path.read_bytes, file, pickle.dumps(b"one")))
    assert files.trouble(Path.read_bytes, file, pickle.dumps(b"another")) is None


def test_the_table_says_what_was_tried():
    tally = Tally("kills", "nothing is lost", note="needs a disk")
    tally.check(False, "here")
    assert "| kills | nothing is lost | none: needs a disk | 1 | 0 |" in table([tally])
