"""Strict hierarchy as a cascade of quadratic programs ([Kanoun2011], [Escande2014]) inside one CasADi Function.

A bound cascade survives a plugin that breaks down in the middle of a tick.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from time import perf_counter

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_on_failure, unchecked_constructor
from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.errors import NameNotFound
from uvms_ocp.solvers.hierarchy import tolerances
from uvms_ocp.solvers.hierarchy.certificate import normal_certificate, normal_rows
from uvms_ocp.solvers.hierarchy.level import Level, residual
from uvms_ocp.solvers.hierarchy.qp_graph import (
    LevelStep,
    QpSettings,
    cascade,
    fixed_rows,
    level_step,
    outcome,
    sanitised,
)
from uvms_ocp.solvers.hierarchy.solution import (
    Solution,
    Status,
    Tick,
    TickResult,
    check_levels_function,
    dense_inputs,
    dense_outputs,
    solve_stacked,
    timed_solution,
)
from uvms_ocp.types import Array, AtLeastOne, Positive

# A bound cascade, which survives a plugin that breaks down in the middle of a tick.

_result = unchecked_constructor(TickResult)

_STATUS = (Status.SOLVED, Status.INEXACT, Status.INVALID_INPUT)
_INEXACT = 1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class QpFunctions:
    """CasADi functions evaluated at every tick."""

    tick: ca.Function
    """Inputs -> v, status, residual, *extras"""
    levels: ca.Function
    """Inputs -> J, lower, upper (gated), J, lower, upper, gate (as given), *extras"""
    steps: Sequence[LevelStep | None]
    """One per level, None for a level without rows."""
    sizes: tuple[int, ...]
    """Rows of each level."""
    certified: bool
    """`LexicographicQp.certified`."""


class QpTick:
    """The whole cascade in one Function; level by level where a plugin reports an error.

    CasADi abandons a Function as soon as a plugin inside it fails, and a plugin such as qpOASES that failed once
    on a warm start fails from then on, until its memory is replaced: a memory that is checked out and not released is
    never handed to the cascade again, and CasADi frees it with the Function. The same cures a plugin that reports success but
    whose warm start no longer leads to the optimum, as after a jump to another problem.
    """

    __slots__ = ("_fresh", "_functions", "_levels", "_tick")

    def __init__(self, functions: QpFunctions) -> None:
        self._functions = functions
        self._tick, self._levels = BufferedFunction(functions.tick), BufferedFunction(functions.levels)
        self._fresh = False
        with contextlib.redirect_stdout(io.StringIO()):
            self._set_up()

    def __call__(self, *inputs: ArrayLike) -> TickResult:
        """Raises `InvalidInput` for a wrong number or shape of inputs."""
        start = perf_counter()
        # Plugins report their troubles through Python's stdout, whatever their options say.
        with contextlib.redirect_stdout(io.StringIO()):
            outputs = self._tick(*inputs)
            if self._tick.failed or (outputs[1][0] == _INEXACT and not self._fresh):
                outputs = self._solve_by_level(inputs)
        # Where fresh plugins do not help either, they would not at the next tick.
        self._fresh = bool(outputs[1][0] == _INEXACT)
        v, status, missed, *extras = outputs
        return _result(
            v=v,
            status=self._status(int(status[0]), v, inputs),
            residual=missed,
            extras=tuple(extras),
            solve_time=perf_counter() - start,
        )

    def _status(self, said: int, v: Array, inputs: Sequence[ArrayLike]) -> Status:
        """Exact only if that is certified, whatever the programs say of themselves."""
        if _STATUS[said] is Status.INVALID_INPUT:
            return Status.INVALID_INPUT
        if not self._functions.certified:
            return Status.INEXACT
        J, low, up = self._levels(*inputs)[:3]
        rows = normal_rows(J.reshape(-1, len(v)), low, up, self._functions.sizes)
        exact = normal_certificate(rows, v / rows.velocity) <= tolerances.CERTIFIED
        return Status.SOLVED if exact else Status.INEXACT

    def _solve_by_level(self, inputs: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """On fresh plugins first, then level by level, where a level that still fails keeps v."""
        for conic in self._conics():
            conic.checkout()
        self._set_up()
        outputs = self._tick(*inputs)
        return self._stepwise(inputs) if self._tick.failed else outputs

    def _set_up(self) -> None:
        for conic in self._conics():
            conic.release(conic.checkout())

    def _conics(self) -> list[ca.Function]:
        return [step.conic for step in self._functions.steps if step is not None]

    def _stepwise(self, inputs: Sequence[ArrayLike]) -> tuple[Array, ...]:
        J, low, up, J_given, lower, upper, gate, *extras = self._levels(*inputs)
        n = self._functions.levels.size2_out(0)
        J, J_given = J.reshape(-1, n), J_given.reshape(-1, n)
        v, P, inexact, held = np.zeros(n), np.eye(n), 0.0, 0
        bounds, fixed = (low.copy(), up.copy()), np.zeros(len(low))
        for step in self._functions.steps:
            if step is None:
                continue
            rows = slice(held, held + step.solve.size1_in(4))
            above = (J[:held], bounds[0][:held], bounds[1][:held], fixed[:held])
            v, P, failed = _level(step, [*above, J[rows], low[rows], up[rows], v, P])
            y = J[rows] @ v
            fixed[rows] = fixed_rows(y, low[rows], up[rows])
            bounds[0][rows], bounds[1][rows] = np.minimum(low[rows], y), np.maximum(up[rows], y)
            inexact, held = max(inexact, float(failed[0])), rows.stop
        return (v, np.array([inexact]), residual(J_given, v, lower, upper, gate), *extras)


def _level(step: LevelStep, inputs: list[Array]) -> tuple[Array, ...]:
    function = BufferedFunction(step.solve)
    outputs = function(*inputs)
    return BufferedFunction(step.give_up)(*inputs) if function.failed else outputs


_DEFAULTS: dict[str, dict[str, object]] = {
    "qpoases": {"printLevel": "none", "enableFlippingBounds": False},
    "qrqp": {"print_iter": False, "print_header": False, "print_info": False},
    "osqp": {"osqp": {"verbose": False}},
    "ipqp": {"print_iter": False, "print_header": False, "print_info": False},
    "highs": {"highs": {"output_flag": False}},
}


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LexicographicQp:
    """Each level minimises its own slack subject to the optimal slack of all levels above it.

    What a gate between 0 and 1 does is said in `uvms_ocp.solvers.hierarchy.level`. Raises `InvalidInput` for a number out of
    its range.
    """

    plugin: str = "qpoases"
    """Any conic plugin of CasADi that solves quadratic programs."""
    options: Mapping[str, object] = field(default_factory=dict)
    """Options of the plugin, on top of our defaults."""
    proximal: Positive = 1e-10
    """Weight of the distance to the velocity of the levels above, relative to the mean square of the rows: it makes each
    program strictly convex."""
    tolerance: Positive = 1e-9
    """Largest accepted violation of a higher level, relative to its row."""
    attempts: AtLeastOne = 3
    """Programs per level at most; a further one starts where the last one ended."""
    certified: bool = True
    """Certify every result, which takes longer than the solution; else no result is called exact."""

    def __post_init__(self) -> None:
        """Raises `NameNotFound` for an unknown plugin."""
        if not _exists(self.plugin):
            raise NameNotFound("conic plugin", self.plugin, conic_plugins())

    @checked_on_failure
    def solve(self, levels: Sequence[Level]) -> Solution:
        """Raises `InvalidInput` where ``levels`` is empty or of mixed width."""
        return timed_solution(levels, partial(solve_stacked, self.bind))

    def bind(self, levels_function: ca.Function, sizes: Sequence[int]) -> Tick:
        """One Function of ``levels_function`` and the cascade; outputs beyond the six of ``Level`` are extras."""
        check_levels_function(levels_function, sizes)
        inputs, names = dense_inputs(levels_function), levels_function.name_in()
        J, lower, upper, _, _, gate, *extras = dense_outputs(levels_function, inputs)
        # Some plugins print a banner through Python's stdout when they are created.
        with contextlib.redirect_stdout(io.StringIO()):
            settings, above = (self._settings(), np.cumsum([0, *sizes]))
            steps = [
                level_step(settings, J.shape[1], int(above[k]), size) if size else None for k, size in enumerate(sizes)
            ]
        valid, J_safe, low, up = sanitised(J, lower, upper, gate)
        v, inexact = cascade(steps, J_safe, low, up)
        status, residual = outcome(valid, v, inexact, J, lower, upper, gate)
        outputs, raw = [v, status, residual, *extras], [J_safe, low, up, J, lower, upper, gate, *extras]
        tick = ca.Function("tick", inputs, outputs, names, [f"out_{i}" for i in range(len(outputs))])
        levels = ca.Function("levels", inputs, raw, names, [f"out_{i}" for i in range(len(raw))])
        return QpTick(QpFunctions(tick=tick, levels=levels, steps=steps, sizes=tuple(sizes), certified=self.certified))

    def _settings(self) -> QpSettings:
        options = {"error_on_fail": False, **_DEFAULTS.get(self.plugin, {}), **self.options}
        return QpSettings(
            plugin=self.plugin,
            options=options,
            proximal=self.proximal,
            tolerance=self.tolerance,
            attempts=self.attempts,
        )


def conic_plugins() -> tuple[str, ...]:
    """Names of the conic plugins of this CasADi that can be loaded."""
    entries = str(ca.CasadiMeta.plugins()).split(";")
    names = sorted(entry.removeprefix("Conic::") for entry in entries if entry.startswith("Conic::"))
    return tuple(name for name in names if _exists(name))


@cache
def _exists(plugin: str) -> bool:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return bool(ca.has_conic(plugin))
