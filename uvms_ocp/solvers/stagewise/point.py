"""Where an interior point is, and how it ends."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum

import numpy as np

from uvms_ocp.arrays import Array, Mask
from uvms_ocp.solvers.stagewise.solution import KktResidual, StageQpStatus, kkt_residual


class Start(IntEnum):
    """What a run makes of the point that it is given."""

    EQUALITIES = 0
    """Its z is where the optimum without inequalities is sought, from which the run starts."""
    WARM = 1
    """z, costates and multipliers, those of all rows in y, are near the optimum."""
    COLD = 2
    """The run starts from z."""
    ACTIVE = 3
    """The optimum without inequalities is all that is sought."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Point:
    """A point, or a direction. Rows M are those of constraints, then the variables; sides (2, M) the lower and the upper ones."""

    z: Array
    """(n,) [unit of z] variables."""
    costate: Array
    """(n_x,) [1/unit of x]"""
    y: Array
    """(M,) [1/unit of the row] multipliers of equalities."""
    s: Array
    """(2, M) [unit of the row] what is left to each bound."""
    multiplier: Array
    """(2, M) [1/unit of the row] >= 0."""
    e: Array
    """(2, M) [unit of the row] by how much elastic rows are missed."""
    f: Array
    """(2, M) [1/unit of the row] multipliers of e >= 0."""

    def moved(self, step: Point, share: float) -> Point:
        """By a share [-] of a step."""
        return Point(**{own.name: getattr(self, own.name) + share * getattr(step, own.name) for own in fields(self)})

    def row_multipliers(self) -> Array:
        """(M,) [1/unit of the row] positive at an upper bound."""
        return np.asarray(self.y + self.multiplier[1] - self.multiplier[0])

    def of_rows(self, rows: Array) -> Point:
        """With those rows numbered `rows` (m,) [-] alone."""
        sides = {name: getattr(self, name)[:, rows] for name in ("s", "multiplier", "e", "f")}
        return Point(z=self.z, costate=self.costate, y=self.y[rows], **sides)

    def flat(self) -> Array:
        """All of it in one array."""
        return np.concatenate([getattr(self, own.name).ravel() for own in fields(self)])


def point_of(flat: Array, n: int, n_x: int) -> Point:
    """The point in one array, with n variables [-] and n_x states [-]; flat (n + n_x + 9 M,) [any]."""
    m = (len(flat) - n - n_x) // 9
    parts = flat[n + n_x :].reshape(9, m)
    s, multiplier, e, f = (parts[k : k + 2] for k in (1, 3, 5, 7))
    return Point(z=flat[:n], costate=flat[n : n + n_x], y=parts[0], s=s, multiplier=multiplier, e=e, f=f)


def resting(z: Array, n_x: int, m: int) -> Point:
    """At z (n,) [unit of z], with nothing else; n_x [-] states, m [-] rows."""
    return point_of(np.concatenate([z, np.zeros(n_x + 9 * m)]), len(z), n_x)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class End:
    """Of one run."""

    status: StageQpStatus
    """SOLVED, NOT_CONVEX, NOT_A_NUMBER, ITERATION_LIMIT, or UNBOUNDED where steps are, which proves nothing."""
    point: Point
    """The best."""
    value: Array
    """(M,) [unit of the row] of rows and variables."""
    held: Array
    """(n,) [1/unit of z] gradient along fixed variables, which their bounds take."""
    kkt: KktResidual
    """There."""
    worst: float
    """[-] the same, relative to the terms of each condition."""
    iterations: int
    """[-] factors."""
    approached: Mask | None = None
    """(2, M) sides of which less was left after the last step, by more than their multipliers fell; None without a step."""


def nothing(point: Point) -> End:
    """Of a run that was not made, at a point."""
    endless = kkt_residual(stationarity=np.inf, primal=np.inf, complementarity=np.inf)
    held, value = np.zeros_like(point.z), np.full_like(point.y, np.nan)
    return End(
        status=StageQpStatus.NOT_A_NUMBER, point=point, value=value, held=held, kkt=endless, worst=np.inf, iterations=0
    )
