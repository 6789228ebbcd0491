"""OMPL's planners, watched: the tree is their own, and the traps of the wheel catch nobody."""

from __future__ import annotations

import gc
import importlib.metadata
import math
import sys
import time
from collections.abc import Callable, Iterator
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from shapely.geometry import box

from guided_gym import (
    Environment,
    InvalidInputError,
    Linkage,
    Problem,
    Robot,
    Search,
    StorageError,
    Task,
    UnknownNameError,
    guided_search,
    make_distribution,
    make_guidance,
    read_trace,
    streams,
)
from guided_gym.guidance.registry import make_searcher
from guided_gym.planners import ompl as planners
from guided_gym.planners.ompl import OmplPlanner
from guided_gym.planners.query import Query, Questions
from guided_gym.planners.spaces import StateSpace

ompl = pytest.importorskip("ompl", reason="the extra ompl is not installed")
base = pytest.importorskip("ompl.base", reason="the extra ompl is not installed")

SINGLE = ("RRT", "RRTstar", "InformedRRTstar", "SORRTstar", "KPIECE1", "BITstar", "FMT")
TWO = ("RRTConnect", "BKPIECE1", "BFMT")  # trees


def planner(name: str, **options: Any) -> OmplPlanner:
    made = make_searcher(f"ompl:{name}", **options)
    assert isinstance(made, OmplPlanner)
    return made


def grown(name: str, problem: Problem, seed: int, limit: int = 3000, **options: Any) -> tuple[Search, Any]:
    """A watched search and OMPL's objects, as they were left."""
    _, expansion, guidance = streams(seed)
    search, watched = Search(problem, expansion, guidance), planner(name, **options)
    watched.prepare(search)
    setup = watched._query
    watched.run(search, limit)
    return search, setup


def edges(search: Search) -> set[tuple[tuple[float, ...], tuple[float, ...]]]:
    tree = search.tree
    rows = [tuple(q) for q in tree.configurations.round(9).tolist()]
    return {(rows[p], rows[i]) for i, p in enumerate(tree.parents.tolist()) if p >= 0}


def own_edges(setup: Any) -> set[tuple[tuple[float, ...], tuple[float, ...]]]:
    def row(state: tuple[float, ...]) -> tuple[float, ...]:
        return tuple(setup.states.configuration(state).round(9).tolist())

    return {(row(a), row(b)) for a, b in setup.edges()}


@pytest.fixture(scope="module")
def cup() -> Problem:
    return make_distribution("Cup").problem(0)


@pytest.fixture(scope="module")
def closed() -> Problem:
    """Start and goal in rooms of their own."""
    environment = Environment((0, 0, 10, 10), (box(4.9, 0, 5.1, 10),))
    return Problem(Robot.point(), environment, Task((1, 1), (9, 9)))


# The tree ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", SINGLE)
def test_tree__is_the_planner_s_own(name: str, cup: Problem) -> None:
    search, setup = grown(name, cup, 0)
    assert search.solved
    assert edges(search) == own_edges(setup)


@pytest.mark.parametrize("name", TWO)
def test_tree__of_two_is_their_own_and_leads_away_from_the_start(name: str, cup: Problem) -> None:
    """OMPL's data has the goal tree's edges towards the goal's root."""
    search, setup = grown(name, cup, 0)
    mine, own = edges(search), own_edges(setup)
    assert {frozenset(edge) for edge in mine} == {frozenset(edge) for edge in own}
    assert mine != own


@pytest.mark.parametrize("name", ["PRM", "PRMstar"])
def test_tree__of_a_roadmap_has_its_edges_only(name: str, cup: Problem) -> None:
    search, setup = grown(name, cup, 0)
    assert edges(search) < own_edges(setup)


def test_tree__of_lazy_planners_has_what_was_checked_only(cup: Problem) -> None:
    search, setup = grown("LBKPIECE1", cup, 0)
    own = own_edges(setup)
    assert {frozenset(edge) for edge in edges(search)} < {frozenset(edge) for edge in own}
    assert cup.space.motions_free(*map(np.array, zip(*edges(search), strict=True))).all()
    assert not cup.space.motions_free(*map(np.array, zip(*own, strict=True))).all()


