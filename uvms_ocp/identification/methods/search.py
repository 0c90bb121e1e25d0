"""Output error from far away: roughly in short stretches first, then as it is meant.

In stretches of a second everything is nearly linear in the unknowns, as in an equation error, if what their beginnings showed
is trusted and the end of one need not be the beginning of the next. What is found there is near enough for long ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from uvms_ocp.identification.methods.output_error import Estimate, FitStatus, Noise, OutputError
from uvms_ocp.identification.methods.rollout import Rollout
from uvms_ocp.identification.methods.stretch import Prepared
from uvms_ocp.identification.models.stage import Vehicle

_COARSER = 10.0  # noise of the first search, which is to find the way and not the place
_COARSE = 4.0  # times the steps with which most of the way is gone: few of the fine ones, which take long, are left
_ROUGH_STEP, _ROUGH_STRETCH = 0.05, 1.0  # [s]
_ROUGH_ITERATIONS, _ROUGH_TOLERANCE = 20, 1e-3
_ROUNDS = 10  # of iterations, the first among them, while each of them still lowers the cost


@dataclass(frozen=True, kw_only=True, slots=True)
class Search:
    """Of the second part."""

    step: float = 0.02
    """[s] of the simulation: lags are biased where it is not well below them."""
    stretch: float = 20.0
    """[s]"""
    iterations: int = 15
    """After which a search goes on, some times, where it has not converged: the way may be long."""


def searched(
    vehicle: Vehicle, recordings: Sequence[Prepared], noise: Noise, rollout: Rollout, search: Search | None = None
) -> Estimate:
    """The unknowns that explain the recordings best, from where the declaration has them."""
    chosen = search or Search()
    rough = _error(vehicle, recordings, _rough(noise), rollout, _ROUGH_STEP, _ROUGH_STRETCH)
    near = rough.solve(rough.start(), iterations=_ROUGH_ITERATIONS, tolerance=_ROUGH_TOLERANCE)
    for step in (min(_COARSE * chosen.step, _ROUGH_STEP), chosen.step):
        error = _error(vehicle, recordings, noise, rollout, step, chosen.stretch)
        near = error.solve(error.start(near.shared), iterations=chosen.iterations)
    return gone_on(error, near, chosen.iterations)


def gone_on(error: OutputError, found: Estimate, iterations: int) -> Estimate:
    """From where a search has reached its limit, in rounds of iterations, until it converges or no step is left."""
    for _ in range(_ROUNDS - 1):
        if found.status is not FitStatus.ITERATION_LIMIT:
            break
        further = error.solve(error.resumed(found), iterations=iterations)
        found = replace(further, iterations=found.iterations + further.iterations)
    return found


def _rough(noise: Noise) -> Noise:
    seen = {name: _COARSER * getattr(noise, name) for name in ("velocity", "rate", "vertical")}
    return replace(noise, **seen, process=1.0, start=2.0 * noise.velocity, outliers=1e3)


def _error(
    vehicle: Vehicle, recordings: Sequence[Prepared], noise: Noise, rollout: Rollout, step: float, stretch: float
) -> OutputError:
    parts = [part for one in recordings for part in one.stretches(step, stretch)]
    return OutputError(vehicle, parts, noise, rollout)
