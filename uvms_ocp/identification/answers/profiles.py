"""How sure a number is, without the belief that all is linear: it is held, and all else is fitted anew.

The deviance of the best fit with a number held, twice the cost beyond the optimum's, is what an interval is made of: its signed
root is where a standard normal variable would be. Where everything is linear it is a straight line, and this interval is the
one of standard errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from uvms_ocp.identification.answers.fitted import Fitted
from uvms_ocp.identification.answers.numbers import INTERVAL, Number, number_of
from uvms_ocp.identification.methods.output_error import Estimate
from uvms_ocp.identification.methods.pull import Pull

_FARTHEST = 4  # [-] standard errors: beyond it an interval is called open
_SOFT = 0.05  # [-] of a standard error, by which a number is held
_ITERATIONS, _DAMPING = 4, 1e-9  # from the next point, where a step of Gauss and Newton is nearly all of the way
_EXACT = 1e-3  # of a deviance
_OTHER = 0.2  # of the half width, by which ends may be apart that are called equal


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Profile:
    """Of one number."""

    number: Number
    values: np.ndarray
    """(k,) [unit] at which it was held, increasing."""
    roots: np.ndarray
    """(k,) [-] signed roots of the deviance there."""
    interval: tuple[float, float]
    """[unit] that holds it with 95 %, as the profile has it; infinite, or 0, where it does not close."""
    fits: int
    """[-] that it took."""

    @property
    def differs(self) -> bool:
        """Whether an end is elsewhere than standard errors say."""
        told = [_line(self.number, ends) for ends in (self.number.interval, self.interval)]
        return bool(np.abs(told[1] - told[0]).max() > _OTHER * (told[0][1] - told[0][0]) / 2)


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """Where a search has ended with a number held."""

    place: float
    """[unit, or its logarithm where it is positive]"""
    root: float
    estimate: Estimate


def profiles(
    fitted: Fitted, told: Sequence[Number], together: float = 1.0, tell: Callable[[str], None] = lambda _: None
) -> Iterator[Profile]:
    """Of those of the numbers that are determined. together: [-] samples that miss alike, by which they were told.

    tell is told of each in turn. A number that follows from one before it alone has the same profile and is left out. One takes
    four searches of a few steps each, or more where its interval is wider than standard errors say.
    """
    wide = fitted.widened(together)
    chosen = list(_distinct(wide, [one for one in told if one.determined]))
    best = _resolved(wide, fitted.estimate) if chosen else fitted.estimate
    for k, one in enumerate(chosen, start=1):
        tell(f"profile {k} of {len(chosen)}: {one.name}")
        yield _profile(wide, best, one)


def _distinct(wide: Fitted, told: Sequence[Number]) -> Iterator[Number]:
    alone: set[int] = set()
    for one in told:
        unknowns = np.flatnonzero(number_of(wide.vehicle, one)(wide.estimate.shared)[1])
        if len(unknowns) > 1 or unknowns[0] not in alone:
            yield one
        alone.update(unknowns[:1] if len(unknowns) == 1 else ())


def _resolved(wide: Fitted, estimate: Estimate) -> Estimate:
    """The optimum itself: searches end a little beside it, which deviances would show."""
    problem = wide.problem()
    return problem.solve(problem.resumed(estimate), tolerance=_EXACT / max(estimate.cost, 1.0), damping=_DAMPING)


def _profile(wide: Fitted, best: Estimate, one: Number) -> Profile:
    number = number_of(wide.vehicle, one)
    sigma = one.sigma / one.value if one.positive else one.sigma
    middle = _Held(number(best.shared)[0], 0.0, best)
    below, above = (_side(wide, middle, number, way * sigma) for way in (-1, 1))
    held = [*below[::-1], middle, *above]
    places, roots = (np.array([getattr(each, name) for each in held]) for name in ("place", "root"))
    ends = _crossing(places, roots, -INTERVAL), _crossing(places, roots, INTERVAL)
    values, interval = (_told(one, np.array(each)) for each in (places, ends))
    fits = len(below) + len(above)
    return Profile(number=one, values=values, roots=roots, interval=(interval[0], interval[1]), fits=fits)


def _side(
    wide: Fitted, middle: _Held, number: Callable[[np.ndarray], tuple[float, np.ndarray]], step: float
) -> list[_Held]:
    """One and two standard errors away, and on until the interval closes."""
    found, last = [], middle
    for k in range(1, _FARTHEST + 1):
        pull = Pull(number=number, target=middle.place + k * step, sigma=_SOFT * abs(step))
        last = _held(wide, middle, last.estimate, pull)
        found.append(last)
        if k > 1 and abs(last.root) > INTERVAL:
            break
    return found


def _held(wide: Fitted, middle: _Held, near: Estimate, pull: Pull) -> _Held:
    problem, tolerance = wide.problem(pull), _EXACT / max(middle.estimate.cost, 1.0)
    found = problem.solve(problem.resumed(near), iterations=_ITERATIONS, tolerance=tolerance, damping=_DAMPING)
    place, _ = pull.number(found.shared)
    deviance = 2.0 * (found.cost - pull.cost(found.shared) - middle.estimate.cost)
    return _Held(place, float(np.sign(pull.target - middle.place) * np.sqrt(max(deviance, 0.0))), found)


def _crossing(places: np.ndarray, roots: np.ndarray, wanted: float) -> float:
    """The place where the root is `wanted`, between those that were looked at; infinite where it is beyond them."""
    sides = roots - wanted
    for k, (a, b) in enumerate(pairwise(sides)):
        if a <= 0.0 <= b and a < b:
            return float(places[k] + (places[k + 1] - places[k]) * a / (a - b))
    return float(np.copysign(np.inf, wanted))


def _told(one: Number, places: np.ndarray) -> np.ndarray:
    return np.asarray(np.exp(places) if one.positive else places)


def _line(one: Number, ends: tuple[float, float]) -> np.ndarray:
    with np.errstate(divide="ignore"):
        return np.log(np.array(ends)) if one.positive else np.array(ends)
