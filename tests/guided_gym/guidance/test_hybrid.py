"""Hybrids swap guides at collisions, and everybody learns."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError, UnknownNameError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.cells import Uninformed
from guided_gym.guidance.composed import Composed
from guided_gym.guidance.hybrid import Hybrid
from guided_gym.guidance.registry import make_guidance, make_guides
from guided_gym.guidance.solvers.plain import Straight
from guided_gym.planning import guided_search
from guided_gym.problems import Problem
from guided_gym.randomness import streams
from guided_gym.search.search import Expansion, Search

Walled = Callable[[str], Problem]


class Listening(Composed):
    """Notes what it hears."""

    def __init__(self) -> None:
        super().__init__(Straight())

    def prepare(self) -> None:
        super().prepare()
        self.heard: list[Expansion] = []
        self.asked = 0

    def feedback(self, expansion: Expansion) -> None:
        self.heard.append(expansion)

    def propose(self, tree, node):
        self.asked += 1
        return super().propose(tree, node)


def test_guides__swap_at_each_collision_and_all_learn(walled: Walled) -> None:
    a, b, c = Listening(), Listening(), Listening()
    hybrid = Hybrid([a, b, c])
    search = Search(walled("rectangle"), *streams(0)[1:])
    search.attach(hybrid)
    assert hybrid.guide is a
    turn, failures = 0, 0
    for _ in range(60):
        assert hybrid.current == turn
        asked = [g.asked for g in (a, b, c)]
        node = hybrid.select(search.tree)
        assert node == hybrid.guide.select(search.tree)
        assert hybrid.distribution(search.tree).tolist() == hybrid.guide.distribution(search.tree).tolist()
        assert hybrid.values(search.tree).tolist() == hybrid.guide.values(search.tree).tolist()
        expansion = search.expand(node, hybrid.propose(search.tree, node))
        assert [g.asked - n for g, n in zip((a, b, c), asked, strict=True)] == [
            int(i == turn) for i in range(3)
        ]
        if expansion.failed:
            turn, failures = (turn + 1) % 3, failures + 1
    assert failures > 3
    assert len(a.heard) == len(b.heard) == len(c.heard) == 60
    assert a.heard == b.heard == c.heard


def test_hybrid__of_one_is_that_one(walled: Walled) -> None:
    for name in ("lazy_prm", "medial_axis", "rrt"):
        alone = guided_search(walled("rectangle"), name, seed=6, max_samples=150, measure=False)
        hybrid = guided_search(
            walled("rectangle"), Hybrid(make_guides([name])), seed=6, max_samples=150, measure=False
        )
        assert (alone.tree.configurations == hybrid.tree.configurations).all()
        assert alone.collision_checks == hybrid.collision_checks


def test_reset__starts_with_the_first_again(walled: Walled) -> None:
    hybrid = Hybrid(make_guides(["goal_distance", "uninformed"]))
    guided_search(walled("rectangle"), hybrid, seed=0, max_samples=50, measure=False)
    hybrid.current = 1
    search = Search(walled("rectangle"), *streams(0)[1:])
    search.attach(hybrid)
    assert hybrid.current == 0


def test_default__is_the_papers() -> None:
    guides = make_guidance("hybrid").guides  # type: ignore[attr-defined]
    assert [g.name for g in guides] == ["lazy_prm", "medial_axis"]


def test_names__may_be_joined_and_nested(walled: Walled) -> None:
    joined = make_guidance("goal_distance+uninformed+lazy_prm")
    assert isinstance(joined, Hybrid)
    assert [g.name for g in joined.guides] == ["goal_distance", "uninformed", "lazy_prm"]
    assert type(joined.guides[1]) is Uninformed
    nested = Hybrid(make_guides([Hybrid(make_guides(["medial_axis", "goal_distance"])), "rrt"]))
    result = guided_search(walled("rectangle"), nested, seed=0, max_samples=150, distributions=True)
    assert np.isfinite(result.record.divergence[result.record.selected >= 0]).any()
    assert result.tree.failure_count > 0


def test_nested__the_inner_one_swaps_whoever_guided(walled: Walled) -> None:
    inner = Hybrid([Listening(), Listening()])
    outer = Hybrid([inner, Listening()])
    search = Search(walled("rectangle"), *streams(0)[1:])
    search.attach(outer)
    search.expand(0, np.array([5.0, 5.0, 0.0]))
    assert (outer.current, inner.current) == (1, 1)
    search.expand(0, np.array([5.0, 5.0, 0.0]))
    assert (outer.current, inner.current) == (0, 0)
    search.expand(0, np.array([1.6, 5.0, 0.0]))
    assert (outer.current, inner.current) == (0, 0)


def test_rule__is_an_option(walled: Walled) -> None:
    class InTurn:
        """The next one after every sample."""

        def begin(self, guides: Sequence[GuidingSpace], search: Search) -> None:
            self.current = len(guides) - 1

        def weights(self) -> list[float]:
            return [float(i == self.current) for i in range(2)]

        def learn(self, current: int, expansion: Expansion) -> None:
            self.current = (current + 1) % 2

    a, b = Listening(), Listening()
    hybrid = Hybrid([a, b], rule=InTurn())
    guided_search(walled("rectangle"), hybrid, seed=0, max_samples=31, measure=False)
    assert (a.asked, b.asked) == (15, 16)


@pytest.mark.parametrize(
    "weights", [[-1, 2], [math.nan, 1], [math.inf, 1], [0, 0], [1], [1, 2, 3], [[1, 0]], "ab", None]
)
def test_rule__whose_weights_are_none_is_named_with_them(walled: Walled, weights: object) -> None:
    class Wrong:
        def begin(self, guides: Sequence[GuidingSpace], search: Search) -> None:
            pass

        def weights(self) -> object:
            return weights

        def learn(self, guide: int, expansion: Expansion) -> None:
            pass

    hybrid = Hybrid([Listening(), Listening()], rule=Wrong())
    with pytest.raises(InvalidInputError, match=f"rule Wrong: expected .*, got {re.escape(repr(weights))}"):
        guided_search(walled("rectangle"), hybrid, seed=0, max_samples=1, measure=False)


def test_states__carry_the_guide_they_belong_to(walled: Walled) -> None:
    hybrid = Hybrid(make_guides(["goal_distance", "medial_axis"]))
    search = Search(walled("rectangle"), *streams(0)[1:])
    search.attach(hybrid)
    q = np.array([[2.0, 5.0, 0.0]])
    states = hybrid.project(search.tree, q)
    hybrid.current = 1
    assert hybrid.heuristic(states) == pytest.approx(search.space.distance(q, search.goal))


@pytest.mark.parametrize("wrong", ["rrt", []])
def test_hybrid__refuses_no_guides(wrong: object) -> None:
    with pytest.raises(InvalidInputError, match="guides"):
        Hybrid(wrong)  # type: ignore[arg-type]


def test_hybrid__refuses_the_same_guide_twice_and_unknown_ones() -> None:
    guide = Uninformed()
    with pytest.raises(InvalidInputError, match="twice"):
        Hybrid([guide, guide])
    with pytest.raises(UnknownNameError, match="medial_axis"):
        make_guidance("rrt+medial_axes")


def test_hybrid__least_is_what_values_say_however_often_it_is_asked() -> None:
    search = Search(make_distribution("TrapCup").problem(0), *map(np.random.default_rng, (0, 1)))
    hybrid = make_guidance("hybrid")
    search.attach(hybrid)
    for _ in range(60):
        for guide in (hybrid, *hybrid.guides):
            node, h = guide.least(search.tree)
            values = guide.values(search.tree)
            assert (node, h) == (int(np.argmin(values)), values.min())
            assert guide.least(search.tree) == (node, h)
        node = hybrid.select(search.tree)
        search.expand(node, hybrid.propose(search.tree, node))


class Fading:
    """A rule whose weights are always the same read-only view, of numbers that change."""

    def begin(self, guides: Sequence[GuidingSpace], search: Search) -> None:
        self.own = np.array([1.0, 0.0])
        self.seen = self.own.view()
        self.seen.flags.writeable = False

    def weights(self) -> np.ndarray:
        return self.seen

    def learn(self, guide: int, expansion: Expansion) -> None:
        self.own[:] = self.own[::-1].copy()


def test_rule__whose_weights_change_in_place_is_heard(walled: Walled) -> None:
    hybrid = Hybrid(make_guides(["goal_distance", "uninformed"]), rule=Fading())
    for samples in (4, 5):
        guided_search(walled("rectangle"), hybrid, seed=0, max_samples=samples, measure=False)
        assert hybrid.current == samples % 2
