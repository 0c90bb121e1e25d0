"""Hierarchies by the dual active-set solver DAQP, natively, as an approximation.

D. Arnström, A. Bemporad, D. Axehill, A dual active-set solver for embedded quadratic programming
using recursive LDL' updates, IEEE Transactions on Automatic Control 67(8), 2022.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from time import perf_counter

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_on_failure, unchecked_constructor
from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.errors import InvalidInput, NotInstalled
from uvms_ocp.solvers.hierarchy import tolerances
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.certificate import normal_certificate, normal_rows
from uvms_ocp.solvers.hierarchy.level import Level, Stack, is_valid, row_slices, stack, widen_bounds
from uvms_ocp.solvers.hierarchy.solution import (
    Solution,
    Status,
    Tick,
    TickResult,
    check_levels_function,
    dense,
    row_residuals,
    timed_solution,
)
from uvms_ocp.types import Array

_result = unchecked_constructor(TickResult)

_EQUALITY = 5  # DAQP's word for it
_ENDLESS = 1e30  # DAQP's infinity
_SMALLEST = 1e-12  # norm of a row that DAQP can normalise

_Solve = Callable[..., tuple[Array, float, int, dict[str, object]]]


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Daqp:
    """DAQP's own hierarchies (``break_points``), cold at every call; gates as
    `uvms_ocp.solvers.hierarchy.level` says.

    Approximate: DAQP divides every row by its norm, so that a level with a slack settles at the
    least squares of the normalised rows, which is another velocity than that of the rows as given;
    scaling rows beforehand undoes nothing. Against the exact optimum of 200 random hierarchies the
    first level that differs is off by less than 2e-6 in half of them, by more than 1e-2 in a tenth,
    and by 0.9 at worst. A result is called exact only if its certificate is. Where DAQP gives up,
    as it does on dependent rows of one level that contradict each other, ``LexicographicActiveSet``
    takes over. Needs the package ``daqp``.
    """

    tolerance: float = 1e-6
    """Violation of a row that DAQP tolerates, relative to the norm of the row."""
    certified: bool = True
    """Certify every result, which takes longer than the solution; else no result is called
    exact.
    """
    _solve: _Solve = field(init=False, repr=False)
    """DAQP's own function."""

    def __post_init__(self) -> None:
        """Raises `NotInstalled` without DAQP, `InvalidInput` for a number that is not positive."""
        if not 0.0 < self.tolerance < math.inf:
            raise InvalidInput(f"tolerance = {self.tolerance}; give a finite value > 0")
        object.__setattr__(self, "_solve", _native())

    @checked_on_failure
    def solve(self, levels: Sequence[Level]) -> Solution:
        """Raises `InvalidInput` where ``levels`` is empty or of mixed width."""
        return timed_solution(levels, self.velocity)

    def bind(self, levels_function: ca.Function, sizes: Sequence[int]) -> Tick:
        """``levels_function`` is evaluated in CasADi, then DAQP is called."""
        check_levels_function(levels_function, sizes)
        return _DaqpTick(
            self,
            BufferedFunction(dense(levels_function)),
            tuple(sizes),
            levels_function.size2_out(0),
        )

    def velocity(self, levels: Sequence[Level]) -> tuple[Array, Status]:
        """V (n,) and status. Raises `InvalidInput` as `solve`."""
        rows = stack(levels)
        if not is_valid(rows.jacobian, rows.lower, rows.upper, rows.gate):
            return np.zeros(rows.jacobian.shape[1]), Status.INVALID_INPUT
        v = self._native_velocity(rows)
        if v is None:
            solution = LexicographicActiveSet(compiled=False).solve(levels)
            return np.array(solution.v), solution.status
        exact = self.certified and self._certificate(rows, v) <= tolerances.CERTIFIED
        return v, Status.SOLVED if exact else Status.INEXACT

    def _certificate(self, rows: Stack, v: Array) -> float:
        normal = normal_rows(
            rows.jacobian,
            *widen_bounds(rows.jacobian, rows.lower, rows.upper, rows.gate),
            rows.sizes,
        )
        return normal_certificate(normal, v / normal.velocity)

    def _native_velocity(self, rows: Stack) -> Array | None:
        """Solve by DAQP; None where it gives up. Rows that ask for nothing are left out."""
        J = rows.jacobian
        low, up = widen_bounds(J, rows.lower, rows.upper, rows.gate)
        n = J.shape[1]
        is_row = (np.linalg.norm(J, axis=1) > _SMALLEST) & ((low > -np.inf) | (up < np.inf))
        counts = [int(is_row[rows_of_level].sum()) for rows_of_level in row_slices(rows.sizes)]
        filled = [count for count in counts if count]
        if not filled:
            return np.zeros(n)
        v, _, flag, _ = self._solve(
            np.eye(n),
            np.zeros(n),
            np.ascontiguousarray(J[is_row]),
            np.minimum(up[is_row], _ENDLESS),
            np.maximum(low[is_row], -_ENDLESS),
            np.where(low[is_row] >= up[is_row], _EQUALITY, 0).astype(np.intc),
            break_points=np.cumsum(filled).astype(np.intc),
            primal_tol=self.tolerance,
        )
        v = np.array(v)
        if flag <= 0 or not np.isfinite(v).all():
            return None
        return v


class _DaqpTick:
    __slots__ = ("_function", "_n", "_sizes", "_solver")

    def __init__(
        self, solver: Daqp, function: BufferedFunction, sizes: tuple[int, ...], n: int
    ) -> None:
        self._solver = solver
        self._function = function
        self._sizes = sizes
        self._n = n

    def __call__(self, *inputs: ArrayLike) -> TickResult:
        start = perf_counter()
        J, lower, upper, _, _, gate, *extras = self._function(*inputs)
        J = J.reshape(-1, self._n)
        v = np.zeros(self._n)
        status = Status.INVALID_INPUT
        residual = np.zeros(len(lower))
        try:
            levels = [
                Level(jacobian=J[r], lower=lower[r], upper=upper[r], gate=gate[r])
                for r in row_slices(self._sizes)
            ]
        except InvalidInput:
            levels = []
        if levels:
            v, status = self._solver.velocity(levels)
            residual = np.concatenate(row_residuals(levels, v))
        return _result(
            v=v,
            status=status,
            residual=residual,
            extras=tuple(extras),
            solve_time=perf_counter() - start,
        )


def _native() -> _Solve:
    try:
        from daqp import solve
    except ImportError:
        raise NotInstalled("solver Daqp", "daqp") from None
    native: _Solve = solve
    return native
