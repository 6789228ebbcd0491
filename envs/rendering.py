"""Frames of a search, drawn with pygame: the tree coloured by the target, failures, and the path found.

Nothing here needs a display, except `Renderer.show`.
"""

from __future__ import annotations

import importlib.util
import itertools
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

from guided_gym.checks import shown
from guided_gym.envs import palette
from guided_gym.envs.palette import Colour
from guided_gym.errors import GuidedGymError, InvalidInputError
from guided_gym.geometry.solids import SpatialEnvironment
from guided_gym.kernels.pixels import shrink
from guided_gym.measure.target import Measure
from guided_gym.search.tree import NO_PARENT
from guided_gym.trajectories import spaced_path

if TYPE_CHECKING:
    from guided_gym.geometry.environment import Environment
    from guided_gym.geometry.mechanism import Mechanism
    from guided_gym.geometry.space import ConfigurationSpace
    from guided_gym.problems import Problem
    from guided_gym.search.search import Search
    from guided_gym.search.tree import SearchTree

Points = NDArray[np.float64]
Pixels = NDArray[np.uint8]

DEFAULT_SIZE = 640
SMALLEST_SIZE = 64
OVERSAMPLING = 2  # drawn this much larger, then scaled down: that is what smooths the edges
MARGIN = 1 / 40  # of the frame's size, around the workspace
CAPTION = 1 / 16  # of the frame's size, below the workspace
_TRACE = 200  # parts of the diagonal, that are drawn straight of the way of an arm's tool
LARGEST_TREE_WITH_DISCS = 4000  # beyond it the discs of the nodes hide their edges


def import_pygame() -> Any:
    """The pygame module, without its greeting.

    Raises:
        GuidedGymError: pygame is not installed; the message names the extra to install.
    """
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # pygame 2.6 imports the deprecated pkg_resources
            import pygame
            import pygame.font
    except ImportError as error:
        raise GuidedGymError(
            f"rendering needs pygame, which cannot be imported ({error}); "
            "in a checkout of guided-gym: pip install '.[render]'"
        ) from error
    return pygame


class Renderer:
    """Draws searches as RGB frames, or in a window.

    What does not change between the frames of one search (obstacles, start and goal, the failures so far)
    is drawn once and kept. A frame depends on nothing but the search: the same search, the same pixels.

    Args:
        size: Width of the frame in pixels; of its height where the workspace is taller than wide. The caption
            adds 1/16 below.
        fps: Frames per second that `show` holds itself to.

    Raises:
        InvalidInputError: A size below 64 pixels, or a frame rate that is not positive.
        GuidedGymError: pygame is missing.
    """

    def __init__(self, size: int = DEFAULT_SIZE, fps: int = 30) -> None:
        if size < SMALLEST_SIZE:
            raise InvalidInputError(f"size: expected at least {SMALLEST_SIZE} pixels, got {shown(size)}")
        if fps <= 0:
            raise InvalidInputError(f"fps: expected a positive number, got {shown(fps)}")
        self.size, self.fps = int(size), fps
        self._pygame = import_pygame()
        self._scene: _Scene | None = None
        self._window: Any = None
        self._clock: Any = None
        self._dismissed = False

    def __reduce__(self) -> tuple[Any, ...]:
        """A copy draws afresh, in a window of its own: surfaces can be neither copied nor sent."""
        return type(self), (self.size, self.fps)

    def frame(
        self, search: Search, *, target: Points | None = None, efficiency: float | None = None
    ) -> Pixels:
        """One frame of the search as it stands.

        Args:
            search: The search to draw.
            target: (n,) target probabilities that colour the nodes; the search's own by default, which asks
                the oracle.
            efficiency: SE for the caption, in nats; none is shown by default.

        Returns:
            (H, W, 3) uint8; H and W are even, as video codecs want them.

        Raises:
            InvalidInputError: ``target`` does not have one entry per node.
        """
        return self._draw(search, target, efficiency)

    def show(self, search: Search, *, target: Points | None = None, efficiency: float | None = None) -> None:
        """Draw the search in a window, at most ``fps`` times a second; the arguments are those of `frame`.

        Once the window has been closed by hand, nothing is shown until `close`.
        """
        pygame = self._pygame
        if self._dismissed:
            return
        pixels = self._draw(search, target, efficiency)
        size = pixels.shape[1::-1]
        if self._window is None or self._window.get_size() != size:
            pygame.display.init()
            self._window = pygame.display.set_mode(size)
            pygame.display.set_caption(f"guided-gym: {search.problem.name}")
            self._clock = pygame.time.Clock()
        self._window.blit(pygame.image.frombuffer(pixels, size, "RGB"), (0, 0))
        quit_asked = any(event.type == pygame.QUIT for event in pygame.event.get())
        pygame.display.flip()
        self._clock.tick(self.fps)
        if quit_asked:
            self.close()
            self._dismissed = True

    def close(self) -> None:
        """Close the window and drop what was kept; safe to call twice."""
        if self._window is not None:
            self._pygame.display.quit()
        self._window = self._clock = self._scene = None
        self._dismissed = False

    def _draw(self, search: Search, target: Points | None, efficiency: float | None) -> Pixels:
        target = Measure(search).distribution() if target is None else np.asarray(target, np.float64)
        if target.shape != (len(search.tree),):
            raise InvalidInputError(
                f"target: expected shape ({len(search.tree)},), one entry per node, got {target.shape}"
            )
        if self._scene is None or not self._scene.shows(search):
            self._scene = _Scene(self._pygame, search, self.size)
        return self._scene.draw(search, target, efficiency)


