"""Plants: what a command does to the true state. Kinematic, or a robot pushed by thrusters and motors through moving water."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any, Protocol

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_constructor, unchecked_constructor
from uvms_ocp.codegen.compile import compile_function
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import Command, Robot, State
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.shapes.hull import skid_points
from uvms_ocp.sim import dynamic_step, fault_effects as effects, thrusters
from uvms_ocp.sim.environment import Environment, EnvironmentSampler
from uvms_ocp.sim.faults import Fault
from uvms_ocp.types import Period, Positive

# Plants: what a command does to the true state.

_state = unchecked_constructor(State)


EFFORTS = ("thrust", "torque", "thruster_energy", "joint_energy")
"""Telemetry that reports and figures know."""


class Plant(Protocol):
    """Something with a true state that a command advances; built for one run, at its start."""

    state: State
    """The true one: another value, or other arrays, after each step; with `a` where an accelerometer is among the sensors."""

    def step(self, command: Command, dt: float) -> None:
        """Advance by dt [s]. The command has thrust and torque where the plant takes forces, the velocity always."""

    def telemetry(self) -> dict[str, Any]:
        """Return quantities beside its state, for the record: numbers and arrays (n,), the same at every tick, empty for none.

        Reports and figures know ``thrust`` (n_thrusters,) [N], ``torque`` (n_joints,) [N m], and what was taken so far,
        ``thruster_energy`` (n_thrusters,) [J], nan where not known, and ``joint_energy`` [J]; a plant tells all four or none.
        The scene draws ``contact`` (n_points,) [N], of the floor on each of `uvms_ocp.robot.shapes.hull.skid_points`, and
        ``current`` (3,) [m/s] in W, of the water at the vehicle. Other names of `uvms_ocp.record.tables.SERIES` are taken.
        """


@checked_constructor
class KinematicPlant(Plant):
    """The paper's plant: velocities follow the command at once, except those of joints that are jammed."""

    def __init__(self, robot: Robot, q0: np.ndarray, faults: tuple[Fault, ...] = ()) -> None:
        """Q0 (n_q,) [m, rad]: the start. Raises `InvalidInput`, as `Robot.check_configuration`."""
        self._model, self._robot, self._faults = robot.model, robot, faults
        self._t = 0.0
        self.state = State(q=robot.check_configuration(q0), v=np.zeros(robot.n_v), a=np.zeros(robot.n_v))

    def step(self, command: Command, dt: Period) -> None:
        v = command.v
        if self._faults and (jammed := effects.jammed_axes(self._robot, effects.active_of(self._faults, self._t))):
            v = v.copy()
            v[list(jammed)] = 0.0
        acceleration = (v - self.state.v) / dt
        self.state = _state(q=pin.integrate(self._model, self.state.q, v * dt), v=v, a=acceleration)
        self._t += dt

    def telemetry(self) -> dict[str, Any]:
        """Nothing: the state is all there is."""
        return {}


# The physical plant: thrusters and motors push a robot through moving water, above a floor that pushes back.


@lru_cache(maxsize=8)
def _compiled_step(
    robot: Robot, dynamics: Dynamics, contact: dynamic_step.ContactModel, stops: dynamic_step.JointStops
) -> tuple[dynamic_step.StepModel, ca.Function]:
    """Model of the step and its function, made once for many runs."""
    model = dynamic_step.StepModel(
        robot=robot,
        dynamics=dynamics.symbolic,
        points=skid_points(robot),
        contact=contact,
        stops=stops,
        thrusters=thrusters.Thrusters.of(robot),
    )
    return model, compile_function(dynamic_step.step_function(model))


_PLANT_FAULTS = ("thruster", "joint", "payload")
BRAKE_FRICTION = 1e6  # [N m s/rad] of a locked joint, which creeps by less than a milliradian in a minute (assumed)


