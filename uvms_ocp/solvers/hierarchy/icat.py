"""Regularised task-priority pseudo-inverse with activation functions ([SimettiCasalino2016]).

In C where there is a compiler, in NumPy otherwise. `[rate]` is the unit of a row, `[velocity]` that
of an entry of v.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np

from uvms_ocp.checks import checked_dataclass, checked_on_failure
from uvms_ocp.codegen.c_text import c_macros
from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.hierarchy import core, tolerances
from uvms_ocp.solvers.hierarchy.level import residual, row_slices
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.types import Array, Positive, Shape


@checked_dataclass(eq=False)
class Icat(core.CompiledSolver):
    """[Gao2022] eq. (27): a fold over the levels, reading ``rate`` and ``activation`` only.

    Priorities hold up to the regularisation and while no activation is between 0 and 1;
    acceleration limits are not kept. With the published numbers an arm that is nearly straight
    stops centimetres short of what it can reach: with a damping of 1e-8 and a threshold of 1e-4 it
    goes on as far as damped least squares, and joints change their rate three to six times as
    quickly. Raises `InvalidInput` for a number that is not positive and finite.
    """

    damping: Positive = 1e-4
    """[rate^4/velocity^4] Largest regularisation of a small singular value, added to its square."""
    threshold: Positive = 0.01
    """[rate^2/velocity^2] Singular values below it are regularised, along a cosine bell."""
    weight: Positive = 10.0
    """[rate^2/velocity^2] Cost of motion that the levels above have already used up."""
    compiled: bool = True
    """False keeps to NumPy."""

    def core_source(self, n: int, sizes: Sequence[int]) -> str:
        """Return the C99 source of the solver as an external function of CasADi; needs libm only."""
        numbers = {
            "damping": self.damping,
            "threshold": self.threshold,
            "weight": self.weight,
            "pi": math.pi,
        }
        macros = c_macros({**numbers, "LARGEST": tolerances.LARGEST, "ENDLESS": tolerances.ENDLESS})
        return "\n".join(
            [
                core.preamble(n, sizes),
                macros,
                *core.texts_of("interface.c", "symmetric.c", "icat.c"),
            ]
        )

    def in_python(self, n: int, sizes: Sequence[int]) -> core.PythonSolver:
        """Return the solver in NumPy, with the arguments and results of a core."""

        @np.errstate(over="ignore", invalid="ignore")
        def solve(
            J: Array,
            lower: Array,
            upper: Array,
            rate: Array,
            activation: Array,
            gate: Array,
            state: Array,
        ) -> list[Array]:
            # Comparisons with NaN are false.
            valid = (
                all((np.abs(matrix) < tolerances.LARGEST).all() for matrix in (J, activation))
                and np.isfinite(rate).all()
            )
            if valid:
                v = self.velocity(J, rate, activation, sizes)
            else:
                v = np.full(n, np.inf)
            if (np.abs(v) < tolerances.ENDLESS).all():
                return [
                    v,
                    state,
                    core.report(Status.REGULARISED),
                    residual(J, v, lower, upper, gate),
                ]
            return [np.zeros(n), state, core.report(Status.INVALID_INPUT), np.zeros(len(state))]

        return solve

    @checked_on_failure
    def velocity(
        self,
        J: Annotated[Array, Shape("m", "n")],
        rate: Annotated[Array, Shape("m")],
        activation: Annotated[Array, Shape("m")],
        sizes: Sequence[int],
    ) -> Array:
        """Return the velocity (n,) of levels J (M, n) [rate/velocity], rate (M,) [rate] and
        activation (M,), all finite.

        Raises `InvalidInput` for sizes of levels that do not add up to M.
        """
        if sum(sizes) != len(J):
            raise InvalidInput(
                f"sizes = {sizes} of levels; give some that add up to the {len(J)} rows of J"
            )
        rho = np.zeros(J.shape[1])
        Q = np.eye(J.shape[1])
        for rows in row_slices(sizes):
            # Without an active row the step is the identity, exactly.
            if activation[rows].any():
                rho, Q = self._step(rho, Q, J[rows], rate[rows], activation[rows])
        return rho

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
        """Compute the pseudo-inverse of a symmetric positive semi-definite matrix: s -> s / (s^2 +
        bell(s) damping).
        """
        s, U = np.linalg.eigh(M)
        s = np.maximum(s, 0.0)
        bell = np.where(s < self.threshold, 0.5 * np.cos(np.pi * s / self.threshold) + 0.5, 0.0)
        return np.asarray((U * (s / (s * s + self.damping * bell))) @ U.T)
