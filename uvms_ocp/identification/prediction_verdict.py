"""Judge predictions: by what one vehicle could explain at best, and by a vehicle that stands still.

The judge sees measurements and predictions alone, and nothing of the search that gave the vehicle.
Fits of a channel stand in order: the vehicle that has not seen the recordings, one vehicle that has
seen all of them, each recording by a vehicle of its own, and 100 %. What lies between two of them is
missed by the fit, by what differs between recordings, and by the model or its sensors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.errors import AdvisedStatus


class MissCause(AdvisedStatus):
    """Reason for which a part of a channel is not predicted."""

    FIT = (
        "the fit",
        "The recordings that the vehicle was identified on do not tell it: add some that move as"
        " these do.",
    )
    RECORDINGS = (
        "what differs between recordings",
        "No single vehicle explains it: ballast, trim, current or another day. Learn what each"
        " recording has for itself (wrench_offset, current, attitude_offset), or keep them apart.",
    )
    MODEL = (
        "the model or the sensors",
        "No recording is explained even by a vehicle of its own: look at residuals, at what was"
        " held fixed, and at noise and delays of the sensors.",
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class FitShares:
    """Fit of one channel, beside the fits that vehicles reach which have seen what is predicted."""

    channel: str
    predicted: float
    """[%] by the vehicle that has not seen it, as `fit_percent`; median over recordings."""
    together: float
    """[%] by one vehicle that was identified on all recordings that are predicted."""
    alone: float
    """[%] each recording by a vehicle that was identified on it alone."""

    @property
    def share(self) -> float:
        """[%] of what one vehicle could explain; no number where that explains nothing."""
        if self.together <= 0.0:
            return float("nan")
        return 100.0 * self.predicted / self.together

    @property
    def missed(self) -> Mapping[MissCause, float]:
        """[%] of the channel that each cause accounts for; together ``100 - predicted``.

        Negative where a vehicle that has seen more predicts less: fits are made in short segments,
        predictions over long ones.
        """
        return {
            MissCause.FIT: self.together - self.predicted,
            MissCause.RECORDINGS: self.alone - self.together,
            MissCause.MODEL: 100.0 - self.alone,
        }

    @property
    def cause(self) -> MissCause:
        """The cause that accounts for most of what is missed."""
        missed = self.missed
        return max(missed, key=lambda cause: missed[cause])

    def __str__(self) -> str:
        """One sentence: how much is missed, and by what."""
        parts = ", ".join(f"{part:.0f} by {cause.value}" for cause, part in self.missed.items())
        share = "" if np.isnan(self.share) else f", {self.share:.0f} % of what one vehicle could"
        return (
            f"{self.channel}: {self.predicted:.0f} % explained{share};"
            f" {100.0 - self.predicted:.0f} % missed ({parts}), mostly by {self.cause.value}."
        )


