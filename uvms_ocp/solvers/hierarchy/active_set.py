"""Strict hierarchy by a dedicated active-set method for lexicographic least squares ([Escande2014], [Dimitrov2015]).

In C where there is a compiler (`core_source` puts its files behind the sizes, tolerances and codes), in NumPy otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache, partial
from importlib.resources import files
from time import perf_counter

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked_dataclass, checked_on_failure, unchecked_constructor
from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.codegen.compile import c_macros, compile_function, constants_of, external_function
from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.hierarchy import active_set_numpy, solution, tolerances
from uvms_ocp.solvers.hierarchy.level import Level
from uvms_ocp.types import Array

# The C source of the solver: its own files, behind the sizes, tolerances and codes that Python decides.

_INCLUDES = "#include <math.h>\n#include <string.h>\n"
_SOURCES = ("equalities.c", "active_set.c", "scaling.c", "certificate.c", "fallbacks.c")


def solver_source(n: int, sizes: Sequence[int]) -> str:
    """C99 source for n velocities and levels of ``sizes`` rows: `solve_levels` of fallbacks.c, all else static; needs libm only.

    Nothing is allocated: a call works on the stack, with 60 kB for 13 velocities and 60 rows. For L levels it makes at most
    3 L + 3 runs, which together end after `IterationBudget.most_of_all` iterations, whatever the numbers, and L + 6
    certificates, whose search ends after twelve rounds per row. Raises `InvalidInput` for levels without a row.
    """
    filled = [size for size in sizes if size]
    if not filled:
        raise InvalidInput(f"levels of {list(sizes)} rows; give at least one row")
    parts = [
        _INCLUDES,
        c_macros({"N": n, "M": sum(filled), "L": len(filled), "LEVEL_SIZES": ", ".join(map(str, filled))}),
        c_macros(constants_of(tolerances)),
        c_macros(asdict(tolerances.iteration_budget(sum(filled)))),
        _codes({code.name: code.value for code in active_set_numpy.RowState}),
        _codes({status.name: code for code, status in enumerate(active_set_numpy.STATUSES)}),
        *_texts(_SOURCES),
    ]
    return "\n".join(parts)


def core_source(n: int, sizes: Sequence[int]) -> str:
    """Return `solver_source` with the solver and its certificate as external functions of CasADi."""
    return "\n".join([solver_source(n, sizes), *_texts(["casadi.c"])])


def _texts(names: Iterable[str]) -> list[str]:
    folder = files("uvms_ocp.solvers.hierarchy")
    return [folder.joinpath(name).read_text(encoding="utf-8") for name in names]


def _codes(codes: Mapping[str, int]) -> str:
    return f"enum {{ {', '.join(f'{name} = {code}' for name, code in codes.items())} }};\n"


# A bound active-set solver: one function of the levels and the solver in C, or in NumPy.

_result = unchecked_constructor(solution.TickResult)


class ActiveSetTick:
    """Warm-started from the active set of the tick before."""

    __slots__ = ("_active_set", "_levels", "_sizes", "_tick", "_width")

    def __init__(self, tick: ca.Function | None, levels: ca.Function, sizes: Sequence[int]) -> None:
        r"""tick: of `LexicographicActiveSet.function`. levels: inputs -> J, lower, upper, rate, activation, gate, \*extras."""
        self._tick = None if tick is None else BufferedFunction(tick)
        self._levels, self._sizes, self._width = BufferedFunction(levels), tuple(sizes), levels.size2_out(0)
        self._active_set = np.zeros(sum(sizes))

    def reset(self) -> None:
        """Forget the active set: the next tick starts cold."""
        self._active_set[:] = 0.0

    def adopt(self, *inputs: Array) -> Callable[[], solution.TickResult]:
        """The call with these arrays, (m,) or (m, n) [any], as they are then, without copies. No other call comes after it."""
        if self._tick is None:
            return partial(self, *inputs)
        self._tick.adopt(*inputs, self._active_set)
        return partial(self._evaluated, self._tick)

    @property
    def compiled(self) -> bool:
        """True if the whole tick is one Function with the solver in C."""
        return self._tick is not None

    def __call__(self, *inputs: ArrayLike) -> solution.TickResult:
        """Raises `InvalidInput` for a wrong number or shape of inputs."""
        start = perf_counter()
        if self._tick is None:
            return self._in_numpy(inputs, start)
        return self._finish(self._tick(*inputs, self._active_set), start)

    def _evaluated(self, tick: BufferedFunction) -> solution.TickResult:
        """Evaluate with the adopted inputs."""
        start = perf_counter()
        tick.evaluate()
        return self._finish([result.copy() for result in tick.results], start)

    def _finish(self, results: Sequence[Array], start: float) -> solution.TickResult:
        v, active_set, report, missed, *extras = results
        self._active_set[:] = active_set
        status = active_set_numpy.STATUSES[int(report[0])]
        return _result(v=v, status=status, residual=missed, extras=tuple(extras), solve_time=perf_counter() - start)

    def _in_numpy(self, inputs: Sequence[ArrayLike], start: float) -> solution.TickResult:
        J, lower, upper, _, _, gate, *extras = self._levels(*inputs)
        found = active_set_numpy.solve_levels(J.reshape(-1, self._width), lower, upper, gate, self._active_set, self._sizes)
        self._active_set[:] = found.active_set
        return _result(
            v=found.v, status=found.status, residual=found.residual, extras=tuple(extras), solve_time=perf_counter() - start
        )


@checked_dataclass(eq=False)
class LexicographicActiveSet:
    """Exact lexicographic least squares, warm-started from the active set of the call before.

    In C where there is a compiler, in NumPy otherwise, with the same results. Where the method gives up it starts anew cold,
    then goes level by level, then with fewer levels, as said in `uvms_ocp.solvers.hierarchy.active_set_numpy`; a call
    takes ``120 + 60 M`` iterations at most for M rows of all levels, whatever the numbers.

    What a gate between 0 and 1 does is said in `uvms_ocp.solvers.hierarchy.level`. In a controller priorities stay strict
    and accelerations within their limits while gates change, and the jerk is bounded (`uvms_ocp.control.velocity.levels`);
    `Icat` keeps none of the three.
    """

    compiled: bool = True
    """False keeps to NumPy."""

    @checked_on_failure
    def solve(self, levels: Sequence[Level]) -> solution.Solution:
        """Solve from a cold start. Raises `InvalidInput` where ``levels`` is empty or of mixed width."""
        return solution.timed_solution(levels, partial(solution.solve_stacked, self._bind_cold))

    def bind(self, levels_function: ca.Function, sizes: Sequence[int]) -> ActiveSetTick:
        """One Function of ``levels_function`` and the solver; outputs beyond the six of ``Level`` are extras."""
        solution.check_levels_function(levels_function, sizes)
        if self.compiled:
            levels_function = compile_function(levels_function)
        return ActiveSetTick(self.function(levels_function, sizes), solution.dense(levels_function), sizes)

    def core(self, n: int, sizes: Sequence[int]) -> ca.Function | None:
        """(J, lower, upper, gate, active set) -> v, active set, report, residual, in machine code; None where that cannot be.

        n: velocities. sizes: rows of each level.
        """
        return _core(n, tuple(sizes)) if self.compiled else None

    def _bind_cold(self, levels_function: ca.Function, sizes: Sequence[int]) -> solution.Tick:
        tick = self.bind(levels_function, sizes)

        def cold(*inputs: ArrayLike) -> solution.TickResult:
            tick.reset()
            return tick(*inputs)

        return cold

    def function(self, levels_function: ca.Function, sizes: Sequence[int]) -> ca.Function | None:
        """(inputs, active_set) -> v, active_set, report, residual, *extras: pure, for ``map`` and export.

        ``report`` is [place of the ``Status`` among all of them, iterations]; v is 0 where the input is invalid.
        None where the solver cannot be compiled.
        """
        core = self.core(levels_function.size2_out(0), sizes)
        if core is None:
            return None
        inputs, names = solution.dense_inputs(levels_function), levels_function.name_in()
        J, lower, upper, _, _, gate, *extras = solution.dense_outputs(levels_function, inputs)
        active = ca.MX.sym("active_set", J.shape[0])
        outputs = [*core(J, lower, upper, gate, active), *extras]
        labels = ["v", "active_set_out", "report", "residual", *(f"extra_{i}" for i in range(len(extras)))]
        return ca.Function("tick", [*inputs, active], outputs, [*names, "active_set"], labels)


@lru_cache(maxsize=64)
def _core(n: int, sizes: tuple[int, ...]) -> ca.Function | None:
    """(J, lower, upper, gate, active set) -> v, active set, report, residual; see casadi.c."""
    return external_function("active_set", core_source(n, sizes)) if sum(sizes) else None
