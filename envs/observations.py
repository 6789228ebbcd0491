"""What is observed of a search: padded arrays of its tree, task and workspace; nothing of the oracle."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, Final, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from guided_gym.checks import affordable, integer, shown
from guided_gym.doors import door, doors
from guided_gym.errors import InvalidInputError, warn
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.mechanism import Mechanism
from guided_gym.kernels import observe as kernel
from guided_gym.search.search import Expansion, Search
from guided_gym.search.tree import NO_PARENT

Observation = dict[str, NDArray[Any]]


class NodeColumn(IntEnum):
    """Columns of the node features of a robot with at most one angle; `node_columns` names those of others.

    "Unit" is the diameter of C: the distance between two corners of the bounds half a turn apart.
    """

    X = 0  # position, -1 to 1 across the bounds
    Y = 1
    COS = 2  # of the heading; 1 for a robot that cannot turn
    SIN = 3
    GOAL_X = 4  # goal - node, 1 = the width of the bounds
    GOAL_Y = 5
    GOAL_COS = 6  # of the turn to the goal's heading
    GOAL_SIN = 7
    GOAL_DISTANCE = 8  # d_X to the goal, obstacles ignored, in units
    COST_TO_COME = 9  # d_T(s, v) in units, clipped at 4
    DEPTH = 10  # edges from the root; counts are log(1 + count) / log(1 + max_samples)
    CHILDREN = 11  # count
    FAILURES = 12  # failed expansions, count
    CLEARANCE = 13  # distance of the placed robot to the nearest obstacle or bound; 1 = half the shorter side


COLUMNS: Final = len(NodeColumn)
_TAIL: Final = COLUMNS - NodeColumn.GOAL_DISTANCE
MAX_COST: Final = 4.0
SMALLEST_IMAGE: Final = 36  # below it, NatureCNN's convolutions leave nothing


def columns_of(angles: int) -> int:
    """Number F of node features with room for so many angles; 14 for one angle."""
    return COLUMNS + 4 * (angles - 1)


def node_columns(angles: int) -> tuple[str, ...]:
    """Names of the node features with room for so many angles, at least one.

    X and Y are of the reference point, or of an arm's tool; COS_k and SIN_k of angle k, from the base on, and
    1 and 0 where a robot has fewer angles. With one angle they are those of `NodeColumn`.
    """
    if angles == 1:
        return tuple(column.name for column in NodeColumn)
    turns = [f"{name}_{k}" for k in range(1, angles + 1) for name in ("COS", "SIN")]
    tail = [column.name for column in NodeColumn][-_TAIL:]
    return ("X", "Y", *turns, "GOAL_X", "GOAL_Y", *(f"GOAL_{name}" for name in turns), *tail)


def _column_bounds(angles: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Bounds of each column: the columns up to the goal's are signed, the others are not."""
    names = np.array(node_columns(angles))
    low = np.where(np.arange(names.size) < names.size - _TAIL, -1, 0).astype(np.float32)
    high = np.where(names == "COST_TO_COME", MAX_COST, 1).astype(np.float32)
    return low, high


def angles_of(robot: Mechanism) -> int:
    """How many of a robot's coordinates are angles."""
    return sum(name not in ("x", "y") for name in robot.names)


class Observer(Protocol):
    """Turns a search into observations. Has buffers, so each environment needs one of its own."""

    def build(self, max_nodes: int, max_samples: int) -> spaces.Dict:
        """Allocate for trees of that size; returns the observation space. Called once."""

    def reset(self, search: Search) -> None:
        """A new search begins."""

    def update(self, search: Search, expansion: Expansion) -> None:
        """The search was expanded."""

    def extract(self, search: Search) -> Observation:
        """The observation: fresh arrays, in the observation space."""


@door
def valid_nodes(search: Search, max_nodes: int) -> NDArray[np.bool_]:
    """(max_nodes,) bool, True for the nodes that may be expanded: all there are, so never none."""
    mask = np.zeros(max_nodes, np.bool_)
    mask[: len(search.tree)] = True
    return mask


@door
def node_table(observation: Mapping[str, NDArray[Any]], columns: int = COLUMNS) -> NDArray[np.float32]:
    """The node features of an observation (or of a batch) as a table: (..., N * F) to (..., N, F).

    Raises:
        InvalidInputError: The observation has no such features.
    """
    nodes: Any = observation.get("nodes")
    columns = integer("columns", columns, least=1)
    shape = getattr(nodes, "shape", ())  # tensors will do
    if not shape or shape[-1] % columns:
        raise InvalidInputError(
            f"observation: expected rows of {columns} features for each node under 'nodes', got "
            f"{shown(shape or nodes)}"
        )
    table: NDArray[np.float32] = nodes.reshape(*nodes.shape[:-1], -1, columns)
    return table


def node_bytes(max_nodes: int, angles: int = 1) -> int:
    """Bytes of an observation of that many nodes, the raster apart: features, parent and mask of each."""
    return max_nodes * (4 * columns_of(angles) + 5)


