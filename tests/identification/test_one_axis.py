"""Decay and towing tests: a vehicle that moves along some axes alone, whose table has little else
than a time and a speed.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from towing import moved
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput, NameNotFound
from uvms_ocp.identification.calibration import Calibration, calibrate
from uvms_ocp.identification.calibration_robot import CalibratedRobot, calibrated_robot
from uvms_ocp.identification.completed_recordings import along_axes
from uvms_ocp.identification.identified_numbers import TOTAL
from uvms_ocp.identification.model import stage_of
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.results import report_text
from uvms_ocp.identification.settings import CalibrationSettings

SETTINGS: dict[str, Any] = {
    "robot": "bluerov2_alpha5",
    "arm": "taken off",
    "hull": [[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]],
    "commands": "wrench",
    "lag": 0.001,
    "delay": 0.0,
    "velocity_delay": 0.0,
    "dead_zone": 0.001,
    "noise": {"velocity": 0.005, "rate": 0.005},
    "step": 0.05,
}
LEARN = {"added_mass": {}, "quadratic_drag": {}}


def _settings(*axes: str, **learn: Any) -> CalibrationSettings:
    return CalibrationSettings(**SETTINGS, axes=axes, learn=learn or LEARN)


def _along(column: int, values: np.ndarray, width: int) -> np.ndarray:
    return np.outer(values, np.arange(width) == column)


def _towed() -> tuple[Recording, float, float]:
    """A recording of surge alone, its mass with added mass, and its quadratic drag."""
    start = calibrated_robot(_settings("surge"), Path()).start
    mass = start.mass + 1.2 * start.added_mass[0, 0]
    drag = 1.3 * start.quadratic_drag[0, 0]
    pushes = (0.0, 20.0, -15.0, 35.0, 8.0)
    t, speed = moved(mass, start.linear_drag[0, 0], drag, pushes, 0.0)
    channels = {
        "linear_velocity": Channel(t=t, values=_along(0, speed, 3)),
        "wrench": Channel(t=5.0 * np.arange(5), values=_along(0, np.array(pushes), 6)),
    }
    return Recording(name="towed", channels=channels), mass, drag


def _fitted(recording: Recording, settings: CalibrationSettings) -> Calibration:
    return calibrate(
        calibrated_robot(settings, Path()), settings, [recording], progress=lambda _: None
    )


def test_a_towing_test_of_one_axis_gives_its_numbers() -> None:
    recording, mass, drag = _towed()
    calibration = _fitted(recording, _settings("surge", **LEARN, wrench_offset={"prior": 0.1}))
    numbers = {number.name: number for number in calibration.numbers}
    assert set(numbers) == {"added_mass surge", "quadratic_drag surge", f"{TOTAL} surge"}
    for name, truth in ((f"{TOTAL} surge", mass), ("quadratic_drag surge", drag)):
        assert abs(numbers[name].value - truth) < 3.0 * numbers[name].sigma
        assert numbers[name].sigma < 0.1 * truth
    report = report_text(calibration)
    assert "moves along surge alone" in report
    assert "| recording | wrench_offset surge [N, N m] |" in report
    assert f"| towed | {calibration.estimate.per_recording['towed'][0]:.3g} |" in report


@pytest.mark.sampled
@pytest.mark.parametrize("commands", ["wrench", "propeller_commands"])
def test_a_decay_test_needs_neither_commands_nor_attitude(commands: str) -> None:
    learn = {"linear_drag": {}, "quadratic_drag": {}}
    settings = CalibrationSettings(**SETTINGS | {"commands": commands}, axes=("yaw",), learn=learn)
    subject = calibrated_robot(settings, Path())
    level = ca.SX(ca.DM([0.0] * 6 + [1.0]))
    about_z = float(ca.evalf(subject.vehicle.dynamics.mass_matrix(level)[5, 5]))
    t, rate = moved(
        about_z,
        subject.start.linear_drag[5, 5],
        1.5 * subject.start.quadratic_drag[5, 5],
        (0.0, 0.0),
        2.0,
    )
    recording = Recording(
        name="decay", channels={"angular_velocity": Channel(t=t, values=_along(2, rate, 3))}
    )
    calibration = _fitted(recording, settings)
    drag = next(number for number in calibration.numbers if number.name == "quadratic_drag yaw")
    assert abs(drag.value - 1.5 * subject.start.quadratic_drag[5, 5]) < 3.0 * drag.sigma
    assert drag.determined
    assert any(
        "not recorded: a fit along some axes takes nothing to push it" in issue
        for issue in calibration.issues
    )


def test_commands_of_another_kind_than_the_settings_name_are_no_decay_test() -> None:
    settings = CalibrationSettings(
        **SETTINGS | {"commands": "propeller_commands"}, axes=("surge",), learn=LEARN
    )
    with pytest.raises(InvalidInput, match="no propeller_commands is recorded"):
        _fitted(_towed()[0], settings)


def test_along_all_axes_nothing_is_made_up() -> None:
    recording = _towed()[0]
    every = CalibrationSettings(**SETTINGS, learn=LEARN)
    assert along_axes(recording, every, 6).channels == recording.channels
    with pytest.raises(
        InvalidInput, match=r"no attitude is recorded.*or give the axes along which alone it moves"
    ):
        _fitted(recording, every)


def test_what_is_needed_along_an_axis_is_not_made_up() -> None:
    towed = _towed()[0]
    turning = Recording(
        name="turning", channels={"angular_velocity": towed.channels["linear_velocity"]}
    )
    assert set(along_axes(turning, _settings("yaw"), 6).channels) == {
        "attitude",
        "linear_velocity",
        "angular_velocity",
        "wrench",
    }
    with pytest.raises(InvalidInput, match="no attitude is recorded"):
        _fitted(turning, _settings("roll"))
    with pytest.raises(InvalidInput, match="no linear_velocity is recorded"):
        _fitted(turning, _settings("surge", "yaw"))


def test_a_vehicle_that_is_held_stays_where_it_is() -> None:
    """Along the other axes nothing moves it, whatever pushes."""
    stage = stage_of(calibrated_robot(_settings("surge", "yaw"), Path()).vehicle)
    x = np.concatenate(
        [[0.0, 0.0, -2.0, 0.0, 0.0, 0.0, 1.0], 0.2 * np.ones(6), np.zeros(stage.n_u)]
    )
    p = np.zeros(stage.n_p)
    for _ in range(20):
        x = np.asarray(stage.step(x, 10.0 * np.ones(stage.n_u), np.zeros(0), p, 0.05)).ravel()
    np.testing.assert_array_equal(x[8:12], np.zeros(4))
    np.testing.assert_array_equal(x[3:5], np.zeros(2))
    assert x[2] == -2.0
    assert abs(x[7]) > 0.01
    assert abs(x[12]) > 0.01


def test_coordinates_of_other_axes_are_not_learnt_and_unknown_ones_are_refused() -> None:
    vehicle = calibrated_robot(_settings("surge", mass={"prior": 0.01}, **LEARN), Path()).vehicle
    assert vehicle.shared.names == ("mass", "added_mass surge", "quadratic_drag surge")
    assert calibrated_robot(_settings("yaw", "surge", "yaw"), Path()).vehicle.axes == (0, 5)
    with pytest.raises(NameNotFound, match="surgee"):
        calibrated_robot(_settings("surge", added_mass={"free": ["surgee"]}), Path())
    with pytest.raises(InvalidInput, match="nothing in it is free"):
        calibrated_robot(_settings("surge", added_mass={"free": ["sway"]}), Path())


def test_the_command_takes_axes_and_refuses_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "learn.yaml").write_text(
        "".join(f"{key}: {value}\n" for key, value in (SETTINGS | {"learn": LEARN}).items())
    )
    np.savetxt(
        tmp_path / "tow.csv",
        np.arange(40.0).reshape(20, 2),
        header="t,u",
        comments="",
        delimiter=",",
    )
    (tmp_path / "map.yaml").write_text(
        "channels: {linear_velocity: {time: t, columns: [u, 0.0, 0.0]}}"
    )
    words = [
        "identify",
        str(tmp_path / "learn.yaml"),
        str(tmp_path / "tow.csv"),
        "--mapping",
        str(tmp_path / "map.yaml"),
    ]
    words += ["--out", str(tmp_path / "out")]
    seen: list[CalibrationSettings] = []

    def only_look(
        subject: CalibratedRobot, settings: CalibrationSettings, *_: object, **__: object
    ) -> None:
        assert subject.vehicle.axes == (0, 5)
        seen.append(settings)
        raise InvalidInput("seen")

    monkeypatch.setattr("uvms_ocp.cli.identify.calibrate", only_look)
    assert "axes.0: given 'up'; allowed: 'surge'" in str(
        CliRunner().invoke(app, [*words, "--axes", "up"]).exception
    )
    assert not seen
    assert (
        str(CliRunner().invoke(app, [*words, "--axes", "surge", "--axes", "yaw"]).exception)
        == "seen"
    )
    assert seen[0].axes == ("surge", "yaw")
    assert seen[0].noise.velocity == SETTINGS["noise"]["velocity"]
