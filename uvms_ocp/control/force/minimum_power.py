"""Minimum-power thrust for a wrench, within limits and dead zones, as kernels.

Power is ``sum factor |T|^exponent``. Reweighted least squares: replacing ``|T|^p`` by a parabola that touches it and lies above
it (p <= 2) gives a linear step in the null space of the thruster matrix, which lowers the power; the step is stretched to nearly
Newton's, so that a few suffice.
"""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector, zeros
from uvms_ocp.solvers import bounded_least_squares

_STEPS = 6
_ROUNDING = 1e-14  # below it there is nothing
_SMALLEST = 2.2250738585072014e-308  # that is not rounded
_USUAL = 1.5  # exponent of power over thrust; two roots cost less than a power
SMALL = 1e-3
"""Share of the largest thrust below which |T|^p is rounded off, so that its curvature stays finite."""

_REWEIGHTINGS = 3  # of the power at the limits; each divides what is left to save by four
_SETTLED = 1e-4  # share of the largest thrust
_EXACT = 1e-9  # relative loss of wrench that counts as none


class PowerMemory(Layout):
    """Power of thrusters. Room for n of them, of which `count` are used."""

    count: int
    matrix: Annotated[list[Vector], Sized("m", "n")]
    """(6, n) [N/N, N m/N]"""
    wrench_weight: Annotated[Vector, Sized("m")]
    """(6,) [1/N, 1/(N m)]"""
    factor: Annotated[Vector, Sized("n")]
    """(n,) [W/N^exponent]"""
    exponent: Annotated[Vector, Sized("n")]
    """(n,) """
    largest: Annotated[Vector, Sized("n")]
    """(n,) [N] thrust."""
    # found by `prepare_minimum_power`
    quadratic: Annotated[Vector, Sized("n")]
    """(n,) [W/N^2] weights of the parabolas that meet the power at the largest thrust."""
    inverse: Annotated[list[Vector], Sized("n", "m")]
    """(n, 6) [N/N, N/(N m)] wrench to the thrust of least weighted squares without limits."""
    spare: Annotated[list[Vector], Sized("n", "n")]
    """(n_spare, n) orthonormal rows of thrust that gives no wrench."""
    n_spare: int
    stretch: float
    """Size of a step."""
    inner: bounded_least_squares.LeastSquaresRows


def prepare_minimum_power(p: PowerMemory) -> None:
    """Find what is the same for every wrench."""
    exponent = 1.0
    for i in range(p.count):
        p.largest[i] = max(p.largest[i], _SMALLEST)
        p.quadratic[i] = p.factor[i] * math.exp((p.exponent[i] - 2.0) * math.log(p.largest[i]))
        exponent = max(exponent, p.exponent[i])
    p.stretch = min(1.8, 0.9 / max(exponent - 1.0, 1e-9))
    for k in range(len(p.matrix)):
        _invert(p, k)
    _find_spare(p)


def minimum_power(p: PowerMemory, wrench: Vector, thrust: Vector) -> None:
    """Find the thrust (n,) [N] for a wrench (6,) [N, N m]: that of the inverse, moved in the null
    space of the matrix.
    """
    for i in range(p.count):
        thrust[i] = bounded_least_squares.dot(p.inverse[i], wrench, len(p.matrix))
    for _ in range(_STEPS if p.n_spare > 0 else 0):
        _reduce_power(p, thrust)


def majorizing_weight(factor: float, exponent: float, largest: float, thrust: float) -> float:
    """Weight [W/N^2] of the parabola that has the slope of the power ``factor |T|^exponent`` at a thrust T [N].

    factor [W/N^exponent]; exponent; largest [N] thrust.
    """
    size = max(thrust * thrust + (SMALL * largest) * (SMALL * largest), _SMALLEST)
    if exponent == _USUAL:
        return 0.5 * factor * exponent / math.sqrt(math.sqrt(size))
    return 0.5 * factor * exponent * math.exp((0.5 * exponent - 1.0) * math.log(size))


