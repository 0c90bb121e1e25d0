"""Carrying out a plan: blind, to see how well the model fits, or with feedback."""

from __future__ import annotations

from uvms_ocp.arguments import changed, trusted
from uvms_ocp.control.force.computed_torque import ComputedTorque, TrackingGains
from uvms_ocp.control.navigation.last_known import LastSound
from uvms_ocp.model.dynamics import Dynamics
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command, Measurement, State
from uvms_ocp.model.water.hydrodynamics import STILL_WATER, Water
from uvms_ocp.ocp.trajectory import Trajectory

_state = trusted(State)


class PlanTracker:
    """Follows one trajectory to its end: a callable ``(Measurement, t) -> Command`` with thrust and torque.

    By computed torque. Build one per run.
    """

    def __init__(
        self,
        trajectory: Trajectory,
        robot: Robot,
        dynamics: Dynamics,
        *,
        dt: float,
        gains: TrackingGains | None = None,
        water: Water = STILL_WATER,
    ) -> None:
        """dt [s]: control period. gains, water: as `ComputedTorque` takes them."""
        self._trajectory, self._model = trajectory, robot.model
        self._law = ComputedTorque(robot, dynamics, dt=dt, gains=gains, water=water)
        self._end = float(trajectory.t[-1]) - 0.5 * dt
        self._sound = LastSound(robot)

    def __call__(self, measurement: Measurement, t: float) -> Command:
        """The command for the tick at time t [s] of the trajectory; finished at its end."""
        measurement = self._sound(measurement, t)
        q, v, a = self._trajectory.state_at(self._model, t)
        command = self._law.command(_state(q=measurement.q, v=measurement.v), q=q, v=v, a=a)
        return changed(command, finished=t > self._end)
