"""A long study goes on where it was, and its rows stand in the order of its cases."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording.kept_rows import kept_rows, spread_out
from studies.study import Study

from uvms_ocp.campaign.jobs import Row

pytestmark = pytest.mark.filterwarnings(
    "ignore::DeprecationWarning", "ignore::ResourceWarning", "ignore::FutureWarning"
)


def tell(case: dict[str, Any]) -> Row:
    with (Path(case["folder"]) / "ran").open("a") as file:
        file.write(f"{case['k']}\n")
    return {"k": case["k"], "square": case["k"] ** 2, "endless": float("inf")}


def study_of(folder: Path, n: int) -> Study:
    cases = [{"k": k, "folder": str(folder)} for k in range(n)]
    return Study(
        name="squares", title="squares", cases=cases, run_case=tell, summarize=lambda rows: rows
    )


def ran(folder: Path) -> list[int]:
    return sorted(int(line) for line in (folder / "ran").read_text().split())


def test_rows_stand_in_the_order_of_the_cases_and_are_run_once(tmp_path: Path) -> None:
    rows = kept_rows(study_of(tmp_path, 20), tmp_path / "work", 2, hours=1.0)
    assert [row["k"] for row in rows] == list(range(20))
    assert kept_rows(study_of(tmp_path, 20), tmp_path / "work", 2, hours=1.0) == rows
    assert ran(tmp_path) == list(range(20))


def test_without_time_no_case_is_begun(tmp_path: Path) -> None:
    assert kept_rows(study_of(tmp_path, 9), tmp_path / "work", 1, hours=0.0) == []
    assert not (tmp_path / "ran").exists()


def test_any_beginning_of_a_study_is_a_fair_share() -> None:
    order = spread_out(range(70))
    assert sorted(order) == list(range(70))
    assert max(np.diff(sorted(order[:7]))) <= 11
