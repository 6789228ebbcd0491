"""The metric: worked by hand, and what must hold for every tree."""

from __future__ import annotations

import math
from functools import partial
from io import StringIO

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError
from guided_gym.kernels import softmin
from guided_gym.measure.target import (
    Measure,
    choice_efficiency,
    entropy,
    jensen_shannon,
    padded,
    sampling_efficiency,
    smooth,
    suboptimality,
    target,
)
from guided_gym.options import SearchOptions, TargetParameters
from guided_gym.planning import guided_search
from guided_gym.search.search import Search

quick = settings(max_examples=80, deadline=None)
lengths = st.floats(0, 50, allow_nan=False)
floors = st.floats(0, 0.3)


@st.composite
def targets(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray, TargetParameters]:
    """Suboptimality and work remaining of a tree, and parameters."""
    n = draw(st.integers(1, 40))
    delta = np.array(draw(st.lists(lengths, min_size=n, max_size=n)))
    tau = np.array(draw(st.lists(lengths, min_size=n, max_size=n)))
    parameters = TargetParameters(
        draw(st.floats(0.02, 2)),
        draw(st.floats(0.02, 2)),
        draw(floors),
        draw(st.sampled_from(["start", "tree"])),
    )
    return delta, tau, parameters


@st.composite
def pairs(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Two distributions over the same nodes, zeros included."""
    n = draw(st.integers(1, 20))
    weights = st.lists(st.floats(1e-6, 1) | st.just(0.0), min_size=n, max_size=n).filter(any)
    p, q = np.array(draw(weights)), np.array(draw(weights))
    return p / p.sum(), q / q.sum()


def test_target__hand_worked_with_three_nodes() -> None:
    # Energies 0 + 1, 0 + 0.5, 0.5 + 1 in units of 0.5 * scale: softmin of (2, 1, 3).
    q = target([0, 0, 1], [2, 1, 2], 2.0, TargetParameters(0.5, 0.5, epsilon=0.0))
    e = math.exp
    z = e(-2) + e(-1) + e(-3)
    assert q == pytest.approx([e(-2) / z, e(-1) / z, e(-3) / z])
    # The floor 0.2: (w_min + gamma) / (Z + 3 gamma) = 0.2 with w and Z relative to the best.
    w, total = e(-2), 1 + e(-1) + e(-2)
    gamma = (0.2 * total - w) / (1 - 0.6)
    bar = target([0, 0, 1], [2, 1, 2], 2.0, TargetParameters(0.5, 0.5, epsilon=0.2))
    assert bar == pytest.approx(np.array([e(-1) + gamma, 1 + gamma, w + gamma]) / (total + 3 * gamma))
    assert bar.min() == pytest.approx(0.2)


def test_efficiency__hand_worked() -> None:
    assert sampling_efficiency([0.5, 0.5, 0], [0.25, 0.25, 0.5]) == pytest.approx(math.log(2))
    assert sampling_efficiency([0, 1, 0], [0.25, 0.25, 0.5]) == pytest.approx(math.log(4))
    assert choice_efficiency(np.array([0.25, 0.25, 0.5]), 1) == pytest.approx(math.log(4))
    assert sampling_efficiency([0.5, 0.5], [1.0, 0.0]) == math.inf
    assert sampling_efficiency([1.0, 0.0], [0.5, 0.5]) == pytest.approx(math.log(2))
    assert jensen_shannon([1, 0], [0, 1]) == pytest.approx(math.log(2))
    # D_JS of (1, 0) and (1/2, 1/2), M = (3/4, 1/4).
    expected = 0.5 * (math.log(4 / 3) + 0.5 * math.log(2 / 3) + 0.5 * math.log(2))
    assert jensen_shannon([1, 0], [0.5, 0.5]) == pytest.approx(expected)


def test_suboptimality__is_clipped_where_the_oracle_errs() -> None:
    d = suboptimality(np.array([0.0, 3.0, 1.0]), np.array([10.0, 9.0, 8.9]), 10.0)
    assert d == pytest.approx([0.0, 2.0, 0.0])


@quick
@given(pairs())
def test_divergences__have_their_bounds(pq: tuple[np.ndarray, np.ndarray]) -> None:
    p, q = pq
    assert sampling_efficiency(p, q) >= 0
    assert sampling_efficiency(p, p) == 0
    js = jensen_shannon(p, q)
    assert 0 <= js <= math.log(2)
    assert js == pytest.approx(jensen_shannon(q, p), abs=1e-12)


@quick
@given(targets())
def test_target__is_a_distribution_no_less_than_epsilon(case: tuple) -> None:
    delta, tau, parameters = case
    n, epsilon = delta.size, parameters.epsilon
    q = target(delta, tau, 7.0, parameters)
    assert q.shape == (n,)
    assert q.sum() == pytest.approx(1)
    if epsilon * n >= 1:
        assert q == pytest.approx(np.full(n, 1 / n))  # no gamma exists: the limit
        return
    assert q.min() >= epsilon * (1 - 1e-9)
    plain = target(
        delta, tau, 7.0, TargetParameters(parameters.delta, parameters.tau, 0, parameters.normalisation)
    )
    if plain.min() < epsilon:
        assert q.min() == pytest.approx(epsilon)  # gamma is the least that will do
    else:
        assert q == pytest.approx(plain)  # and is 0 where none is needed


@quick
@given(targets(), st.data())
def test_efficiency__is_at_most_log_one_over_epsilon(case: tuple, data: st.DataObject) -> None:
    delta, tau, parameters = case
    n = delta.size
    q = target(delta, tau, 7.0, parameters)
    worst = math.log(max(n, 1 / parameters.epsilon if parameters.epsilon else math.inf))
    weights = np.array(
        data.draw(st.lists(st.floats(0, 1), min_size=n, max_size=n).filter(lambda w: sum(w) > 1e-3))
    )
    assert sampling_efficiency(weights / weights.sum(), q) <= worst + 1e-9
    assert choice_efficiency(q, data.draw(st.integers(0, n - 1))) <= worst + 1e-9


@quick
@given(targets(), st.randoms(use_true_random=False))
def test_target__does_not_depend_on_labels(case: tuple, random: object) -> None:
    delta, tau, parameters = case
    order = np.array(random.sample(range(delta.size), delta.size))  # type: ignore[attr-defined]
    q = target(delta, tau, 7.0, parameters)
    assert target(delta[order], tau[order], 7.0, parameters) == pytest.approx(q[order], abs=1e-12)


@quick
@given(targets(), st.data())
def test_kernel__agrees_with_the_whole_distribution(case: tuple, data: st.DataObject) -> None:
    delta, tau, p = case
    p = TargetParameters(p.delta, p.tau, p.epsilon)
    node = data.draw(st.integers(0, delta.size - 1))
    energy = (delta / p.delta + tau / p.tau) / 7.0
    q = target(delta, tau, 7.0, p)
    chosen, best = softmin.choice_efficiency(np.append(energy, -1e9), delta.size, node, p.epsilon)
    if q[node] > 1e-290:
        assert chosen == pytest.approx(-math.log(q[node]), abs=1e-9)
    assert best == pytest.approx(-math.log(q.max()), abs=1e-9)


@quick
@given(targets(), st.data())
def test_kernel__choices_one_after_the_other_are_those_one_by_one(case: tuple, data: st.DataObject) -> None:
    delta, tau, p = case
    energy = delta / p.delta + tau / p.tau
    sizes = np.array(sorted(data.draw(st.lists(st.integers(1, energy.size), min_size=1, max_size=30))))
    nodes = np.array([data.draw(st.integers(0, size - 1)) for size in sizes.tolist()])
    together = softmin.choice_efficiencies(energy, nodes, sizes, p.epsilon)
    alone = [softmin.choice_efficiency(energy, n, v, p.epsilon) for v, n in zip(nodes, sizes, strict=True)]
    assert together.tolist() == [list(pair) for pair in alone]  # to the last bit


def test_measure__refuses_choices_of_a_tree_that_never_was() -> None:
    problem = make_distribution("Cup").problem(0)
    search = Search(problem, np.random.default_rng(0), np.random.default_rng(1))
    search.expand(0, search.planner.uniform(search.start))
    measure = Measure(search)
    assert measure.choices([], []).shape == (0, 2)
    assert measure.choices([0], [1]).tolist() == [list(measure.choice(0, 1))]
    for nodes, sizes in (
        ([0], [9]),
        ([1], [1]),
        ([-1], [1]),
        ([0, 0], [2, 1]),
        ([0], [1, 1]),
        ([[0]], [[1]]),
    ):
        with pytest.raises(InvalidInputError, match="expected"):
            measure.choices(nodes, sizes)


@pytest.mark.parametrize("normalisation", ["start", "tree"])
def test_searches__are_measured_in_hindsight_as_they_were_on_the_way(normalisation: str) -> None:
    """A trace asks at each sample; without one, all choices are measured together afterwards."""
    options = SearchOptions(target=TargetParameters(normalisation=normalisation))
    rewired = SearchOptions(rewire=True, target=options.target)
    for guidance, how in (("lazy_prm", options), ("rrt", options), ("rrt", rewired)):
        problem = make_distribution("Cup").problem(0)
        ran = partial(guided_search, problem, guidance, seed=0, max_samples=60, options=how)
        on_the_way, afterwards = ran(trace=StringIO()).record, ran().record
        assert np.array_equal(on_the_way.efficiency, afterwards.efficiency)
        assert np.array_equal(on_the_way.selected, afterwards.selected)


def test_target__prefers_less_work_and_less_suboptimality() -> None:
    q = target([0, 1, 0, 1], [1, 1, 2, 2], 5.0)
    assert q[0] > max(q[1], q[2])
    assert min(q[1], q[2]) > q[3]


def test_target__of_one_node_and_of_a_search_that_starts_at_its_goal() -> None:
    assert target([0], [3], 3.0).tolist() == [1.0]
    q = target([0.0, 0.2], [0.0, 0.1], 0.0)
    assert np.isfinite(q).all()
    assert q[0] > q[1]


@pytest.mark.parametrize("normalisation", ["start", "tree"])
def test_target__gives_unreachable_nodes_the_floor(normalisation: str) -> None:
    q = target([0, np.inf], [1, np.inf], 1.0, TargetParameters(normalisation=normalisation))
    assert q == pytest.approx([1 - 1e-4, 1e-4])


def test_normalisation__by_the_tree_divides_by_its_largest_values() -> None:
    by_tree = target([0, 2, 4], [9, 3, 1], 5.0, TargetParameters(0.3, 0.7, 0.0, "tree"))
    by_hand = target([0, 0.5, 1], [1, 3 / 9, 1 / 9], 1.0, TargetParameters(0.3, 0.7, 0.0))
    assert by_tree == pytest.approx(by_hand)


def test_smooth__continues_to_uniform_without_a_jump() -> None:
    weights = np.array([1.0, 0.2, 0.01, 0.0])
    almost = smooth(weights, 0.25 - 1e-9)
    assert almost == pytest.approx(smooth(weights, 0.25), abs=1e-6)


def test_padded__is_zero_after_the_search_has_finished() -> None:
    assert padded(np.array([3.0, 2.0]), 5).tolist() == [3, 2, 0, 0, 0]
    assert padded(np.array([3.0, 2.0]), 1).tolist() == [3]
    assert padded(np.zeros(0), 2).tolist() == [0, 0]


def test_entropy__hand_worked() -> None:
    bounds = [[0, 2], [0, 2]]
    assert entropy([[0.5, 0.5], [0.6, 0.4]], 2, bounds) == 0
    four = [[0.5, 0.5], [1.5, 0.5], [0.5, 1.5], [1.5, 1.5]]
    assert entropy(four, 2, bounds) == pytest.approx(math.log(4))


@pytest.mark.parametrize(
    "wrong",
    [
        {"delta": 0.0},
        {"tau": -1.0},
        {"tau": math.nan},
        {"epsilon": 1.0},
        {"epsilon": -0.1},
        {"epsilon": math.nan},
        {"normalisation": "best"},
    ],
)
def test_parameters__refuse_what_makes_no_sense(wrong: dict) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        TargetParameters(**wrong)


def test_divergences__refuse_distributions_over_different_trees() -> None:
    for divergence in (sampling_efficiency, jensen_shannon):
        with pytest.raises(InvalidInputError, match="same nodes"):
            divergence([1.0], [0.5, 0.5])


@pytest.mark.parametrize("divergence", [sampling_efficiency, jensen_shannon])
@pytest.mark.parametrize(
    ("wrong", "name"),
    [
        ([math.nan, 1.0], "P"),
        ([-0.5, 1.5], "P"),
        ([0.5, 0.6], "P"),
        ([2.0, 3.0], "P"),
        ([0.0, 0.0], "P"),
        ([math.inf, 0.0], "P"),
        ([], "P"),
    ],
)
def test_divergences__refuse_what_is_no_distribution(divergence, wrong: list[float], name: str) -> None:
    good = np.full(len(wrong), 1 / max(len(wrong), 1))
    with pytest.raises(InvalidInputError, match=f"{name}: expected probabilities"):
        divergence(wrong, good)
    if wrong:
        with pytest.raises(InvalidInputError, match="Q: expected probabilities"):
            divergence(good, wrong)


def test_divergences__take_single_precision() -> None:
    weights = np.random.default_rng(0).random(5000).astype(np.float32)
    p = weights / weights.sum()
    assert sampling_efficiency(p, p[::-1]) > 0
    assert 0 < jensen_shannon(p, p[::-1]) < math.log(2)


def test_divergences__at_the_least_positive_number() -> None:
    tiny = 5e-324  # half of it is 0
    assert jensen_shannon([tiny, 1.0], [0.0, 1.0]) == 0.0
    assert jensen_shannon([0.0, 1.0], [tiny, 1.0]) == 0.0
    assert sampling_efficiency([tiny, 1.0], [tiny, 1.0]) == 0.0
    assert sampling_efficiency([tiny, 1.0], [0.0, 1.0]) == math.inf


@pytest.mark.parametrize(
    ("delta", "tau", "scale", "message"),
    [
        ([0.0, 0.0], [math.inf, math.inf], 1.0, "can reach the goal"),
        ([math.inf, math.inf], [1.0, 2.0], 1.0, "can reach the goal"),
        ([math.inf, 0.0], [1.0, math.inf], 1.0, "can reach the goal"),
        ([0.0, 1.0], [1.0], 1.0, "same nodes"),
        ([0.0], [1.0, 2.0], 1.0, "same nodes"),
        (0.0, 1.0, 1.0, "one length per node"),
        ([], [], 1.0, "one length per node"),
        ([[0.0]], [[1.0]], 1.0, "one length per node"),
        ([0.0, -0.1], [1.0, 2.0], 1.0, "delta: expected lengths >= 0, got -0.1 for node 1"),
        ([0.0, 0.1], [math.nan, 2.0], 1.0, "tau: expected lengths >= 0, got nan for node 0"),
        ([0.0, 0.1], [1.0, 2.0], -1.0, "scale"),
        ([0.0, 0.1], [1.0, 2.0], math.nan, "scale"),
        ([0.0, 0.1], [1.0, 2.0], math.inf, "scale"),
    ],
)
@pytest.mark.parametrize("normalisation", ["start", "tree"])
def test_target__refuses_what_is_no_tree(delta, tau, scale: float, message: str, normalisation: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        target(delta, tau, scale, TargetParameters(normalisation=normalisation))


@pytest.mark.parametrize(
    ("weights", "epsilon", "message"),
    [
        ([0.0, 0.0], 0.1, "weights"),
        ([1.0, -0.1], 0.1, "weights"),
        ([1.0, math.nan], 0.1, "weights"),
        ([1.0, math.inf], 0.1, "weights"),
        ([], 0.1, "weights"),
        ([1.0], -0.1, "epsilon"),
        ([1.0], 1.0, "epsilon"),
        ([1.0], math.nan, "epsilon"),
    ],
)
def test_smooth__refuses_what_is_no_weight(weights: list[float], epsilon: float, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        smooth(np.array(weights), epsilon)


def test_smooth__of_weights_whose_sum_overflows() -> None:
    assert smooth(np.array([1e308, 1e308, 5e307]), 0.0) == pytest.approx([0.4, 0.4, 0.2])
    assert smooth(np.array([5e-324, 0.0]), 0.1) == pytest.approx([0.9, 0.1])


@pytest.mark.parametrize(
    ("q", "node"), [([0.5, 0.5], 2), ([0.5, 0.5], -1), ([math.nan], 0), ([1.5], 0), ([-0.1, 1.1], 0)]
)
def test_choice_efficiency__refuses_what_is_no_choice(q: list[float], node: int) -> None:
    with pytest.raises(InvalidInputError, match="expected"):
        choice_efficiency(np.array(q), node)


@pytest.mark.parametrize(
    ("samples", "bins", "bounds", "message"),
    [
        ([[math.nan, math.nan]] * 3, 2, [[0, 2], [0, 2]], "3 of 3 outside"),
        ([[0.5, math.inf], [1, 1]], 2, [[0, 2], [0, 2]], "1 of 2 outside"),
        ([[0.5, 2.1]], 2, [[0, 2], [0, 2]], "outside"),
        (np.zeros((0, 2)), 2, [[0, 2], [0, 2]], "samples: expected shape"),
        ([0.5, 0.5], 2, [[0, 2], [0, 2]], "samples: expected shape"),
        ([[0.5]], 2, [[0, 2], [0, 2]], "bounds"),
        ([[0.5]], 2, [[2, 0]], "bounds"),
        ([[0.5]], 2, [[0, math.nan]], "bounds"),
        ([[0.5]], 0, [[0, 2]], "bins"),
    ],
)
def test_entropy__refuses_what_has_none(samples, bins: int, bounds, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        entropy(samples, bins, bounds)


def test_entropy__of_many_cells_needs_no_memory_for_those_that_are_empty() -> None:
    samples = np.random.default_rng(0).random((100, 3))
    assert entropy(samples, 10**6, [[0, 1]] * 3) == pytest.approx(math.log(100))
    assert entropy([[0.0], [1.0]], 1, [[0, 1]]) == 0.0  # the upper bound lies in the last cell


@quick
@given(st.integers(1, 50), st.integers(1, 5), st.integers(1, 3))
def test_entropy__agrees_with_a_histogram(m: int, bins: int, d: int) -> None:
    samples = np.random.default_rng(m).random((m, d))
    counts, _ = np.histogramdd(samples, bins, [(0.0, 1.0)] * d)
    p = counts[counts > 0] / m
    assert entropy(samples, bins, [[0.0, 1.0]] * d) == pytest.approx(-np.sum(p * np.log(p)), abs=1e-12)