@pytest.mark.parametrize("name", ["RRT", "RRTConnect", "BITstar", "FMT"])
def test_watching_changes_nothing(name: str, cup: Problem) -> None:
    """With the same seed and OMPL's own check, unwatched OMPL grows the tree that we saw begin."""
    search, _ = grown(name, cup, 0, resolution=0.01)
    assert search.solved
    alone = planner(name, resolution=0.01).alone(cup, seed=0)
    assert alone.path is not None
    theirs = {frozenset(tuple(np.round(state, 9)) for state in edge) for edge in alone.tree}
    goal = tuple(cup.task.goal.round(9).tolist())  # our rule ends a search where the goal is seen
    assert {frozenset(edge) for edge in edges(search) if goal not in edge} <= theirs


def test_alone__one_call_for_a_motion_answers_as_one_for_each_state(cup: Problem) -> None:
    watched = planner("RRTConnect", resolution=0.002)
    one, other = watched.alone(cup, seed=0), watched.alone(cup, seed=0, by_states=False)
    assert one.tree == other.tree
    assert one.looks > other.looks


def test_alone__with_certified_motions_no_path_collides(cup: Problem) -> None:
    for name in ("RRT", "FMT", "AORRTC"):
        alone = planner(name).alone(cup, seed=0)
        assert alone.path is not None
        assert alone.free


@pytest.mark.parametrize("name", [*SINGLE, *TWO, "LBKPIECE1", "AORRTC"])
def test_same_seed_same_tree__in_one_process(name: str, cup: Problem) -> None:
    """OMPL takes a seed late, though it complains."""
    one, two, other = (
        guided_search(cup, f"ompl:{name}", seed=seed, max_samples=200, measure=False) for seed in (3, 3, 4)
    )
    assert np.array_equal(one.tree.configurations, two.tree.configurations)
    assert np.array_equal(one.record.selected, two.record.selected)
    assert one.tries == two.tries
    assert not np.array_equal(one.tree.configurations, other.tree.configurations)


# Samples ----------------------------------------------------------------------------------------------------


def test_samples__of_one_tree_are_all_tries(cup: Problem) -> None:
    result = guided_search(cup, "ompl:RRT", seed=0)
    assert sum(result.tries.values()) == 0
    assert result.samples == result.tree.failure_count + len(result.tree) - 1
    assert result.collision_checks == 1 + result.samples + len(result.tree) - 1  # the goal is looked for
    assert np.isfinite(result.record.efficiency).all()
    assert (result.record.efficiency >= result.record.best).all()
    assert (result.record.nodes > result.record.selected).all()


def test_samples__of_a_goal_tree_have_no_efficiency(cup: Problem) -> None:
    result = guided_search(cup, "ompl:RRTConnect", seed=0)
    assert result.tries["elsewhere"] > 0
    assert result.record.efficiency.size == result.samples
    tried = result.samples + sum(result.tries[kind] for kind in ("elsewhere", "joining", "within"))
    assert tried <= result.collision_checks
    assert result.tries["joined"] <= result.tries["elsewhere"]


def test_samples__of_the_start_tree_keep_to_the_step(cup: Problem) -> None:
    result = guided_search(cup, "ompl:RRT(range=0.4)", seed=0)
    tree = result.tree
    lengths = cup.space.distance(tree.configurations[1:], tree.configurations[tree.parents[1:]])
    assert lengths.max() <= 0.4 + 1e-9
    longer = guided_search(cup, "ompl:RRT(range=0)", seed=0).tree  # OMPL's own choice
    assert (
        cup.space.distance(longer.configurations[1:], longer.configurations[longer.parents[1:]]).max() > 1.0
    )


def test_limit__counts_tries_of_both_trees(closed: Problem) -> None:
    result = guided_search(closed, "ompl:RRTConnect", seed=0, max_samples=50, measure=False)
    assert not result.solved
    assert result.samples + result.tries["elsewhere"] + result.tries["joining"] == 50


def test_first_false__goes_on_for_shorter_paths(cup: Problem) -> None:
    once = guided_search(cup, "ompl:RRTstar", seed=0, max_samples=800, measure=False)
    watched = planner("RRTstar", first=False)
    longer = guided_search(cup, watched, seed=0, max_samples=800, measure=False)
    assert longer.samples == 800 > once.samples
    assert longer.length < once.length
    lengths = [length for _, _, length in watched.history]
    assert lengths == sorted(lengths, reverse=True)
    assert lengths[-1] == pytest.approx(longer.length)


