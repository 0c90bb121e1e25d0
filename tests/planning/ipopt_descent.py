"""Minimise a path cost by IPOPT, as the oracle of the descent of the package."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from uvms_ocp.planning.block_tridiagonal import BlockTridiagonal
from uvms_ocp.planning.path_cost import LocalModel
from uvms_ocp.planning.trust_region import Descent, DescentProblem
from uvms_ocp.types import Array, Indices, Mask


@dataclass(frozen=True, kw_only=True, slots=True)
class Ipopt:
    """IPOPT with the model's gradient and positive semi-definite Hessian; keeps the bounds, and
    does not stop early.
    """

    max_iterations: int = 100
    tolerance: float = 1e-4
    """Largest error of the optimality conditions, as IPOPT scales them."""

    def minimise(self, problem: DescentProblem) -> Descent:
        free = problem.free
        oracle = _Oracle(problem.model, problem.start, problem.free)
        y = ca.MX.sym("y", oracle.size)
        value = _value_function(oracle)
        gradient = _gradient_function(oracle)
        hessian = _hessian_function(oracle)
        settings = {
            "grad_f": gradient,
            "hess_lag": hessian,
            "no_nlp_grad": True,
            "calc_lam_p": False,
            "print_time": False,
            "ipopt": {
                "print_level": 0,
                "sb": "yes",
                "max_iter": self.max_iterations,
                "tol": self.tolerance,
                "acceptable_tol": 100.0 * self.tolerance,
                "hessian_constant": "no",
            },
        }
        solver = ca.nlpsol("soft_collision", "ipopt", {"x": y, "f": value(y)}, settings)
        found = solver(x0=problem.start[free], lbx=problem.lower[free], ubx=problem.upper[free])
        x = oracle.full(np.asarray(found["x"]).ravel())
        stats = solver.stats()
        return Descent(
            variables=x,
            model=problem.model(x),
            iterations=int(stats["iter_count"]),
            converged=bool(stats["success"]),
        )


@dataclass(slots=True, eq=False)
class _Oracle:
    """Value, gradient and Hessian in the free variables; the last point is remembered, IPOPT asks
    for it thrice.
    """

    model: Callable[[Array], LocalModel]
    """Local model as in `DescentProblem`."""
    start: Array
    """(n_nodes, b) [m, rad]"""
    free: Mask
    """(n_nodes, b)"""
    _at: Array | None = None
    """(n_free,) [m, rad] the last point."""
    _here: LocalModel | None = None
    """The cost there."""
    pattern: ca.Sparsity = field(init=False)
    """(n_free, n_free) of the upper half of the Hessian."""
    entries: Indices = field(init=False)
    """(nnz,) where its nonzeros are in the whole Hessian of all variables."""

    def __post_init__(self) -> None:
        n, b = self.free.shape
        coupled = np.ones((n, b, b))
        block = BlockTridiagonal(diagonal=coupled, below=coupled[1:]).dense()
        keep = np.flatnonzero(self.free.ravel())
        upper = np.triu(block[np.ix_(keep, keep)])
        self.pattern = ca.sparsify(ca.DM(upper)).sparsity()
        rows, columns = (np.array(part) for part in self.pattern.get_triplet())
        self.entries = keep[rows] * (n * b) + keep[columns]

    @property
    def size(self) -> int:
        return int(self.free.sum())

    def full(self, y: Array) -> Array:
        x = self.start.copy()
        x[self.free] = y
        return x

    def at(self, y: Array) -> LocalModel:
        if self._here is None or self._at is None or not np.array_equal(y, self._at):
            self._at, self._here = y.copy(), self.model(self.full(y))
        return self._here

    def hessian(self, y: Array) -> ca.DM:
        return ca.DM(self.pattern, self.at(y).hessian.dense().ravel()[self.entries])


class _Callback(ca.Callback):
    """A Python function of dense columns with given output sparsities, under the names that nlpsol
    expects.
    """

    def __init__(
        self,
        name: str,
        inputs: dict[str, int],
        outputs: dict[str, ca.Sparsity],
        call: Callable[[list[ca.DM]], list[ca.DM]],
    ) -> None:
        ca.Callback.__init__(self)
        self.inputs = inputs
        self.outputs = outputs
        self.call_back = call
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self.inputs)

    def get_n_out(self) -> int:
        return len(self.outputs)

    def get_name_in(self, index: int) -> str:
        return list(self.inputs)[index]

    def get_name_out(self, index: int) -> str:
        return list(self.outputs)[index]

    def get_sparsity_in(self, index: int) -> ca.Sparsity:
        return ca.Sparsity.dense(list(self.inputs.values())[index], 1)

    def get_sparsity_out(self, index: int) -> ca.Sparsity:
        return list(self.outputs.values())[index]

    def eval(self, arguments: list[ca.DM]) -> list[ca.DM]:
        return self.call_back(arguments)


def _value_function(oracle: _Oracle) -> ca.Callback:
    def call(arguments: list[ca.DM]) -> list[ca.DM]:
        return [ca.DM(oracle.at(_column(arguments[0])).parts.total)]

    return _Callback("soft_value", {"x": oracle.size}, {"f": ca.Sparsity.dense(1)}, call)


def _gradient_function(oracle: _Oracle) -> ca.Callback:
    def call(arguments: list[ca.DM]) -> list[ca.DM]:
        here = oracle.at(_column(arguments[0]))
        return [ca.DM(here.parts.total), ca.DM(here.gradient[oracle.free])]

    outputs = {"f": ca.Sparsity.dense(1), "grad_f_x": ca.Sparsity.dense(oracle.size)}
    return _Callback("soft_gradient", {"x": oracle.size, "p": 0}, outputs, call)


def _hessian_function(oracle: _Oracle) -> ca.Callback:
    def call(arguments: list[ca.DM]) -> list[ca.DM]:
        return [arguments[2] * oracle.hessian(_column(arguments[0]))]

    inputs = {"x": oracle.size, "p": 0, "lam_f": 1, "lam_g": 0}
    return _Callback("soft_hessian", inputs, {"triu_hess_gamma_x_x": oracle.pattern}, call)


def _column(value: ca.DM) -> Array:
    return np.asarray(value, dtype=float).ravel()
