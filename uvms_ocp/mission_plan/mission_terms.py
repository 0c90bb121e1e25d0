"""Terms that a mission has beside those of its tasks: what conditions ask for, what is liked, and rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np

from uvms_ocp.arguments import Bound, checked
from uvms_ocp.ocp.terms import OfTask, StageSymbols, Term
from uvms_ocp.tasks.task import Residual, bounded_residual, zero_residual


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RowsWithin(OfTask):
    """The residual of a task, of which some rows are looked at."""

    rows: tuple[int, ...]
    """Indices into the residual."""
    lower: Bound = -np.inf
    """[unit of the rows]"""
    upper: Bound = np.inf
    """[unit of the rows]"""

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        value = self.task.residual(stage.tick, parameters).value[list(self.rows)]
        return bounded_residual(value, lower=self.lower, upper=self.upper)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Preferred(OfTask):
    """The residual of a task as a cost, not as something to be reached."""

    is_goal: ClassVar[bool] = False

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return self.task.residual(stage.tick, parameters)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rest(Term):
    """Velocities are zero that nothing else keeps at zero."""

    axes: tuple[int, ...]
    """Indices in v."""

    @property
    def name(self) -> str:
        return "at rest"

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return zero_residual(stage.tick.velocity[list(self.axes)])
