"""Carrying out a plan on a plant: blind, to see how well the model fits, or with feedback."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import pinocchio as pin

from uvms_ocp.control.force.allocation import allocation_of
from uvms_ocp.control.force.dynamic import ThrusterLag
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.dynamics import Dynamics
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command, State
from uvms_ocp.model.water.hydrodynamics import STILL_WATER, Water
from uvms_ocp.ocp.trajectory import Trajectory


class Plant(Protocol):
    """What a plan is carried out on."""

    state: State

    def step(self, command: Command, dt: float) -> None: ...


@dataclass(frozen=True, kw_only=True, slots=True)
class TrackingGains:
    """Of the position and velocity errors of the closed loop [1/s^2], [1/s]; zeros leave it open."""

    vehicle_stiffness: float = 1.0
    vehicle_damping: float = 2.0
    joints_stiffness: float = 36.0
    joints_damping: float = 12.0
    lead: float = 4.0  # thrusters are driven this many times faster than their lag

    def __post_init__(self) -> None:
        values = [getattr(self, name) for name in self.__dataclass_fields__]
        if not (np.isfinite(values).all() and min(values) >= 0 and self.lead >= 1):
            raise InvalidInput(f"tracking gains {values}; give finite values >= 0, and lead >= 1")


OPEN_LOOP = TrackingGains(vehicle_stiffness=0, vehicle_damping=0, joints_stiffness=0, joints_damping=0)


class PlanTracker:
    """Computed-torque control along a trajectory: the forces of the planned motion, corrected by feedback."""

    def __init__(
        self,
        robot: Robot,
        dynamics: Dynamics,
        *,
        dt: float,
        gains: TrackingGains | None = None,
        water: Water = STILL_WATER,
    ) -> None:
        """dt [s]: control period. water: as far as the controller knows it."""
        chosen = gains or TrackingGains()
        self._robot, self._dynamics, self._water = robot, dynamics, water
        self._open = chosen == OPEN_LOOP
        n, m = robot.n_vehicle, robot.n_joints
        self._K_p = np.repeat([chosen.vehicle_stiffness, chosen.joints_stiffness], [n, m])
        self._K_d = np.repeat([chosen.vehicle_damping, chosen.joints_damping], [n, m])
        self._allocation = allocation_of(robot)
        self._lag = ThrusterLag(robot, chosen.lead, dt)
        self.applied: np.ndarray | None = None  # (n_v,) force of the last command, as thrusters follow it

    def command(self, trajectory: Trajectory, t: float, state: State, disturbance: np.ndarray | float = 0.0) -> Command:
        """Command at time t [s] of the trajectory for the measured state; disturbance (n_v,): force to work against."""
        q, v, a = trajectory.state_at(self._robot.model, t)
        at = State(q=q, v=v) if self._open else state
        error = pin.difference(self._robot.model, at.q, q)
        wanted = a + self._K_p * error + self._K_d * (v - at.v)
        tau = self._dynamics.inverse_dynamics(at.q, at.v, wanted, self._water) - disturbance
        wrench = np.zeros(6)
        wrench[: self._robot.n_vehicle] = tau[self._robot.vehicle_v]
        thrust = self._lag.drive(self._allocation.allocate(wrench).thrust, hurry=True)
        effort = self._robot.limits.effort
        torque = np.clip(tau[self._robot.joint_v], -effort, effort)
        reached = (self._allocation.matrix @ self._lag.thrust)[: self._robot.n_vehicle]
        self.applied = np.concatenate([reached, torque])
        return Command(v=v, thrust=thrust, torque=torque)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Mismatch:
    """How a plant departed from a plan."""

    position: float  # [m] largest distance of the frame from its planned position
    end_position: float  # [m] at the end
    end_orientation: float  # [rad]
    end_state: State


def carry_out(
    trajectory: Trajectory,
    plant: Plant,
    tracker: PlanTracker,
    *,
    robot: Robot,
    frame: str,
    dt: float = 1 / 200,
) -> Mismatch:
    """Run a trajectory on a plant and compare the pose of `frame` with the plan. dt [s]: control period."""
    n = round(trajectory.t[-1] / dt)
    largest = 0.0
    for i in range(n):
        plant.step(tracker.command(trajectory, i * dt, plant.state), dt)
        planned, _, _ = trajectory.state_at(robot.model, (i + 1) * dt)
        error = _pose(robot, planned, frame).inverse() * _pose(robot, plant.state.q, frame)
        largest = max(largest, float(np.linalg.norm(error.translation)))
    return Mismatch(
        position=largest,
        end_position=float(np.linalg.norm(error.translation)),
        end_orientation=float(np.linalg.norm(pin.log3(error.rotation))),
        end_state=plant.state,
    )


def _pose(robot: Robot, q: np.ndarray, frame: str) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.frame_id(frame)]
