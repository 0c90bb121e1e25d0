"""The estimate over a recording is that of the run, and says how well each sensor agrees with
it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from uvms_ocp.cli.commands import app
from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification.reading import read_recording
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.record.record import Record
from uvms_ocp.robot import Command, Reading, Readings, StateEstimate, load_robot
from uvms_ocp.robot.signals import robot_sensors
from uvms_ocp.robot.spatial import continuous_quaternions
from uvms_ocp.scenario import Scenario, estimate_recording, reach
from uvms_ocp.scenario.cases import SCENARIOS
from uvms_ocp.scenario.log_expectations import expectations_of_log
from uvms_ocp.sim import parse_fault

OF_THE_ESTIMATE = (
    "q_estimated",
    "v_estimated",
    "q_std",
    "altimeter_range",
    "altimeter_std",
    "health",
)
FAULTS = (
    "position:bias=0.5@2-4",
    "joint_positions:lost@1-4",
    "attitude:late=0.2@2",
    "altimeter:frozen@2",
    "depth:nan@1-3",
)
FAULTS_OF_SCENARIOS = {
    "case1": "thruster3:dead@3",
    "case2": "altimeter:frozen@2",
    "bluerov_inspection": "position:bias=0.5@2-4",
    "transit": "attitude:late=0.2@2",
    "two_targets": "joint_positions:lost@1-4",
}


def mission(**options: object) -> Scenario:
    return reach(noise=True, duration=5.0, **options)


@pytest.fixture(scope="module")
def sound() -> Record:
    return mission().run()


def require_the_same(run: Record, found: Record) -> None:
    for name in OF_THE_ESTIMATE:
        assert np.array_equal(run[name], found[name], equal_nan=run[name].dtype.kind == "f"), name
    outputs = [
        (alarm.t, alarm.text)
        for alarm in run.run_meta.alarms
        if alarm.text.partition(" ")[0] in run.run_meta.channels
    ]
    assert outputs == [(alarm.t, alarm.text) for alarm in found.run_meta.alarms]


def replayed(record: Record, scenario: Scenario) -> Iterator[StateEstimate]:
    """The estimate at every tick."""
    estimator = scenario.estimator()
    last = {}
    command = None
    for k, t in enumerate(record["t"].tolist()):
        for channel in record.run_meta.channels:
            *value, stamp = record.series[f"measured_{channel}"][k].tolist()
            if np.isfinite(stamp):
                scalar = channel in ("depth", "altimeter_range")
                last[channel] = Reading(value=value[0] if scalar else np.array(value), t=stamp)
        yield estimator(Readings(**last), t, command)
        command = Command(v=record.series["command"][k], brakes=bool(record.series["brakes"][k]))


def require_the_same_by_hand(record: Record, scenario: Scenario) -> None:
    for k, estimate in enumerate(replayed(record, scenario)):
        trusts = [channel.trust for channel in estimate.health]
        for name, value in (
            ("q_estimated", estimate.q),
            ("v_estimated", estimate.v),
            ("q_std", estimate.std),
            ("health", trusts),
        ):
            assert np.array_equal(value, record.series[name][k]), (name, k)
        assert np.array_equal(
            estimate.altimeter_range, record.series["altimeter_range"][k], equal_nan=True
        )


@pytest.mark.sampled
@pytest.mark.parametrize("fault", FAULTS)
def test_over_the_record_of_a_run_it_is_that_of_the_run(fault: str) -> None:
    scenario = mission(faults=fault)
    run = scenario.run()
    result = estimate_recording(run, scenario.robot)
    assert result.same
    require_the_same(run, result.record)
    require_the_same_by_hand(run, scenario)


@pytest.mark.slow
@pytest.mark.parametrize("name", FAULTS_OF_SCENARIOS)
def test_over_the_record_of_every_scenario(name: str) -> None:
    scenario = SCENARIOS[name](noise=True, duration=5.0, faults=FAULTS_OF_SCENARIOS[name])
    run = scenario.run()
    require_the_same(run, estimate_recording(run, scenario.robot).record)
    require_the_same_by_hand(run, scenario)


def test_over_a_record_that_was_saved_with_rows_on_the_disk(sound: Record, tmp_path: Path) -> None:
    sound.save(tmp_path / "record.npz")
    result = estimate_recording(
        Record.load(tmp_path / "record.npz"), mission().robot, folder=tmp_path / "rows"
    )
    assert result.same
    result.record.save(tmp_path / "estimate.npz")
    require_the_same(sound, Record.load(tmp_path / "estimate.npz"))


def test_a_fault_on_top_is_what_the_run_with_it_would_have_read(sound: Record) -> None:
    """Commands are those of the sound run, so that the same holds until the fault has moved the
    vehicle.
    """
    fault = "depth:bias=2@1"
    faulty = mission(faults=fault).run()
    result = estimate_recording(sound, mission().robot, faults=(parse_fault(fault),))
    first = int(np.argmax(faulty["health"].any(axis=1)))
    assert result.same is False
    assert first > 0
    assert np.array_equal(result.record["q_estimated"][:first], faulty["q_estimated"][:first])
    depth = next(row for row in result.channels if row["channel"] == "depth")
    assert depth["lost_s"] > 0.0
    assert depth["first_s"] == pytest.approx(faulty["t"][first])


def test_channels_of_others_are_estimated_from_what_they_read(sound: Record) -> None:
    robot = mission().robot
    channels = {}
    for channel in (
        "position",
        "attitude",
        "linear_velocity",
        "angular_velocity",
        "joint_positions",
    ):
        rows = sound[f"measured_{channel}"]
        rows = rows[np.isfinite(rows).all(axis=1)]
        channels[channel] = Channel(t=1.7e9 + rows[:, -1], values=rows[:, :-1])
    estimate = estimate_recording(Recording(name="dive", channels=channels), robot).record
    rows = min(len(estimate), len(sound))
    late = slice(200, rows)
    assert set(estimate.run_meta.channels) == set(channels)
    assert "q" not in estimate.series
    error = np.abs(estimate["q_estimated"][late, :3] - sound["q"][late, :3])
    assert (error <= 5.0 * estimate["q_std"][late, :3]).all(), error.max(axis=0)


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["attitude", "angular_velocity"])
def test_a_channel_of_others_that_is_slower_than_the_robot_s_is_not_silent(
    name: str, sound: Record
) -> None:
    robot = mission().robot
    channels = {}
    for channel in ("position", "attitude", "linear_velocity", "angular_velocity"):
        rows = sound[f"measured_{channel}"]
        rows = rows[np.isfinite(rows).all(axis=1)]
        if channel == name:
            rows = rows[::10]
        channels[channel] = Channel(t=rows[:, -1], values=rows[:, :-1])
    joints = sound["measured_joint_positions"]
    joints = joints[np.isfinite(joints).all(axis=1)]
    channels["joint_positions"] = Channel(t=joints[:, -1], values=joints[:, :-1])
    estimate = estimate_recording(Recording(name="dive", channels=channels), robot).record
    alarms = [alarm.text for alarm in estimate.run_meta.alarms]
    assert not [text for text in alarms if text.startswith(name)], alarms


def drawn_log(
    rng: np.random.Generator, rates: Mapping[str, float], slow: Mapping[str, float]
) -> tuple[Recording, np.ndarray]:
    """Draw a vehicle that swims and turns for 40 s, and what its sensors read; return its true
    positions (n, 3) [m] every 5 ms, too.

    rates: [Hz] of the channels. slow: standard deviations [unit of the channel] of errors that change
    within five seconds, beside the white ones.
    """
    t = np.arange(0.0, 40.0, 0.005)
    size = rng.uniform(0.1, 1.0) * np.array([0.5, 0.4, 0.3, 0.25, 0.2, 0.8])
    frequency = rng.uniform(0.3, 1.2, size=6)
    phase = frequency * t[:, None] + rng.uniform(0.0, 6.0, size=6)
    wave = size * np.sin(phase)
    change = size * frequency * np.cos(phase)
    attitude = Rotation.from_euler("ZYX", wave[:, [5, 4, 3]])
    turning = []
    for angles, angle_rates in zip(wave, change, strict=True):
        to_turning = pin.rpy.computeRpyJacobian(angles[3:], pin.LOCAL)
        turning.append(to_turning @ angle_rates[3:])
    position = wave[:, :3] + [0.0, 0.0, -5.0]
    truth = {
        "position": position,
        "attitude": attitude.as_quat(),
        "linear_velocity": attitude.inv().apply(change[:, :3]),
        "angular_velocity": np.array(turning),
    }
    sigmas = {
        "position": 10 ** rng.uniform(-2.5, -0.5),
        "attitude": 10 ** rng.uniform(-3.5, -2.0),
        "linear_velocity": 10 ** rng.uniform(-3.0, -1.0),
        "angular_velocity": 10 ** rng.uniform(-3.0, -1.5),
    }
    channels = {}
    for name, values in truth.items():
        stride = round(200.0 / rates[name])
        n = len(values[::stride])
        error = sigmas[name] * rng.normal(size=(n, 3))
        decay = np.exp(-1.0 / (5.0 * rates[name]))
        drift = np.zeros(3)
        for k in range(n):
            kick = slow.get(name, 0.0) * np.sqrt(1.0 - decay**2) * rng.normal(size=3)
            drift = decay * drift + kick
            error[k] += drift
        if name == "attitude":
            turned = Rotation.from_quat(values[::stride]) * Rotation.from_rotvec(error)
            read = continuous_quaternions(turned.as_quat())
        else:
            read = values[::stride] + error
        channels[name] = Channel(t=t[::stride], values=read)
    return Recording(name="dive", channels=channels), position


@pytest.mark.sampled
@pytest.mark.parametrize("rate", [10.0, 50.0])
@pytest.mark.parametrize("seed", range(3))
def test_innovations_of_a_log_are_as_expected_whatever_its_sensors(seed: int, rate: float) -> None:
    """The robot's file says other rates, and other noise, of all of them."""
    rates = {
        "position": 4.0,
        "attitude": rate,
        "linear_velocity": 5.0,
        "angular_velocity": rate,
    }
    log, position = drawn_log(np.random.default_rng(seed), rates, {})
    result = estimate_recording(log, load_robot("bluerov2"))
    for row in result.channels:
        assert 0.7 < row["ratio"] < 1.4, row
        assert row["lost_s"] == 0.0, row
    late = slice(2_000, min(len(result.record), len(position)))
    error = result.record["q_estimated"][late, :3] - position[late]
    normalised = error / result.record["q_std"][late, :3]
    # Errors of a position change slowly: these are few independent ones.
    assert np.sqrt(np.mean(normalised**2)) < 2.5


