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
    """(n,) [N] largest thrust."""
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


def prepare_minimum_power(power: PowerMemory) -> None:
    """Prepare the inverse and the null space of the thruster matrix, which serve every wrench."""
    exponent = 1.0
    for i in range(power.count):
        power.largest[i] = max(power.largest[i], _SMALLEST)
        power.quadratic[i] = power.factor[i] * math.exp(
            (power.exponent[i] - 2.0) * math.log(power.largest[i])
        )
        exponent = max(exponent, power.exponent[i])
    power.stretch = min(1.8, 0.9 / max(exponent - 1.0, 1e-9))
    for k in range(len(power.matrix)):
        _invert(power, k)
    _find_spare(power)


def minimum_power(power: PowerMemory, wrench: Vector, thrust: Vector) -> None:
    """Find the thrust (n,) [N] for a wrench (6,) [N, N m]: that of the inverse, moved in the null
    space of the matrix.
    """
    for i in range(power.count):
        thrust[i] = bounded_least_squares.dot(power.inverse[i], wrench, len(power.matrix))
    for _ in range(_STEPS if power.n_spare > 0 else 0):
        _reduce_power(power, thrust)


def majorizing_weight(factor: float, exponent: float, largest: float, thrust: float) -> float:
    """Return the weight [W/N^2] of the parabola that has the slope of the power ``factor
    |T|^exponent`` at a thrust T [N].

    factor [W/N^exponent]; exponent; largest [N] thrust.
    """
    size = max(thrust * thrust + (SMALL * largest) * (SMALL * largest), _SMALLEST)
    if exponent == _USUAL:
        return 0.5 * factor * exponent / math.sqrt(math.sqrt(size))
    return 0.5 * factor * exponent * math.exp((0.5 * exponent - 1.0) * math.log(size))


def _invert(power: PowerMemory, k: int) -> None:
    """Write column k of the inverse."""
    for row in range(len(power.matrix)):
        power.inner.b[row] = 1.0 if row == k else 0.0
        for i in range(power.count):
            power.inner.W[row][i] = (
                power.wrench_weight[row] * power.matrix[row][i] / math.sqrt(power.quadratic[i])
            )
    bounded_least_squares.least_norm(power.inner, len(power.matrix), power.count)
    for i in range(power.count):
        value = power.inner.y[i] * power.wrench_weight[k] / math.sqrt(power.quadratic[i])
        power.inverse[i][k] = value if abs(value) > _ROUNDING else 0.0


def _find_spare(power: PowerMemory) -> None:
    """Choose thrusters one by one, always that of which most is neither in the rows of the matrix
    nor spare yet.
    """
    for row in range(len(power.matrix)):
        power.inner.W[row][: power.count] = power.matrix[row][: power.count]
    rank = bounded_least_squares.row_space(power.inner, len(power.matrix), power.count)
    power.n_spare = 0
    while power.n_spare < power.count - rank:
        best = 0
        largest_rest = -1.0
        for i in range(power.count):
            rest = _rest(power, rank, i)
            if rest > largest_rest:
                best = i
                largest_rest = rest
        _add_spare(power, rank, best)


def _rest(power: PowerMemory, rank: int, i: int) -> float:
    rest = 1.0
    for k in range(rank):
        rest -= power.inner.basis[k][i] * power.inner.basis[k][i]
    for k in range(power.n_spare):
        rest -= power.spare[k][i] * power.spare[k][i]
    return rest


def _add_spare(power: PowerMemory, rank: int, start: int) -> None:
    new = power.spare[power.n_spare]
    for i in range(power.count):
        new[i] = 1.0 if i == start else 0.0
    for _ in range(2):  # to the last bit
        for k in range(rank):
            _take_from(new, power.inner.basis[k], power.count)
        for k in range(power.n_spare):
            _take_from(new, power.spare[k], power.count)
    size = math.sqrt(bounded_least_squares.dot(new, new, power.count))
    for i in range(power.count):
        new[i] = new[i] / size if abs(new[i]) > _ROUNDING else 0.0
    power.n_spare += 1


def _take_from(x: Vector, direction: Vector, n: int) -> None:
    along = bounded_least_squares.dot(x, direction, n)
    for i in range(n):
        x[i] -= along * direction[i]


def _reduce_power(power: PowerMemory, thrust: Vector) -> None:
    """Move the thrust by one step to less power."""
    weight = zeros(len(power.factor))
    for i in range(power.count):
        weight[i] = majorizing_weight(
            power.factor[i], power.exponent[i], power.largest[i], thrust[i]
        )
    for k in range(power.n_spare):
        power.inner.y[k] = _weighted(power.spare[k], weight, thrust, power.count)
        for j in range(k + 1):
            power.inner.K[k][j] = _weighted(power.spare[k], weight, power.spare[j], power.count)
    bounded_least_squares.solve_positive(power.inner, power.n_spare)
    for k in range(power.n_spare):
        for i in range(power.count):
            thrust[i] -= power.stretch * power.spare[k][i] * power.inner.y[k]


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
    """(n,) [N] thrust of least power for the wrench, limits aside."""
    within: Annotated[Vector, Sized("n")]
    """(n,) [N] inside the limits, dead zones aside."""
    thrust: Annotated[Vector, Sized("n")]
    """(n,) [N] thrust for the wrench, inside the limits and outside the dead zones."""


