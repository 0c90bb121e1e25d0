"""Records of the toolkit's own runs tell what was asked of the vehicle, and what a fit should not
believe of them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from compiler import long_without_compiler
from own_runs import DEAD_ZONE, LAG, as_before, driven_run, slow

from uvms_ocp import load_robot
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.calibration import calibrate
from uvms_ocp.identification.calibration_robot import CalibratedRobot, calibrated_robot
from uvms_ocp.identification.data_quality import check_data_quality
from uvms_ocp.identification.identified_numbers import IdentifiedNumber, values_of
from uvms_ocp.identification.reading import read_recording
from uvms_ocp.identification.recording import Recording
from uvms_ocp.identification.robot_variant import variant_text, whole_text
from uvms_ocp.identification.run_recordings import run_recording
from uvms_ocp.identification.segments import PreparedRecording
from uvms_ocp.identification.settings import CalibrationSettings
from uvms_ocp.identification.settings_checks import check_settings, require_current
from uvms_ocp.record.record import Record
from uvms_ocp.record.series_checks import MEASURED
from uvms_ocp.robot.description import read_description
from uvms_ocp.robot.signals import robot_sensors
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix
from uvms_ocp.scenario.cases.bluerov import bluerov_inspection
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.sim import parse_fault
from uvms_ocp.sim.currents import UniformCurrent
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor

SETTINGS = """
robot: bluerov2_alpha5
arm: taken off
hull: [[-0.25, -0.2, -0.15], [0.25, 0.2, 0.15]]
delay: 0.0005
learn:
  lag: {}