class _Scene:
    """The drawing of one search: its fixed layer, and what is laid over it frame by frame."""

    def __init__(self, pygame: Any, search: Search, size: int) -> None:
        self._problem, self._tree = search.problem, search.tree
        self._view = _View(search.problem.environment, size)
        self._base = _Canvas(pygame, self._view)
        self._canvas = _Canvas(pygame, self._view)
        self._caption = _Caption(pygame, self._view)
        self._drawn_failures = 0
        _draw_workspace(self._base, self._problem.environment)
        self._caption.draw_key(self._base.surface)

    def shows(self, search: Search) -> bool:
        return self._problem is search.problem and self._tree is search.tree

    def draw(self, search: Search, target: Points, efficiency: float | None) -> Pixels:
        canvas = self._canvas
        self._draw_new_failures()
        canvas.surface.blit(self._base.surface, (0, 0))
        _draw_tree(canvas, search.tree, target)
        path = search.path()
        if path is not None:
            _draw_path(canvas, search, path)
        _draw_task(canvas, self._problem)
        if path is None and search.last is not None:
            selected = search.tree.configurations[search.last.node]
            canvas.robot(self._problem.robot, selected, palette.FREE, width=4.0)  # stands out from the tree
            canvas.robot(self._problem.robot, selected, palette.INK, width=1.6)
        self._caption.draw(canvas.surface, search, efficiency)
        return canvas.reduced()

    def _draw_new_failures(self) -> None:
        contacts = self._tree.contacts[self._drawn_failures :]
        self._base.marks(self._problem.robot.position(contacts), palette.FAILURE)
        self._drawn_failures = self._tree.failure_count


def _draw_workspace(canvas: _Canvas, environment: Environment) -> None:
    if isinstance(environment, SpatialEnvironment):
        for shadow in environment.obstacles:
            canvas.veil(np.asarray(shadow.exterior.coords), palette.OBSTACLE)
        return canvas.border(palette.FRAME)
    pieces = [p for p in shapely.get_parts(environment.obstacle_union) if isinstance(p, shapely.Polygon)]
    # The largest first, so that an obstacle within another's hole is drawn after the hole.
    for polygon in sorted(pieces, key=lambda p: -shapely.Polygon(p.exterior).area):
        canvas.polygon(np.asarray(polygon.exterior.coords), palette.OBSTACLE)
        for hole in polygon.interiors:
            canvas.polygon(np.asarray(hole.coords), palette.FREE)
    canvas.border(palette.FRAME)


def _draw_tree(canvas: _Canvas, tree: SearchTree, target: Points) -> None:
    points = canvas.view.pixels(tree.space.robot.position(tree.configurations)).tolist()
    parents = tree.parents.tolist()
    levels = palette.target_levels(target)
    order = np.argsort(levels, kind="stable").tolist()  # the likeliest on top
    colours = [palette.TARGET_COLOURS[level].tolist() for level in levels]
    for node in order:
        if parents[node] != NO_PARENT:
            canvas.segment(points[parents[node]], points[node], colours[node], 1.3)
    if len(order) <= LARGEST_TREE_WITH_DISCS:
        for node in order:
            canvas.disc(points[node], colours[node], 2.2)


def _draw_task(canvas: _Canvas, problem: Problem) -> None:
    for q, colour in ((problem.task.start, palette.START), (problem.task.goal, palette.GOAL)):
        canvas.robot(problem.robot, q, colour, width=2.0, fill=True)


def _draw_path(canvas: _Canvas, search: Search, path: Points) -> None:
    pixels = canvas.view.pixels(trace(search.space, path)).tolist()
    canvas.polyline(pixels, palette.FREE, 5.0)
    canvas.polyline(pixels, palette.PATH, 2.6)
    for q in spaced(search, path)[1:-1]:
        canvas.robot(search.problem.robot, q, palette.PATH, width=1.3)


