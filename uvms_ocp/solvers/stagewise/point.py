"""Where an interior point is, and by how much the optimality conditions fail there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.arrays import Array
from uvms_ocp.solvers.stagewise.solution import KktResidual

_SHARPER = 1e3  # a bound that only just binds is missed by the root of what is left of complementarity


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Point:
    """Where an iteration is, or a direction."""

    z: Array
    """(n,) variables."""
    costate: Array
    """(n_x,)"""
    y: Array
    """(M,) multipliers of equalities."""
    s: Array
    """(2, M) what is left to each bound."""
    multiplier: Array
    """(2, M) >= 0."""
    e: Array
    """(2, M) by how much elastic rows are missed."""
    f: Array
    """(2, M) multipliers of e >= 0."""

    def moved(self, step: Point, share: float) -> Point:
        return Point(**{name: getattr(self, name) + share * getattr(step, name) for name in self.__dataclass_fields__})


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Residuals:
    """By how much the conditions fail at a point."""

    grad: Array
    defect: Array
    value: Array
    row: Array
    equal: Array
    dual: Array
    kkt: KktResidual
    scale: tuple[float, float]
    """Of gradients and of variables."""
    held: Array
    """(n,) gradient along fixed variables, which their bounds take."""

    def worst(self) -> float:
        """Relative to the scales."""
        gradient, variable = self.scale
        complementarity = _SHARPER * self.kkt.complementarity / (gradient * variable)
        return max(self.kkt.stationarity / gradient, self.kkt.primal / variable, complementarity)


def resting(z: Array, n_x: int, m: int) -> Point:
    nothing = np.zeros((2, m))
    return Point(z=z, costate=np.zeros(n_x), y=np.zeros(m), s=nothing, multiplier=nothing, e=nothing, f=nothing)


def largest_of(a: Array) -> float:
    return float(np.abs(a).max(initial=0.0))
