"""PPO with the node scorer as its policy: MaskablePPO on what `ScoredGuidance` sees of a growing tree.

What is learned is the scorer of an agent, on a field, or a belief in motions, that stays as it is; the agent
that comes of it runs as any other, by `make_guidance("learned:FOLDER")`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.policies import MaskableMultiInputActorCriticPolicy
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv
from torch import Tensor, nn

from guided_gym.checks import integer
from guided_gym.compute.workers import Workers
from guided_gym.envs.guide_selection_env import Unobserved
from guided_gym.envs.guided_search_env import GuidedSearchEnv
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.agent import LearnedAgent, LearnedGuidance
from guided_gym.guidance.learned.field import FieldArchitecture, FieldModel
from guided_gym.guidance.learned.field import plain_tensors as plain_field
from guided_gym.guidance.learned.folders import agent_folder
from guided_gym.guidance.learned.motion_agent import MOTION_KIND, MotionAgent
from guided_gym.guidance.learned.motion_guidance import MotionGuidance
from guided_gym.guidance.learned.scored import ScoredGuidance
from guided_gym.guidance.learned.scorer import ScorerArchitecture, ScorerColumn, ScorerModel
from guided_gym.guidance.learned.scorer import plain_tensors as plain_scorer
from guided_gym.train import networks
from guided_gym.train.policies import ABSENT, PerNode
from guided_gym.train.reinforcement import ReinforcementConfig, Tensors, Trainee, train
from guided_gym.train.specs import package_version
from guided_gym.train.terminal import Progress

_COLUMNS = len(ScorerColumn) + 1  # and what is taken from the score
# Of the card of the agent that a run began with.
_KEPT: Final[tuple[str, ...]] = ("kind", "robot", "field", "belief", "estimate", "scorer")
SELECTION_REWARD: Final = {"regret": 1.0, "sample": 0.1}
"""What a choice is worth where selection alone is learned."""
_MOST = 1e4  # no column of the scorer is negative, and none that large


@dataclass(frozen=True)
class PPOConfig(ReinforcementConfig):
    """Options of a run that trains a node scorer.

    Attributes:
        start: Where to begin: ``"scratch"`` with random weights on an untaught field, ``"plain"`` with the
            scorer that imitation begins with on that field, or an agent (a folder, or a shipped one's name)
            with all but its scorer: one of a field, or one of motions.
        cells: Cells along each side of an untaught field's raster.
        headings: Headings of its grid.
        scorer_hidden: Units of each layer of the scorer; an agent that is named brings its own.
        selection: Whether all searches expand uniformly, as in the protocol ``selection``. The reward is then
            `SELECTION_REWARD`, whose best policy is known (docs/rewards.md), and least excess SE is best.

    Raises:
        InvalidInputError: An option that is out of range.
    """

    environments: tuple[str, ...] = ("RandomSimplePassage",)
    max_samples: int = 200
    start: str = "scratch"
    cells: int = 56
    headings: int = 16
    scorer_hidden: int = 32
    selection: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("cells", "headings", "scorer_hidden"):
            integer(name, getattr(self, name), least=1)


def train_ppo(
    config: PPOConfig,
    out: Path,
    progress: Progress | None = None,
    say: Callable[[str], None] = print,
    workers: Workers = 1,
) -> dict[str, Any]:
    """Run or continue a run; returns the card of the best agent, written to ``out/agent``.

    ``workers`` validate.

    Raises:
        InvalidInputError: The device or TensorBoard is not there, or the buffer would take too much memory.
        UnknownNameError: No such environment or agent.
        StorageError: The folder holds another run, or a damaged file; an agent's files cannot be used.
    """
    return train(_ScorerTrainee(config), out, progress, say, workers)


class ScorerObservation(gymnasium.Wrapper[Any, Any, Any, Any]):
    """What the node scorer sees, as a Dict observation of a search that a `ScoredGuidance` expands.

    ``columns`` (max_nodes * 9,) float32: of node i, the `ScorerColumn` and what failures take from its score,
    zeros beyond the tree. ``action_mask`` (max_nodes,) int8: 1 for the nodes that there are.

    Args:
        env: A search environment.
        guidance: Whose columns they are, and who learns from what the search does.
    """

    def __init__(self, env: GuidedSearchEnv, guidance: ScoredGuidance) -> None:
        super().__init__(env)
        self._guidance = guidance
        self._max_nodes = env.max_nodes
        n = env.max_nodes
        self.observation_space = spaces.Dict(
            {
                "columns": spaces.Box(0, _MOST, (n * _COLUMNS,), np.float32),
                "action_mask": spaces.Box(0, 1, (n,), np.int8),
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Begin a search."""
        _, info = self.env.reset(seed=seed, options=options)
        self._search.attach(self._guidance)
        return self._observation(), info

    def step(self, action: Any) -> tuple[dict[str, NDArray[Any]], Any, bool, bool, dict[str, Any]]:
        """One sample."""
        _, reward, terminated, truncated, info = self.env.step(action)
        return self._observation(), reward, terminated, truncated, info

    def action_masks(self) -> NDArray[np.bool_]:
        """(max_nodes,) bool, True for the nodes that may be expanded."""
        return self._search.action_masks()

    @property
    def _search(self) -> GuidedSearchEnv:
        inner = self.env
        assert isinstance(inner, GuidedSearchEnv)
        return inner

    def _observation(self) -> dict[str, NDArray[Any]]:
        tree = self._search.search.tree
        columns = np.zeros((self._max_nodes, _COLUMNS), np.float32)
        columns[: len(tree), :-1] = self._guidance.columns(tree)
        columns[: len(tree), -1] = self._guidance.penalties(tree)
        return {"columns": columns.ravel(), "action_mask": self.action_masks().view(np.int8)}


class _ScorerAndCritic(nn.Module):
    """Logits of the nodes by the scorer; for the critic, a summary of the tree by a network of its own."""

    def __init__(self, nodes: int, architecture: ScorerArchitecture) -> None:
        super().__init__()
        h = architecture.hidden
        self.nodes = nodes
        self.scorer = networks.NodeScorer(architecture)
        self.node = nn.Sequential(nn.Linear(_COLUMNS, h), nn.ReLU(), nn.Linear(h, h), nn.ReLU())
        self.mixed = nn.Sequential(nn.Linear(2 * h + 1, h), nn.ReLU())
        self.latent_dim_pi, self.latent_dim_vf = nodes, h

    def forward(self, observation: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        return self.forward_actor(observation), self.forward_critic(observation)

    def forward_actor(self, observation: dict[str, Tensor]) -> Tensor:
        columns, mask = self._split(observation)
        logits = self.scorer(columns[..., :-1], mask) - columns[..., -1]
        return torch.where(mask, logits, torch.full_like(logits, ABSENT))

    def forward_critic(self, observation: dict[str, Tensor]) -> Tensor:
        columns, mask = self._split(observation)
        hidden = self.node(columns) * mask[..., None]  # units are >= 0, so that zero is the least
        count = mask.sum(1, keepdim=True)
        summary = torch.cat([hidden.sum(1) / count, hidden.amax(1), torch.log(count) / 5], 1)
        out: Tensor = self.mixed(summary)
        return out

    def _split(self, observation: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        columns = observation["columns"].reshape(-1, self.nodes, _COLUMNS)
        return columns, observation["action_mask"] > 0.5


class NodeScorerPolicy(PerNode, MaskableMultiInputActorCriticPolicy):
    """A policy of MaskablePPO over `ScorerObservation`: a logit for each node, a value for the tree.

    Args:
        *arguments: As of its base.
        architecture: Sizes of the scorer.
        **options: As of its base.
    """

    def __init__(self, *arguments: Any, architecture: ScorerArchitecture, **options: Any) -> None:
        self._architecture = architecture
        super().__init__(*arguments, **options)

    def network(self) -> nn.Module:
        """The scorer, and what the critic looks at."""
        nodes = int(self.action_space.n)  # type: ignore[attr-defined]
        return _ScorerAndCritic(nodes, self._architecture)

    @property
    def scorer(self) -> networks.NodeScorer:
        """The node scorer."""
        scorer = self.mlp_extractor.scorer
        assert isinstance(scorer, networks.NodeScorer)
        return scorer


class _ScorerTrainee(Trainee):
    kind = "ppo"
    config: PPOConfig

    def __init__(self, config: PPOConfig) -> None:
        self.config = config
        self.selection = config.selection
        self.agent: LearnedAgent | MotionAgent
        if config.start in ("scratch", "plain"):
            field = FieldArchitecture(cells=config.cells, headings=config.headings)
            scorer = ScorerArchitecture(hidden=config.scorer_hidden)
            card = {"field": asdict(field), "scorer": asdict(scorer)}
            parts = {"field": plain_field(field), "scorer": plain_scorer(scorer)}
            models = FieldModel(field, parts["field"]), ScorerModel(scorer, parts["scorer"])
            self.agent = LearnedAgent(card, *models)
            self.tensors = {f"{part}.{name}": t for part, some in parts.items() for name, t in some.items()}
        else:
            folder = agent_folder(config.start)
            moves = weights.card_kind(folder) == MOTION_KIND
            self.agent = (MotionAgent if moves else LearnedAgent).load(folder)  # checks what it reads
            kind = self.agent.card["kind"]
            self.tensors = weights.load_agent(folder, kind, ("format", "kind"))[1]
        self.scorer = self.agent.scorer.architecture

    def guidance(self, tensors: Tensors) -> ScoredGuidance:
        """The guidance of the agent with another scorer, which selects."""
        agent = copy.copy(self.agent)
        agent.scorer = ScorerModel(self.scorer, tensors)
        if isinstance(agent, MotionAgent):
            return MotionGuidance(agent, scored=True)
        return LearnedGuidance(agent, scored=True)

    def _own(self) -> Tensors:
        """The tensors of the agent's scorer."""
        return weights.part_of(self.tensors, "scorer")

    def environment(self, name: str) -> gymnasium.Env[Any, Any]:
        guidance = self.guidance(self._own())
        samples = self.config.max_samples
        env = GuidedSearchEnv(
            name,
            split="train",
            max_nodes=max(samples + 2, 3),
            max_samples=samples,
            expansion="uniform" if self.selection else guidance,
            reward=SELECTION_REWARD if self.selection else "efficiency",
            observe=Unobserved(),
        )
        own = env.expander  # a copy of what was given
        return ScorerObservation(env, own if isinstance(own, ScoredGuidance) else guidance)

    def model(self, environments: DummyVecEnv, options: dict[str, Any]) -> PPO:
        torch.manual_seed(self.config.seed)
        sizes = {"architecture": self.scorer}
        model = MaskablePPO(NodeScorerPolicy, environments, policy_kwargs=sizes, **options)
        policy = model.policy
        assert isinstance(policy, NodeScorerPolicy)
        self._begin(policy.scorer)
        return model  # type: ignore[return-value]  # no subclass, but of the same shape

    def _begin(self, scorer: networks.NodeScorer) -> None:
        last = scorer.score[1]
        assert isinstance(last, nn.Linear)
        with torch.no_grad():
            if self.config.start == "scratch":
                scorer.linear.weight.zero_()
            elif self.config.start != "plain":
                networks.load_scorer(scorer, self._own())
            if not last.weight.any():  # asleep, it would take long to wake
                nn.init.normal_(last.weight, std=0.01)

    def export(self, model: PPO) -> Tensors:
        assert isinstance(model.policy, NodeScorerPolicy)
        return {name: t.copy() for name, t in networks.scorer_tensors(model.policy.scorer).items()}

    def write(self, folder: Path, card: dict[str, Any], tensors: Tensors) -> None:
        named = {name: t for name, t in self.tensors.items() if not name.startswith("scorer.")}
        named.update({f"scorer.{name}": t for name, t in tensors.items()})
        kept = {name: self.agent.card[name] for name in _KEPT if name in self.agent.card}
        if isinstance(self.agent, MotionAgent):
            kept["selection"] = {"scored": True}  # by default, such agents select without their scorer
        weights.save_agent(folder, {**card, "package_version": package_version(), **kept}, named)
