"""The local planner: N_C(v) is a ball, sampled uniformly, and steering stays in it."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from guided_gym.errors import GuidedGymWarning, InvalidInputError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.search.local_planner import LocalPlanner

SPACES = [
    ConfigurationSpace(r, Environment((0.0, 0.0, 10.0, 10.0)))
    for r in (Robot.point(), Robot.rectangle(0.8, 0.3))
]


def planner(space: ConfigurationSpace, **options: object) -> LocalPlanner:
    return LocalPlanner(space, np.random.default_rng(0), **options)  # type: ignore[arg-type]


def test_step__is_a_twentieth_of_the_diagonal_in_the_open() -> None:
    for space in SPACES:
        assert planner(space).step == pytest.approx(0.05 * math.hypot(10, 10))


@pytest.mark.parametrize(
    ("robot", "step"),
    [
        (Robot.point(), 0.5),  # the width of the corridor
        (Robot.rectangle(0.12, 0.16), 0.3),  # three radii of 0.1; the width less two is the same
        (Robot.rectangle(0.18, 0.24), 0.45),  # three radii of 0.15; the width less two is less
        (Robot.rectangle(0.006, 0.008), 0.49),  # hardly more than a point
        (Robot.rectangle(0.3, 0.4), 0.5),  # three of its radii would be more than the width
    ],
)
def test_step__suits_a_corridor(robot: Robot, step: float) -> None:
    walls = [shapely.box(0, 0, 1000, 4.75), shapely.box(0, 5.25, 1000, 10)]
    space = ConfigurationSpace(robot, Environment((0.0, 0.0, 1000.0, 10.0), walls))
    assert planner(space).step == pytest.approx(step, rel=2e-3)


def test_step__that_is_much_too_long_is_warned_of() -> None:
    walls = [shapely.box(0, 0, 100, 4.75), shapely.box(0, 5.25, 100, 10)]
    space = ConfigurationSpace(Robot.point(), Environment((0.0, 0.0, 100.0, 10.0), walls))
    with pytest.warns(GuidedGymWarning, match=r"a step of 1 is long .* default is 0\.498"):
        planner(space, step=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        planner(space, step=0.7)
        planner(space)


@pytest.mark.parametrize("space", SPACES)
@pytest.mark.parametrize("step", [0.3, 3.0])
def test_candidates__lie_in_the_ball_uniformly(space: ConfigurationSpace, step: float) -> None:
    q = np.array([5.0, 5.0, 3.1])[: space.dimension]
    drawn = planner(space, step=step).candidates(q, 4000)
    away = space.distance(drawn, q)
    assert away.max() <= step + 1e-9
    if step < 1:  # no part of the ball laps round the circle
        inner = float(np.mean(away < 0.5 * step))
        assert inner == pytest.approx(0.5**space.dimension, abs=0.03)
        assert space.difference(q, drawn).mean(axis=0) == pytest.approx(
            0, abs=0.05 * step / space.weights.min()
        )
    if space.dimension == 3:
        assert (np.abs(drawn[:, 2]) <= math.pi).all()


def test_candidates__as_many_as_asked_for() -> None:
    local = planner(SPACES[1], candidates=7)
    q = np.array([5.0, 5.0, 0.0])
    assert local.candidates(q).shape == (7, 3)
    assert local.candidates(q, 2).shape == (2, 3)
    assert local.uniform(q).shape == (3,)


def test_steer__hand_worked() -> None:
    local = planner(SPACES[0], step=2.0)
    assert local.steer(np.array([1.0, 1.0]), np.array([1.0, 9.0])).tolist() == [1, 3]
    assert local.steer(np.array([1.0, 1.0]), np.array([1.5, 1.0])).tolist() == [1.5, 1]


@pytest.mark.filterwarnings("ignore:a step of:guided_gym.errors.GuidedGymWarning")
@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.floats(0.01, 12))
def test_steer__goes_the_short_way_as_far_as_it_may(seed: int, step: float) -> None:
    for space in SPACES:
        a, b = space.sample(np.random.default_rng(seed), 2)
        reached = planner(space, step=step).steer(a, b)
        whole, gone = float(space.distance(a, b)), float(space.distance(a, reached))
        assert gone == pytest.approx(min(step, whole), rel=1e-9, abs=1e-9)
        assert gone + float(space.distance(reached, b)) == pytest.approx(whole, abs=1e-9)


@pytest.mark.parametrize("wrong", [{"step": 0.0}, {"step": math.nan}, {"step": math.inf}, {"candidates": 0}])
def test_planner__refuses_what_makes_no_sense(wrong: dict) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        planner(SPACES[0], **wrong)
