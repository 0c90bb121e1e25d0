"""How exactly a QP of stages is solved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.exceptions import InvalidInput

_MOST_ITERATIONS = 10_000


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StageQpOptions:
    """Raises `InvalidInput` for numbers that are not positive and finite, and more than 10,000 iterations."""

    tolerance: float = 1e-9
    """[-] of the KKT conditions, relative to the largest term in them."""
    max_iterations: int = 60
    """[-] factors of one run; a QP that one run does not solve takes two more."""
    warm_mu: float = 1e-6
    """[-] complementarity at a warm start, relative to the largest curvature: a squared distance to bounds."""
    cold_mu: float = 0.1
    """[-] complementarity at a cold start, relative to what missed bounds cost by curvature and gradient. With more of it QPs in
    which many bounds are reached take fewer factors, and those without a point are told later."""
    compiled: bool = True
    """False keeps to NumPy."""

    def __post_init__(self) -> None:
        for name in ("tolerance", "max_iterations", "warm_mu", "cold_mu"):
            if not 0 < getattr(self, name) < np.inf:
                raise InvalidInput(f"{name} = {getattr(self, name)}; give a finite value > 0")
        if self.max_iterations > _MOST_ITERATIONS:
            raise InvalidInput(f"max_iterations = {self.max_iterations}; give at most {_MOST_ITERATIONS}")


@dataclass(frozen=True, kw_only=True, slots=True)
class StageTolerances:
    """Numbers that C and NumPy share."""

    rounding: float = 4e-15
    """[-] pivot, relative to its diagonal entry, that may be rounding alone."""
    tiny: float = 1e-290
    """[-] pivot that is none."""
    indefinite: float = 1e-9
    """[-] negative pivot, relative to its diagonal entry, that is no rounding."""
    damped: float = 1e-8
    """[-] pivot, relative to its diagonal entry, that takes the place of rounding."""
    smallest_curvature: float = 1e-12
    """[-] of a diagonal entry that pivots are compared with, relative to the largest."""
    elasticity: float = 1e-7
    """[-] compliance of equalities in one step, relative to that of the stiffest variable; what it leaves, the next one takes."""
    side_elasticity: float = 1e-5
    """[-] that of inequalities, relative to the one of equalities."""
    slow: float = 1e-7
    """[-] curvature that steps of a second run reckon with in every direction, relative to gradient over variables."""
    phase_one: float = 1e-6
    """[-] curvature in phase one, beside a cost of 1 for what is missed."""
    to_boundary: float = 0.995
    """[-] share of the way to the nearest bound."""
    short_step: float = 0.1
    """[-] share of a step that the second order has spoilt."""
    floor: float = 1e-4
    """[-] complementarity aimed at, relative to the tolerance: less only loses digits."""
    sharper: float = 1e3
    """[-] of complementarity: a bound that only just binds is missed by the root of what is left of it."""
    least_size: float = 1e-3
    """[unit of z] variables below which a gradient is compared with the curvature."""
    counts: float = 1e-6
    """[-] multiplier, beside the largest, of a bound that is reached."""
    many_changes: int = 8
    """[-] of bounds that are held, more than which must fall from round to round."""
    vain_changes: int = 2
    """[-] rounds in which fewer do not."""
    most_corrections: int = 10
    """[-] of a solution without inequalities."""
    exact: float = 1e-5
    """[-] of the tolerance, down to which those corrections go on while they help."""
    finished: float = 1e-5
    """[-] tolerance above which what an interior point comes close to is not looked for: it keeps off the bounds."""
    sharp: float = 1e-2
    """[-] of the tolerance, by which a side must be missed to be held."""
    far: float = 0.5
    """[-] failure of all conditions from which the solution of a QP nearby is no start."""
    nearer: float = 1e2
    """[-] by which complementarity at a warm start is more where that is far, and less where it is not."""
    least_missed: float = 0.1
    """[unit of z] violation of bounds that a cold start reckons with."""
    stuck: float = 1e-7
    """[-] share of a step that leads nowhere."""
    hopeless: float = 1e6
    """[-] by which multipliers grow where there is no point."""
    inexact_tolerances: float = 1e3
    """[-] tolerances to which an optimum can still be used."""
    most_vain: int = 6
    """[-] iterations that bring such an optimum no nearer, after which it stays as it is."""
    most_high: int = 15
    """[-] iterations in which the violation does not fall, after which phase one is asked."""
    endless: float = 1e12
    """[unit of z] variables beyond which a cost falls without end."""


STAGE_TOLERANCES = StageTolerances()
