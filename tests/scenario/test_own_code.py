"""Scenarios of one's own: from a file, by a name in it, from a module; what is wrong with them is
told in one line.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from uvms_ocp.campaign.code_source import CodeSource
from uvms_ocp.errors import InvalidInput, NameNotFound, UvmsError
from uvms_ocp.robot.loading import robot_folder
from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.scenario.own_code import load_scenario
from uvms_ocp.scenario.scenario import Scenario

MISSION = """
from pathlib import Path
import uvms_ocp as uo
import helper

def scenario(plant="dynamic", robot="girona_maris7_full"):
    return uo.scenario.case1(plant=plant, robot=robot, duration=helper.LONG)

fixed = uo.scenario.case1(plant="kinematic")
number = 3
own_robot = lambda: uo.scenario.case1(
    robot=uo.load_robot(urdf=Path(__file__).parent / "r" / "robot.urdf", hydrodynamics=Path(__file__).parent / "r" / "h.yaml")
)
"""


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    (tmp_path / "helper.py").write_text("LONG = 7.0\n")
    (tmp_path / "mission.py").write_text(MISSION)
    (tmp_path / "r").mkdir()
    source = robot_folder("girona_maris7_full")
    (tmp_path / "r" / "robot.urdf").write_bytes((source / "robot.urdf").read_bytes())
    (tmp_path / "r" / "h.yaml").write_bytes((source / "hydrodynamics.yaml").read_bytes())
    return tmp_path / "mission.py"


def chosen(words: object, **options: object) -> Scenario:
    return load_scenario(str(words), options, SCENARIOS)


def test_a_file_gives_its_scenario_with_the_options_that_it_takes(mission: Path) -> None:
    assert chosen(mission).duration == 7.0
    assert chosen(f"{mission}:scenario", plant="kinematic").plant == "kinematic"


def test_a_scenario_that_is_a_value_takes_what_can_be_changed_of_it(mission: Path) -> None:
    changed = chosen(
        f"{mission}:fixed", seed=5, seabed=-41.0, current=(0.1, 0.0, 0.0), noise=True, duration=3.0
    )
    assert (changed.seed, changed.duration, changed.environment.seafloor.z) == (5, 3.0, -41.0)
    assert changed.sensors.position.sigma > 0
    assert changed.environment.current.value[0] == 0.1


def test_a_module_by_its_name(mission: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(mission.parent)
    monkeypatch.syspath_prepend(mission.parent)
    assert chosen("uvms_ocp.scenario.cases.case1:case1", duration=2.0).duration == 2.0


@pytest.mark.parametrize(
    ("name", "options", "error", "message"),
    [
        (":scenaro", {}, NameNotFound, "Did you mean 'scenario'"),
        (":number", {}, InvalidInput, "is a int; give a Scenario"),
        (":fixed", {"robot": "planar5"}, InvalidInput, "whose robot is fixed"),
        (
            ":scenario",
            {"seabed": 1.0},
            InvalidInput,
            "takes no option seabed; it takes plant, robot",
        ),
    ],
)
def test_what_is_wrong_is_told(
    mission: Path, name: str, options: dict[str, object], error: type[UvmsError], message: str
) -> None:
    with pytest.raises(error, match=message) as told:
        chosen(f"{mission}{name}", **options)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("text", "message"), [("1 / 0", "mission.py:1: ZeroDivisionError"), ("x = (", "mission.py:1:")]
)
def test_code_that_fails_is_told_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "mission.py").write_text(text)
    with pytest.raises(InvalidInput, match=message):
        chosen(tmp_path / "mission.py")


@pytest.mark.parametrize("words", ["nowhere.py", "nowhere.at.all:scenario"])
def test_code_that_is_not_there_is_told(words: str) -> None:
    with pytest.raises(InvalidInput, match="there is no such"):
        chosen(words)


def test_a_file_that_changed_is_run_anew(mission: Path) -> None:
    before = chosen(mission)
    mission.write_text(MISSION.replace("helper.LONG", "9.0"))
    assert (before.duration, chosen(mission).duration) == (7.0, 9.0)


def test_a_robot_is_a_name_a_folder_or_a_file_with_its_water(mission: Path) -> None:
    folder = robot_folder("girona_maris7")
    for words, water in (
        (str(folder), None),
        (str(folder / "robot.urdf"), str(folder / "hydrodynamics.yaml")),
    ):
        options = {"robot": words} | ({"hydrodynamics": water} if water else {})
        assert len(chosen(mission, **options).robot.description.thrusters) == 5
    with pytest.raises(InvalidInput, match="without a robot"):
        chosen(mission, hydrodynamics="water.yaml")


def test_code_goes_to_other_machines_with_the_files_that_it_reads(
    mission: Path, tmp_path: Path
) -> None:
    source = CodeSource.gathered(f"{mission}:own_robot")
    assert {"mission.py", "helper.py", "r/robot.urdf", "r/h.yaml"} <= set(source.files)
    for path in (*mission.parent.glob("*.py"), *(mission.parent / "r").iterdir()):
        path.write_text("this machine has others")
    assert source.build().robot.n_joints == 7


def test_a_source_is_the_same_wherever_its_folder_is(mission: Path, tmp_path: Path) -> None:
    identity = CodeSource.gathered(str(mission), {"plant": "kinematic"}).identity()
    moved = tmp_path / "other"
    moved.mkdir()
    for name in ("mission.py", "helper.py"):
        (moved / name).write_bytes((tmp_path / name).read_bytes())
    assert (
        CodeSource.gathered(str(moved / "mission.py"), {"plant": "kinematic"}).identity()
        == identity
    )
