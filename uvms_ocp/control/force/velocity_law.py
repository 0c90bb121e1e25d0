"""From a velocity to the generalized force that makes it: model-based feed-forward and PI with anti-windup.

How much of its bandwidth it bears follows from how late velocities are known.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.model.sensing import SensorSpec, SensorSpecs
from uvms_ocp.model.symbolic.dynamics import SymbolicDynamics

_MOST_DEAD = 0.2
"""[-] bandwidth times dead time: with observer and estimator in the loop, that of Case 1 holds at 0.2 and breaks at 0.3."""
_OWN = 1.5
"""[-] control periods of dead time beside that of the sensors: half a one, as commands are held, and one that nobody told of."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class VelocityLaw:
    """``tau = M (a_ref + K_p (e + i)) + D i + h(q, v_ref)`` with ``i = reset * int e``.

    D in the integral part: without it, axes with much drag are left with a slow tail. Drag in h is that of the
    reference: fed back from the measured velocity it destabilises the loop wherever the model has too much of it.
    """

    dynamics: SymbolicDynamics
    K_p: np.ndarray
    """(n_v,) [1/s]"""
    reset: np.ndarray
    """(n_v,) [1/s] inverse integral time."""
    dt: float
    """[s]"""

    def force(self, q: ca.SX, v: ca.SX, before: ca.SX, error: ca.SX, integral: ca.SX, share: ca.SX) -> ca.SX:
        """Generalized force (n_v,) [N, N m] at q (n_q,) [m, rad] for the reference v (n_v,) [m/s, rad/s], which was `before`.

        error (n_v,) [m/s, rad/s] of the velocity, integral (n_v,) [m, rad] of it; share (n_v,) [-] of the bandwidth.
        """
        still = ca.SX(3, len(self.dynamics.links))
        lasting = share * self.reset * integral
        a = (v - before) / self.dt + share * self.K_p * (error + lasting)
        damping = self.dynamics.damping_matrix(q, v, still)
        return self.dynamics.inverse_dynamics(q, v, a, still, still) + ca.mtimes(damping, lasting)

    def integrated(self, integral: ca.SX, error: ca.SX, wanted: ca.SX, reached: ca.SX) -> ca.SX:
        """The integral (n_v,) [m, rad] a tick later; error (n_v,) [m/s, rad/s], forces (n_v,) [N, N m].

        Conditional integration: an axis whose force falls short does not wind up further in that direction.
        """
        short = wanted - reached
        winding = ca.logic_and(ca.fabs(short) > 1e-6 * (1 + ca.fabs(wanted)), short * error > 0)
        return integral + ca.if_else(winding, 0.0, error * self.dt)


@dataclass(frozen=True, kw_only=True, slots=True)
class DeadTimes:
    """After which motion is seen at the soonest."""

    vehicle: float = 0.0
    """[s]"""
    joints: float = 0.0
    """[s]"""


@dataclass(frozen=True, kw_only=True, slots=True)
class Borne:
    """What sensors leave of the bandwidth of the loops."""

    vehicle: float = 1.0
    """[-]"""
    joints: float = 1.0
    """[-]"""
    joints_late: float = 0.0
    """[s] dead time of the joints."""


def dead_times(specs: SensorSpecs) -> DeadTimes:
    """Of what tells velocities soonest; fixes tell the linear one where there is no DVL."""
    linear = specs.linear_velocity or specs.position
    return DeadTimes(
        vehicle=max(_soonest(linear), _soonest(specs.angular_velocity, specs.attitude)),
        joints=_soonest(specs.joint_velocities, specs.joint_positions),
    )


def borne_by(late: DeadTimes, *, vehicle: float, joints: float, dt: float) -> Borne:
    """Of loops with the bandwidths vehicle [1/s] and joints [1/s], closed once in dt [s]."""
    shares = (_share(vehicle, late.vehicle + _OWN * dt), _share(joints, late.joints + _OWN * dt))
    return Borne(vehicle=shares[0], joints=shares[1], joints_late=late.joints)


def _soonest(*specs: SensorSpec | None) -> float:
    return min((spec.delay for spec in specs if spec is not None), default=0.0)


def _share(bandwidth: float, late: float) -> float:
    return min(1.0, _MOST_DEAD / (bandwidth * late)) if bandwidth * late > 0.0 else 1.0