@pytest.mark.sampled
@pytest.mark.parametrize(
    "slow",
    [{"attitude": 0.01}, {"position": 0.2}, {"linear_velocity": 0.03}, {"angular_velocity": 0.02}],
)
def test_errors_that_are_not_white_are_found_by_innovations(slow: Mapping[str, float]) -> None:
    rates = {"position": 5.0, "attitude": 50.0, "linear_velocity": 5.0, "angular_velocity": 50.0}
    log, _ = drawn_log(np.random.default_rng(5), rates, slow)
    result = estimate_recording(log, load_robot("bluerov2"))
    for row in result.channels:
        assert 0.6 < row["ratio"] < 1.4, row
        assert row["lost_s"] == 0.0, row


def test_of_a_channel_with_few_samples_the_robot_s_file_says_the_noise() -> None:
    rates = {"position": 1.0, "attitude": 10.0, "linear_velocity": 5.0, "angular_velocity": 10.0}
    log, _ = drawn_log(np.random.default_rng(0), rates, {})
    robot = load_robot("bluerov2")
    sparse = replace(
        log.channels["position"],
        t=log.channels["position"].t[::2],
        values=log.channels["position"].values[::2],
    )
    specs = expectations_of_log(
        replace(log, channels={**log.channels, "position": sparse}),
        robot,
        robot_sensors(robot.description),
        0.005,
    ).specs
    position = robot_sensors(robot.description).position
    assert position is not None
    assert specs.position == replace(position, rate=0.5, delay=0.0)
    assert specs.depth is None


