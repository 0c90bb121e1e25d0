"""A residual or a constraint of one's own, as a term: a function of the symbols of a step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.arrays import Array
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.tasks.reference import VectorGoal, evaluate_vector
from uvms_ocp.tasks.task import Residual

OwnRows = Callable[..., ca.SX]
"""``stage -> rows``, or ``stage, parameters -> rows`` for a term that has parameters; rows (m,) as CasADi SX."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _OwnTerm(Term):
    """Rows by a function, within bounds."""

    label: str
    rows: OwnRows
    lower: Any
    upper: Any
    parameters: VectorGoal | None
    # What holds for all terms of a package's class holds here for one term.
    state_only: bool = True  # type: ignore[misc]
    is_goal: bool = True  # type: ignore[misc]

    @property
    def name(self) -> str:
        return self.label

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        value = self.rows(stage) if self.parameters is None else self.rows(stage, parameters)
        if not isinstance(value, ca.SX) or value.shape[1] != 1 or not value.shape[0]:
            given = f"{type(value).__name__} of shape {getattr(value, 'shape', ())}"
            raise InvalidInput(f"{self.label}: its function gave {given}; give a column (m, 1) of casadi.SX")
        if self.state_only and _reads_inputs(value, stage):
            raise InvalidInput(f"{self.label}: its rows depend on acceleration, thrust or torque; give inputs=True")
        lower, upper = (_bound(self.label, bound, value.shape[0]) for bound in (self.lower, self.upper))
        if not (lower <= upper).all():
            raise InvalidInput(f"{self.label}: bounds {lower} to {upper} are NaN or swapped; give lower <= upper")
        return Residual(value=value, lower=lower, upper=upper)

    def n_parameters(self, robot: Robot) -> int:
        return 0 if self.parameters is None else len(self.reference(0.0))

    def reference(self, t: float) -> np.ndarray:
        return np.zeros(0) if self.parameters is None else evaluate_vector(self.label, self.parameters, t)[0].ravel()


@checked
def residual_term(
    name: str,
    rows: OwnRows,
    *,
    lower: Any = 0.0,
    upper: Any = 0.0,
    at: At = At.END,
    weight: float = 1.0,
    phase: str | None = None,
    goal: bool = True,
    inputs: bool = False,
    parameters: VectorGoal | None = None,
) -> Term:
    """A term from a function ``rows(stage)`` that gives expressions (m,) of a `StageSymbols`, as `casadi.SX`.

    In a level the distance of the rows to ``[lower, upper]`` is minimised, as a constraint the range is kept; bounds are one
    number or (m,) [unit of the row]. at, weight [1/unit of the row^2], phase: as `Term` has them. goal: to be reached, so
    that a plan which leaves it has missed it; else a cost. inputs: rows read acceleration, thrust or torque. parameters
    (n,) [any], or a function ``t -> (value, rate)`` of the time [s] of the node: given to ``rows(stage, parameters)``, and
    what a kept planner may be given anew. Raises `InvalidInput` as the term does when a planner is built: for rows that are
    no column of SX, bounds that do not fit them, and rows that read inputs without `inputs`.
    """
    return _OwnTerm(
        label=name,
        rows=rows,
        lower=lower,
        upper=upper,
        at=at,
        weight=weight,
        phase=phase,
        is_goal=goal,
        state_only=not inputs,
        parameters=parameters,
    )


def _bound(name: str, bound: Any, m: int) -> Array:
    """(m,) [unit of the row]"""
    try:
        return np.array(np.broadcast_to(np.asarray(bound, dtype=float), (m,)))
    except (ValueError, TypeError):
        given = f"shape {np.shape(bound)}"
        raise InvalidInput(f"{name}: a bound has {given}; give one number, or {m} of them") from None


def _reads_inputs(value: ca.SX, stage: StageSymbols) -> bool:
    """Whether any symbol of acceleration or force is in the rows."""
    inputs = ca.vertcat(stage.acceleration, stage.thrust_share, stage.torque_share)
    state = ca.vertcat(stage.tick.q, stage.tick.velocity)
    own = {symbol.__hash__() for symbol in ca.symvar(inputs)} - {symbol.__hash__() for symbol in ca.symvar(state)}
    return any(symbol.__hash__() in own for symbol in ca.symvar(value))
