"""A long study goes on where it was, and its rows stand in the order of its cases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from recording.kept_rows import KeptRows

from uvms_ocp.campaign.study import Row, Study


def tell(case: dict[str, Any]) -> Row:
    with (Path(case["folder"]) / "ran").open("a") as file:
        file.write(f"{case['k']}\n")
    return {"k": case["k"], "square": case["k"] ** 2, "endless": float("inf")}


def study_of(folder: Path, n: int) -> Study:
    cases = [{"k": k, "folder": str(folder)} for k in range(n)]
    return Study(name="squares", title="squares", cases=cases, run_case=tell, summarize=lambda rows: rows)


def ran(folder: Path) -> list[int]:
    return sorted(int(line) for line in (folder / "ran").read_text().split())


def test_rows_stand_in_the_order_of_the_cases_and_are_run_once(tmp_path: Path) -> None:
    rows = KeptRows(tmp_path / "work", 2).run(study_of(tmp_path, 20), hours=1.0)
    assert [row["k"] for row in rows] == list(range(20))
    assert KeptRows(tmp_path / "work", 2).run(study_of(tmp_path, 20), hours=1.0) == rows
    assert ran(tmp_path) == list(range(20))


def test_without_time_there_are_the_rows_that_are_known(tmp_path: Path) -> None:
    KeptRows(tmp_path / "work", 1).run(study_of(tmp_path, 3), hours=1.0)
    rows = KeptRows(tmp_path / "work", 1).run(study_of(tmp_path, 9), hours=0.0)
    assert [row["k"] for row in rows] == [0, 1, 2]


def test_a_row_that_was_cut_short_is_run_again_and_no_other(tmp_path: Path) -> None:
    kept = KeptRows(tmp_path / "work", 1)
    whole = kept.run(study_of(tmp_path, 8), hours=1.0)
    file = tmp_path / "work" / "rows.jsonl"
    file.write_text(file.read_text()[:-15])
    for _ in range(2):
        assert kept.run(study_of(tmp_path, 8), hours=1.0) == whole
    assert len(ran(tmp_path)) == 9
