"""Trajectories as functions of time: polynomials, minimum snap, segment times."""

from uvms_ocp.trajectories.min_snap import Boundary as Boundary
from uvms_ocp.trajectories.min_snap import Constraint as Constraint
from uvms_ocp.trajectories.min_snap import CurveSpecification as CurveSpecification
from uvms_ocp.trajectories.min_snap import MinSnap as MinSnap
from uvms_ocp.trajectories.min_snap import MotionLimits as MotionLimits
from uvms_ocp.trajectories.min_snap import min_snap as min_snap
from uvms_ocp.trajectories.min_snap import min_snap_qp as min_snap_qp
from uvms_ocp.trajectories.min_snap import optimal_times as optimal_times
from uvms_ocp.trajectories.min_snap import scale_to_limits as scale_to_limits
from uvms_ocp.trajectories.min_snap import trapezoidal_times as trapezoidal_times
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial as PiecewisePolynomial
from uvms_ocp.trajectories.polynomial import concatenate as concatenate
