"""Ahead of time: trajectories, their times, and their clearance from obstacles."""

from .certificate import check_clearance as check_clearance
from .certificate import clearance_along as clearance_along
from .clearance import CoalDistances as CoalDistances
from .collision_scene import CollisionScene as CollisionScene
from .collision_scene import Obstacle as Obstacle
from .collision_scene import collision_scene as collision_scene
from .collision_scene import obstacle as obstacle
from .coordinates import Coordinates as Coordinates
from .coordinates import coordinates as coordinates
from .inverse_kinematics import tool_goal as tool_goal
from .min_snap import Boundary as Boundary
from .min_snap import Constraint as Constraint
from .min_snap import MinSnap as MinSnap
from .min_snap import min_snap as min_snap
from .polynomial import PiecewisePolynomial as PiecewisePolynomial
from .polynomial import concatenate as concatenate
from .qp_form import min_snap_qp as min_snap_qp
from .sampling import sampled_waypoints as sampled_waypoints
from .segment_times import MotionLimits as MotionLimits
from .segment_times import optimal_times as optimal_times
from .segment_times import scale_to_limits as scale_to_limits
from .segment_times import trapezoidal_times as trapezoidal_times
from .soft_collision import CollisionPlan as CollisionPlan
from .soft_collision import PlanStatus as PlanStatus
from .soft_collision import SoftCollisionOptions as SoftCollisionOptions
from .soft_collision import plan_soft_collision as plan_soft_collision