def test_a_log_is_read_when_it_came_and_expected_as_late_as_its_mapping_says() -> None:
    rates = {"position": 5.0, "attitude": 50.0, "linear_velocity": 5.0, "angular_velocity": 50.0}
    log, _ = drawn_log(np.random.default_rng(1), rates, {})
    position = log.channels["position"]
    late = replace(position, t=position.t + 0.4, delay=0.4)
    result = estimate_recording(
        replace(log, channels={**log.channels, "position": late}), load_robot("bluerov2")
    )
    rows = {row["channel"]: row for row in result.channels}
    assert rows["position"]["delay_s"] == pytest.approx(0.4, abs=0.005)
    assert 0.7 < rows["position"]["ratio"] < 1.4
    assert rows["position"]["lost_s"] == 0.0


def test_noise_that_is_larger_than_expected_is_proposed() -> None:
    scenario = mission()
    expected = robot_sensors(scenario.robot.description)
    real = replace(
        expected, attitude=replace(expected.attitude, sigma=3.0 * expected.attitude.sigma)
    )
    louder = estimate_recording(replace(scenario, real_sensors=real).run(), scenario.robot)
    rows = {row["channel"]: row for row in louder.channels}
    assert rows["attitude"]["ratio"] == pytest.approx(3.0, rel=0.25)
    assert rows["attitude"]["proposed_sigma"] == pytest.approx(
        3.0 * expected.attitude.sigma, rel=0.25
    )
    assert all(row["ratio"] < 1.25 for name, row in rows.items() if name != "attitude")


