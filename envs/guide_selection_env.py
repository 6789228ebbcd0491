"""Multi-guidance search as an environment: choose which guiding space guides (paper, Section 7.1)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from guided_gym.doors import doors
from guided_gym.envs.guided_search_env import OPTIONS, GuidedSearchEnv, as_index
from guided_gym.errors import UnknownOptionError
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.hybrid import Hybrid
from guided_gym.guidance.learned.turns import Turns, bounds
from guided_gym.guidance.registry import make_guides
from guided_gym.guidance.rules import Taking

if TYPE_CHECKING:
    from guided_gym.catalogue.distributions import ProblemDistribution
    from guided_gym.catalogue.splits import Split
    from guided_gym.envs.observations import Observation
    from guided_gym.problems import Problem
    from guided_gym.search.search import Expansion, Search

DEFAULT_GUIDES: Final = ("lazy_prm", "medial_axis")
_OWN: Final = ("action", "expansion", "observe", "raster", "max_nodes", "target_in_info")
_NOBODY: Final = -1  # a node that there is not: what an invalid choice of a guide asks for
SELECTION_OPTIONS: Final = ("guides", *(name for name in OPTIONS if name not in _OWN))


@doors
class GuideSelectionEnv(gymnasium.Env[NDArray[np.float32], int]):
    """A hybrid search: choose the guiding space that guides the next sample.

    Description:
        One episode is one search (paper, Algorithm 1). Each step is one sample: the chosen guiding space
        selects the node and proposes the configuration; all of them learn from what comes of it. The same
        search, the same problems and the same reward as `GuidedSearchEnv`, with a choice so small that
        plain PPO or DQN can make it.

    Action space:
        ``Discrete(k)``, the guiding space that guides next.

    Observation space:
        ``Box`` of 5 + 13 k numbers: `guided_gym.guidance.learned.turns.SearchColumn`, then
        `guided_gym.guidance.learned.turns.GuideColumn` of each guiding space. None of them comes from the
        oracle.

    Rewards, invalid actions, episode end, info and randomness:
        As in `GuidedSearchEnv`. An index without a guiding space counts as a sample and changes nothing.

        All guiding spaces may be chosen at any time (`action_masks`). ``reset(seed=k)`` gives the tree that
        ``guided_search`` gives with a `Hybrid` of the same guides, if its rule makes the same choices.

    Args:
        distribution: Name in the catalogue, a distribution, or a problem.
        guides: Guiding spaces to choose from, or their names; instances are copied.
        max_samples: Steps until truncation.
        split: ``"train"``, ``"validation"`` or ``"test"``; None for the whole distribution.
        **options: As in `GuidedSearchEnv`: reward, on_invalid, step, candidates, goal_tolerance, goal_edge,
            rewire, target, render_mode.

    Raises:
        UnknownNameError: An unknown name or option; the nearest one is suggested. For an option, it is a
            TypeError, too.
        InvalidInputError: An option's value cannot be used.
    """

    metadata: dict[str, Any] = GuidedSearchEnv.metadata

    def __init__(
        self,
        distribution: str | ProblemDistribution | Problem = "TrapCup",
        *,
        guides: Sequence[GuidingSpace | str] = DEFAULT_GUIDES,
        max_samples: int = 500,
        split: str | Split | None = None,
        **options: Any,
    ) -> None:
        for name in options:
            if name not in SELECTION_OPTIONS:
                raise UnknownOptionError("GuideSelectionEnv()", name, SELECTION_OPTIONS)
        hybrid = Hybrid(make_guides(guides), rule=_AsTold())
        self.searching = GuidedSearchEnv(
            distribution,
            split=split,
            max_samples=max_samples,
            expansion=hybrid,
            observe=Unobserved(),
            **options,
        )
        self.guides = tuple(guide.name for guide in hybrid.guides)
        low, high = bounds(len(self.guides))
        self.observation_space = spaces.Box(low, high, dtype=np.float32)
        self.action_space = spaces.Discrete(len(self.guides))  # type: ignore[assignment]
        self.render_mode = self.searching.render_mode

    @property
    def search(self) -> Search:
        """The search in progress; a new object after each reset."""
        return self.searching.search

    @property
    def problem(self) -> Problem:
        """The problem of this episode."""
        return self.searching.problem

    @property
    def hybrid(self) -> Hybrid:
        """The guiding spaces, prepared for this search."""
        assert isinstance(self.searching.expander, Hybrid)
        return self.searching.expander

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin a search; see `GuidedSearchEnv.reset`."""
        _, info = self.searching.reset(seed=seed, options=options)
        self._np_random, self._np_random_seed = self.searching.np_random, self.searching.np_random_seed
        self.searching.attach(self.hybrid)
        self._turns = Turns(self.hybrid.guides, self.search)
        self._observation = self._turns.observe()
        return self._observation.copy(), info

    def action_masks(self) -> NDArray[np.bool_]:
        """(k,) bool, all True: any guiding space may guide (the name MaskablePPO looks for)."""
        return np.ones(len(self.guides), np.bool_)

    def step(self, action: int) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """One sample, guided by the guiding space of that index.

        Raises:
            InvalidInputError: An action of the wrong type; with ``on_invalid="raise"``, no such
                guiding space.
            GuidedGymError: There was no reset yet.
        """
        searching = self.searching
        search, samples = searching.search, searching.search.samples
        guide = as_index(action, "a guiding space")
        if not 0 <= guide < len(self.guides):
            searching.refuse(f"0 to {len(self.guides) - 1}", guide)
            node = _NOBODY
        else:
            hybrid = self.hybrid
            hybrid.current = guide
            node = 0 if searching.finished else hybrid.select(search.tree)
        _, reward, terminated, truncated, info = searching.step(node)
        if search.samples > samples and search.last is not None:
            self._turns.note(guide, search.last)
            self._observation = self._turns.observe()
        return self._observation.copy(), float(reward), terminated, truncated, info

    def _repr_html_(self) -> str:
        """The search as it stands, for notebooks."""
        return self.searching._repr_html_()

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """A picture of the search; see `GuidedSearchEnv.render`."""
        return self.searching.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        self.searching.close()


class _AsTold(Taking):
    """The rule of a hybrid whose turns somebody else decides: the last guide goes on."""

    def learn(self, guide: int, expansion: Expansion) -> None:
        """Stay with the guide that was told to guide."""
        self.turn = guide


class Unobserved:
    """An observer that observes nothing, for environments whose observations come from elsewhere."""

    def build(self, max_nodes: int, max_samples: int) -> spaces.Dict:
        """An empty space."""
        return spaces.Dict({})

    def reset(self, search: Search) -> None:
        """Nothing to begin."""

    def update(self, search: Search, expansion: Expansion) -> None:
        """Nothing to note."""

    def extract(self, search: Search) -> Observation:
        """Nothing."""
        return {}
