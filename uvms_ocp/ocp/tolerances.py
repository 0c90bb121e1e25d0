"""Tolerances of the judge of plans: within which a motion that is called solved keeps what it
promises.
"""

from __future__ import annotations

from uvms_ocp.record.meta_values import MetaValue


class VerdictTolerances(MetaValue):
    """Tolerances within which a motion that is called solved keeps what it promises."""

    motion: float = 1e-4
    """[m, rad, m/s, rad/s] Distance between a node and where its predecessor leads."""
    forces: float = 1e-3
    """[share of the largest force] Miss of the forces that move it, and excess over their limits in
    the middle of steps.
    """
    force_between: float = 1e-2
    """[share of the limit] Excess of thrust and torque anywhere else in a step."""
    ranges: float = 3e-4
    """[unit of the quantity] Excess of positions, velocities, accelerations and rows of constraints
    over their ranges, at nodes and between.
    """
    clearance: float = 1e-3
    """[m] Lack of distance between shapes, at nodes and between."""
    goal: float = 1e-3
    """Residual of a level of goals that is met; of weights below 1 times their root."""
    gain: float = 2e-3
    """[share of the residual] Fall that one more step may promise for a level."""
    gain_floor: float = 1e-5
    """Gain of a residual that is none."""


TOLERANCES = VerdictTolerances()
"""Tolerances of every plan."""
