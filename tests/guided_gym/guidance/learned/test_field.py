"""The field network in numpy: what it sees, and what it says without any training."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.guidance.learned.field import FieldArchitecture, FieldModel, decoder_input, plain_tensors
from guided_gym.guidance.solvers.wave import PoseGrid, WaveModel
from guided_gym.measure.oracle import oracle_for
from guided_gym.problems import Problem, Task

ARCHITECTURE = FieldArchitecture(cells=24, headings=8)
WALL = [(0.45, 0.3), (0.55, 0.3), (0.55, 1.0), (0.45, 1.0)]


def point_problem() -> Problem:
    environment = Environment.from_polygons((0, 0, 1, 1), [WALL])
    return Problem(Robot.point(), environment, Task((0.2, 0.8), (0.8, 0.8)))


def grid_of(problem: Problem) -> PoseGrid:
    return PoseGrid.of(problem.space, ARCHITECTURE.cells, ARCHITECTURE.headings)


def model(**changes: object) -> FieldModel:
    return FieldModel(ARCHITECTURE, plain_tensors(ARCHITECTURE), **changes)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["SimplePassage", "point"])
def test_the_untrained_field_is_near_the_true_distance(name: str) -> None:
    problem = point_problem() if name == "point" else make_distribution(name).problem(0)
    field = model().evaluate(grid_of(problem), problem.task.goal)
    q = problem.space.sample(np.random.default_rng(0), 2000)
    q = q[problem.space.valid(q)]
    truth = np.asarray(oracle_for(problem.space, problem.task.goal).cost_to_go(q))
    found = field.cost_to_go(q)
    assert np.median(np.abs(found - truth) / np.maximum(truth, 0.1 * truth.max())) < 0.1
    assert (found >= problem.space.distance(q, problem.task.goal) - 1e-6).all()


@pytest.mark.parametrize("name", ["Trap", "point"])
def test_the_untrained_field_is_the_wave(name: str) -> None:
    problem = point_problem() if name == "point" else make_distribution(name).problem(0)
    grid, goal = grid_of(problem), problem.task.goal
    wave = WaveModel(ARCHITECTURE.cells, ARCHITECTURE.headings).evaluate(grid, goal)
    field = model().evaluate(grid, goal)
    both = (wave.values > 0) & (field.values > 0)
    assert both.sum() > 0.4 * wave.values.size
    assert (both == (wave.values > 0)).mean() > 0.999
    assert np.median(np.abs(field.values - wave.values)[both]) < 1e-3 * grid.side


def test_without_planning_no_finer_grid_is_tried() -> None:
    """A wall without a gap: a model with a wave looks for one in finer grids."""
    environment = Environment.from_polygons((0, 0, 1, 1), [[(0.4, 0), (0.6, 0), (0.6, 1), (0.4, 1)]])
    problem = Problem(Robot.point(), environment, Task((0.2, 0.8), (0.8, 0.8)))
    still = FieldModel(replace(ARCHITECTURE, planning=False), plain_tensors(ARCHITECTURE))
    asked = problem.space, problem.task.start, problem.task.goal
    assert still.solve(*asked).grid.room.shape[0] == ARCHITECTURE.cells
    assert model().solve(*asked).grid.room.shape[0] == 2 * ARCHITECTURE.cells


def test_a_pickled_model_says_the_same() -> None:
    problem = point_problem()
    first = model()
    asked = problem.space, problem.task.start, problem.task.goal
    known = first.solve(*asked).front.known
    twin = pickle.loads(pickle.dumps(first))
    assert np.array_equal(twin.solve(*asked).front.known, known)


def test_without_planning_the_field_starts_from_the_distance() -> None:
    problem = make_distribution("Cup").problem(0)
    architecture = FieldArchitecture(cells=24, headings=8, planning=False)
    field = FieldModel(architecture, plain_tensors(architecture)).evaluate(
        grid_of(problem), problem.task.goal
    )
    q = problem.task.start[None]
    assert field.cost_to_go(q)[0] == pytest.approx(
        float(problem.space.distance(q, problem.task.goal)[0]), rel=0.02
    )


def test_a_correction_is_added_in_sides_of_the_square() -> None:
    problem = point_problem()
    grid = grid_of(problem)
    tensors = plain_tensors(ARCHITECTURE)
    tensors["head.bias"][:] = 0.25
    q = problem.task.start[None]
    plain = model().evaluate(grid, problem.task.goal).cost_to_go(q)[0]
    raised = FieldModel(ARCHITECTURE, tensors).evaluate(grid, problem.task.goal).cost_to_go(q)[0]
    assert raised - plain == pytest.approx(0.25 * grid.side, rel=1e-4)
    ignored = FieldModel(ARCHITECTURE, tensors, corrected=False).evaluate(grid, problem.task.goal)
    assert ignored.cost_to_go(q)[0] == pytest.approx(plain)


def test_decoder_input__is_bounded_and_has_its_layers() -> None:
    problem = make_distribution("Trap").problem(0)
    grid = grid_of(problem)
    frame = grid.towards(problem.task.goal)
    layers = decoder_input(grid, frame, model().arrival(model().begin(grid, problem.task.goal)))
    assert layers.shape == (24, 24, 3 * 8 + 1)
    assert np.abs(layers).max() <= 4.0


@pytest.mark.parametrize("sizes", [{"cells": 20}, {"headings": 6}, {"widths": (1, 0, 1)}, {"blocked": -1.0}])
def test_sizes_that_cannot_be_are_refused(sizes: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError, match="field network"):
        FieldArchitecture(**sizes)  # type: ignore[arg-type]
    with pytest.raises(StorageError, match="field network"):
        FieldArchitecture.from_card(sizes)
