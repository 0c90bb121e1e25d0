"""Commands as a few numbers: what each actuator is told at knots, and straight lines between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from uvms_ocp.identification.recordings.recording import Channel
from uvms_ocp.identification.recordings.sampling import Held

_WITHIN = 1e-9  # [-] of a step


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class History:
    """Of commands that begin and end with 0, as sparse linear maps from knots (n_knots, n_u) [N, N m]."""

    told: Any
    """(n, n_knots) [-] commands as they are sent, held for a step each."""
    acting: Any
    """(n, n_knots) [-] commands as they act, late."""
    late: Any
    """(n, n_knots) [1/s] how they change with the delay."""

    @staticmethod
    def of(duration: float, every: float, step: float, delay: float) -> History:
        """Of some duration [s], knots about `every` [s] and in steps of `step` [s], where commands act by `delay` [s] late."""
        n, inner = round(duration / step), max(1, round(duration / every) - 1)
        told, t = _lines(n, inner, step * (inner + 1) / duration), step * np.arange(n)
        # A command of one step only: what it does is the same at any time.
        held, edges = Held(Channel(t=t, values=np.eye(n, 1, -1))), edges_of(n, step, delay)
        acting, late = _shifted(held.mean(edges)[:, 0]), _shifted(-held.mean_slope(edges)[:, 0])
        return History(told=told, acting=acting @ told, late=late @ told)

    @property
    def n_knots(self) -> int:
        """Those at both ends left out."""
        return int(self.told.shape[1])

    def nearest(self, told: np.ndarray) -> np.ndarray:
        """Knots (n_knots, n_u) [N, N m] whose commands are nearest to told (n, n_u) [N, N m]."""
        from scipy.sparse.linalg import spsolve  # a tenth of a second

        square = (self.told.T @ self.told).tocsc()
        return np.asarray(spsolve(square, self.told.T @ told)).reshape(self.n_knots, -1)


def edges_of(n: int, step: float, delay: float) -> np.ndarray:
    """(n + 1,) [s] when what acts in steps of `step` [s] was told, from 0, where commands act by delay [s] late."""
    # Delays are often whole steps: rounding would decide, edge by edge, which of two commands changes with them.
    return step * (np.arange(n + 1) + _WITHIN) - delay


def _lines(n: int, inner: int, each: float) -> Any:
    """(n, inner) [-] shares of knots in n samples that lie `each` knots apart; the first knot and the last are 0."""
    from scipy.sparse import csr_array

    place = each * np.arange(n)
    knot = np.minimum(place.astype(int), inner)
    share = place - knot
    rows, columns = np.tile(np.arange(n), 2), np.concatenate([knot, knot + 1])
    whole = csr_array((np.concatenate([1.0 - share, share]), (rows, columns)), shape=(n, inner + 2))
    return whole[:, 1:-1]


def _shifted(response: np.ndarray) -> Any:
    """(n, n) [any] what commands do, of which the one in the second step does response (n,) [any]."""
    from scipy.sparse import diags

    later = np.flatnonzero(response)
    return diags(response[later], 1 - later, shape=(len(response),) * 2, format="csr")


def multisine(rng: np.random.Generator, n_knots: int, n_u: int, waves: float) -> np.ndarray:
    """Knots (n_knots, n_u) [-] of sines with drawn phases, at most 1; waves: [-] of the fastest from begin to end."""
    turns = 2 * np.pi * np.arange(1, max(1, round(waves)) + 1)[:, None] * np.linspace(0.0, 1.0, n_knots)
    found = np.sin(turns[:, :, None] + 2 * np.pi * rng.uniform(size=(len(turns), 1, n_u))).sum(axis=0)
    return np.asarray(found / np.abs(found).max(axis=0))
