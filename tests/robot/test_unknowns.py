"""What a robot's files leave open is said where the robot is loaded, checked and used."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pinocchio as pin
import pytest
import yaml

from uvms_ocp.robot.assembly import without_arm
from uvms_ocp.robot.loading import list_robots, load_robot, robot_folder
from uvms_ocp.robot.static_balance import without_trim
from uvms_ocp.robot.unknowns import link_masses, links_without_water
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.preflight.robot_check import RobotVerdict, check_robot, check_robot_files

WET = [name for name in list_robots() if load_robot(name).description.links]


def rewritten(name: str, folder: Path, **changes: Any) -> Path:
    """A hydrodynamics file of a robot with other entries."""
    content = yaml.safe_load(
        (robot_folder(name) / "hydrodynamics.yaml").read_text(encoding="utf-8")
    )
    path = folder / "hydrodynamics.yaml"
    path.write_text(yaml.safe_dump({**content, **changes}), encoding="utf-8")
    return path


def without_power(name: str, folder: Path) -> Path:
    """The last thruster has lost its power data."""
    content = yaml.safe_load(
        (robot_folder(name) / "hydrodynamics.yaml").read_text(encoding="utf-8")
    )
    *earlier, last = content["thrusters"]
    return rewritten(
        name, folder, thrusters=[*earlier, {key: last[key] for key in last if key != "power"}]
    )


@pytest.mark.parametrize("name", list_robots())
def test_the_masses_of_the_links_are_those_of_the_robot(name: str) -> None:
    for robot in (
        load_robot(name),
        without_arm(load_robot(name)) if name in WET else load_robot(name),
    ):
        bare = without_trim(robot)
        assert sum(link_masses(bare.model).values()) == pytest.approx(
            pin.computeTotalMass(bare.model), rel=1e-12
        )


@pytest.mark.parametrize("name", list_robots())
def test_the_robots_of_the_package_leave_nothing_open(
    name: str, caplog: pytest.LogCaptureFixture
) -> None:
    robot = load_robot(name)
    assert not caplog.records
    assert not {f.subject for f in check_robot(robot).findings} & {"water", "energy"}


@pytest.mark.sampled
@pytest.mark.parametrize(
    "name", [name for name in WET if len(load_robot(name).description.links) > 1]
)
def test_a_link_that_the_file_forgets_is_named(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    whole = load_robot(name)
    masses = link_masses(without_trim(whole).model)
    links = dict(whole.description.links)
    content = yaml.safe_load(
        (robot_folder(name) / "hydrodynamics.yaml").read_text(encoding="utf-8")
    )
    for link in links:
        caplog.clear()
        remaining_links = {key: value for key, value in content["links"].items() if key != link}
        robot = load_robot(name, hydrodynamics=rewritten(name, tmp_path, links=remaining_links))
        forgotten = (link,) if masses[link] > 0.0 else ()
        assert links_without_water(without_trim(robot).model, robot.description) == forgotten
        assert [
            f"no water acts on link {link}:" in record.getMessage() for record in caplog.records
        ] == [True] * len(forgotten)
        water_findings = [f for f in check_robot(robot).findings if f.subject == "water"]
        assert [f.verdict for f in water_findings] == [RobotVerdict.WARNING] * len(forgotten)


def test_a_link_that_is_said_to_be_dry_is_not_warned_about(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    content = yaml.safe_load(
        (robot_folder("girona_maris7") / "hydrodynamics.yaml").read_text(encoding="utf-8")
    )
    links = {**content["links"], "link7": {"coefficients": {}}}
    load_robot("girona_maris7", hydrodynamics=rewritten("girona_maris7", tmp_path, links=links))
    assert not caplog.records


def test_a_thruster_without_power_is_named_at_load_check_and_pre_flight(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    water = without_power("girona_maris7_full", tmp_path)
    robot = load_robot("girona_maris7_full", hydrodynamics=water)
    last = robot.description.thrusters[-1].name
    expected = f"no power is given for thruster {last}"
    assert [expected in record.getMessage() for record in caplog.records] == [True]
    report = check_robot_files(robot_folder("girona_maris7_full"), water)
    assert [f.text.startswith(expected) for f in report.findings if f.subject == "energy"] == [True]
    warnings = case1(robot=robot).check().of_check("energy")
    assert [f.text.startswith(expected) for f in warnings] == [True]
    assert not case1(robot=robot, plant="kinematic").check().of_check("energy")
