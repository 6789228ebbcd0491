"""Train, validation and test problems: never the same ones, and each has a number."""

from __future__ import annotations

import itertools

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.catalogue.distributions import ProblemList
from guided_gym.catalogue.splits import SPLITS, TEST, TRAIN, Split, in_split, problem_seed
from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.problems import Problem
from guided_gym.randomness import streams

NAME = "RandomSimplePassage"


def test_splits__never_overlap():
    for a, b in itertools.combinations(SPLITS.values(), 2):
        assert a.first + a.size <= b.first or b.first + b.size <= a.first
    assert all(s.first >= 0 and s.first + s.size <= 2**31 for s in SPLITS.values())


@settings(max_examples=50)
@given(st.sampled_from(sorted(SPLITS)), st.sampled_from(sorted(SPLITS)), st.data())
def test_problem_seed__is_another_for_each_problem(a, b, data):
    i, j = (data.draw(st.integers(0, SPLITS[name].size - 1)) for name in (a, b))
    assert (problem_seed(a, i) == problem_seed(b, j)) == ((a, i) == (b, j))


def test_train_seeds_count_from_0():
    assert [problem_seed("train", i) for i in range(3)] == [0, 1, 2]
    assert list(TEST.seeds(5, 2)) == [problem_seed("test", 5), problem_seed(TEST, 6)]
    assert list(Split("short", 7, 3).seeds()) == [7, 8, 9]


@pytest.mark.parametrize("index", [-1, TRAIN.size])
def test_problem_seed__refuses_what_is_not_there(index):
    with pytest.raises(InvalidInputError, match=f"got {index}"):
        problem_seed("train", index)
    with pytest.raises(UnknownNameError, match="did you mean 'train'"):
        problem_seed("trian", 0)


def test_in_split__numbers_the_problems_of_the_split_s_seeds():
    distribution = make_distribution(NAME)
    test = in_split(distribution, "test")
    assert isinstance(test, ProblemList) and len(test) == TEST.size
    expected = distribution.problem(problem_seed("test", 3))
    assert test[3].fingerprint == test.problem(3).fingerprint == expected.fingerprint
    assert test.problem(3 + TEST.size).fingerprint == expected.fingerprint
    assert in_split(distribution, "train")[3].fingerprint != expected.fingerprint


def test_in_split__leaves_fixed_problems_alone_and_splits_once():
    cup = make_distribution("Cup")
    assert in_split(cup, "test") is cup
    train = in_split(make_distribution(NAME), "train")
    assert in_split(train, "train") is train
    with pytest.raises(InvalidInputError, match="no other split"):
        in_split(train, "test")


def test_names__may_end_in_a_split():
    named = make_distribution(f"{NAME}@validation")
    assert named.name == f"{NAME}@validation"
    expected = in_split(make_distribution(NAME), "validation").problem(0)
    assert named.problem(0).fingerprint == expected.fingerprint
    with pytest.raises(UnknownNameError, match="split"):
        make_distribution(f"{NAME}@tset")


def test_environment__poses_the_split_s_problems():
    split = gymnasium.make(f"guided_gym/{NAME}-v0", split="test").unwrapped
    whole = gymnasium.make(f"guided_gym/{NAME}-v0").unwrapped
    split.reset(seed=2)
    whole.reset(seed=problem_seed("test", 2))
    assert split.problem.fingerprint == whole.problem.fingerprint
    split.reset()  # goes on with the split's own problems
    first = split.problem
    split.reset(seed=2)
    split.reset()
    assert split.problem.fingerprint == first.fingerprint != whole.problem.fingerprint
    with pytest.raises(UnknownNameError, match="split"):
        gymnasium.make(f"guided_gym/{NAME}-v0", split="tests")


class Watched(ProblemList):
    """Ten problems; remembers which were asked for."""

    name = "Watched"

    def __init__(self) -> None:
        self.asked: list[int] = []

    def __len__(self) -> int:
        return 10

    def __getitem__(self, index: int) -> Problem:
        self.asked.append(index)
        return make_distribution(NAME).problem(index)


def test_a_list__is_indexed_by_a_fresh_seed_and_else_drawn_from():
    problems = Watched()
    problems.problem(23)
    assert problems.asked == [3]
    rng = streams(0)[0]
    drawn = problems.draw(rng)
    assert 0 <= problems.asked[-1] < 10
    again = Watched()
    assert again.draw(streams(0)[0]).fingerprint == drawn.fingerprint
    assert again.asked == problems.asked[1:]
    assert {problems.sample(np.random.default_rng(k)).name for k in range(3)} == {NAME}
