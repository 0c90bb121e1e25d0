"""Readings that must not be believed: what is no number, of the wrong time, or contradicts the
estimate; and the way back.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from uvms_ocp.errors import NameNotFound
from uvms_ocp.estimation.estimator import Estimator
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import (
    ACCELEROMETER,
    CHANNELS,
    IDEAL_SENSORS,
    Reading,
    Readings,
    SensorSpec,
    SensorSpecs,
    State,
    StateEstimate,
)
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.sensors import SensorSuite
from uvms_ocp.types import Array

DT = 0.01
SPECS = SensorSpecs(
    specific_force=ACCELEROMETER, joint_velocities=SensorSpec(rate=50.0, sigma=0.01)
)
JUMPS = {
    "position": np.array([50.0, 50.0, 0.0]),  # a depth that stays would contradict it
    "depth": 20.0,
    "attitude": 0.8,
    "angular_velocity": 3.0,
    "linear_velocity": 5.0,
    "joint_positions": 1.0,
    "joint_velocities": 5.0,
    "altimeter_range": 50.0,
    "specific_force": 30.0,
}


class AtRest:
    """A robot at rest, its sensors, and an estimator that is given what `spoil` makes of a
    channel's readings.
    """

    def __init__(self, specs: SensorSpecs = SPECS, seed: int = 0) -> None:
        self.robot: Robot = load_robot("girona_maris7")
        self.q = self.robot.configuration(position=(1.0, 2.0, -36.0))
        self.state = State(q=self.q, v=np.zeros(self.robot.n_v), a=np.zeros(self.robot.n_v))
        self.suite = SensorSuite(self.robot, FlatSeafloor(z=-40.0), specs, seed=seed)
        self.estimator = Estimator(self.robot, specs)
        self.k = 0

    def run(self, seconds, channel="", spoil=lambda reading: reading) -> StateEstimate:
        for _ in range(round(seconds / DT)):
            t = self.k * DT
            readings = self.suite.read(self.state, t)
            if channel and getattr(readings, channel) is not None:
                readings = replace(readings, **{channel: spoil(getattr(readings, channel))})
            measurement = self.estimator(readings, t)
            self.k = self.k + 1
        return measurement

    def error(self, measurement: StateEstimate) -> float:
        return float(np.abs(pin.difference(self.robot.model, self.q, measurement.q)).max())


def jumped(channel, share=1.0):
    def spoil(reading):
        size = share * JUMPS[channel]
        if channel == "attitude":
            turned = pin.Quaternion(reading.value) * pin.Quaternion(
                pin.exp3(np.array([0.0, 0.0, size]))
            )
            return Reading(value=turned.coeffs(), t=reading.t)
        return Reading(value=reading.value + size, t=reading.t)

    return spoil


@pytest.mark.parametrize("channel", CHANNELS)
def test_a_burst_of_what_is_no_number_leaves_no_trace(channel: str) -> None:
    robot_at_rest = AtRest()
    robot_at_rest.run(3.0)
    burst = robot_at_rest.run(
        0.5, channel, lambda reading: Reading(value=reading.value * np.nan, t=reading.t)
    )
    assert np.isfinite(burst.q).all()
    assert np.isfinite(burst.v).all()
    after = robot_at_rest.run(1.0)
    assert robot_at_rest.error(after) < 0.03
    assert after.age < 0.25


@pytest.mark.parametrize("channel", CHANNELS)
def test_a_reading_of_the_future_or_of_the_past_is_never_used(channel: str) -> None:
    robot_at_rest = AtRest()
    robot_at_rest.run(2.0)
    used = robot_at_rest.estimator.used(channel)
    jump = jumped(channel)
    for shift in (5.0, -3.0):
        robot_at_rest.run(
            0.3,
            channel,
            lambda reading, shift=shift: Reading(value=jump(reading).value, t=reading.t + shift),
        )
        assert robot_at_rest.estimator.used(channel) == used
    assert robot_at_rest.error(robot_at_rest.run(0.5)) < 0.03


@pytest.mark.parametrize("channel", CHANNELS)
def test_a_jump_is_refused_and_believed_only_where_it_lasts(channel: str) -> None:
    robot_at_rest = AtRest()
    robot_at_rest.run(3.0)
    before = robot_at_rest.estimator.used(channel)
    robot_at_rest.run(0.22, channel, jumped(channel))
    outcome = robot_at_rest.estimator.outcome(channel)
    assert outcome is not None
    assert not outcome.accepted
    assert outcome.squared > 25.0
    assert robot_at_rest.estimator.used(channel) == before
    assert robot_at_rest.error(robot_at_rest.run(0.3)) < 0.03
    if channel == "depth":
        return  # which position fixes contradict
    robot_at_rest.run(2.5, channel, jumped(channel))
    lasting = robot_at_rest.estimator.outcome(channel)
    assert lasting is not None
    assert lasting.accepted


def test_a_floor_that_comes_nearer_is_believed_at_once() -> None:
    robot_at_rest = AtRest()
    far = robot_at_rest.run(3.0).altimeter_range
    nearer = robot_at_rest.run(
        0.11, "altimeter_range", lambda reading: Reading(value=reading.value - 2.0, t=reading.t)
    ).altimeter_range
    assert nearer == pytest.approx(far - 2.0, abs=0.1)


def test_outcomes_tell_time_size_and_freedom() -> None:
    robot_at_rest = AtRest()
    assert robot_at_rest.estimator.outcome("position") is None
    robot_at_rest.run(2.0)
    degrees = {"depth": 1, "altimeter_range": 1, "joint_positions": 7, "joint_velocities": 7}
    for channel in CHANNELS:
        outcome = robot_at_rest.estimator.outcome(channel)
        assert outcome is not None
        assert outcome.t == robot_at_rest.estimator.used(channel) > 1.7
        assert outcome.degrees == degrees.get(channel, 3)
        assert outcome.accepted
    with pytest.raises(NameNotFound, match="sonar"):
        robot_at_rest.estimator.outcome("sonar")


def test_a_refused_channel_is_not_used_until_it_is_trusted_again() -> None:
    robot_at_rest = AtRest()
    robot_at_rest.run(2.0)
    used = robot_at_rest.estimator.used("position")
    robot_at_rest.estimator.refuse("position")
    assert robot_at_rest.run(1.0).age > 1.0
    assert robot_at_rest.estimator.used("position") == used
    robot_at_rest.estimator.refuse("position", False)
    assert robot_at_rest.run(0.5).age < 0.25


@pytest.mark.sampled
@pytest.mark.parametrize("seed", range(3))
def test_no_delay_makes_the_estimate_diverge(seed: int) -> None:
    """Of any channel, from 0 to 2 s, which the filter has not been told of."""
    robot_at_rest = AtRest(seed=seed)
    rng = np.random.default_rng(seed)
    late = {name: float(rng.uniform(0.0, 2.0)) for name in CHANNELS}
    past: dict[str, list[Reading]] = {name: [] for name in CHANNELS}
    for k in range(1200):
        t = k * DT
        readings = robot_at_rest.suite.read(robot_at_rest.state, t)
        arrived = {}
        for name in CHANNELS:
            past[name].append(getattr(readings, name))
            if t >= late[name]:
                arrived[name] = past[name][k - math.floor(late[name] / DT)]
        measurement = robot_at_rest.estimator(Readings(**arrived), t)
    error = pin.difference(robot_at_rest.robot.model, robot_at_rest.q, measurement.q)
    assert np.abs(error / measurement.std).max() < 5.0
    assert measurement.std.max() < 0.5
    assert np.abs(measurement.v).max() < 0.5
    assert measurement.age < 2.4


class Twins:
    """The filter in C and that in NumPy, of a robot at the origin, both given what `spoil` makes of
    the truth.
    """

    def __init__(self, specs: SensorSpecs) -> None:
        robot = load_robot("girona_maris7")
        self.both = Estimator(robot, specs), Estimator(robot, specs, compiled=False)
        truth = dict.fromkeys(CHANNELS, np.zeros(3)) | {
            "attitude": np.array([0.0, 0.0, 0.0, 1.0]),
            "depth": 0.0,
        }
        truth |= dict.fromkeys(("joint_positions", "joint_velocities"), np.zeros(robot.n_joints))
        truth |= {"altimeter_range": 5.0, "specific_force": np.array([0.0, 0.0, 9.81])}
        self.truth = {name: truth[name] for name in CHANNELS if getattr(specs, name) is not None}
        self.k = 0

    def run(self, seconds, dt, spoil=lambda name, value: value) -> list[StateEstimate]:
        for _ in range(round(seconds / dt)):
            t = self.k * dt
            values = {name: spoil(name, value) for name, value in self.truth.items()}
            readings = Readings(
                **{name: Reading(value=value, t=t) for name, value in values.items()}
            )
            told = [estimator(readings, t) for estimator in self.both]
            self.k = self.k + 1
        return told

    def are_finite(self, told: list[StateEstimate]) -> bool:
        numbers = [part for m in told for part in (m.q, m.v, m.std, m.altimeter_range)]
        numbers += [part for e in self.both for part in (e.memory.x, e.covariance)]
        return all(np.isfinite(part).all() for part in numbers)


@pytest.mark.slow
@pytest.mark.parametrize("size", [np.nan, np.inf, -1.0, 1e200, -1e200, 1e6])
@pytest.mark.parametrize("channel", CHANNELS)
def test_no_number_leaves_an_estimate_that_is_not_finite(channel: str, size: float) -> None:
    """For one reading or for 1.5 s, of a filter that nothing guards; the last size is believed
    after a while.
    """
    twins = Twins(SPECS)
    twins.run(0.5, 0.1)
    parts = ("q", "v", "std", "age", "altimeter_range")
    if size == 1e6:  # what is left of 1e6 m after a jump back is rounding
        parts = ("age",)

    def jumped(name: str, value: np.ndarray | float) -> np.ndarray | float:
        return value * 0.0 + size if name == channel else value

    for seconds in (0.1, 1.5):
        twins.run(seconds, 0.1, jumped)
        told = twins.run(2.0, 0.1)
        assert twins.are_finite(told)
        for part in parts:
            np.testing.assert_allclose(
                getattr(told[0], part), getattr(told[1], part), rtol=1e-9, atol=1e-9, err_msg=part
            )


@pytest.mark.parametrize("value", [-1.0, np.inf, -np.inf, 1e200, -1e200])
def test_a_range_that_cannot_be_is_no_echo_and_no_answer(value: float) -> None:
    twins = Twins(SPECS)
    before = twins.run(1.0, 0.1)
    used = [estimator.used("altimeter_range") for estimator in twins.both]
    told = twins.run(0.5, 0.1, lambda name, true: value if name == "altimeter_range" else true)
    assert [estimator.used("altimeter_range") for estimator in twins.both] == used
    for after, then in zip(told, before, strict=True):
        assert after.altimeter_range == pytest.approx(then.altimeter_range, abs=1e-6)
    twins.run(0.1, 0.1, lambda name, true: np.nan if name == "altimeter_range" else true)
    assert all(estimator.used("altimeter_range") > 1.4 for estimator in twins.both)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("channel", "jump"),
    [
        ("position", np.array([10.0, 0.0, 0.0])),
        ("position", 300.0),
        ("depth", 1e3),
        ("linear_velocity", 300.0),
    ],
)
def test_exact_sensors_that_jump_and_come_back_are_followed(
    channel: str, jump: Array | float
) -> None:
    twins = Twins(IDEAL_SENSORS)
    told = twins.run(1.0, 0.02)
    for _ in range(75):
        told = twins.run(0.02, 0.02, lambda name, value: value + jump if name == channel else value)
        assert twins.are_finite(told)
    for _ in range(125):
        told = twins.run(0.02, 0.02)
        assert twins.are_finite(told)
    for measurement in told:
        assert np.abs(measurement.q[:3]).max() < 1e-3
        assert np.abs(measurement.v).max() < 1e-2


@pytest.mark.sampled
@pytest.mark.parametrize("delay", [0.0, pytest.param(0.3, marks=pytest.mark.slow), 1.0])
def test_late_readings_find_the_estimate_again_after_a_long_silence(delay: float) -> None:
    """When the filter knows nothing any more, however late what is read is."""
    twins = Twins(SPECS)
    dt = 0.05
    for k in range(round(75.0 / dt)):
        t = k * dt
        is_silent = t < delay or 5.0 <= t < 65.0
        values = {} if is_silent else twins.truth
        readings = Readings(
            **{name: Reading(value=value, t=t - delay) for name, value in values.items()}
        )
        estimators = twins.both if delay == 0.3 else twins.both[:1]
        measurement, *twin = [estimator(readings, t) for estimator in estimators]
        for expected in twin:
            for part in ("q", "v", "std", "age"):
                np.testing.assert_allclose(
                    getattr(measurement, part), getattr(expected, part), rtol=1e-7, atol=1e-7
                )
    assert measurement.age < delay + 0.3
    assert measurement.std.max() < 0.5
    assert np.abs(measurement.v).max() < 0.1
    assert measurement.altimeter_range == pytest.approx(5.0, abs=0.1)
