"""Detect joints that are asked to move, are pushed, and stay where they are, as kernels."""

from __future__ import annotations

import math
from typing import Annotated

from uvms_ocp.codegen.kernel_layout import Layout, Sized, Vector
from uvms_ocp.robot.signals import SAME_TIME

JAM_TRAVEL = 0.05
"""[rad, or sizes of the robot] that a joint is asked to go, and does not, before it counts as
jammed.
"""
_MEMORY = 2.0  # [s] of the way that a joint was asked to go
_MOVED = 0.1  # share of that way which counts as having moved
_JAM_EFFORT = 0.2  # share of its effort that must resist it
_JAM_TIME = 0.5  # [s] for which it stands still all the time


class JointFaultMemory(Layout):
    """Verdicts on all joints, with the ways they were asked to go and went."""

    count: int
    """Joints."""
    effort: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [N m or N] limits of the motors."""
    travel: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] that each is asked to go, and does not, before it counts as jammed."""
    started: bool
    t: float
    """[s] of the last look."""
    before: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] positions at the last look."""
    asked: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] ways of late that were commanded."""
    moved: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [rad or m] ways of late that were measured."""
    since: Annotated[Vector, Sized("n_joints")]
    """(n_joints,) [s] time since when a joint stands and resists; infinity where it does not. Kept
    for a jammed joint.
    """
    jammed: Annotated[list[bool], Sized("n_joints")]
    """(n_joints,) which joints are jammed."""
    found: Annotated[list[bool], Sized("n_joints")]
    """(n_joints,) which joints the last sample has found jammed."""


def reset_joints(joint_faults: JointFaultMemory) -> None:
    """Forget the ways of the joints, as encoders that are silent or doubted tell none."""
    joint_faults.started = False
    for j in range(joint_faults.count):
        joint_faults.asked[j] = 0.0
        joint_faults.moved[j] = 0.0
        joint_faults.found[j] = False
        if not joint_faults.jammed[j]:
            joint_faults.since[j] = math.inf


def detect_joint_faults(
    joint_faults: JointFaultMemory, way: Vector, q: Vector, resistance: Vector, t: float
) -> bool:
    """Take in the way (n_joints,) [rad or m] asked since the last look, and q (n_joints,) [rad or
    m] where they are, by the way they went, at time t [s].

    resistance (n_joints,) [N m or N]: what the observer finds to act on the joints beside motors
    and model. Return whether any was found jammed.
    """
    keep = math.exp(-(t - joint_faults.t) / _MEMORY)
    any_found = False
    for j in range(joint_faults.count):
        joint_faults.found[j] = False
        if joint_faults.started:
            joint_faults.asked[j] = keep * joint_faults.asked[j] + way[j]
            joint_faults.moved[j] = keep * joint_faults.moved[j] + q[j] - joint_faults.before[j]
            _look_at_joint(joint_faults, j, resistance[j], t)
        joint_faults.before[j] = q[j]
        any_found = any_found or joint_faults.found[j]
    joint_faults.started = True
    joint_faults.t = t
    return any_found


def _look_at_joint(joint_faults: JointFaultMemory, j: int, resistance: float, t: float) -> None:
    if joint_faults.jammed[j]:
        return
    commanded_travel = abs(joint_faults.asked[j])
    if joint_faults.asked[j] > 0.0:
        against = -resistance
    else:
        against = resistance if joint_faults.asked[j] < 0.0 else 0.0
    stands = (
        commanded_travel > joint_faults.travel[j]
        and abs(joint_faults.moved[j]) < _MOVED * commanded_travel
    )
    if stands and against > _JAM_EFFORT * joint_faults.effort[j]:
        joint_faults.since[j] = min(joint_faults.since[j], t)
    else:
        joint_faults.since[j] = math.inf
    joint_faults.found[j] = t - joint_faults.since[j] >= _JAM_TIME - SAME_TIME
    joint_faults.jammed[j] = joint_faults.found[j]
