"""Trust-region descent on a block-tridiagonal Gauss-Newton matrix (Levenberg-Marquardt in a smooth
metric).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from uvms_ocp.planning.block_tridiagonal import BlockTridiagonal
from uvms_ocp.planning.path_cost import LocalModel
from uvms_ocp.types import (
    Array,
    Mask,
)

# [m or rad] that the position of a node moves at most in one step: of the search, and not of what it finds
_LONGEST_STEP = 0.3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DescentProblem:
    """A cost over the free variables of `PathCost`, and where to start."""

    model: Callable[[Array], LocalModel]
    """The cost near variables (n_nodes, b) [m, rad]."""
    start: Array
    """(n_nodes, b) [m, rad] first variables."""
    free: Mask
    """(n_nodes, b) False for variables that stay."""
    metric: BlockTridiagonal
    """Metric in which long steps are held back."""
    lower: Array
    """(n_nodes, b) [m, rad] lower bounds, for solvers that can keep them."""
    upper: Array
    """(n_nodes, b) [m, rad] upper bounds, for solvers that can keep them."""
    enough: Callable[[LocalModel], bool] = lambda model: False
    """Tells of a cost that is low enough to stop at, for solvers that can stop early."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Descent:
    """End of a descent."""

    variables: Array
    """(n_nodes, b) [m, rad] last variables."""
    model: LocalModel
    """The cost near them."""
    iterations: int
    """Number of steps that were tried."""
    converged: bool
    """True where the descent ended by itself, not by its limit of iterations."""


class DescentSolver(Protocol):
    """Minimiser of the cost of a path."""

    def minimise(self, problem: DescentProblem) -> Descent: ...


@dataclass(frozen=True, kw_only=True, slots=True)
class TrustRegion:
    """Levenberg-Marquardt: steps solve ``(H + mu metric) step = -gradient``.

    mu falls when the model predicts well and grows when a step is refused, so a step is never
    accepted that raises the cost. Bounds are not kept.
    """

    max_iterations: int = 40
    tolerance: float = 1e-3
    """Relative decrease of the cost below which an accepted step is the last."""
    damping: float = 1e-3
    """First weight of the metric that holds steps back."""

    def minimise(self, problem: DescentProblem) -> Descent:
        model = problem.model
        x = problem.start
        mu = self.damping
        current = model(x)
        for iteration in range(self.max_iterations):
            if problem.enough(current):
                return Descent(variables=x, model=current, iterations=iteration, converged=True)
            step, predicted, mu = _step(current, problem.free, problem.metric, mu)
            candidate = model(x + step)
            actual = current.parts.total - candidate.parts.total
            refused = actual <= 0.0
            if refused:
                decrease = predicted
            else:
                decrease = actual
            is_done = decrease <= self.tolerance * current.parts.total
            if refused:
                mu = mu * 8.0
            else:
                x = x + step
                current = candidate
                mu = mu * _damping_change(actual / predicted)
            if is_done:
                return Descent(variables=x, model=current, iterations=iteration + 1, converged=True)
        return Descent(variables=x, model=current, iterations=self.max_iterations, converged=False)


def _step(
    model: LocalModel, free: Mask, metric: BlockTridiagonal, mu: float
) -> tuple[Array, float, float]:
    """Return the step, its predicted decrease, and the damping with which it is positive definite
    and short enough.
    """
    slope = model.gradient * free
    while True:
        factor = (model.hessian + metric.scaled(mu)).pinned(free).cholesky()
        if factor is None:
            step = -slope
        else:
            step = -factor.solve(slope)
        if factor is not None and np.abs(step[:, : model.n_axes]).max() <= _LONGEST_STEP:
            break
        mu *= 4.0
    predicted = -float(np.sum(slope * step)) - 0.5 * float(np.sum(step * model.hessian.times(step)))
    return step, predicted, mu


def _damping_change(ratio: float) -> float:
    """Return the factor on mu after an accepted step, by the ratio of actual to predicted decrease."""
    if ratio > 0.75:
        return 0.25
    if ratio > 0.25:
        return 1.0
    return 4.0