noise: {velocity: 0.01, rate: 0.02, vertical: 0.01}
stretch: 6
"""


@cache
def run() -> Record:
    return driven_run()


@cache
def subject() -> tuple[CalibratedRobot, CalibrationSettings]:
    settings = CalibrationSettings.model_validate(yaml.safe_load(SETTINGS))
    return calibrated_robot(settings, Path()), settings


def learnt_lag(record: Record) -> IdentifiedNumber:
    (number,) = calibrate(*subject(), [run_recording(record, "run")]).numbers
    return number


def told(record: Record) -> str:
    return "; ".join(map(str, check_data_quality(run_recording(record, "run"))))


def test_thrust_follows_what_was_asked_through_limits_dead_zone_and_lag() -> None:
    record = run()
    demanded = np.clip(record["asked_thrust"][:-1], *thrust_limits(slow()))
    thrust = record["thrust"]
    target = np.where(np.abs(demanded) < DEAD_ZONE, 0.0, demanded)
    assert (target != record["asked_thrust"][:-1]).any()
    left = np.exp(-record.run_meta.dt / LAG)
    np.testing.assert_allclose(
        thrust[1:], target + left * (thrust[:-1] - target), rtol=0, atol=1e-10
    )


@long_without_compiler
def test_a_plant_without_thrusters_is_asked_for_no_thrust() -> None:
    record = case1(plant="kinematic", dt=0.02, duration=0.1).run()
    assert "asked_thrust" not in record.series
    with pytest.raises(InvalidInput, match="run: no thrust is recorded"):
        PreparedRecording.of(run_recording(record, "run"), subject()[0].vehicle)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [False, True])
def test_the_lag_of_thrusters_is_learnt_from_a_run(noise: bool) -> None:
    record = driven_run(sensors=robot_sensors(slow().description)) if noise else run()
    assert learnt_lag(record).value == pytest.approx(LAG, rel=0.03)
    assert told(record) == ""


@pytest.mark.slow
def test_dead_zones_are_learnt_from_a_run_as_robot_files_have_them() -> None:
    record = driven_run(duration=20.0, size=3.0, held=0.25, dead_zone=2.0)
    learn = {"lag": {}, "dead_zone": {}, "dead_zone_reverse": {}}
    settings = CalibrationSettings.model_validate(
        subject()[1].model_dump() | {"learn": learn, "dead_zone": 3.0, "stretch": 10.0}
    )
    numbers = calibrate(
        calibrated_robot(settings, Path()), settings, [run_recording(record, "run")]
    ).numbers
    (lag,), zones = (
        (number for number in numbers if number.quantity == "lag"),
        [number for number in numbers if number.quantity != "lag"],
    )
    assert lag.value == pytest.approx(LAG, rel=0.03)
    assert len(zones) == 16
    assert np.median([number.value for number in zones]) == pytest.approx(2.0, rel=0.1)
    assert max(abs(number.value - 2.0) for number in zones) < 0.5


@pytest.mark.slow
def test_of_an_older_run_the_lag_is_lost_and_that_is_told() -> None:
    older = as_before(run())
    assert learnt_lag(older).value < 0.1 * LAG
    assert "thrust: as thrusters gave it, not as it was asked of them" in told(older)
    np.testing.assert_array_equal(
        run_recording(older, "run").channel("thrust").values[1:], older["thrust"]
    )


def test_before_a_run_thrusters_are_at_rest() -> None:
    commands = PreparedRecording.of(run_recording(run(), "run"), subject()[0].vehicle).commands
    np.testing.assert_array_equal(commands.at(np.array([-1.0, -0.01])), 0.0)
    np.testing.assert_array_equal(commands.at(np.array([0.0]))[0], run()["asked_thrust"][0])


@pytest.mark.slow
@long_without_compiler
def test_a_wrench_is_that_which_thrusters_can_give() -> None:
    scenario = case1(robot="girona_maris7", dt=0.02, duration=0.4)
    record = scenario.run()
    B = thruster_matrix(scenario.robot)
    assert np.abs(record["unreachable"]).max() > 1.0
    wrench = run_recording(record, "run").channel("wrench").values
    np.testing.assert_allclose(
        B @ np.linalg.pinv(B) @ wrench.T, wrench.T, atol=1e-9 * np.abs(wrench).max()
    )


FAULTS = {
    "thruster2:dead@3": "thruster2: thruster2:dead@3, a fault of this run",
    "current:step=0.2,0,0@2": "current: current:step=0.2,0,0@2, a fault of this run",
    "position:bias=1,0,0@4-5": "position: position:bias=1,0,0@4-5, a fault of this run",
}


@pytest.mark.sampled
@pytest.mark.parametrize(("fault", "text"), FAULTS.items(), ids=FAULTS)
def test_a_fault_of_a_run_is_told(fault: str, text: str) -> None:
    assert text in told(driven_run(duration=6.0, faults=(parse_fault(fault),)))


@pytest.mark.sampled
@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_a_run_is_recorded_as_its_sensors_saw_it_when_they_did(delay: float) -> None:
    specs = robot_sensors(slow().description)
    late = replace(specs, linear_velocity=replace(specs.linear_velocity, delay=delay))
    record = driven_run(duration=6.0, sensors=late)
    channels = run_recording(record, "run").channels
    for name, series, part in (
        ("position", "q", slice(3)),
        ("linear_velocity", "v", slice(3)),
        ("angular_velocity", "v", slice(3, 6)),
    ):
        channel = channels[name]
        spec = getattr(late, name)
        at = np.searchsorted(record["t"], channel.t - 1e-6)
        np.testing.assert_allclose(channel.values, record[series][at, part], atol=5.5 * spec.sigma)
        assert channel.rate == pytest.approx(min(spec.rate, 1.0 / record.run_meta.dt), rel=0.02)
    assert channels["attitude"].t[-1] == record["t"][-1]


def test_where_sensors_are_ideal_the_estimate_is_what_was_measured() -> None:
    assert not {*MEASURED} & run().series.keys()


@pytest.mark.slow
def test_numbers_from_default_sensors_lie_within_their_intervals() -> None:
    record = driven_run(duration=40.0, held=1.0, seed=1, sensors=robot_sensors(slow().description))
    learn = {
        "added_mass": {"free": ["surge", "sway", "heave"]},
        "quadratic_drag": {"free": ["surge", "sway", "heave"]},
    }
    noise = {"velocity": 0.002, "rate": 0.005, "vertical": 0.002}
    values = subject()[1].model_dump() | {
        "learn": learn,
        "noise": noise,
        "lag": LAG,
        "dead_zone": DEAD_ZONE,
    }
    robot_and_vehicle = calibrated_robot(
        settings := CalibrationSettings.model_validate(values), Path()
    )
    calibration = calibrate(robot_and_vehicle, settings, [run_recording(record, "run")])
    truth = values_of(robot_and_vehicle.vehicle, robot_and_vehicle.vehicle.shared.start)
    off = [
        (each.value - true) / each.sigma
        for each, true in zip(calibration.numbers, truth, strict=True)
    ]
    assert np.abs(off).max() < 3.0
    assert all(number.determined for number in calibration.numbers)


def test_a_fault_that_never_came_is_not_told() -> None:
    assert told(driven_run(duration=6.0, faults=(parse_fault("thruster2:dead@9"),))) == ""


def test_a_run_that_touched_the_floor_is_told() -> None:
    record = driven_run(duration=6.0, floor=-20.2, seed=3)
    assert "position: on the floor at " in told(record)
    assert record["contact"].any()


def columns_turned(recording: Recording, channel: str) -> Recording:
    one = recording.channel(channel)
    turned = replace(one, values=one.values[:, ::-1], columns=one.columns[::-1])
    return replace(recording, channels={**recording.channels, channel: turned})


def test_thrusters_go_by_their_names() -> None:
    recording = run_recording(run(), "run")
    vehicle = subject()[0].vehicle
    straight, turned = (
        PreparedRecording.of(one, vehicle)
        for one in (recording, columns_turned(recording, "thrust"))
    )
    np.testing.assert_array_equal(turned.commands.channel.values, straight.commands.channel.values)
    others = replace(recording.channel("thrust"), columns=tuple("abcdefgh"))
    with pytest.raises(InvalidInput, match=r"run: thrust is of a, b, .*; allowed: T1, T2"):
        PreparedRecording.of(
            replace(recording, channels={**recording.channels, "thrust": others}), vehicle
        )


def also_told(record: Record, **changed: object) -> str:
    subject_of_run, settings = subject()
    recording = run_recording(record, "run")
    changed_settings = CalibrationSettings.model_validate(settings.model_dump() | changed)
    return "; ".join(
        map(
            str,
            check_settings(
                calibrated_robot(changed_settings, Path()) if changed else subject_of_run,
                changed_settings,
                recording,
            ),
        )
    )


def test_a_strong_current_that_nothing_learns_is_refused_before_the_search() -> None:
    (one, settings), recording = subject(), run_recording(run(), "run")
    still = recording.channels["current"]
    flow = replace(still, values=still.values + np.array([0.1, 0.1, 0.0]))
    flowing = replace(recording, channels={**recording.channels, "current": flow})
    with pytest.raises(InvalidInput, match=r"run: a current of 0\.14 m/s.*learn it too"):
        calibrate(one, settings, [flowing])
    learning = CalibrationSettings.model_validate(
        settings.model_dump() | {"learn": {"current": {}}}
    )
    require_current(calibrated_robot(learning, Path()), flowing)
    require_current(one, recording)


def test_what_a_fit_neglects_is_told_and_nothing_else() -> None:
    assert also_told(run()) == ""
    flowing = driven_run(
        duration=6.0,
        environment=Environment(
            seafloor=FlatSeafloor(z=-40.0), current=UniformCurrent([0.2, 0.0, 0.0])
        ),
    )
    assert also_told(flowing) == "current: up to 0.2 m/s that a fit takes for still water: learn it"
    assert also_told(flowing, learn={"current": {}}) == ""
    assert (
        also_told(driven_run(duration=6.0, size=30.0))
        == "thrust: more is asked of T1, T2, T3, T4, T5, T6, T7, T8 than they can give: a fit takes"
        " it for given"
    )
    assert "thrust: commands of a run of this toolkit act at once" in also_told(run(), delay=0.05)
    assert also_told(run(), delay=0.05, learn={"lag": {}, "delay": {}}) == ""


def test_a_lag_that_is_not_given_begins_with_that_of_the_thrusters() -> None:
    values = {"robot": "girona_maris7_full", "hull": [[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]}
    settings = CalibrationSettings.model_validate(subject()[1].model_dump() | values)
    thrusters = load_robot("girona_maris7_full").description.thrusters
    for lag in (None, 0.3):
        begun_lag = calibrated_robot(
            settings.model_copy(update={"lag": lag}), Path()
        ).vehicle.actuators.lag
        assert begun_lag == pytest.approx(
            lag or np.mean([thruster.time_constant for thruster in thrusters])
        )


@pytest.mark.slow
@long_without_compiler
def test_a_wrench_of_our_controller_is_ahead_of_the_lag_and_that_is_told() -> None:
    record = bluerov_inspection(duration=2.0).run()
    settings = CalibrationSettings.model_validate(
        subject()[1].model_dump() | {"arm": "as it is", "commands": "wrench"}
    )
    doubt, *more = check_settings(
        calibrated_robot(settings, Path()), settings, run_recording(record, "run")
    )
    assert not more
    assert str(doubt).startswith("wrench: thrusters were driven ahead of their lag")


@pytest.mark.slow
def test_a_file_stays_as_it_was_where_it_holds_nothing_of_what_was_learnt(tmp_path: Path) -> None:
    result = calibrate(*subject(), [run_recording(run(), "run")])
    (tmp_path / "variant.yaml").write_text(variant_text(result, ["run"]))
    (tmp_path / "whole.yaml").write_text(whole_text(result, tmp_path / "variant.yaml"))
    assert read_description(tmp_path / "whole.yaml") == read_description(result.subject.file)


def test_the_folder_of_a_run_is_its_record(tmp_path: Path) -> None:
    """The results of a command, and the rows that a run writes while it goes on."""
    scenario = bluerov_inspection(noise=True, duration=0.5)
    record = scenario.run(folder=tmp_path / "rows")
    (tmp_path / "results").mkdir()
    record.save(tmp_path / "results" / "record.npz")
    expected = run_recording(record, "run")
    for name in ("rows", "results"):
        recording = read_recording(tmp_path / name)
        assert recording.channels.keys() == expected.channels.keys()
        np.testing.assert_array_equal(
            recording.channels["thrust"].values, expected.channels["thrust"].values
        )
