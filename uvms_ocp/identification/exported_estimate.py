"""Choose the numbers that a robot's file may hold: open ones are as they were declared, and all
others are fitted anew about them.

An unknown that recordings do not determine ends anywhere, often at next to nothing, and a vehicle
would fly with it. The others have taken its part where they were fitted with it: they are not kept
as they were either. What is next to nothing because the recordings say so, as drag that another one
takes the place of, stays so: as it was before it would contradict them. What no body in water has,
and nothing determines, is never exported: where the recordings contradict the declared value too,
there is no answer, as where nothing is determined at all.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.identification import parameters, uncertainty
from uvms_ocp.identification.estimates import Estimate, FitStatus
from uvms_ocp.identification.fit import FitContext
from uvms_ocp.identification.identified_numbers import (
    INTERVAL,
    IdentifiedNumber,
    slopes_of,
    values_of,
)

_OF_BODIES = ("mass", "added_mass", "volume")
"""Quantities that no body in water has next to none of."""
_FARTHEST = 100.0  # times the declared value, or part of it


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ExportedEstimate:
    """Estimate as it is exported to the robot's file."""

    estimate: Estimate
    kept: tuple[str, ...] = ()
    """Unknowns that are as they were declared, as ``added_mass surge``."""
    contradicted: tuple[str, ...] = ()
    """Unknowns that no body would have as they were found, and that the recordings contradict as they
    were declared; then there is no answer.
    """

    @property
    def advice(self) -> str:
        """What to do next."""
        if not self.contradicted:
            return self.estimate.status.advice
        return (
            f"{', '.join(self.contradicted)} would be what no body has, and the recordings contradict"
            " what was declared: look at mass, volume and inertia in the robot's file, and at thrust."
        )

    @property
    def usable(self) -> bool:
        """True if a file may be made of it: the search has converged, and something is determined."""
        return self.estimate.status is FitStatus.CONVERGED


def exported_estimate(
    fitted: FitContext, inflation: float, identified: Sequence[IdentifiedNumber]
) -> ExportedEstimate:
    """Hold undetermined numbers at their declared values where the recordings allow it, else one
    quantity after the other, and one number after the other.

    inflation: samples that miss alike, as `variance_inflation` finds. identified: all numbers of the
    fit.
    """
    shared = fitted.vehicle.shared
    estimate = fitted.estimate
    errors = uncertainty.standard_errors(fitted.vehicle, estimate, inflation)
    is_open = errors > uncertainty.DETERMINED
    is_held = np.zeros(len(is_open), dtype=bool)
    best = estimate
    if estimate.status is FitStatus.CONVERGED:
        if not any(number.determined for number in identified):
            unanswered = replace(estimate, status=FitStatus.NO_ANSWER)
            return ExportedEstimate(estimate=unanswered)
        for is_chosen in _choices(shared, is_open):
            if (is_chosen <= is_held).all():
                continue
            candidate = is_held | is_chosen
            allowed = INTERVAL**2 * inflation * int(candidate.sum())
            held_fit = _refitted(fitted, candidate)
            if held_fit is not None and 2.0 * (held_fit.cost - estimate.cost) < allowed:
                is_held = candidate
                best = held_fit
        is_impossible = _impossible(fitted, best, identified) & ~is_held
        if is_impossible.any():
            is_held |= is_impossible
            held_fit = _refitted(fitted, is_held)
            allowed = INTERVAL**2 * inflation * int(is_held.sum())
            if held_fit is None or 2.0 * (held_fit.cost - estimate.cost) >= allowed:
                return ExportedEstimate(
                    estimate=replace(estimate, status=FitStatus.NO_ANSWER),
                    contradicted=tuple(np.array(shared.names)[is_impossible].tolist()),
                )
            best = held_fit
    return ExportedEstimate(estimate=best, kept=tuple(np.array(shared.names)[is_held].tolist()))


def _choices(shared: parameters.Unknowns, is_open: np.ndarray) -> Iterator[np.ndarray]:
    """Yield masks (n,) [bool] of open unknowns: all, then quantity by quantity, then one by one."""
    yield is_open
    quantities = np.array([name.partition(" ")[0] for name in shared.names])
    for name in dict.fromkeys(quantities.tolist()):
        yield is_open & (quantities == name)
    for place in np.flatnonzero(is_open):
        yield np.arange(len(is_open)) == place


def _impossible(
    fitted: FitContext, estimate: Estimate, identified: Sequence[IdentifiedNumber]
) -> np.ndarray:
    """Mark unknowns (n,) [bool] of masses and volumes that nothing determines, and that are so far
    from what was declared that no body has them.
    """
    vehicle = fitted.vehicle
    is_determined = {number.name: number.determined for number in identified}
    values = values_of(vehicle, estimate.shared)
    declared = values_of(vehicle, vehicle.shared.start)
    names = [name for _, name in slopes_of(vehicle, estimate.shared)[0]]
    impossible_names = set()
    for name, value, before in zip(names, values, declared, strict=True):
        is_of_body = name.partition(" ")[0] in _OF_BODIES
        is_open = is_of_body and before > 0.0 and not is_determined.get(name, False)
        if is_open and not 1.0 / _FARTHEST < value / before < _FARTHEST:
            impossible_names.add(name)
    return np.array([name in impossible_names for name in vehicle.shared.names])


def _refitted(fitted: FitContext, is_held: np.ndarray) -> Estimate | None:
    """Refit with the unknowns of a mask (n,) [bool] held as declared; `None` where that does not
    converge.
    """
    shared = fitted.vehicle.shared
    vehicle = replace(fitted.vehicle, shared=shared.held(is_held))
    problem = replace(fitted, vehicle=vehicle).problem()
    start = np.where(is_held, shared.start, fitted.estimate.shared)
    warm_start = problem.resumed(replace(fitted.estimate, shared=start))
    # From so near a step leaves its square, and less of a tolerance is enough.
    solution = problem.solve(warm_start, iterations=fitted.search.iterations, tolerance=1e-3)
    if solution.status is not FitStatus.CONVERGED:
        return None
    return replace(solution, shared=np.where(is_held, shared.start, solution.shared))