def _invert(p: PowerMemory, k: int) -> None:
    """Column k of the inverse."""
    for row in range(len(p.matrix)):
        p.inner.b[row] = 1.0 if row == k else 0.0
        for i in range(p.count):
            p.inner.W[row][i] = p.wrench_weight[row] * p.matrix[row][i] / math.sqrt(p.quadratic[i])
    bounded_least_squares.least_norm(p.inner, len(p.matrix), p.count)
    for i in range(p.count):
        value = p.inner.y[i] * p.wrench_weight[k] / math.sqrt(p.quadratic[i])
        p.inverse[i][k] = value if abs(value) > _ROUNDING else 0.0


def _find_spare(p: PowerMemory) -> None:
    """Choose thrusters one by one, always that of which most is neither in the rows of the matrix
    nor spare yet.
    """
    for row in range(len(p.matrix)):
        p.inner.W[row][: p.count] = p.matrix[row][: p.count]
    rank = bounded_least_squares.row_space(p.inner, len(p.matrix), p.count)
    p.n_spare = 0
    while p.n_spare < p.count - rank:
        best = 0
        largest_rest = -1.0
        for i in range(p.count):
            rest = _rest(p, rank, i)
            if rest > largest_rest:
                best = i
                largest_rest = rest
        _add_spare(p, rank, best)


def _rest(p: PowerMemory, rank: int, i: int) -> float:
    rest = 1.0
    for k in range(rank):
        rest -= p.inner.basis[k][i] * p.inner.basis[k][i]
    for k in range(p.n_spare):
        rest -= p.spare[k][i] * p.spare[k][i]
    return rest


def _add_spare(p: PowerMemory, rank: int, start: int) -> None:
    new = p.spare[p.n_spare]
    for i in range(p.count):
        new[i] = 1.0 if i == start else 0.0
    for _ in range(2):  # to the last bit
        for k in range(rank):
            _take_from(new, p.inner.basis[k], p.count)
        for k in range(p.n_spare):
            _take_from(new, p.spare[k], p.count)
    size = math.sqrt(bounded_least_squares.dot(new, new, p.count))
    for i in range(p.count):
        new[i] = new[i] / size if abs(new[i]) > _ROUNDING else 0.0
    p.n_spare += 1


def _take_from(x: Vector, direction: Vector, n: int) -> None:
    along = bounded_least_squares.dot(x, direction, n)
    for i in range(n):
        x[i] -= along * direction[i]


def _reduce_power(p: PowerMemory, thrust: Vector) -> None:
    """One step to less power."""
    weight = zeros(len(p.factor))
    for i in range(p.count):
        weight[i] = majorizing_weight(p.factor[i], p.exponent[i], p.largest[i], thrust[i])
    for k in range(p.n_spare):
        p.inner.y[k] = _weighted(p.spare[k], weight, thrust, p.count)
        for j in range(k + 1):
            p.inner.K[k][j] = _weighted(p.spare[k], weight, p.spare[j], p.count)
    bounded_least_squares.solve_positive(p.inner, p.n_spare)
    for k in range(p.n_spare):
        for i in range(p.count):
            thrust[i] -= p.stretch * p.spare[k][i] * p.inner.y[k]


def _weighted(x: Vector, weight: Vector, y: Vector, n: int) -> float:
    total = 0.0
    for i in range(n):
        total += x[i] * weight[i] * y[i]
    return total


# Thrust for a wrench that limits or dead zones are in the way of, as a kernel.


class LimitedThrustMemory(Layout):
    """Memory of bounded minimum-power allocation, with the fields of `Allocation`. Room for n
    thrusters.
    """

    powers: PowerMemory
    problem: bounded_least_squares.BoundedProblem
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
    within: Annotated[Vector, Sized("n")]
    """(n,) [N] inside the limits, dead zones aside."""
    thrust: Annotated[Vector, Sized("n")]
    """(n,) [N] the answer."""


