"""A Kalman filter of values and their derivatives: what all parts of the state estimator are made of."""

from __future__ import annotations

from functools import lru_cache
from math import factorial

import numpy as np


class Track:
    """n values, each with its first m - 1 derivatives.

    `x` (n, m) is the estimate, `P` (n, m, m) its covariance; the n axes are independent. Derivatives change by white
    noise alone, apart from what the caller adds to `x` (a command, say).
    """

    def __init__(self, n: int, *, sigma: tuple[float, ...], density: tuple[float, ...]) -> None:
        """sigma (m,) [its unit]: standard deviation of each derivative at the start.

        density (m,) [its unit / sqrt(s)]: noise that drives each derivative.
        """
        self.x = np.zeros((n, len(sigma)))
        self.P = np.tile(np.diag(np.square(sigma)), (n, 1, 1))
        self._density = density
        self._elapsed = 0.0
        """[s] by which P lags behind x: covariances are only needed at corrections."""

    def predict(self, dt: float) -> None:
        """Advance by dt [s]."""
        self.x = self.x @ _transition(len(self._density), round(dt, 9)).T
        self._elapsed += dt

    def correct(
        self, order: int, innovation: np.ndarray, sigma: float, *, age: float = 0.0, axes: slice = slice(None)
    ) -> None:
        """Use a measurement of the derivative `order` of the n axes, or of some, that was taken `age` [s] ago.

        innovation (n,) [its unit]: measured minus predicted, both as of then. sigma [its unit]: standard deviation of its
        noise. An old measurement is one of all derivatives: a gain as if it were of the present would overshoot, and with
        frequent ones the estimate would swing up without end.
        """
        if self._elapsed:
            self._predict_covariance()
        P, then = self.P[axes], _transition(len(self._density), round(-age, 9))[order]
        spread = P @ then
        gain = spread / (spread @ then + sigma * sigma)[:, None]
        self.x[axes] += gain * innovation[:, None]
        self.P[axes] = P - gain[:, :, None] * (then @ P)[:, None, :]

    def spread(self) -> np.ndarray:
        """Standard deviation (n,) [its unit] of the values now."""
        if self._elapsed:
            self._predict_covariance()
        return np.sqrt(self.P[:, 0, 0])

    def take(self) -> np.ndarray:
        """Return the values (n,) and set them to zero: for values that live on a manifold elsewhere."""
        values = self.x[:, 0].copy()
        self.x[:, 0] = 0.0
        return values

    def _predict_covariance(self) -> None:
        dt = round(self._elapsed, 9)
        F = _transition(len(self._density), dt)
        self.P = F @ self.P @ F.T + _diffusion(self._density, dt)
        self._elapsed = 0.0


@lru_cache(maxsize=256)
def _transition(m: int, dt: float) -> np.ndarray:
    """Taylor matrix F (m, m): ``x(t + dt) = F x(t)`` for a value and its derivatives."""
    return np.array([[dt ** (j - i) / factorial(j - i) if j >= i else 0.0 for j in range(m)] for i in range(m)])


@lru_cache(maxsize=256)
def _diffusion(density: tuple[float, ...], dt: float) -> np.ndarray:
    """Covariance (m, m) that white noise of each derivative adds in dt: ``integral of F(s) S F(s)' ds``."""
    m = len(density)
    Q = np.zeros((m, m))
    for i in range(m):
        for j in range(m):
            for k in range(max(i, j), m):
                power = 2 * k - i - j + 1
                Q[i, j] += density[k] ** 2 * dt**power / (power * factorial(k - i) * factorial(k - j))
    return Q
