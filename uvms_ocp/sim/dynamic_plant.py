"""The physical plant: thrusters and motors push a robot through moving water, above a floor that
pushes back.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_constructor
from uvms_ocp.codegen.kernel_layout import (
    CallbackBinding,
    arrays_of,
    assign,
)
from uvms_ocp.codegen.kernels import make_memory
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import Command, Robot, State, signals
from uvms_ocp.robot.dynamics import Dynamics, robot_dynamics
from uvms_ocp.robot.shapes.hull import skid_points
from uvms_ocp.sim import (
    dynamic_step,
    machine_faults,
    seafloor_contact,
    stepped_current,
    thrusters,
)
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.environment_sampler import EnvironmentSampler
from uvms_ocp.sim.faults import Fault
from uvms_ocp.sim.plant import Plant
from uvms_ocp.types import Period, Positive

_TELEMETRY = ("thrust", "torque", "contact", "thruster_energy", "joint_energy")
_PLANT_FAULTS = ("thruster", "joint", "payload")


@lru_cache(maxsize=8)
def _step(
    robot: Robot,
    dynamics: Dynamics,
    contact: seafloor_contact.ContactModel,
    stops: dynamic_step.JointStops,
) -> tuple[dynamic_step.StepModel, ca.Function]:
    """Make the model of the step and its function, once for many runs."""
    model = dynamic_step.StepModel(
        robot=robot,
        dynamics=dynamics.symbolic,
        points=skid_points(robot),
        contact=contact,
        stops=stops,
        thrusters=thrusters.Thrusters.of(robot),
    )
    return model, dynamic_step.step_function(model)


@checked_constructor
class DynamicPlant(Plant):
    """Robot, thrusters, water and floor at `max_step` or finer; see `uvms_ocp.sim.dynamic_step` for
    the equations.
    """

    memory: dynamic_step.PlantMemory
    """Memory of the kernel."""
    _arrays: Any
    """Arrays of `memory`."""
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
        contact: seafloor_contact.ContactModel | None = None,
        stops: dynamic_step.JointStops | None = None,
        faults: tuple[Fault, ...] = (),
    ) -> None:
        """q0 (n_q,) [m, rad]: start, at rest. max_step [s]: longest step. faults: those of sensors
        are left out.

        Raises `InvalidInput` for a max_step that is not > 0, and for a start that is no
        configuration of the robot.
        """
        self._robot = robot
        self._unloaded = dynamics
        self._dynamics = dynamics
        self._max_step = max_step
        self._environment = stepped_current.with_steps(environment, faults)
        parts = contact or seafloor_contact.ContactModel(), stops or dynamic_step.JointStops()
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

        def sample() -> None:
            surroundings.sample(arrays.q, self.memory.t, self.memory.dt)

        self._sampling = CallbackBinding(self.memory.sample, sample)

    def step(self, command: Command, dt: Period) -> None:
        """Advance by dt [s]. Water and floor are sampled once, thrust and motion in steps of at
        most `max_step`.

        Raises `InvalidInput` for a command without thrust or torque, or with some that are not
        finite or of another number.
        """
        self.ask(command)
        self.begin(dt)
        self._advance(self.memory)
        self.adopt()

    @property
    def is_compiled(self) -> bool:
        """True where the plant moves as machine code."""
        return not inspect.isfunction(self._advance)

    def begin(self, dt: Period) -> None:
        """Have the kernel go on from the present state, by periods of dt [s], with the faults that
        there are now.
        """
        if self.faults:
            active = machine_faults.active_of(self.faults, self.memory.t)
            if active != self._active:
                self._apply_faults(active)
        # The state may have been set from outside.
        self._arrays.q[:] = self.state.q
        self._arrays.v[:] = self.state.v
        if dt != self._dt:
            self._dt = dt
            n_steps = max(1, math.ceil(dt / self._max_step - 1e-9))
            step_dt = dt / n_steps
            decay = self._model.thrusters.decay(step_dt).T.ravel()
            assign(self.memory, dt=dt, n_steps=n_steps, step_dt=step_dt, decay=decay)

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
        """Return telemetry on the memory of the kernel."""
        arrays = self._arrays
        telemetry = {name: getattr(arrays, name) for name in _TELEMETRY}
        telemetry["joint_energy"] = arrays.joint_energy.reshape(())
        telemetry["current"] = np.zeros(3)
        has_links_in_water = len(arrays.u) > 0
        if has_links_in_water:
            telemetry["current"] = arrays.u[:3]
        return telemetry

    def ask(self, command: Command) -> None:
        """Take down the thrust and torque that a command asks for. Raises as `step`."""
        thrust = command.thrust
        torque = command.torque
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
        self.memory.brake = 1.0 if command.brakes else 0.0

    def _apply_faults(self, active: tuple[Fault, ...]) -> None:
        """Go on with other faults than before."""
        condition = machine_faults.thruster_condition(active, self._arrays.thrust)
        self._arrays.thrust[condition.dead] = 0.0
        had = machine_faults.payloads(self._active)
        have = machine_faults.payloads(active)
        locked = machine_faults.jammed_axes(self._robot, active)
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
            return
        self._dynamics = self._with_payloads(have)
        q = self.state.q
        v = machine_faults.joined_velocity(
            before.mass_matrix(q), self._dynamics.mass_matrix(q), self.state.v, self._model.locked
        )
        self.state = signals.unchecked_state(q=q, v=v)

    def _with_payloads(self, carried: tuple[Fault, ...]) -> Dynamics:
        if carried:
            return robot_dynamics(machine_faults.loaded(self._robot, carried))
        return self._unloaded
