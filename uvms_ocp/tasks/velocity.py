"""Tasks on generalized velocities themselves: vehicle null velocity (NR) and under-actuation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.tasks.task import (
    Residual,
    Rows,
    Task,
    TaskClass,
    TickSymbols,
    equality_rows,
    zero_residual,
)


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
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


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class NullVelocity(VehicleVelocity):
    """NR: the vehicle stands still."""

    name: str = "NR"
    axes: tuple[int, ...] = (0, 1, 2, 3, 4, 5)

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """Velocity of the axes = 0 [m/s, rad/s]."""
        return zero_residual(symbols.velocity[list(self.axes)])

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        return equality_rows(symbols.velocity_rows(list(self.axes)), ca.SX.zeros(len(self.axes)))


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class UnderActuation(VehicleVelocity):
    """Axes without thrust keep their measured velocity, so that the other rows reckon with it."""

    name: str = "UA"
    axes: tuple[int, ...]

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        axes = list(self.axes)
        return equality_rows(symbols.velocity_rows(axes), symbols.velocity[axes])
