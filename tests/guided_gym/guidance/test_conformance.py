"""What every guiding space must keep to. A new one joins by adding a row to `SPACES`.

The last test registers a guiding space of its own, to show how little one needs.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from typing import ClassVar

import numpy as np
import pytest

from guided_gym.errors import InvalidInputError, NoPathError, UnknownNameError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.guidance import registry
from guided_gym.guidance.base import GuidingSpace
from guided_gym.guidance.cells import Uninformed, Voronoi
from guided_gym.guidance.registry import guidance_names, make_guidance, register_guidance
from guided_gym.planning import guided_search
from guided_gym.problems import Problem, Task
from guided_gym.randomness import streams
from guided_gym.search.search import Search
from guided_gym.storage.path_library import PathLibrary

Walled = Callable[[str], Problem]
Make = Callable[..., GuidingSpace]

# Name -> options that keep it small. Every registered guiding space has a row.
SPACES: dict[str, dict] = {
    "uninformed": {},
    "rrt": {"cell_samples": 500},
    "goal_distance": {},
    "oracle": {},
    "prm": {"vertices": 300},
    "lazy_prm": {"vertices": 300},
    "medial_axis": {},
    "path_database": {},  # its paths come from `stored_paths`
    "wavefront": {},
    "hybrid": {"guides": ["medial_axis", "goal_distance"]},
    "straight": {},
    "exact": {},
    "roadmap": {"vertices": 300},
    "shortened": {"vertices": 300},
    "skeleton": {"robot": "point"},
    "wave": {},
    "paths": {},  # likewise
    "searched": {"guidance": "goal_distance", "samples": 200},
}
EXPERIENCED = ("path_database", "paths")
DRAWN_EXACTLY = [name for name in SPACES if name != "rrt"]  # RRT's P is an estimate
TEMPERED = [name for name in SPACES if name not in ("uninformed", "rrt", "wavefront", "hybrid")]
ROBOTS = ["point", "rectangle", "notched"]


@pytest.fixture(scope="module")
def stored_paths(walled: Walled) -> Callable[[Problem], PathLibrary]:
    """A few solved paths for the space of a problem; one of them runs into the wall."""
    libraries: dict[str, PathLibrary] = {}

    def build(problem: Problem) -> PathLibrary:
        name = problem.robot.name
        if name not in libraries:
            found = [guided_search(problem, "medial_axis", seed=s, measure=False).path for s in range(3)]
            paths = [path for path in found if path is not None]
            paths.append(np.stack([problem.task.start, problem.task.goal]))
            libraries[name] = PathLibrary.from_paths(paths, problem.space.weights, problem.space.periods)
        return libraries[name]

    return build


@pytest.fixture
def make(stored_paths: Callable[[Problem], PathLibrary]) -> Make:
    """A guiding space of the table, for a problem."""

    def build(name: str, problem: Problem, **options: object) -> GuidingSpace:
        options = SPACES[name] | options
        if name in EXPERIENCED:
            options["database"] = stored_paths(problem)
        return make_guidance(name, **options)

    return build


def states(guidance: GuidingSpace, problem: Problem, samples: int, seed: int = 0) -> Iterator[Search]:
    """A search before each of its first samples."""
    _, expansion, own = streams(seed)
    search = Search(problem, expansion, own)
    search.attach(guidance)
    for _ in range(samples):
        yield search
        if search.solved:
            return
        node = guidance.select(search.tree)
        search.expand(node, guidance.propose(search.tree, node))


def test_table__has_a_row_for_every_guiding_space() -> None:
    assert list(SPACES) == guidance_names()


@pytest.mark.parametrize("name", SPACES)
@pytest.mark.parametrize("robot", ROBOTS)
def test_guidance__gives_a_distribution_and_keeps_to_it(
    walled: Walled, make: Make, name: str, robot: str
) -> None:
    problem = walled(robot)
    guidance = make(name, problem)
    for count, search in enumerate(states(guidance, problem, 60)):
        tree = search.tree
        if count % 7 == 0:
            values = guidance.values(tree)
            assert values.shape == (len(tree),)
            assert (values >= 0).all()  # no NaN either
        p = guidance.distribution(tree)
        assert p.shape == (len(tree),)
        assert p.sum() == pytest.approx(1)
        assert (p >= 0).all()
        before = search.guidance_rng.bit_generator.state
        node = guidance.select(tree)
        search.guidance_rng.bit_generator.state = before  # the loop selects again
        assert 0 <= node < len(tree)
        if name in DRAWN_EXACTLY:
            assert guidance.distribution(tree)[node] > 0


@pytest.mark.parametrize("name", SPACES)
@pytest.mark.parametrize("robot", ROBOTS)
def test_propose__stays_within_one_step(walled: Walled, make: Make, name: str, robot: str) -> None:
    problem = walled(robot)
    guidance = make(name, problem)
    rng = np.random.default_rng(0)
    for search in states(guidance, problem, 50):
        tree = search.tree
        for node in (guidance.select(tree), int(rng.integers(len(tree)))):  # somebody else's choice too
            target = guidance.propose(tree, node)
            assert target.shape == (problem.space.dimension,)
            assert target.dtype == np.float64
            assert problem.space.distance(tree.configurations[node], target) <= search.planner.step + 1e-9


@pytest.mark.parametrize("name", SPACES)
@pytest.mark.parametrize("robot", ROBOTS)
def test_project_and_heuristic__agree_with_each_other(
    walled: Walled, make: Make, name: str, robot: str
) -> None:
    problem = walled(robot)
    guidance = make(name, problem)
    for search in states(guidance, problem, 20):
        q = np.array(search.tree.configurations)
        h = guidance.heuristic(guidance.project(search.tree, q))
        assert h.shape == (len(q),)
        assert (h >= 0).all()


@pytest.mark.parametrize("name", SPACES)
def test_reset__makes_it_as_good_as_new(walled: Walled, make: Make, name: str) -> None:
    used = make(name, walled("rectangle"))
    guided_search(walled("rectangle"), used, seed=9, max_samples=70, measure=False)
    fresh = make(name, walled("rectangle"))
    trees = [
        guided_search(walled("rectangle"), g, seed=4, max_samples=120, measure=False).tree
        for g in (used, fresh)
    ]
    assert len(trees[0]) == len(trees[1])
    assert (trees[0].configurations == trees[1].configurations).all()
    assert trees[0].failed_nodes.tolist() == trees[1].failed_nodes.tolist()


@pytest.mark.parametrize("name", [name for name in SPACES if name not in EXPERIENCED])
def test_guidance__serves_one_robot_after_another(walled: Walled, make: Make, name: str) -> None:
    guidance = make(name, walled("rectangle"))
    for robot in ("rectangle", "point", "notched"):
        result = guided_search(walled(robot), guidance, seed=1, max_samples=40, measure=False)
        assert result.tree.configurations.shape[1] == walled(robot).space.dimension


@pytest.mark.parametrize("name", TEMPERED)
def test_select__without_a_temperature_is_argmin(walled: Walled, make: Make, name: str) -> None:
    guidance = make(name, walled("rectangle"))
    for search in states(guidance, walled("rectangle"), 40):
        values = guidance.values(search.tree)
        if np.isfinite(values).any():
            p = guidance.distribution(search.tree)
            assert p[int(np.argmin(values))] == 1
            assert guidance.select(search.tree) == int(np.argmin(guidance.values(search.tree)))


@pytest.mark.parametrize("name", TEMPERED)
def test_select__with_a_temperature_draws_from_softmin(walled: Walled, make: Make, name: str) -> None:
    problem = walled("rectangle")
    guidance = make(name, problem, temperature=2.0)
    for _ in range(30):
        *_, search = states(guidance, problem, 40)
        if np.isfinite(guidance.values(search.tree)).any():
            break
    h = guidance.values(search.tree).copy()
    p = guidance.distribution(search.tree)
    if np.isfinite(h).any():
        weights = np.exp((h.min() - h) / (2.0 * search.planner.step))
        assert p == pytest.approx(weights / weights.sum())
    drawn = np.bincount([guidance.select(search.tree) for _ in range(3000)], minlength=p.size) / 3000
    assert 0.5 * np.abs(drawn - p).sum() < 0.12
    assert (p[drawn > 0] > 0).all()


def test_voronoi__draws_about_from_its_estimate(walled: Walled) -> None:
    guidance = make_guidance("rrt", goal_bias=0.2)
    *_, search = states(guidance, walled("point"), 40)
    p = guidance.distribution(search.tree)
    drawn = np.bincount([guidance.select(search.tree) for _ in range(4000)], minlength=p.size) / 4000
    assert 0.5 * np.abs(drawn - p).sum() < 0.1
    assert p[search.tree.nearest(search.goal)] > 0.2


def test_voronoi__with_a_goal_bias_grows_the_same_tree_in_bursts_and_by_single_samples(
    walled: Walled,
) -> None:
    problem = walled("rectangle")
    trees = []
    for distributions in (False, True):  # the whole distribution is asked for sample by sample
        guidance = make_guidance("rrt", goal_bias=0.3)
        result = guided_search(problem, guidance, seed=4, max_samples=150, distributions=distributions)
        trees.append(result.tree)
    assert np.array_equal(trees[0].configurations, trees[1].configurations)
    assert np.array_equal(trees[0].failed_targets, trees[1].failed_targets)
    plain = guided_search(problem, "rrt", seed=4, max_samples=150, measure=False).tree
    assert not np.array_equal(plain.configurations[:20], trees[0].configurations[:20])


@pytest.mark.parametrize("name", SPACES)
@pytest.mark.parametrize("robot", ["point", "rectangle"])
def test_failures__teach(walled: Walled, make: Make, name: str, robot: str) -> None:
    """With a wall in the way, nobody runs into it from one node for ever."""
    problem = walled(robot)
    result = guided_search(problem, make(name, problem), seed=2, max_samples=300, measure=False)
    if result.samples < 40:
        return  # the wall was no trouble
    share = np.bincount(result.record.selected).max() / result.samples
    assert share <= 0.6
    tree = result.tree
    cells = np.floor(tree.failed_targets / (0.05 * problem.space.extent)).astype(int)
    _, counts = np.unique(np.column_stack([tree.failed_nodes, cells]), axis=0, return_counts=True)
    assert counts.max(initial=0) <= max(20, 0.1 * result.samples)  # the same node towards the same place


@pytest.mark.parametrize("name", SPACES)
def test_guidance__survives_where_no_path_exists(
    closed: Problem, make: Make, walled: Walled, name: str
) -> None:
    if name == "oracle":
        return  # refuses, and a test of the search says so
    guidance = make(name, walled("rectangle") if name in EXPERIENCED else closed)
    try:
        result = guided_search(closed, guidance, seed=0, max_samples=250, measure=False)
    except NoPathError as error:  # it has proved so
        result = error.result
        assert result is not None
    assert not result.solved
    if result.samples:  # some have it proved before they draw one
        assert np.bincount(result.record.selected).max() <= 0.6 * result.samples


@pytest.mark.parametrize("name", [name for name in SPACES if name != "hybrid"])
def test_guidance__works_inside_a_hybrid(walled: Walled, make: Make, name: str) -> None:
    problem = walled("rectangle")
    hybrid = make_guidance("hybrid", guides=[make(name, problem), "goal_distance"])
    result = guided_search(problem, hybrid, seed=3, max_samples=120, distributions=True)
    assert result.samples == 120 or result.solved
    assert np.isfinite(result.record.efficiency).all()


@pytest.mark.parametrize("name", SPACES)
def test_guidance__can_expand_for_another(walled: Walled, make: Make, name: str) -> None:
    problem = walled("rectangle")
    result = guided_search(
        problem, "uninformed", expansion=make(name, problem), seed=3, max_samples=80, measure=False
    )
    steps = problem.space.distance(
        result.tree.configurations[1:], result.tree.configurations[result.tree.parents[1:]]
    )
    assert np.max(steps, initial=0) <= problem.space.scale + 1e-9


@pytest.mark.parametrize("name", SPACES)
def test_guidance__in_an_environment_without_obstacles(make: Make, walled: Walled, name: str) -> None:
    problem = Problem(
        walled("rectangle").robot, Environment((0.0, 0.0, 10.0, 10.0)), Task((1.5, 5, 0), (8.5, 5, 0))
    )
    guidance = make(name, walled("rectangle") if name in EXPERIENCED else problem)
    _, expansion, own = streams(0)
    search = Search(problem, expansion, own)
    search.attach(guidance)
    for _ in range(15):  # on, though the goal is in sight
        node = guidance.select(search.tree)
        assert not search.expand(node, guidance.propose(search.tree, node)).failed


@pytest.mark.parametrize("name", SPACES)
def test_options__that_are_unknown_are_met_with_a_suggestion(name: str) -> None:
    known = {"uninformed": None, "rrt": "goal_bias", "hybrid": "guides"}.get(name, "temperature")
    if known is None:
        with pytest.raises(UnknownNameError, match="option of guidance 'uninformed'"):
            make_guidance(name, anything=1)
        return
    with pytest.raises(UnknownNameError, match=f"did you mean '{known}'"):
        make_guidance(name, **{known[:-1]: 1})


@pytest.mark.parametrize("option", ["temperature", "expansion_penalty"])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_options__are_checked(option: str, value: float) -> None:
    for name in ("prm", "lazy_prm", "medial_axis"):
        with pytest.raises(InvalidInputError, match=option):
            make_guidance(name, **{option: value})


@pytest.mark.parametrize("bad", [None, 42, ":x", ".foo:Bar", "os:path", "nosuch:X", "os:nosuch"])
def test_make_guidance__refuses_what_is_no_guiding_space(bad: object) -> None:
    with pytest.raises(InvalidInputError, match="guidance"):
        make_guidance(bad)  # type: ignore[arg-type]


def test_make_guidance__takes_names_paths_and_instances() -> None:
    instance = make_guidance("rrt")
    assert make_guidance(instance) is instance
    assert type(make_guidance("guided_gym.guidance.cells:Voronoi")) is Voronoi
    with pytest.raises(InvalidInputError, match="need a name"):
        make_guidance(instance, goal_bias=0.1)
    with pytest.raises(UnknownNameError, match="did you mean 'lazy_prm'"):
        make_guidance("lazyprm")
    with pytest.raises(InvalidInputError, match="names joined by"):
        make_guidance("lazy_prm+")


@pytest.mark.parametrize("name", [name for name in SPACES if name not in EXPERIENCED])
def test_guidance__can_be_pickled_before_a_search(walled: Walled, name: str) -> None:
    guidance = make_guidance(name, **SPACES[name])
    twin = pickle.loads(pickle.dumps(guidance))
    a, b = (
        guided_search(walled("rectangle"), g, seed=1, max_samples=50, measure=False) for g in (guidance, twin)
    )
    assert (a.tree.configurations == b.tree.configurations).all()


def test_registering__takes_thirty_lines(monkeypatch: pytest.MonkeyPatch, walled: Walled) -> None:
    monkeypatch.setattr(registry.GUIDANCES, "rows", dict(registry.GUIDANCES.rows))

    @register_guidance
    class Workspace(GuidingSpace):
        """Robot modification to a point: h is the obstacle-free distance in the workspace."""

        name: ClassVar[str] = "workspace"

        def __init__(self, *, scale: float = 1.0, temperature: float = 0.0) -> None:
            super().__init__(temperature=temperature)
            self.scale = scale

        def project(self, tree, q):
            """The position of the reference point."""
            return q[:, :2]

        def heuristic(self, states):
            """Distance to the goal's position."""
            return self.scale * np.hypot(*(states - self.goal[:2]).T)

    assert guidance_names()[-1] == "workspace"
    for robot in ROBOTS:
        problem = walled(robot)
        for spec in ("workspace", make_guidance("workspace", scale=2.0, temperature=1.0), "workspace+rrt"):
            result = guided_search(problem, spec, seed=0, max_samples=60, distributions=True)
            assert np.isfinite(result.record.divergence).all()
    with pytest.raises(UnknownNameError, match="did you mean 'scale'"):
        make_guidance("workspace", scal=1)


