"""Disturbance observer: the generalized force that the model does not explain, such as a current or
a payload.
"""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np

from uvms_ocp.codegen.buffered import BufferedFunction
from uvms_ocp.codegen.elementwise import Array
from uvms_ocp.control.payload import ForceResponse
from uvms_ocp.errors import InvalidInput


class ObserverDynamics(Protocol):
    """Dynamics that an observer needs, of `SymbolicDynamics`."""

    @property
    def links(self) -> Sized: ...
    def mass_matrix(self, q: ca.SX) -> ca.SX:
        """Return the mass matrix M (n_v, n_v) [kg, kg m, kg m2] at q (n_q,) [m, rad]."""

    def forward_dynamics(self, q: ca.SX, v: ca.SX, tau: ca.SX, u: ca.SX, Du_Dt: ca.SX) -> ca.SX:
        """Return the acceleration (n_v,) [m/s2, rad/s2] under tau (n_v,) [N, N m] at q (n_q,) [m,
        rad] and v (n_v,) [m/s, rad/s].

        u (3, n_links) [m/s] and Du_Dt (3, n_links) [m/s2]: of the water at the links, in W.
        """


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ObserverState:
    """State of an observer."""

    estimate: Array
    """(n_v,) [N, N m] estimate of the disturbance d."""
    lead: Array
    """(n_v,) [N, N m] from d to itself with one lag 1 / w less, and so more noise."""
    v_hat: Array
    """(n_v,) [m/s, rad/s] velocity that the model expects now."""
    follows: Array
    """() 1 where v_hat is known."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ObserverLaw:
    """Luenberger observer of ``M a + h = tau + d`` with d constant, driven by the measured
    velocity.

    v_hat follows the model, the innovation ``v - v_hat`` corrects it with 2 w and d with w^2 M:
    both poles at -w. Where axes have other bandwidths, what couples two of them goes by the lower.
    Raises `InvalidInput` for a bandwidth that is not between 0 and 1 / dt.
    """

    bandwidth: Array
    """(n_v,) [rad/s] bandwidth w of each axis."""
    limit: np.ndarray
    """(n_v,) [N, N m] of d, both ways."""
    dt: float
    """[s]"""

    def __post_init__(self) -> None:
        w = self.bandwidth
        dt = self.dt
        if not (np.isfinite(w).all() and (w > 0).all() and (w * dt < 1).all()):
            raise InvalidInput(
                f"observer bandwidth {w} rad/s; give values between 0 and 1 / dt = {1 / dt:g}"
            )

    def after(
        self,
        before: ObserverState,
        body: ObserverDynamics,
        q: ca.SX,
        v: ca.SX,
        tau: ca.SX,
        share: ca.SX,
        current: ca.DM | None = None,
    ) -> ObserverState:
        """Return the state after a tick with estimated q (n_q,) [m, rad] and v (n_v,) [m/s, rad/s].

        tau (n_v,) [N, N m] has acted since the last one. share (n_v,): of the bandwidth, as much as
        v bears now. Drag is that of the measured velocity in a current (3,) [m/s] in W, by default
        none: what it damps is no disturbance, and must not be compensated.
        """
        w = self.bandwidth * share
        v_hat = ca.if_else(before.follows, before.v_hat, v)
        innovation = v - v_hat
        M = body.mass_matrix(q)
        push = _coupled(M, w**2) @ innovation
        estimate = limited(before.estimate + self.dt * push, self.limit)
        still = ca.SX(3, len(body.links))
        if current is None:
            water = still
        else:
            water = ca.repmat(ca.SX(current), 1, len(body.links))
        corrected = tau + estimate + 2 * _coupled(M, w) @ innovation
        v_hat = v_hat + self.dt * body.forward_dynamics(q, v, corrected, water, still)
        return ObserverState(estimate=estimate, lead=push / w, v_hat=v_hat, follows=ca.SX(1.0))

    def response(
        self, before: ForceResponse, M: ca.SX, force: ca.SX, share: ca.SX
    ) -> ForceResponse:
        """Propagate the response of the estimate to forces (n_v, k) [N, N m], each by itself, by
        one tick.

        An observer is linear in what disturbs it, until its limit. M (n_v, n_v) [kg, kg m, kg m2];
        share (n_v,): of the bandwidth that each axis has now.
        """
        w = self.bandwidth * share
        D, L_transposed, order = ca.ldl(M, False)
        estimate = before.estimate + self.dt * _coupled(M, w**2) @ before.innovation
        drift = ca.ldl_solve(
            force - estimate - 2 * _coupled(M, w) @ before.innovation, D, L_transposed, order
        )
        return ForceResponse(estimate=estimate, innovation=before.innovation + self.dt * drift)


def _coupled(M: ca.SX, gain: ca.SX) -> ca.SX:
    """Return M (n, n) with each entry times the lower of the gains (n,) of its two axes.

    What acts on the faster of two axes then shows as no push on the slower one, and a wrong
    velocity of the slower one drives the faster one by the lower gain alone.
    """
    return M * ca.fmin(ca.repmat(gain, 1, gain.numel()), ca.repmat(gain.T, gain.numel(), 1))


def limited(y: ca.SX, limit: np.ndarray) -> ca.SX:
    """Limit y (n,) to a range from -limit to limit (n,), all in one unit; what is no number stays
    none.
    """
    bound = ca.DM(limit)
    return ca.if_else(y > bound, bound, ca.if_else(y < -bound, -bound, y))


class DisturbanceObserver:
    """An observer that is called at every tick. Holds what it knows: build one per run.

    What it keeps from tick to tick is the acceleration that the disturbance makes, not the force:
    where joint axes come into line a motion is left with hardly any inertia, and what was a good
    force in the last configuration would throw it about.
    """

    def __init__(
        self, law: ObserverLaw, body: ObserverDynamics, n_q: int, current: np.ndarray | None = None
    ) -> None:
        """n_q: entries of q. current (3,) [m/s] in W: as far as it is known, and no disturbance."""
        n = len(law.bandwidth)
        q = ca.SX.sym("q", n_q)
        (v, tau, held_estimate, v_hat) = (
            ca.SX.sym(name, n) for name in ("v", "tau", "kept", "v_hat")
        )
        follows = ca.SX.sym("follows")
        M = body.mass_matrix(q)
        before = ObserverState(
            estimate=M @ held_estimate, lead=ca.SX(n, 1), v_hat=v_hat, follows=follows
        )
        after = law.after(
            before, body, q, v, tau, ca.SX.ones(n), None if current is None else ca.DM(current)
        )
        D, L_transposed, order = ca.ldl(M, False)
        outputs = [
            after.estimate,
            ca.ldl_solve(after.estimate, D, L_transposed, order),
            after.v_hat,
        ]
        self._function = BufferedFunction(
            ca.Function("observer", [q, v, tau, held_estimate, v_hat, follows], ca.cse(outputs))
        )
        self.estimate = np.zeros(n)
        self._kept = np.zeros(n)
        self._v_hat = np.zeros(n)
        self._follows = np.zeros(1)

    def update(self, q: np.ndarray, v: np.ndarray, tau: np.ndarray) -> np.ndarray:
        """Return the disturbance d (n_v,) [N, N m] after a tick in which tau has acted.

        q (n_q,) [m, rad], v (n_v,) [m/s, rad/s], tau (n_v,) [N, N m].
        """
        self.estimate, self._kept, self._v_hat = self._function(
            q, v, tau, self._kept, self._v_hat, self._follows
        )
        self._follows[0] = 1.0
        return self.estimate