@door
def rollout_bytes(max_nodes: int = 256, raster: int = 64, environments: int = 8, steps: int = 2048) -> int:
    """Bytes of a PPO rollout buffer over the default observation, with masks.

    ``environments * steps * (max_nodes * (4 * F + 9) + raster**2 + 64)`` with F = `COLUMNS`: per node F
    float32 features, an int32 parent, the int8 mask in the observation and the float32 mask that MaskablePPO
    keeps; a byte per cell of the raster; 32 bytes for start and goal, and 32 for action, reward, return,
    episode start, value, log-probability and advantage. 341 MB at the defaults (555 MB if everything were
    float32); sampling from the buffer copies it once, key by key.
    """
    for name, value in (("max_nodes", max_nodes), ("raster", raster)):
        integer(name, value, least=0)
    for name, value in (("environments", environments), ("steps", steps)):
        integer(name, value, least=1)
    return environments * steps * (max_nodes * (4 * COLUMNS + 9) + raster**2 + 64)


@doors
class TreeObservation:
    """The default observation: a flat Dict of padded arrays.

    ============  ==========================  ========================================================
    key           shape, dtype                content
    ============  ==========================  ========================================================
    nodes         (max_nodes * F,) float32    features of node i at ``[i * F + column]``, columns as in
                                              `node_columns`, zeros beyond the tree; `node_table` gives
                                              (max_nodes, F)
    parents       (max_nodes,) int32          parent of each node, -1 at the root and beyond the tree
    action_mask   (max_nodes,) int8           1 for the nodes that may be expanded: all there are
    start, goal   (2 + 2 n,) float32          x, y, then cos, sin of each angle, scaled like the nodes
    raster        (1, raster, raster) uint8   the workspace: 255 times the share of a cell that obstacles
                                              cover (of four points); row 0 is the bottom, column 0 the left
    ============  ==========================  ========================================================

    The table of nodes is flat since stable-baselines3 takes vectors and images, and warns of all else.

    Args:
        raster: Cells along each side of the raster; below `SMALLEST_IMAGE` a warning is given.
        angles: n, the number of angles that have columns: F = 10 + 4 n, 14 for rigid planar robots.

    Raises:
        InvalidInputError: raster or angles is not a positive integer, or raster takes too much memory.
    """

    def __init__(self, raster: int = 64, angles: int = 1) -> None:
        self.angles = integer("angles", angles, least=1)
        if self.angles > kernel.MOST_ANGLES:
            raise InvalidInputError(
                f"angles: expected at most {kernel.MOST_ANGLES}, got {angles}; pass your own observer"
            )
        self.columns = columns_of(self.angles)
        self.raster = integer("raster", raster, least=1)
        # Four points a cell, in float64, while it is drawn.
        affordable("raster", raster, 2 * 8 * (2 * self.raster) ** 2, "a picture of the workspace")
        if self.raster < SMALLEST_IMAGE:
            warn(
                f"raster={raster}: the default network of stable-baselines3 (NatureCNN) needs at least "
                f"{SMALLEST_IMAGE} cells a side; bring a network of your own, or take a larger raster"
            )
        self._drawn: tuple[Environment, NDArray[np.uint8]] | None = None

    def build(self, max_nodes: int, max_samples: int) -> spaces.Dict:
        """Allocate the buffers; returns the observation space."""
        self._max_nodes = max_nodes
        self._nodes = np.zeros((max_nodes, self.columns), np.float32)
        self._parents = np.full(max_nodes, NO_PARENT, np.int32)
        self._counts = shown_counts(max_samples)
        low, high = (np.tile(bound, max_nodes) for bound in _column_bounds(self.angles))
        n = self.raster
        return spaces.Dict(
            {
                "nodes": spaces.Box(low, high, dtype=np.float32),
                "parents": spaces.Box(NO_PARENT, max_nodes - 1, (max_nodes,), np.int32),
                "action_mask": spaces.Box(0, 1, (max_nodes,), np.int8),
                "start": spaces.Box(-1, 1, (2 + 2 * self.angles,), np.float32),
                "goal": spaces.Box(-1, 1, (2 + 2 * self.angles,), np.float32),
                "raster": spaces.Box(0, 255, (1, n, n), np.uint8),
            }
        )

    def clone(self) -> TreeObservation:
        """An observer of a clone of the search."""
        other = copy.copy(self)
        other._nodes, other._parents = self._nodes.copy(), self._parents.copy()
        return other

    def reset(self, search: Search) -> None:
        """Forget the last search; fix the scales of this one.

        Raises:
            InvalidInputError: A robot that these columns cannot describe.
        """
        self._scales = scales_of(search, self.angles)
        self._nodes.fill(0.0)
        self._parents.fill(NO_PARENT)
        self._n = 0
        self._rewirings = search.tree.rewirings
        self._ends = {
            "start": observed_pose(search, search.start, self._scales),
            "goal": observed_pose(search, search.goal, self._scales),
        }
        self._add_nodes(search)

    def update(self, search: Search, expansion: Expansion) -> None:
        """Write the new node and the counts of the expanded one; of all nodes, if the tree was rewired."""
        tree = search.tree
        self._add_nodes(search)
        if tree.rewirings != self._rewirings:
            self._rewirings = tree.rewirings
            for i in range(self._n):
                self._write_place_in_tree(search, i)
        else:
            self._write_place_in_tree(search, expansion.node)

    def extract(self, search: Search) -> Observation:
        """Fresh copies of all arrays."""
        return {
            "nodes": self._nodes.ravel().copy(),
            "parents": self._parents.copy(),
            "action_mask": valid_nodes(search, self._max_nodes).view(np.int8),
            "start": self._ends["start"].copy(),
            "goal": self._ends["goal"].copy(),
            "raster": self._workspace(search.problem.environment).copy(),
        }

    def _add_nodes(self, search: Search) -> None:
        for i in range(self._n, len(search.tree)):
            q, geometry = search.tree.nodes.configurations[i], search.space.geometry
            kernel.observe_configuration(self._nodes[i], q, search.goal, self._scales, geometry)
            self._write_place_in_tree(search, i)
        self._n = len(search.tree)

    def _write_place_in_tree(self, search: Search, i: int) -> None:
        """The columns that change while the tree grows."""
        nodes = search.tree.nodes
        counts = (nodes.depths.item(i), nodes.children.item(i), nodes.failures.item(i))
        unit = self._scales.item(kernel.UNIT)
        kernel.observe_place(self._nodes[i], nodes.costs.item(i), counts, unit, MAX_COST, self._counts)
        self._parents[i] = nodes.parents[i]

    def _workspace(self, environment: Environment) -> NDArray[np.uint8]:
        if self._drawn is None or self._drawn[0] is not environment:
            self._drawn = (environment, drawn_workspace(environment, self.raster))
        return self._drawn[1]


