"""Priority levels of linear velocity objectives, and their stacking.

`[rate]` is the unit of a row, `[velocity]` that of an entry of v; each may have its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked_dataclass, checked_on_failure
from uvms_ocp.codegen.elementwise import (
    Array as ArrayOrExpression,
    all_entries,
    interval_distance,
    logical_and,
    row_sums,
    where,
)
from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.display import FieldTable
from uvms_ocp.solvers.hierarchy import tolerances
from uvms_ocp.types import Array


@checked_dataclass(check=checked_on_failure, kw_only=False, eq=False, init=False, repr=False)
class Level(FieldTable):
    """Rows ``lower <= jacobian @ v <= upper`` of one priority; an equality has ``lower == upper``.

    Every field but ``jacobian`` may be omitted or given as a scalar for all rows; arrays are
    read-only.
    """

    jacobian: Array
    """(m, n) [rate/velocity] maps the generalized velocity to the rates of the rows."""
    lower: Array
    """(m,) [rate] smallest, default -inf."""
    upper: Array
    """(m,) [rate] largest, default +inf."""
    rate: Array
    """(m,) [rate] reference of ``Icat``, default 0 clipped into [lower, upper]."""
    activation: Array
    """(m,) weight in [0, 1] for ``Icat``, default 1 for equalities and where 0 is out of bounds,
    else 0.
    """
    gate: Array
    """(m,) 0 removes a row, 1 keeps it exactly, between see `widen_bounds`; default 1; read by the
    strict solvers.
    """
    name: str
    """Used in error messages only."""

    def __init__(
        self,
        *,
        jacobian: ArrayLike,
        lower: ArrayLike = -np.inf,
        upper: ArrayLike = np.inf,
        rate: ArrayLike | None = None,
        activation: ArrayLike | None = None,
        gate: ArrayLike = 1.0,
        name: str = "",
    ) -> None:
        """Check and store jacobian (m, n) [rate/velocity]; lower, upper and rate () or (m,) [rate];
        activation and gate () or (m,).

        Raises `InvalidInput` naming the level and the field that is wrong.
        """
        J = _numbers(name, "jacobian", jacobian)
        if J.ndim != 2 or J.shape[1] == 0:
            raise InvalidInput(
                f"{_label(name, 'jacobian')} has shape {J.shape}; give (m, n) with n >= 1"
            )
        if not np.isfinite(J).all():
            raise InvalidInput(
                f"{_label(name, 'jacobian')} contains an infinite value; give finite numbers"
            )
        m = len(J)
        low = _rows(name, "lower", lower, m)
        up = _rows(name, "upper", upper, m)
        _check_order(name, low, up)
        neutral_rate = np.clip(np.zeros(m), low, up)
        needs_action = (neutral_rate != 0.0) | (low == up)
        if rate is None:
            rates = neutral_rate
        else:
            rates = _finite(name, "rate", rate, m)
        if activation is None:
            activations = np.where(needs_action, 1.0, 0.0)
        else:
            activations = _fraction(name, "activation", activation, m)
        fields = {
            "jacobian": J,
            "lower": low,
            "upper": up,
            "rate": rates,
            "activation": activations,
            "gate": _fraction(name, "gate", gate, m),
        }
        for field, value in fields.items():
            value.flags.writeable = False
            object.__setattr__(self, field, value)
        object.__setattr__(self, "name", name)

    @property
    def n_rows(self) -> int:
        """Number m of rows."""
        return int(self.jacobian.shape[0])

    @property
    def n_velocities(self) -> int:
        """Number n of velocities."""
        return int(self.jacobian.shape[1])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Stack:
    """All levels on top of each other, M rows in total."""

    jacobian: Array
    """(M, n) [rate/velocity] Jacobian."""
    lower: Array
    """(M,) [rate] lower bounds."""
    upper: Array
    """(M,) [rate] upper bounds."""
    rate: Array
    """(M,) [rate] desired rates."""
    activation: Array
    """(M,) activations."""
    gate: Array
    """(M,) gates."""
    sizes: tuple[int, ...]
    """Rows of each level; their sum is M."""


def stack(levels: Sequence[Level]) -> Stack:
    """Stack the levels in their order. Raises `InvalidInput` where there are none or their numbers
    of columns differ.
    """
    if not levels:
        raise InvalidInput(
            "levels is empty; give at least one Level, its columns tell the number of velocities"
        )
    n = levels[0].n_velocities
    for index, level in enumerate(levels):
        if level.n_velocities != n:
            mismatch = (
                f"{_label(level.name, 'jacobian')} (number {index}) has {level.n_velocities}"
                " columns"
            )
            raise InvalidInput(f"{mismatch}; the first level has {n}, give all levels the same")
    rows = ("jacobian", "lower", "upper", "rate", "activation", "gate")
    stacked = dict[str, Array]()
    for name in rows:
        stacked[name] = np.concatenate([getattr(level, name) for level in levels])
    return Stack(**stacked, sizes=tuple(level.n_rows for level in levels))


def row_slices(sizes: Sequence[int]) -> Iterator[slice]:
    """Yield the rows of each level in the stack."""
    start = 0
    for size in sizes:
        yield slice(start, start + size)
        start += size


def _label(name: str, field: str) -> str:
    if name:
        return f"level {name!r}: {field}"
    return f"level: {field}"


def _numbers(name: str, field: str, value: ArrayLike) -> Array:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidInput(
            f"{_label(name, field)} is not numeric; give an array of numbers"
        ) from None
    if np.isnan(array).any():
        raise InvalidInput(f"{_label(name, field)} contains NaN; give numbers")
    return array


def _rows(name: str, field: str, value: ArrayLike, m: int) -> Array:
    array = _numbers(name, field, value)
    if array.ndim > 1 or (array.ndim == 1 and array.shape != (m,)):
        raise InvalidInput(
            f"{_label(name, field)} has shape {array.shape}; give a scalar or ({m},)"
        )
    return np.array(np.broadcast_to(array, m))


def _finite(name: str, field: str, value: ArrayLike, m: int) -> Array:
    array = _rows(name, field, value, m)
    if not np.isfinite(array).all():
        raise InvalidInput(f"{_label(name, field)} contains an infinite value; give finite numbers")
    return array


def _fraction(name: str, field: str, value: ArrayLike, m: int) -> Array:
    array = _rows(name, field, value, m)
    if ((array < 0.0) | (array > 1.0)).any():
        raise InvalidInput(
            f"{_label(name, field)} spans [{array.min():g}, {array.max():g}]; give values in [0, 1]"
        )
    return array


def _check_order(name: str, lower: Array, upper: Array) -> None:
    # A bound of +inf below, or -inf above, has no rate that could satisfy it.
    wrong = (lower > upper) | (lower == np.inf) | (upper == -np.inf)
    if wrong.any():
        row = int(np.argmax(wrong))
        bounds = (
            f"{_label(name, 'lower')}[{row}] = {lower[row]:g} and upper[{row}] = {upper[row]:g}"
        )
        raise InvalidInput(f"{bounds}; give lower <= upper, and infinity only outwards")


def is_valid(
    J: ArrayOrExpression,
    lower: ArrayOrExpression,
    upper: ArrayOrExpression,
    gate: ArrayOrExpression,
) -> ArrayOrExpression:
    """Check that a solver can take the rows: J of sensible size, an interval for every row, gates
    in [0, 1]; no NaN.

    J (M, n) [rate/velocity]; lower and upper (M,) [rate]; gate (M,).
    """
    # Comparisons with NaN are false.
    ordered = logical_and(lower <= upper, logical_and(lower < np.inf, upper > -np.inf))
    gated = logical_and(gate >= 0.0, gate <= 1.0)
    return logical_and(
        all_entries(abs(J) < tolerances.LARGEST), all_entries(logical_and(ordered, gated))
    )


def widen_bounds(
    J: ArrayOrExpression,
    lower: ArrayOrExpression,
    upper: ArrayOrExpression,
    gate: ArrayOrExpression,
    reach: ArrayOrExpression | None = None,
) -> tuple[ArrayOrExpression, ArrayOrExpression]:
    """Widen bounds (M,) [rate], which leave to infinity as the gate goes from 1 to 0; scaling.c is
    the twin in C.

    What a gate g means, for `Level`, missions, the controller and what is exported from it:

    - 1 keeps the row as it is, 0 removes it.
    - Between, both bounds are wider by ``sqrt((1 - g) / g)`` times the range of the row. The row
      keeps its rank, but it is indifferent to what lies within that band. The band is all that the
      row can do, and more, as g goes to 0: the limit is the problem without the row, and by then v
      does not change any more. Along a cosine bell in time the band opens and closes at a steady
      pace.
    - The range is ``sum |J_row|``, that of J v for |v| <= 1, where `reach` is not given; in the
      controller it is what the limits let one tick change, so that accelerations grow and fade.

    A fractional gate that is held is a tolerance, not a weight: weights do not move the optimum of
    a strict hierarchy. A gate scales the activation for `Icat`, which weighs.

    J (M, n) [rate/velocity]; lower and upper (M,) [rate]; gate (M,); reach (M,) [rate]: finite
    range of each row, ``sum |J_row|`` where it is not given.
    """
    removed = gate <= 0.0
    gate = where(removed, 1.0, gate)
    if reach is None:
        reach = row_sums(abs(J))
    # Two roots: the quotient of the smallest gates is infinite, and 0 times that is not a number.
    width = reach * ((1.0 - gate) ** 0.5 / gate**0.5)
    return where(removed, -np.inf, lower - width), where(removed, np.inf, upper + width)


def residual(
    J: ArrayOrExpression,
    v: ArrayOrExpression,
    lower: ArrayOrExpression,
    upper: ArrayOrExpression,
    gate: ArrayOrExpression,
) -> ArrayOrExpression:
    """Return the signed distance (M,) [rate] of ``J v`` to [lower, upper], 0 where the gate is 0.

    J (M, n) [rate/velocity]; v (n,) [velocity]; lower and upper (M,) [rate]; gate (M,).
    """
    return where(gate > 0.0, interval_distance(J @ v, lower, upper), 0.0)