def trace(space: ConfigurationSpace, path: Points) -> Points:
    """(k, 2) the way of the robot's position along a path (m, d)."""
    if not space.robot.straight and len(path) > 1:
        path = spaced_path(space, path, space.extent / _TRACE)
    return space.robot.position(path)


def spaced(search_or_problem: Search | Problem, path: Points, gap: float | None = None) -> Points:
    """(k, d) configurations along a path (m, d), about ``gap`` apart in the space's distance, ends included.

    Args:
        search_or_problem: What the path belongs to; only its ``space`` is asked.
        path: The path.
        gap: Distance between neighbours; None for a thirteenth of the workspace's diagonal, or the robot's
            diameter if that is more.
    """
    if len(path) < 2:  # the start is near enough to the goal
        return path
    space = search_or_problem.space
    gap = max(space.extent / 13, space.robot.size) if gap is None else gap
    lengths = np.atleast_1d(space.distance(path[:-1], path[1:]))
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    stops = np.linspace(0.0, along[-1], max(2, round(along[-1] / gap) + 1))
    edge = np.clip(np.searchsorted(along, stops, side="right") - 1, 0, len(path) - 2)
    t = np.clip((stops - along[edge]) / np.maximum(lengths[edge], 1e-300), 0.0, 1.0)
    return space.interpolate(path[edge], path[edge + 1], t)


class _View:
    """Where the workspace lies in the frame; in pixels of the oversampled canvas."""

    def __init__(self, environment: Environment, size: int) -> None:
        xmin, ymin, xmax, ymax = environment.bounds
        self.corner = np.array([xmin, ymax])
        self.unit = size * OVERSAMPLING / DEFAULT_SIZE  # line widths are given for the default size
        margin = size * MARGIN
        scale = (size - 2 * margin) / max(xmax - xmin, ymax - ymin)
        width, height = (xmax - xmin) * scale + 2 * margin, (ymax - ymin) * scale + 2 * margin
        self.size = (_even(max(width, size / 2)), _even(height + size * CAPTION))
        self.canvas_size = (self.size[0] * OVERSAMPLING, self.size[1] * OVERSAMPLING)
        self.scale = scale * OVERSAMPLING
        left = (self.size[0] - (xmax - xmin) * scale) / 2
        self.offset = np.array([left, margin]) * OVERSAMPLING
        self.box = (*self.offset, (xmax - xmin) * self.scale, (ymax - ymin) * self.scale)
        self.caption_top = self.box[1] + self.box[3]
        self.bottom = float(self.canvas_size[1])

    def pixels(self, points: Points) -> Points:
        """(n, 2) pixels of workspace points (n, 2)."""
        placed: Points = self.offset + (points - self.corner) * (self.scale, -self.scale)
        return placed


def _even(length: float) -> int:
    return 2 * round(length / 2)


