"""The physical plant: thrusters and motors push a robot through moving water, above a floor that pushes back."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from uvms_ocp.arguments import Period, checked, late, trusted
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.buffered import BufferedFunction
from uvms_ocp.functions.compile import compile_function
from uvms_ocp.model.dynamics import Dynamics, robot_dynamics
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.spatial import quaternion_to_matrix
from uvms_ocp.model.state import Command, State
from uvms_ocp.model.thrusters import thruster_matrix
from uvms_ocp.sim.contact import ContactModel, skid_points
from uvms_ocp.sim.currents import water_at
from uvms_ocp.sim.dynamic_step import JointStops, StepModel, step_function
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.faults.current_step import with_steps
from uvms_ocp.sim.faults.fault import Fault
from uvms_ocp.sim.faults.plant_faults import active_of, jammed_axes, joined_velocity, loaded, payloads
from uvms_ocp.sim.faults.thruster_condition import condition_of
from uvms_ocp.sim.plant import Plant
from uvms_ocp.sim.thrusters import ThrusterBank, joint_power

_state = trusted(State)

_STRUCK = ("thruster", "joint", "payload")
BRAKE_FRICTION = 1e6  # [N m s/rad] of a locked joint, which creeps by less than a milliradian in a minute (assumed)


@checked
class DynamicPlant(Plant):
    """Robot, thrusters, water and floor at `max_step` or finer; see `uvms_ocp.sim.dynamic_step` for the equations."""

    def __init__(
        self,
        robot: Robot,
        q0: np.ndarray,
        *,
        dynamics: Dynamics,
        environment: Environment,
        max_step: float = 1e-3,
        contact: ContactModel | None = None,
        stops: JointStops | None = None,
        faults: tuple[Fault, ...] = (),
    ) -> None:
        """q0 (n_q,) [m, rad]: the start, at rest. max_step [s]. faults: those of sensors are left out.

        Raises `InvalidInput` for a max_step that is not > 0, and as `Robot.check_configuration`.
        """
        if not (math.isfinite(max_step) and max_step > 0):
            raise InvalidInput(f"max_step = {max_step} s; give a finite time > 0")
        self._robot, self._unloaded, self._dynamics, self._max_step = robot, dynamics, dynamics, max_step
        self._environment = with_steps(environment, faults)
        self._points = skid_points(robot)
        self._model = StepModel(
            robot=robot,
            dynamics=dynamics.symbolic,
            points=self._points,
            contact=contact or ContactModel(),
            stops=stops or JointStops(),
        )
        self._step = BufferedFunction(compile_function(step_function(self._model)))
        self._faults = tuple(fault for fault in faults if fault.strikes.family in _STRUCK)
        self._active: tuple[Fault, ...] = ()
        self._matrix = thruster_matrix(robot)
        self._bank = ThrusterBank(robot)
        self._efficiency = robot.description.joint_efficiency
        self._t = 0.0
        self._contact = np.zeros(len(self._points))
        self._torque = np.zeros(robot.n_joints)
        self._joint_energy = 0.0
        self.state = State(q=robot.check_configuration(q0), v=np.zeros(robot.n_v), a=np.zeros(robot.n_v))

    @late
    def step(self, command: Command, dt: Period) -> None:
        """Advance by dt [s]. Water and floor are sampled once, thrust and motion in steps of at most `max_step`.

        Raises `InvalidInput` for a command without thrust or torque.
        """
        thrust, self._torque = self._efforts(command)
        if (active := active_of(self._faults, self._t)) != self._active:
            self._suffer(active)
        water, floor = self._water(), self._floor()
        n_steps = math.ceil(dt / self._max_step - 1e-9)
        h, brake = np.array([dt / n_steps]), np.array([BRAKE_FRICTION if command.brakes else 0.0])
        q, v = self.state.q, self.state.v
        for _ in range(n_steps):
            wrench = self._matrix @ self._bank.step(thrust, h[0])
            tau = np.concatenate([wrench[: self._robot.n_vehicle], self._torque])
            q, v, self._contact = self._step(q, v, tau, *water, *floor, brake, h)
            self._joint_energy += h[0] * float(
                joint_power(self._torque, v[self._robot.joint_v], self._efficiency).sum()
            )
        self._t += dt
        self.state = _state(q=q, v=v, a=(v - self.state.v) / dt)  # the mean, as an accelerometer would integrate it

    def telemetry(self) -> dict[str, Any]:
        return {
            "thrust": self._bank.thrust.copy(),
            "torque": self._torque,
            "contact": self._contact,
            "thruster_energy": self._bank.energy.copy(),
            "joint_energy": self._joint_energy,
        }

    def _suffer(self, active: tuple[Fault, ...]) -> None:
        """Go on with other faults than before."""
        self._bank.suffer(condition_of(active, self._bank.thrust))
        had, have, locked = payloads(self._active), payloads(active), jammed_axes(self._robot, active)
        self._active = active
        if have != had:
            self._carry(had, have)
        if have != had or locked != self._model.locked:
            self._model = replace(self._model, dynamics=self._dynamics.symbolic, locked=locked)
            # Not compiled: a run does not wait for that in its middle.
            self._step = BufferedFunction(step_function(self._model))

    def _carry(self, had: tuple[Fault, ...], have: tuple[Fault, ...]) -> None:
        """Let go of payloads, which take their momentum along, and pick up others, which lay still."""
        kept = tuple(fault for fault in had if fault in have)
        before = self._with_payloads(kept)
        self._dynamics = before if have == kept else self._with_payloads(have)
        if have != kept:
            q, v = self.state.q, self.state.v
            matrices = before.mass_matrix(q), self._dynamics.mass_matrix(q)
            self.state = _state(q=q, v=joined_velocity(*matrices, v, self._model.locked))

    def _with_payloads(self, carried: tuple[Fault, ...]) -> Dynamics:
        return robot_dynamics(loaded(self._robot, carried)) if carried else self._unloaded

    def _efforts(self, command: Command) -> tuple[np.ndarray, np.ndarray]:
        if command.thrust is None or command.torque is None:
            raise InvalidInput("the dynamic plant needs thrust and torque; wrap the controller in a DynamicController")
        effort = self._robot.limits.effort
        return command.thrust, np.clip(command.torque, -effort, effort)

    def _water(self) -> tuple[np.ndarray, np.ndarray]:
        """Velocity [m/s] and acceleration Du/Dt [m/s2] (3, n_links) of the water at the links."""
        water = water_at(self._environment.current, self._dynamics.link_positions(self.state.q), self._t)
        return water.velocity.T, water.acceleration.T

    def _floor(self) -> tuple[np.ndarray, np.ndarray]:
        """Height (n_points,) [m] and normal (3, n_points) [-] of the floor below the contact points."""
        q = self.state.q
        corners = self._points @ quaternion_to_matrix(q[3:7]).T + q[:3] if len(self._points) else self._points
        floor = self._environment.seafloor
        heights = [floor.height(x, y) for x, y, _ in corners]
        normals = [floor.normal(x, y) for x, y, _ in corners]
        return np.array(heights), np.array(normals).reshape(-1, 3).T
