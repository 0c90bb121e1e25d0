"""A bound cascade, which survives a plugin that breaks down in the middle of a tick."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.arguments import trusted
from uvms_ocp.arrays import Array
from uvms_ocp.functions.buffered import BufferedFunction
from uvms_ocp.solvers.hierarchy.cascade.qp_graph import LevelStep, fixed_rows
from uvms_ocp.solvers.hierarchy.certificate import normal_certificate
from uvms_ocp.solvers.hierarchy.gated_rows import residual
from uvms_ocp.solvers.hierarchy.scaling import normal_rows
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.solvers.hierarchy.tick import TickResult
from uvms_ocp.solvers.hierarchy.tolerances import TOLERANCES

_result = trusted(TickResult)

_STATUS = (Status.SOLVED, Status.INEXACT, Status.INVALID_INPUT)
_INEXACT = 1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class QpFunctions:
    """What a tick evaluates."""

    tick: ca.Function
    """inputs -> v, status, residual, *extras"""
    levels: ca.Function
    """inputs -> J, lower, upper (gated), J, lower, upper, gate (as given), *extras"""
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
                outputs = self._rescued(inputs)
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
        exact = normal_certificate(rows, v / rows.velocity) <= TOLERANCES.certified
        return Status.SOLVED if exact else Status.INEXACT

    def _rescued(self, inputs: Sequence[ArrayLike]) -> tuple[Array, ...]:
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
