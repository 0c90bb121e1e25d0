"""A newcomer's path through the command line: templates, check, campaign, report, one run again,
comparison.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from uvms_ocp.campaign.store import read_table
from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput, NameNotFound, UvmsError

pytestmark = pytest.mark.slow

QUICK = ("--plant", "kinematic", "--duration", "0.3", "--force")
KINEMATIC = """
from uvms_ocp.campaign import Normal, Variation

variations = [Variation("start.x", Normal(0.0, 0.1)), Variation("goals.TP.z", Normal(0.0, 0.05))]
"""


def ours(*words: str) -> str:
    """What a command prints; its errors are raised."""
    result = CliRunner().invoke(app, words, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a robot, a mission and a campaign of it that is complete."""
    folder = tmp_path_factory.mktemp("newcomer")
    ours("new-robot", str(folder / "robot"))
    ours("new-mission", str(folder / "mission.py"), "--robot", str(folder / "robot"))
    (folder / "vary.py").write_text(KINEMATIC)
    words = [
        sys.executable,
        "-m",
        "uvms_ocp",
        "campaign",
        "mission.py",
        "--vary",
        "vary.py",
        "--runs",
        "4",
        *QUICK,
    ]
    told = subprocess.run(
        [*words, "--out", "c", "--workers", "1"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stdout + told.stderr
    return folder


def test_the_templates_pass_their_checks(place: Path) -> None:
    checked = ours("check-robot", str(place / "robot"))
    assert "8 thrusters, rank 6" in checked
    assert "warning" not in checked
    assert "accepted" in ours("check", str(place / "mission.py"))
    assert "ToolPosition" not in ours("mission", str(place / "mission.py"))


def test_names_of_what_can_be_varied_are_whole_and_the_posture_of_the_arm_is_no_point(
    place: Path,
) -> None:
    words = ("campaign", str(place / "mission.py"), "--parameters")
    names = [row["parameter"] for row in json.loads(_json(*words, "--json"))]
    printed = ours(*words).split()
    assert [name for name in names if name not in printed] == []
    assert [name for name in names if name.startswith("goals.") and name.endswith(".x")] == [
        "goals.TP.x",
        "goals.PC.x",
    ]


def test_what_is_no_python_code_is_no_list_of_variations(place: Path) -> None:
    with pytest.raises(InvalidInput, match=r"'vary\.txt' is no Python code; give FILE\.py"):
        ours(
            "campaign",
            str(place / "mission.py"),
            "--vary",
            "vary.txt",
            "--out",
            str(place / "none"),
        )


def test_the_template_mission_completes_as_it_is(place: Path, tmp_path: Path) -> None:
    report = json.loads(
        _json("run", str(place / "mission.py"), "--out", str(tmp_path / "run"), "--json")
    )
    assert report["completed"]
    assert report["robot"] == "my_robot"


def _json(*words: str) -> str:
    result = CliRunner().invoke(app, words, catch_exceptions=False)
    assert result.exit_code in (0, 3), result.output
    return result.stdout


def test_templates_are_not_written_over(place: Path) -> None:
    with pytest.raises(InvalidInput, match="is there already"):
        ours("new-mission", str(place / "mission.py"))


def test_the_folder_holds_rows_report_and_copies(place: Path) -> None:
    folder = place / "c"
    names = {path.name for path in folder.iterdir()} - {".uvms_ocp"}
    assert names == {"campaign.json", "rows", "sources", "report.json", "report.html"}
    assert (folder / "sources" / "scenario" / "mission.py").read_text() == (
        place / "mission.py"
    ).read_text()
    assert (folder / "sources" / "scenario" / "robot" / "robot.urdf").exists()
    assert (folder / "sources" / "variations" / "vary.py").read_text() == KINEMATIC


def test_the_page_needs_no_network(place: Path) -> None:
    page = (place / "c" / "report.html").read_text()
    assert page.count("data:image/png;base64,") >= 3
    assert not re.search(r'(?:src|href)="(?!data:)', page)
    assert "uvms-ocp campaign" in page


def test_a_report_says_why_it_is_silent_worst_by_what_and_whose_numbers_a_cause_has(
    place: Path,
) -> None:
    told = " ".join(ours("campaign", str(place / "c"), "--report").split())
    page = (place / "c" / "report.html").read_text(encoding="utf-8")
    for text in (told, page):
        assert "fewer than 30 runs" in text
        assert "failures before successes" in text
    assert "the numbers are those of the run that is named" in page
    assert "Nothing to tell" not in page


def test_a_report_counts_success_by_bounds_of_ones_own(place: Path) -> None:
    told = json.loads(
        _json("campaign", str(place / "c"), "--report", "--success", "duration_s<100", "--json")
    )
    assert told["criterion"] == ["duration_s < 100"]
    assert (told["finished"], told["success"]["number"]) == (4, 0)


def test_a_run_is_repeated_alone_from_the_copies(place: Path, tmp_path: Path) -> None:
    moved = tmp_path / "elsewhere"
    (place / "c").rename(moved)
    try:
        report = json.loads(
            _json(
                "campaign", str(moved), "--rerun", "2", "--out", str(tmp_path / "again"), "--json"
            )
        )
        row = read_table(moved).set_index("run").loc[2]
    finally:
        moved.rename(place / "c")
    assert report["seed"] == row["seed"]
    assert report["tool_position_error_m"] == pytest.approx(row["tool_position_error_m"], rel=1e-12)
    assert (tmp_path / "again" / "record.npz").exists()


def test_a_campaign_compared_with_itself_is_no_different(place: Path) -> None:
    told = json.loads(_json("campaign", str(place / "c"), "--against", str(place / "c"), "--json"))
    assert told["paired"]
    assert (told["first_only"], told["second_only"], told["p_value"]) == (0, 0, 1.0)
    assert all(row["mean_change"] == 0.0 for row in told["figures"])


def test_a_changed_mission_is_refused_and_the_file_named(place: Path, tmp_path: Path) -> None:
    text = (place / "mission.py").read_text()
    (place / "mission.py").write_text(text.replace("0.02)", "0.03)"))
    words = (
        "campaign",
        str(place / "mission.py"),
        "--vary",
        str(place / "vary.py"),
        "--runs",
        "4",
        *QUICK,
    )
    try:
        with pytest.raises(InvalidInput, match=r"not the same: scenario files mission.py"):
            ours(*words, "--out", str(place / "c"))
    finally:
        (place / "mission.py").write_text(text)


def test_what_can_be_varied_is_listed() -> None:
    parameters = json.loads(_json("campaign", "case1", "--parameters", "--json"))
    assert {"water.drag", "payload.mass", "goals.PC.x"} <= {row["parameter"] for row in parameters}


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        (("campaign", "case9"), NameNotFound, "unknown scenario 'case9'"),
        (("campaign", "case1", "--sampler", "sobel"), NameNotFound, "Did you mean 'sobol'"),
        (("campaign", "case1", "--report"), InvalidInput, "no campaign is there"),
        (("campaign", "case1", "--vary", "nowhere.py"), InvalidInput, "there is no such file"),
        (("campaign", "case1", "--records", "some"), NameNotFound, "unknown choice of records"),
        (("campaign", "case1", "--runs", "0"), InvalidInput, "runs"),
        (("new-mission", "mission.txt"), InvalidInput, "give the name of a Python file"),
    ],
)
def test_mistakes_are_told_in_one_line(
    words: tuple[str, ...], error: type[UvmsError], message: str
) -> None:
    with pytest.raises(error, match=message) as told:
        CliRunner().invoke(app, words, catch_exceptions=False)
    assert "\n" not in str(told.value)