@pytest.mark.parametrize("name", ["", "a+b", "a:b", "a b", "a,b", "a@b", None, 3])
def test_registering__refuses_names_that_would_be_misread(name: str) -> None:
    class Nameless(Uninformed):
        pass

    Nameless.name = name
    with pytest.raises(InvalidInputError, match="expected a word"):
        register_guidance(Nameless)


def test_registering__keeps_what_has_the_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry.GUIDANCES, "rows", dict(registry.GUIDANCES.rows))

    class Mine(Uninformed):
        name: ClassVar[str] = "rrt"

    with pytest.raises(InvalidInputError, match=r"Voronoi; replace=True"):
        register_guidance(Mine)
    assert type(make_guidance("rrt")) is Voronoi
    register_guidance(Mine, replace=True)
    assert type(make_guidance("rrt")) is Mine
    twin = type("Mine", (Mine,), {"__qualname__": Mine.__qualname__, "__module__": Mine.__module__})
    assert register_guidance(twin) is twin  # a module that was loaded anew
    for nothing in (Robot, Mine(), None):
        with pytest.raises(InvalidInputError, match="subclass of GuidingSpace"):
            register_guidance(nothing)


class Given(GuidingSpace):
    """Its h is what it is given."""

    def __init__(self, h) -> None:
        super().__init__()
        self.h = h

    def project(self, tree, q):
        return q

    def heuristic(self, states):
        return self.h(len(states))


