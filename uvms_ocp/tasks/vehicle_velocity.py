"""Tasks on the vehicle's own velocities: null velocity (NR) and under-actuation (UA)."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import Robot, symbolic_bodies, thrusters
from uvms_ocp.tasks.task import (
    Residual,
    Rows,
    Task,
    TaskClass,
    TickSymbols,
    equality_rows,
    zero_residual,
)


@checked_dataclass(eq=False)
class VehicleVelocity(Task):
    """Shared part of tasks on chosen vehicle axes (0-2 linear, 3-5 angular, in B).

    Raises `InvalidInput` for other axes or none.
    """

    reactive: ClassVar[bool] = False
    task_class: TaskClass = TaskClass.CONSTRAINT
    axes: tuple[int, ...]
    """Indices in the vehicle's part of v."""

    def __post_init__(self) -> None:
        if not self.axes or not set(self.axes) <= set(range(6)):
            raise InvalidInput(f"{self.name}: axes {self.axes}; give some of 0 to 5")

    def axes_of(self, robot: Robot) -> list[int]:
        """Return `axes`. Raises `InvalidInput` for a robot without a vehicle, whose first velocities
        are those of its joints.
        """
        if not robot.n_vehicle:
            raise InvalidInput(
                f"{self.name}: robot {robot.name!r} has a fixed base, and no vehicle with axes"
                f" {self.axes}; drop the task"
            )
        return list(self.axes)


@checked_dataclass(eq=False)
class NullVelocity(VehicleVelocity):
    """NR: the vehicle stands still."""

    symbolic_numbers: ClassVar[tuple[str, ...]] = ()
    name: str = "NR"
    axes: tuple[int, ...] = (0, 1, 2, 3, 4, 5)

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Ask for no velocity of the axes [m/s, rad/s]."""
        return zero_residual(symbols.velocity[self.axes_of(symbols.robot)])

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        rows = symbols.velocity_rows(self.axes_of(symbols.robot))
        return equality_rows(rows, ca.SX.zeros(len(self.axes)))


@checked_dataclass(eq=False)
class UnderActuation(VehicleVelocity):
    """Axes without thrust keep their measured velocity, so that the other rows reckon with it.

    Of all that no thruster drives these are the motions that no thruster works on, see
    `uvms_ocp.robot.thrusters.free_motions`.
    """

    symbolic_numbers: ClassVar[tuple[str, ...]] = ()
    name: str = "UA"
    axes: tuple[int, ...]

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        rows = symbols.velocity_rows(self.axes_of(symbols.robot))
        if self.axes == thrusters.undriven_axes(symbols.robot):
            rows = ca.SX(symbolic_bodies.sparse(thrusters.free_motions(symbols.robot)[1]))
        return equality_rows(rows, rows @ symbols.velocity)
