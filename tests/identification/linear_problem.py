"""A problem in which all is linear and noise is Gaussian: what sensors show is a fixed matrix times
the unknowns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from driven import known, vehicle_of

from uvms_ocp.identification.estimates import FitStatus, Noise
from uvms_ocp.identification.fit import FitContext, Search
from uvms_ocp.identification.model import Vehicle
from uvms_ocp.identification.output_error import OutputErrorProblem
from uvms_ocp.identification.parameters import Prior
from uvms_ocp.identification.recording import Channel
from uvms_ocp.identification.resampling import ZeroOrderHold
from uvms_ocp.identification.rollout import (
    N_START,
    PredictedOutputs,
    Rollout,
    SegmentStart,
    Weights,
)
from uvms_ocp.identification.segments import Segment

NOISE = Noise(velocity=0.1, rate=0.1, vertical=0.1, outliers=1e6)


class LinearRollout(Rollout):
    """Shows ``G (p + bend p^2)``, whatever the start."""

    def __init__(self, G: tuple[np.ndarray, ...], bend: float = 0.0) -> None:
        self.G = G
        self._bend = bend

    def predict(
        self,
        stretches: Sequence[Segment],
        starts: Sequence[SegmentStart],
        p: np.ndarray,
        weights: Weights | None = None,
    ) -> list[PredictedOutputs]:
        return [self._seen(k, row, weights) for k, row in enumerate(p)]

    def _seen(self, k: int, p: np.ndarray, weights: Weights | None) -> PredictedOutputs:
        rows = tuple(g @ (p + self._bend * p**2) for g in self.G)
        H, g = np.zeros((len(p) + N_START,) * 2), np.zeros(len(p) + N_START)
        pairs = weights(k, rows) if weights is not None else ()
        for matrix, (w, wr) in zip(self.G, pairs, strict=False):
            slopes = (matrix * (1.0 + 2.0 * self._bend * p)).reshape(-1, len(p))
            H[: len(p), : len(p)] += (slopes.T * w.ravel()) @ slopes
            g[: len(p)] += slopes.T @ wr.ravel()
        return PredictedOutputs(rows=rows, end=np.zeros(0), H=H, g=g)


def vehicle() -> Vehicle:
    """Whose unknowns are their own coordinates."""
    return vehicle_of(known().with_status(bias=Prior(sigma=2.0, only=("surge", "sway", "heave"))))


@dataclass(frozen=True, kw_only=True)
class _One:
    """In the place of a prepared recording."""

    stretch: Segment

    def segments(self, step: float, duration: float | None = None) -> tuple[Segment, ...]:
        return (self.stretch,)


def problem(seed: int = 0, n: int = 40, bend: float = 0.0) -> FitContext:
    """Solved, with unknowns that weigh differently and together."""
    rng = np.random.default_rng(seed)
    auv = vehicle()
    mixed = np.array([[1.0, 0.9, 0.0], [0.0, 0.4, 0.3], [0.0, 0.0, 0.2]])
    G = tuple(rng.normal(size=(n, 3, 3)) @ mixed for _ in range(3))
    truth = np.array([0.3, 0.2, 0.4])
    rollout = LinearRollout(G, bend)
    seen = tuple(g @ (truth + bend * truth**2) + 0.1 * rng.normal(size=(n, 3)) for g in G)
    error = OutputErrorProblem(auv, [_stretch(seen)], NOISE, rollout)
    fitted = error.solve(error.start(), tolerance=1e-13)
    estimate = replace(
        fitted, status=FitStatus.CONVERGED
    )  # to the last digit, where no step is left
    given = {"prepared": (_One(stretch=_stretch(seen)),), "estimate": estimate}
    return FitContext(vehicle=auv, rollout=rollout, noise=NOISE, search=Search(), **given)  # type: ignore[arg-type]


def _stretch(seen: tuple[np.ndarray, ...]) -> Segment:
    n = len(seen[0])
    times = 0.1 * np.arange(n)
    commands = ZeroOrderHold(Channel(t=times, values=np.zeros((n, 6))))
    still = {
        "q": np.array([0, 0, 0, 0, 0, 0, 1.0]),
        "v": np.zeros(6),
        "joints": np.zeros((0, n - 1)),
    }
    return Segment(
        recording="made", edges=times, commands=commands, t=(times,) * 3, measured=seen, **still
    )
