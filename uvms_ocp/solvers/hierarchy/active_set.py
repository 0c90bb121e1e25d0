"""Strict hierarchy by a dedicated active-set method for lexicographic least squares ([Escande2014],
[Dimitrov2015]).

In C where there is a compiler (`core_source` puts its files behind the sizes, tolerances and
codes), in NumPy otherwise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import lru_cache

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.codegen.c_text import c_macros, constants_of
from uvms_ocp.errors import InvalidInput
from uvms_ocp.solvers.hierarchy import active_set_numpy, core, tolerances
from uvms_ocp.solvers.hierarchy.iteration_budget import iteration_budget
from uvms_ocp.types import Array


def solver_source(n: int, sizes: Sequence[int]) -> str:
    """Return C99 source for n velocities and levels of ``sizes`` rows: `solve_levels` of
    fallbacks.c, all else static; needs libm only.

    Nothing is allocated: a call works on the stack, with 60 kB for 13 velocities and 60 rows. For L
    levels it makes at most 3 L + 3 runs, which together end after `IterationBudget.most_of_all`
    iterations, whatever the numbers, and L + 6 certificates, whose search ends after twelve rounds
    per row. Raises `InvalidInput` for levels without a row.
    """
    if not any(sizes):
        raise InvalidInput(f"sizes = {list(sizes)} of levels; give at least one row")
    row_states = [f"{state.name} = {state.value}" for state in active_set_numpy.RowState]
    parts = [
        core.preamble(n, sizes),
        c_macros(constants_of(tolerances)),
        c_macros(asdict(iteration_budget(sum(sizes)))),
        f"enum {{ {', '.join(row_states)} }};\n",
        *core.texts_of("equalities.c", "active_set.c", "scaling.c", "certificate.c", "fallbacks.c"),
    ]
    return "\n".join(parts)


@lru_cache(maxsize=64)
def core_source(n: int, sizes: tuple[int, ...]) -> str:
    """Return `solver_source` with the solver and its certificate as external functions of
    CasADi.
    """
    return "\n".join([solver_source(n, sizes), *core.texts_of("interface.c", "casadi.c")])


@checked_dataclass(eq=False)
class LexicographicActiveSet(core.CompiledSolver):
    """Exact lexicographic least squares, warm-started from the active set of the call before.

    In C where there is a compiler, in NumPy otherwise, with the same results. Where the method
    gives up it starts anew cold, then goes level by level, then with fewer levels, as said in
    `uvms_ocp.solvers.hierarchy.active_set_numpy`; a call takes ``120 + 60 M`` iterations at most
    for M rows of all levels, whatever the numbers.

    What a gate between 0 and 1 does is said in `uvms_ocp.solvers.hierarchy.level`. In a controller
    priorities stay strict and accelerations within their limits while gates change, and the jerk is
    bounded (`uvms_ocp.control.velocity.levels`); `Icat` keeps none of the three.
    """

    compiled: bool = True
    """False keeps to NumPy."""

    def core_source(self, n: int, sizes: Sequence[int]) -> str:
        """Return the C99 source of the active set and its certificate, see `core_source`."""
        return core_source(n, tuple(sizes))

    def in_python(self, n: int, sizes: Sequence[int]) -> core.PythonSolver:
        """Return `active_set_numpy.solve_levels` with the arguments and results of a core."""

        def solve(
            J: Array,
            lower: Array,
            upper: Array,
            rate: Array,
            activation: Array,
            gate: Array,
            state: Array,
        ) -> list[Array]:
            result = active_set_numpy.solve_levels(J, lower, upper, gate, state, sizes)
            return [
                result.v,
                result.active_set,
                core.report(result.status, result.iterations),
                result.residual,
            ]

        return solve
