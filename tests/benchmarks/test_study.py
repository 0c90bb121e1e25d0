"""A study tells which cases made no row, and shows its table like any value."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from studies.study import Study, StudyResult
from studies.table2 import table2

from uvms_ocp.errors import InvalidInput, NameNotFound

EVIL = "<script>alert(1)</script>\x1b[31m"


def mistyped(name: str) -> dict[str, Any]:
    raise NameNotFound("robot", name, ["girona"])


@pytest.mark.slow
def test_a_study_in_processes_tells_the_mistake_of_a_case() -> None:
    study = Study(
        name="a", title="b", cases=("giorna", "nautilus"), run_case=mistyped, summarize=list
    )
    with pytest.raises(InvalidInput, match=r"2 of 2 cases .*unknown robot 'giorna'"):
        study.run(workers=2)


def test_a_study_and_its_result_are_shown_as_tables_of_80_columns_in_which_names_are_text() -> None:
    table = ({"floor": EVIL, "clearance_m": 0.12345},)
    for value in (table2(), StudyResult(name=EVIL, title=EVIL, cases=({},), table=table)):
        lines = repr(value).splitlines()
        assert 1 < len(lines) < 50
        assert max(map(len, lines)) <= 80
        assert all(line.isprintable() for line in lines)
        assert "<script" not in value._repr_html_()


def completed_without_passing(name: str) -> dict[str, Any]:
    return {"name": name, "end": "completed", "passed": False}


@pytest.mark.slow
def test_a_study_goes_on_where_it_was_after_cases_that_completed_and_did_not_pass(
    tmp_path: Path,
) -> None:
    """Their rows said that they had success and had none, and were refused."""
    study = Study(
        name="a",
        title="b",
        cases=("x", "y"),
        run_case=completed_without_passing,
        summarize=list,
    )
    first = study.run(tmp_path / "study")
    again = study.run(tmp_path / "study")
    assert [dict(row) for row in again.cases] == [dict(row) for row in first.cases]
