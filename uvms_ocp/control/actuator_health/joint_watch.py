"""Joints that are asked to move, are pushed, and do not, as kernels."""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.functions.kernels.layout import Layout, Sized, Vector

_MEMORY = 2.0  # [s] of the way that a joint was asked to go
_MOVED = 0.1  # share of that way which counts as having moved


class JointWatch(Layout):
    """Verdicts on all joints, with the ways they were asked to go and went."""

    count: int
    """[-] joints."""
    effort: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [N m or N] limits."""
    jam_travel: float
    """[rad or m] as the next two of `ActuatorHealthTuning`."""
    jam_effort: float
    """[-]"""
    jam_time: float
    """[s]"""
    started: bool
    t: float
    """[s] of the last look."""
    before: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] where they were then."""
    asked: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] ways of late."""
    moved: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] likewise."""
    since: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [s] from which on it stands and resists; infinity where it does not. Of what is jammed it stays."""
    jammed: Annotated[list[bool], Sized("n_joints")]
    """(n_joints,)"""
    found: Annotated[list[bool], Sized("n_joints")]
    """(n_joints,) jammed, by the last look."""


def forget_joints(w: JointWatch) -> None:
    """Encoders are silent or doubted."""
    w.started = False
    for j in range(w.count):
        w.asked[j] = 0.0
        w.moved[j] = 0.0
        w.found[j] = False
        if not w.jammed[j]:
            w.since[j] = math.inf


def look_at_joints(w: JointWatch, way: Vector, q: Vector, resistance: Vector, t: float) -> bool:
    """Take in the way (n_joints,) [rad or m] asked since the last look, and q (n_joints,) [rad or m] where they are, by the way
    they went, at time t [s].

    resistance (n_joints,) [N m or N]: what the observer finds to act on the joints beside motors and model. Whether any was
    found jammed.
    """
    keep, any_found = math.exp(-(t - w.t) / _MEMORY), False
    for j in range(w.count):
        w.found[j] = False
        if w.started:
            w.asked[j] = keep * w.asked[j] + way[j]
            w.moved[j] = keep * w.moved[j] + q[j] - w.before[j]
            _look_at_joint(w, j, resistance[j], t)
        w.before[j] = q[j]
        any_found = any_found or w.found[j]
    w.started = True
    w.t = t
    return any_found


def _look_at_joint(w: JointWatch, j: int, resistance: float, t: float) -> None:
    if w.jammed[j]:
        return
    wanted = abs(w.asked[j])
    against = -resistance if w.asked[j] > 0.0 else resistance if w.asked[j] < 0.0 else 0.0
    stands = wanted > w.jam_travel and abs(w.moved[j]) < _MOVED * wanted
    w.since[j] = min(w.since[j], t) if stands and against > w.jam_effort * w.effort[j] else math.inf
    w.found[j] = t - w.since[j] >= w.jam_time - 1e-9
    w.jammed[j] = w.found[j]
