"""Still pictures of problems and of what guides, as SVG for notebooks."""

from __future__ import annotations

import base64
import struct
import zlib
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.display.pages import escaped
from guided_gym.geometry.solids import SpatialEnvironment

if TYPE_CHECKING:
    from guided_gym.problems import Problem
    from guided_gym.search.tree import SearchTree

WIDTH: Final = 380  # pixels of a picture, along its longer side
_MARGIN: Final = 4

# Those of view.js in light: a notebook's page may be dark, the picture brings its own paper.
_PAPER, _OBSTACLE, _INK = "#f8f7f4", "#4a525e", "#21252b"
_START, _GOAL, _PATH = "#0072b2", "#008a64", "#d52c14"
_FIELD: Final = (0, 114, 178)

Floats = NDArray[np.float64]


class Picture:
    """An SVG of a workspace, drawn from the back to the front.

    Args:
        problem: The problem whose workspace it shows.
        title: What it shows, for people who cannot see.
        width: Pixels along the longer side.
    """

    def __init__(self, problem: Problem, title: str, width: int = WIDTH) -> None:
        self._problem = problem
        self._title = title
        xmin, ymin, xmax, ymax = problem.environment.bounds
        self._scale = (width - 2 * _MARGIN) / max(xmax - xmin, ymax - ymin)
        self._corner = np.array([xmin, ymax])
        self._size = (xmax - xmin) * self._scale, (ymax - ymin) * self._scale
        self._parts: list[str] = []

    def pixels(self, points: Floats) -> Floats:
        """(n, 2) pixels of points (n, 2) of the workspace."""
        placed: Floats = (points - self._corner) * (self._scale, -self._scale) + _MARGIN
        return placed

    def _path(self, data: str, style: str) -> None:
        if data:
            self._parts.append(f'<path d="{data}" {style}/>')

    def _ring(self, points: Floats, closed: bool) -> str:
        pairs = (f"{x:.1f} {y:.1f}" for x, y in self.pixels(points).tolist())
        return "M" + "L".join(pairs) + ("Z" if closed else "")

    def obstacles(self) -> None:
        """The obstacles; in space they let through what is behind them."""
        see_through = isinstance(self._problem.environment, SpatialEnvironment)
        style = f'fill-opacity="0.22" stroke="{_OBSTACLE}" stroke-width="0.8"' if see_through else ""
        for one in self._problem.environment.obstacles:  # each a path: where two overlap is no hole
            rings = (one.exterior, *one.interiors)
            data = "".join(self._ring(shapely.get_coordinates(ring)[:-1], True) for ring in rings)
            self._path(data, f'fill="{_OBSTACLE}" fill-rule="evenodd" {style}')

    def robot(self, q: Floats, colour: str, filled: bool = False) -> None:
        """The robot at a configuration."""
        for shape in self._problem.robot.place(q):
            points = shapely.get_coordinates(shape)
            if len(points) == 1:
                x, y = self.pixels(points)[0]
                inside = colour if filled else "none"
                self._parts.append(
                    f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{inside}" stroke="{colour}"/>'
                )
                continue
            closed = isinstance(shape, shapely.Polygon)
            fill = f'fill="{colour}" fill-opacity="0.35"' if filled and closed else 'fill="none"'
            self._path(
                self._ring(points[:-1] if closed else points, closed),
                f'{fill} stroke="{colour}" stroke-width="{1.5 if filled else 0.8}"',
            )

    def task(self) -> None:
        """The robot at start and goal."""
        self.robot(self._problem.task.start, _START, filled=True)
        self.robot(self._problem.task.goal, _GOAL, filled=True)

    def segments(self, ends: Floats, colour: str, width: float, opacity: float = 1.0) -> None:
        """(m, 2, 2) straight lines."""
        rows = self.pixels(ends.reshape(-1, 2)).reshape(-1, 4).tolist()
        data = "".join(f"M{a:.0f} {b:.0f}L{c:.0f} {d:.0f}" for a, b, c, d in rows)
        self._path(data, f'fill="none" stroke="{colour}" stroke-width="{width}" stroke-opacity="{opacity}"')

    def tree(self, tree: SearchTree) -> None:
        """The edges of a tree, between the robot's positions."""
        points, parents = self._problem.robot.position(tree.configurations), tree.parents
        children = np.flatnonzero(parents >= 0)
        self.segments(np.stack([points[parents[children]], points[children]], axis=1), _INK, 0.9)

    def path(self, path: Floats) -> None:
        """A path, wide and pale."""
        if len(path) > 1:
            data = self._ring(self._problem.robot.position(path), False)
            style = f'fill="none" stroke="{_PATH}" stroke-width="5" stroke-opacity="0.4"'
            self._path(data, f'{style} stroke-linejoin="round" stroke-linecap="round"')

    def graph(self, drawing: dict[str, Any]) -> None:
        """A guiding space's graph: what is alive, and what failures removed."""
        ends, alive = drawing["points"][drawing["edges"]], drawing["alive"]
        width, opacity = (1.4, 0.9) if len(ends) <= 500 else (0.5, 0.5) if len(ends) <= 5000 else (0.4, 0.25)
        self.segments(ends[alive], _START, width, opacity)
        self.segments(ends[~alive], _PATH, 0.5, 0.4)

    def field(self, values: Floats, bounds: list[float]) -> None:
        """The field h over the workspace, the stronger the smaller; row by row from below."""
        finite = np.isfinite(values)
        shade = np.zeros(values.shape)
        if finite.any():
            low, high = values[finite].min(), values[finite].max()
            shade[finite] = 0.66 - 0.62 * (values[finite] - low) / max(high - low, 1e-300)
        image = np.empty((*values.shape, 4), np.uint8)
        image[..., :3], image[..., 3] = _FIELD, np.rint(255 * shade)
        data = base64.b64encode(_png(image[::-1])).decode("ascii")
        (x, y), (right, low_y) = self.pixels(np.array([[bounds[0], bounds[3]], [bounds[2], bounds[1]]]))
        self._parts.append(
            f'<image x="{x:.1f}" y="{y:.1f}" width="{right - x:.1f}" height="{low_y - y:.1f}" '
            f'preserveAspectRatio="none" href="data:image/png;base64,{data}"/>'
        )

    def text(self) -> str:
        """The SVG."""
        width, height = (side + 2 * _MARGIN for side in self._size)
        inner = f"{self._size[0]:.1f}", f"{self._size[1]:.1f}"  # of the workspace
        frame = f'x="{_MARGIN}" y="{_MARGIN}" width="{inner[0]}" height="{inner[1]}"'
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
            f'viewBox="0 0 {width:.1f} {height:.1f}" role="img" style="max-width: 100%; height: auto">'
            f'<title>{escaped(self._title)}</title><rect {frame} fill="{_PAPER}"/>'
            f'<svg {frame} viewBox="{_MARGIN} {_MARGIN} {self._size[0]:.1f} {self._size[1]:.1f}">'
            f"{''.join(self._parts)}</svg>"
            f'<rect {frame} fill="none" stroke="{_OBSTACLE}"/></svg>'
        )


def _png(image: NDArray[np.uint8]) -> bytes:
    """(H, W, 4) as a PNG."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width = image.shape[:2]
    rows = b"".join(b"\0" + row.tobytes() for row in image)
    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", head)
        + chunk(b"IDAT", zlib.compress(rows, 9))
        + chunk(b"IEND", b"")
    )


def problem_picture(problem: Problem, width: int = WIDTH) -> Picture:
    """A problem: obstacles, start and goal."""
    picture = Picture(problem, f"{problem.name}: start in blue, goal in green", width)
    picture.obstacles()
    picture.task()
    return picture
