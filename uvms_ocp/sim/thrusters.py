"""Thruster dynamics as CasADi expressions, limits, dead zone, first-order lag and electrical power;
power of joint drives.

Thrust follows the command, clipped to the limits and cut in the dead zone, with the first-order lag
``time_constant thrust_dot = target - thrust``, exact for a command held over the step.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.codegen.elementwise import Array, clipped, where
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.electrical_power import electrical_power, power_law
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import thrust_limits

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
N_DECAYS = len(_NODES) + 1
"""Columns of `Thrusters.decay`: one for each node of the energy integral, and the end of the
step.
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Thrusters:
    """All thrusters of a robot. What one without power data takes is not known: NaN."""

    lower: np.ndarray
    """(n,) [N] lower limits of the thrust."""
    upper: np.ndarray
    """(n,) [N] upper limits of the thrust."""
    dead_zone: np.ndarray
    """(n,) [N] thrust below which a command gives none."""
    time_constant: np.ndarray
    """(n,) [s] time constants of the lag."""
    factor: np.ndarray
    """(n,) [W/N^exponent] electrical power at a thrust of 1 N, NaN where the file gives none."""
    exponent: np.ndarray
    """(n,) exponents of the thrust in the electrical power."""

    @staticmethod
    def of(robot: Robot) -> Thrusters:
        """Return the thrusters of the robot's file."""
        thrusters = robot.description.thrusters
        lower, upper = thrust_limits(robot)
        factor, exponent = power_law(robot)
        return Thrusters(
            lower=lower,
            upper=upper,
            dead_zone=np.array([thruster.dead_zone for thruster in thrusters]),
            time_constant=np.array([thruster.time_constant for thruster in thrusters]),
            factor=factor,
            exponent=exponent,
        )

    def target(self, asked: Array, share: Array, offset: Array) -> Array:
        """Return the steady thrust (n,) [N] for a command asked (n,) [N].

        share (n,) and offset (n,) [N]: `ThrusterCondition` of the thrusters.
        """
        within = clipped(asked, self.lower, self.upper)
        sound = where(ca.fabs(within) < self.dead_zone, 0.0, within)
        return clipped(share * sound + offset, self.lower, self.upper)

    def step(self, thrust: ca.SX, target: ca.SX, decay: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the thrust (n,) [N] after dt [s] and the electrical energy (n,) [J] that this took.

        thrust (n,) [N]: at the beginning. target (n,) [N]: held meanwhile. decay (n, N_DECAYS):
        `decay` of this dt.
        """
        distance = thrust - target
        energy = ca.SX.zeros(len(self.lower))
        for node, weight in enumerate(_WEIGHTS):
            energy += dt * weight / 2 * self.power(target + distance * decay[:, node])
        return target + distance * decay[:, -1], energy

    def power(self, thrust: Array) -> ca.SX:
        """Return the electrical power (n,) [W] at a thrust (n,) [N]."""
        return electrical_power(thrust, self.factor, self.exponent)

    def decay(self, dt: float) -> np.ndarray:
        """Return the share (n, N_DECAYS) of the distance to the target that is left at the nodes
        and at the end of dt [s].

        Raises `InvalidInput` for a dt that is not > 0.
        """
        if not (np.isfinite(dt) and dt > 0.0):
            raise InvalidInput(f"dt = {dt} s given; allowed: more than 0")
        times = np.append(dt * (_NODES + 1.0) / 2.0, dt)
        # No lag: the distance to the command is gone at once.
        time_constant = self.time_constant[:, None]
        lagging = time_constant > 0.0
        decay = np.exp(-times / np.where(lagging, time_constant, 1.0))
        return np.where(lagging, decay, 0.0)
