"""First-order thrusters, and the thrust command that makes them faster than their lag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.functions.elementwise import Array, clipped, where
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.thrusters import thrust_limits


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ThrusterLag:
    """Model of n thrusters over a tick, of numbers and of CasADi expressions alike."""

    lower: np.ndarray
    """(n,) [N]"""
    upper: np.ndarray
    """(n,) [N]"""
    lead: np.ndarray
    """(n,) [-] so many times faster than their lag they are driven."""
    decay: np.ndarray
    """(n,) [-] share of the distance from its command that a thruster keeps over a tick."""

    def command(self, thrust: Array, wanted: Array, hurry: Array) -> Array:
        """Command (n,) [N] that brings thrust (n,) [N] to the wanted one (n,) [N]; hurry () [-]: ahead of the lag."""
        lead = where(hurry, self.lead, 1.0)
        return clipped(thrust + lead * (wanted - thrust), self.lower, self.upper)

    def after(self, thrust: Array, command: Array) -> Array:
        """What becomes of a thrust (n,) [N] within a tick, (n,) [N], under a command (n,) [N]."""
        return command + (thrust - command) * self.decay


def thruster_lag(robot: Robot, *, lead: float, dt: float) -> ThrusterLag:
    """That of a robot's thrusters; lead [-]: driven so many times faster than their lag. dt [s]: control period."""
    time_constants = np.array([thruster.time_constant for thruster in robot.description.thrusters])
    lower, upper = thrust_limits(robot)
    return ThrusterLag(
        lower=lower,
        upper=upper,
        # Faster than the control period would ring.
        lead=np.clip(lead, 1.0, np.maximum(time_constants / (2 * dt), 1.0)),
        decay=np.exp(-dt / np.maximum(time_constants, 1e-9)),
    )