def scales_of(search: Search, shown: int = 1) -> NDArray[np.float64]:
    """(SCALES,) by which the features of a search's nodes are divided, as the kernels take them.

    Args:
        search: The search.
        shown: For how many angles there are columns.

    Raises:
        InvalidInputError: The robot has more angles.
    """
    space = search.space
    angles = angles_of(space.robot)
    if angles > shown:
        raise InvalidInputError(
            f"observe: expected a robot with at most {shown} angles, as many as these observations show, "
            f"got one with {angles}; TreeObservation(angles={angles}) shows them"
        )
    first = space.dimension - angles
    xmin, ymin, xmax, ymax = space.environment.bounds
    size = np.array([xmax - xmin, ymax - ymin])
    scales = np.zeros(kernel.SCALES)
    scales[[kernel.X, kernel.Y, kernel.WIDTH, kernel.HEIGHT]] = xmin, ymin, *size
    scales[kernel.ANGLE], scales[kernel.ANGLES], scales[kernel.SHOWN] = first, angles, shown
    scales[kernel.WEIGHTS : kernel.WEIGHTS + angles] = space.weights[first:]
    scales[kernel.PERIODS : kernel.PERIODS + angles] = space.periods[first:]
    farthest = np.where(space.periods > 0, 0.5 * space.periods, space.upper - space.lower)
    scales[kernel.UNIT] = math.hypot(*(farthest * space.weights))
    scales[kernel.ROOM] = size.min() / 2
    return scales


def observed_pose(search: Search, q: NDArray[np.float64], scales: NDArray[np.float64]) -> NDArray[np.float32]:
    """(2 + 2 n,) x, y and cos, sin of each angle of a configuration, scaled like the nodes."""
    first, shown = int(scales[kernel.ANGLE]), int(scales[kernel.SHOWN])
    low, size = scales[[kernel.X, kernel.Y]], scales[[kernel.WIDTH, kernel.HEIGHT]]
    angles = np.append(q[first:], np.zeros(shown - (q.size - first))).tolist()
    turns = [part for angle in angles for part in (math.cos(angle), math.sin(angle))]
    x, y = (2 * (search.space.robot.position(q) - low) / size - 1).tolist()
    return np.array([x, y, *turns], np.float32).clip(-1, 1)


def shown_counts(max_samples: int) -> NDArray[np.float64]:
    """(max_samples + 2,) what is shown of each count: its logarithm, at most 1."""
    logarithms = np.log1p(np.arange(max_samples + 2)) / math.log1p(max(max_samples, 1))
    return logarithms.clip(max=1)


def drawn_workspace(environment: Environment, raster: int) -> NDArray[np.uint8]:
    """(1, raster, raster) 255 times the share of each cell that obstacles cover, row 0 at the bottom."""
    # Four points a cell: a wall half as thin as a cell leaves its trace.
    points = environment.raster(2 * raster).reshape(raster, 2, raster, 2)
    covered = points.sum(axis=(1, 3), dtype=np.uint16) * 255 // 4
    drawn: NDArray[np.uint8] = covered.astype(np.uint8)[np.newaxis]
    return drawn
