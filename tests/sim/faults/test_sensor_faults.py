"""Laws of sensor faults: what each kind does to the readings, nothing before its onset, nothing
after its end.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from fault_registry import ENCODERS, SENSORS

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import CHANNELS, Reading, SensorSpec, SensorSpecs, State
from uvms_ocp.sim import parse_fault
from uvms_ocp.sim.fault_effects import SAMPLE_EFFECTS, Sample
from uvms_ocp.sim.faults import FAMILIES, FaultModel, ValueRange, parse_faults
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.sensors import SensorSuite

DT = 0.01
RATE = 20.0
DELAY = 0.03
ONSET = 1.0
END = 2.0
DURATION = 3.5
SPEC = SensorSpec(rate=RATE, sigma=0.01, delay=DELAY)
SPECS = SensorSpecs(**dict.fromkeys(CHANNELS, SPEC))
SENSOR_TEXTS = [text for texts in SENSORS.values() for text in texts] + ENCODERS
Series = list[Reading[Any] | None]


@pytest.fixture(scope="module", name="robot")
def _robot() -> Robot:
    return load_robot("girona_maris7")


def channel_of(text: str) -> str:
    return parse_fault(text).location.channel


def readings(
    robot: Robot,
    texts: list[str],
    channel: str,
    *,
    duration: float = DURATION,
    specs: SensorSpecs = SPECS,
) -> Series:
    """Of one channel at every tick, while the robot moves."""
    suite = SensorSuite(robot, FlatSeafloor(z=-40.0), specs, seed=3, faults=parse_faults(texts))
    start = robot.configuration(position=(1.0, 2.0, -36.0), rpy=(0.1, -0.06, 0.5))
    v = np.linspace(0.01, 0.02, robot.n_v)
    states = (
        State(q=pin.integrate(robot.model, start, v * k * DT), v=v * k, a=v / DT)
        for k in range(round(duration / DT))
    )
    return [getattr(suite.read(state, k * DT), channel) for k, state in enumerate(states)]


def same(a: Reading[Any] | None, b: Reading[Any] | None) -> bool:
    if a is None or b is None:
        return a is b
    return a.t == b.t and np.array_equal(a.value, b.value, equal_nan=True)


def fresh(series: Series) -> list[Reading[Any]]:
    """The different readings in order of arrival."""
    fresh_readings = [reading for reading in series if reading is not None]
    return [b for a, b in pairwise([None, *fresh_readings]) if b is not a]


def struck(series: Series) -> list[Reading[Any]]:
    """Those that were taken while the fault was there, by their stamps."""
    return [reading for reading in fresh(series) if ONSET <= reading.t < END]


def test_each_kind_of_the_table_has_one_effect() -> None:
    assert set(FAMILIES["sensor"]) == set(SAMPLE_EFFECTS)
    assert set(FAMILIES["encoder"]) <= set(SAMPLE_EFFECTS)


def test_a_new_kind_is_a_row_and_a_function(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    def shortened(sample: Sample, channel_fault: Any) -> Sample:
        return channel_fault.with_value(sample, channel_fault.fault.values[0] * sample.value)

    row = FaultModel(effect="reads a share", values=(ValueRange(what="share [-]", lower=0.0),))
    monkeypatch.setitem(FAMILIES["sensor"], "shortened", row)
    monkeypatch.setitem(SAMPLE_EFFECTS, "shortened", shortened)
    sound = fresh(readings(robot, [], "depth"))
    faulty = fresh(readings(robot, [f"depth:shortened=0.5@{ONSET}-{END}"], "depth"))
    for before, after in zip(sound, faulty, strict=True):
        share = 0.5 if ONSET <= before.t < END else 1.0
        assert after.value == pytest.approx(share * before.value)


@pytest.mark.parametrize("text", SENSOR_TEXTS)
def test_nothing_changes_before_the_onset(text: str, robot: Robot) -> None:
    channel = channel_of(text)
    sound, faulty = (readings(robot, texts, channel) for texts in ([], [f"{text}@{ONSET}-{END}"]))
    before = round((ONSET + DELAY) / DT)
    assert all(same(a, b) for a, b in zip(sound[:before], faulty[:before], strict=True))
    assert not all(same(a, b) for a, b in zip(sound, faulty, strict=True))


@pytest.mark.parametrize("text", SENSOR_TEXTS)
def test_all_is_well_again_after_the_end(text: str, robot: Robot) -> None:
    channel = channel_of(text)
    sound, faulty = (readings(robot, texts, channel) for texts in ([], [f"{text}@{ONSET}-{END}"]))
    after = round((END + 1 / RATE + DELAY) / DT)
    assert all(same(a, b) for a, b in zip(sound[after:], faulty[after:], strict=True))


@pytest.mark.parametrize("text", SENSOR_TEXTS)
def test_other_channels_do_not_notice(text: str, robot: Robot) -> None:
    sound_channel = "depth" if channel_of(text) != "depth" else "position"
    sound, faulty = (readings(robot, texts, sound_channel) for texts in ([], [f"{text}@{ONSET}"]))
    assert all(same(a, b) for a, b in zip(sound, faulty, strict=True))


def sound_and_struck(
    robot: Robot, channel: str, kind: str
) -> list[tuple[Reading[Any], Reading[Any]]]:
    """Pairs of readings that were taken at the same time while the fault was there."""
    sound, faulty = (
        readings(robot, texts, channel) for texts in ([], [f"{channel}:{kind}@{ONSET}-{END}"])
    )
    pairs = list(zip(struck(sound), struck(faulty), strict=True))
    assert len(pairs) == round(RATE * (END - ONSET))
    assert all(a.t == b.t for a, b in pairs)
    return pairs


@pytest.mark.parametrize("channel", CHANNELS)
def test_frozen_repeats_the_last_value_with_new_stamps(channel: str, robot: Robot) -> None:
    last = [reading for reading in fresh(readings(robot, [], channel)) if reading.t < ONSET - 1e-9][
        -1
    ]
    for a, b in sound_and_struck(robot, channel, "frozen"):
        np.testing.assert_array_equal(b.value, last.value)
        assert not np.array_equal(a.value, b.value)


@pytest.mark.parametrize("channel", CHANNELS)
def test_lost_delivers_nothing_new(channel: str, robot: Robot) -> None:
    series = readings(robot, [f"{channel}:lost@{ONSET}"], channel)
    assert series[-1] is not None
    assert series[-1].t == pytest.approx(ONSET - 1 / RATE)


@pytest.mark.parametrize("channel", CHANNELS)
def test_nan_is_no_number_in_any_component(channel: str, robot: Robot) -> None:
    for _, b in sound_and_struck(robot, channel, "nan"):
        assert np.isnan(b.value).all()


def error_of(channel: str, robot: Robot, sound: Any, faulty: Any) -> np.ndarray:
    """In the tangent space."""
    if channel == "attitude":
        return pin.log3((pin.Quaternion(sound).inverse() * pin.Quaternion(faulty)).matrix())
    return np.atleast_1d(faulty - sound)


@pytest.mark.parametrize("channel", CHANNELS)
def test_bias_is_off_by_its_offset(channel: str, robot: Robot) -> None:
    for a, b in sound_and_struck(robot, channel, "bias=0.25"):
        np.testing.assert_allclose(error_of(channel, robot, a.value, b.value), 0.25, atol=1e-9)


def test_bias_may_be_given_for_each_component(robot: Robot) -> None:
    for a, b in sound_and_struck(robot, "position", "bias=5,0,-1"):
        np.testing.assert_allclose(b.value - a.value, [5.0, 0.0, -1.0], atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("channel", CHANNELS)
def test_spikes_are_as_large_and_as_frequent_as_asked_for(channel: str, robot: Robot) -> None:
    share = 0.3
    size = 0.7
    specs = replace(SPECS, **{channel: SensorSpec(rate=100.0, sigma=0.01)})
    sound, faulty = (
        fresh(readings(robot, texts, channel, duration=20.0, specs=specs))
        for texts in ([], [f"{channel}:spikes={size},{share}"])
    )
    errors = np.array(
        [error_of(channel, robot, a.value, b.value) for a, b in zip(sound, faulty, strict=True)]
    )
    norms = np.linalg.norm(errors, axis=1)
    spiked = norms > 1e-12
    np.testing.assert_allclose(norms[spiked], size, atol=1e-9)
    assert abs(spiked.mean() - share) < 4 * math.sqrt(share * (1 - share) / len(spiked))
    assert (np.count_nonzero(np.abs(errors) > 1e-9, axis=1) <= 1).all()
    assert (errors.max(axis=0) > 0.5 * size).all()
    assert (errors.min(axis=0) < -0.5 * size).all()
    again = fresh(
        readings(robot, [f"{channel}:spikes={size},{share}"], channel, duration=20.0, specs=specs)
    )
    assert all(same(a, b) for a, b in zip(faulty, again, strict=True))


@pytest.mark.parametrize("channel", CHANNELS)
def test_late_readings_arrive_when_promised_and_tell_when_they_were_taken(
    channel: str, robot: Robot
) -> None:
    extra = 0.2
    sound, faulty = (
        readings(robot, texts, channel) for texts in ([], [f"{channel}:late={extra}@{ONSET}"])
    )
    by_stamp = {reading.t: reading for reading in fresh(sound)}
    for k, reading in enumerate(faulty):
        t = k * DT
        if reading is not None:
            np.testing.assert_array_equal(reading.value, by_stamp[reading.t].value)
        if t >= ONSET + DELAY + extra:
            assert reading is not None
            assert DELAY + extra - 1e-9 <= t - reading.t < DELAY + extra + 1 / RATE + 1e-9


def test_a_reading_that_was_overtaken_is_not_delivered_any_more(robot: Robot) -> None:
    stamps = [
        reading.t for reading in fresh(readings(robot, [f"depth:late=1@{ONSET}-{END}"], "depth"))
    ]
    assert stamps == sorted(stamps)


@pytest.mark.parametrize("channel", CHANNELS)
def test_stuck_reads_one_value(channel: str, robot: Robot) -> None:
    zero = np.array([0.0, 0.0, 0.0, 1.0]) if channel == "attitude" else 0.0
    for _, b in sound_and_struck(robot, channel, "stuck=0.4"):
        np.testing.assert_allclose(error_of(channel, robot, zero, b.value), 0.4, atol=1e-12)


@pytest.mark.parametrize("channel", CHANNELS)
def test_a_clock_that_is_ahead_stamps_readings_with_the_future(channel: str, robot: Robot) -> None:
    sound, faulty = (
        fresh(readings(robot, texts, channel)) for texts in ([], [f"{channel}:ahead=2.5@{ONSET}"])
    )
    for a, b in zip(sound, faulty, strict=True):
        assert b.t == pytest.approx(a.t + (2.5 if a.t >= ONSET - 1e-9 else 0.0))
        np.testing.assert_array_equal(a.value, b.value)


@pytest.mark.parametrize("text", ENCODERS)
def test_a_single_encoder_leaves_the_others_alone(text: str, robot: Robot) -> None:
    channel = channel_of(text)
    sound, faulty = (
        struck(readings(robot, texts, channel)) for texts in ([], [f"{text}@{ONSET}-{END}"])
    )
    differs = np.array([a.value != b.value for a, b in zip(sound, faulty, strict=True)])
    assert differs[:, 2].any()
    assert not np.delete(differs, 2, axis=1).any()


def test_faults_of_one_channel_act_one_after_the_other(robot: Robot) -> None:
    combined = fresh(readings(robot, ["depth:stuck=1", "depth:bias=0.5"], "depth"))
    assert {reading.value for reading in combined} == {1.5}


def test_joints_that_are_no_vector_space_stay_on_their_manifold() -> None:
    robot = load_robot("bluerov2_alpha5")
    for text in (
        "joint_positions:bias=0.3@0",
        "joint_positions:stuck=0.4@0",
        "joint1_position:spikes=1,1@0",
    ):
        value = fresh(readings(robot, [text], "joint_positions"))[-1].value
        q = robot.configuration().copy()
        q[robot.joint_q] = value
        np.testing.assert_allclose(pin.normalize(robot.model, q), q, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "joint_velocities:frozen",
            "there is no sensor joint_velocities; there are position, depth",
        ),
        ("joint9_position:frozen", "the robot has 7 joints; give one of them, from 1"),
        ("position:bias=1,2", "position:bias=1,2@0: 2 values; give 1 or 3"),
        ("joint3_position:stuck=1,2", "2 values; give 1 or 1"),
    ],
)
def test_a_sensor_that_is_not_there_is_refused(text: str, told: str, robot: Robot) -> None:
    with pytest.raises(InvalidInput) as error:
        SensorSuite(robot, FlatSeafloor(z=-40.0), SensorSpecs(), faults=parse_faults([text]))
    assert told in str(error.value)
    assert "\n" not in str(error.value)
