"""Commands as a few numbers: what each actuator is told at knots, and straight lines between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.identification.recordings.recording import Channel
from uvms_ocp.identification.recordings.sampling import Held


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class History:
    """Of commands that begin and end with 0, as linear maps from knots (n_knots, n_u) [N, N m]."""

    told: np.ndarray
    """(n, n_knots) [-] commands as they are sent, held for a step each."""
    acting: np.ndarray
    """(n, n_knots) [-] commands as they act, late."""
    late: np.ndarray
    """(n, n_knots) [1/s] how they change with the delay."""

    @staticmethod
    def of(duration: float, every: float, step: float, delay: float) -> History:
        """Of some duration [s], knots about `every` [s] and in steps of `step` [s], where commands act by `delay` [s] late."""
        n, inner = round(duration / step), max(1, round(duration / every) - 1)
        t, knots = step * np.arange(n), np.linspace(0.0, duration, inner + 2)
        told = np.array([np.interp(t, knots, row) for row in np.eye(inner + 2)[1:-1]]).T
        held, edges = Held(Channel(t=t, values=told)), step * np.arange(n + 1) - delay
        return History(told=told, acting=held.mean(edges), late=-held.mean_slope(edges))

    @property
    def n_knots(self) -> int:
        """Those at both ends left out."""
        return self.told.shape[1]


def multisine(rng: np.random.Generator, n_knots: int, n_u: int, waves: float) -> np.ndarray:
    """Knots (n_knots, n_u) [-] of sines with drawn phases, at most 1; waves: [-] of the fastest from begin to end."""
    turns = 2 * np.pi * np.arange(1, max(1, round(waves)) + 1)[:, None] * np.linspace(0.0, 1.0, n_knots)
    found = np.sin(turns[:, :, None] + 2 * np.pi * rng.uniform(size=(len(turns), 1, n_u))).sum(axis=0)
    return np.asarray(found / np.abs(found).max(axis=0))
