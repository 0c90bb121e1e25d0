"""Check a motion against the limits and constraints of its problem, at the nodes and between them.

The check knows nothing of a solver: no transcription, planes, scalings or multipliers. The motion
between nodes is that of `Trajectory.state_at`. For each kind of range it finds the largest excess,
where and when it occurs:

- joint positions are parabolas over a step and velocities straight lines: their peaks are exact;
- forces, by inverse dynamics, and rows of terms are sampled between the nodes, more densely where
  they come near their range;
- distances of shapes are measured by coal: no point of a link moves faster than its reach allows, so
  that intervals are halved until they exclude an excess of more than `FINE`, or are too short.

A fixed start may break limits by itself. In the first step only what goes beyond that counts; forces
count from the first moment on, as the motion chooses its acceleration there.
"""

from __future__ import annotations

from uvms_ocp.ocp.motion_constraints import check_shapes, check_term
from uvms_ocp.ocp.motion_dynamics import check_dynamics, check_ends
from uvms_ocp.ocp.motion_limits import (
    check_accelerations,
    check_forces,
    check_positions,
    check_velocities,
)
from uvms_ocp.ocp.motion_scan import Motion
from uvms_ocp.ocp.problem import OcpProblem
from uvms_ocp.ocp.range_check import MotionCheck, RangeCheck
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.trajectory import Trajectory


def motion_check(problem: OcpProblem, trajectory: Trajectory, *, t0: float = 0.0) -> MotionCheck:
    """Check a trajectory of as many steps as the problem has; t0 [s] is the time of its first node,
    for goals and obstacles that move.
    """
    motion = Motion(problem=problem, trajectory=trajectory, t0=t0)
    ranges = [*check_ends(motion), *check_dynamics(motion)]
    if problem.limited:
        ranges += [check_positions(motion), check_velocities(motion), check_accelerations(motion)]
        ranges += check_forces(motion)
    return MotionCheck(
        ranges=(*ranges, *_check_constraints(motion)),
        time_resolution=float(motion.h.max() / motion.looks),
    )


def between_checks(
    problem: OcpProblem, trajectory: Trajectory, *, t0: float = 0.0
) -> tuple[RangeCheck, ...]:
    """Check the ranges that a motion may exceed between nodes though it keeps them at the nodes:
    positions, forces and constraints; see `motion_check`.
    """
    motion = Motion(problem=problem, trajectory=trajectory, t0=t0)
    limits = []
    if problem.limited:
        limits = [check_positions(motion), *check_forces(motion)]
    return (*limits, *_check_constraints(motion))


def _check_constraints(motion: Motion) -> list[RangeCheck]:
    """Check all constraints of the problem: distances of shapes, and rows of terms."""
    checks = []
    for term in motion.problem.constraints:
        if isinstance(term, ShapeClearance):
            checks.append(check_shapes(motion, term))
        else:
            checks.append(check_term(motion, term))
    return checks
