"""Plants: what a command does to the true state."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import Period, checked, late, trusted
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command, State
from uvms_ocp.sim.faults.fault import Fault
from uvms_ocp.sim.faults.plant_faults import active_of, jammed_axes

_state = trusted(State)


EFFORTS = ("thrust", "torque", "thruster_energy", "joint_energy")
"""Telemetry that reports and figures know."""


class Plant(Protocol):
    """Something with a true state that a command advances; built for one run, at its start."""

    state: State
    """The true one: another value, or other arrays, after each step; with `a` where an accelerometer is among the sensors."""

    def step(self, command: Command, dt: float) -> None:
        """Advance by dt [s]. The command has thrust and torque where the plant takes forces, the velocity always."""

    def telemetry(self) -> dict[str, Any]:
        """What it knows beside its state, for the record: numbers and arrays (n,), the same at every tick, empty for none.

        Reports and figures know ``thrust`` (n_thrusters,) [N], ``torque`` (n_joints,) [N m], and what was taken so far,
        ``thruster_energy`` (n_thrusters,) [J], nan where not known, and ``joint_energy`` [J]; a plant tells all four or none.
        The scene draws ``contact`` (n_points,) [N], of the floor on each of `uvms_ocp.sim.contact.skid_points`, and ``current``
        (3,) [m/s] in W, of the water at the vehicle. Other names of `uvms_ocp.tables.series_table.SERIES` are taken.
        """


@checked
class KinematicPlant(Plant):
    """The paper's plant: velocities follow the command at once, except those of joints that are jammed."""

    def __init__(self, robot: Robot, q0: np.ndarray, faults: tuple[Fault, ...] = ()) -> None:
        """q0 (n_q,) [m, rad]: the start. Raises `InvalidInput`, as `Robot.check_configuration`."""
        self._model, self._robot, self._faults = robot.model, robot, faults
        self._t = 0.0
        self.state = State(q=robot.check_configuration(q0), v=np.zeros(robot.n_v), a=np.zeros(robot.n_v))

    @late
    def step(self, command: Command, dt: Period) -> None:
        v = command.v
        if self._faults and (jammed := jammed_axes(self._robot, active_of(self._faults, self._t))):
            v = v.copy()
            v[list(jammed)] = 0.0
        acceleration = (v - self.state.v) / dt
        self.state = _state(q=pin.integrate(self._model, self.state.q, v * dt), v=v, a=acceleration)
        self._t += dt

    def telemetry(self) -> dict[str, Any]:
        """Nothing: the state is all there is."""
        return {}