@pytest.mark.parametrize(
    ("h", "message"),
    [
        (lambda n: np.full(n, -1.0), "got -1.0 for state 0"),
        (lambda n: np.full(n, np.nan), "got nan"),
        (lambda n: np.zeros((n, 2)), "got shape"),
        (lambda n: 1.0, r"got shape \(\)"),
        (lambda n: ["far"] * n, "got \\['far'"),
        (lambda n: None, "got None|got nan|got shape"),
    ],
)
def test_h__of_a_users_guiding_space_is_checked(walled: Walled, h, message: str) -> None:
    with pytest.raises(InvalidInputError, match=rf"Given\.heuristic: expected .*{message}"):
        guided_search(walled("point"), Given(h), seed=0, max_samples=5, measure=False)


@pytest.mark.parametrize("node", [-1, 10**9, 0.5, None, "root"])
def test_select__of_a_users_guiding_space_is_checked(walled: Walled, node: object) -> None:
    guidance = Given(np.ones)
    guidance.select = lambda tree: node  # type: ignore[method-assign, assignment, return-value]
    with pytest.raises(InvalidInputError, match="node: expected an integer, 0 to 0, got"):
        guided_search(walled("point"), guidance, seed=0, max_samples=5)


@pytest.mark.parametrize("h", [lambda n: np.full(n, np.inf), lambda n: [0] * n])
def test_h__may_be_infinite_and_need_not_be_an_array(walled: Walled, h) -> None:
    assert guided_search(walled("point"), Given(h), seed=0, max_samples=5, measure=False).samples == 5


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("lazy_prm", {"vertices": "many"}),
        ("lazy_prm", {"reach": "far"}),
        ("lazy_prm", {"check": -1.0}),
        ("lazy_prm", {"factor": np.nan}),
        ("prm", {"neighbours": 2.5}),
        ("prm", {"anchors": True}),
        ("rrt", {"goal_bias": float("nan")}),
        ("rrt", {"cell_samples": "4"}),
        ("medial_axis", {"factor": "fast"}),
        ("goal_distance", {"temperature": [1]}),
        ("hybrid", {"guides": 3}),
        ("hybrid", {"rule": 3}),
        ("path_database", {"database": 3}),
    ],
)
def test_options__of_the_wrong_type_are_refused(name: str, options: dict[str, object]) -> None:
    with pytest.raises(InvalidInputError, match=rf"{next(iter(options))}: expected .*, got"):
        make_guidance(name, **options)


def test_robot__without_turning_has_two_coordinates() -> None:
    assert Robot.point().dimension == 2
