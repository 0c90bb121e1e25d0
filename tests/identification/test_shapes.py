"""A robot whose hull is a shape is identified as it is: what the shape gives is the prior of its
coefficients.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from towing import moved
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.calibration import calibrate
from uvms_ocp.identification.calibration_robot import (
    SHAPE_SPREADS,
    CalibratedRobot,
    calibrated_robot,
)
from uvms_ocp.identification.parameters import AXES
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.results import report_text
from uvms_ocp.identification.robot_variant import variant_text, whole_text
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.robot.assembly import without_arm
from uvms_ocp.robot.coefficients import links_in_water
from uvms_ocp.robot.description import as_matrix6
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics
from uvms_ocp.robot.loading import load_robot, robot_folder
from uvms_ocp.robot.robot import Robot

SETTINGS: dict[str, Any] = {
    "robot": "mine",
    "arm": "taken off",
    "hull": [[-0.4, -0.25, -0.15], [0.4, 0.25, 0.15]],
    "commands": "wrench",
    "lag": 0.001,
    "delay": 0.0,
    "velocity_delay": 0.0,
    "learn": {"added_mass": {}, "quadratic_drag": {}},
    "noise": {"velocity": 0.005, "rate": 0.005},
    "step": 0.05,
}
BOX = {"size": [0.8, 0.5, 0.3], "drag_coefficient": 0.8}
AWAY: dict[str, Any] = {"pose": {"position": [0.02, 0.0, 0.01]}}
LINKS: dict[str, dict[str, Any]] = {
    "box": {"box": BOX},
    "box away": {"box": BOX | AWAY},
    "box by the flow": {"box": BOX | {"drag_by": "flow"}},
    "sphere": {"sphere": {"radius": 0.3}},
    "coefficients away": {
        "coefficients": {"added_mass": [9.0] * 6, "quadratic_drag": [60.0] * 6, "volume": 0.02}
        | AWAY
    },
}
COEFFICIENTS = ("added_mass", "linear_drag", "quadratic_drag", "volume", "centre_of_buoyancy")


def shaped(folder: Path, link: dict[str, Any]) -> Path:
    """A robot in a folder, with another description of its vehicle's link."""
    (folder / "mine").mkdir(exist_ok=True)
    known = robot_folder("bluerov2_alpha5")
    (folder / "mine/robot.urdf").write_text((known / "robot.urdf").read_text())
    content = yaml.safe_load((known / "hydrodynamics.yaml").read_text())
    content["links"]["base_link"] = link
    (folder / "mine/hydrodynamics.yaml").write_text(yaml.safe_dump(content))
    return folder


def subject_of(folder: Path, **changed: Any) -> tuple[CalibratedRobot, CalibrationSettings]:
    settings = CalibrationSettings.model_validate(SETTINGS | changed)
    return calibrated_robot(settings, folder), settings


def hull_of(robot: Robot) -> LinkHydrodynamics:
    (hull,) = (
        wet for wet in links_in_water(without_arm(robot).description) if wet.frame == "base_link"
    )
    return hull


def towed(subject: CalibratedRobot, mass: float, drag: float) -> Recording:
    """In surge alone."""
    pushes = (0.0, 20.0, -15.0, 35.0, 8.0)
    t, speed = moved(mass, subject.start.linear_drag[0, 0], drag, pushes, 0.0)
    along = {"linear_velocity": (t, speed, 3), "wrench": (5.0 * np.arange(5), np.array(pushes), 6)}
    channels = {
        name: Channel(t=t, values=np.outer(x, np.arange(n) == 0))
        for name, (t, x, n) in along.items()
    }
    return Recording(name="towed", channels=channels)


