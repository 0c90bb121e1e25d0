"""What a search of commands lowers: what is left unknown, and what it costs to leave the pool or to hurry thrusters."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from uvms_ocp.identification.excitation.confines import Limits
from uvms_ocp.identification.excitation.course import Courses
from uvms_ocp.identification.excitation.history import History
from uvms_ocp.identification.excitation.information import Aim


@dataclass(frozen=True, slots=True, eq=False)
class Objective:
    """Of knots (n_knots, n_u) [N, N m]."""

    aim: Aim
    limits: Limits
    history: History
    courses: Courses
    wanted: np.ndarray
    """(m,) [units of numbers] standard errors that those of the aim are compared with."""
    off: np.ndarray = field(default_factory=lambda: np.zeros(1))
    """(n + 1, n_x) [as `Stage`], or none (1,), that states are truly beside the course."""

    def value(self, knots: np.ndarray, price: float) -> tuple[float, np.ndarray]:
        """[-] at knots (n_knots, n_u) [N, N m], with its slope [1/N, 1/(N m)]; price [-] of leaving the pool."""
        one = self.courses.of(self.history.acting @ knots, self.history.late @ knots)
        figure, M = self.aim.figure(one, self.courses.h, self.wanted)
        out, slope = self.limits.beyond(one.x + self.off)
        share = 2.0 * price / len(one.x)
        with_x = np.pad(share * np.einsum("ki,kij->kj", out, slope), ((0, 0), (0, one.x.shape[1] - slope.shape[2])))
        with_u, with_late = self.courses.pulled(one, M, with_x)
        hurry, with_told = self._hurry(self.history.told @ knots, price)
        pulled = self.history.acting.T @ with_u + self.history.late.T @ with_late + self.history.told.T @ with_told
        return figure + share * float((out**2).sum()) / 2.0 + hurry, pulled

    def lowered(self, knots: np.ndarray, price: float, iterations: int) -> np.ndarray:
        """Better knots (n_knots, n_u) [N, N m], by a quasi-Newton method within the limits of thrust; price [-]."""
        from scipy.optimize import minimize  # half a second, which few need

        size = np.abs(self.limits.thrust).max(axis=1)

        def lower(scaled: np.ndarray) -> tuple[float, np.ndarray]:
            value, slope = self.value(scaled.reshape(knots.shape) * size, price)
            return value, (slope * size).ravel()

        bounds = np.tile(self.limits.thrust / size[:, None], (len(knots), 1))
        options = {"maxiter": iterations, "maxcor": 30}
        found = minimize(lower, (knots / size).ravel(), jac=True, method="L-BFGS-B", bounds=bounds, options=options)
        return np.asarray(found.x.reshape(knots.shape) * size)

    def _hurry(self, told: np.ndarray, price: float) -> tuple[float, np.ndarray]:
        """[-] what steps beyond the slew limit cost, with its slope (n, n_u) [1/N, 1/(N m)]."""
        slope, most = np.zeros_like(told), self.limits.slew * self.courses.h
        if not np.isfinite(most):
            return 0.0, slope
        change = np.diff(told, axis=0)
        over = np.sign(change) * np.maximum(np.abs(change) / most - 1.0, 0.0)
        each = 2.0 * price / len(told) * over / most
        slope[1:] += each
        slope[:-1] -= each
        return price / len(told) * float((over**2).sum()), slope