# Spaces -----------------------------------------------------------------------------------------------------


def some_space(periods: list[float], weights: list[float], lower: list[float], upper: list[float]) -> Any:
    arrays = {
        name: np.array(values, np.float64)
        for name, values in (("periods", periods), ("weights", weights), ("lower", lower), ("upper", upper))
    }
    return SimpleNamespace(dimension=len(periods), **arrays)


TURN = 2 * math.pi
SPACES = {
    "plane": some_space([0, 0], [1, 1], [0, 0], [10, 5]),
    "robot": some_space([0, 0, TURN], [1, 1, 0.7], [0, 0, -math.pi], [10, 5, math.pi]),
    "arm": some_space([0, 0, 0, 0], [2, 1.5, 1, 0.5], [-1, -2, -3, -1], [1, 2, 3, 2]),
    "rings": some_space([TURN, 0, TURN], [2, 1.5, 1], [-math.pi, -2, -math.pi], [math.pi, 2, math.pi]),
    "ring": some_space([TURN, TURN], [1, 0.5], [-math.pi] * 2, [math.pi] * 2),
}


@pytest.mark.parametrize("cut", [False, True])
@pytest.mark.parametrize("kind", SPACES)
def test_space__agrees_with_ompl(kind: str, cut: bool) -> None:
    space = SPACES[kind]
    states = StateSpace(base, space, cut)
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b = rng.uniform(space.lower, space.upper, (2, space.dimension))
        one, two = states.state(a), states.state(b)
        assert states.configuration(states.read(one)) == pytest.approx(a)
        far = states.length(states.read(one), states.read(two))
        assert far == pytest.approx(states.ompl.distance(one, two))
        states.ompl.setLongestValidSegmentFraction(0.03)
        states.ompl.setup()
        assert states.pieces(a, b, 0.03) == states.ompl.validSegmentCount(one, two)
        change = b - a
        if not cut:
            round_ = space.periods > 0
            change[round_] -= TURN * np.rint(change[round_] / TURN)
        ours = float(np.linalg.norm(change * space.weights))
        assert ours <= far + 1e-9
        if cut or not (space.periods > 0).any():
            assert far == pytest.approx(ours)  # the same metric


def test_space__of_a_robot_that_turns_is_ompl_s_own(cup: Problem) -> None:
    assert isinstance(StateSpace(base, cup.space, False).ompl, base.SE2StateSpace)
    assert isinstance(StateSpace(base, cup.space, True).ompl, base.RealVectorStateSpace)


def test_space__in_which_a_planner_cannot_sample_is_refused() -> None:
    space = SPACES["ring"]
    problem: Any = SimpleNamespace(
        space=SimpleNamespace(**vars(space), extent=1.0, valid=lambda q: True),
        task=SimpleNamespace(start=np.zeros(2), goal=np.ones(2), tolerance=0.0),
    )
    with pytest.raises(InvalidInputError, match="angles=cut"):
        Query(ompl, problem, "BITstar")
    assert Query(ompl, problem, "BITstar", cut=True, resolution=0.01).solve(2.0) is not None
    for name in ("RRT", "KPIECE1", "FMT", "PRM"):
        assert Query(ompl, problem, name, resolution=0.01).solve(2.0) is not None


@pytest.fixture(scope="module", params=[None, 2.5], ids=["turning", "limited"])
def arm(request: pytest.FixtureRequest) -> Problem:
    """Three links that turn freely, or not, between two blocks."""
    environment = Environment((0, 0, 10, 10), (box(7.6, 4.2, 10, 5), box(2, 6.3, 4.2, 7)))
    links = Linkage.arm([1.3] * 3, 0.15, base=(5, 5), limits=request.param)
    task = Task((0.5, 0.4, -0.3), (-2.0, -0.5, 0.4))
    return Problem(links, environment, task)


@pytest.mark.parametrize("name", ["RRT", "RRTstar", "RRTConnect", "KPIECE1", "FMT"])
def test_arm__is_planned_for_like_any_robot(name: str, arm: Problem) -> None:
    search, query = grown(name, arm, 0)
    assert search.solved
    mine = {frozenset(edge) for edge in edges(search)}
    own = {frozenset(edge) for edge in own_edges(query)}
    assert mine == own if name in SINGLE else mine <= own  # the goal was seen before the trees met
    path = search.path()
    assert path is not None
    assert arm.space.motions_free(path[:-1], path[1:]).all()


