"""Thrust for a wrench that limits or dead zones are in the way of, as a kernel."""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.control.force.least_power import Powers, touching
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector, zeros
from uvms_ocp.solvers.bounded_least_squares import BoundedProblem, solve_bounded

_REWEIGHTINGS = 3  # of the power at the limits; each divides what is left to save by four
_SETTLED = 1e-4  # share of the largest thrust
_EXACT = 1e-9  # relative loss of wrench that counts as none


class LimitedThrust(Layout):
    """Of an `Allocation`, whose fields are described there. Room for n thrusters, as many as `powers.count` are used."""

    powers: Powers
    problem: BoundedProblem
    lower: Annotated[Vector, Sized("n")]
    """(n,) [N]"""
    upper: Annotated[Vector, Sized("n")]
    """(n,) [N]"""
    dead_zone: Annotated[Vector, Sized("n")]
    """(n,) [N]"""
    wrench: Annotated[Vector, Sized("m")]
    """(6,) [N, N m] asked for."""
    unbounded: Annotated[Vector, Sized("n")]
    """(n,) [N] thrust of least power for it, limits aside."""
    thrust: Annotated[Vector, Sized("n")]
    """(n,) [N] the answer."""


def limit_thrust(p: LimitedThrust) -> bool:
    """Find the thrust; whether the limits keep the wrench from being reached."""
    n, inside = p.problem.columns, True
    for i in range(n):
        p.thrust[i] = p.unbounded[i]
        inside = inside and p.lower[i] <= p.unbounded[i] <= p.upper[i]
    if not inside:
        _bounded(p)
    saturated = not inside and _loses(p)
    _leave_dead_zones(p)
    return saturated


def _bounded(p: LimitedThrust) -> None:
    """Inside the limits: of least quadratic power, then step by step of least power."""
    n, before = p.problem.columns, zeros(len(p.thrust))
    for i in range(n):
        p.problem.weight[i] = p.powers.quadratic[i]
        p.problem.lower[i] = p.lower[i]
        p.problem.upper[i] = p.upper[i]
    _solve(p, False)
    for _ in range(_REWEIGHTINGS if p.powers.n_spare > 0 else 0):
        for i in range(n):
            before[i] = p.thrust[i]
        _touch(p)
        _solve(p, True)
        moved, most = 0.0, 0.0
        for i in range(n):
            moved = max(moved, abs(p.thrust[i] - before[i]))
            most = max(most, p.powers.largest[i])
        if moved < _SETTLED * most:
            break


def _touch(p: LimitedThrust) -> None:
    for i in range(p.problem.columns):
        p.problem.weight[i] = touching(p.powers.factor[i], p.powers.exponent[i], p.powers.largest[i], p.thrust[i])


def _solve(p: LimitedThrust, started: bool) -> None:
    """The thrust for the weights and limits in the problem; started: from the thrust that there is."""
    for k in range(p.problem.rows):
        p.problem.b[k] = p.powers.wrench_weight[k] * p.wrench[k]
        for i in range(p.problem.columns):
            p.problem.A[k][i] = p.powers.wrench_weight[k] * p.powers.matrix[k][i]
    for i in range(p.problem.columns):
        p.problem.x[i] = p.thrust[i]
    p.problem.started = started
    solve_bounded(p.problem)
    for i in range(p.problem.columns):
        p.thrust[i] = p.problem.x[i]


def _loses(p: LimitedThrust) -> bool:
    """Whether the wrench is another one than that of the unbounded thrust."""
    lost, wanted = 0.0, 0.0
    for k in range(p.problem.rows):
        difference, whole = 0.0, 0.0
        for i in range(p.problem.columns):
            difference += p.powers.matrix[k][i] * (p.thrust[i] - p.unbounded[i])
            whole += p.powers.matrix[k][i] * p.unbounded[i]
        difference *= p.powers.wrench_weight[k]
        whole *= p.powers.wrench_weight[k]
        lost += difference * difference
        wanted += whole * whole
    return math.sqrt(lost) > _EXACT * math.sqrt(wanted)


def _leave_dead_zones(p: LimitedThrust) -> None:
    """Round what lies inside a dead zone, and let the other thrusters make up for it."""
    for i in range(p.problem.columns):
        p.problem.lower[i] = p.lower[i]
        p.problem.upper[i] = p.upper[i]
    while _fix_inside_dead_zones(p):
        _touch(p)
        _solve(p, False)


def _fix_inside_dead_zones(p: LimitedThrust) -> bool:
    """At the nearest thrust that can be commanded; whether there was any that was not yet fixed."""
    found = False
    for i in range(p.problem.columns):
        size, edge = abs(p.thrust[i]), p.dead_zone[i]
        if 0.0 < size < edge and p.problem.lower[i] < p.problem.upper[i]:
            nearest = min(max(math.copysign(edge, p.thrust[i]), p.lower[i]), p.upper[i])
            rounded = nearest if size > 0.5 * edge and abs(nearest) >= edge else 0.0
            p.problem.lower[i] = rounded
            p.problem.upper[i] = rounded
            found = True
    return found
