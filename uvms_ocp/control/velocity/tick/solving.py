"""The hierarchy solved between `before` and `after`, in machine code: levels, solver, and what comes of it."""

from __future__ import annotations

from typing import Annotated, Any

from uvms_ocp.control.velocity.levels import LevelsProblem
from uvms_ocp.control.velocity.tick.kernels import after
from uvms_ocp.control.velocity.tick.layout import TickMemory
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, structure_of
from uvms_ocp.functions.kernels.smooth import Smooth
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.solvers.hierarchy.tick import dense


class VelocityController(Layout):
    """All that a controller of velocities remembers."""

    tick: TickMemory
    """Of the mission, and before and after the solver."""
    levels: Smooth
    """As `LevelsProblem.function`."""
    solver: Smooth
    """J, lower, upper, gate, active set -> v, active set, report, residual."""
    jacobian: Annotated[Vector, Sized("n_entries")]
    """(n_rows, n_v) column after column, as all that follows of `Level`."""
    lower: Annotated[Vector, Sized("n_rows")]
    upper: Annotated[Vector, Sized("n_rows")]
    gate: Annotated[Vector, Sized("n_rows")]
    activity: Annotated[Vector, Sized("n_activity")]
    """(n_activity,) [-] as that of the levels function."""
    active_set: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) of the tick before."""
    found_set: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) of this one."""
    report: Annotated[Vector, Sized(2)]
    """(2,) code of the solver's `Status`, and iterations."""
    residual: Annotated[Vector, Sized("n_rows")]
    """(n_rows,) [m/s, rad/s] as that of `TickResult`."""
    usable: Annotated[list[int], Sized("n_statuses")]
    """(n_statuses,) which statuses have a velocity to use."""


def solve(c: VelocityController) -> int:
    """What the hierarchy asks for; returns the code of the `Status`. A kernel."""
    m, J, low, up, gate, goals, told = (
        c.tick,
        c.jacobian,
        c.lower,
        c.upper,
        c.gate,
        c.tick.goals.values,
        c.tick.quantities,
    )
    v, gates = m.v, m.gates
    c.levels(m.q, v, m.previous, m.change, m.echo, goals, gates, J, low, up, None, None, gate, told, c.activity)
    c.solver(J, low, up, gate, c.active_set, m.solved, c.found_set, c.report, c.residual)
    for i in range(len(c.active_set)):
        c.active_set[i] = c.found_set[i]
    status = int(c.report[0])
    m.usable = c.usable[status] != 0
    return status


def finish(c: VelocityController) -> int:
    """`solve`, and `after` it. A kernel."""
    status = solve(c)
    after(c.tick)
    return status


def velocity_controller(tick: Any, problem: LevelsProblem, solver: Any) -> Any:
    """A `VelocityController` whose tick is a copy of this one; `None` for a solver that has no machine code."""
    levels, rows = dense(problem.function), problem.sizes
    core = solver.core(levels.size2_out(0), rows) if isinstance(solver, LexicographicActiveSet) else None
    if core is None:
        return None
    sizes = {"n_rows": sum(rows), "n_entries": levels.numel_out(0), "n_statuses": len(Status)}
    activity = levels.numel_out(levels.n_out() - 1)
    kind = structure_of(VelocityController, tick=type(tick), levels=levels, solver=core, n_activity=activity, **sizes)
    memory: Any = kind()
    memory.tick = tick
    memory.usable[:] = [status.usable for status in Status]
    return memory
