"""Conditions in which drawn robots fly: the period of the loop, how late positions and gyro come, and
how far the robot is out of trim, as its file says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import SensorSpecs
from uvms_ocp.robot.size import size
from uvms_ocp.robot.thrusters import thrust_limits, thruster_matrix, unactuated_axes
from uvms_ocp.scenario.scenario import Scenario

PERIODS = (0.01, 0.05)  # [s] from the shortest to the longest
POSITION_DELAY = 0.5  # [s] at most
GYRO_DELAY = 0.05  # [s] at most
OUT_OF_TRIM = 0.5  # share of the thrust that holding an untrimmed robot still takes at most
_STREAM = 1  # beside that of robots and missions, so that seeds keep theirs
_GRAVITY = 9.81  # [m/s2]


@dataclass(frozen=True, kw_only=True, slots=True)
class Conditions:
    """Conditions of one run."""

    dt: float
    """Control period [s]."""
    position_delay: float
    """By how much [s] fixes come late."""
    gyro_delay: float
    """By how much [s] turn rates come late."""
    trim: float
    """Share of the largest trim that takes `OUT_OF_TRIM` of the thrust; 0 of a robot in trim."""
    direction: tuple[float, float, float]
    """Lift, and moments of roll and pitch over the size of the robot; a unit vector."""


def drawn_conditions(seed: int) -> Conditions:
    """Draw any period, delays of half of the robots, and a trim of half of them."""
    rng = np.random.default_rng((seed, _STREAM))
    dt = float(np.exp(rng.uniform(*np.log(PERIODS))))
    is_late = rng.random() < 0.5
    position_delay, gyro_delay = rng.uniform(0.0, (POSITION_DELAY, GYRO_DELAY)).tolist()
    if not is_late:
        position_delay = gyro_delay = 0.0
    is_out_of_trim = rng.random() < 0.5
    trim = float(rng.uniform())
    direction = rng.normal(size=3)
    lift, roll, pitch = (direction / np.linalg.norm(direction)).tolist()
    return Conditions(
        dt=round(dt, 3),
        position_delay=round(position_delay, 3),
        gyro_delay=round(gyro_delay, 3),
        trim=trim if is_out_of_trim else 0.0,
        direction=(lift, roll, pitch),
    )


def out_of_trim(robot: Robot, conditions: Conditions, folder: Path) -> Robot:
    """Return the robot of robot.urdf and hydrodynamics.yaml in a folder with the buoyancy of its hull
    moved and changed, which its file says from then on. The same robot where thrust holds no more.
    """
    wrench = np.zeros(6)
    wrench[2:5] = np.array(conditions.direction) * [1.0, size(robot.model), size(robot.model)]
    wrench[list(unactuated_axes(robot))] = 0.0
    wrench *= conditions.trim * _largest(robot, wrench)
    if not wrench.any():
        return robot
    file = folder / "hydrodynamics.yaml"
    water = yaml.safe_load(file.read_text(encoding="utf-8"))
    hull = water["links"]["hull"]["coefficients"]
    specific_weight = robot.description.water_density * _GRAVITY  # [N/m3]
    buoyancy = specific_weight * hull["volume"]
    x, y, z = hull["centre_of_buoyancy"]
    # Thrusters make up for it: of lift too much they push down.
    lift, roll, pitch = -wrench[2:5]
    buoyant = buoyancy + lift
    hull["volume"] = float(buoyant / specific_weight)
    hull["centre_of_buoyancy"] = [
        float((buoyancy * x - pitch) / buoyant),
        float((buoyancy * y + roll) / buoyant),
        z,
    ]
    file.write_text(yaml.safe_dump(water, sort_keys=False), encoding="utf-8")
    return load_robot(urdf=folder / "robot.urdf", hydrodynamics=file)


def _largest(robot: Robot, wrench: np.ndarray) -> float:
    """Compute the largest factor by which a wrench (6,) [N, N m] may be multiplied so that thrusters hold
    it, and the robot still, with `OUT_OF_TRIM` of their thrust.
    """
    still = np.zeros(robot.n_v)
    holding = robot_dynamics(robot).inverse_dynamics(robot.configuration(), still, still)[:6]
    driven = [axis for axis in range(6) if axis not in unactuated_axes(robot)]
    allocation = np.linalg.pinv(thruster_matrix(robot)[driven])
    at_rest = allocation @ holding[driven]
    per_trim = allocation @ wrench[driven]
    lower, upper = OUT_OF_TRIM * np.array(thrust_limits(robot))
    if not per_trim.any() or (at_rest < lower).any() or (at_rest > upper).any():
        return 0.0
    limit = np.where(per_trim > 0.0, upper, lower)
    moved = per_trim != 0.0
    return float(((limit - at_rest)[moved] / per_trim[moved]).min())


def delayed(scenario: Scenario, conditions: Conditions) -> Scenario:
    """Return the scenario with positions and gyro that come as late as drawn."""
    sensors = scenario.specs
    return replace(scenario, sensors=_late(sensors, conditions))


def _late(sensors: SensorSpecs, conditions: Conditions) -> SensorSpecs:
    assert sensors.position is not None
    assert sensors.angular_velocity is not None
    return replace(
        sensors,
        position=replace(sensors.position, delay=conditions.position_delay),
        angular_velocity=replace(sensors.angular_velocity, delay=conditions.gyro_delay),
    )
