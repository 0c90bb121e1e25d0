"""Regularised task-priority pseudo-inverse with activation functions ([SimettiCasalino2016]).

`[rate]` is the unit of a row, `[velocity]` that of an entry of v.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import Annotated

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked_dataclass, checked_on_failure, unchecked_constructor
from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.hierarchy import solution, tolerances
from uvms_ocp.solvers.hierarchy.level import Level, residual, row_slices, stack
from uvms_ocp.types import Array, Positive, Shape

_result = unchecked_constructor(solution.TickResult)


@checked_dataclass(eq=False)
class Icat:
    """[Gao2022] eq. (27): a fold over the levels, reading ``rate`` and ``activation`` only.

    Priorities hold up to the regularisation and while no activation is between 0 and 1; acceleration limits are not kept. With
    the published numbers an arm that is nearly straight stops centimetres short of what it can reach: with a damping of 1e-8 and
    a threshold of 1e-4 it goes on as far as damped least squares, and joints change their rate three to six times as quickly.
    Raises `InvalidInput` for a number that is not positive and finite.
    """

    damping: Positive = 1e-4
    """[rate^4/velocity^4] Largest regularisation of a small singular value, added to its square."""
    threshold: Positive = 0.01
    """[rate^2/velocity^2] Singular values below it are regularised, along a cosine bell."""
    weight: Positive = 10.0
    """[rate^2/velocity^2] Cost of motion that the levels above have already used up."""

    @checked_on_failure
    def solve(self, levels: Sequence[Level]) -> solution.Solution:
        """Raises `InvalidInput` where ``levels`` is empty or of mixed width."""
        return solution.timed_solution(levels, self._of_levels)

    def bind(self, levels_function: ca.Function, sizes: Sequence[int]) -> solution.Tick:
        """``levels_function`` is evaluated in CasADi, the fold in NumPy."""
        solution.check_levels_function(levels_function, sizes)
        inputs = solution.dense_inputs(levels_function)
        function = ca.Function("levels", inputs, solution.dense_outputs(levels_function, inputs))
        return _IcatTick(self, BufferedFunction(function), tuple(sizes), levels_function.size2_out(0))

    @checked_on_failure
    def velocity(
        self,
        J: Annotated[Array, Shape("m", "n")],
        rate: Annotated[Array, Shape("m")],
        activation: Annotated[Array, Shape("m")],
        sizes: Sequence[int],
    ) -> Array:
        """(n,) [velocity] from J (M, n) [rate/velocity], rate (M,) [rate] and activation (M,), all finite.

        Raises `InvalidInput` for sizes of levels that do not add up to M.
        """
        if sum(sizes) != len(J):
            raise InvalidInput(f"sizes = {sizes} of levels; give some that add up to the {len(J)} rows of J")
        rho, Q = np.zeros(J.shape[1]), np.eye(J.shape[1])
        for rows in row_slices(sizes):
            # Without an active row the step is the identity, exactly.
            if activation[rows].any():
                rho, Q = self._step(rho, Q, J[rows], rate[rows], activation[rows])
        return rho

    def _of_levels(self, levels: Sequence[Level]) -> tuple[Array, solution.Status]:
        rows = stack(levels)
        return _guarded(self, rows.jacobian, rows.rate, rows.activation, rows.sizes)

    def _step(self, rho: Array, Q: Array, J: Array, rate: Array, a: Array) -> tuple[Array, Array]:
        X = J @ Q
        used = np.eye(len(Q)) - Q
        # X'A'A X + X'(I - A)A X = X'A X, since A is diagonal.
        weighted = X.T * a
        M2 = weighted @ X
        target = weighted * a
        J1 = self._regularised(M2 + self.weight * (used.T @ used)) @ target
        J2 = self._regularised(M2) @ target
        Q_J2 = Q @ J2
        return rho + Q_J2 @ ((X @ J1) @ (rate - J @ rho)), Q - Q_J2 @ X

    def _regularised(self, M: Array) -> Array:
        """Pseudo-inverse of a symmetric positive semi-definite matrix: s -> s / (s^2 + bell(s) damping)."""
        s, U = np.linalg.eigh(M)
        s = np.maximum(s, 0.0)
        bell = np.where(s < self.threshold, 0.5 * np.cos(np.pi * s / self.threshold) + 0.5, 0.0)
        return np.asarray((U * (s / (s * s + self.damping * bell))) @ U.T)


@np.errstate(over="ignore", invalid="ignore")
def _guarded(solver: Icat, J: Array, rate: Array, activation: Array, sizes: Sequence[int]) -> tuple[Array, solution.Status]:
    """Solve as `Icat.velocity` for any numbers: v is 0 where they are invalid or the result is not finite."""
    # Comparisons with NaN are false.
    valid = (np.abs(J) < tolerances.LARGEST).all() and np.isfinite(rate).all() and np.isfinite(activation).all()
    v = solver.velocity(J, rate, activation, sizes) if valid else np.full(J.shape[1], np.inf)
    sound = bool((np.abs(v) < tolerances.ENDLESS).all())
    return (v, solution.Status.REGULARISED) if sound else (np.zeros(len(v)), solution.Status.INVALID_INPUT)


class _IcatTick:
    __slots__ = ("_function", "_n", "_sizes", "_solver")

    def __init__(self, solver: Icat, function: BufferedFunction, sizes: tuple[int, ...], n: int) -> None:
        self._solver, self._function, self._sizes, self._n = solver, function, sizes, n

    def __call__(self, *inputs: ArrayLike) -> solution.TickResult:
        start = perf_counter()
        J, lower, upper, rate, activation, gate, *extras = self._function(*inputs)
        J = J.reshape(-1, self._n)
        v, status = _guarded(self._solver, J, rate, activation, self._sizes)
        missed = residual(J, v, lower, upper, gate) if status.usable else np.zeros(len(lower))
        return _result(v=v, status=status, residual=missed, extras=tuple(extras), solve_time=perf_counter() - start)
