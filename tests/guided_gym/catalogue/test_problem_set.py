"""Problem sets: the problems and oracles that the distribution gives, from a file, for whoever asks."""

from __future__ import annotations

import copy
import json
import pickle
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from shapely import LineString

from guided_gym.catalogue.distributions import FixedProblem, ProblemList, SampledProblems
from guided_gym.catalogue.problem_set import ProblemSet, _robot, _robot_part, build_problem_set
from guided_gym.catalogue.table import make_distribution
from guided_gym.envs.guided_search_env import GuidedSearchEnv
from guided_gym.errors import InvalidInputError, NoPathError, StorageError
from guided_gym.geometry.environment import Environment
from guided_gym.geometry.linkages import Body, Joint, Linkage
from guided_gym.geometry.robots import Robot
from guided_gym.measure.oracle import Oracle, oracle_for
from guided_gym.problems import Problem, Task
from guided_gym.storage.record_file import RecordFile, RecordWriter

NAME = "RandomSimplePassage"
COUNT = 3


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sets") / "passages.problems"
    assert build_problem_set(path, NAME, COUNT).solved == COUNT
    return path


def rewritten(built: Path, path: Path, change) -> Path:
    """A copy of a set with other headers and records."""
    file = RecordFile(built, "problem set")
    header, records = change(dict(file.header), [file.record(i) for i in range(len(file))])
    with RecordWriter(path, "problem set", header) as writer:
        for key, record in enumerate(records):
            writer.add(key, record)
        writer.finish()
    return path


def test_problem_set__has_the_problems_of_the_seeds_and_their_oracles(built):
    problems, distribution = ProblemSet(built), make_distribution(NAME)
    assert problems.name == NAME and len(problems) == COUNT
    for seed in range(COUNT):
        theirs = distribution.problem(seed)
        solved = Oracle(theirs.space, theirs.task.goal, start=theirs.task.start)
        ours = problems.problem(seed)
        assert ours.fingerprint == theirs.fingerprint and ours.name == theirs.name
        assert ours.regions == dict(theirs.regions)
        for one, other in zip(ours.space.geometry, theirs.space.geometry, strict=True):
            assert np.array_equal(one, other)
        poses = theirs.space.sample(np.random.default_rng(seed), 500)
        stored = oracle_for(ours.space, ours.task.goal, start=ours.task.start)
        assert np.array_equal(stored.cost_to_go(poses), solved.cost_to_go(poses))
        assert stored.error == solved.error and stored.resolution == solved.resolution
    assert problems.problem(COUNT).fingerprint == problems.problem(0).fingerprint  # modulo their number


def test_problem_set__environments_do_as_without_it(built):
    alone = gymnasium.make(f"guided_gym/{NAME}-v0", max_samples=30).unwrapped
    over = gymnasium.make(f"guided_gym/{NAME}-v0", max_samples=30, problems=str(built)).unwrapped
    for seed in (1, 0):
        first, again = alone.reset(seed=seed), over.reset(seed=seed)
        assert all(np.array_equal(first[0][key], again[0][key]) for key in first[0])
        for node in [0] * 10:
            ours, theirs = over.step(node), alone.step(node)
            assert ours[1:4] == theirs[1:4]
            assert all(np.array_equal(ours[0][key], theirs[0][key]) for key in ours[0])
    over.reset()
    assert over.problem.fingerprint in {ProblemSet(built)[i].fingerprint for i in range(COUNT)}


def test_problem_set__native_vectors_and_guide_selection_take_it(built):
    options = {"max_samples": 20, "problems": str(built)}
    envs = gymnasium.make_vec(f"guided_gym/{NAME}-v0", num_envs=4, **options)
    observation, _ = envs.reset(seed=[0, 1, 2, 0])
    env = gymnasium.make(f"guided_gym/{NAME}-v0", **options)
    assert np.array_equal(observation["raster"][1], env.reset(seed=1)[0]["raster"])
    for _ in range(25):
        envs.step(np.zeros(4, np.int64))
    name = "guided_gym/RandomGuideSelection-v0"
    selection = gymnasium.make(name, distribution=NAME, max_samples=5, problems=str(built))
    selection.reset(seed=2)
    assert selection.unwrapped.problem.fingerprint == ProblemSet(built)[2].fingerprint


