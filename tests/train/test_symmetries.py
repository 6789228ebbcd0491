"""Turning a problem turns its field: the symmetries agree with geometry."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

torch = pytest.importorskip("torch")

from guided_gym.geometry.environment import Environment  # noqa: E402
from guided_gym.geometry.robots import Robot  # noqa: E402
from guided_gym.guidance.learned.field import FieldArchitecture, FieldModel, decoder_input, plain_tensors  # noqa: E402
from guided_gym.guidance.solvers.wave import PoseGrid  # noqa: E402
from guided_gym.problems import Problem, Task  # noqa: E402
from guided_gym.train.symmetries import SYMMETRIES, Symmetry, turned, turned_back  # noqa: E402

ARCHITECTURE = FieldArchitecture(cells=24, headings=8)
RINGS = [[(0.4, 0.0), (0.5, 0.0), (0.5, 0.7), (0.4, 0.7)], [(0.7, 0.5), (0.9, 0.5), (0.8, 0.6)]]
BODY = [(-0.1, 0.0), (0.1, 0.0), (0.1, 0.06)]  # a bent rod, without a symmetry of its own
START, GOAL = (0.15, 0.2, 0.3), (0.85, 0.3, -2.0)


def moved(points: object, symmetry: Symmetry, centre: float) -> np.ndarray:
    points = np.array(points, float) - centre
    if symmetry.mirrored:
        points = points * [-1, 1]
    for _ in range(symmetry.quarters):
        points = np.stack([-points[:, 1], points[:, 0]], axis=-1)
    return points + centre


def pose(q: tuple[float, float, float], symmetry: Symmetry) -> tuple[float, float, float]:
    x, y = moved([q[:2]], symmetry, 0.5)[0]
    theta = np.pi - q[2] if symmetry.mirrored else q[2]
    return x, y, theta + symmetry.quarters * np.pi / 2


def layers(symmetry: Symmetry) -> torch.Tensor:
    body = np.array(BODY) * ([1, -1] if symmetry.mirrored else [1, 1])
    environment = Environment.from_polygons((0, 0, 1, 1), [moved(ring, symmetry, 0.5) for ring in RINGS])
    task = Task(pose(START, symmetry), pose(GOAL, symmetry))
    problem = Problem(Robot(shapely.LineString(body)), environment, task)
    grid = PoseGrid.of(problem.space, ARCHITECTURE.cells, ARCHITECTURE.headings)
    frame = grid.towards(problem.task.goal)
    model = FieldModel(ARCHITECTURE, plain_tensors(ARCHITECTURE))
    arrival = model.arrival(model.begin(grid, problem.task.goal))
    return torch.from_numpy(decoder_input(grid, frame, arrival).transpose(2, 0, 1).copy())[None]


@pytest.mark.parametrize("symmetry", SYMMETRIES, ids=str)
def test_a_turned_problem_has_the_turned_layers(symmetry: Symmetry) -> None:
    found, expected = turned(layers(Symmetry(False, 0)), symmetry, 8), layers(symmetry)
    assert torch.quantile((found - expected).abs(), 0.99) < 0.02


@pytest.mark.parametrize("symmetry", SYMMETRIES, ids=str)
def test_turned_back_is_the_inverse(symmetry: Symmetry) -> None:
    maps = torch.rand(2, 8, 6, 6)
    assert torch.equal(turned_back(turned(maps, symmetry, 8), symmetry), maps)
