"""Run another controller under the supervision of the mission."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any, Protocol, runtime_checkable

import numpy as np

from uvms_ocp.checks import replace_unchecked
from uvms_ocp.codegen.sequence import values_of
from uvms_ocp.control.velocity.kinematic import KinematicController
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.display import SmallTable, TableDisplay
from uvms_ocp.robot.signals import Command, StateEstimate


@runtime_checkable
class ReportingController(Protocol):
    """A controller that tells how it fares, such as `uvms_ocp.control.Nmpc`."""

    @property
    def alarms(self) -> Sequence[tuple[float, str]]:
        """Time [s] and text of each alarm so far."""

    @property
    def given_up(self) -> str:
        """Reason why the controller cannot go on; empty while it can."""


class SupervisedController(TableDisplay):
    """A controller ``(StateEstimate, t) -> Command`` that passes on the commands of another one,
    while a kinematic layer of its own follows the mission.

    The kinematic layer measures all quantities, goes through the phases and ends the run; its own
    commands are dropped. So a PID, a learned policy or the exported controller gets the same
    record, report and figures as ours. Alarms of a `ReportingController` go into the record, and
    where it gives up, the mission is given up with its reason. Feedback from thrusters and joints
    is not used: no mission is given up for thrust, contact or a faulty actuator.
    """

    def __init__(
        self,
        *,
        controller: Callable[[StateEstimate, float], Command],
        kinematic: KinematicController,
        n_thrusters: int | None,
        name: str,
    ) -> None:
        """n_thrusters: number of thrusters of the plant; `None` for a plant that takes velocities
        alone. name: of the controller, in messages.
        """
        self.kinematic = kinematic
        """Kinematic layer that follows the mission."""
        self.wrapped = controller
        """The other controller."""
        self.name = name
        self._reporting = controller if isinstance(controller, ReportingController) else None
        self._n_alarms = 0
        """Number of its alarms that were taken over."""
        names = ("solve_time", "tick_time", "controller_time")
        self.times = {name: np.zeros(()) for name in names}
        """Series [s] of the other controller at the newest tick, in memory."""
        self._reserved = kinematic.series().keys()
        self._fault = ""
        """Reason why the controller has given up that the mission has been told."""
        robot = kinematic.robot
        self._shapes: dict[str, tuple[int, ...]] = {"v": (robot.n_v,)}
        if n_thrusters is not None:
            self._shapes |= {"thrust": (n_thrusters,), "torque": (robot.n_joints,)}

    def __call__(self, estimate: StateEstimate, t: float) -> Command:
        """Return the command for the tick at time t [s]. Raises `InvalidInput` for one that the
        plant cannot take.
        """
        watched = self.kinematic.command(self.kinematic.observe(estimate, t))
        command = self.ask(estimate, t)
        finished = watched.finished or command.finished
        telemetry = {**watched.telemetry, **values_of(self.times), **command.telemetry}
        return replace_unchecked(command, finished=finished, telemetry=telemetry)

    def ask(self, estimate: StateEstimate, t: float) -> Command:
        """Return the command of the other controller at time t [s], once the mission is where it is
        then; the kinematic layer follows it. Raises as a call.
        """
        begin = perf_counter()
        command = self.wrapped(estimate, t)
        spent = perf_counter() - begin
        self._require(command)
        self.kinematic.follow(command)
        if self._reporting is not None:
            self._hear(self._reporting)
        self.times["tick_time"][...] = spent
        self.times["controller_time"][...] = spent
        return command

    def _hear(self, controller: ReportingController) -> None:
        """Take over new alarms, and tell the mission, for its next tick, if the controller has
        given up.
        """
        alarms = controller.alarms
        self.kinematic.watchdog.alarms.extend(alarms[self._n_alarms :])
        self._n_alarms = len(alarms)
        if controller.given_up != self._fault:
            self._fault = controller.given_up
            self.kinematic.hear_fault(self._fault)

    def _table(self) -> SmallTable:
        return SmallTable(
            title=f"{type(self).__name__} of {self.name}", rows=self.kinematic._table().rows
        )

    def _require(self, command: Any) -> None:
        """Raise `InvalidInput` for a command that the plant cannot take, or whose telemetry has
        names of the mission's.
        """
        if not isinstance(command, Command):
            raise InvalidInput(
                f"controller {self.name} returned {type(command).__name__}; return a Command"
            )
        for name, shape in self._shapes.items():
            require_numbers(
                f"the command of controller {self.name}", name, getattr(command, name), shape
            )
        reserved = command.telemetry.keys() & self._reserved
        if reserved:
            problem = (
                f"telemetry of controller {self.name} has {min(reserved)!r}, which the mission"
                " tells"
            )
            raise InvalidInput(f"{problem}; rename it")


def is_finite(numbers: np.ndarray) -> bool:
    """Check that all numbers (n,) are finite; of a few, NumPy would take longer."""
    return all(map(math.isfinite, numbers.tolist()))


def require_numbers(
    whose: str, name: str, value: np.ndarray | None, shape: tuple[int, ...]
) -> None:
    """Raise `InvalidInput` for a value (n,) [any unit] that is not finite or not of the shape.

    whose, name: owner and name of the value, for the message.
    """
    if value is None:
        problem = "None"
    elif value.shape != shape:
        problem = f"of shape {value.shape}"
    elif value.dtype != float:  # the record would keep whole numbers alone
        problem = f"of type {value.dtype}"
    elif not is_finite(value):
        problem = "not finite"
    else:
        return
    raise InvalidInput(f"{whose} has {name} {problem}; give {shape[0]} finite numbers")
