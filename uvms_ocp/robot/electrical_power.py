"""Electrical power that thrusters and drives of joints take."""

from __future__ import annotations

import casadi as ca
import numpy as np

from uvms_ocp.codegen.elementwise import Array
from uvms_ocp.robot.robot import Robot


def power_law(robot: Robot) -> tuple[np.ndarray, np.ndarray]:
    """Return factor (n_thrusters,) [W/N^exponent], NaN where the file gives none, and exponent
    (n_thrusters,).
    """
    factors = list[float]()
    exponents = list[float]()
    for thruster in robot.description.thrusters:
        power = thruster.power
        if power:
            factors.append(power.watts / power.thrust**power.exponent)
            exponents.append(power.exponent)
        else:
            factors.append(np.nan)
            exponents.append(1.0)
    return np.array(factors), np.array(exponents)


def electrical_power(thrust: Array, factor: np.ndarray, exponent: np.ndarray) -> ca.SX:
    """Return the electrical power (n_thrusters,) [W] at a thrust (n_thrusters,) [N], by a
    `power_law`.
    """
    size = ca.fabs(thrust)
    powers = list[ca.SX]()
    for k, e in enumerate(exponent):
        if e == 1.5:
            # A call of pow takes five times as long as the square root of the usual exponent.
            powers.append(size[k] * ca.sqrt(size[k]))
        else:
            powers.append(size[k] ** e)
    return ca.DM(factor) * ca.vertcat(ca.SX(0, 1), *powers)


def joint_power(tau: Array, rate: Array, efficiency: float) -> Array:
    """Return the electrical power (n_joints,) [W] of drives, of effort tau [N m or N] and rate
    [rad/s or m/s], both (n_joints,).

    ``|tau rate|`` divided by the efficiency: braking gives nothing back, standing still is free.
    """
    return abs(tau * rate) / efficiency