def test_the_delay_of_readings_is_told(sound: Record) -> None:
    expected = robot_sensors(mission().robot.description)
    for row in estimate_recording(sound, mission().robot).channels:
        spec = getattr(expected, row["channel"])
        assert row["delay_s"] == pytest.approx(spec.delay, abs=1.0 / 200)


def test_what_cannot_be_estimated_is_refused_in_one_line(sound: Record) -> None:
    robot = mission().robot
    for wrong, text in (
        (
            lambda: estimate_recording(reach(duration=0.05).run(), robot),
            "record it anew, with noise",
        ),
        (
            lambda: estimate_recording(sound, robot, faults=(parse_fault("thruster1:dead"),)),
            "give those of sensors",
        ),
        (lambda: estimate_recording(sound, SCENARIOS["case1"]().robot), "give the robot recorded"),
    ):
        with pytest.raises(InvalidInput, match=text) as raised:
            wrong()
        assert "\n" not in str(raised.value)


def test_the_command_says_that_it_is_the_estimate_of_the_run(sound: Record, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    sound.save(tmp_path / "run" / "record.npz")
    words = [
        "estimate",
        str(tmp_path / "run"),
        "--out",
        str(tmp_path / "out"),
        "--robot",
        sound.meta.robot,
    ]
    process = CliRunner().invoke(app, words)
    assert process.exit_code == 0, process.output
    assert "the estimate is that of the run" in process.output
    written = {
        path.name
        for path in (tmp_path / "out").rglob("*")
        if path.is_file() and ".uvms_ocp" not in path.parts
    }
    assert written == {"record.npz", "report.json", "estimate.png", "health.png"}
    assert Record.load(tmp_path / "out" / "record.npz").run_meta.plant == "recorded"


def test_a_table_of_a_run_is_refused_for_it_has_estimates_in_place_of_readings(
    sound: Record, tmp_path: Path
) -> None:
    sound.save(tmp_path / "record.npz")
    with pytest.raises(InvalidInput, match=r"record\.npz, which has the readings"):
        estimate_recording(read_recording(tmp_path / "record.npz"), mission().robot)