def test_problem_set__copies_are_itself_and_other_processes_open_the_file(built):
    problems = ProblemSet(built)
    assert copy.deepcopy(problems) is problems
    sent = pickle.dumps(problems)
    assert len(sent) < 1000 and pickle.loads(sent)[1].fingerprint == problems[1].fingerprint


def test_build__goes_on_grows_and_gives_the_same_whoever_builds(built, tmp_path):
    path = tmp_path / "other.problems"

    def stop(done: int, total: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        build_problem_set(path, NAME, 2, progress=stop)
    with pytest.raises(StorageError, match="finished problem set"):
        ProblemSet(path)
    assert build_problem_set(path, NAME, 2).solved == 1
    assert build_problem_set(path, NAME, COUNT).solved == 1
    assert build_problem_set(path, NAME, 1) == build_problem_set(path, NAME, COUNT)  # nothing is taken away
    assert path.read_bytes() == built.read_bytes()


def test_build__refuses_a_file_of_other_problems(built, tmp_path):
    for options in ({"first": 1}, {"goal_tolerance": 0.5}, {"distribution": "RandomTrapCup"}):
        with pytest.raises(InvalidInputError, match="choose another file"):
            build_problem_set(**{"path": built, "distribution": NAME, "count": COUNT, **options})
    for count in (0, -1, 1.5, True):
        with pytest.raises(InvalidInputError, match="count"):
            build_problem_set(tmp_path / "none", NAME, count)
    assert not (tmp_path / "none").exists()


def test_environment__refuses_a_set_of_other_problems(built, tmp_path):
    with pytest.raises(InvalidInputError, match=f"expected problems of RandomTrapCup, got a set of {NAME}"):
        GuidedSearchEnv("RandomTrapCup", problems=built)
    with pytest.raises(InvalidInputError, match=r"goal_tolerance=0\.5"):
        GuidedSearchEnv(NAME, problems=built, goal_tolerance=0.5)
    with pytest.raises(InvalidInputError, match=f"{NAME}@train"):
        GuidedSearchEnv(NAME, split="train", problems=built)
    with pytest.raises(InvalidInputError, match="problems: expected the name"):
        GuidedSearchEnv(NAME, problems=3)
    with pytest.raises(StorageError, match="no such file"):
        GuidedSearchEnv(NAME, problems=tmp_path / "none")

    def another_robot(header, records):
        return {**header, "robot": {**header["robot"], "dimension": 2}}, records

    with pytest.raises(InvalidInputError, match="robot"):
        GuidedSearchEnv(NAME, problems=rewritten(built, tmp_path / "robot", another_robot))


def test_environment__refuses_a_set_that_is_truncated_damaged_or_of_another_version(built, tmp_path):
    content = built.read_bytes()
    version = bytearray(content)
    version[24] += 1  # right behind the file's first words
    for number, (part, message) in enumerate(
        (
            (content[:-1], "expected a finished problem set, got one that was stopped, or truncated"),
            (content[:17_000], "expected a finished problem set"),
            (content[:10_000], "header of this problem set is damaged"),
            (content[:3], "got a file of another kind"),
            (bytes(version), "from another version of guided-gym"),
        )
    ):
        path = tmp_path / f"set-{number}"
        path.write_bytes(part)
        with pytest.raises(StorageError, match=message):
            gymnasium.make(f"guided_gym/{NAME}-v0", problems=path)
        with pytest.raises(StorageError, match=message):
            gymnasium.make_vec(f"guided_gym/{NAME}-v0", num_envs=2, problems=path)


def test_problem_set__refuses_an_oracle_that_does_not_fit(built, tmp_path):
    def swapped(header, records):
        (one, a), (two, _) = records[:2]
        return header, [records[0], records[1]._replace(meta={**two, "problem": one["problem"]}, arrays=a)]

    with pytest.raises(StorageError, match="problem 1: expected the problem that the oracle was solved for"):
        ProblemSet(rewritten(built, tmp_path / "swapped", swapped))[1]

    def changed(**part):
        def change(header, records):
            meta, arrays = records[0]
            arrays = {**arrays, "oracle.field": arrays["oracle.field"][: part.pop("size", None)]}
            oracle = meta["oracle"]
            inner = {**oracle["meta"], **part.pop("inner", {})}
            changed = {**meta, "oracle": {**oracle, "meta": inner, **part}}
            return header, [records[0]._replace(meta=changed, arrays=arrays)]

        return change

    for number, (part, message) in enumerate(
        (
            ({"size": -1}, "expected a field of"),
            ({"inner": {"version": 2}}, "another version of guided-gym"),
            ({"inner": {"resolution": [8, 8]}}, "a grid of 3 axes"),
            ({"inner": {"resolution": [8, 8, 8]}}, "expected a field of"),
            ({"inner": {"resolution": "x"}}, "got something else"),
            ({"kind": "crystal ball"}, "grid or roadmap"),
        )
    ):
        with pytest.raises(StorageError, match=message):
            ProblemSet(rewritten(built, tmp_path / f"changed-{number}", changed(**part)))[0]


class Halves(ProblemList):
    """A problem with a path, and one without."""

    name = "Halves"

    def __len__(self) -> int:
        return 2

    def __getitem__(self, index: int) -> Problem:
        walls = [[(4, 0), (6, 0), (6, 10 if index else 4), (4, 10 if index else 4)]]
        environment = Environment.from_polygons((0, 0, 10, 10), walls)
        return Problem(Robot.point(), environment, Task((1, 1), (9, 1)), f"half-{index}")


def test_problem_set__a_problem_without_a_path_stays_without(tmp_path):
    report = build_problem_set(tmp_path / "halves", Halves(), 2)
    assert report.without_path == 1
    problems = ProblemSet(tmp_path / "halves")
    assert problems.problem(0).name == "half-0"
    with pytest.raises(NoPathError):
        problems.problem(1)
    assert {problems.draw(np.random.default_rng(k)).name for k in range(4)} == {"half-0"}


def test_problem_set__robots_may_differ_and_one_problem_is_a_set(tmp_path):
    def draw(rng: np.random.Generator) -> Problem:
        wall = [[(4, 0), (6, 0), (6, 4), (4, 4)]]
        robot = Robot.rectangle(1.0, float(rng.uniform(0.1, 0.5)))
        return Problem(robot, Environment.from_polygons((0, 0, 10, 10), wall), Task((1, 1, 0), (9, 1, 0)))

    several = SampledProblems("Several", draw)
    build_problem_set(tmp_path / "several", several, 2)
    problems = ProblemSet(tmp_path / "several")
    assert problems.header["robot"] is None
    assert problems[0].robot != problems[1].robot
    GuidedSearchEnv(several, problems=tmp_path / "several").reset(seed=1)
    build_problem_set(tmp_path / "one", FixedProblem(problems[0]), 1)
    assert ProblemSet(tmp_path / "one")[0].fingerprint == problems[0].fingerprint


def test_problem_set__says_of_a_robot_with_joints_all_that_it_is():
    joints = (Joint((1.0, 5.0), limits=(-2.5, 2.5)), Joint((1.5, 0.0), parent=0, heading=0.3))
    bodies = tuple(Body(k, LineString([(0, 0), (1.5, 0)])) for k in range(2))
    for options in ({}, {"mobile": True, "self_collision": True}):
        arm = Linkage(joints, bodies, (1, (1.5, 0.0)), name="arm", **options)
        again = _robot(json.dumps(_robot_part(arm)))
        assert again == arm and again.name == arm.name and again.joints == arm.joints
