"""Some rows of a task's residual in a range of their own: what conditions ask for, as a term."""

from __future__ import annotations

from dataclasses import dataclass
import casadi as ca
import numpy as np

from uvms_ocp.arguments import Bound, checked
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.terms import StageSymbols, Term
from uvms_ocp.tasks.task import Residual, Task, bounded_residual


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RowsWithin(Term):
    """The residual of a task, of which some rows are looked at."""

    task: Task
    rows: tuple[int, ...]
    """Indices into the residual."""
    lower: Bound = -np.inf
    """[unit of the rows]"""
    upper: Bound = np.inf
    """[unit of the rows]"""

    @property
    def name(self) -> str:
        return self.task.name

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        value = self.task.residual(stage.tick, parameters).value[list(self.rows)]
        return bounded_residual(value, lower=self.lower, upper=self.upper)

    def n_parameters(self, robot: Robot) -> int:
        return self.task.n_parameters(robot)

    def reference(self, t: float) -> np.ndarray:
        return self.task.reference(t)
