"""The second half of a tick as a thing to call: the solver and what follows, in one call of machine code or one by one."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np

from uvms_ocp.control.velocity.tick.memory import TickArrays
from uvms_ocp.control.velocity.tick.solving import finish
from uvms_ocp.functions.kernels.binding import bind_to
from uvms_ocp.functions.kernels.layout import view
from uvms_ocp.solvers.hierarchy.solution import Status
from uvms_ocp.solvers.hierarchy.tick import TickResult

Solved = tuple[int, np.ndarray, np.ndarray, float]
"""Code of the `Status`, residual (n_rows,) [m/s, rad/s], activity (n_activity,) [-], time [s] of the solver or of both."""
_STATUS_CODE = {status: code for code, status in enumerate(Status)}


def finish_in_c(whole: Any) -> Callable[[], Solved]:
    """On a `VelocityController`."""
    (run,) = bind_to(whole, (finish,))
    residual, activity = view(whole.residual), view(whole.activity)

    def call() -> Solved:
        begin = perf_counter()
        status = run(whole)
        return status, residual.copy(), activity.copy(), perf_counter() - begin

    return call


def finish_by(
    solve: Callable[[], TickResult], after: Callable[[], None], arrays: TickArrays, memory: Any
) -> Callable[[], Solved]:
    """By a solver that Python calls, on the arrays of a `TickMemory`."""

    def call() -> Solved:
        result = solve()
        arrays.solved[:], arrays.quantities[:] = result.v, result.extras[0]
        memory.usable = result.status.usable
        after()
        return _STATUS_CODE[result.status], result.residual, result.extras[1], result.solve_time

    return call