@pytest.mark.sampled
@pytest.mark.parametrize("name", LINKS)
def test_numbers_replace_the_shape_in_the_file_and_all_others_stay_as_it_gave_them(
    name: str, tmp_path: Path
) -> None:
    subject, settings = subject_of(shaped(tmp_path, LINKS[name]), axes=["surge"])
    mass = subject.start.mass + 0.6 * subject.start.added_mass[0, 0]
    drag = 0.7 * subject.start.quadratic_drag[0, 0]
    calibration = calibrate(
        subject, settings, [towed(subject, mass, drag)], progress=lambda _: None
    )
    numbers = {each.name: each for each in calibration.numbers}
    for number, truth in (("mass and added mass surge", mass), ("quadratic_drag surge", drag)):
        assert abs(numbers[number].value - truth) < 3.0 * numbers[number].sigma
        assert numbers[number].sigma < 0.1 * truth
    assert ("is the prior of its coefficients" in report_text(calibration)) == (
        "coefficients" not in name
    )
    (tmp_path / "variant.yaml").write_text(variant_text(calibration, ["towed"]))
    (tmp_path / "whole.yaml").write_text(whole_text(calibration, tmp_path / "variant.yaml"))
    after = load_robot(urdf=tmp_path / "mine/robot.urdf", hydrodynamics=tmp_path / "whole.yaml")
    before = load_robot(
        urdf=tmp_path / "mine/robot.urdf", hydrodynamics=tmp_path / "mine/hydrodynamics.yaml"
    )
    expected = {field: np.array(getattr(hull_of(before), field)) for field in COEFFICIENTS}
    for quantity in SETTINGS["learn"]:
        expected[quantity][0, 0] = numbers[f"{quantity} surge"].value
    for field in COEFFICIENTS:
        np.testing.assert_allclose(
            getattr(hull_of(after), field), expected[field], rtol=1e-5, atol=1e-8
        )
    np.testing.assert_allclose(
        hull_of(after).X_FL.homogeneous, hull_of(before).X_FL.homogeneous, atol=1e-9
    )
    assert hull_of(after).by_flow == hull_of(before).by_flow == ("flow" in name)


@pytest.mark.sampled
@pytest.mark.parametrize("name", LINKS)
def test_buoyancy_is_where_it_was_when_nothing_says_otherwise(name: str, tmp_path: Path) -> None:
    """Whatever the frame of the coefficients; the hull's box is around the same place, too."""
    subject, settings = subject_of(
        shaped(tmp_path, LINKS[name]),
        learn={"volume": {}, "centre_of_buoyancy": {}},
        axes=["surge"],
    )
    still = Channel(t=np.arange(100.0) / 10.0, values=np.zeros((100, 3)))
    wrench = Channel(t=np.arange(100.0) / 10.0, values=np.zeros((100, 6)))
    rest = Recording(name="rest", channels={"linear_velocity": still, "wrench": wrench})
    calibration = calibrate(subject, settings, [rest], progress=lambda _: None)
    coefficients = yaml.safe_load(variant_text(calibration, ["rest"]))["links"]["base_link"][
        "coefficients"
    ]
    (tmp_path / "variant.yaml").write_text(variant_text(calibration, ["rest"]))
    (tmp_path / "whole.yaml").write_text(whole_text(calibration, tmp_path / "variant.yaml"))
    after = load_robot(urdf=tmp_path / "mine/robot.urdf", hydrodynamics=tmp_path / "whole.yaml")
    np.testing.assert_allclose(hull_of(after).volume, hull_of(subject.robot).volume, rtol=1e-5)
    np.testing.assert_allclose(
        hull_of(after).centre_of_buoyancy, hull_of(subject.robot).centre_of_buoyancy, atol=1e-5
    )
    assert coefficients["volume"] > 0.0


def test_what_a_shape_gives_is_a_prior_unless_settings_know_better(tmp_path: Path) -> None:
    learn = {
        "added_mass": {},
        "linear_drag": {"prior": 0.1},
        "volume": {"bounds": [0.01, 0.5]},
        "mass": {},
    }
    for link, prior in (("box", SHAPE_SPREADS["added_mass"]), ("coefficients away", np.inf)):
        known = subject_of(shaped(tmp_path, LINKS[link]), learn=learn)[
            0
        ].vehicle.shared.declaration.quantities
        np.testing.assert_array_equal(known["added_mass"].sigma, [prior] * len(AXES))
        assert set(known["linear_drag"].sigma) <= {0.1}
        assert np.isinf([*known["volume"].sigma, *known["mass"].sigma]).all()


def test_a_turned_shape_is_refused_for_its_axes_are_not_those_of_the_link(tmp_path: Path) -> None:
    cylinder = {"radius": 0.2, "length": 0.9, "pose": {"rpy": [0.0, 1.5707963267948966, 0.0]}}
    subject, _ = subject_of(shaped(tmp_path, {"cylinder": cylinder}))
    with pytest.raises(
        InvalidInput, match="base_link: give it coefficients along the axes of its link"
    ):
        subject.coefficients()


def test_a_robot_that_is_begun_with_is_one_to_identify(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["new-robot", str(tmp_path / "mine")])
    assert result.exit_code == 0, result.output
    subject, _ = subject_of(tmp_path, arm="as it is", commands="thrust", axes=[*AXES])
    coefficients = subject.coefficients()
    for field in COEFFICIENTS[:3]:
        np.testing.assert_allclose(
            getattr(hull_of(subject.robot), field), as_matrix6(getattr(coefficients, field))
        )
    assert "added_mass roll" in subject.vehicle.shared.names
