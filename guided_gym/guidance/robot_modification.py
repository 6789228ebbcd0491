"""Robot modification, S = (r', E): guidance from the workspace (paper, Section 4.1)."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import number
from guided_gym.guidance.solvers.roadmap import Anchors, Roadmap, RoadmapGuidance
from guided_gym.guidance.solvers.skeleton import medial_axis
from guided_gym.kernels.anchors import nearest_segments
from guided_gym.structures.shortest_paths import graph_from_edges

if TYPE_CHECKING:
    from guided_gym.search.search import Expansion


class MedialAxis(RoadmapGuidance):
    """The medial axis of the free workspace, travelled by a point: r' is the robot's reference point.

    A configuration projects (forward kinematics) to its workspace position and from there to the nearest
    skeleton edge e_v; h is the distance along the skeleton from there to the projection of the goal. A
    position inside an obstacle is no state of S: its h is infinite. A failed expansion from v raises the
    weight of e_v.

    Args:
        growth: What each failed expansion from v adds to the weight of e_v, as a share of its length.
        spacing: Length of a skeleton edge, in units of the local planner's step.
        temperature: See `GuidingSpace`.
        expansion_penalty: See `GuidingSpace`.
    """

    name: ClassVar[str] = "medial_axis"

    def __init__(
        self,
        *,
        growth: float = 0.1,
        spacing: float = 1.0,
        temperature: float = 0.0,
        expansion_penalty: float = 1.0,
    ) -> None:
        super().__init__(temperature=temperature, expansion_penalty=expansion_penalty)
        self.growth = number("growth", growth, above=0)
        self.spacing = number("spacing", spacing, above=0)

    def build(self) -> Roadmap:
        """The skeleton, with the goal's projection as a vertex of its own."""
        environment = self.space.environment
        points, edges = medial_axis(environment, self.spacing * self.planner.step)
        goal = self.goal[None, :2]
        split, fraction, _ = nearest_segments(goal, points[edges[:, 0]], points[edges[:, 1]])
        a, b = edges[split[0]]
        n = len(points)
        points = np.vstack([points, points[a] + fraction[0] * (points[b] - points[a])])
        edges = np.vstack([np.delete(edges, split[0], axis=0), [[a, n], [n, b]]]).astype(np.int32)
        self._tails, self._heads = (np.ascontiguousarray(points[edges[:, i]]) for i in (0, 1))
        lengths = np.hypot(*(self._heads - self._tails).T)
        return Roadmap(points, graph_from_edges(n + 1, edges, lengths), n)

    def anchor(self, q: NDArray[np.float64]) -> Anchors:
        """Join each configuration to both ends of its nearest skeleton edge."""
        e, fraction, _ = nearest_segments(q, self._tails, self._heads)
        along = fraction * self.roadmap.lengths[e]
        lengths = np.stack([along, self.roadmap.lengths[e] - along], axis=1)
        lengths[self.space.environment.clearance(q[:, :2]) <= 0] = np.inf
        return Anchors(self.roadmap.edges[e], lengths, np.repeat(e[:, None], 2, axis=1))

    def feedback(self, expansion: Expansion) -> None:
        """Raise the weight of e_v when v fails to expand."""
        if expansion.failed:
            edge = self.anchors(self.search.tree).edges[expansion.node, :1]
            self.roadmap.lengthen(edge, self.growth)
