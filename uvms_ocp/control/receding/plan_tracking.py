"""Carrying out a plan: blind, to see how well the model fits, or with feedback; and how far a plant departed from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

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


@dataclass(frozen=True, kw_only=True, slots=True)
class Mismatch:
    """How a plant departed from a plan."""

    position: float
    """[m] largest distance of the frame from its planned position."""
    end_position: float
    """[m] at the end."""
    end_orientation: float
    """[rad] at the end."""


def mismatch(trajectory: Trajectory, t: np.ndarray, q: np.ndarray, *, robot: Robot, frame: str) -> Mismatch:
    """The pose of a frame at the recorded q (n, n_q) [m, rad] against the planned one at the times t (n,) [s].

    Raises `FrameNotFound` for an unknown frame.
    """
    data, index = robot.model.createData(), robot.frame_id(frame)

    def pose(configuration: np.ndarray) -> pin.SE3:
        pin.framesForwardKinematics(robot.model, data, configuration)
        return data.oMf[index].copy()

    planned = [trajectory.state_at(robot.model, float(moment))[0] for moment in t]
    errors = [pose(wanted).inverse() * pose(found) for wanted, found in zip(planned, q, strict=True)]
    distances = [float(np.linalg.norm(error.translation)) for error in errors]
    return Mismatch(
        position=max(distances),
        end_position=distances[-1],
        end_orientation=float(np.linalg.norm(pin.log3(errors[-1].rotation))),
    )