def limited_thrust(p: LimitedThrustMemory) -> bool:
    """Find the thrust; whether the limits keep the wrench from being reached."""
    n = p.problem.columns
    inside = True
    for i in range(n):
        p.thrust[i] = p.unbounded[i]
        inside = inside and p.lower[i] <= p.unbounded[i] <= p.upper[i]
    if not inside:
        _bounded(p)
    saturated = not inside and _loses(p)
    p.within[:n] = p.thrust[:n]
    _leave_dead_zones(p)
    return saturated


def _bounded(p: LimitedThrustMemory) -> None:
    """Inside the limits: of least quadratic power, then step by step of least power."""
    n = p.problem.columns
    before = zeros(len(p.thrust))
    p.problem.weight[:n] = p.powers.quadratic[:n]
    p.problem.lower[:n] = p.lower[:n]
    p.problem.upper[:n] = p.upper[:n]
    _solve(p, False)
    for _ in range(_REWEIGHTINGS if p.powers.n_spare > 0 else 0):
        before[:n] = p.thrust[:n]
        _touch(p)
        _solve(p, True)
        moved = 0.0
        largest_thrust = 0.0
        for i in range(n):
            moved = max(moved, abs(p.thrust[i] - before[i]))
            largest_thrust = max(largest_thrust, p.powers.largest[i])
        if moved < _SETTLED * largest_thrust:
            break


def _touch(p: LimitedThrustMemory) -> None:
    for i in range(p.problem.columns):
        p.problem.weight[i] = majorizing_weight(
            p.powers.factor[i], p.powers.exponent[i], p.powers.largest[i], p.thrust[i]
        )


def _solve(p: LimitedThrustMemory, started: bool) -> None:
    """The thrust for the weights and limits in the problem; started: from the thrust that there
    is.
    """
    n = p.problem.columns
    for k in range(p.problem.rows):
        p.problem.b[k] = p.powers.wrench_weight[k] * p.wrench[k]
        for i in range(n):
            p.problem.A[k][i] = p.powers.wrench_weight[k] * p.powers.matrix[k][i]
    p.problem.x[:n] = p.thrust[:n]
    p.problem.started = started
    bounded_least_squares.solve_bounded(p.problem)
    p.thrust[:n] = p.problem.x[:n]


def _loses(p: LimitedThrustMemory) -> bool:
    """Return whether the wrench is another one than that of the unbounded thrust."""
    lost = 0.0
    required = 0.0
    for k in range(p.problem.rows):
        difference = 0.0
        total = 0.0
        for i in range(p.problem.columns):
            difference += p.powers.matrix[k][i] * (p.thrust[i] - p.unbounded[i])
            total += p.powers.matrix[k][i] * p.unbounded[i]
        difference *= p.powers.wrench_weight[k]
        total *= p.powers.wrench_weight[k]
        lost += difference * difference
        required += total * total
    return math.sqrt(lost) > _EXACT * math.sqrt(required)


def _leave_dead_zones(p: LimitedThrustMemory) -> None:
    """Round what lies inside a dead zone, and let the other thrusters make up for it."""
    n = p.problem.columns
    p.problem.lower[:n] = p.lower[:n]
    p.problem.upper[:n] = p.upper[:n]
    while _fix_inside_dead_zones(p):
        _touch(p)
        _solve(p, False)


def _fix_inside_dead_zones(p: LimitedThrustMemory) -> bool:
    """At the nearest thrust that can be commanded; whether there was any that was not yet fixed."""
    is_inside = False
    for i in range(p.problem.columns):
        size = abs(p.thrust[i])
        edge = p.dead_zone[i]
        if 0.0 < size < edge and p.problem.lower[i] < p.problem.upper[i]:
            nearest = min(max(math.copysign(edge, p.thrust[i]), p.lower[i]), p.upper[i])
            if size > 0.5 * edge and abs(nearest) >= edge:
                rounded = nearest
            else:
                rounded = 0.0
            p.problem.lower[i] = rounded
            p.problem.upper[i] = rounded
            is_inside = True
    return is_inside
