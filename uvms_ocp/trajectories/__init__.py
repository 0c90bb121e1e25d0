"""Trajectories as functions of time: polynomials, minimum snap, segment times."""

from uvms_ocp.trajectories.min_snap import (
    Boundary as Boundary,
    Constraint as Constraint,
    CurveSpecification as CurveSpecification,
    MinSnap as MinSnap,
    MotionLimits as MotionLimits,
    min_snap as min_snap,
    min_snap_qp as min_snap_qp,
    optimal_times as optimal_times,
    scale_to_limits as scale_to_limits,
    trapezoidal_times as trapezoidal_times,
)
from uvms_ocp.trajectories.polynomial import (
    PiecewisePolynomial as PiecewisePolynomial,
    concatenate as concatenate,
)
