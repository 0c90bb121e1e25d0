"""Disturbance observer: the generalized force that the model does not know, such as a current or a payload."""

from __future__ import annotations

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.dynamics import Dynamics


class DisturbanceObserver:
    """Luenberger observer of ``M a + h = tau + d`` with d constant, driven by the measured velocity.

    v_hat follows the model, the innovation ``v - v_hat`` corrects it with 2 w and d with w^2 M: both poles at -w.
    """

    def __init__(self, dynamics: Dynamics, *, bandwidth: np.ndarray, limit: np.ndarray, dt: float) -> None:
        """bandwidth w (n_v,) [rad/s]; limit (n_v,) [N, N m] of d, both ways; dt [s].

        Raises `InvalidInput` for a bandwidth that is not between 0 and 1 / dt.
        """
        if not (np.isfinite(bandwidth).all() and (bandwidth > 0).all() and (bandwidth * dt < 1).all()):
            raise InvalidInput(f"observer bandwidth {bandwidth} rad/s; give values between 0 and 1 / dt = {1 / dt:g}")
        self._dynamics, self._bandwidth, self._limit, self._dt = dynamics, bandwidth, limit, dt
        self._v_hat: np.ndarray | None = None
        self.estimate = np.zeros(len(bandwidth))
        """d (n_v,) [N, N m]"""
        self._lead = np.zeros(len(bandwidth))

    @property
    def prompt(self) -> np.ndarray:
        """d (n_v,) [N, N m] with one lag 1 / w less, and so more noise."""
        return self.estimate + self._lead

    def pause(self, *, forget: bool) -> None:
        """Keep the estimate, or set it to zero, until measurements can be trusted again."""
        self._v_hat = None
        if forget:
            self.estimate[:] = 0.0

    def update(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray, share: np.ndarray | float = 1.0) -> np.ndarray:
        """The estimate (n_v,) [N, N m] after a tick with measured q (n_q,) [m, rad] and v (n_v,) [m/s, rad/s].

        tau (n_v,) [N, N m] has acted since the last one. share (n_v,) [-]: of the bandwidth, as much as v bears now.
        Drag is that of the measured velocity: what it damps is no disturbance, and must not be compensated.
        """
        if self._v_hat is None:
            self._v_hat = v.copy()
        w = self._bandwidth * share
        innovation = v - self._v_hat
        self._lead = self._dynamics.mass_matrix(q) @ (w**2 * innovation)
        self.estimate += self._dt * self._lead
        self._lead /= w
        np.clip(self.estimate, -self._limit, self._limit, out=self.estimate)
        acceleration = self._dynamics.forward_dynamics(q, v, tau + self.estimate)
        self._v_hat = self._v_hat + self._dt * (acceleration + 2 * w * innovation)
        return self.estimate
