"""Profile likelihood of single numbers: intervals without the assumption that everything is linear.

A number is held at a value, and all else is fitted anew. The deviance of that fit, twice the cost
beyond the optimum's, gives the interval: its signed root is where a standard normal variable would
be. Where everything is linear it is a straight line, and this interval is the one of standard
errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from uvms_ocp.identification.fit import FitContext
from uvms_ocp.identification.identified_numbers import (
    INTERVAL,
    IdentifiedNumber,
    number_of,
)
from uvms_ocp.identification.normal_equations import NormalEquations
from uvms_ocp.identification.output_error import (
    ProfilePenalty,
    SearchPoint,
)

_FARTHEST = 4  # standard errors: beyond it an interval is called open
_SOFT = 0.05  # of a standard error, by which a number is held
# of Gauss and Newton, where one is nearly all of the way
_STEPS = 3
_DAMPING = 1e-9
_EXACT = 1e-3  # of a deviance
_KEPT = 0.1  # of a deviance, by which it may miss what a step has promised
_OTHER = 0.2  # of the half width, by which ends may be apart that are called equal


def profiles(
    fitted: FitContext,
    numbers: Sequence[IdentifiedNumber],
    inflation: float = 1.0,
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[Profile]:
    """Yield the profile likelihood of every determined number. inflation: samples that miss alike,
    as for the numbers.

    progress gets a line for each. A number that follows from one before it alone has the same
    profile and is left out. One takes a simulation of all recordings for each value at which it is
    held, and a search where that shows that all is not linear.
    """
    wide = fitted.inflated(inflation)
    chosen = list(_distinct(wide, [number for number in numbers if number.determined]))
    if not chosen:
        return
    # The optimum itself: searches end a little beside it, which deviances would show.
    problem = wide.problem()
    estimate = fitted.estimate
    optimum = problem.solve(
        problem.resumed(estimate), tolerance=_EXACT / max(estimate.cost, 1.0), damping=_DAMPING
    )
    point = problem.resumed(optimum)
    best = _Best(wide, optimum.cost, point, problem.blocks(point))
    for k, number in enumerate(chosen, start=1):
        progress(f"profile {k} of {len(chosen)}: {number.name}")
        yield _profile(best, number)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Profile:
    """Profile likelihood of one number."""

    number: IdentifiedNumber
    values: np.ndarray
    """(k,) [unit] at which it was held, increasing."""
    roots: np.ndarray
    """(k,) signed roots of the deviance there."""
    interval: tuple[float, float]
    """[unit] that holds it with 95 %, as the profile has it; infinite, or 0, where it does not
    close.
    """

    @property
    def differs(self) -> bool:
        """True if an end differs from that by standard errors."""
        lines = [_line(self.number, ends) for ends in (self.number.interval, self.interval)]
        return bool(np.abs(lines[1] - lines[0]).max() > _OTHER * (lines[0][1] - lines[0][0]) / 2)


@dataclass(frozen=True, slots=True, eq=False)
class _Best:
    """Optimum of the cost."""

    wide: FitContext
    """Fit with inflated variances."""
    cost: float
    """Half the weighted squares at the optimum."""
    point: SearchPoint
    blocks: list[NormalEquations]
    """Normal equations of each recording at the point."""


@dataclass(frozen=True, slots=True, eq=False)
class _HeldFit:
    """End of a search with a number held."""

    place: float
    """[unit, or its logarithm where it is positive] value of the number."""
    root: float
    """Signed root of the deviance."""
    point: SearchPoint


def _distinct(wide: FitContext, numbers: Sequence[IdentifiedNumber]) -> Iterator[IdentifiedNumber]:
    single: set[int] = set()
    for number in numbers:
        unknowns = np.flatnonzero(number_of(wide.vehicle, number)(wide.estimate.shared)[1])
        if len(unknowns) > 1 or unknowns[0] not in single:
            yield number
        if len(unknowns) == 1:
            single.update(unknowns)


def _profile(best: _Best, identified: IdentifiedNumber) -> Profile:
    number = number_of(best.wide.vehicle, identified)
    point = best.point
    sigma = identified.sigma
    if identified.positive:
        sigma /= identified.value
    middle = _HeldFit(number(point.shared)[0], 0.0, point)
    below = _side(best, middle, number, -sigma)
    above = _side(best, middle, number, sigma)
    fits = [*below[::-1], middle, *above]
    places = np.array([fit.place for fit in fits])
    roots = np.array([fit.root for fit in fits])
    ends = np.array([_crossing(places, roots, side) for side in (-INTERVAL, INTERVAL)])
    if identified.positive:
        places = np.exp(places)
        ends = np.exp(ends)

    return Profile(
        number=identified,
        values=places,
        roots=roots,
        interval=(float(ends[0]), float(ends[1])),
    )


def _side(
    best: _Best,
    middle: _HeldFit,
    number: Callable[[np.ndarray], tuple[float, np.ndarray]],
    step: float,
) -> list[_HeldFit]:
    """Hold the number one and two standard errors away, and on until the interval closes."""
    fits = []
    last = middle
    for k in range(1, _FARTHEST + 1):
        pull = ProfilePenalty(
            number=number, target=middle.place + k * step, sigma=_SOFT * abs(step)
        )
        last = _held(best, last, pull, k)
        fits.append(last)
        if k > 1 and abs(last.root) > INTERVAL:
            break
    return fits


def _held(best: _Best, nearest: _HeldFit, pull: ProfilePenalty, k: int) -> _HeldFit:
    """Hold the number by one step from the optimum if its cost is as predicted, else by more steps
    or a search.
    """
    problem = best.wide.problem(pull)
    point, cost = problem.stepped(best.point, best.blocks)
    gain = 2.0 * (cost - pull.cost(point.shared) - best.cost) - k**2
    share = _KEPT * k**2
    for _ in range(_STEPS):
        if abs(gain) < share:
            return _found(best, pull, point, cost)
        next_point, next_cost = problem.stepped(point)
        if not next_cost <= cost:
            break
        gain = 2.0 * (cost - next_cost)
        point = next_point
        cost = next_cost
    estimate = problem.solve(
        nearest.point, tolerance=_EXACT / max(best.cost, 1.0), damping=_DAMPING
    )
    return _found(best, pull, problem.resumed(estimate), estimate.cost)


def _found(best: _Best, pull: ProfilePenalty, point: SearchPoint, cost: float) -> _HeldFit:
    deviance = 2.0 * (cost - pull.cost(point.shared) - best.cost)
    side = np.sign(pull.target - pull.number(best.point.shared)[0])
    return _HeldFit(pull.number(point.shared)[0], float(side * np.sqrt(max(deviance, 0.0))), point)


def _crossing(places: np.ndarray, roots: np.ndarray, root: float) -> float:
    """Interpolate the place at which the signed root of the deviance is `root`; infinite where it
    lies beyond the places that were tried.
    """
    sides = roots - root
    for k, (a, b) in enumerate(pairwise(sides)):
        if a <= 0.0 <= b and a < b:
            return float(places[k] + (places[k + 1] - places[k]) * a / (a - b))
    return float(np.copysign(np.inf, root))


def _line(number: IdentifiedNumber, ends: tuple[float, float]) -> np.ndarray:
    with np.errstate(divide="ignore"):
        if number.positive:
            return np.log(np.array(ends))
        return np.array(ends)
