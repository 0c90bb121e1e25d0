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

from uvms_ocp.identification.estimates import ProfilePenalty, SearchPoint
from uvms_ocp.identification.fit import FitContext
from uvms_ocp.identification.identified_numbers import (
    INTERVAL,
    IdentifiedNumber,
    number_of,
)
from uvms_ocp.identification.normal_equations import NormalEquations

_FARTHEST = 4  # [standard errors] beyond which an interval is called open
_SOFTNESS = 0.05  # [standard errors] deviation of the penalty that holds a number
_STEPS = 3  # Gauss-Newton steps, of which the first goes nearly all of the way
_DAMPING = 1e-9  # damping of a search that begins near its end
_TOLERANCE = 1e-3  # change of the deviance at which a search ends
_PROMISE_ERROR = 0.1  # share of a deviance by which it may miss what a step has promised
_END_DIFFERENCE = 0.2  # share of the half width, from which on ends are said to differ


def profiles(
    fitted: FitContext,
    numbers: Sequence[IdentifiedNumber],
    inflation: float = 1.0,
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[Profile]:
    """Yield the profile likelihood of every determined number.

    inflation: number of samples that miss alike, as for the numbers. progress gets a line for each.
    A number that follows from a single unknown, as one before it does, has the same profile and is
    left out. A profile takes a simulation of all recordings for each value at which the number is
    held, and a search where that shows that all is not linear.
    """
    inflated = fitted.inflated(inflation)
    determined = [number for number in numbers if number.determined]
    profiled = list(_distinct(inflated, determined))
    if not profiled:
        return
    # The optimum itself: searches end a little beside it, which deviances would show.
    problem = inflated.problem()
    estimate = fitted.estimate
    optimum = problem.solve(
        problem.resumed(estimate), tolerance=_TOLERANCE / max(estimate.cost, 1.0), damping=_DAMPING
    )
    point = problem.resumed(optimum)
    best = _Optimum(inflated, optimum.cost, point, problem.blocks(point))
    for k, number in enumerate(profiled, start=1):
        progress(f"profile {k} of {len(profiled)}: {number.name}")
        yield _profile(best, number)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Profile:
    """Profile likelihood of one number."""

    number: IdentifiedNumber
    """Number that is profiled, with its standard error."""
    values: np.ndarray
    """(k,) [unit] values at which the number was held, increasing."""
    roots: np.ndarray
    """(k,) signed roots of the deviance at these values."""
    interval: tuple[float, float]
    """[unit] interval that holds the number with 95 %, by the profile; infinite, or 0, where the
    profile does not close.
    """

    @property
    def differs(self) -> bool:
        """True if an end differs from that of the interval by standard errors."""
        linear = _coordinates(self.number, self.number.interval)
        profiled = _coordinates(self.number, self.interval)
        half_width = (linear[1] - linear[0]) / 2
        return bool(np.abs(profiled - linear).max() > _END_DIFFERENCE * half_width)


@dataclass(frozen=True, slots=True, eq=False)
class _Optimum:
    """Optimum of the cost, at which profiles begin."""

    inflated: FitContext
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


def _distinct(
    fitted: FitContext, numbers: Sequence[IdentifiedNumber]
) -> Iterator[IdentifiedNumber]:
    """Yield the numbers but for those of a single unknown that a number before them follows from."""
    profiled_unknowns: set[int] = set()
    for number in numbers:
        _, slope = number_of(fitted.vehicle, number)(fitted.estimate.shared)
        unknowns = np.flatnonzero(slope)
        if len(unknowns) > 1 or unknowns[0] not in profiled_unknowns:
            yield number
        if len(unknowns) == 1:
            profiled_unknowns.update(unknowns)


def _profile(best: _Optimum, identified: IdentifiedNumber) -> Profile:
    """Compute the profile of a number, in its logarithm where it is positive."""
    number = number_of(best.inflated.vehicle, identified)
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
    best: _Optimum,
    middle: _HeldFit,
    number: Callable[[np.ndarray], tuple[float, np.ndarray]],
    step: float,
) -> list[_HeldFit]:
    """Hold the number one and two standard errors away, and on until the interval closes."""
    fits = []
    last = middle
    for k in range(1, _FARTHEST + 1):
        penalty = ProfilePenalty(
            number=number, target=middle.place + k * step, sigma=_SOFTNESS * abs(step)
        )
        last = _held(best, last, penalty, k)
        fits.append(last)
        if k > 1 and abs(last.root) > INTERVAL:
            break
    return fits


def _held(best: _Optimum, nearest: _HeldFit, penalty: ProfilePenalty, k: int) -> _HeldFit:
    """Hold the number k standard errors away: by one step from the optimum if its cost is as
    predicted, else by more steps, or a search from the nearest fit.
    """
    problem = best.inflated.problem(penalty)
    point, cost = problem.stepped(best.point, best.blocks)
    gain = 2.0 * (cost - penalty.cost(point.shared) - best.cost) - k**2
    share = _PROMISE_ERROR * k**2
    for _ in range(_STEPS):
        if abs(gain) < share:
            return _held_fit(best, penalty, point, cost)
        next_point, next_cost = problem.stepped(point)
        if not next_cost <= cost:
            break
        gain = 2.0 * (cost - next_cost)
        point = next_point
        cost = next_cost
    estimate = problem.solve(
        nearest.point, tolerance=_TOLERANCE / max(best.cost, 1.0), damping=_DAMPING
    )
    return _held_fit(best, penalty, problem.resumed(estimate), estimate.cost)


def _held_fit(best: _Optimum, penalty: ProfilePenalty, point: SearchPoint, cost: float) -> _HeldFit:
    """Return the fit at a point, with the signed root of its deviance."""
    deviance = 2.0 * (cost - penalty.cost(point.shared) - best.cost)
    place, _ = penalty.number(point.shared)
    optimal_place, _ = penalty.number(best.point.shared)
    side = np.sign(penalty.target - optimal_place)
    root = float(side * np.sqrt(max(deviance, 0.0)))
    return _HeldFit(place, root, point)


def _crossing(places: np.ndarray, roots: np.ndarray, root: float) -> float:
    """Interpolate the place at which the signed root of the deviance is `root`; infinite where it
    lies beyond the places that were tried.
    """
    for k, (before, after) in enumerate(pairwise(roots - root)):
        if before <= 0.0 <= after and before < after:
            gap = places[k + 1] - places[k]
            return float(places[k] + gap * before / (before - after))
    return float(np.copysign(np.inf, root))


def _coordinates(number: IdentifiedNumber, ends: tuple[float, float]) -> np.ndarray:
    """Return the ends of an interval (2,), as logarithms where the number is positive."""
    with np.errstate(divide="ignore"):
        if number.positive:
            return np.log(np.array(ends))
        return np.array(ends)
