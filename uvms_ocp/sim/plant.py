"""Plants: what a command does to the true state. Kinematic, or a robot pushed by thrusters and
motors through moving water.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any, Protocol

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_constructor
from uvms_ocp.codegen.kernel_layout import (
    CallbackBinding,
    FunctionField,
    Layout,
    Sized,
    Vector,
    arrays_of,
    assign,
    structure_of,
)
from uvms_ocp.codegen.kernels import make_memory
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import Command, Robot, State, SymbolicModel, signals
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.shapes.hull import skid_points
from uvms_ocp.sim import dynamic_step, fault_effects as effects, thrusters
from uvms_ocp.sim.environment import Environment, EnvironmentSampler
from uvms_ocp.sim.faults import Fault
from uvms_ocp.types import Period, Positive

# Plants: what a command does to the true state.


EFFORTS = ("thrust", "torque", "thruster_energy", "joint_energy")
"""Telemetry that reports and figures know."""


class Plant(Protocol):
    """Something with a true state that a command advances; built for one run, at its start."""

    state: State
    """The true one: another value, or other arrays, after each step; with `a` where an
    accelerometer is among the sensors.
    """

    def step(self, command: Command, dt: float) -> None:
        """Advance by dt [s]. The command has thrust and torque where the plant takes forces, the
        velocity always.
        """

    def telemetry(self) -> dict[str, Any]:
        """Return quantities beside its state, for the record: numbers and arrays (n,), the same at
        every tick, empty for none.

        Reports and figures know ``thrust`` (n_thrusters,) [N], ``torque`` (n_joints,) [N m], and
        what was taken so far, ``thruster_energy`` (n_thrusters,) [J], nan where not known, and
        ``joint_energy`` [J]; a plant tells all four or none. The scene draws ``contact``
        (n_points,) [N], of the floor on each of `uvms_ocp.robot.shapes.hull.skid_points`, and
        ``current`` (3,) [m/s] in W, of the water at the vehicle. Other names of
        `uvms_ocp.record.tables.SERIES` are taken.
        """


class KinematicMemory(Layout):
    """State of the kinematic plant, and the velocity that it is asked for."""

    integrate: FunctionField
    """Q and change (n_v,) [m, rad] to `q_next`."""
    t: float
    """[s] time of the state."""
    dt: float
    """[s] of a control period."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad]"""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s]"""
    a: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s2, rad/s2] by which v changed in the last period."""
    asked: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s]"""
    change: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m, rad] in a period."""
    q_next: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] after it."""


def advance_kinematic(p: KinematicMemory) -> None:
    """Move the plant by one control period. A kernel."""
    for i in range(len(p.v)):
        p.a[i] = (p.asked[i] - p.v[i]) / p.dt
        p.v[i] = p.asked[i]
        p.change[i] = p.v[i] * p.dt
    p.integrate(p.q, p.change, p.q_next)
    p.q[:] = p.q_next
    p.t += p.dt


@checked_constructor
class KinematicPlant(Plant):
    """The paper's plant: velocities follow the command at once, except those of joints that are
    jammed.
    """

    def __init__(self, robot: Robot, q0: np.ndarray, faults: tuple[Fault, ...] = ()) -> None:
        """Q0 (n_q,) [m, rad]: the start. Raises `InvalidInput`, as `Robot.check_configuration`."""
        self._robot = robot
        self.faults = faults
        structure = structure_of(
            KinematicMemory, n_q=robot.n_q, n_v=robot.n_v, integrate=_integration(robot)
        )
        self.memory: KinematicMemory
        """Memory of the kernel."""
        self.memory, (self._advance,) = make_memory(structure, (advance_kinematic,))
        self._arrays = arrays_of(self.memory)
        self.state = State(
            q=robot.check_configuration(q0), v=np.zeros(robot.n_v), a=np.zeros(robot.n_v)
        )

    def step(self, command: Command, dt: Period) -> None:
        arrays = self._arrays
        arrays.asked[:] = command.v
        if self.faults:
            active = effects.active_of(self.faults, self.memory.t)
            jammed = effects.jammed_axes(self._robot, active)
            arrays.asked[list(jammed)] = 0.0
        self.begin(dt)
        self._advance(self.memory)
        self.adopt()

    def begin(self, dt: Period) -> None:
        """Have the kernel go on from the present state, by periods of dt [s]."""
        self.memory.dt = dt
        self._arrays.q[:] = self.state.q
        self._arrays.v[:] = self.state.v

    def adopt(self) -> None:
        """Take the state of the memory for the present one."""
        arrays = self._arrays
        self.state = signals.unchecked_state(
            q=arrays.q.copy(), v=arrays.v.copy(), a=arrays.a.copy()
        )

    def telemetry(self) -> dict[str, Any]:
        """Nothing: the state is all there is."""
        return {}

    telemetry_in_memory = telemetry


@lru_cache(maxsize=8)
def _integration(robot: Robot) -> ca.Function:
    q = ca.SX.sym("q", robot.n_q)
    change = ca.SX.sym("change", robot.n_v)
    q_next = SymbolicModel(robot.model).integrate(q, change)
    if (
        robot.n_vehicle
    ):  # whose quaternion keeps norm 1, so that rounding does not add up over a run
        q_next = ca.vertcat(q_next[:3], q_next[3:7] / ca.norm_2(q_next[3:7]), q_next[7:])
    return ca.Function("integrate", [q, change], [ca.densify(q_next)], {"cse": True})


# The physical plant: thrusters and motors push a robot through moving water, above a floor that
# pushes back.


@lru_cache(maxsize=8)
def _step(
    robot: Robot,
    dynamics: Dynamics,
    contact: dynamic_step.ContactModel,
    stops: dynamic_step.JointStops,
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
    return model, dynamic_step.step_function(model)


_TELEMETRY = ("thrust", "torque", "contact", "thruster_energy", "joint_energy")
_PLANT_FAULTS = ("thruster", "joint", "payload")
# [N m s/rad] of a locked joint, which creeps by less than a milliradian in a minute (assumed)
BRAKE_FRICTION = 1e6


@checked_constructor
class DynamicPlant(Plant):
    """Robot, thrusters, water and floor at `max_step` or finer; see `uvms_ocp.sim.dynamic_step` for
    the equations.
    """

    memory: dynamic_step.PlantMemory
    """Memory of the kernel."""
    _arrays: Any
    """Its arrays."""
    _advance: Callable[[dynamic_step.PlantMemory], None]
    _sampling: CallbackBinding
    _dt: float
    """[s] of a control period."""

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
        """Q0 (n_q,) [m, rad]: the start, at rest. max_step [s]. faults: those of sensors are left
        out.

        Raises `InvalidInput` for a max_step that is not > 0, and as `Robot.check_configuration`.
        """
        self._robot = robot
        self._unloaded = dynamics
        self._dynamics = dynamics
        self._max_step = max_step
        self._environment = effects.with_steps(environment, faults)
        parts = contact or dynamic_step.ContactModel(), stops or dynamic_step.JointStops()
        self._model, step = _step(robot, dynamics, *parts)
        self.faults = tuple(fault for fault in faults if fault.location.family in _PLANT_FAULTS)
        self._active: tuple[Fault, ...] = ()
        self._shapes = (len(robot.description.thrusters),), (robot.n_joints,)
        self.state = State(
            q=robot.check_configuration(q0), v=np.zeros(robot.n_v), a=np.zeros(robot.n_v)
        )
        self._make(step)
        assign(self.memory, thruster_energy=0.0 * self._model.thrusters.factor, share=1.0)

    def _make(self, step: ca.Function, *, compiled: bool = True) -> None:
        """Give the kernel its memory."""
        structure = dynamic_step.plant_structure(self._model, step)
        self.memory, (self._advance,) = make_memory(
            structure, (dynamic_step.advance_plant,), compiled=compiled
        )
        self._arrays = arrays = arrays_of(self.memory)
        surroundings = EnvironmentSampler(
            self._environment, self._model.dynamics, self._model.points, compiled=compiled
        )
        surroundings.bind(
            u=arrays.u.reshape(-1, 3),
            Du_Dt=arrays.Du_Dt.reshape(-1, 3),
            floor_z=arrays.floor_z,
            floor_normal=arrays.floor_normal.reshape(-1, 3),
        )
        self.memory.sampled = surroundings.changes
        self._dt = 0.0
        self._sampling = CallbackBinding(
            self.memory.sample, lambda: surroundings.sample(arrays.q, self.memory.t, self.memory.dt)
        )

    def step(self, command: Command, dt: Period) -> None:
        """Advance by dt [s]. Water and floor are sampled once, thrust and motion in steps of at
        most `max_step`.

        Raises `InvalidInput` for a command without thrust or torque, or with some that are not
        finite or of another number.
        """
        self._ask(command)
        self.begin(dt)
        self._advance(self.memory)
        self.adopt()

    def begin(self, dt: Period) -> None:
        """Have the kernel go on from the present state, by periods of dt [s], with the faults that
        there are now.
        """
        if (
            self.faults
            and (active := effects.active_of(self.faults, self.memory.t)) != self._active
        ):
            self._apply_faults(active)
        # others may have put them there
        self._arrays.q[:] = self.state.q
        self._arrays.v[:] = self.state.v
        if dt != self._dt:
            self._dt = dt
            n_steps = max(1, math.ceil(dt / self._max_step - 1e-9))
            decay = self._model.thrusters.decay(dt / n_steps).T.ravel()
            assign(self.memory, dt=dt, n_steps=n_steps, step_dt=dt / n_steps, decay=decay)

    def adopt(self) -> None:
        """Take the state of the memory for the present one. Raises what its environment raises."""
        self._sampling.check()
        arrays = self._arrays
        self.state = signals.unchecked_state(
            q=arrays.q.copy(), v=arrays.v.copy(), a=arrays.a.copy()
        )

    def telemetry(self) -> dict[str, Any]:
        return {name: array.copy()[()] for name, array in self.telemetry_in_memory().items()}

    def telemetry_in_memory(self) -> dict[str, np.ndarray]:
        """Telemetry on the memory of the kernel."""
        arrays = self._arrays
        telemetry = {name: getattr(arrays, name) for name in _TELEMETRY}
        telemetry["joint_energy"] = arrays.joint_energy.reshape(())
        return telemetry | {
            "current": arrays.u[:3] if len(arrays.u) else np.zeros(3)
        }  # nothing where no link is in water

    def _ask(self, command: Command) -> None:
        """Write down what the command asks for."""
        thrust, torque = command.thrust, command.torque
        if thrust is None or torque is None:
            raise InvalidInput(
                "the dynamic plant needs thrust and torque; wrap the controller in a"
                " DynamicController"
            )
        # Limits would hide what is NaN or infinite; its square is no finite number.
        finite = math.isfinite(thrust.dot(thrust) + torque.dot(torque))
        if (thrust.shape, torque.shape) != self._shapes or not finite:
            (n,), (m,) = self._shapes
            problem = f"thrust {thrust.tolist()} N, torque {torque.tolist()} N m given"
            raise InvalidInput(f"{problem}; allowed: {n} and {m} finite numbers")
        self._arrays.asked_thrust[:] = thrust
        self._arrays.asked_torque[:] = torque
        self.memory.brake = BRAKE_FRICTION if command.brakes else 0.0

    def _apply_faults(self, active: tuple[Fault, ...]) -> None:
        """Go on with other faults than before."""
        condition = effects.condition_of(active, self._arrays.thrust)
        self._arrays.thrust[condition.dead] = 0.0
        had = effects.payloads(self._active)
        have = effects.payloads(active)
        locked = effects.jammed_axes(self._robot, active)
        self._active = active
        if have != had:
            self._carry(had, have)
        if have != had or locked != self._model.locked:
            # Not compiled: a run does not wait for that in its middle.
            self._model = replace(self._model, dynamics=self._dynamics.symbolic, locked=locked)
            before = self.memory
            self._make(dynamic_step.step_function(self._model), compiled=False)
            for name in ("t", "asked_thrust", "asked_torque", "brake", *_TELEMETRY):
                setattr(self.memory, name, getattr(before, name))
        assign(self.memory, share=condition.share, offset=condition.offset)

    def _carry(self, had: tuple[Fault, ...], have: tuple[Fault, ...]) -> None:
        """Let go of payloads, which take their momentum along, and pick up others, which lay
        still.
        """
        lasting = tuple(fault for fault in had if fault in have)
        before = self._with_payloads(lasting)
        if have == lasting:
            self._dynamics = before
        else:
            self._dynamics = self._with_payloads(have)
        if have != lasting:
            q, v = self.state.q, self.state.v
            matrices = before.mass_matrix(q), self._dynamics.mass_matrix(q)
            self.state = signals.unchecked_state(
                q=q, v=effects.joined_velocity(*matrices, v, self._model.locked)
            )

    def _with_payloads(self, carried: tuple[Fault, ...]) -> Dynamics:
        if carried:
            return robot_dynamics(effects.loaded(self._robot, carried))
        return self._unloaded
