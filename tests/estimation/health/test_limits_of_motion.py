"""Whatever a robot may do by its limits, or does not do although it is told to, no sound sensor is
doubted for it.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import yaml
from corruptors import with_defect
from edited_robots import load_edited
from health_run import FLOOR, HealthRun, Motion, between

from uvms_ocp.estimation.estimator import Estimator
from uvms_ocp.estimation.health.guarded_estimator import GuardedEstimator
from uvms_ocp.robot.loading import load_robot, robot_folder
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Command, Readings, SensorSpecs, State, Trust
from uvms_ocp.robot.unasked_acceleration import unasked_acceleration
from uvms_ocp.sim.sensors import SensorSuite

HALF = 0.4  # [s] in which joints and vehicle speed up, and slow down


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load_robot("girona_maris7")


def shuttling(robot: Robot, axes: slice) -> Motion:
    """To and fro at the acceleration limits of some axes."""
    a = np.zeros(robot.n_v)
    a[axes] = robot.limits.acceleration[axes] * np.where(np.arange(robot.n_v)[axes] % 2, 1.0, -1.0)
    return lambda t: a * HALF * (2.0 * abs((t / (2.0 * HALF) + 0.5) % 2.0 - 1.0) - 1.0)


def braking(robot: Robot, axes: slice) -> Motion:
    """Steady, at rest from 3 s on, all at once."""
    v = np.zeros(robot.n_v)
    v[axes] = 0.3
    return lambda t: v * (t < 3.0)


def rest(robot: Robot) -> Motion:
    return lambda t: np.zeros(robot.n_v)


def gentle(name: str) -> Robot:
    """A shipped robot whose file limits accelerations of its vehicle to 0.3 m/s2 and 0.4 rad/s2."""
    folder = robot_folder(name)
    data = yaml.safe_load((folder / "hydrodynamics.yaml").read_text(encoding="utf-8"))
    data["vehicle_limits"]["acceleration"] = [0.3, 0.3, 0.3, 0.4, 0.4, 0.4]
    return load_edited(ET.parse(folder / "robot.urdf"), data)


VEHICLE = slice(0, 6)
JOINTS = slice(6, None)


@pytest.mark.sampled
@pytest.mark.parametrize("axes", [VEHICLE, JOINTS], ids=["vehicle", "joints"])
def test_motion_at_the_limits_of_acceleration_is_believed(robot: Robot, axes: slice) -> None:
    assert HealthRun(robot, duration=8.0, motion=shuttling(robot, axes)).guard.monitor.alarms == []


@pytest.mark.sampled
@pytest.mark.parametrize("axes", [slice(i, i + 1) for i in range(6)] + [JOINTS], ids=str)
def test_motion_at_the_limits_that_nobody_asked_for_is_believed(robot: Robot, axes: slice) -> None:
    """Of one axis of the vehicle at a time: no thrusters give all at once."""
    run = HealthRun(robot, duration=6.0, motion=shuttling(robot, axes), requested=rest(robot))
    assert run.guard.monitor.alarms == []


@pytest.mark.sampled
@pytest.mark.parametrize("axis", range(3))
def test_what_weight_and_one_thruster_do_is_believed_of_a_robot_that_is_told_less(
    axis: int,
) -> None:
    """Speed for HALF, and rest again: limits say how fast a robot is told to speed up, not how fast it
    can. 1 m/s2 at most: a DVL is five times slower than thrusters.
    """
    strong = gentle("bluerov2_alpha5")
    v = np.zeros(strong.n_v)
    v[axis] = HALF * min(1.0, unasked_acceleration(strong)[axis])

    def pushed(t: float) -> np.ndarray:
        return v * np.interp(t, [2.0, 2.0 + HALF, 3.0, 3.0 + HALF], [0.0, 1.0, 1.0, 0.0])

    run = HealthRun(strong, duration=6.0, motion=pushed, requested=rest(strong))
    assert run.guard.monitor.alarms == []


@pytest.mark.parametrize("dt", [0.02, 0.03, 0.05])
@pytest.mark.parametrize("axis", [3, 4])
def test_a_vehicle_that_weight_turns_quickly_is_believed_by_slow_loops(
    axis: int, dt: float
) -> None:
    """Attitude and gyro both tell of a turn that began after the last tick: it is no bias of the gyro."""
    light = load_robot("bluerov2_alpha5")
    v = np.zeros(light.n_v)
    v[axis] = 0.1 * 0.7 * unasked_acceleration(light)[axis]

    def rocking(t: float) -> np.ndarray:
        return v * np.interp(t, [2.0, 2.1, 2.4, 2.7, 3.0], [0.0, 1.0, 0.0, -0.5, 0.0])

    run = HealthRun(light, duration=5.0, motion=rocking, requested=rest(light), dt=dt)
    assert run.guard.monitor.alarms == []


ALL_LATE = SensorSpecs(
    **{
        name: replace(getattr(SensorSpecs(), name), delay=0.2)
        for name in ("attitude", "angular_velocity", "linear_velocity", "joint_positions")
    }
)


@pytest.mark.sampled
@pytest.mark.parametrize("axes", [slice(3, 4), slice(5, 6), JOINTS], ids=str)
def test_motion_that_nobody_asked_for_is_believed_of_late_sensors_too(
    robot: Robot, axes: slice
) -> None:
    run = HealthRun(
        robot, duration=6.0, motion=shuttling(robot, axes), requested=rest(robot), specs=ALL_LATE
    )
    assert run.guard.monitor.alarms == []


@pytest.mark.sampled
@pytest.mark.parametrize("name", ["attitude", "joint_positions"])
def test_a_jump_of_a_late_sensor_is_found_at_once(robot: Robot, name: str) -> None:
    run = HealthRun(robot, duration=4.0, spoil=between(name, "jump", 2.0, 3.0), specs=ALL_LATE)
    assert run.first_bad(name, 2.0) < 0.1


@pytest.mark.sampled
@pytest.mark.parametrize("axes", [VEHICLE, JOINTS], ids=["vehicle", "joints"])
def test_commands_that_nobody_follows_make_no_sensor_suspect(robot: Robot, axes: slice) -> None:
    run = HealthRun(robot, duration=8.0, motion=rest(robot), requested=shuttling(robot, axes))
    assert run.guard.monitor.alarms == []
    assert np.abs(run.q_estimated[-100:, :3] - run.q[-100:, :3]).max() < 0.05


@pytest.mark.parametrize("told", [True, False])
def test_joints_that_stop_at_once_make_no_encoder_suspect(robot: Robot, told: bool) -> None:
    """A jam, brakes or a stop; whether the command goes on or not."""
    moving = braking(robot, JOINTS)
    requested = moving if told else (lambda t: moving(0.0))
    run = HealthRun(robot, duration=4.0, motion=moving, requested=requested)
    late = [text for t, text in run.guard.monitor.alarms if "does not change" not in text]
    assert late == []
    assert np.abs(run.v_estimated[-20:, JOINTS]).max() < 0.1


@pytest.mark.sampled
@pytest.mark.parametrize("size", [0.05, 0.1, 0.2])
def test_a_biased_gyro_is_named_and_the_attitude_neither_lost_nor_led_astray(
    robot: Robot, size: float
) -> None:
    def biased(readings: Readings, t: float) -> Readings:
        def add(reading, t):
            return type(reading)(value=reading.value + np.array([0.0, 0.0, size]), t=reading.t)

        if t < 3.0 or not readings.angular_velocity:
            return readings
        return with_defect(readings, "angular_velocity", add, t)

    run = HealthRun(robot, duration=12.0, spoil=biased)
    assert run.first_bad("angular_velocity", 3.0) < 1.0
    assert (run.of("attitude") == Trust.GOOD).all()
    turn = 2.0 * np.abs(run.q_estimated[:, 3:6] - run.q[:, 3:6])
    assert turn[run.t > 1.0].max() < 0.03
    assert turn[run.t > 6.0].max() < 0.01
    assert np.abs(run.v_estimated - run.v)[run.t > 6.0, 3:6].max() < 0.03


@pytest.mark.parametrize(("axis", "fast"), [(3, 12.0), (8, 100.0)], ids=["vehicle", "joint"])
def test_what_gravity_and_motors_do_beyond_what_is_planned_is_believed(
    robot: Robot, axis: int, fast: float
) -> None:
    """Unasked, in every second for 40 ms at `fast` [rad/s2], and back: as a load falls, or a
    thruster blows.
    """
    away = np.zeros(robot.n_v)
    away[axis] = fast
    pulse = (
        [0.0, 0.04, 0.12, 0.16, 1.0],
        [0.0, 0.04, -0.04, 0.0, 0.0],
    )  # [s] and, per unit, how fast it then is
    run = HealthRun(
        robot,
        duration=4.0,
        motion=lambda t: away * np.interp(t % 1.0, *pulse),
        requested=rest(robot),
    )
    assert run.guard.monitor.alarms == []


def test_a_motion_that_grows_by_a_third_at_every_tick_is_believed(robot: Robot) -> None:
    """A chain of light links that whips: faster than any limit, but never faster than it has
    begun.
    """

    def whip(t: float) -> np.ndarray:
        v = np.zeros(robot.n_v)
        v[8] = min(0.05 * 1.3 ** (100.0 * (t - 2.0)), 12.0) * (2.0 <= t < 2.3)
        return v

    run = HealthRun(robot, duration=2.3, motion=whip, requested=rest(robot))
    assert run.guard.monitor.alarms == []
    assert np.abs(run.v_estimated[-5:, 8] - 12.0).max() < 1.0


def test_encoders_are_believed_again_once_brakes_hold_the_arm(robot: Robot) -> None:
    """What they missed is not carried on with the last velocity, away from all that they can
    read.
    """
    guard = GuardedEstimator(Estimator(robot, SensorSpecs()), robot, SensorSpecs())
    fallen = np.zeros(robot.n_v)
    fallen[8] = 3.0
    suite = SensorSuite(robot, FLOOR)
    fell = 0.0
    for k in range(400):
        t = 0.01 * k
        share = np.interp(t, [1.0, 1.3, 1.5, 1.51], [0.0, 1.0, 1.0, 0.0])
        fell += 0.01 * share
        q = pin.integrate(
            robot.model, robot.configuration(position=(0.0, 0.0, -36.0)), fell * fallen
        )
        readings = suite.read(State(q=q, v=share * fallen), t)
        silent = replace(readings, joint_positions=None) if 1.5 <= t < 1.9 else readings
        measurement = guard(silent, t, Command(v=np.zeros(robot.n_v), brakes=t >= 1.51))
    trusts = {item.channel: item.trust for item in guard.monitor.health}
    assert trusts["joint_positions"] is Trust.GOOD
    assert np.abs(measurement.q - q)[robot.joint_q].max() < 0.01


@pytest.mark.sampled
@pytest.mark.parametrize(("dt", "size"), [(1 / 20, 0.1), (1 / 50, 0.04), (1 / 200, 0.04)])
def test_spikes_of_an_encoder_are_no_motion(robot: Robot, dt: float, size: float) -> None:
    """What is granted to a jolt does not grow with a slow tick: the joint was believed to turn at
    the size over the tick.
    """
    rng = np.random.default_rng(2)

    def spoil(readings: Readings, t: float) -> Readings:
        def add(reading, t):
            return replace(
                reading, value=reading.value + size * (np.arange(len(reading.value)) == 2)
            )

        if t > 1.0 and rng.uniform() < 0.05:
            return with_defect(readings, "joint_positions", add, t)
        return readings

    run = HealthRun(robot, duration=6.0, dt=dt, spoil=spoil, motion=rest(robot))
    assert np.abs(run.q_estimated - run.q)[:, robot.joint_q].max() < 0.2 * size
    assert np.abs(run.v_estimated[:, robot.joint_v]).max() < 0.3
