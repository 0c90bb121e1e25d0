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
from uvms_ocp.identification.methods.output_error import Estimate, Expansion
from uvms_ocp.identification.methods.point import Point
from uvms_ocp.identification.methods.pull import Pull

_FARTHEST = 4  # [-] standard errors: beyond it an interval is called open
_SOFT = 0.05  # [-] of a standard error, by which a number is held
_STEPS, _DAMPING = 3, 1e-9  # of Gauss and Newton, where one is nearly all of the way
_EXACT = 1e-3  # of a deviance
_KEPT = 0.1  # of a deviance, by which it may miss what a step has promised
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

    @property
    def differs(self) -> bool:
        """Whether an end is elsewhere than standard errors say."""
        told = [_line(self.number, ends) for ends in (self.number.interval, self.interval)]
        return bool(np.abs(told[1] - told[0]).max() > _OTHER * (told[0][1] - told[0][0]) / 2)


@dataclass(frozen=True, slots=True, eq=False)
class _Best:
    """Where the cost is lowest."""

    wide: Fitted
    cost: float
    expansion: Expansion


@dataclass(frozen=True, slots=True, eq=False)
class _Held:
    """Where a search has ended with a number held."""

    place: float
    """[unit, or its logarithm where it is positive]"""
    root: float
    point: Point


def profiles(
    fitted: Fitted, told: Sequence[Number], together: float = 1.0, tell: Callable[[str], None] = lambda _: None
) -> Iterator[Profile]:
    """Of those of the numbers that are determined. together: [-] samples that miss alike, by which they were told.

    tell is told of each in turn. A number that follows from one before it alone has the same profile and is left out. One takes
    a simulation of all recordings for each value at which it is held, and a search where that shows that all is not linear.
    """
    wide = fitted.widened(together)
    chosen = list(_distinct(wide, [one for one in told if one.determined]))
    if not chosen:
        return
    best = _best(wide, fitted.estimate)
    for k, one in enumerate(chosen, start=1):
        tell(f"profile {k} of {len(chosen)}: {one.name}")
        yield _profile(best, one)


def _distinct(wide: Fitted, told: Sequence[Number]) -> Iterator[Number]:
    alone: set[int] = set()
    for one in told:
        unknowns = np.flatnonzero(number_of(wide.vehicle, one)(wide.estimate.shared)[1])
        if len(unknowns) > 1 or unknowns[0] not in alone:
            yield one
        alone.update(unknowns[:1] if len(unknowns) == 1 else ())


def _best(wide: Fitted, estimate: Estimate) -> _Best:
    """The optimum itself: searches end a little beside it, which deviances would show."""
    problem = wide.problem()
    found = problem.solve(problem.resumed(estimate), tolerance=_EXACT / max(estimate.cost, 1.0), damping=_DAMPING)
    return _Best(wide, found.cost, problem.expansion(problem.resumed(found)))


def _profile(best: _Best, one: Number) -> Profile:
    number, point = number_of(best.wide.vehicle, one), best.expansion.point
    sigma = one.sigma / one.value if one.positive else one.sigma
    middle = _Held(number(point.shared)[0], 0.0, point)
    below, above = (_side(best, middle, number, way * sigma) for way in (-1, 1))
    held = [*below[::-1], middle, *above]
    places, roots = (np.array([getattr(each, name) for each in held]) for name in ("place", "root"))
    ends = _crossing(places, roots, -INTERVAL), _crossing(places, roots, INTERVAL)
    values, interval = (_told(one, np.array(each)) for each in (places, ends))
    return Profile(number=one, values=values, roots=roots, interval=(float(interval[0]), float(interval[1])))


def _side(
    best: _Best, middle: _Held, number: Callable[[np.ndarray], tuple[float, np.ndarray]], step: float
) -> list[_Held]:
    """One and two standard errors away, and on until the interval closes."""
    found, last = [], middle
    for k in range(1, _FARTHEST + 1):
        pull = Pull(number=number, target=middle.place + k * step, sigma=_SOFT * abs(step))
        last = _held(best, last, pull, k)
        found.append(last)
        if k > 1 and abs(last.root) > INTERVAL:
            break
    return found


def _held(best: _Best, near: _Held, pull: Pull, k: int) -> _Held:
    """By one step from the optimum where its cost is what the step promises, by some more or a search where it is not."""
    problem = best.wide.problem(pull)
    point, cost = problem.stepped(best.expansion)
    gained, share = 2.0 * (cost - pull.cost(point.shared) - best.cost) - k**2, _KEPT * k**2
    for _ in range(_STEPS):
        if abs(gained) < share:
            return _found(best, pull, point, cost)
        after, lower = problem.stepped(problem.expansion(point))
        if not lower <= cost:
            break
        gained, point, cost = 2.0 * (cost - lower), after, lower
    found = problem.solve(near.point, tolerance=_EXACT / max(best.cost, 1.0), damping=_DAMPING)
    return _found(best, pull, problem.resumed(found), found.cost)


def _found(best: _Best, pull: Pull, point: Point, cost: float) -> _Held:
    deviance = 2.0 * (cost - pull.cost(point.shared) - best.cost)
    side = np.sign(pull.target - pull.number(best.expansion.point.shared)[0])
    return _Held(pull.number(point.shared)[0], float(side * np.sqrt(max(deviance, 0.0))), point)


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
