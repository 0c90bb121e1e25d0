"""Sequential quadratic programming for control in real time: few steps, each of them complete.

An interior-point solver of NLPs that is stopped early stands somewhere between its start and the constraints. A QP that
is solved to its end obeys the linearised constraints, all of them: from a start near the solution, such as the last one
moved on in time, one step is nearly feasible and nearly optimal (real-time iteration [Diehl2005]).
Levels are QPs in their order within one step: a level keeps what the linear model of the levels above has reached. Where
its QP fails, the step of the levels above is taken without it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import casadi as ca
import numpy as np

from uvms_ocp.arguments import Bound, checked, late
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.solvers.nlp.nlp_status import NlpStatus
from uvms_ocp.solvers.nlp.program import LevelNlp, LexicographicProgram, Parameters, Variables
from uvms_ocp.solvers.nlp.row_bounds import RowBounds, row_bounds

QP_PLUGINS = ("hpipm", "proxqp", "piqp")


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SqpOptions:
    """How a step is made, and when another one is.

    Raises `NameNotFound` for another plugin, `InvalidInput` for one that this CasADi lacks or a number that is not positive.
    """

    plugin: str = "hpipm"
    """``hpipm``, the fastest, knows horizons only; ``proxqp`` and ``piqp`` take any program."""
    max_steps: int = 3
    """For every solve."""
    accuracy: float = 1e-2
    """[-] Largest violation of scaled rows with which a point counts as usable, and no further step is made."""
    tolerance: float = 1e-3
    """[-] By which the linearised residual of a level may rise."""
    damping: float = 1e-6
    """[1/unit of x^2] Added to the diagonal of the Hessian, so that what no term determines does not move."""

    def __post_init__(self) -> None:
        if self.plugin not in QP_PLUGINS:
            raise NameNotFound("QP solver", self.plugin, QP_PLUGINS)
        if not ca.has_conic(self.plugin):
            raise InvalidInput(f"this CasADi has no QP solver {self.plugin!r}; give another of {', '.join(QP_PLUGINS)}")
        for name in self.__dataclass_fields__:
            if name != "plugin" and not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InvalidInput(f"{name} = {getattr(self, name)}; give a finite value > 0")


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SqpResult:
    """The best point of all steps: the first that keeps the constraints, or else the one that breaks them least."""

    x: np.ndarray
    """(n,) [unit of x] finite."""
    status: NlpStatus
    """SOLVED where x keeps the constraints to `SqpOptions.accuracy`; no word on optimality."""
    violation: float
    """[-] Largest, of scaled rows."""
    steps: int
    """Made, the one that failed included."""
    solve_time: float
    """[s] by the clock that was given."""


@checked
class RealTimeSqp:
    """Steps of one program: its QPs are built once, here.

    Raises `InvalidInput` for a program without derivative functions. The Hessian must not be indefinite: Gauss-Newton.
    """

    def __init__(self, program: LexicographicProgram, options: SqpOptions | None = None) -> None:
        self.program, self.options = program, options or SqpOptions()
        self._levels = [_LevelQp(nlp, i, self.options) for i, nlp in enumerate(program.nlps)]

    @late
    def solve(
        self,
        x: Variables,
        *,
        p: Parameters,
        x_lower: Variables | float = -np.inf,
        x_upper: Variables | float = np.inf,
        time_limit: Bound = np.inf,
        clock: Callable[[], float] = perf_counter,
    ) -> SqpResult:
        """From x (n,) [unit of x]: one step, and more while the constraints are broken and `time_limit` [s] allows another.

        p (n_p,) [unit of the parameter]; x_lower and x_upper (n,), or one for all variables [unit of x].
        """
        begin, steps = clock(), 0
        bounds = row_bounds(self.program.ranges, x_lower, x_upper, len(x))
        best, least, status = x, np.inf, NlpStatus.ITERATION_LIMIT
        while steps < self.options.max_steps:
            step, failure = self._step(x, p, bounds)
            steps += 1
            if failure is not None:
                status = failure
                break
            x = x + step
            violation = self._violation(x, p, bounds)
            if violation < least:
                best, least = x, violation
            if least <= self.options.accuracy:
                status = NlpStatus.SOLVED
                break
            if (clock() - begin) * (steps + 1) / steps > time_limit:
                status = NlpStatus.TIME_LIMIT
                break
        return SqpResult(x=best, status=status, violation=least, steps=steps, solve_time=clock() - begin)

    def _step(self, x: np.ndarray, p: np.ndarray, bounds: RowBounds) -> tuple[np.ndarray, NlpStatus | None]:
        """Step (n,), and why there is none."""
        step, cost = np.zeros_like(x), 0.0
        for i, level in enumerate(self._levels):
            linear = level.linearized(x, p)
            if i:
                above = self.program.ranges.levels[i - 1]
                y = linear.rows_after(step, level.places(above.frozen))
                bounds = bounds.with_rows(above.frozen, above.frozen_bounds(y, cost, self.options.tolerance))
            lower, failure = level.solve(linear, x, bounds)
            if failure is not None:
                # What the levels above have reached stands without this one.
                return step, failure if i == 0 else None
            step = lower
            cost = linear.cost_after(step)
        return step, None

    def _violation(self, x: np.ndarray, p: np.ndarray, bounds: RowBounds) -> float:
        first = self._levels[0].nlp
        violation = bounds.violation(x, np.array(first.functions["nlp_g"](x, p)).ravel(), first.rows)
        return violation if np.isfinite(violation) else np.inf


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Linear:
    """Cost, rows and their derivatives at one point."""

    f: float
    """[-] Cost."""
    gradient: np.ndarray
    """(n,) [1/unit of x] of the cost."""
    H: ca.DM
    """(n, n) Gauss-Newton Hessian, damped."""
    g: np.ndarray
    """(m,) [unit of the row] rows."""
    A: ca.DM
    """(m, n) their Jacobian."""

    def rows_after(self, step: np.ndarray, places: np.ndarray) -> np.ndarray:
        return np.asarray((self.g + np.array(self.A @ step).ravel())[places])

    def cost_after(self, step: np.ndarray) -> float:
        return float(self.f + self.gradient @ step + step @ np.array(self.H @ step).ravel() / 2)


class _LevelQp:
    """QP of one level."""

    def __init__(self, nlp: LevelNlp, index: int, options: SqpOptions) -> None:
        missing = [name for name in _FUNCTIONS if name not in nlp.functions]
        if missing:
            raise InvalidInput(f"the program has no derivatives {', '.join(missing)}; transcribe it for IPOPT")
        self.nlp = nlp
        n, m = nlp.nlp["x"].numel(), len(nlp.rows)
        x, p = ca.MX.sym("x", n), ca.MX.sym("p", nlp.nlp["p"].numel())
        f, gradient = nlp.functions["nlp_grad_f"](x, p)
        g, A = nlp.functions["nlp_jac_g"](x, p)
        upper = nlp.functions["nlp_hess_l"](x, p, 1, ca.MX.zeros(m))
        H = ca.triu2symm(upper) + options.damping * ca.MX.eye(n)
        self._linearize = ca.Function(f"linear_{index}", [x, p], [f, gradient, H, g, A])
        shape = {"h": H.sparsity(), "a": A.sparsity()}
        self._qp = ca.conic(f"qp_{index}", options.plugin, shape, {"error_on_fail": False, **_OPTIONS[options.plugin]})

    def places(self, frozen: slice) -> np.ndarray:
        """Where the rows of a level above are among those of this QP."""
        position = np.full(self.nlp.rows.max(initial=-1) + 1, -1)
        position[self.nlp.rows] = np.arange(len(self.nlp.rows))
        return position[frozen]

    def linearized(self, x: np.ndarray, p: np.ndarray) -> _Linear:
        f, gradient, H, g, A = self._linearize.call([x, p])
        return _Linear(f=float(f), gradient=np.array(gradient).ravel(), H=H, g=np.array(g).ravel(), A=A)

    def solve(self, linear: _Linear, x: np.ndarray, bounds: RowBounds) -> tuple[np.ndarray, NlpStatus | None]:
        rows = self.nlp.rows
        if not (np.isfinite(linear.g).all() and np.isfinite(linear.gradient).all()):
            return np.zeros_like(x), NlpStatus.NOT_A_NUMBER
        solution = self._qp(
            h=linear.H,
            g=linear.gradient,
            a=linear.A,
            lba=bounds.lower[rows] - linear.g,
            uba=bounds.upper[rows] - linear.g,
            lbx=bounds.x_lower - x,
            ubx=bounds.x_upper - x,
        )
        step = np.array(solution["x"]).ravel()
        if not (self._qp.stats()["success"] and np.isfinite(step).all()):
            return np.zeros_like(x), NlpStatus.STALLED
        return step, None


_FUNCTIONS = ("nlp_g", "nlp_grad_f", "nlp_jac_g", "nlp_hess_l")
_OPTIONS: dict[str, dict[str, object]] = {
    # Starts are near the solution: a small barrier saves two of nine iterations.
    # It replaces infinite bounds by `inf`, 1e8 of its own accord, beside which no complementarity reaches its tolerance.
    "hpipm": {"inf": 1e6, "hpipm": {"mu0": 1e-2, "iter_max": 20}},
    "proxqp": {"proxqp": {"eps_abs": 1e-7}},
    "piqp": {},
}
