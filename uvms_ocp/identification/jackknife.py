"""Check intervals of a fit by the jackknife: how far numbers move when a recording is left out.

Standard errors come from the fit's own information and residuals. The jackknife takes none of
these: n fits, each without one recording, scatter by ``sqrt((n - 1) / n sum (x_k - mean)^2)``
(Efron and Tibshirani, An Introduction to the Bootstrap, 11.2). Where recordings differ by more than
their noise, as by ballast, that is larger than the standard error, and the interval is too narrow.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.estimates import FitStatus
from uvms_ocp.identification.identified_numbers import IdentifiedNumber, values_of
from uvms_ocp.identification.model import Vehicle
from uvms_ocp.identification.validation import HeldOutRecording

_LEVEL = 0.01  # share of honest intervals that the test calls too narrow


@dataclass(frozen=True, kw_only=True, slots=True)
class DisagreedNumber:
    """A number called determined on which the recordings disagree."""

    number: IdentifiedNumber
    scatter: float
    """[unit of the number] standard error by the jackknife."""

    def __str__(self) -> str:
        """Write one sentence with both standard errors."""
        number = self.number
        return (
            f"{number.name} is called determined to {number.sigma:.2g} {number.unit}, and fits"
            f" without one recording each scatter as if it were known to {self.scatter:.2g}"
            f" {number.unit}: recordings differ, and its interval is too narrow."
        )


def disagreed_numbers(
    vehicle: Vehicle, numbers: Sequence[IdentifiedNumber], left_out: Sequence[HeldOutRecording]
) -> Iterator[DisagreedNumber]:
    """Yield the determined numbers that scatter by more than their standard errors allow.

    Of independent recordings ``(n - 1) scatter^2 / sigma^2`` is a chi-squared variable of n - 1
    degrees of freedom. Fits that have not converged are left out; two at least are needed.
    """
    from scipy.stats import chi2  # a tenth of a second

    converged = [
        recording for recording in left_out if recording.estimate.status is FitStatus.CONVERGED
    ]
    # Parts of one recording are left out together: their fits are the same.
    estimates = {
        recording.estimate.shared.tobytes(): recording.estimate.shared for recording in converged
    }
    n = len(estimates)
    if n < 2:
        return
    values = np.array([values_of(vehicle, shared) for shared in estimates.values()])
    deviations = values - values.mean(axis=0)
    scatters = np.sqrt((n - 1) / n * (deviations**2).sum(axis=0))
    largest_ratio = float(np.sqrt(chi2.ppf(1.0 - _LEVEL, n - 1) / (n - 1)))
    for number, scatter in zip(numbers, scatters, strict=True):
        if number.determined and scatter > largest_ratio * number.sigma:
            yield DisagreedNumber(number=number, scatter=float(scatter))
