"""A roadmap whose best way is shortened, and then followed: in many dimensions, ways on a roadmap zigzag."""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from guided_gym.guidance.solvers.base import Floats, Query, Valid
from guided_gym.guidance.solvers.graph import Ints
from guided_gym.guidance.solvers.roadmap import LIKELY, Roadmap
from guided_gym.kernels.anchors import segments_touched
from guided_gym.kernels.metric import steer

_ROUNDS: Final = 12  # of chords
_CHORDS: Final = 24  # that are asked about together
_TINY: Final = 1e-300
_GAIN: Final = 1e-3  # share of a part of a way that its chord has to save
_SPACING: Final = 0.25  # steps between the states of a way that nodes are joined to
_AHEAD: Final = 4  # states of the way beyond a step that a proposal steers to
_WAYS: Final = 8  # that are laid one after the other, each better than the last
_FEW: Final = 4  # candidates whose joints to the way are asked about together


class Way(NamedTuple):
    """States along a way to the goal, so close together that nodes near it can be joined to it.

    Attributes:
        points: (m, d') states; the last one is the goal.
        left: (m,) cost from each to the goal (length).
    """

    points: Floats
    left: Floats


class _Chords(NamedTuple):
    """Chords of a way: between which parts, at which share of each, (k, 2); their ends; what they replace."""

    parts: Ints  # [k, 2]
    shares: Floats  # [k, 2]
    ends: Floats  # [k, 2, d']
    spent: Floats  # [k] cost of the way between the ends


