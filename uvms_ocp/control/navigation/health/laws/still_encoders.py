"""Encoders that do not change by a bit while their joints are asked to move.

This holds for exact and for coarse encoders too: a joint that follows its command changes them. Joints with locked brakes
are not asked to move, and robots whose joints have several numbers each are not judged.
"""

from __future__ import annotations

from typing import Annotated

from uvms_ocp.control.navigation.health.reasons import Reason, Why, give
from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector


class StillEncoders(Layout):
    """How far each joint was asked to go since its encoder last changed."""

    n: int
    """[-] joints, 0 where they are not judged."""
    allowed: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] that may be asked: some travel, and what encoders are late by at full speed."""
    rates: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad/s or m/s] that have been asked since the last tick."""
    asked: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m]"""
    started: bool
    last: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] the newest value."""


def ask(e: StillEncoders, moving: bool, dt: float) -> None:
    """The rates that have been asked for dt [s]; moving: there was a command, and no brakes."""
    for i in range(e.n):
        e.asked[i] = e.asked[i] + e.rates[i] * dt if moving else 0.0


def stands_still(e: StillEncoders, value: Vector, why: Why) -> bool:
    """Whether an encoder counts as frozen, by the newest value (n_joints,) [rad or m]."""
    worst, excess = 0, 0.0
    for i in range(e.n):
        if e.started and value[i] != e.last[i]:
            e.asked[i] = 0.0
        e.last[i] = value[i]
        beyond = abs(e.asked[i]) - e.allowed[i]
        if beyond > excess:
            worst = i
            excess = beyond
    e.started = True
    if excess > 0.0:
        give(why, Reason.STILL, worst, e.asked[worst])
    return excess > 0.0