def test_arm__whose_joints_turn_freely_is_refused_by_those_that_sample_ellipses(arm: Problem) -> None:
    if (arm.space.periods == 0).all():
        assert guided_search(arm, "ompl:BITstar", seed=0, measure=False).solved
        return
    with pytest.raises(InvalidInputError, match="angles=cut"):
        guided_search(arm, "ompl:BITstar", seed=0, measure=False)
    assert guided_search(arm, "ompl:BITstar(angles=cut)", seed=0, measure=False).solved


# Traps ------------------------------------------------------------------------------------------------------


def test_trap__an_old_path_does_not_outlive_a_new_wall() -> None:
    """`Planner.clear` of OMPL keeps old solutions: each search has objects of its own."""
    wall = Environment((0, 0, 10, 10), (box(4.9, 0, 5.1, 9),))
    higher = Environment((0, 0, 10, 10), (box(4.9, 0, 5.1, 10),))
    task = Task((1, 1), (9, 1))
    same = planner("RRTConnect")
    first = guided_search(Problem(Robot.point(), wall, task), same, seed=0, measure=False)
    second = guided_search(Problem(Robot.point(), higher, task), same, seed=0, max_samples=500, measure=False)
    assert first.solved
    assert not second.solved


@pytest.mark.parametrize("name", planners.planner_names())
def test_trap__start_and_goal_that_see_each_other_need_no_planner(name: str) -> None:
    """AORRTC calls such a goal invalid, with an exact solution in hand."""
    space = Environment((0, 0, 10, 10), ())
    for goal in ((9, 9), (1, 1)):  # KPIECE1 and RRTConnect return detours for start = goal
        result = guided_search(Problem(Robot.point(), space, Task((1, 1), goal)), f"ompl:{name}", seed=0)
        assert result.solved
        assert result.samples == 0
        assert result.length == pytest.approx(math.dist((1, 1), goal))


def test_trap__kpiece_takes_no_part_of_a_motion_from_a_watched_check(cup: Problem) -> None:
    """A validator written in Python is asked for yes or no: alone, KPIECE1 also keeps what was free."""
    own = planner("KPIECE1", resolution=0.01)
    alone = own.alone(cup, seed=0)
    search, _ = grown("KPIECE1", cup, 0, resolution=0.01)
    theirs = {frozenset(tuple(np.round(state, 9)) for state in edge) for edge in alone.tree}
    assert not {frozenset(edge) for edge in edges(search)} <= theirs


def test_trap__answers_of_numpy_reach_ompl_as_python_s(cup: Problem) -> None:
    answer = cup.space.valid(cup.task.start)
    assert type(answer) is bool
    assert type(StateSpace(base, cup.space, False).sampled_check(0.01)(cup.task.start, cup.task.goal)) is bool


def test_log_level__is_as_before() -> None:
    before = ompl.util.getLogLevel()
    ompl.util.setLogLevel(ompl.util.LOG_ERROR)
    try:
        guided_search(make_distribution("Cup").problem(0), "ompl:RRT", seed=0, max_samples=5, measure=False)
        assert ompl.util.getLogLevel() == ompl.util.LOG_ERROR
    finally:
        ompl.util.setLogLevel(before)


def test_memory__does_not_grow(cup: Problem) -> None:
    def pages() -> int:
        return int(Path("/proc/self/statm").read_text().split()[1])

    if not Path("/proc/self/statm").exists():
        pytest.skip("needs /proc")

    def search() -> None:
        guided_search(cup, "ompl:RRTConnect", seed=0, max_samples=100, measure=False)

    for _ in range(30):
        search()
    gc.collect()
    before = pages()
    for _ in range(100):
        search()
    gc.collect()
    assert (pages() - before) * 4096 < 2 * 2**20


