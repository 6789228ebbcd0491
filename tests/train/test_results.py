"""The results file: what goes in comes out, twice is once, and damage is refused."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from guided_gym.errors import InvalidInputError, StorageError
from guided_gym.train.results import RESULTS_FILE, Results, ResultsFile, Run, grid_cells, grid_shape

MakeRun = Callable[..., Run]


def test_file__gives_back_what_was_added(tmp_path: Path, make_run: MakeRun) -> None:
    run = make_run(samples=3, curve=np.array([0.5, 1.0, 0.25], np.float32), regions={"a": (1.5, 2)})
    unsolved = make_run(seed=1, solved=False)
    with ResultsFile.in_folder(tmp_path / "new" / "folder") as file:
        file.add([unsolved, run])
    with ResultsFile(tmp_path / "new" / "folder" / RESULTS_FILE) as file:
        stored = file.runs("Cup", "rrt", "s", [0, 1, 2])
    assert [found.seed for found in stored] == [0, 1]
    np.testing.assert_array_equal(stored[0].curve, run.curve)
    assert stored[0].regions == {"a": (1.5, 2)}
    assert stored[0].solved and not stored[1].solved
    assert math.isnan(stored[1].path_cost)
    assert stored[0].efficiency_per_sample == pytest.approx(run.total_efficiency / 3)


def test_file__takes_minus_zero(make_run: MakeRun) -> None:
    with ResultsFile(None) as file:
        file.add([make_run(entropy=-0.0, total_efficiency=-0.0, processor=-0.0)])
        assert file.runs("Cup", "rrt", "s", [0])[0].entropy == 0.0


def test_file__keeps_the_first_of_two_equal_keys(make_run: MakeRun) -> None:
    with ResultsFile(None) as file:
        file.add([make_run(seconds=1.0)])
        file.add([make_run(seconds=2.0), make_run(seed=5, settings="other")])
        assert [run.seconds for run in file.runs("Cup", "rrt", "s", [0])] == [1.0]
        assert file.seeds("Cup", "rrt", "s") == {0}
        assert file.seeds("Cup", "rrt", "other") == {5}


def test_file__two_writers_at_once(tmp_path: Path, make_run: MakeRun) -> None:
    with ResultsFile.in_folder(tmp_path) as one, ResultsFile.in_folder(tmp_path) as two:
        one.add([make_run(seed=0)])
        two.add([make_run(seed=0), make_run(seed=1)])
        one.add([make_run(seed=2)])
        assert one.seeds("Cup", "rrt", "s") == two.seeds("Cup", "rrt", "s") == {0, 1, 2}


@pytest.mark.parametrize("content", [b"hello, this is no database at all", b"SQLite format 3\x00 or so"])
def test_file__foreign_or_corrupt(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / RESULTS_FILE
    path.write_bytes(content)
    with pytest.raises(StorageError, match=r"expected a .*results file"):
        ResultsFile.in_folder(tmp_path)
    assert path.read_bytes() == content


def test_file__another_programs_database(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / RESULTS_FILE) as connection:
        connection.execute("CREATE TABLE theirs (x)")
    connection.close()
    with pytest.raises(StorageError, match="another program's"):
        ResultsFile.in_folder(tmp_path)


def test_file__damaged_row(tmp_path: Path, make_run: MakeRun) -> None:
    with ResultsFile.in_folder(tmp_path) as file:
        file.add([make_run()])
    with sqlite3.connect(tmp_path / RESULTS_FILE) as connection:
        connection.execute("UPDATE runs SET total_efficiency = 0")
    connection.close()
    with ResultsFile.in_folder(tmp_path) as file, pytest.raises(StorageError, match="checksum"):
        file.runs("Cup", "rrt", "s", [0])


def test_file__a_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(StorageError, match="expected a folder"):
        ResultsFile.in_folder(tmp_path / "taken")


def test_results__curves_are_zero_after_the_end(make_run: MakeRun) -> None:
    results = Results((make_run(samples=2), make_run(seed=1, samples=4)), max_samples=5)
    np.testing.assert_array_equal(results.curves("Cup", "rrt"), [[2, 2, 0, 0, 0], [2, 2, 2, 2, 0]])
    assert results.values("Cup", "rrt", "total_efficiency").tolist() == [4.0, 8.0]


def test_results__regions_that_a_run_lacks_count_zero(make_run: MakeRun) -> None:
    runs = (make_run(regions={"a": (1.0, 1)}), make_run(seed=1, regions={"a": (2.0, 1), "b": (3.0, 1)}))
    by_region = Results(runs, 5).by_region("Cup", "rrt")
    assert {name: sums.tolist() for name, sums in by_region.items()} == {"a": [1.0, 2.0], "b": [0.0, 3.0]}


def test_results__say_who_is_still_searching_and_who_is_done(make_run: MakeRun) -> None:
    runs = (make_run(samples=2), make_run(seed=1, samples=4, solved=False))
    results = Results(runs, max_samples=4)
    np.testing.assert_array_equal(results.survivors("Cup", "rrt"), [[2, 2, np.nan, np.nan], [2, 2, 2, 2]])
    solved = results.solved_after("Cup", "rrt")
    assert solved.tolist() == [[False, False, True, True, True], [False] * 5]


def test_run__path_over_the_optimum(make_run: MakeRun) -> None:
    assert make_run(path_cost=10.0, optimum=8.0).path_ratio == 1.25
    assert math.isnan(make_run(solved=False).path_ratio)
    assert make_run(path_cost=0.0, optimum=0.0).path_ratio == 1.0


def test_grid__cells_are_square_and_the_edge_takes_what_lies_outside() -> None:
    bounds = (0.0, 0.0, 48.0, 24.0)
    assert grid_shape(bounds) == (12, 24)
    at = np.array([[0.0, 0.0], [47.9, 0.1], [0.1, 2.1], [48.0, 24.0], [-5.0, 99.0]])
    assert grid_cells(at, bounds).tolist() == [0, 23, 24, 287, 264]


def test_results__by_cell_add_up(make_run: MakeRun) -> None:
    cells, curve = np.array([0, 3, 3], np.uint16), np.array([1, 2, 4], np.float32)
    run = make_run(samples=3, cells=cells, curve=curve, best=np.array([1, 1, 1], np.float32))
    other = make_run(seed=1, samples=0)
    total, excess = Results((run, other), 5).by_cell("Cup", "rrt", (2, 2))
    assert total.tolist() == [[0.5, 0.0], [0.0, 3.0]]
    assert excess.tolist() == [[0.0, 0.0], [0.0, 2.0]]


def test_file__of_an_older_version_says_what_to_do(tmp_path: Path, make_run: MakeRun) -> None:
    with ResultsFile.in_folder(tmp_path) as file:
        file.add([make_run()])
    with sqlite3.connect(tmp_path / RESULTS_FILE) as connection:
        connection.execute("PRAGMA user_version = 1")
    connection.close()
    with pytest.raises(StorageError, match=r"version 4 .* got version 1; .* choose another folder"):
        ResultsFile.in_folder(tmp_path)


def test_file__keeps_what_was_left_out(tmp_path: Path) -> None:
    with ResultsFile.in_folder(tmp_path) as file:
        file.skip([("Cup", "rrt", 3, "s", "no path"), ("Cup", "rrt", 3, "s", "again")])
        assert file.skipped("Cup", "rrt", "s") == {3: "no path"}
        assert file.seeds("Cup", "rrt", "s") == {3}
        assert file.skipped("Cup", "rrt", "other") == {}


def test_results__unknown_group(make_run: MakeRun) -> None:
    with pytest.raises(InvalidInputError, match="no results of 'oracle'"):
        Results((make_run(),), 5).values("Cup", "oracle", "samples")


def test_run__of_no_samples_costs_nothing(make_run: MakeRun) -> None:
    run = make_run(samples=0)
    assert run.efficiency_per_sample == 0.0
