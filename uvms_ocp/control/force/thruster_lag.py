"""First-order thrusters, and the thrust command that makes them faster than their lag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.codegen.elementwise import Array, clipped, where
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import thrust_limits


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ThrusterLag:
    """Model of n thrusters over a tick, of numbers and of CasADi expressions alike."""

    lower: np.ndarray
    """(n,) [N]"""
    upper: np.ndarray
    """(n,) [N]"""
    lead: np.ndarray
    """(n,) times that thrusters are driven faster than their lag."""
    decay: np.ndarray
    """(n,) share of the distance from its command that a thruster keeps over a tick."""
    mean_decay: np.ndarray
    """(n,) mean over a tick of the share of that distance."""
    dead_zone: np.ndarray
    """(n,) [N] smaller thrust cannot be commanded."""

    def command(self, thrust: Array, desired: Array, hurry: Array) -> Array:
        """Command (n,) [N] that brings thrust (n,) [N] to the wanted one (n,) [N]; hurry (): ahead
        of the lag.

        What would lead into a dead zone is the wanted thrust itself, which is 0 or beyond it.
        """
        lead = where(hurry, self.lead, 1.0)
        ahead = clipped(thrust + lead * (desired - thrust), self.lower, self.upper)
        return where(ahead * ahead < self.dead_zone**2, desired, ahead)

    def after(self, thrust: Array, command: Array) -> Array:
        """Propagate a thrust (n,) [N] by one tick under a command (n,) [N]."""
        return command + (thrust - command) * self.decay

    def mean(self, thrust: Array, command: Array) -> Array:
        """Compute the mean thrust (n,) [N] over the tick that begins with this thrust (n,) [N] and
        command (n,) [N].
        """
        return command + (thrust - command) * self.mean_decay


def thruster_lag(robot: Robot, *, lead: float, dt: float) -> ThrusterLag:
    """Return the lag of a robot's thrusters; lead: driven so many times faster than their lag. dt
    [s]: control period.
    """
    thrusters = robot.description.thrusters
    time_constants = np.array([thruster.time_constant for thruster in thrusters])
    dead_zones = np.array([thruster.dead_zone for thruster in thrusters])
    lower, upper = thrust_limits(robot)
    # Faster than the control period would ring.
    largest_lead = np.maximum(time_constants / (2 * dt), 1.0)
    ticks = dt / np.maximum(time_constants, 1e-9)  # in time constants
    return ThrusterLag(
        lower=lower,
        upper=upper,
        lead=np.clip(lead, 1.0, largest_lead),
        decay=np.exp(-ticks),
        mean_decay=-np.expm1(-ticks) / ticks,
        dead_zone=dead_zones,
    )
