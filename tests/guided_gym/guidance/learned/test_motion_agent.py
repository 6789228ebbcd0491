"""Agents for robots without a grid: belief in motions, cost-to-go, and the guidance that they make."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from guided_gym.catalogue.table import make_distribution
from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.robots import Robot
from guided_gym.geometry.space import ConfigurationSpace
from guided_gym.guidance.composed import Composed
from guided_gym.guidance.learned import weights
from guided_gym.guidance.learned.belief import BeliefArchitecture, BeliefModel, plain_tensors, scene_of
from guided_gym.guidance.learned.folders import agent_folder
from guided_gym.guidance.learned.motion_agent import MotionAgent, load_motion_agent
from guided_gym.guidance.learned.motion_guidance import LESSON, MotionGuidance
from guided_gym.guidance.modifications import Predicted
from guided_gym.guidance.registry import make_guidance
from guided_gym.guidance.solvers.roadmap import Roadmap
from guided_gym.kernels.belief import motion_columns, parts_of, rooms_along
from guided_gym.planning import guided_search
from guided_gym.problems import Problem
from guided_gym.search.search import NO_NODE

AGENT = "planar-arm-4"


@pytest.fixture(scope="module")
def problem() -> Problem:
    return make_distribution("RandomPlanarArm4@validation").problem(1)


def test_room_is_the_distance_of_the_bodies_to_what_is_around_them(problem: Problem) -> None:
    space, architecture = problem.space, BeliefArchitecture(cells=64, unit=4.0)
    scene = scene_of(space, architecture)
    q = space.sample(np.random.default_rng(0), 200)
    rooms = rooms_along(q, q, 1, scene, space.metric)[:, 0, :-1].min(axis=1) * scene.unit
    alone = ConfigurationSpace(space.robot, Environment(space.environment.bounds))
    clear = np.asarray(space.clearance(q))
    some = np.asarray(space.valid(q)) & (np.asarray(alone.clearance(q)) > clear)
    assert some.sum() > 50
    # Points along the middle of a link, half its width apart, and a raster of a few hundredths.
    assert np.abs(rooms - clear)[some].max() < 0.15


def test_an_untaught_belief_tells_free_from_blocked_configurations(problem: Problem) -> None:
    space, architecture = problem.space, BeliefArchitecture()
    belief = BeliefModel(architecture, plain_tensors(architecture)).on(space)
    q = space.sample(np.random.default_rng(0), 500)
    p = belief.motions(q, q)
    assert ((p > 0.5) == np.asarray(space.valid(q))).mean() > 0.97
    assert belief.looks == 500


def test_the_shipped_belief_is_calibrated_on_motions_of_unseen_problems() -> None:
    rng, p, free = np.random.default_rng(0), [], []
    model = load_motion_agent(AGENT).belief
    for number in range(4):
        space = make_distribution("RandomPlanarArm4@validation").problem(number).space
        starts, ends = space.sample(rng, 400), space.sample(rng, 400)
        ends = space.interpolate(starts, ends, rng.uniform(0.02, 0.3, 400))
        p.append(model.on(space).motions(starts, ends))
        free.append(np.asarray(space.motions_free(starts, ends)))
    chances, found = np.concatenate(p), np.concatenate(free)
    assert 0.2 < found.mean() < 0.8
    assert ((chances > 0.5) == found).mean() > 0.97
    assert abs(chances.mean() - found.mean()) < 0.02


def test_a_motion_is_looked_at_closely_and_not_beyond_where_it_is_hopeless(problem: Problem) -> None:
    space, model = problem.space, load_motion_agent(AGENT).belief
    starts, ends = problem.task.start[None], problem.task.goal[None]
    spacing = scene_of(space, model.architecture).spacing
    assert parts_of(starts[0], ends[0], spacing, space.metric) == np.ceil(
        space.distance(starts[0], ends[0]) / spacing
    )
    whole, cut = model.on(space), model.on(space)
    p, q = whole.motions(starts, ends), cut.motions(starts, ends, 0.1)
    assert p[0] < 0.1
    assert q[0] < 0.1
    assert cut.looks < whole.looks


def test_columns_of_a_motion_are_those_of_its_parts(problem: Problem) -> None:
    space, scene = problem.space, scene_of(problem.space, BeliefArchitecture())
    a, b = problem.task.start[None], problem.task.goal[None]
    columns, owner = motion_columns(a, b, scene, space.metric)
    parts = parts_of(a[0], b[0], scene.spacing, space.metric)
    assert len(columns) == len(owner) == parts * (len(space.robot.bodies) + 1)  # type: ignore[attr-defined]
    assert (columns[:, 0] <= columns[:, 1]).all()  # less room, more room
    assert set(np.unique(columns[:, 3])) == {0.0, 1.0}


def test_it_solves_and_counts_what_it_looks_at(problem: Problem) -> None:
    result = guided_search(problem, f"learned:{AGENT}", seed=0, max_samples=300, measure=False)
    assert result.solved
    assert result.looks > 8000  # each vertex of the roadmap at least
    assert result.looks <= result.collision_checks


def test_where_nothing_is_believed_in_few_roadmaps_are_asked_about(problem: Problem) -> None:
    architecture = BeliefArchitecture(hidden=1)
    never = {name: np.zeros(shape, np.float32) for name, shape in architecture.shapes().items()}
    never["last.bias"] -= 9.0
    roadmap, predicted = Roadmap(vertices=300), Predicted(BeliefModel(architecture, never))
    guidance = Composed(roadmap, environment=predicted, lesson=LESSON, candidates=2)
    result = guided_search(problem, guidance, seed=0, max_samples=30, measure=False)
    assert len(roadmap.graph.points) == 301  # as many as the first had, and the goal
    assert result.looks < 5 * 301 + 30 * 40  # of each vertex of four roadmaps, and of the motions tried


def _doubtful() -> MotionAgent:
    """An agent that believes in no motion."""
    agent, architecture = load_motion_agent(AGENT), BeliefArchitecture(hidden=1)
    never = {name: np.zeros(shape, np.float32) for name, shape in architecture.shapes().items()}
    never["last.bias"] -= 9.0
    return MotionAgent(agent.card, BeliefModel(architecture, never), agent._estimate, agent.scorer)


@pytest.mark.parametrize("scored", [False, True])
def test_where_nothing_is_believed_in_a_checked_roadmap_guides_and_is_counted(
    problem: Problem, scored: bool
) -> None:
    options = {"scored": scored, "vertices": 300, "candidates": 8}
    agent = _doubtful()
    checked = MotionGuidance(agent, checked=1500, **options)
    result = guided_search(problem, checked, seed=0, max_samples=200, measure=False)
    assert result.solved
    assert result.looks > 1500 * 13
    without = MotionGuidance(agent, checked=0, **options)
    other = guided_search(problem, without, seed=0, max_samples=200, measure=False)
    assert other.samples > 2 * result.samples
    again = guided_search(problem, checked, seed=0, max_samples=200, measure=False)
    assert np.array_equal(again.tree.configurations, result.tree.configurations)


def _credulous() -> MotionAgent:
    """An agent that holds every motion to be free."""
    agent, architecture = load_motion_agent(AGENT), BeliefArchitecture(hidden=1)
    always = {name: np.zeros(shape, np.float32) for name, shape in architecture.shapes().items()}
    always["last.bias"] += 9.0
    return MotionAgent(agent.card, BeliefModel(architecture, always), agent._estimate, agent.scorer)


@pytest.mark.parametrize("shortened", [False, True])
def test_after_some_failures_ways_are_checked_and_counted(problem: Problem, shortened: bool) -> None:
    options = {"vertices": 2000, "shortened": shortened}
    found = {
        trust: guided_search(
            problem,
            MotionGuidance(_credulous(), trust=trust, **options),
            seed=0,
            max_samples=300,
            measure=False,
        )
        for trust in (0, 3, None)
    }
    failures = {trust: int((r.record.child == NO_NODE).sum()) for trust, r in found.items()}
    assert found[0].solved and found[3].solved
    assert failures[0] < 0.5 * failures[None]
    assert 3 <= failures[3] < 0.5 * failures[None]
    for result in found.values():
        assert result.looks <= result.collision_checks


def test_checks_refute_what_is_not_free_and_count_as_looks(problem: Problem) -> None:
    space, expected = problem.space, Predicted(AGENT).doubts(problem.space)
    rng = np.random.default_rng(0)
    starts, ends = space.sample(rng, 60), space.sample(rng, 60)
    assert not expected.checking
    assert not expected.refuted(starts, ends).any()
    assert expected.looks == 0
    expected.check_in(space)
    assert expected.checking
    assert np.array_equal(expected.refuted(starts, ends), ~np.asarray(space.motions_free(starts, ends)))
    assert expected.looks == 60


def test_a_checked_roadmap_is_not_drawn_where_the_belief_sees_a_way(problem: Problem) -> None:
    both, bare = MotionGuidance(AGENT), MotionGuidance(AGENT, checked=0)
    first, second = (guided_search(problem, g, seed=0, max_samples=300, measure=False) for g in (both, bare))
    assert np.array_equal(first.tree.configurations, second.tree.configurations)
    assert first.looks == second.looks


def test_the_same_seed_gives_the_same_tree(problem: Problem) -> None:
    first, second = (guided_search(problem, f"learned:{AGENT}", seed=3, measure=False) for _ in range(2))
    assert np.array_equal(first.tree.configurations, second.tree.configurations)


def test_parts_stand_alone_and_together(problem: Problem) -> None:
    for text in (
        f"roadmap(environment=predicted({AGENT}),vertices=2000,check=0.0)",
        f"learned:{AGENT}@sees=belief@scored=False",
        f"learned:{AGENT}@sees=estimate@scored=False",
        f"learned:{AGENT}@sees=estimate",
    ):
        guidance = make_guidance(text)
        assert isinstance(guidance, Composed)
        result = guided_search(problem, guidance, seed=0, max_samples=40, measure=False)
        assert result.looks > 0


def test_the_cost_to_go_is_no_less_than_the_straight_line(problem: Problem) -> None:
    space = problem.space
    q = space.sample(np.random.default_rng(0), 50)
    estimate = load_motion_agent(AGENT).estimate(space)
    costs = estimate.costs(q, problem.task.goal)
    assert (costs >= np.asarray(space.distance(q, problem.task.goal))).all()
    assert estimate.costs(problem.task.goal[None], problem.task.goal)[0] == 0.0


def test_a_solver_that_does_not_ask_is_refused(problem: Problem) -> None:
    with pytest.raises(InvalidInputError, match="such as roadmap"):
        guided_search(problem, f"straight(environment=predicted({AGENT}))", measure=False)
    with pytest.raises(InvalidInputError, match="plane of 2"):
        guided_search(problem, f"roadmap(environment=predicted({AGENT}),robot=subset(2))", measure=False)


@pytest.mark.parametrize("robot", ["inner", "point", "links(3)"])
def test_a_belief_is_of_the_modified_robot(problem: Problem, robot: str) -> None:
    text = f"roadmap(environment=predicted({AGENT}),robot={robot},vertices=500)"
    result = guided_search(problem, text, seed=0, max_samples=30, measure=False)
    assert result.looks > 400


def test_the_cost_to_go_of_another_robot_is_refused() -> None:
    other = make_distribution("RandomPlanarArm7@validation").problem(0)
    with pytest.raises(InvalidInputError, match="robot that it was trained for"):
        guided_search(other, f"learned:{AGENT}@sees=estimate", measure=False)


def test_what_it_sees_is_one_of_three() -> None:
    with pytest.raises(InvalidInputError, match="belief, estimate, both"):
        make_guidance(f"learned:{AGENT}@sees=everything")


def test_a_belief_serves_rigid_robots_too() -> None:
    robot = Robot.rectangle(1.0, 0.4)
    space = ConfigurationSpace(
        robot, Environment.from_polygons((0, 0, 10, 10), [[(4, 0), (5, 0), (5, 8), (4, 8)]])
    )
    q = space.sample(np.random.default_rng(0), 400)
    p = Predicted(AGENT).doubts(space).likely(q, q)
    assert ((p > 0.5) == np.asarray(space.valid(q))).mean() > 0.95


def test_other_agents_are_no_motion_agents() -> None:
    with pytest.raises(StorageError, match="expected the card of a"):
        make_guidance("roadmap(environment=predicted(se2))")


@pytest.mark.parametrize("part", ["belief", "estimate", "scorer"])
def test_a_card_of_other_sizes_is_refused(tmp_path: Path, part: str) -> None:
    folder = tmp_path / "agent"
    shutil.copytree(agent_folder(AGENT), folder)
    file = folder / weights.CARD_FILE
    card = json.loads(file.read_text())
    card[part]["hidden"] += 1
    file.write_text(json.dumps(card))
    with pytest.raises(StorageError):
        MotionAgent.load(folder)
    card[part] = {"sizes": 3}
    file.write_text(json.dumps(card))
    with pytest.raises(StorageError, match="card: expected the sizes"):
        MotionAgent.load(folder)
