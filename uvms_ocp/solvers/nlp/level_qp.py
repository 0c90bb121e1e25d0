"""The QP of one level at a point: least squares of its rows, subject to linearised constraints and rows of the levels above."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus
from uvms_ocp.solvers.nlp.program import LevelNlp
from uvms_ocp.solvers.nlp.row_bounds import RowBounds
from uvms_ocp.solvers.nlp.sqp_options import OF_MATRICES, SqpOptions

_FUNCTIONS = ("nlp_g", "nlp_grad_f", "nlp_jac_g", "nlp_hess_l")
_OPTIONS: dict[str, dict[str, object]] = {
    # Starts are near the solution: a small barrier saves two of nine iterations. Frozen rows leave slabs so thin that the
    # QPs of lower levels take up to 30. With its own 1e8 in the place of infinite bounds hpipm ends far from the solution.
    "hpipm": {"inf": 1e6, "hpipm": {"mu0": 1e-2, "iter_max": 60}},
    "proxqp": {"proxqp": {"eps_abs": 1e-7}},
    "piqp": {},
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Linear:
    """Rows, and derivatives of rows and cost, at one point."""

    gradient: np.ndarray
    """(n,) [1/unit of x] of the cost."""
    H: ca.DM
    """(n, n) Gauss-Newton Hessian, damped."""
    g: np.ndarray
    """(m,) [unit of the row] rows."""
    A: ca.DM
    """(m, n) their Jacobian."""

    @property
    def finite(self) -> bool:
        return bool(np.isfinite(self.g).all() and np.isfinite(self.gradient).all())


class LevelQp:
    """Built once; raises `InvalidInput` for a level without derivative functions."""

    def __init__(self, nlp: LevelNlp, index: int, options: SqpOptions) -> None:
        missing = [name for name in _FUNCTIONS if name not in nlp.functions]
        if missing:
            raise InvalidInput(f"the program has no derivatives {', '.join(missing)}; transcribe it for IPOPT")
        self._rows = nlp.rows
        n, m = nlp.nlp["x"].numel(), len(nlp.rows)
        x, p, damping = ca.MX.sym("x", n), ca.MX.sym("p", nlp.nlp["p"].numel()), ca.MX.sym("damping")
        _, gradient = nlp.functions["nlp_grad_f"](x, p)
        g, A = nlp.functions["nlp_jac_g"](x, p)
        upper = nlp.functions["nlp_hess_l"](x, p, 1, ca.MX.zeros(m))
        H = ca.triu2symm(upper) + damping * ca.MX.eye(n)
        self._linearize = ca.Function(f"linear_{index}", [x, p, damping], [gradient, H, g, A])
        shape, plugin = {"h": H.sparsity(), "a": A.sparsity()}, options.plugin or OF_MATRICES
        self._qp = ca.conic(f"qp_{index}", plugin, shape, {"error_on_fail": False, **_OPTIONS[plugin]})

    def step(
        self, x: np.ndarray, p: np.ndarray, bounds: RowBounds, damping: float
    ) -> tuple[np.ndarray, NlpStatus | None]:
        """Step (n,) from x (n,) [unit of x], and why there is none.

        p (n_p,) [unit of the parameter]. damping [1/unit of x^2]: weight of the square of the step.
        """
        gradient, H, g, A = self._linearize.call([x, p, damping])
        linear = _Linear(gradient=np.array(gradient).ravel(), H=H, g=np.array(g).ravel(), A=A)
        if not linear.finite:
            return np.zeros_like(x), NlpStatus.NOT_A_NUMBER
        step = self._solved(linear, x, bounds)
        if not (self._qp.stats()["success"] and np.isfinite(step).all()):
            return np.zeros_like(x), NlpStatus.STALLED
        return step, None

    def _solved(self, linear: _Linear, x: np.ndarray, bounds: RowBounds) -> np.ndarray:
        solution = self._qp(
            h=linear.H,
            g=linear.gradient,
            a=linear.A,
            lba=bounds.lower[self._rows] - linear.g,
            uba=bounds.upper[self._rows] - linear.g,
            lbx=bounds.x_lower - x,
            ubx=bounds.x_upper - x,
        )
        return np.array(solution["x"]).ravel()
