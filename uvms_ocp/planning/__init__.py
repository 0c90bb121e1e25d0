"""A start, a goal and obstacles in, a path that bends around them out."""

from uvms_ocp.planning.goals import PostureGoal as PostureGoal
from uvms_ocp.planning.goals import ToolGoal as ToolGoal
from uvms_ocp.planning.inverse_kinematics import tool_goal as tool_goal
from uvms_ocp.planning.request import AXES as AXES
from uvms_ocp.planning.request import PlanRequest as PlanRequest
from uvms_ocp.planning.request import PlanResult as PlanResult
from uvms_ocp.planning.request import solve as solve
from uvms_ocp.planning.sampling import sampled_waypoints as sampled_waypoints
from uvms_ocp.planning.soft_collision import CollisionPlan as CollisionPlan
from uvms_ocp.planning.soft_collision import PlanStatus as PlanStatus
from uvms_ocp.planning.soft_collision import SoftCollisionOptions as SoftCollisionOptions
from uvms_ocp.planning.soft_collision import plan_soft_collision as plan_soft_collision
