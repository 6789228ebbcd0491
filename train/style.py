"""How all figures look: sizes, fonts, one colour per guidance, and how they are written."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Final, ParamSpec, TypeVar

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from guided_gym.checks import shown
from guided_gym.envs import palette
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.guidance.grammar import JOINED, parse

P = ParamSpec("P")
R = TypeVar("R")

COLUMN: Final = 3.5  # inches, one column of a paper
PAGE: Final = 7.16  # inches, both columns
FORMATS: Final = ("pdf", "png", "svg")

TARGET_MAP: Final = ListedColormap(palette.TARGET_COLOURS / 255.0, name="target")
INK: Final = palette.hexadecimal(palette.INK)
MUTED: Final = palette.hexadecimal(palette.MUTED)

_RC: Final[Any] = {  # matplotlib types its 300 keys as literals
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],  # comes with matplotlib: the same figure everywhere
    "font.size": 8.0,
    "axes.titlesize": 8.5,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.minor.width": 0.4,
    "ytick.minor.width": 0.4,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "xtick.minor.size": 1.5,
    "ytick.minor.size": 1.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "grid.color": "#e6e6e3",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "lines.linewidth": 1.4,
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "guided-gym",
    "figure.dpi": 150,
    "savefig.dpi": 300,
}

# The colours of Okabe and Ito, which the colour-blind can tell apart; greys and dashes for the references.
_LOOKS: Final[dict[str, tuple[str, str, Any]]] = {
    "rrt": ("RRT", "#D55E00", "-"),
    "lazy_prm": ("LazyPRM", "#0072B2", "-"),
    "medial_axis": ("MedialAxis", "#009E73", "-"),
    "hybrid": ("Hybrid", "#CC79A7", "-"),
    "path_database": ("PathDatabase", "#E69F00", "-"),
    "prm": ("PRM", "#56B4E9", "-"),
    "wavefront": ("Wavefront", "#882255", "-"),
    "oracle": ("Oracle", "#000000", (0, (4, 1.5))),
    "goal_distance": ("GoalDistance", "#666666", (0, (1, 1))),
    "uninformed": ("Uninformed", "#999999", (0, (3, 1, 1, 1))),
}
# So that five lines and more are told apart in print without colours, too.
_DASHES: Final[tuple[Any, ...]] = (
    "-",
    (0, (5, 1)),
    (0, (2, 1)),
    (0, (5, 1, 1, 1)),
    (0, (5, 1, 1, 1, 1, 1)),
    (0, (8, 1.5, 3, 1.5)),
)
MANY_LINES: Final = 5
_SPARE: Final = ("#AA4499", "#44AA99", "#332288", "#999933", "#661100", "#DDAA33", "#BB5566", "#004488")


class Looks:
    """The label, colour and dash of each guidance in one figure; a name keeps its colour in every figure.

    Args:
        names: Guidances as `make_guidance` takes them, options and sums included.
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._looks: dict[str, tuple[str, str, Any]] = {}
        spare = iter(_SPARE * 20)
        taken: set[str] = set()
        for name in dict.fromkeys(names):
            base = name.partition(":")[0] if name.partition(":")[0] in _LOOKS else name
            base = "hybrid" if _joined(name) else base
            label, colour, dash = _LOOKS.get(base, (name, "", "-"))
            if not colour or colour in taken:
                colour = next(spare)
            taken.add(colour)
            self._looks[name] = (label if name == base else name, colour, dash)
        if len(self._looks) >= MANY_LINES:
            plain = [name for name, look in self._looks.items() if look[2] == "-"]
            for name, dash in zip(plain, itertools.cycle(_DASHES)):
                self._looks[name] = (*self._looks[name][:2], dash)

    def label(self, name: str) -> str:
        """The text of the label that the reader sees."""
        return self._looks[name][0]

    def colour(self, name: str) -> str:
        """Hexadecimal colour."""
        return self._looks[name][1]

    def dash(self, name: str) -> Any:
        """Line style, as matplotlib takes it."""
        return self._looks[name][2]


def _joined(name: str) -> bool:
    """Whether a label is an expression of several guidances."""
    try:
        return parse(name).name == JOINED
    except InvalidInputError:  # any text may be a label
        return False


def label_of(guidance: str) -> str:
    """The name of a guidance as the paper writes it."""
    return Looks([guidance]).label(guidance)


def styled(function: Callable[P, R]) -> Callable[P, R]:
    """Run a function that draws under the style of this module, leaving matplotlib's settings alone."""

    @functools.wraps(function)
    def inner(*args: P.args, **kwargs: P.kwargs) -> R:
        with matplotlib.rc_context(_RC):
            return function(*args, **kwargs)

    return inner


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of that many inches; its layout makes room for labels by itself."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


@styled
def save(figure: Figure, path: str | Path, formats: Sequence[str] = ("pdf", "png")) -> list[Path]:
    """Write a figure, once per format; the same figure gives the same bytes.

    Args:
        figure: The figure.
        path: Where to, without an extension (one of ours is dropped); its folder is made.
        formats: Of ``pdf``, ``png`` and ``svg``.

    Returns:
        The files, in the order of ``formats``.

    Raises:
        InvalidInputError: Another format.
        StorageError: The file cannot be written.
    """
    path = Path(path)
    if path.suffix[1:] in FORMATS:
        path = path.with_suffix("")
    for name in formats:
        if name not in FORMATS:
            raise InvalidInputError(f"formats: expected some of {', '.join(FORMATS)}, got {shown(name)}")
    undated = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {"Software": None}}
    files = [path.with_name(f"{path.name}.{name}") for name in formats]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        for file, name in zip(files, formats, strict=True):
            figure.savefig(file, format=name, metadata=undated[name])
    except OSError as error:
        raise StorageError(f"cannot write the figure {path}: {error}") from error
    return files
