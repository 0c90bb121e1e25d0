"""Strict hierarchy by a dedicated active-set method for lexicographic least squares ([Escande2014], [Dimitrov2015])."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from time import perf_counter

import casadi as ca

from uvms_ocp.compile import compile_function, compile_library
from uvms_ocp.solvers.active_set_tick import ActiveSetFunctions, ActiveSetTick
from uvms_ocp.solvers.level import Level, stack
from uvms_ocp.solvers.qp_graph import outcome, sanitised
from uvms_ocp.solvers.solution import Solution, row_residuals
from uvms_ocp.solvers.tick import LEVEL_OUTPUTS, check_levels_function, dense_inputs, dense_outputs


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LexicographicActiveSet:
    """Exact lexicographic least squares, warm-started from the active set of the call before.

    In C where there is a compiler, in NumPy otherwise, with the same results. Gates act as in ``LexicographicQp``.
    """

    compiled: bool = True
    """False keeps to NumPy."""
    cascade: bool = True
    """Fall back on ``LexicographicQp``, polished by one more run, where the method gives up."""

    def solve(self, levels: Sequence[Level]) -> Solution:
        """From a cold start; raise ``InvalidInput`` where ``levels`` is empty or of mixed width."""
        start = perf_counter()
        rows = stack(levels)
        tick = _stack_tick(self, rows.jacobian.shape[1], rows.sizes)
        tick.reset()
        result = tick(rows.jacobian, rows.lower, rows.upper, rows.rate, rows.activation, rows.gate)
        return Solution(
            v=result.v,
            status=result.status,
            residuals=row_residuals(levels, result.v),
            solve_time=perf_counter() - start,
        )

    def bind(self, levels_function: ca.Function, sizes: Sequence[int]) -> ActiveSetTick:
        """One Function of ``levels_function`` and the solver; outputs beyond the six of ``Level`` are extras."""
        check_levels_function(levels_function, sizes)
        if self.compiled:
            levels_function = compile_function(levels_function)
        function = self.function(levels_function, sizes)
        return ActiveSetTick(
            ActiveSetFunctions(
                tick=function,
                core=None if function is None else _core(levels_function.size2_out(0), tuple(sizes)),
                levels=gated_levels(levels_function),
                sizes=tuple(sizes),
                cascade=self.cascade,
            )
        )

    def function(self, levels_function: ca.Function, sizes: Sequence[int]) -> ca.Function | None:
        """(inputs, active_set) -> v, active_set, report, status, residual, *extras: pure, for ``map`` and export.

        ``report`` is [outcome of the run, iterations, 1 if it had to start anew cold]; status is 0 for valid input and
        2 otherwise. None where the core cannot be compiled.
        """
        core = _core(levels_function.size2_out(0), tuple(sizes)) if self.compiled else None
        if core is None:
            return None
        inputs, names = dense_inputs(levels_function), levels_function.name_in()
        J, lower, upper, _, _, gate, *extras = dense_outputs(levels_function, inputs)
        valid, J_safe, low, up = sanitised(J, lower, upper, gate)
        active = ca.MX.sym("active_set", J.shape[0])
        v, reached, report = core(J_safe, low, up, active)
        status, residual = outcome(valid, v, ca.MX.zeros(1), J, lower, upper, gate)
        outputs = [v, reached, report, status, residual, *extras]
        labels = ["v", "active_set_out", "report", "status", "residual", *_extra_names(len(extras))]
        return ca.Function("tick", [*inputs, active], outputs, [*names, "active_set"], labels)


def _extra_names(count: int) -> list[str]:
    return [f"extra_{i}" for i in range(count)]


def gated_levels(levels_function: ca.Function) -> ca.Function:
    """inputs -> valid, J, lower, upper (harmless where not valid, gated), lower, upper, gate, *extras."""
    inputs = dense_inputs(levels_function)
    J, lower, upper, _, _, gate, *extras = dense_outputs(levels_function, inputs)
    outputs = [*sanitised(J, lower, upper, gate), lower, upper, gate, *extras]
    labels = ["valid", "J", "low", "up", "lower", "upper", "gate", *_extra_names(len(extras))]
    return ca.Function("levels", inputs, outputs, levels_function.name_in(), labels)


@lru_cache(maxsize=64)
def _core(n: int, sizes: tuple[int, ...]) -> ca.Function | None:
    """(J, lower, upper, active set) -> (v, active set, [outcome, iterations])."""
    if sum(sizes) == 0:
        return None
    path = compile_library(core_source(n, sizes))
    return None if path is None else ca.external("lexls", str(path))


def core_source(n: int, sizes: Sequence[int]) -> str:
    """C source for n velocities and levels of ``sizes`` rows; needs libm only."""
    filled = [size for size in sizes if size]
    constants = {"N": n, "M": sum(filled), "L": len(filled), "SIZES": ", ".join(map(str, filled))}
    defines = "".join(f"#define LEX_{name} {value}\n" for name, value in constants.items())
    return defines + files("uvms_ocp.solvers").joinpath("active_set.c").read_text(encoding="utf-8")


@lru_cache(maxsize=64)
def _stack_tick(solver: LexicographicActiveSet, n: int, sizes: tuple[int, ...]) -> ActiveSetTick:
    m = sum(sizes)
    symbols = [ca.MX.sym(name, m, n if name == "J" else 1) for name in LEVEL_OUTPUTS]
    names = list(LEVEL_OUTPUTS)
    return solver.bind(ca.Function("levels", symbols, symbols, [f"{name}_in" for name in names], names), sizes)