class _Canvas:
    """An oversampled surface and the few shapes that are drawn on it.

    Workspace shapes are clipped to the workspace. Widths and radii are in pixels of the default size.
    """

    def __init__(self, pygame: Any, view: _View) -> None:
        self._pygame, self.view = pygame, view
        self.surface = pygame.Surface(view.canvas_size, 0, 32, (0xFF0000, 0xFF00, 0xFF, 0))
        self.surface.fill(palette.PAPER)
        self._box = pygame.Rect([round(float(v)) for v in view.box])
        self.surface.fill(palette.FREE, self._box)

    def reduced(self) -> Pixels:
        """(H, W, 3) uint8: the surface at the frame's size."""
        width, height = self.view.canvas_size
        pixels = np.frombuffer(self.surface.get_buffer(), np.uint32).reshape(height, width)
        out = np.empty((self.view.size[1], self.view.size[0], 3), np.uint8)
        shrink(pixels, OVERSAMPLING, out)
        return out

    def border(self, colour: Colour) -> None:
        self._pygame.draw.rect(self.surface, colour, self._box, self._width(1.0))

    def polygon(self, ring: Points, colour: Colour) -> None:
        self.surface.set_clip(self._box)
        self._pygame.draw.polygon(self.surface, colour, self.view.pixels(ring).tolist())
        self.surface.set_clip(None)

    def veil(self, ring: Points, colour: Colour) -> None:
        """A polygon that lets through what is behind it, with its outline."""
        pixels = self.view.pixels(ring).tolist()
        layer = self._pygame.Surface(self.view.canvas_size, self._pygame.SRCALPHA)
        self._pygame.draw.polygon(layer, (*colour, 56), pixels)
        self.surface.set_clip(self._box)
        self.surface.blit(layer, (0, 0))
        self.polyline(pixels, colour, 0.8)
        self.surface.set_clip(None)

    def segment(self, a: list[float], b: list[float], colour: Colour, width: float) -> None:
        self._pygame.draw.line(self.surface, colour, a, b, self._width(width))

    def disc(self, centre: list[float], colour: Colour, radius: float) -> None:
        self._pygame.draw.circle(self.surface, colour, centre, radius * self.view.unit)

    def polyline(self, pixels: list[list[float]], colour: Colour, width: float) -> None:
        for a, b in itertools.pairwise(pixels):
            self.segment(a, b, colour, width)
        for joint in pixels:
            self.disc(joint, colour, width / 2)

    def marks(self, points: Points, colour: Colour) -> None:
        """Faint dots; they add up where there are many."""
        radius = max(1, round(1.8 * self.view.unit))
        stamp = self._pygame.Surface((2 * radius + 1, 2 * radius + 1), self._pygame.SRCALPHA)
        self._pygame.draw.circle(stamp, (*colour, 56), (radius, radius), radius)
        for x, y in self.view.pixels(points).tolist():
            self.surface.blit(stamp, (round(x) - radius, round(y) - radius))

    def robot(self, robot: Mechanism, q: Points, colour: Colour, width: float, fill: bool = False) -> None:
        for shape in robot.place(q):
            self._body(shape, colour, width, fill)

    def _body(self, shape: Any, colour: Colour, width: float, fill: bool) -> None:
        ring = shape.exterior if isinstance(shape, shapely.Polygon) else shape
        pixels = self.view.pixels(np.asarray(ring.coords)).tolist()
        if len(pixels) == 1:
            self.disc(pixels[0], colour, 5.0 if fill else 3.5)
            return
        if fill and len(pixels) > 2:
            tint = tuple((c + 2 * f) // 3 for c, f in zip(colour, palette.FREE, strict=True))
            self._pygame.draw.polygon(self.surface, tint, pixels)
        self.polyline(pixels, colour, width)

    def _width(self, width: float) -> int:
        return max(OVERSAMPLING, round(width * self.view.unit))


class _Caption:
    """The line of text below the workspace, and the key to the nodes' colours."""

    def __init__(self, pygame: Any, view: _View) -> None:
        self._pygame, self._view = pygame, view
        pygame.font.init()
        self._font = pygame.font.Font(_font_file(), round(11.5 * view.unit))
        self._middle = view.caption_top + (view.bottom - view.caption_top) / 2
        self._left = float(view.box[0])
        self._right = float(view.box[0] + view.box[2])

    def draw_key(self, surface: Any) -> None:
        """The key to the colours, where the numbers leave room for it."""
        unit = self._view.unit
        if self._right - self._left < 480 * unit:
            return
        x = self._text(surface, "high", self._right, palette.MUTED, align=1.0)
        width, height = 72 * unit, 8 * unit
        key = self._pygame.surfarray.make_surface(np.repeat(palette.TARGET_COLOURS[:, None, :], 4, axis=1))
        key = self._pygame.transform.smoothscale(key, (round(width), round(height)))
        x -= width + 5 * unit
        surface.blit(key, (round(x), round(self._middle - height / 2)))
        self._text(surface, "target Q  low", x - 5 * unit, palette.MUTED, align=1.0)

    def draw(self, surface: Any, search: Search, efficiency: float | None) -> None:
        """The numbers of this frame; each in a column of its own, so that they stand still in a video."""
        columns = [("samples", f"{search.samples}"), ("nodes", f"{len(search.tree)}")]
        if efficiency is not None:
            columns.append(("SE", f"{efficiency:.2f} nats"))
        x = self._left
        for label, value in columns:
            start = self._text(surface, label, x, palette.MUTED) + 5 * self._view.unit
            self._text(surface, value, start, palette.INK)
            x = start + 42 * self._view.unit

    def _text(self, surface: Any, text: str, x: float, colour: Colour, align: float = 0.0) -> float:
        """Write text, its left (align 0) or right (align 1) end at x; returns its other end."""
        image = self._font.render(text, True, colour)
        width, height = map(float, image.get_size())
        surface.blit(image, (round(x - align * width), round(self._middle - height / 2)))
        return x - width if align else x + width


def _font_file() -> str | None:
    """DejaVu Sans, which matplotlib brings along (without importing it); None for pygame's own font."""
    spec = importlib.util.find_spec("matplotlib")
    for folder in (spec.submodule_search_locations if spec else None) or ():
        file = Path(folder) / "mpl-data" / "fonts" / "ttf" / "DejaVuSans.ttf"
        if file.is_file():
            return str(file)
    return None