class Shortened(Roadmap):
    """A roadmap of which only the best way counts once it is known, with its detours cut off by chords.

    Whether a chord is free is asked of whoever says so of edges: E', or the doubts that a query brings. A
    node, or a candidate, has a way along the straight motion to the state of the way from which least is left
    in all. A failure near the way ends it: another one is found on the roadmap, and shortened. Where E' has
    no obstacles and nobody doubts, nobody can be asked about chords, and it is a roadmap as any other.

    Args:
        vertices: As of `Roadmap`.
        neighbours: As of `Roadmap`.
        anchors: As of `Roadmap`.
    """

    def begin(self, query: Query, rng: np.random.Generator, step: float) -> None:
        """Draw the roadmap; there is no way yet."""
        self._way: Way | None = None
        self._along, self._joints = np.zeros(0), np.zeros((0, query.space.dimension))
        super().begin(query, rng, step)
        self._asks = query.doubts is not None or not self._lazy

    def follow(self, states: Floats) -> Floats:
        """(n,) cost-to-go of the nodes, along the way or, where that is less, on the roadmap."""
        for _ in range(_WAYS):
            along = self._followed_along(states)
            h = super().follow(states) if self._way is None else self._settled(states, float(along.min()))
            row = int(np.argmin(h))
            if not h[row] < along.min() or not self._asks:
                break
            self._lay(states, row)
        return np.minimum(h, self._followed_along(states))

    def __call__(self, states: Floats) -> Floats:
        """(n, d') states to (n,) cost-to-go, along the way or, where that is less, on the roadmap."""
        h = super().__call__(states)
        return h if self._way is None else np.minimum(h, self._known_along(states, self._way)[0])

    def _settled(self, states: Floats, least: float) -> Floats:
        """(n,) the roadmap's h; known as far as it is less than what is known along the way."""
        h = self._on_graph(states)
        if self.query.doubts is not None:
            while h.min() < least and self._look_from_node(states, int(np.argmin(h))):
                h = self._on_graph(states)
            self._count_asked()
        return h

    def _lay(self, states: Floats, row: int) -> None:
        """Shorten the way of a node on the roadmap, and follow it."""
        self._way = self._dense(*self._cut(*self._knots(states, row)))
        self._along = np.zeros(0)

    def _knots(self, states: Floats, row: int) -> tuple[Floats, Floats]:
        """(k, d') corners of the roadmap's way from a node, and (k - 1,) the cost of each part."""
        nodes, graph = self._nodes, self.graph
        assert nodes is not None
        vertices, lengths = nodes.anchors.vertices[row], nodes.anchors.lengths[row]
        best = int(np.argmin(lengths + graph.distance[vertices]))
        vertex, tree = int(vertices[best]), graph.tree
        corners, costs = [states[row], graph.points[vertex]], [float(lengths[best])]
        while tree.parent[vertex] >= 0:
            edge = int(tree.parent_edge[vertex])
            costs.append(float(graph.lengths[edge] * graph.multipliers[edge]))
            vertex = int(tree.parent[vertex])
            corners.append(graph.points[vertex])
        return np.array(corners), np.array(costs)

    def _cut(self, corners: Floats, costs: Floats) -> tuple[Floats, Floats]:
        """Cut off detours by chords between random places of the way, the best of each round first."""
        for _ in range(_ROUNDS):
            chords = self._chords(corners, costs)
            if not len(chords.spent):
                continue
            tails, heads = chords.ends[:, 0], chords.ends[:, 1]
            found = self.query.space.distance(tails, heads) * self._factors(tails, heads)
            gains = chords.spent - found
            taken: list[int] = []
            for i in np.argsort(-gains).tolist():
                if gains[i] <= _GAIN * chords.spent[i]:
                    break
                first, last = chords.parts[i]
                if all(last < chords.parts[k, 0] or first > chords.parts[k, 1] for k in taken):
                    taken.append(i)
            for i in sorted(taken, key=lambda i: -int(chords.parts[i, 0])):  # from the goal on: places stay
                (a, b), (s, t) = chords.parts[i], chords.shares[i]
                corners = np.vstack([corners[: a + 1], chords.ends[i], corners[b + 1 :]])
                between = [s * costs[a], found[i], (1.0 - t) * costs[b]]
                costs = np.concatenate([costs[:a], between, costs[b + 1 :]])
        return corners, costs

    def _chords(self, corners: Floats, costs: Floats) -> _Chords:
        """Some chords of a way that would save something, were they free; the longest among them."""
        space = self.query.space
        lengths = space.distance(corners[:-1], corners[1:])
        ends = np.concatenate([[0.0], np.cumsum(lengths)])
        places = np.sort(self.rng.uniform(0.0, ends[-1], (_CHORDS, 2)), axis=1)
        places[0] = 0.0, ends[-1]
        parts = np.clip(np.searchsorted(ends, places, side="right") - 1, 0, len(lengths) - 1)
        shares = np.clip((places - ends[parts]) / np.maximum(lengths[parts], _TINY), 0.0, 1.0)
        spent = np.concatenate([[0.0], np.cumsum(costs)])[parts] + shares * costs[parts]
        saved = spent[:, 1] - spent[:, 0]
        at = space.interpolate(corners[parts], corners[parts + 1], shares)
        worth = space.distance(at[:, 0], at[:, 1]) < (1.0 - _GAIN) * saved
        some = worth & (parts[:, 0] < parts[:, 1])
        return _Chords(parts[some], shares[some], at[some], saved[some])

    def _dense(self, corners: Floats, costs: Floats) -> Way:
        """The way as states close together."""
        space = self.query.space
        lengths = space.distance(corners[:-1], corners[1:])
        left = np.concatenate([np.cumsum(costs[::-1])[::-1], [0.0]])
        points, remaining = [], []
        for k, length in enumerate(lengths):
            if not length > 0.0:
                continue
            share = np.arange(count := math.ceil(length / (_SPACING * self.step))) / count
            points.append(space.interpolate(corners[k], corners[k + 1], share))
            remaining.append(left[k] - share * costs[k])
        points.append(corners[-1:])
        remaining.append(left[-1:])
        return Way(np.ascontiguousarray(np.concatenate(points)), np.concatenate(remaining))

    def _factors(self, tails: Floats, heads: Floats) -> Floats:
        """(n,) factors on the lengths of motions; infinite where one is not free, or failures forbid it."""
        tails, heads = np.ascontiguousarray(tails), np.ascontiguousarray(heads)
        if self.query.doubts is not None:
            factors = self.query.doubts.factors(tails, heads)
            if self._doubted.checking:
                believed = np.flatnonzero(np.isfinite(factors))
                refuted = self.query.doubts.refuted(tails[believed], heads[believed])  # type: ignore[attr-defined]
                factors[believed[refuted]] = np.inf
            self._count_asked()
        else:
            self.looks += len(tails)
            factors = np.where(self.query.space.motions_free(tails, heads), 1.0, np.inf)
        factors = factors * self._taught_factors(tails, heads)
        factors[~self._inspected_free(tails, heads)] = np.inf
        return factors

    def _taught_factors(self, tails: Floats, heads: Floats) -> Floats:
        """(n,) factors of motions near failures."""
        metric, factors = self.query.space.metric, np.ones(len(tails))
        for state, reach, factor in zip(*self.taught.arrays, strict=True):
            factors[segments_touched(tails, heads, state, reach, metric)] *= factor
        return factors

    def _inspected_free(self, tails: Floats, heads: Floats) -> np.ndarray:
        """(n,) whether states along motions are valid where failures have had vertices looked at."""
        free = np.ones(len(tails), np.bool_)
        if not self._inspections or not free.size:
            return free
        space = self.query.space
        parts = np.maximum(np.ceil(space.distance(tails, heads) / (_SPACING * self.step)), 1).astype(np.int64)
        owner = np.repeat(np.arange(len(tails)), parts)
        done = np.repeat(np.cumsum(parts) - parts, parts)
        share = (np.arange(len(owner)) - done + 1) / np.repeat(parts, parts)
        states = space.interpolate(tails[owner], heads[owner], share)
        near = np.zeros(len(states), np.bool_)
        for state, reach, _ in self._inspections:
            near |= space.distance(states, state) <= reach
        valid = self._inspections[-1][2]
        if near.any():
            free[owner[near][~valid(states[near])]] = False
        return free

    def _left(self, states: Floats, way: Way) -> Floats:
        """(n, m) what is left from each state by way of each state of the way, were the joint free."""
        left: Floats = self.query.space.distance(states[:, None], way.points[None]) + way.left
        return left

    def _known_along(self, states: Floats, way: Way) -> tuple[Floats, Floats]:
        """(n,) what is left from each state along the way, and (n, d') where it joins it.

        The best joint is asked about, and where it is not free, that to the nearest state of the way.
        """
        left, rows = self._left(states, way), np.arange(len(states))
        joint = np.argmin(left, axis=1)
        known = self._joint_costs(states, way, joint)
        refused = np.flatnonzero(np.isinf(known))
        if refused.size:
            nearest = np.argmin(left[refused] - way.left, axis=1)
            joint[refused] = nearest
            known[refused] = self._joint_costs(states[refused], way, nearest)
        return known, way.points[joint[rows]]

    def _joint_costs(self, states: Floats, way: Way, joint: Ints) -> Floats:
        heads, known = way.points[joint], way.left[joint].copy()
        straight = self.query.space.distance(states, heads)
        moved = np.flatnonzero(straight > 0.0)
        known[moved] += straight[moved] * self._factors(states[moved], heads[moved])
        return known

    def _followed_along(self, states: Floats) -> Floats:
        """(n,) what is left from each node along the way; infinite without one."""
        n, first, way = len(states), len(self._along), self._way
        if way is None:
            return np.full(n, np.inf)
        if n > first:
            known, heads = self._known_along(np.ascontiguousarray(states[first:n]), way)
            self._along = np.concatenate([self._along, known])
            self._joints = np.concatenate([self._joints[:first], heads])
        return self._along[:n]

    def raise_near(self, state: Floats, reach: float, factor: float) -> None:
        """As of any roadmap; a way that passes near is given up, and so is a node's joint to it."""
        super().raise_near(state, reach, factor)
        way, metric = self._way, self.query.space.metric
        if way is None:
            return
        if segments_touched(way.points[:-1], way.points[1:], state, reach, metric).size:
            self.forget()
        elif self._nodes is not None and len(self._along):
            n = len(self._along)
            near = segments_touched(self._nodes.states(np.arange(n)), self._joints[:n], state, reach, metric)
            self._along[near] = np.inf

    def forget(self) -> None:
        """Give the way up; another one is laid when h is asked for."""
        self._way, self._along = None, np.zeros(0)

    def inspect(self, state: Floats, reach: float, valid: Valid) -> None:
        """As of any roadmap; a way through what is not valid is given up, and joints are asked about anew."""
        super().inspect(state, reach, valid)
        self._along = np.zeros(0)
        if self._way is not None:
            near = self.query.space.distance(self._way.points, state) <= reach
            if near.any() and not valid(self._way.points[near]).all():
                self._way = None

    def ahead(self, origin: Floats) -> Floats:
        """(k, d') states at most a step from another one, on the way or on motions to it."""
        way = self._way
        if way is None:
            return np.zeros((0, len(origin)))
        apart = self.query.space.distance(way.points, origin)
        within = np.flatnonzero(apart <= self.step)
        first = int(within[-1]) if within.size else int(np.argmin(self._left(origin[None], way)[0]))
        beyond = first + np.arange(_AHEAD) * round(1.0 / _SPACING)
        targets = way.points[np.minimum(beyond, len(way.points) - 1)]
        metric = self.query.space.metric
        return np.array([steer(origin, target, self.step, metric) for target in targets])

    def choose(self, origin: Floats, states: Floats) -> int:
        """Choose one of some states around another, along the way if there is one."""
        way, doubts = self._way, self.query.doubts
        assert doubts is not None
        if way is None:
            return super().choose(origin, states)
        least = self._left(states, way).min(axis=1)
        origins = np.repeat(origin[None], len(states), axis=0)
        likely = doubts.likely(origins, states) >= LIKELY
        likely &= np.isfinite(self._taught_factors(origins, states))
        order = np.argsort(np.where(likely, least, np.inf), kind="stable")[: int(likely.sum())]
        best, chosen = np.inf, -1
        for k in range(0, len(order), _FEW):
            some = order[k : k + _FEW]
            if least[some[0]] >= best:
                break
            known, _ = self._known_along(states[some], way)
            if known.min() < best:
                best, chosen = float(known.min()), int(some[np.argmin(known)])
        self._count_asked()
        return chosen if chosen >= 0 else super().choose(origin, states)
