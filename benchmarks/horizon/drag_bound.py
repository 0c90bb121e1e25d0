"""The least energy that drag and weight set along a way, whatever flies it.

At every moment of the way the thrusters have to balance, at least, what the water does to the robot
at the velocity that it has relative to it, and what weight and buoyancy do: the generalized force
of moving on steadily, without accelerating. Among all thrusts that give the vehicle's part of it
the least power is taken, ``sum factor |T|^exponent``. Integrated over the way this is the energy of
flying it quasi-statically; accelerations, noise and errors of control come on top.
"""

from __future__ import annotations

import numpy as np

from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import thruster_matrix
from uvms_ocp.sim.currents import Current, water_at

_SWEEPS = 60  # of reweighted least squares
_ROUNDING = 1e-6  # [N]


def quasi_static_energy(
    robot: Robot,
    current: Current,
    t: np.ndarray,
    q: np.ndarray,
    v: np.ndarray,
    *,
    every: int,
    inertia: bool = False,
) -> float:
    """Compute the energy of thrusters [J] along q (n, n_q) [m, rad] with v (n, n_v) [m/s, rad/s] at
    t (n,) [s], looked at `every` rows.

    inertia: count the accelerations between the rows looked at as well.
    """
    dynamics = robot_dynamics(robot)
    a = np.zeros_like(v)
    if inertia:
        a[::every] = np.gradient(v[::every], t[::every], axis=0)
    rows = np.arange(0, len(t), every)
    powers = []
    for k in rows:
        water = water_at(current, q[k : k + 1, :3], float(t[k]))
        u = type(water)(velocity=water.velocity[0])
        force = dynamics.inverse_dynamics(q[k], v[k], a[k], u)
        powers.append(least_power(robot, force[: robot.n_vehicle]))
    return float(np.trapezoid(powers, t[rows]))


def least_power(robot: Robot, wrench: np.ndarray) -> float:
    """[W] Least electrical power of all thrusts that give a wrench (6,) [N, N m], without their
    limits.
    """
    B = thruster_matrix(robot)
    exponents = []
    factors = []
    for thruster in robot.description.thrusters:
        power = thruster.power
        if power:
            exponents.append(power.exponent)
            factors.append(power.watts / power.thrust**power.exponent)
    exponent = np.array(exponents)
    factor = np.array(factors)
    thrust = np.linalg.pinv(B) @ wrench
    for _ in range(_SWEEPS):
        # A parabola that touches the power of each thruster at the last thrust and lies above it.
        softness = (np.abs(thrust) + _ROUNDING) ** (2 - exponent) / factor
        thrust = softness * (B.T @ np.linalg.lstsq((B * softness) @ B.T, wrench, rcond=None)[0])
    return float(factor @ np.abs(thrust) ** exponent)
