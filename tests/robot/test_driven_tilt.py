"""How far thrust below the mass tilts a vehicle whose roll and pitch nothing drives is told before it
swims, with what keeps it nearly level.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from uvms_ocp.robot.description import checked_copy
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.static_balance import tilt_when_driven
from uvms_ocp.scenario.preflight.robot_check import RobotVerdict, check_robot

MASS = 60.0
BELOW = 0.2  # [m] of the thrusters below mass
URDF = (
    f"<robot name='r'><link name='base_link'><inertial><mass value='{MASS}'/><inertia ixx='3' ixy='0'"
    " ixz='0' iyy='6' iyz='0' izz='7'/></inertial></link></robot>"
)


def vehicle(folder: Path, arm: float, *, below: float = BELOW, more: str = "") -> Robot:
    """Return a vehicle with five thrusters and buoyancy [m] above its mass."""
    (folder / "robot.urdf").write_text(URDF, encoding="utf-8")
    thrusters = "".join(
        f"  - {{name: t{k}, link: base_link, position: [{x}, {y}, {-below}],"
        f" direction: [0.8, {side}, 0.0], minimum: -50, maximum: 50, time_constant: 0.1}}\n"
        for k, (x, y, side) in enumerate(
            ((0.4, 0.3, -0.6), (0.4, -0.3, 0.6), (-0.4, 0.3, 0.6), (-0.4, -0.3, -0.6))
        )
    )
    (folder / "hydrodynamics.yaml").write_text(
        "base: free_flyer\nwater_density: 1000.0\n"
        "vehicle_limits:\n  velocity: [0.5, 0.4, 0.4, 0.4, 0.4, 0.5]\n"
        "  acceleration: [0.3, 0.2, 0.3, 0.4, 0.4, 0.4]\n"
        "links:\n  base_link:\n    coefficients:\n      added_mass: [30, 50, 80, 1, 1, 1]\n"
        "      linear_drag: [10, 20, 30, 1, 1, 1]\n      quadratic_drag: [80, 100, 150, 5, 5, 5]\n"
        f"      volume: {MASS / 1000.0}\n      centre_of_buoyancy: [0, 0, {arm}]\n"
        f"thrusters:\n{thrusters}"
        "  - {name: up, link: base_link, position: [0, 0, 0], direction: [0, 0, 1], minimum: -50,"
        f" maximum: 50, time_constant: 0.1}}\n{more}",
        encoding="utf-8",
    )
    return load_robot(folder)


def test_thrust_below_the_mass_turns_against_weight(tmp_path: Path) -> None:
    tilt = tilt_when_driven(vehicle(tmp_path, 0.1))
    assert tilt is not None
    pushes = {0: 0.3 * 90 + 10 * 0.5 + 80 * 0.25, 1: 0.2 * 110 + 20 * 0.4 + 100 * 0.16}
    assert (tilt.push, tilt.turn) == (0, 4)  # surge needs more, and pitches it
    assert tilt.moment == pytest.approx(max(pushes.values()) * BELOW, rel=1e-9)
    assert tilt.righting == pytest.approx(MASS * 9.81 * 0.1, rel=1e-9)
    assert tilt.angle == pytest.approx(np.arcsin(tilt.moment / tilt.righting))


def test_what_is_told_to_cure_it_does(tmp_path: Path) -> None:
    findings = check_robot(vehicle(tmp_path, 0.03)).findings
    (found,) = [finding for finding in findings if finding.subject == "attitude"]
    assert found.verdict is RobotVerdict.WARNING
    assert "thrust along surge" in found.text
    factor = float(re.findall(r"with ([0-9.]+) times", found.text)[0])
    share = float(re.findall(r"or ([0-9.]+) times the force", found.text)[0])
    assert factor == pytest.approx(1.0 / share, rel=0.02)
    cured = tilt_when_driven(vehicle(tmp_path, 0.03 * factor))
    assert cured is not None
    assert np.rad2deg(cured.angle) == pytest.approx(15.0, rel=0.05)
    report = check_robot(vehicle(tmp_path, 0.03 * factor * 1.1))
    assert not [finding for finding in report.findings if finding.subject == "attitude"]


def test_thrusters_that_drive_every_turn_tilt_nothing(tmp_path: Path) -> None:
    verticals = "".join(
        f"  - {{name: v{k}, link: base_link, position: [{x}, {y}, 0], direction: [0, 0, 1],"
        " minimum: -50, maximum: 50, time_constant: 0.1}\n"
        for k, (x, y) in enumerate(((0.3, 0.2), (0.3, -0.2), (-0.3, 0.0)))
    )
    assert tilt_when_driven(vehicle(tmp_path, 0.03, more=verticals)) is None
    level = tilt_when_driven(vehicle(tmp_path, 0.03, below=0.0))
    assert level is not None
    assert level.angle == pytest.approx(0.0, abs=1e-9)


def test_a_vehicle_that_rests_askew_is_told(tmp_path: Path) -> None:
    robot = vehicle(tmp_path, 0.03)
    links = robot.description.model_dump()["links"]
    links["base_link"]["coefficients"]["centre_of_buoyancy"] = (0.02, 0.0, 0.03)
    file = tmp_path / "askew"
    file.mkdir()
    askew = load_robot(
        urdf=tmp_path / "robot.urdf",
        hydrodynamics=checked_copy(robot.description, links=links),
    )
    texts = [f.text for f in check_robot(askew).findings if f.subject == "attitude"]
    assert any("it will rest at 34 deg" in text for text in texts)
