"""The first ticks of a run, in which late sensors have not spoken yet."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pinocchio as pin
import pytest
from compiler import long_without_compiler
from studies.drawn_faults import PERIODS, ROBOTS

from uvms_ocp.control.force.dynamic import DynamicController
from uvms_ocp.robot.description import TrimBody
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import ChannelHealth, StateEstimate, Trust
from uvms_ocp.robot.static_balance import with_trim
from uvms_ocp.robot.thrusters import largest_wrench
from uvms_ocp.scenario.cases.bluerov import reach
from uvms_ocp.scenario.scenario import Scenario

_ARM = 0.5  # [m] of the lead to one side of the vehicle's origin, and of the foam to the other
_GRAVITY = 9.81  # [m/s2]
_LEAD = 11340.0  # [kg/m3]
_LIGHTEST = 0.2  # share of the mass of the lead that the foam has
_FALLEN = 0.2  # [rad, m] of a vehicle that was not held


def out_of_trim(robot: Robot, axis: int, share: float) -> Robot:
    """Return the robot with a moment about an axis of rotation, 3 or 4, or with weight, axis 2: a
    share of the largest that its thrusters have there.
    """
    wrench = share * float(largest_wrench(robot)[axis])
    density = robot.description.water_density
    if axis == 2:
        mass = wrench / _GRAVITY
        return with_trim(robot, [lead(mass, (0.0, 0.0, 0.0))])
    mass = wrench / (2.0 * _ARM * _GRAVITY)
    side = [0.0, 0.0, 0.0]
    side[axis % 2] = _ARM
    lifted = mass * (1.0 - density / _LEAD)
    foam = TrimBody(
        name="foam",
        position=(-side[0], -side[1], -side[2]),
        mass=_LIGHTEST * mass,
        volume=(lifted + _LIGHTEST * mass) / density,
    )
    return with_trim(robot, [lead(mass, (side[0], side[1], side[2])), foam])


def lead(mass: float, position: tuple[float, float, float]) -> TrimBody:
    return TrimBody(name="lead", position=position, mass=mass, volume=mass / _LEAD)


def late(robot: Robot, *, position: float, gyro: float, dt: float, seed: int) -> Scenario:
    """Return a short run of a robot whose fixes and gyro are late [s]."""
    scenario = reach(robot=robot, noise=True, seed=seed, dt=dt, duration=position + 0.8)
    specs = scenario.specs
    assert specs.position is not None
    assert specs.angular_velocity is not None
    late_specs = dataclasses.replace(
        specs,
        position=dataclasses.replace(specs.position, delay=position),
        angular_velocity=dataclasses.replace(specs.angular_velocity, delay=gyro),
    )
    return dataclasses.replace(scenario, sensors=late_specs)


def tilts(q: np.ndarray) -> np.ndarray:
    """Return the angles (n,) [rad] between the z axis of the vehicle in q (n, n_q) and that in the
    first row.
    """
    axes = np.array([pin.Quaternion(row[3:7]).toRotationMatrix()[:, 2] for row in q])
    return np.arccos(np.clip(axes @ axes[0], -1.0, 1.0))


@pytest.mark.sampled
@pytest.mark.parametrize("axis", [2, 3, 4])
def test_the_first_command_carries_weight_and_buoyancy(axis: int) -> None:
    robot = out_of_trim(load_robot("bluerov2_alpha5"), axis, 0.3)
    scenario = reach(robot=robot)
    dynamics = robot_dynamics(robot)
    layer = DynamicController(
        robot=robot, dynamics=dynamics, kinematic=scenario.kinematic_controller()
    )
    awaiting = StateEstimate(
        q=scenario.start, v=np.zeros(robot.n_v), altimeter_range=math.nan, age=math.inf
    )
    rest = np.zeros(robot.n_v)
    weight = dynamics.inverse_dynamics(scenario.start, rest, rest)[:6]
    assert abs(weight[axis]) > 1.0
    command = layer(awaiting, 0.0)
    assert not command.stop
    np.testing.assert_allclose(command.telemetry["wrench"], weight, atol=1e-9)
    np.testing.assert_allclose(command.telemetry["unreachable"], np.zeros(6), atol=1e-6)


def test_turns_are_damped_while_first_readings_are_awaited_unless_the_gyro_is_doubted() -> None:
    robot = load_robot("bluerov2_alpha5")
    scenario = reach(robot=robot)
    dynamics = robot_dynamics(robot)
    v = np.zeros(robot.n_v)
    rest = np.zeros(robot.n_v)
    v[4] = 0.2
    weight = dynamics.inverse_dynamics(scenario.start, rest, rest)[:6]
    doubt = ChannelHealth(channel="angular_velocity", trust=Trust.SUSPECT)
    damping = list[float]()
    for health in ((), (doubt,)):
        layer = DynamicController(
            robot=robot, dynamics=dynamics, kinematic=scenario.kinematic_controller()
        )
        awaiting = StateEstimate(
            q=scenario.start, v=v, altimeter_range=math.nan, age=math.inf, health=health
        )
        command = layer(awaiting, 0.0)
        assert command.hold
        damping.append(command.telemetry["wrench"][4] - weight[4])
    assert damping[0] < -0.1
    assert damping[1] == pytest.approx(0.0, abs=1e-9)


@long_without_compiler
@pytest.mark.parametrize(
    ("share", "gyro", "seed"), [(0.2, 0.02, 0), pytest.param(0.4, 0.05, 1, marks=pytest.mark.slow)]
)
def test_a_vehicle_that_nobody_trimmed_is_believed_its_sensors_though_the_gyro_is_late(
    share: float, gyro: float, seed: int
) -> None:
    robot = load_robot("bluerov2_alpha5")
    scenario = late(robot, position=0.2, gyro=gyro, dt=0.005, seed=seed)
    record = dataclasses.replace(scenario, plant_robot=out_of_trim(robot, 4, share)).run()
    assert record.meta.alarms == ()


@long_without_compiler
def test_a_thruster_that_pushes_with_all_its_force_makes_no_sensor_suspect() -> None:
    robot = load_robot("bluerov2_alpha5")
    scenario = late(robot, position=0.2, gyro=0.05, dt=0.005, seed=0)
    record = dataclasses.replace(scenario, faults=("thruster1:stuck=40@0.5",)).run()
    names = {alarm.text.split()[0] for alarm in record.meta.alarms}
    assert names.isdisjoint({"attitude", "angular_velocity", "position", "linear_velocity"})


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize(
    ("axis", "share", "position", "gyro", "dt", "seed"),
    [
        (4, 0.3, 0.5, 0.02, 0.005, 0),
        (3, 0.3, 0.5, 0.05, 0.005, 1),
        (2, 0.5, 0.3, 0.05, 0.01, 2),
        pytest.param(4, 0.5, 0.5, 0.05, 0.01, 3, marks=pytest.mark.slow),
        (3, 0.5, 0.2, 0.05, 0.02, 2),
    ],
)
def test_nothing_falls_and_nothing_is_refused_while_late_sensors_are_awaited(
    axis: int, share: float, position: float, gyro: float, dt: float, seed: int
) -> None:
    robot = out_of_trim(load_robot("bluerov2_alpha5"), axis, share)
    record = late(robot, position=position, gyro=gyro, dt=dt, seed=seed).run()
    assert tilts(np.array(record["q"])).max() < _FALLEN
    assert np.abs(record["q"][:, 2] - record["q"][0, 2]).max() < _FALLEN
    assert record.meta.alarms == ()


_QUICK = (10, 14)  # seeds of slow ticks, each of another robot
_DRAWN = 24


def drawn_reach(seed: int) -> Scenario:
    """Draw a robot, its trim up to half of its thrust, which its file states or not, delays and the
    period of its ticks.
    """
    rng = np.random.default_rng(seed)
    robot = load_robot(str(rng.choice(ROBOTS)))
    dt = float(rng.choice(PERIODS))
    share = float(rng.uniform(0.0, 0.5))
    is_stated = bool(rng.random() < 0.7)
    position, gyro, duration = rng.uniform((0.0, 0.0, 6.0), (0.5, 0.05, 12.0)).tolist()
    largest = largest_wrench(robot)
    axis = int(rng.choice([axis for axis in (2, 3, 4) if largest[axis] > 1e-6]))
    plant = out_of_trim(robot, axis, share)
    known = plant if is_stated else robot
    scenario = late(known, position=position, gyro=gyro, dt=dt, seed=seed)
    return dataclasses.replace(
        scenario, plant_robot=None if is_stated else plant, duration=duration
    )


@pytest.mark.sampled
@long_without_compiler
@pytest.mark.parametrize(
    "seed",
    [
        pytest.param(seed, marks=() if seed in _QUICK else pytest.mark.slow)
        for seed in range(_DRAWN)
    ],
)
def test_no_sound_channel_is_doubted_whatever_trim_delays_and_ticks_are(seed: int) -> None:
    assert not drawn_reach(seed).run()["health"].any()
