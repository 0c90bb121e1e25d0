"""Accelerations that rise and fall instead of jumping.

The acceleration limits alone let a velocity turn from full acceleration to full braking within
one tick, and a strict hierarchy does so wherever it pays. Two things ease it: references are
approached with an acceleration that falls to 0, and a level of its own bounds the change of
acceleration of each axis. That level is below the tasks that keep the robot safe: braking for
the sake of a limit is never eased.
"""

from __future__ import annotations

import math

import casadi as ca
import numpy as np

from uvms_ocp.robot import Robot, symbolic_bodies, thrusters
from uvms_ocp.robot.size import size
from uvms_ocp.tasks.approach_speed import ENDLESS, stopping_speed
from uvms_ocp.tasks.task import Rows, TickSymbols

# [s] from rest to the acceleration limit: short enough for what gates ask for (0.2 s, half of it at
# work)
_RISE = 0.07
_FALL = 0.1  # [s] from the acceleration limit to a reference; longer, so that the axes can follow
# [m] size of a robot from which on these times hold; smaller robots move in shorter times, and would
# swing if they were held to these
_LARGE_ROBOT = 0.2
_WEAKLY_MOVED = 0.05  # acceleration of a row over that of the row that the same axes move most
_SMALLEST_CHANGE = 1e-12  # keeps the division by a change of zero finite


def jerk_limit_rows(symbols: TickSymbols, previous: ca.SX, change: ca.SX) -> Rows:
    """Make the rows that bound the change of acceleration: each velocity goes on changing as in the
    tick before, give or take what the limit of jerk allows.

    previous (n_v,) [m/s, rad/s]: velocity commanded in the tick before; change (n_v,) [m/s, rad/s]:
    its difference from the command before that. The regularised pseudo-inverse does not read these
    rows.
    """
    dt = symbols.dt
    n_v = symbols.robot.n_v
    jerk = ca.DM(symbols.robot.limits.acceleration) / (_RISE * pace(symbols.robot))
    # An axis that was braked to a standstill stays there: what is left of the braking must not push
    # it backwards.
    falling = stopping_speed(ca.fabs(previous), deceleration=jerk, dt=dt) * dt
    largest_change = falling + ca.if_else(change * previous > 0, ca.inf, 0)
    continued = previous + ca.fmin(ca.fmax(change, -largest_change), largest_change)
    free = symbolic_bodies.sparse(unlimited_axes(symbols.robot))
    return Rows(
        jacobian=ca.SX.eye(n_v),
        rate=ca.SX.zeros(n_v),
        lower=continued - jerk * dt**2 - free,
        upper=continued + jerk * dt**2 + free,
        activation=ca.SX.zeros(n_v),
    )


def pace(robot: Robot) -> float:
    """Return the share of their times in which accelerations of a robot rise and fall: the root of its
    size, as for waves (Froude), and 1 of large ones.
    """
    return min(1.0, math.sqrt(size(robot.model) / _LARGE_ROBOT))


def unlimited_axes(robot: Robot) -> np.ndarray:
    """Return (n_v,) infinity for axes that no thruster drives, and that heed no limit; 0 for the
    others.
    """
    unlimited = np.zeros(robot.n_v)
    unlimited[list(thrusters.undriven_axes(robot))] = np.inf
    return unlimited


def smooth_share(desired: ca.SX, acceleration: ca.SX, dt: float, pace: float = 1.0) -> ca.SX:
    """Compute the share (m,) of the `desired` changes (m,) [any/s] that rates can make in this
    tick, so as to arrive smoothly.

    acceleration (m,) [any/s2]: largest of each rate. dt [s]. pace: `pace` of the robot.
    """
    falling = falling_share(desired, acceleration, dt, pace)
    return ca.fmin(_share(desired, acceleration, dt), falling)


def common_share(desired: ca.SX, acceleration: ca.SX, dt: float, pace: float = 1.0) -> ca.SX:
    """Compute the shares (m,) of rows that change in proportion: the smallest `smooth_share` of
    those that the axes can move.

    A row that they move by little, beside the row that they move most, as in a singular posture,
    has its own share: in proportion to it none would move. desired (m,) [any/s]; acceleration (m,)
    [any/s2]; dt [s]; pace: `pace` of the robot.
    """
    share = _share(desired, acceleration, dt)
    excess = _excess(desired, acceleration, dt, pace)
    moved = acceleration > _WEAKLY_MOVED * ca.mmax(acceleration)
    # One root for all of them.
    smallest_share = ca.mmin(ca.if_else(moved, share, ca.inf))
    common = ca.fmin(smallest_share, _falling(ca.mmax(ca.if_else(moved, excess, 0))))
    single_share = ca.fmin(share, _falling(excess))
    return ca.if_else(moved, common, ca.fmin(single_share, common))


def falling_share(desired: ca.SX, acceleration: ca.SX, dt: float, pace: float = 1.0) -> ca.SX:
    """Limit the share like `smooth_share`, for the acceleration limit itself: it falls to 0 on the
    last part of the way.

    desired (m,) [any/s]; acceleration (m,) [any/s2]; dt [s]; pace: `pace` of the robot.
    """
    return _falling(_excess(desired, acceleration, dt, pace))


def _share(desired: ca.SX, acceleration: ca.SX, dt: float) -> ca.SX:
    """Compute the share of the desired change that the acceleration limit allows in one tick."""
    return acceleration * dt / ca.fmax(ca.fabs(desired), _SMALLEST_CHANGE)


def _excess(desired: ca.SX, acceleration: ca.SX, dt: float, pace: float) -> ca.SX:
    """Compute the ratio of the desired change to what the jerk alone allows in one tick."""
    jerk = ca.fmax(ca.fmin(acceleration, ENDLESS), 1 / ENDLESS) / (pace * _FALL)
    return 2 * ca.fabs(desired) / (jerk * dt**2)


def _falling(excess: ca.SX) -> ca.SX:
    """Compute `stopping_speed` of the desired change over that change, without a difference of
    nearly equal numbers.
    """
    return 2 / (1 + ca.sqrt(1 + excess))
