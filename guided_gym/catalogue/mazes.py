"""Random mazes: walls on a grid of rooms, and lattices of square cells in the frame of the NEXT benchmark."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import Polygon, box
from shapely.geometry.base import BaseGeometry
from shapely.ops import unary_union

from guided_gym.catalogue.distributions import SampledProblems
from guided_gym.catalogue.grids import Cells, Room, carved, covering, way
from guided_gym.catalogue.placement import free_pose
from guided_gym.checks import shown
from guided_gym.errors import InvalidInputError, NoPathError
from guided_gym.geometry.environment import Bounds, Environment
from guided_gym.geometry.linkages import Linkage
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.problems import Problem, Task

SIZE: Final = 10.0
WALL: Final = 0.2  # thickness
ROBOT: Final = (0.8, 0.3)
ROOMS: Final = (4, 6)  # fewest and most along a side, for the rectangle: corridors of 1.5 to 2.35
POINT_ROOMS: Final = (5, 9)  # for the point: corridors of 0.93 to 1.84
PERFECT: Final = 0.5  # part of the mazes that are perfect
REMOVED: Final = 0.4  # at most this part of an imperfect maze's walls is missing
WINDOWED: Final = 0.5  # part of the rectangle's mazes that have windows
WINDOWS: Final = 0.4  # at most this part of their walls has one
WINDOW_WIDTH: Final = (0.1, 0.25)  # a point fits, the rectangle, 0.3 wide, never does

LATTICE: Final = 15  # cells along a side
LATTICE_BOUNDS: Final = (-1.0, -1.0, 1.0, 1.0)
STICK_LENGTH: Final = 0.2
STICK_WEIGHT: Final = 0.4 / math.pi  # length per radian
MOST_OBSTACLES: Final = 128  # of a perfect maze
HARD_OBSTACLES: Final = (105, MOST_OBSTACLES)
ANY_OBSTACLES: Final = (57, MOST_OBSTACLES)  # as the benchmark's own maps have
LINKS: Final = 5  # of the snake: seven coordinates
UNIT: Final = 2.0 / LATTICE / 1.4  # where snakes are published, a cell is 1.4 wide, and a radian counts as 1
LINK: Final = (0.8 * UNIT, 0.1 * UNIT)  # length and width
SNAKE_TRIES: Final = (2000, 20)  # configurations at once, and how often; few are free where it is narrow
HARD_APART: Final = 10  # cells on the shortest way from start to goal, at least

Edges = NDArray[np.float64]


# Rooms ----------------------------------------------------------------------------------------------------


def random_maze(rng: np.random.Generator) -> Problem:
    """A maze of 4 x 4 to 6 x 6 rooms for the rectangle, some with loops, some with narrow windows."""
    windows = rng.uniform(0.0, WINDOWS) if rng.random() < WINDOWED else 0.0
    return _maze(rng, Robot.rectangle(*ROBOT), "RandomMaze", ROOMS, windows)


def random_point_maze(rng: np.random.Generator) -> Problem:
    """A maze of 5 x 5 to 9 x 9 rooms for a point, some with loops."""
    return _maze(rng, Robot.point(), "RandomPointMaze", POINT_ROOMS)


def _maze(
    rng: np.random.Generator, robot: Robot, name: str, sizes: tuple[int, int], windows: float = 0.0
) -> Problem:
    rooms = int(rng.integers(sizes[0], sizes[1] + 1))
    walls = carved(rng, rooms, rooms, newest=rng.random())
    if rng.random() >= PERFECT:
        walls = _with_loops(rng, walls, rng.uniform(0.0, REMOVED))
    walls = walls[1:-1, 1:-1]  # the bounds are the outer walls
    edges = _room_edges(rooms)
    open_to_points = _between_rooms(walls) & (rng.random(walls.shape) < windows)
    obstacles = [
        box(edges[i0], edges[j0], edges[i1], edges[j1])
        for i0, j0, i1, j1 in covering(walls & ~open_to_points)
    ]
    for i, j in np.argwhere(open_to_points).tolist():
        obstacles += _with_window(rng, _area(edges, (i, j)))
    environment = Environment((0.0, 0.0, SIZE, SIZE), tuple(obstacles))
    space = ConfigurationSpace(robot, environment)
    start_room, goal_room = _two_rooms(rng, rooms)
    start, goal = (free_pose(space, rng, _area(edges, room)) for room in (start_room, goal_room))
    regions = _way_and_rest(edges, way(walls, start_room, goal_room))
    return Problem(robot, environment, Task(start, goal), name, regions)


def _with_loops(rng: np.random.Generator, walls: Cells, part: float) -> Cells:
    """The maze without that part of the walls between rooms, and without pillars that then stand alone."""
    walls = walls.copy()
    between = _between_rooms(walls)
    between[[0, -1]] = between[:, [0, -1]] = False
    walls &= ~(between & (rng.random(walls.shape) < part))
    pillars = walls & (np.indices(walls.shape) % 2 == 0).all(axis=0)
    around = np.zeros_like(walls)
    around[1:-1, 1:-1] = walls[:-2, 1:-1] | walls[2:, 1:-1] | walls[1:-1, :-2] | walls[1:-1, 2:]
    alone = pillars & ~around
    alone[[0, -1]] = alone[:, [0, -1]] = False
    walls &= ~alone
    return walls


def _between_rooms(walls: Cells) -> Cells:
    """The walls that part two rooms: one index odd, one even, and no pillars."""
    odd: Cells = np.indices(walls.shape).sum(axis=0) % 2 == 1
    return odd & walls


def _with_window(rng: np.random.Generator, area: Bounds) -> list[Polygon]:
    """A wall between two rooms, in two pieces with a narrow gap between them."""
    x0, y0, x1, y1 = area
    half = rng.uniform(*WINDOW_WIDTH) / 2
    if x1 - x0 > y1 - y0:
        middle = rng.uniform(x0 + 2 * WALL, x1 - 2 * WALL)
        return [box(x0, y0, middle - half, y1), box(middle + half, y0, x1, y1)]
    middle = rng.uniform(y0 + 2 * WALL, y1 - 2 * WALL)
    return [box(x0, y0, x1, middle - half), box(x0, middle + half, x1, y1)]


def _room_edges(rooms: int) -> Edges:
    """Coordinates between room, wall, room, ..., room: (2 rooms,)."""
    corridor = (SIZE - (rooms - 1) * WALL) / rooms
    left = np.arange(rooms) * (corridor + WALL)
    edges = np.column_stack((left, left + corridor)).ravel()
    edges[-1] = SIZE
    return edges


def _two_rooms(rng: np.random.Generator, rooms: int) -> tuple[Room, Room]:
    """The cells of two rooms that are not the same."""
    first = int(rng.integers(rooms * rooms))
    second = (first + int(rng.integers(1, rooms * rooms))) % (rooms * rooms)
    start, goal = ((2 * (k // rooms), 2 * (k % rooms)) for k in (first, second))
    return start, goal


def _area(edges: Edges, cell: Room) -> Bounds:
    i, j = cell
    return (float(edges[i]), float(edges[j]), float(edges[i + 1]), float(edges[j + 1]))


def _way_and_rest(edges: Edges, cells: list[Room]) -> dict[str, BaseGeometry]:
    """Regions: the rooms and passages of a shortest way, and everything else."""
    inside = unary_union([box(*_area(edges, cell)) for cell in cells])
    return {"way": inside, "elsewhere": box(0.0, 0.0, SIZE, SIZE).difference(inside)}


# Lattices -------------------------------------------------------------------------------------------------


def hard_point_maze(rng: np.random.Generator) -> Problem:
    """A 15 x 15 lattice with 105 to 128 obstacle cells for a point: nearly perfect mazes, as in NEXT."""
    return lattice_maze(rng, "point", HARD_OBSTACLES, "HardPointMaze", HARD_APART)


def hard_stick_maze(rng: np.random.Generator) -> Problem:
    """A 15 x 15 lattice with 105 to 128 obstacle cells for a stick: nearly perfect mazes, as in NEXT."""
    return lattice_maze(rng, "stick", HARD_OBSTACLES, "HardStickMaze", HARD_APART)


def snake_maze(rng: np.random.Generator) -> Problem:
    """A 15 x 15 lattice with 57 to 128 obstacle cells, as in NEXT, for a snake of five links."""
    robot = Linkage.snake([LINK[0]] * LINKS, LINK[1], limits=math.pi, self_collision=True)
    while True:
        environment = lattice_environment(_lattice(rng, ANY_OBSTACLES))
        space = ConfigurationSpace(robot, environment, UNIT)
        start, goal = _free_snake(space, rng), _free_snake(space, rng)
        if start is not None and goal is not None and not space.motion_free(start, goal):
            return Problem(robot, environment, Task(start, goal), "Snake7", rotation_weight=UNIT)


def _free_snake(space: ConfigurationSpace, rng: np.random.Generator) -> NDArray[np.float64] | None:
    """(7,) a free configuration; None if none was found."""
    try:
        return free_pose(space, rng, tries=SNAKE_TRIES)
    except NoPathError:
        return None


def lattice_mazes(robot: str, obstacles: tuple[int, int], name: str = "LatticeMaze") -> SampledProblems:
    """Lattices like those of the NEXT benchmark, with a number of obstacle cells in a range.

    Args:
        robot: ``"point"`` or ``"stick"``.
        obstacles: Fewest and most obstacle cells; 56 is the border alone, 128 a perfect maze.
        name: Name of the distribution.

    Raises:
        InvalidInputError: Another robot or an impossible range.
    """
    lattice_robot(robot)
    if not 4 * (LATTICE - 1) <= obstacles[0] <= obstacles[1] <= MOST_OBSTACLES:
        raise InvalidInputError(f"obstacles: expected a range within 56 to 128, got {shown(obstacles)}")
    draw: Callable[[np.random.Generator], Problem]
    draw = partial(lattice_maze, robot=robot, obstacles=obstacles, name=name)
    return SampledProblems(name, draw, f"15 x 15 lattices, {obstacles[0]} to {obstacles[1]} obstacle cells")


def lattice_maze(
    rng: np.random.Generator, robot: str, obstacles: tuple[int, int], name: str, apart: int = 0
) -> Problem:
    """One problem of `lattice_mazes`: a perfect maze without some walls, start and goal anywhere.

    With ``apart``, start and goal do not see each other and their way leads through as many cells or more.
    """
    walls = _lattice(rng, obstacles)
    environment, body = lattice_environment(walls), lattice_robot(robot)
    space = ConfigurationSpace(body, environment, STICK_WEIGHT if body.dimension == 3 else None)
    start, goal = free_pose(space, rng), free_pose(space, rng)
    while apart and (len(way(walls, _cell(start), _cell(goal))) < apart or space.motion_free(start, goal)):
        start, goal = free_pose(space, rng), free_pose(space, rng)
    return lattice_problem(environment, body, Task(start, goal), name)


def _lattice(rng: np.random.Generator, obstacles: tuple[int, int]) -> Cells:
    """(15, 15) the obstacle cells of a perfect maze, but for some, so that a number in a range is left."""
    walls = carved(rng, LATTICE // 2, LATTICE // 2, newest=rng.random())
    keep = int(rng.integers(obstacles[0], obstacles[1] + 1))
    inner = np.argwhere(walls[1:-1, 1:-1]) + 1
    gone = rng.permutation(len(inner))[: MOST_OBSTACLES - keep]
    walls[tuple(inner[gone].T)] = False
    return walls


def _cell(q: NDArray[np.float64]) -> Room:
    i, j = ((q[:2] + 1.0) * (LATTICE / 2)).astype(int).tolist()
    return i, j


def lattice_robot(name: str) -> Robot:
    """The robots of the NEXT benchmark: a point, or a stick of length 0.2.

    Raises:
        InvalidInputError: Another name.
    """
    if name not in ("point", "stick"):
        raise InvalidInputError(f"robot: expected 'point' or 'stick', got {shown(name)}")
    return Robot.point() if name == "point" else Robot.segment(STICK_LENGTH)


def lattice_environment(walls: Cells) -> Environment:
    """The workspace [-1, 1]^2 with the True cells of a (15, 15) map as obstacles; first index x.

    Adjoining cells become few rectangles whose union is exactly theirs.
    """
    edges = (2.0 * np.arange(LATTICE + 1) - LATTICE) / LATTICE
    obstacles = tuple(box(edges[i0], edges[j0], edges[i1], edges[j1]) for i0, j0, i1, j1 in covering(walls))
    return Environment(LATTICE_BOUNDS, obstacles)


def lattice_problem(environment: Environment, robot: Robot, task: Task, name: str) -> Problem:
    """A problem in that frame, with the benchmark's distance: 0.4 / pi of length per radian."""
    weight = STICK_WEIGHT if robot.dimension == 3 else None
    return Problem(robot, environment, task, name, rotation_weight=weight)
