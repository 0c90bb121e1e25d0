"""The physical plant: thrusters and motors push a robot through moving water, above a floor that pushes back."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from uvms_ocp.arguments import Period, checked, late, trusted
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.compile import compile_function
from uvms_ocp.functions.numbers_apart import compile_shared
from uvms_ocp.model.dynamics import Dynamics, robot_dynamics
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.state import Command, State
from uvms_ocp.sim.contact import ContactModel, skid_points
from uvms_ocp.sim.dynamic_step import JointStops, StepModel, step_function
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.faults.current_step import with_steps
from uvms_ocp.sim.faults.fault import Fault
from uvms_ocp.sim.faults.plant_faults import active_of, jammed_axes, joined_velocity, loaded, payloads
from uvms_ocp.sim.faults.thruster_condition import condition_of
from uvms_ocp.sim.plant import Plant
from uvms_ocp.sim.step_sequence import StepSequence, parts_of
from uvms_ocp.sim.surroundings import Surroundings
from uvms_ocp.sim.thrusters import Thrusters

_state = trusted(State)

_STRUCK = ("thruster", "joint", "payload")
BRAKE_FRICTION = 1e6  # [N m s/rad] of a locked joint, which creeps by less than a milliradian in a minute (assumed)


@checked
class DynamicPlant(Plant):
    """Robot, thrusters, water and floor at `max_step` or finer; see `uvms_ocp.sim.dynamic_step` for the equations."""

    _dt: float
    """[s] of a control period."""
    _advance: StepSequence
    """The steps of one."""
    _given: Mapping[str, np.ndarray]
    """What they read."""

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
        shared: bool = False,
    ) -> None:
        """q0 (n_q,) [m, rad]: the start, at rest. max_step [s]. faults: those of sensors are left out.

        shared: whether machine code serves all robots that differ in numbers alone, for one that is drawn at random.

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
            thrusters=Thrusters.of(robot),
        )
        compiled = compile_shared if shared else compile_function
        self._step = compiled(step_function(self._model))
        self._surroundings = Surroundings(self._environment, dynamics.symbolic, self._points)
        self._faults = tuple(fault for fault in faults if fault.strikes.family in _STRUCK)
        self._active: tuple[Fault, ...] = ()
        self._t = 0.0
        self._shapes = (len(robot.description.thrusters),), (robot.n_joints,)
        self._condition = condition_of((), np.zeros(self._shapes[0]))
        self.state = State(q=robot.check_configuration(q0), v=np.zeros(robot.n_v), a=np.zeros(robot.n_v))
        self._parts = parts_of(self._step)
        self._after = np.zeros(self._parts["a"].stop)
        self._after[self._parts["thruster_energy"]] = 0.0 * self._model.thrusters.factor
        self._begin(max_step)

    @late
    def step(self, command: Command, dt: Period) -> None:
        """Advance by dt [s]. Water and floor are sampled once, thrust and motion in steps of at most `max_step`.

        Raises `InvalidInput` for a command without thrust or torque, or with some that are not finite or of another number.
        """
        if self._faults and (active := active_of(self._faults, self._t)) != self._active:
            self._suffer(active)
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
            "thrust": after[parts["thrust"]],
            "torque": after[parts["torque"]],
            "contact": after[parts["contact"]],
            "thruster_energy": after[parts["thruster_energy"]],
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
        """From now on, with the function there is, take periods of dt [s]."""
        n_steps = max(1, math.ceil(dt / self._max_step - 1e-9))
        self._dt, self._advance = dt, StepSequence(self._step, n_steps)
        self._given = given = self._advance.given
        self._advance.carried[:] = self._after[: len(self._advance.carried)]
        given["dt"][0], given["decay"][:] = dt, self._model.thrusters.decay(dt / n_steps).T
        given["share"][:], given["offset"][:] = self._condition.share, self._condition.offset
        self._surroundings.bind(given)

    def _suffer(self, active: tuple[Fault, ...]) -> None:
        """Go on with other faults than before."""
        self._after = self._after.copy()
        thrust = self._after[self._parts["thrust"]]
        self._condition = condition_of(active, thrust)
        thrust[self._condition.dead] = 0.0
        had, have, locked = payloads(self._active), payloads(active), jammed_axes(self._robot, active)
        self._active = active
        if have != had:
            self._carry(had, have)
        if have != had or locked != self._model.locked:
            # Not compiled: a run does not wait for that in its middle.
            self._model = replace(self._model, dynamics=self._dynamics.symbolic, locked=locked)
            self._step = step_function(self._model)
            self._surroundings = Surroundings(self._environment, self._dynamics.symbolic, self._points, compiled=False)
        self._begin(self._dt)

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
