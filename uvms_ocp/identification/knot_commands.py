"""Commands of an experiment by knots: piecewise linear, held for a step each, and acting with a delay."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.identification import recording
from uvms_ocp.identification.resampling import ZeroOrderHold

_EDGE_SHIFT = 1e-9  # share of a step by which edges are moved into it


class KnotCommands:
    """Piecewise linear commands that begin and end with 0, as sparse linear maps from knots
    (n_knots, n_u) [N, N m].
    """

    def __init__(self, duration: float, interval: float, step: float, delay: float) -> None:
        """Place knots about `interval` [s] apart in a duration [s]; commands are held for `step`
        [s] and act with a delay [s].
        """
        n_steps = round(duration / step)
        n_inner = max(1, round(duration / interval) - 1)
        self.sent = _lines(n_steps, n_inner, step * (n_inner + 1) / duration)
        """(n, n_knots) map to the commands that are sent, held for a step each."""
        # A command of one step only: what it does is the same at any time.
        pulse = recording.Channel(t=step * np.arange(n_steps), values=np.eye(n_steps, 1, -1))
        held = ZeroOrderHold(pulse)
        edges = edges_of(n_steps, step, delay)
        acting = _shifted(held.mean(edges)[:, 0])
        late = _shifted(-held.mean_slope(edges)[:, 0])
        self.acting = acting @ self.sent
        """(n, n_knots) map to the commands as they act, late."""
        self.late = late @ self.sent
        """(n, n_knots) [1/s] map to the change of acting commands with the delay."""

    @property
    def n_knots(self) -> int:
        """Number of knots without those at both ends."""
        return int(self.sent.shape[1])

    def nearest(self, sent: np.ndarray) -> np.ndarray:
        """Compute the knots (n_knots, n_u) [N, N m] whose commands are nearest to sent (n, n_u) [N, N
        m], by least squares.
        """
        from scipy.sparse.linalg import spsolve  # a tenth of a second

        square = (self.sent.T @ self.sent).tocsc()
        if np.linalg.matrix_rank(square.toarray(), hermitian=True) < self.n_knots:
            # Knots that no command shows stay at 0.
            return np.asarray(np.linalg.pinv(self.sent.toarray()) @ sent)
        return np.asarray(spsolve(square, self.sent.T @ sent)).reshape(self.n_knots, -1)


def edges_of(n: int, step: float, delay: float) -> np.ndarray:
    """Return the times (n + 1,) [s], from 0, of the commands that act in steps of `step` [s], where
    commands act by delay [s] late.
    """
    # Delays are often whole steps: rounding would decide, edge by edge, which of two commands
    # changes with them.
    return step * (np.arange(n + 1) + _EDGE_SHIFT) - delay


def _lines(n: int, inner: int, spacing: float) -> Any:
    """Compute shares (n, inner) of knots in n samples that lie `spacing` knots apart; the first
    knot and the last are 0.
    """
    from scipy.sparse import csr_array

    place = spacing * np.arange(n)
    knot = np.minimum(place.astype(int), inner)
    share = place - knot
    rows = np.tile(np.arange(n), 2)
    columns = np.concatenate([knot, knot + 1])
    shares = np.concatenate([1.0 - share, share])
    with_ends = csr_array((shares, (rows, columns)), shape=(n, inner + 2))
    return with_ends[:, 1:-1]


def _shifted(response: np.ndarray) -> Any:
    """Build the map (n, n) [any] from commands to their effects, of which a command in the second
    step has the effect response (n,) [any].
    """
    from scipy.sparse import diags

    n = len(response)
    later = np.flatnonzero(response)
    return diags(response[later], 1 - later, shape=(n, n), format="csr")


def multisine(rng: np.random.Generator, n_knots: int, n_u: int, waves: float) -> np.ndarray:
    """Draw knots (n_knots, n_u) [-] of sines with random phases, at most 1; waves: number of waves
    of the fastest from begin to end.
    """
    orders = np.arange(1, max(1, round(waves)) + 1)
    turns = 2 * np.pi * orders[:, None] * np.linspace(0.0, 1.0, n_knots)
    phases = 2 * np.pi * rng.uniform(size=(len(turns), 1, n_u))
    sines = np.sin(turns[:, :, None] + phases).sum(axis=0)
    return np.asarray(sines / np.abs(sines).max(axis=0))
