"""Wavefront guidance: S = C on a coarse grid of poses, h how long a wave from the goal takes to a pose."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from guided_gym.checks import integer, number
from guided_gym.guidance.base import GuidingSpace, draw
from guided_gym.guidance.solvers.wave import Field, WaveModel, check_grid
from guided_gym.kernels import fields
from guided_gym.structures.nearest import GrowingIndex

if TYPE_CHECKING:
    from guided_gym.search.search import Expansion
    from guided_gym.search.tree import SearchTree

_ENOUGH_ROOM: Final = 0.2  # cells; a motion is worth a step less for each that it lacks
_MOST_CANDIDATES: Final = 2048
_CONTACT_REACH: Final = 0.5  # steps around a contact that count as known to be bad
_CROWD: Final = 6.0  # nodes within that reach that are no crowd yet, the node itself included
_AGAIN: Final = 3.0  # failures that each child of a node after its first counts as
_FAILURE, _CONTACT = 1.0, 0.3  # nats that log(1 + failures) and log(1 + contacts) take
_NEVER: Final = 1e6  # steps; stands for "the field sees no way"
_CLIP: Final = 4.0  # of remaining way and of detour, in optima
_LEAST: Final = 1e-9  # sides of the workspace that a way left may be as a unit
_PROGRESS: Final = 0.25  # steps by which the way left must fall to count as progress
_VAIN_REACH: Final = 2.0  # cells around an expansion in vain that become slower
_VAIN_GAIN: Final = 10.0  # times slower, for each
_TIRED: Final = 8  # runs in vain, after each so many of which it takes more of it for another
_SAME_PLACE: Final = 0.2  # reaches; contacts that are no further apart count as one place


class Wavefront(GuidingSpace):
    """Search-space guidance by a raster: h is when a wave from the goal arrives, slow where there is no room.

    The wave runs over a grid of poses, once per problem; nodes and candidates are looked up. P is what the
    target distribution would be, were the field the true distance. Where a search makes no progress, the
    poses that it has tried become slower and the wave runs again. Proposals are not checked for collision.

    Args:
        cells: Cells along each side of the raster, divisible by 8.
        headings: Headings of the grid, for a robot that can turn; divisible by 4.
        temperature: 0 selects the largest logit; 1 draws from the softmax of the logits.
        failure_penalty: Nats that each failed expansion of a node takes from its logit; each child after the
            first takes more, and a crowd of nodes around it some, so that nothing is tried in vain forever.
        candidates: Members of N_C(v) that a proposal looks at, more of them in a crowd; None for as many as
            the search's options say.
        patience: Expansions in a row without progress after which the wave runs again.

    Raises:
        InvalidInputError: An option that is out of range.
    """

    name: ClassVar[str] = "wavefront"

    def __init__(
        self,
        *,
        cells: int = 56,
        headings: int = 16,
        temperature: float = 0.0,
        failure_penalty: float = 0.3,
        candidates: int | None = None,
        patience: int = 12,
    ) -> None:
        check_grid(cells, headings)
        self._begin(WaveModel(cells, headings), temperature, failure_penalty, candidates, patience)

    def _begin(
        self,
        model: WaveModel,
        temperature: float,
        failure_penalty: float,
        candidates: int | None,
        patience: int,
    ) -> None:
        super().__init__(temperature=temperature, expansion_penalty=0.0)
        self.model = model
        self.failure_penalty = number("failure_penalty", failure_penalty, least=0)
        self.candidates = None if candidates is None else integer("candidates", candidates, least=1)
        self.patience = integer("patience", patience, least=1)

    def prepare(self) -> None:
        """Run the wave, once per problem."""
        self._grid, self._field = self.model.solve(self.search.problem)
        self._effort: Field | None = None
        self._reach = _CONTACT_REACH * self.planner.step
        self._weight = float(self._grid.frame[fields.WEIGHT])
        self._nodes = np.zeros((256, 3))  # way left, contacts around, nodes around
        self._seen = self._contacts = 0
        self._nearest = np.inf
        self._vain: list[NDArray[np.float64]] = []
        self._again = 0  # runs since the last progress
        self._places = GrowingIndex(self.space.metric)  # of contacts, those close together taken as one
        self._weights = np.zeros(64)  # how many each stands for
        looks = self._grid.looks(self._field.frame)
        self.search.collision_checks += looks
        self.search.looks += looks

    def project(self, tree: SearchTree, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """(m, 2) the field at configurations (length) and how crowded known contacts are around them."""
        q = np.ascontiguousarray(q)
        self._take_contacts(tree)
        return np.column_stack([self._way_left(q), self._contacts_at(q)])

    def _take_contacts(self, tree: SearchTree) -> None:
        """Take in the contacts that are new; nodes near them know."""
        for contact in tree.failed.contacts[self._contacts : tree.failure_count]:
            near = self._places.within(contact, _SAME_PLACE * self._reach)
            if near.size:
                self._weights[near[0]] += 1
            else:
                self._places.add(contact)
                if len(self._places) > len(self._weights):
                    self._weights = np.concatenate([self._weights, np.zeros(len(self._weights))])
                self._weights[len(self._places) - 1] = 1
            nodes = self._seen_near(tree, contact)
            self._nodes[nodes, 1] += self._crowding(tree.nodes.configurations[nodes], contact[None])
        self._contacts = tree.failure_count

    def _seen_near(self, tree: SearchTree, q: NDArray[np.float64]) -> NDArray[np.int64]:
        """The nodes, ascending, that have been taken in and to whose crowd q counts."""
        near = tree.index.within(q, fields.FAR * self._reach)
        return np.sort(near[near < self._seen])

    def _contacts_at(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """(m,) how crowded known contacts are around configurations (m, d)."""
        if len(self._places) == 0 or len(q) == 0:
            return np.zeros(len(q))
        spread = float(np.max(self.space.distance(q, q[0])))
        near = np.sort(self._places.within(q[0], spread + fields.FAR * self._reach))
        return self._crowding(q, self._places.points[near], self._weights[near])

    def _crowding(
        self, q: NDArray[np.float64], points: NDArray[np.float64], weights: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        weights = np.ones(len(points)) if weights is None else weights
        q, points = np.ascontiguousarray(q), np.array(points)
        return fields.crowding(q, points, weights, self._reach, self._weight)

    def heuristic(self, states: NDArray[np.float64]) -> NDArray[np.float64]:
        """The field, and a step for each contact at hand."""
        return np.asarray(states[:, 0] + self.planner.step * states[:, 1])

    def logits(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) log of P up to a constant: the target's, were the field the truth, less `penalties`."""
        self._update(tree)
        contacts = self._nodes[: len(tree), 1]
        left, detour = self._left_and_detour(tree)
        failed = np.log1p(tree.nodes.failures[: len(tree)])
        target = self.search.options.target
        scores = -(left / target.tau + detour / target.delta)
        scores -= _FAILURE * failed + _CONTACT * np.log1p(contacts)
        return np.asarray(scores - self.penalties(tree))

    def penalties(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) what is taken from the logit of each node, so that nothing is tried in vain forever."""
        self._update(tree)
        crowd = np.log1p(np.maximum(self._nodes[: len(tree), 2] - _CROWD, 0.0))
        again = _AGAIN * np.maximum(tree.nodes.children[: len(tree)] - 1, 0)
        return np.asarray(self.failure_penalty * (tree.nodes.failures[: len(tree)] + again + crowd))

    def values(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) h of each node: how far its logit lies below the largest, in nats."""
        logits = self.logits(tree)
        return np.asarray(logits.max() - logits)

    def distribution(self, tree: SearchTree) -> NDArray[np.float64]:
        """(n,) the distribution P over the nodes from which `select` draws."""
        h = self.values(tree)
        if self.temperature == 0:
            p = np.zeros(h.size)
            p[int(np.argmin(h))] = 1.0
            return p
        p = np.exp(-h / self.temperature)
        return np.asarray(p / p.sum())

    def select(self, tree: SearchTree) -> int:
        """The node of the largest logit, or a draw from P if there is a temperature."""
        if self.temperature == 0:
            return int(np.argmax(self.logits(tree)))
        return draw(self.distribution(tree), self.rng)

    def propose(self, tree: SearchTree, node: int) -> NDArray[np.float64]:
        """(d,) x_new: the candidate with the shortest way on, shy of what has no room.

        Where the task ends in a region around the goal, a node within a step of it tries the goal itself
        first: where that has no room, the field has its least value before it.
        """
        self._update(tree)
        q, step = tree.nodes.configurations[node], self.planner.step
        crowd = max(self._nodes[node, 2] - _CROWD, 0.0)
        untried = tree.nodes.children[node] + tree.nodes.failures[node] == 0
        if untried and not self.search.task.by_edge and float(self.space.distance(q, self.goal)) <= step:
            return self.goal.copy()
        usual = self.planner.candidate_count if self.candidates is None else self.candidates
        count = min(int(usual * (1 + crowd)), max(_MOST_CANDIDATES, usual))
        candidates = self.planner.candidates(q, count)
        lengths = np.asarray(self.space.distance(candidates, q))
        states = self.project(tree, candidates)
        # No free motion brings the goal nearer than by its length: what seems to lies behind a wall.
        states[:, 0] = np.maximum(states[:, 0], self._nodes[node, 0] - lengths)
        scores = self.heuristic(states) + 0.5 * lengths
        penalty = step / (1 + tree.nodes.children[node])  # what was safe has not helped: dare more
        self.search.looks += len(candidates)  # motions, followed through the raster
        best = self._grid.best_motion(q, candidates, scores, _ENOUGH_ROOM, penalty)
        return np.asarray(candidates[best])

    def feedback(self, expansion: Expansion) -> None:
        """Count what was in vain; after so much of it in a row, have the wave avoid it."""
        tree = self.search.tree
        self._update(tree)
        if not expansion.failed and self._progress(float(self._nodes[expansion.child, 0])):
            return
        self._vain.append(expansion.target if expansion.contact is None else expansion.contact)
        if len(self._vain) >= self.patience * (1 + self._again // _TIRED) and self.model.plans:
            self._run_again(tree)

    def _progress(self, left: float) -> bool:
        """Whether that way left is shorter than any before."""
        if left > self._nearest - _PROGRESS * self.planner.step:
            return False
        self._nearest, self._again = left, 0
        self._vain.clear()
        return True

    def _run_again(self, tree: SearchTree) -> None:
        """Slow down the poses around what was in vain, run the wave, and look the nodes up again."""
        if self._effort is None:
            self._effort = np.ones(self._grid.room.shape, np.float32)
        reach = _VAIN_REACH * float(self._grid.frame[fields.CELL])
        fields.add_effort(self._effort, np.array(self._vain), self._grid.frame, reach, _VAIN_GAIN)
        self._field = self.model.evaluate(self._grid, self.goal, self._effort)
        self._vain.clear()
        self._again += 1
        self._nodes[: self._seen, 0] = self._way_left(tree.nodes.configurations[: self._seen])
        self._tie(tree, 0, self._seen)
        self._nearest = float(self._nodes[: self._seen, 0].min())

    def _way_left(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.minimum(self._field.cost_to_go(q), _NEVER * self.planner.step))

    def _left_and_detour(self, tree: SearchTree) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) way left and (n,) suboptimality of each node as it seems, in optima, after `_update`."""
        n, optimum = len(tree), self._optimum()
        remaining = self._nodes[:n, 0]
        left = np.minimum(remaining / optimum, _CLIP)
        return left, np.clip((tree.nodes.costs[:n] + remaining) / optimum - 1.0, 0.0, _CLIP)

    def _optimum(self) -> float:
        """The way left at the root (length), as far as it is of any use as a unit."""
        return float(min(max(self._nodes[0, 0], _LEAST * self._grid.side), _CLIP * self._grid.side))

    def _update(self, tree: SearchTree) -> None:
        """Take in the nodes and contacts that are new."""
        n = len(tree)
        self._take_contacts(tree)
        if n > len(self._nodes):
            self._nodes = np.concatenate([self._nodes, np.zeros((n, 3))])
        first = self._seen
        if n > first:
            self._nodes[first:n, :2] = self.project(tree, tree.nodes.configurations[first:n])
            for node in range(first, n):
                self._seen = node + 1
                q = tree.nodes.configurations[node]
                near = self._seen_near(tree, q)
                there = np.array(tree.nodes.configurations[near])
                self._nodes[near, 2] += self._crowding(there, q[None])
                self._nodes[node, 2] = self._crowding(q[None], there)[0]
            self._tie(tree, first, n)

    def _tie(self, tree: SearchTree, first: int, last: int) -> None:
        """The edge to the parent is free, so the way left is no longer than it and the parent's."""
        parents = tree.nodes.parents[:last]
        start = max(first, 1)
        edges = self.space.distance(
            tree.nodes.configurations[start:last], tree.nodes.configurations[parents[start:last]]
        )
        fields.tie(self._nodes, parents, np.atleast_1d(edges), start)
