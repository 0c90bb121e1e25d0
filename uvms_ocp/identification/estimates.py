"""What a search for the numbers of a vehicle takes and gives: noise, iterates, a penalty, and the
estimate with the reason for which the search ended.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from uvms_ocp.errors import AdvisedStatus
from uvms_ocp.identification.rollout import SegmentStart


@dataclass(frozen=True, kw_only=True, slots=True)
class Noise:
    """Standard deviations of measurements and of changes of state between segments."""

    velocity: float = 0.02
    """[m/s] deviation of measured velocity, errors of the model included."""
    rate: float = 0.05
    """[rad/s] deviation of measured angular velocity."""
    vertical: float = 0.03
    """[rad] deviation of measured roll and pitch, of the vertical in B."""
    process: float = 0.05
    """[m/s, rad/s, rad] deviation between the end of a segment and the start of the next."""
    start: float = 0.1
    """[m/s, rad/s, rad] deviation between the start of a segment and the measurements there."""
    outliers: float = 3.0
    """Standard deviations beyond which the loss is linear."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SearchPoint:
    """Iterate of a search: unknowns and starts."""

    shared: np.ndarray
    """(n,) [as `Unknowns.start`] unknowns of all recordings."""
    per_recording: tuple[np.ndarray, ...]
    """(m,) [as `Unknowns.start`] unknowns that each recording has for itself."""
    starts: tuple[tuple[SegmentStart, ...], ...]
    """Starts of the segments of each recording."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ProfilePenalty:
    """Quadratic penalty that draws one number to a value, for profile likelihood.

    Where a search ends, the number is a little off the value, and all unknowns are the best ones
    for the number that was reached.
    """

    number: Callable[[np.ndarray], tuple[float, np.ndarray]]
    """Maps the unknowns (n,) [as `Unknowns.start`] to the number [any] and its slope (n,) [any per
    unknown].
    """
    target: float
    """[as the number] value to which it is drawn."""
    sigma: float
    """[as the number] deviation that costs a half."""

    def cost(self, shared: np.ndarray) -> float:
        """Compute the penalty [-] at the unknowns shared (n,) [as `Unknowns.start`]."""
        value, _ = self.number(shared)
        return ((value - self.target) / self.sigma) ** 2 / 2

    def normal(self, shared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the part of the normal equations, (n, n) and (n,), that the penalty adds at the
        unknowns shared (n,) [as `Unknowns.start`].
        """
        value, slope = self.number(shared)
        H = np.outer(slope, slope) / self.sigma**2
        g = slope * (value - self.target) / self.sigma**2
        return H, g


class FitStatus(AdvisedStatus):
    """Reason for which a fit ended."""

    CONVERGED = "converged", "Look at what is not determined before numbers are used."
    ITERATION_LIMIT = (
        "iteration limit",
        "Look at the recordings' doubts, learn less, or give shorter stretches.",
    )
    RUNS_AWAY = (
        "runs away",
        (
            "The simulation is not finite where the search begins: look at times and units of the"
            " recordings."
        ),
    )
    STALLED = (
        "stalled",
        "No step lowers the cost: look at the recordings' doubts, and at starts and priors.",
    )
    NO_ANSWER = (
        "no answer",
        (
            "No number is determined: look at the recordings' doubts, learn less, or record what"
            " the report asks for."
        ),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Estimate:
    """Unknowns at which a search ended, with their cost, information and its status."""

    shared: np.ndarray
    """(n,) [as `Unknowns.start`] unknowns of all recordings."""
    per_recording: Mapping[str, np.ndarray]
    """(m,) [as `Unknowns.start`] unknowns that a recording has for itself, by its name."""
    starts: tuple[SegmentStart, ...]
    """Starts of the segments."""
    cost: float
    """Half the sum of the weighted squares."""
    information: np.ndarray
    """(n, n) [1 / unknowns^2] information on the shared unknowns, the others eliminated, priors
    included.
    """
    status: FitStatus
    """Reason for which the search ended."""
    iterations: int
    """Number of steps that were taken."""
    assumed: np.ndarray | float = 0.0
    """(n, n) [unknowns^2] covariance from sources other than noise: the step of the simulation, and
    constants that were assumed.
    """
