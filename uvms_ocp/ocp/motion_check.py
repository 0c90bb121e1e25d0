"""Check a motion against its problem, at the nodes and between them, by these two alone.

Nothing of a solver is known here: no transcription, planes, scalings or multipliers. What the
motion is between nodes is what `Trajectory.state_at` says. Of each kind of range it is found by how
much it is left, where and when:

- joint positions are parabolas over a step and velocities straight lines: their peaks are exact;
- forces are those of inverse dynamics at the state between the nodes, and rows of terms those of
  the term there: looked at densely, and more closely where they come near their range;
- shapes and the links among themselves are measured by coal, and no point of them moves faster than
  its reach: intervals are halved until that excludes more than `FINE`, or are too short.

What a start that is given breaks by itself is no fault of the motion: in the first step only what
goes beyond it counts. Forces are the motion's own from the first moment on: it chooses its
acceleration there.
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
        ranges=(*ranges, *_constraints(motion)),
        time_resolution=float(motion.h.max() / motion.looks),
    )


def between_checks(
    problem: OcpProblem, trajectory: Trajectory, *, t0: float = 0.0
) -> tuple[RangeCheck, ...]:
    """Check what may be left between nodes though it is kept at them: positions, forces and
    constraints; see `motion_check`.
    """
    motion = Motion(problem=problem, trajectory=trajectory, t0=t0)
    limits = []
    if problem.limited:
        limits = [check_positions(motion), *check_forces(motion)]
    return (*limits, *_constraints(motion))


def _constraints(motion: Motion) -> list[RangeCheck]:
    checks = []
    for term in motion.problem.constraints:
        if isinstance(term, ShapeClearance):
            checks.append(check_shapes(motion, term))
        else:
            checks.append(check_term(motion, term))
    return checks