def limited_thrust(allocation: LimitedThrustMemory) -> bool:
    """Find the thrust for the wrench; return whether the limits keep the wrench from being reached."""
    n = allocation.problem.columns
    inside = True
    for i in range(n):
        allocation.thrust[i] = allocation.unbounded[i]
        inside = inside and allocation.lower[i] <= allocation.unbounded[i] <= allocation.upper[i]
    if not inside:
        _bounded(allocation)
    saturated = not inside and _loses(allocation)
    allocation.within[:n] = allocation.thrust[:n]
    _leave_dead_zones(allocation)
    return saturated


def _bounded(allocation: LimitedThrustMemory) -> None:
    """Find thrust inside the limits: of least quadratic power first, then step by step of least
    power.
    """
    n = allocation.problem.columns
    before = zeros(len(allocation.thrust))
    allocation.problem.weight[:n] = allocation.powers.quadratic[:n]
    allocation.problem.lower[:n] = allocation.lower[:n]
    allocation.problem.upper[:n] = allocation.upper[:n]
    _solve(allocation, False)
    for _ in range(_REWEIGHTINGS if allocation.powers.n_spare > 0 else 0):
        before[:n] = allocation.thrust[:n]
        _touch(allocation)
        _solve(allocation, True)
        moved = 0.0
        largest_thrust = 0.0
        for i in range(n):
            moved = max(moved, abs(allocation.thrust[i] - before[i]))
            largest_thrust = max(largest_thrust, allocation.powers.largest[i])
        if moved < _SETTLED * largest_thrust:
            break


def _touch(allocation: LimitedThrustMemory) -> None:
    for i in range(allocation.problem.columns):
        allocation.problem.weight[i] = majorizing_weight(
            allocation.powers.factor[i],
            allocation.powers.exponent[i],
            allocation.powers.largest[i],
            allocation.thrust[i],
        )


def _solve(allocation: LimitedThrustMemory, started: bool) -> None:
    """Solve for the thrust with the weights and limits in the problem; started: begin from the
    present thrust.
    """
    n = allocation.problem.columns
    for k in range(allocation.problem.rows):
        allocation.problem.b[k] = allocation.powers.wrench_weight[k] * allocation.wrench[k]
        for i in range(n):
            allocation.problem.A[k][i] = (
                allocation.powers.wrench_weight[k] * allocation.powers.matrix[k][i]
            )
    allocation.problem.x[:n] = allocation.thrust[:n]
    allocation.problem.started = started
    bounded_least_squares.solve_bounded(allocation.problem)
    allocation.thrust[:n] = allocation.problem.x[:n]


def _loses(allocation: LimitedThrustMemory) -> bool:
    """Return whether the wrench is another one than that of the unbounded thrust."""
    lost = 0.0
    required = 0.0
    for k in range(allocation.problem.rows):
        difference = 0.0
        total = 0.0
        for i in range(allocation.problem.columns):
            difference += allocation.powers.matrix[k][i] * (
                allocation.thrust[i] - allocation.unbounded[i]
            )
            total += allocation.powers.matrix[k][i] * allocation.unbounded[i]
        difference *= allocation.powers.wrench_weight[k]
        total *= allocation.powers.wrench_weight[k]
        lost += difference * difference
        required += total * total
    return math.sqrt(lost) > _EXACT * math.sqrt(required)


def _leave_dead_zones(allocation: LimitedThrustMemory) -> None:
    """Round what lies inside a dead zone, and let the other thrusters make up for it."""
    n = allocation.problem.columns
    allocation.problem.lower[:n] = allocation.lower[:n]
    allocation.problem.upper[:n] = allocation.upper[:n]
    while _fix_inside_dead_zones(allocation):
        _touch(allocation)
        _solve(allocation, False)


def _fix_inside_dead_zones(allocation: LimitedThrustMemory) -> bool:
    """Fix thrust that is inside of a dead zone at the nearest that can be commanded; return whether
    there was any that was not yet fixed.
    """
    is_inside = False
    for i in range(allocation.problem.columns):
        size = abs(allocation.thrust[i])
        edge = allocation.dead_zone[i]
        if 0.0 < size < edge and allocation.problem.lower[i] < allocation.problem.upper[i]:
            nearest = min(
                max(math.copysign(edge, allocation.thrust[i]), allocation.lower[i]),
                allocation.upper[i],
            )
            if size > 0.5 * edge and abs(nearest) >= edge:
                rounded = nearest
            else:
                rounded = 0.0
            allocation.problem.lower[i] = rounded
            allocation.problem.upper[i] = rounded
            is_inside = True
    return is_inside
