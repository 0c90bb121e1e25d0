"""Our solvers on given matrices and on the whole tick of Case 1."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
from recording.report import Row
from recording.timing import built

from hierarchy_solvers.found import Found, certificates_of, timed_row
from hierarchy_solvers.problems import Inputs, Problem, exactness_problems
from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.control.velocity.levels import LevelsProblem
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.solvers.hierarchy.active_set import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.cascade import LexicographicQp
from uvms_ocp.solvers.hierarchy.core import CoreTick
from uvms_ocp.solvers.hierarchy.icat import Icat
from uvms_ocp.solvers.hierarchy.level import Level
from uvms_ocp.solvers.hierarchy.solution import LEVEL_OUTPUTS, Tick

IN_C = "active set in C"
IN_NUMPY = "active set in NumPy"
SOLVERS: dict[str, HierarchySolver] = {
    IN_C: LexicographicActiveSet(),
    IN_NUMPY: LexicographicActiveSet(compiled=False),
    "qpOASES cascade": LexicographicQp(),
    "iCAT in C": Icat(),
    "iCAT in NumPy": Icat(compiled=False),
}


def stacked(levels: Sequence[Level]) -> list[np.ndarray]:
    """The six inputs of a tick."""
    inputs = []
    for name in ("jacobian", "lower", "upper", "rate", "activation", "gate"):
        inputs.append(np.concatenate([getattr(level, name) for level in levels]))
    return inputs


def solved(solver: HierarchySolver, problem: Problem) -> Found:
    """Every problem of the set, after one call to warm up."""
    tick = _bound_to_matrices(solver, problem)
    inputs_of_ticks = [stacked(levels) for levels in problem.sets]
    tick(*inputs_of_ticks[0])
    v = []
    exact = []
    seconds = []
    for inputs in inputs_of_ticks:
        if not problem.warm:
            _forget(tick)
        start = time.perf_counter()
        result = tick(*inputs)
        seconds.append(time.perf_counter() - start)
        v.append(result.v)
        exact.append(result.status.exact)
    return Found(v=np.array(v), exact=np.array(exact), seconds=np.array(seconds))


def _bound_to_matrices(solver: HierarchySolver, problem: Problem) -> Tick:
    """A tick whose inputs are the stacked levels themselves."""
    n = problem.sets[0][0].n_velocities
    n_rows = sum(problem.sizes)
    symbols = []
    for name in LEVEL_OUTPUTS:
        n_columns = n if name == "J" else 1
        symbols.append(ca.MX.sym(name, n_rows, n_columns))
    names_in = [f"{name}_in" for name in LEVEL_OUTPUTS]
    function = ca.Function("levels", symbols, symbols, names_in, list(LEVEL_OUTPUTS))
    return solver.bind(function, problem.sizes)


def _forget(tick: Tick) -> None:
    """Let the next call start cold: only the active-set solver remembers."""
    if isinstance(tick, CoreTick):
        tick.reset()


def whole_tick_rows(
    problem: LevelsProblem, inputs: Sequence[Inputs], *, passes: int, cold: bool
) -> list[Row]:
    """Case 1, kinematics included, as the controller calls it; cold: compiled anew, to time
    that.
    """
    rows: list[Row] = []
    for name, solver in SOLVERS.items():
        scenario = replace(case1(plant="kinematic"), solver=solver)
        build_s = built(scenario.controller, cold=cold).wall
        tick = solver.bind(problem.function, problem.sizes)
        rows.append(_repeated("whole tick", name, tick, inputs, passes) | {"build_s": build_s})
    return rows


def cold_rows(problem: LevelsProblem, states: Sequence[Inputs], passes: int) -> list[Row]:
    """Case 1 at random states, each from a cold start."""
    rows: list[Row] = []
    for name in (IN_C, IN_NUMPY):
        tick = SOLVERS[name].bind(problem.function, problem.sizes)
        rows.append(_repeated("random states, cold", name, tick, states, passes, True))
    return rows


def _repeated(
    problem: str,
    solver: str,
    tick: Tick,
    inputs: Sequence[Inputs],
    passes: int,
    forget: bool = False,
) -> dict[str, object]:
    """Time a tick in several passes, in which it does the same work: what is longer than the
    shortest is other programs.
    """
    tick(*inputs[0])
    times = []
    for _ in range(passes):
        seconds, inexact = _one_pass(tick, inputs, forget)
        times.append(seconds)
    return timed_row(problem, solver, np.min(times, axis=0), inexact)


def _one_pass(tick: Tick, inputs: Sequence[Inputs], forget: bool) -> tuple[np.ndarray, int]:
    """Times [s] of all ticks in sequence, and the number that are not exact."""
    seconds = []
    inexact = 0
    for values in inputs:
        if forget:
            _forget(tick)
        start = time.perf_counter()
        result = tick(*values)
        seconds.append(time.perf_counter() - start)
        inexact += not result.status.exact
    return np.array(seconds), inexact


def exactness_rows(count: int) -> list[Row]:
    """Certificates of many random hierarchies, all of them checked."""
    rows: list[Row] = []
    for problem in exactness_problems(count):
        results = solved(SOLVERS[IN_C], problem)
        row = timed_row(problem.name, IN_C, results.seconds, results.inexact)
        largest = float(certificates_of(problem, results.v).max())
        rows.append(row | {"largest certificate where exact": largest})
    return rows
