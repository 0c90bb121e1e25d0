"""What comes of a QP of stages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.arguments import Bound, checked, trusted
from uvms_ocp.arrays import Array
from uvms_ocp.solvers.stagewise.stage_qp import StageShape
from uvms_ocp.status import AdvisedStatus


class StageQpStatus(AdvisedStatus):
    """Outcome of one QP."""

    SOLVED = "solved", "nothing to do"
    INEXACT = "inexact", "the KKT conditions hold to a thousand times the tolerance only; scale the rows"
    INFEASIBLE = "infeasible", "no point keeps the constraints; loosen them, or make rows soft"
    UNBOUNDED = "unbounded", "the cost falls without end; add damping, or bounds"
    NOT_CONVEX = "not convex", "a Hessian is indefinite; use Gauss-Newton, or add damping"
    ITERATION_LIMIT = "iteration limit", "raise max_iterations, or scale the rows"
    NOT_A_NUMBER = (
        "not a number",
        "an entry of the QP is not finite, a bound endless on the wrong side, or slack rewarded; look where it comes from",
    )

    @property
    def usable(self) -> bool:
        """True where the point can be used as the optimum."""
        return self in (StageQpStatus.SOLVED, StageQpStatus.INEXACT)


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class KktResidual:
    """By how much the optimality conditions fail, in units of the QP."""

    stationarity: Bound
    """[1/unit of z] largest entry of the gradient of the Lagrangian."""
    primal: Bound
    """[unit of the row] largest violation of dynamics, hard rows and hard bounds."""
    complementarity: Bound
    """[-] largest product of a multiplier and what is left to its bound."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StageQpSolution:
    """Point and multipliers; tuples have an entry per stage, views of arrays of their own.

    Lagrangian: ``cost + costate_{k+1}' (A x + B u + b - x_{k+1}) + y' C z + y_z' z``: a multiplier is positive at an upper bound
    and negative at a lower one.
    """

    status: StageQpStatus
    """How far the rest can be relied on; where INFEASIBLE, the point misses the hard rows least, in sum."""
    z: tuple[Array, ...]
    """(n_z,) [unit of z]"""
    x: tuple[Array, ...]
    """(n_x,) [unit of x]"""
    u: tuple[Array, ...]
    """(n_u,) [unit of u], N of them."""
    costate: tuple[Array, ...]
    """(n_x,) [1/unit of x] of the step that leads to a state; 0 for x_0."""
    y: tuple[Array, ...]
    """(n_c,) [1/unit of the row] multipliers of rows."""
    y_z: tuple[Array, ...]
    """(n_z,) [1/unit of z] multipliers of bounds."""
    excess: tuple[Array, ...]
    """(n_c,) [unit of the row] by how much rows are missed: below 0 at the lower bound."""
    iterations: int
    """[-] factorisations."""
    kkt: KktResidual
    """Of the point."""
    cost: float
    """[-] without what soft rows cost."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Near:
    """The multipliers of a QP nearby, and where to start: in arrays with stage after stage."""

    z: Array
    """(n,) [unit of z]"""
    costate: Array
    """(n_x,) [1/unit of x]"""
    y: Array
    """(M,) [1/unit of the row] of rows, then of bounds."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Found:
    """A `StageQpSolution` in arrays with stage after stage, for who solves one QP after the other."""

    shape: StageShape
    """Of the QP."""
    status: StageQpStatus
    """How far the rest can be relied on."""
    z: Array
    """(n,) [unit of z]"""
    costate: Array
    """(n_x,) [1/unit of x]"""
    y: Array
    """(M,) [1/unit of the row] of rows, then of bounds."""
    excess: Array
    """(m,) [unit of the row] by how much rows are missed."""
    iterations: int
    """[-] factorisations."""
    kkt: KktResidual
    """Of the point."""
    products: Products
    """Of the residuals along z."""

    def near(self) -> Near:
        """For a QP nearby that starts where this one ends."""
        return Near(z=np.zeros_like(self.z), costate=self.costate, y=self.y)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Products:
    """Of the residuals' rows along z."""

    slope: float
    """[-] r' J z: derivative of the half square."""
    square: float
    """[-] of J z."""
    change: float
    """[1/unit of z] largest entry of J' J z: of what the gradient of the half square changes by."""


kkt_residual = trusted(KktResidual)
"""Without a look at its arguments."""
stage_qp_solution = trusted(StageQpSolution)
"""The same."""
