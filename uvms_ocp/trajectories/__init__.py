"""Trajectories as functions of time: polynomials, minimum snap, segment times."""

from uvms_ocp.trajectories.coefficient_qp import min_snap_qp as min_snap_qp
from uvms_ocp.trajectories.curve_conditions import (
    Boundary as Boundary,
    Constraint as Constraint,
    CurveSpecification as CurveSpecification,
)
from uvms_ocp.trajectories.min_snap import MinSnap as MinSnap, min_snap as min_snap
from uvms_ocp.trajectories.polynomial import (
    PiecewisePolynomial as PiecewisePolynomial,
    concatenate as concatenate,
)
from uvms_ocp.trajectories.segment_times import (
    MotionLimits as MotionLimits,
    optimal_times as optimal_times,
    scale_to_limits as scale_to_limits,
    trapezoidal_times as trapezoidal_times,
)
