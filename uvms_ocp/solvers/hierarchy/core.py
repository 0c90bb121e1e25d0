"""Solvers of hierarchies whose core is one function in machine code, and what binds it to the
function of the levels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from importlib.resources import files
from time import perf_counter

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked, checked_on_failure
from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.codegen.c_text import WIDE_MACROS, c_macros
from uvms_ocp.codegen.compile import compile_function, external_function
from uvms_ocp.solvers.hierarchy import solution
from uvms_ocp.solvers.hierarchy.level import Level
from uvms_ocp.types import Array

STATUSES = tuple(solution.Status)
"""Statuses by their codes, which a core gives."""

PythonSolver = Callable[..., Sequence[Array]]
"""(J (M, n), lower, upper, rate, activation, gate, state) -> v, state, report, residual, as a core
has them.
"""


def texts_of(*names: str) -> list[str]:
    """Return the texts of files of C beside this one."""
    return [
        (files("uvms_ocp.solvers.hierarchy") / name).read_text(encoding="utf-8") for name in names
    ]


def report(status: solution.Status, iterations: int = 0) -> Array:
    """Write the code of a status, and iterations, as a core reports them (2,)."""
    return np.array([STATUSES.index(status), iterations], dtype=float)


def preamble(n: int, sizes: Sequence[int]) -> str:
    """Return what the C of a core begins with: headers, codes of statuses, sizes.

    n: velocities. sizes: rows of each level.
    """
    filled = [size for size in sizes if size]
    rows = {"N": n, "M": sum(filled), "L": len(filled), "LEVEL_SIZES": ", ".join(map(str, filled))}
    codes = ", ".join(f"{status.name} = {code}" for code, status in enumerate(STATUSES))
    return (
        f"#include <math.h>\n#include <string.h>\n\n{WIDE_MACROS}\n{c_macros(rows)}\nenum {{"
        f" {codes} }};\n"
    )


class CoreTick:
    """A solver bound to the function of its levels, which starts from the state of the tick
    before.
    """

    __slots__ = ("_in_python", "_levels", "_state", "_tick", "_width")

    def __init__(
        self, tick: ca.Function | None, levels: ca.Function, in_python: PythonSolver
    ) -> None:
        r"""tick: of `CompiledSolver.function`. levels: inputs -> J, lower, upper, rate, activation,
        gate, \*extras.
        """
        self._tick = None if tick is None else BufferedFunction(tick)
        self._levels = BufferedFunction(levels)
        self._in_python = in_python
        self._width = levels.size2_out(0)
        self._state = np.zeros(levels.size1_out(0))

    def reset(self) -> None:
        """Forget the state, which of the strict solver is its active set: the next tick starts
        cold.
        """
        self._state[:] = 0.0

    def adopt(self, *inputs: Array) -> Callable[[], solution.TickResult]:
        """Return the call that reads these arrays, (m,) or (m, n) [any], in place, without copies.
        It replaces every other call of this tick.
        """
        if self._tick is None:
            return partial(self, *inputs)
        self._tick.adopt(*inputs, self._state)
        return partial(self._evaluated, self._tick)

    def __call__(self, *inputs: ArrayLike) -> solution.TickResult:
        """Raises `InvalidInput` for a wrong number or shape of inputs."""
        start = perf_counter()
        if self._tick is not None:
            return self._finish(self._tick(*inputs, self._state), start)
        J, *outputs = self._levels(*inputs)
        rows = outputs[:5]
        extras = outputs[5:]
        results = self._in_python(J.reshape(-1, self._width), *rows, self._state)
        return self._finish([*results, *extras], start)

    def _evaluated(self, tick: BufferedFunction) -> solution.TickResult:
        """Evaluate with the adopted inputs."""
        start = perf_counter()
        tick.evaluate()
        return self._finish([result.copy() for result in tick.results], start)

    def _finish(self, results: Sequence[Array], start: float) -> solution.TickResult:
        v, state, report, missed, *extras = results
        self._state[:] = state
        status = STATUSES[int(report[0])]
        return solution.tick_result(
            v=v,
            status=status,
            residual=missed,
            extras=tuple(extras),
            solve_time=perf_counter() - start,
        )


@checked
class CompiledSolver:
    """Base of the solvers that run a core in C where there is a compiler, and the same method in
    NumPy otherwise.
    """

    compiled: bool

    def core_source(self, n: int, sizes: Sequence[int]) -> str:
        """Return C99 source of the core, as an external function of CasADi, for n velocities and
        levels of ``sizes`` rows.
        """
        raise NotImplementedError

    def in_python(self, n: int, sizes: Sequence[int]) -> PythonSolver:
        """Return the core in Python, for where there is no compiler."""
        raise NotImplementedError

    @checked_on_failure
    def solve(self, levels: Sequence[Level]) -> solution.Solution:
        """Solve from a cold start. Raises `InvalidInput` where ``levels`` is empty or of mixed
        width.
        """
        return solution.timed_solution(levels, partial(solution.solve_stacked, self._bind_cold))

    def bind(self, levels_function: ca.Function, sizes: Sequence[int]) -> CoreTick:
        """Build one Function of ``levels_function`` and the solver; outputs beyond the six of
        ``Level`` are extras.
        """
        solution.check_levels_function(levels_function, sizes)
        if self.compiled:
            levels_function = compile_function(levels_function)
        in_python = self.in_python(levels_function.size2_out(0), sizes)
        tick = self.function(levels_function, sizes)
        return CoreTick(tick, solution.dense(levels_function), in_python)

    def core(self, n: int, sizes: Sequence[int]) -> ca.Function | None:
        """Return (J, lower, upper, rate, activation, gate, state) -> v, state, report, residual, in
        machine code; None where that cannot be.

        n: velocities. sizes: rows of each level.
        """
        if self.compiled and any(sizes):
            return external_core(self.core_source(n, sizes))
        return None

    def _bind_cold(self, levels_function: ca.Function, sizes: Sequence[int]) -> solution.Tick:
        tick = self.bind(levels_function, sizes)

        def cold(*inputs: ArrayLike) -> solution.TickResult:
            tick.reset()
            return tick(*inputs)

        return cold

    def function(self, levels_function: ca.Function, sizes: Sequence[int]) -> ca.Function | None:
        """Return (inputs, state) -> v, state, report, residual, *extras: pure, for ``map`` and
        export.

        ``report`` is [place of the ``Status`` among all of them, iterations]; v is 0 where the
        input is invalid. None where the solver cannot be compiled.
        """
        core = self.core(levels_function.size2_out(0), sizes)
        if core is None:
            return None
        inputs = solution.dense_inputs(levels_function)
        names = levels_function.name_in()
        outputs = solution.dense_outputs(levels_function, inputs)
        state = ca.MX.sym("state", outputs[0].shape[0])
        rows = outputs[:6]
        extras = outputs[6:]
        results = [*core(*rows, state), *extras]
        extra_names = [f"extra_{i}" for i in range(len(extras))]
        names_in = [*names, "state"]
        names_out = ["v", "state_out", "report", "residual", *extra_names]
        return ca.Function("tick", [*inputs, state], results, names_in, names_out)


@lru_cache(maxsize=64)
def external_core(source: str) -> ca.Function | None:
    """Compile the core of a `CompiledSolver.core_source`; None where it cannot be compiled."""
    return external_function("solve_hierarchy", source)
