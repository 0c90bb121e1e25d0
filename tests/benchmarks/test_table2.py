"""Table 2: cells, verdicts and what they are derived from."""

from __future__ import annotations

from pathlib import Path

import pytest
from compiler import long_without_compiler
from recording.rows import column, rows_where
from studies.study import StudyResult
from studies.table2 import FLOORS, PAPER, THRESHOLDS, run_transit, table2, verdict

pytestmark = [
    pytest.mark.filterwarnings(
        "ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::FutureWarning"
    ),
    pytest.mark.slow,
]


@pytest.fixture(scope="module")
def result() -> StudyResult:
    return table2(seeds=1, seed=1, length=15.0).run()


@long_without_compiler
def test_every_cell_of_the_paper_is_measured(result: StudyResult) -> None:
    assert len(result.table) == len(FLOORS) * len(THRESHOLDS) == len(PAPER)
    assert all(row["completed"] for row in result.cases)


@long_without_compiler
def test_an_almost_flat_floor_is_safe_at_every_threshold(result: StudyResult) -> None:
    flat = rows_where(result.table, "floor", "almost flat")
    assert column(flat, "verdict") == column(flat, "paper") == ["safe"] * 3


@long_without_compiler
def test_a_higher_threshold_never_comes_nearer_to_the_floor(result: StudyResult) -> None:
    for floor in FLOORS.values():
        cells = column(rows_where(result.table, "floor", floor), "smallest_clearance_m")
        assert cells == sorted(cells)


def test_the_dynamic_plant_keeps_the_same_clearance() -> None:
    case = {"floor": "small", "threshold_m": 1.0, "seed": 1, "length_m": 10.0}
    kinematic = run_transit({**case, "plant": "kinematic"})["clearance_m"]
    dynamic = run_transit({**case, "plant": "dynamic"})["clearance_m"]
    assert dynamic == pytest.approx(kinematic, abs=0.01)


@pytest.mark.parametrize(
    ("clearances", "words"),
    [
        ([1.0, 2.0], "safe"),
        ([1.0, 0.3], "not always safe"),
        ([0.2, 0.3], "not completely safe"),
        ([1.0, -0.1], "not safe"),
    ],
)
def test_the_words_follow_from_the_clearances(clearances: list[float], words: str) -> None:
    assert verdict(clearances) == words


@long_without_compiler
def test_a_study_writes_one_line_per_run(result: StudyResult, tmp_path: Path) -> None:
    result.write_csv(tmp_path / "runs.csv")
    lines = (tmp_path / "runs.csv").read_text().splitlines()
    assert len(lines) == 1 + len(result.cases)
    assert lines[0].startswith("floor,threshold_m,seed")
