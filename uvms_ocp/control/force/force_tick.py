"""A tick of the force layer in Python: its memory, made once, and the kernel that works on it."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from uvms_ocp.control.actuator_health.thresholds import ActuatorHealthTuning
from uvms_ocp.control.actuator_health.watch_memory import look_sizes, write_look
from uvms_ocp.control.force.allocation import allocation_of, sharing_sizes
from uvms_ocp.control.force.force_step import ForceMemory, adapt, begin_force, force_step
from uvms_ocp.control.force.thrust_sharing import MOST
from uvms_ocp.control.force.tick_columns import Given, Known, Told, places_of, views_of
from uvms_ocp.control.force.tick_functions import TickLaws, follow_function, observe_function, want_function
from uvms_ocp.control.force.velocity_law import Borne
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.functions.kernels.binding import memory_of
from uvms_ocp.functions.kernels.layout import structure_of
from uvms_ocp.functions.kernels.smooth import column_view
from uvms_ocp.model.state import Command


class ForceTick:
    """From a reference velocity to commands.

    Holds what is known: build one per run. Not for use from two threads at once.
    """

    def __init__(self, laws: TickLaws, borne: Borne | None = None, *, compiled: bool = True) -> None:
        """borne: of what the sensors are like. compiled: in C where there is a compiler."""
        structure = structure_of(ForceMemory, **_sizes(laws))
        self.memory: Any
        """A `ForceMemory`"""
        self.memory, (begin, self._step, self._adapt) = memory_of(
            structure, (begin_force, force_step, adapt), compiled=compiled
        )
        self.given: Given = views_of(Given, laws.sizes, self.memory.given)
        """What the next tick is given."""
        parts = {name: getattr(self.memory.given, name) for name in Given.__dataclass_fields__}
        self._flags = Given(**parts)  # of ctypes, which take single numbers sooner than NumPy
        self.now: Known = views_of(Known, laws.sizes, self.memory.now)
        """What was known in the last one."""
        self.known: Known = views_of(Known, laws.sizes, self.memory.known)
        """What the next one goes on from."""
        self._told = column_view(self.memory.told)
        self._places = tuple(places_of(Told, laws.sizes).values())
        self._write(laws, borne or Borne())
        begin(self.memory)

    def give(self, q: np.ndarray, v: np.ndarray, command: Command, feedback: tuple[float, float]) -> None:
        """The robot at q (n_q,) [m, rad] and v (n_v,) [m/s, rad/s] as measured, and the command of the velocities.

        feedback [-]: of vehicle and joints, as `Given` has it.
        """
        given = self.given
        given.q[:], given.v[:], given.reference[:] = q, v, command.v
        flags = self._flags
        flags.feedback[0], flags.joint_feedback[0] = feedback
        flags.hold[0], flags.stop[0] = command.hold, command.stop
        self.memory.brakes = command.brakes

    def step(self, t: float, joint_age: float = 0.0, encoders_known: bool = True) -> list[np.ndarray]:
        """A tick at time t [s]: the parts of `Told`, which the caller owns.

        joint_age [s] and encoders_known: as `ForceMemory` has them. Raises `InvalidInput` for a force that is not finite, or
        that is beyond `MOST`.
        """
        memory = self.memory
        memory.t, memory.joint_age, memory.encoders_known = t, joint_age, encoders_known
        if not self._step(memory):
            force = np.array(memory.wanted.force)
            raise InvalidInput(
                f"a motion that needs the force {force} [N, N m]; give one of finite forces below {MOST:g}"
            )
        told = self._told.copy()
        return [told[place] for place in self._places]

    @property
    def observes(self) -> bool:
        """Whether the last tick was given velocities that the observer may learn from."""
        flags, without_joints = self._flags, not self.memory.look.joints.count
        return not (flags.hold[0] or flags.stop[0]) and (without_joints or bool(flags.joints[0]))

    def adapt(self) -> None:
        """To the effect in the memory of the look, as a tick does that has found one."""
        self._adapt(self.memory)

    def _write(self, laws: TickLaws, borne: Borne) -> None:
        memory, robot = self.memory, laws.robot
        memory.bears, memory.joints_bear, memory.joints_late = borne.vehicle, borne.joints, borne.joints_late
        allocation_of(robot).write(memory.sharing)
        memory.look.n_vehicle, memory.look.joints.count = robot.n_vehicle, robot.n_joints
        if laws.search is not None and laws.intake is not None and laws.observer is not None:
            memory.watched, bandwidth = True, float(laws.observer.bandwidth[0])
            write_look(memory.look, robot, laws.search, laws.intake, bandwidth=bandwidth, dt=laws.velocity.dt)


@lru_cache(maxsize=2)
def _sizes(laws: TickLaws) -> dict[str, Any]:
    """Sizes [-] and functions of a `ForceMemory`."""
    period = laws.velocity.dt * (laws.intake.every if laws.intake else 1)
    symbolic, search = laws.velocity.dynamics, laws.search or ActuatorHealthTuning()
    return {
        **look_sizes(laws.robot, symbolic, search, period),
        **sharing_sizes(len(laws.robot.description.thrusters)),
        **laws.sizes,
        "observe": observe_function(laws),
        "want": want_function(laws),
        "follow": follow_function(laws),
    }