@checked_constructor
class DynamicPlant(Plant):
    """Robot, thrusters, water and floor at `max_step` or finer; see `uvms_ocp.sim.dynamic_step` for the equations."""

    _dt: float
    """[s] of a control period."""
    _advance: dynamic_step.StepSequence
    """The steps of one period."""
    _given: Mapping[str, np.ndarray]
    """Inputs of the steps."""

    def __init__(
        self,
        robot: Robot,
        q0: np.ndarray,
        *,
        dynamics: Dynamics,
        environment: Environment,
        max_step: Positive = 1e-3,
        contact: dynamic_step.ContactModel | None = None,
        stops: dynamic_step.JointStops | None = None,
        faults: tuple[Fault, ...] = (),
    ) -> None:
        """Q0 (n_q,) [m, rad]: the start, at rest. max_step [s]. faults: those of sensors are left out.

        Raises `InvalidInput` for a max_step that is not > 0, and as `Robot.check_configuration`.
        """
        self._robot, self._unloaded, self._dynamics, self._max_step = robot, dynamics, dynamics, max_step
        self._environment = effects.with_steps(environment, faults)
        parts = contact or dynamic_step.ContactModel(), stops or dynamic_step.JointStops()
        self._model, self._step = _compiled_step(robot, dynamics, *parts)
        self._surroundings = EnvironmentSampler(self._environment, dynamics.symbolic, self._model.points)
        self._faults = tuple(fault for fault in faults if fault.location.family in _PLANT_FAULTS)
        self._active: tuple[Fault, ...] = ()
        self._t = 0.0
        self._shapes = (len(robot.description.thrusters),), (robot.n_joints,)
        self._condition = effects.condition_of((), np.zeros(self._shapes[0]))
        self.state = State(q=robot.check_configuration(q0), v=np.zeros(robot.n_v), a=np.zeros(robot.n_v))
        self._parts = dynamic_step.parts_of(self._step)
        self._after = np.zeros(self._parts["a"].stop)
        self._after[self._parts["thruster_energy"]] = 0.0 * self._model.thrusters.factor
        self._begin(max_step)

    def step(self, command: Command, dt: Period) -> None:
        """Advance by dt [s]. Water and floor are sampled once, thrust and motion in steps of at most `max_step`.

        Raises `InvalidInput` for a command without thrust or torque, or with some that are not finite or of another number.
        """
        if self._faults and (active := effects.active_of(self._faults, self._t)) != self._active:
            self._apply_faults(active)
        if dt != self._dt:
            self._begin(dt)
        given, advance = self._given, self._advance
        self._ask(command, given)
        given["q"][:], given["v"][:] = self.state.q, self.state.v  # others may have put them there
        self._surroundings.sample(self.state.q, self._t)
        self._after = after = advance()
        advance.carried[:] = after[: len(advance.carried)]
        self._t += dt
        parts = self._parts
        self.state = _state(q=after[parts["q"]], v=after[parts["v"]], a=after[parts["a"]])

    def telemetry(self) -> dict[str, Any]:
        after, parts = self._after, self._parts
        return {
            **{name: after[parts[name]] for name in ("thrust", "torque", "contact", "thruster_energy")},
            "joint_energy": after.item(parts["joint_energy"].start),
            "current": self._given["u"][:1].sum(axis=0),  # nothing where no link is in water
        }

    def _ask(self, command: Command, memory: Mapping[str, np.ndarray]) -> None:
        """Write down what the command asks for."""
        thrust, torque = command.thrust, command.torque
        if thrust is None or torque is None:
            raise InvalidInput("the dynamic plant needs thrust and torque; wrap the controller in a DynamicController")
        # Limits would hide what is NaN or infinite; its square is no finite number.
        finite = math.isfinite(thrust.dot(thrust) + torque.dot(torque))
        if (thrust.shape, torque.shape) != self._shapes or not finite:
            (n,), (m,) = self._shapes
            given = f"thrust {thrust.tolist()} N, torque {torque.tolist()} N m given"
            raise InvalidInput(f"{given}; allowed: {n} and {m} finite numbers")
        memory["asked_thrust"][:], memory["asked_torque"][:] = thrust, torque
        memory["brake"][0] = BRAKE_FRICTION if command.brakes else 0.0

    def _begin(self, dt: float) -> None:
        """Take periods of dt [s] from now on, with the function there is."""
        n_steps = max(1, math.ceil(dt / self._max_step - 1e-9))
        self._dt, self._advance = dt, dynamic_step.StepSequence(self._step, n_steps)
        self._given = given = self._advance.given
        self._advance.carried[:] = self._after[: len(self._advance.carried)]
        given["dt"][0], given["decay"][:] = dt, self._model.thrusters.decay(dt / n_steps).T
        given["share"][:], given["offset"][:] = self._condition.share, self._condition.offset
        self._surroundings.bind(given)

    def _apply_faults(self, active: tuple[Fault, ...]) -> None:
        """Go on with other faults than before."""
        self._after = self._after.copy()
        thrust = self._after[self._parts["thrust"]]
        self._condition = effects.condition_of(active, thrust)
        thrust[self._condition.dead] = 0.0
        had, have, locked = effects.payloads(self._active), effects.payloads(active), effects.jammed_axes(self._robot, active)
        self._active = active
        if have != had:
            self._carry(had, have)
        if have != had or locked != self._model.locked:
            # Not compiled: a run does not wait for that in its middle.
            self._model = replace(self._model, dynamics=self._dynamics.symbolic, locked=locked)
            self._step = dynamic_step.step_function(self._model)
            self._surroundings = EnvironmentSampler(
                self._environment, self._dynamics.symbolic, self._model.points, compiled=False
            )
        self._begin(self._dt)

    def _carry(self, had: tuple[Fault, ...], have: tuple[Fault, ...]) -> None:
        """Let go of payloads, which take their momentum along, and pick up others, which lay still."""
        kept = tuple(fault for fault in had if fault in have)
        before = self._with_payloads(kept)
        self._dynamics = before if have == kept else self._with_payloads(have)
        if have != kept:
            q, v = self.state.q, self.state.v
            matrices = before.mass_matrix(q), self._dynamics.mass_matrix(q)
            self.state = _state(q=q, v=effects.joined_velocity(*matrices, v, self._model.locked))

    def _with_payloads(self, carried: tuple[Fault, ...]) -> Dynamics:
        return robot_dynamics(effects.loaded(self._robot, carried)) if carried else self._unloaded