@pytest.mark.parametrize("resolution", [0.0, 0.01])
def test_memory__nothing_outlives_a_run_unwatched(resolution: float, cup: Problem) -> None:
    """OMPL holds who answers it, who held its condition to end, which held OMPL: nobody could free them."""

    def left() -> int:
        gc.collect()
        # By type: a dead proxy, which another library may have left, answers no isinstance.
        return sum(issubclass(type(thing), Questions) for thing in gc.get_objects())

    before = left()
    assert planner("RRT", resolution=resolution).alone(cup, seed=0).path is not None
    assert left() == before


# Bad input --------------------------------------------------------------------------------------------------


def test_unknown_planner__names_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'RRTConnect'"):
        make_searcher("ompl:RRTConect")


def test_planner_that_the_wheel_lacks__says_so() -> None:
    missing = planners.missing_planners()
    assert missing
    with pytest.raises(InvalidInputError, match=r"wheel .* does not bind.*RRTConnect"):
        make_searcher(f"ompl:{missing[0]}")


def test_unknown_parameter__names_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'goal_bias'"):
        make_searcher("ompl:RRT(goalbias=0.1)")
    with pytest.raises(UnknownNameError, match="goal_bias"):
        OmplPlanner("RRT", {"goal_bia": 0.1})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ompl:RRT(goal_bias=1.5)", "goal_bias: expected a share"),
        ("ompl:RRT(range=-1)", "range"),
        ("ompl:RRT(range=nan)", "range"),
        ("ompl:FMT(num_samples=0)", "num_samples"),
        ("ompl:FMT(num_samples=1.5)", "num_samples"),
        ("ompl:RRTstar(delay_cc=1)", "delay_cc"),
        ("ompl:RRT(resolution=1)", "resolution"),
        ("ompl:RRT(seconds=0)", "seconds"),
        ("ompl:RRT(angles=square)", "angles"),
        ("ompl:RRT(first=2)", "first"),
    ],
)
def test_value_that_cannot_be(text: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        make_searcher(text)


@pytest.fixture
def unknown() -> Iterator[None]:
    """What is known of the wheel is looked up again."""
    caches = (planners.bindings, planners._maker, planners.setters)
    for cached in caches:
        cached.cache_clear()
    yield
    for cached in caches:
        cached.cache_clear()


@pytest.mark.usefixtures("unknown")
def test_missing_library__says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ompl", None)
    with pytest.raises(InvalidInputError, match=r"pip install 'guided-gym\[ompl\]'"):
        make_searcher("ompl:RRT")


@pytest.mark.usefixtures("unknown")
@pytest.mark.parametrize("version", ["1.7.0", "3.0.0"])
def test_other_major_version__is_refused(version: str, monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.metadata.version
    monkeypatch.setattr(importlib.metadata, "version", lambda name: version if name == "ompl" else real(name))
    with pytest.raises(InvalidInputError, match=f"expected version 2.x, got {version}"):
        make_searcher("ompl:RRT")


@pytest.mark.parametrize("name", ["RRT", "PRM", "FMT", "BITstar", "AORRTC"])
def test_time_limit__ends_a_planner(name: str, closed: Problem) -> None:
    began = time.perf_counter()
    result = guided_search(closed, f"ompl:{name}(seconds=0.1)", seed=0, max_samples=10**7, measure=False)
    assert time.perf_counter() - began < 3.0
    assert not result.solved


def test_approximate_solution__is_none(closed: Problem) -> None:
    """RRT has an approximate path to whatever lies nearest to the goal."""
    search, setup = grown("RRT", closed, 0, limit=100)
    assert setup.definition.hasApproximateSolution()
    assert not search.solved


def test_path_that_collides__is_not_solved() -> None:
    """A thin wall between the states that a coarse check looks at."""
    environment = Environment((0, 0, 10, 10), (box(4.99, 0, 5.01, 10),))
    problem = Problem(Robot.point(), environment, Task((1, 1), (9, 9)))
    result = guided_search(problem, "ompl:RRT(resolution=0.2)", seed=0, measure=False)
    assert not result.solved
    assert result.path is None
    assert result.colliding is not None
    assert result.colliding[0] == pytest.approx(problem.task.start)
    assert result.colliding[-1] == pytest.approx(problem.task.goal)


@pytest.mark.parametrize("name", ["RRTstar", "RRTConnect", "KPIECE1", "BITstar(resolution=0.01)"])
def test_measure__in_hindsight_is_what_it_was_on_the_way(cup: Problem, name: str) -> None:
    """A trace has each choice measured at once, else as many as can be, together: rewiring or not."""
    runs = [
        guided_search(cup, f"ompl:{name}", seed=0, max_samples=150, trace=trace)
        for trace in (StringIO(), None)
    ]
    assert np.array_equal(runs[0].record.efficiency, runs[1].record.efficiency)
    assert np.array_equal(runs[0].tree.parents, runs[1].tree.parents)
    assert (runs[0].tree.rewirings > 0) == (name == "RRTstar")


def test_error_in_a_check__comes_back(cup: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*asked: object) -> bool:
        raise KeyboardInterrupt

    monkeypatch.setattr(type(cup.space), "motion_free", fail)
    monkeypatch.setattr("guided_gym.search.watch.attempt", fail)
    _, expansion, guidance = streams(0)
    monkeypatch.setattr(type(cup), "begins_solved", False)
    search = Search(cup, expansion, guidance)
    for name in ("RRT", "PRM"):
        watched = planner(name)
        watched.prepare(search)
        with pytest.raises(KeyboardInterrupt):
            watched.run(search, 10)


@pytest.mark.parametrize(
    "use",
    [
        lambda: make_guidance("ompl:RRT"),
        lambda: make_guidance("hybrid(ompl:RRT, rrt)"),
        lambda: make_guidance("ompl:RRT+rrt"),
    ],
)
def test_where_a_guiding_space_is_needed__planners_are_refused(use: Callable[[], object]) -> None:
    with pytest.raises(InvalidInputError, match="expected a guiding space"):
        use()


@pytest.mark.parametrize("name", [*planners.planner_names(), "RRT(resolution=0.01)", "RRTstar(first=false)"])
def test_trace__grows_the_same_tree_again(name: str, cup: Problem, tmp_path: Path) -> None:
    """Nodes that no sample added, and other parents, included; sampled motions are taken from the trace."""
    result = guided_search(cup, f"ompl:{name}", seed=0, max_samples=150, trace=tmp_path / "trace.jsonl")
    trace = read_trace(tmp_path / "trace.jsonl")
    tree = trace.replay().tree
    assert trace.trouble == ""
    assert len(trace) == result.samples
    assert np.array_equal(tree.configurations, result.tree.configurations)
    assert np.array_equal(tree.parents, result.tree.parents)
    assert np.array_equal(tree.contacts, result.tree.contacts)
    assert tree.cost_to_come == pytest.approx(result.tree.cost_to_come)
    joined = sum(len(gain.nodes) for _, gain in trace.gains)
    assert len(tree) == 1 + joined + sum(sample.contact is None for sample in trace.samples)
    assert sum(len(gain.parents) for _, gain in trace.gains) == result.tree.rewirings


def test_trace__with_a_gain_that_fits_nowhere_ends_there(cup: Problem, tmp_path: Path) -> None:
    file = tmp_path / "trace.jsonl"
    guided_search(cup, "ompl:RRTConnect", seed=0, max_samples=1000, trace=file)
    lines = file.read_text().splitlines(keepends=True)
    at = next(i for i, line in enumerate(lines) if line.startswith('{"also"'))
    for gain in ('{"also":[{"n":999,"x":[1,1,1]}]}', '{"also":[{"n":0,"x":[1,1]}]}', '{"also":7}',
                 '{"also":[],"w":[[0,999]]}', '{"also":[{"n":0,"x":[1,1,1],"t":"far"}]}'):  # fmt: skip
        file.write_text("".join([*lines[:at], gain + "\n", *lines[at + 1 :]]))
        trace = read_trace(file)
        assert f"line {at + 1} " in trace.trouble
        assert trace.end is None
    file.write_text("".join(lines).replace('"watched":"certified"', '"watched":null', 1))
    assert "no guided search adds" in read_trace(file).trouble
    file.write_text("".join(lines).replace('"watched":"certified"', '"watched":"hardly"', 1))
    with pytest.raises(StorageError, match="'watched'"):
        read_trace(file)


@pytest.mark.parametrize("option", [{"expansion": "uniform"}, {"distributions": True}])
def test_option_that_a_planner_cannot_have(option: dict[str, Any], cup: Problem) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(option))):
        guided_search(cup, "ompl:RRT", seed=0, **option)
