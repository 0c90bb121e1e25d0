"""Plants: the interface by which a command advances the true state, and the kinematic plant of the
paper.
"""

from __future__ import annotations

import inspect
from functools import lru_cache
from typing import Annotated, Any, Protocol

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked_constructor
from uvms_ocp.codegen.kernel_layout import (
    FunctionField,
    Layout,
    Sized,
    Vector,
    arrays_of,
    structure_of,
)
from uvms_ocp.codegen.kernels import make_memory
from uvms_ocp.robot import Command, Robot, State, SymbolicModel, signals
from uvms_ocp.robot.dimensions import dimensions_of
from uvms_ocp.sim import (
    machine_faults,
)
from uvms_ocp.sim.faults import Fault
from uvms_ocp.types import Period


class Plant(Protocol):
    """Something with a true state that a command advances; built for one run, at its start."""

    state: State
    """True state: another value, or other arrays, after each step; with `a` where an accelerometer
    is among the sensors.
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
    """Function of q and a change (n_v,) [m, rad] that gives `q_next`."""
    t: float
    """[s] time of the state."""
    dt: float
    """[s] Control period."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] configuration."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity."""
    a: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s2, rad/s2] change of v in the last period, over its length."""
    asked: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] commanded velocity."""
    jammed: Annotated[list[int], Sized("n_v")]
    """(n_v,) whether the axis cannot move."""
    change: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m, rad] motion in a period."""
    q_next: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] configuration after a period."""


def advance_kinematic(plant: KinematicMemory) -> None:
    """Move the plant by one control period. A kernel."""
    for i in range(len(plant.v)):
        v = 0.0 if plant.jammed[i] != 0 else plant.asked[i]
        plant.a[i] = (v - plant.v[i]) / plant.dt
        plant.v[i] = v
        plant.change[i] = plant.v[i] * plant.dt
    plant.integrate(plant.q, plant.change, plant.q_next)
    plant.q[:] = plant.q_next
    plant.t += plant.dt


@checked_constructor
class KinematicPlant(Plant):
    """The paper's plant: velocities follow the command at once, except those of joints that are
    jammed.
    """

    def __init__(self, robot: Robot, q0: np.ndarray, faults: tuple[Fault, ...] = ()) -> None:
        """q0 (n_q,) [m, rad]: start. Raises `InvalidInput` for one that is no configuration of the
        robot.
        """
        self._robot = robot
        self.faults = faults
        structure = structure_of(
            KinematicMemory, dimensions_of(robot), integrate=_integration(robot)
        )
        self.memory: KinematicMemory
        """Memory of the kernel."""
        self.memory, (self._advance,) = make_memory(structure, (advance_kinematic,))
        self._arrays = arrays_of(self.memory)
        self.state = State(
            q=robot.check_configuration(q0), v=np.zeros(robot.n_v), a=np.zeros(robot.n_v)
        )

    def step(self, command: Command, dt: Period) -> None:
        self.ask(command)
        self.begin(dt)
        self._advance(self.memory)
        self.adopt()

    def ask(self, command: Command) -> None:
        """Take down the velocity that a command asks for."""
        self._arrays.asked[:] = command.v

    @property
    def is_compiled(self) -> bool:
        """True where the plant moves as machine code."""
        return not inspect.isfunction(self._advance)

    def begin(self, dt: Period) -> None:
        """Have the kernel go on from the present state, by periods of dt [s], with the faults that
        there are now.
        """
        self.memory.dt = dt
        if self.faults:
            active = machine_faults.active_of(self.faults, self.memory.t)
            self._arrays.jammed[:] = 0
            self._arrays.jammed[list(machine_faults.jammed_axes(self._robot, active))] = 1
        self._arrays.q[:] = self.state.q
        self._arrays.v[:] = self.state.v

    def adopt(self) -> None:
        """Take the state of the memory for the present one."""
        arrays = self._arrays
        self.state = signals.unchecked_state(
            q=arrays.q.copy(), v=arrays.v.copy(), a=arrays.a.copy()
        )

    def telemetry(self) -> dict[str, Any]:
        """Return nothing: the state is all that this plant has."""
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
