"""``plan mission`` writes a plan, ``run --follow`` flies it, and neither takes what does not
fit.
"""

from __future__ import annotations

import json
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from command_line import called


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> tuple[CompletedProcess[str], Path]:
    folder = tmp_path_factory.mktemp("mission")
    return called(
        "plan", "mission", "reach", "--step", "1", "--out", "plan", "--json", cwd=folder
    ), folder


@pytest.mark.slow
def test_a_mission_is_planned_and_told(planned: tuple[CompletedProcess[str], Path]) -> None:
    process, folder = planned
    assert process.returncode == 0, process.stderr
    report = json.loads(process.stdout)
    assert report["status"] == "solved"
    assert [phase["name"] for phase in report["phases"]] == ["A", "B"]
    assert json.loads((folder / "plan" / "report.json").read_text()) == report
    assert "thrust up to" in process.stderr


@pytest.mark.slow
def test_a_plan_is_flown_from_its_folder(planned: tuple[CompletedProcess[str], Path]) -> None:
    process = called("run", "reach", "--follow", "plan", "--out", "run", "--json", cwd=planned[1])
    assert process.returncode == 0, process.stderr
    report = json.loads(process.stdout)
    assert report["completed"]
    assert report["alarms"] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("run", "reach", "--seed", "5", "--follow", "plan"), "another mission than reach"),
        (
            ("run", "case1", "--follow", "plan/report.json"),
            "give the plan.npz that `plan mission` wrote",
        ),
        (("plan", "mission", "nothing"), "unknown scenario"),
        (("plan", "mission", "transit"), "the floor rises"),
        (("plan", "mission", "reach", "--nlp", "none"), "unknown NLP solver"),
        (("plan", "mission", "reach", "--within", "-1"), "duration"),
    ],
    ids=" ".join,
)
def test_what_does_not_fit_is_refused_in_one_line(
    planned: tuple[CompletedProcess[str], Path], words: tuple[str, ...], text: str
) -> None:
    process = called(*words, cwd=planned[1])
    assert process.returncode == 2
    (line,) = process.stderr.strip().splitlines()
    assert line.startswith("error: ")
    assert text in line


@pytest.mark.slow
def test_a_plan_that_is_not_found_in_time_is_told_and_not_written(tmp_path: Path) -> None:
    process = called(
        "plan", "mission", "reach", "--time-limit", "0.001", "--out", "plan", "--json", cwd=tmp_path
    )
    assert process.returncode == 3
    assert json.loads(process.stdout)["status"] == "unfinished"
    assert not (tmp_path / "plan" / "plan.npz").exists()
