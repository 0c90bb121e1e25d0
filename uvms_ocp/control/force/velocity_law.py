"""Velocity law: model-based feed-forward and PI with anti-windup, and the derating of its bandwidth
for dead time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from uvms_ocp.codegen.elementwise import Array
from uvms_ocp.robot.signals import SensorSpec, SensorSpecs
from uvms_ocp.robot.symbolic_dynamics import SymbolicDynamics

_MOST_DEAD = 0.2
"""bandwidth times dead time: with observer and estimator in the loop, that of Case 1 holds at 0.2
and breaks at 0.3.
"""
_ROUNDING = 1e-6  # share of the largest force by which one that is reached may fall short
_NOTHING = 1e-12  # stiffness that counts as none
CONTROLLER_DEAD_TIME = 1.5
"""control periods of dead time beside that of the sensors: half a one, as commands are held, and
one that nobody told of.
"""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class VelocityLaw:
    """``tau = M (a_ref + K_p (e + i)) + D i + h(q, v_ref)`` with ``i = reset * int e``.

    D in the integral part: without it, axes with much drag are left with a slow tail. Drag in h is
    that of the reference: fed back from the measured velocity it destabilises the loop wherever the
    model has too much of it.
    """

    dynamics: SymbolicDynamics
    K_p: Array
    """(n_v,) [1/s]"""
    reset: Array
    """(n_v,) [1/s] inverse integral time."""
    dt: float
    """[s]"""

    def force(
        self, q: ca.SX, v: ca.SX, before: ca.SX, error: ca.SX, integral: ca.SX, share: ca.SX
    ) -> ca.SX:
        """Compute the generalized force (n_v,) [N, N m] at q (n_q,) [m, rad] for the reference v
        (n_v,) [m/s, rad/s], which was `before` one tick ago.

        error (n_v,) [m/s, rad/s] of the velocity, integral (n_v,) [m, rad] of it; share (n_v,) of
        the bandwidth.
        """
        still = ca.SX(3, len(self.dynamics.links))
        lasting = share * self.reset * integral
        a = (v - before) / self.dt + share * self.K_p * (error + lasting)
        damping = self.dynamics.damping_matrix(q, v, still)
        return self.dynamics.inverse_dynamics(q, v, a, still, still) + ca.mtimes(damping, lasting)

    def bumpless(self, q: ca.SX, v: ca.SX, integral: ca.SX, share: ca.SX, before: ca.SX) -> ca.SX:
        """Transfer without a bump: return the integral (n_v,) [m, rad] with which each axis keeps
        its lasting force at another share of the bandwidth.

        q (n_q,) [m, rad]; v (n_v,) [m/s, rad/s]: reference; share (n_v,): of the bandwidth from now
        on; before (n_v,): the share so far.
        """
        damping = self.dynamics.damping_matrix(q, v, ca.SX(3, len(self.dynamics.links)))
        drag = ca.diag(damping) / ca.diag(self.dynamics.mass_matrix(q))
        stiffness = share * (share * self.K_p + drag) + _NOTHING
        stiffness_before = before * (before * self.K_p + drag) + _NOTHING
        return integral * stiffness_before / stiffness

    def integrated(self, integral: ca.SX, error: ca.SX, desired: ca.SX, reached: ca.SX) -> ca.SX:
        """Return the integral (n_v,) [m, rad] a tick later; error (n_v,) [m/s, rad/s]; desired and
        reached forces (n_v,) [N, N m].

        Conditional integration: an axis whose force falls short does not wind up further in that
        direction.
        """
        short = desired - reached
        winding = ca.logic_and(ca.fabs(short) > _ROUNDING * ca.norm_inf(desired), short * error > 0)
        return integral + ca.if_else(winding, 0.0, error * self.dt)


@dataclass(frozen=True, kw_only=True, slots=True)
class DeadTimes:
    """Times after which sensors show a motion at the soonest."""

    vehicle: float = 0.0
    """[s] dead time of the vehicle's linear velocity."""
    turning: float = 0.0
    """[s] dead time of the vehicle's angular velocity."""
    joints: float = 0.0
    """[s] dead time of the joints' velocities."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BandwidthDerating:
    """Bandwidth derating for dead time: shares that the loops keep."""

    vehicle: float = 1.0
    """Share of its bandwidth that the loop of the vehicle keeps."""
    joints: float = 1.0
    """Share of their bandwidth that the loops of the joints keep."""
    joints_late: float = 0.0
    """[s] dead time of the joints."""


def dead_times(specs: SensorSpecs) -> DeadTimes:
    """Return the dead times of the fastest velocity sensors; fixes give the linear one where there
    is no DVL.
    """
    linear = _soonest(specs.linear_velocity or specs.position)
    turning = _soonest(specs.angular_velocity, specs.attitude)
    joints = _soonest(specs.joint_velocities, specs.joint_positions)
    return DeadTimes(vehicle=max(linear, turning), turning=turning, joints=joints)


def bandwidth_derating(
    late: DeadTimes, *, vehicle: float, joints: float, dt: float
) -> BandwidthDerating:
    """Compute the derating of loops with bandwidths vehicle [1/s] and joints [1/s], closed once in
    dt [s].
    """
    shares = (
        _share(vehicle, late.vehicle + CONTROLLER_DEAD_TIME * dt),
        _share(joints, late.joints + CONTROLLER_DEAD_TIME * dt),
    )
    return BandwidthDerating(vehicle=shares[0], joints=shares[1], joints_late=late.joints)


def largest_dead_time(
    stiffness: np.ndarray, *, bandwidth: float, reset: float, observer: float
) -> float:
    """Return the dead time [s] from which loops swing that carry weight and buoyancy of a late
    configuration; inf where they never do.

    stiffness (n, n) [1/s2]: ``M^-1 dg/dq`` of the axes that are late. bandwidth, reset [1/s] and
    observer [rad/s]: of them. Prediction at the last known velocity misses what has accelerated
    since, so that an axis that would fall with exp(p t) is no longer caught from about ``p T =
    1.3`` on, and one that would swing with w is driven from about ``w T = 1.9`` on.
    """
    eigenvalues = np.linalg.eigvals(stiffness).real
    if bandwidth:
        falling, swinging = _stiffness_limits(reset / bandwidth, observer / bandwidth)
    else:
        falling, swinging = _stiffness_limits(0.0, 0.0)
    steepest = max(eigenvalues.min(initial=0.0) / falling, eigenvalues.max(initial=0.0) / swinging)
    if steepest > 0.0:
        return 1.0 / math.sqrt(steepest)
    return math.inf


@lru_cache(maxsize=8)
def _stiffness_limits(reset: float, observer: float) -> tuple[float, float]:
    """Return the least (< 0) and largest (> 0) stiffness, times the dead time squared, with all the
    bandwidth k that is borne.

    reset and observer: shares of the bandwidth. With z = s T and Q = (w / (z + w))^2 of the
    observer, the loop is ``(1 - Q) (z^2 + mu (1 - (1 + z) e^-z)) + (k (1 + r / z) + Q z) z e^-z =
    0``: on its border z is imaginary and mu is real. Where there is no border below zero, nothing
    that falls is caught.
    """
    z = 1j * np.linspace(1e-2, 2 * np.pi, 20_000)
    k = _MOST_DEAD
    r = _MOST_DEAD * reset
    w = _MOST_DEAD * observer
    late = np.exp(-z)
    sensitivity = 1 - (w / (z + w)) ** 2
    feedback = (k * (1 + r / z) + (1 - sensitivity) * z) * z * late
    mu = -(z**2 + feedback / sensitivity) / (1 - (1 + z) * late)
    border = mu.real[:-1][np.diff(np.sign(mu.imag)) != 0]
    falling = border[border < 0]
    swinging = border[border > 0]
    largest_falling = float(falling.max()) if len(falling) else -_NOTHING
    return largest_falling, float(swinging.min(initial=math.inf))


def _soonest(*specs: SensorSpec | None) -> float:
    return min((spec.delay for spec in specs if spec is not None), default=0.0)


def _share(bandwidth: float, late: float) -> float:
    if bandwidth * late > 0.0:
        return min(1.0, _MOST_DEAD / (bandwidth * late))
    return 1.0
