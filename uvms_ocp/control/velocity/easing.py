"""Accelerations that rise and fall instead of jumping.

The acceleration limits alone let a velocity turn from full acceleration to full braking within one tick, and a strict
hierarchy does so wherever it pays. Two things ease it: references are approached with an acceleration that falls to 0, and
a level of its own bounds the change of acceleration of each axis. That level is below the tasks that keep the robot safe:
braking for the sake of a limit is never eased.
"""

from __future__ import annotations

import casadi as ca

from uvms_ocp.tasks.limits import ENDLESS, stopping_speed
from uvms_ocp.tasks.task import Rows, TickSymbols

_RISE = 0.07  # [s] from rest to the acceleration limit: short enough for what gates ask for (0.2 s, half of it at work)
_FALL = 0.1  # [s] from the acceleration limit to a reference; longer, so that the axes can follow
_NOTHING = 1e-12  # keeps the division by a change of zero finite


def easing_rows(symbols: TickSymbols, previous: ca.SX, change: ca.SX) -> Rows:
    """Each axis changes by what it changed by in the tick before, give or take what its jerk allows.

    previous (n_v,) [m/s, rad/s]: commanded in the tick before; change (n_v,) [m/s, rad/s]: of it since the tick before that.
    Not read by the regularised pseudo-inverse.
    """
    dt, n_v = symbols.dt, symbols.robot.n_v
    jerk = ca.DM(symbols.robot.limits.acceleration) / _RISE
    # An axis that was braked to a standstill stays there: what is left of the braking must not push it backwards.
    falling = stopping_speed(ca.fabs(previous), deceleration=jerk, dt=dt) * dt
    most = falling + ca.if_else(change * previous > 0, ca.inf, 0)
    held = previous + ca.fmin(ca.fmax(change, -most), most)
    return Rows(
        jacobian=ca.SX.eye(n_v),
        rate=ca.SX.zeros(n_v),
        lower=held - jerk * dt**2,
        upper=held + jerk * dt**2,
        activation=ca.SX.zeros(n_v),
    )


def eased_share(wanted: ca.SX, acceleration: ca.SX, dt: float) -> ca.SX:
    """Share (m,) [-] of the changes `wanted` (m,) [any/s] that rates can make in this tick, so as to arrive smoothly.

    acceleration (m,) [any/s2]: largest of each rate. dt [s].
    """
    return ca.fmin(_share(wanted, acceleration, dt), falling_share(wanted, acceleration, dt))


def common_share(wanted: ca.SX, acceleration: ca.SX, dt: float) -> ca.SX:
    """Least of `eased_share` (m,) [-] over all rows, with one root for all of them: () [-].

    wanted (m,) [any/s]; acceleration (m,) [any/s2]; dt [s].
    """
    return ca.fmin(ca.mmin(_share(wanted, acceleration, dt)), _falling(ca.mmax(_excess(wanted, acceleration, dt))))


def falling_share(wanted: ca.SX, acceleration: ca.SX, dt: float) -> ca.SX:
    """As `eased_share`, but for the acceleration limit itself: the acceleration falls to 0 on the last part of the way.

    wanted (m,) [any/s]; acceleration (m,) [any/s2]; dt [s].
    """
    return _falling(_excess(wanted, acceleration, dt))


def _share(wanted: ca.SX, acceleration: ca.SX, dt: float) -> ca.SX:
    return acceleration * dt / ca.fmax(ca.fabs(wanted), _NOTHING)


def _excess(wanted: ca.SX, acceleration: ca.SX, dt: float) -> ca.SX:
    """What is wanted over what the jerk alone would give in one tick."""
    jerk = ca.fmax(ca.fmin(acceleration, ENDLESS), 1 / ENDLESS) / _FALL
    return 2 * ca.fabs(wanted) / (jerk * dt**2)


def _falling(excess: ca.SX) -> ca.SX:
    """`stopping_speed` at that jerk of what is wanted, over what is wanted: without a difference of nearly equal numbers."""
    return 2 / (1 + ca.sqrt(1 + excess))
