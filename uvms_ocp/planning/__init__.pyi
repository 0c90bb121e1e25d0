import uvms_ocp.robot.shapes.obstacles

from .conservative_advancement import (
    check_clearance as check_clearance,
    clearance_along as clearance_along,
)
from .distances import CoalDistances as CoalDistances
from .planned_axes import Coordinates as Coordinates, coordinates as coordinates
from .request import (
    AXES as AXES,
    PlanRequest as PlanRequest,
    PlanResult as PlanResult,
    PostureGoal as PostureGoal,
    ToolGoal as ToolGoal,
    plan_path as plan_path,
    tool_goal as tool_goal,
)
from .rrt_connect import sampled_waypoints as sampled_waypoints
from .scene import CollisionScene as CollisionScene, collision_scene as collision_scene
from .soft_collision import (
    CollisionPlan as CollisionPlan,
    PlanStatus as PlanStatus,
    SoftCollisionOptions as SoftCollisionOptions,
    plan_soft_collision as plan_soft_collision,
)

Obstacle = uvms_ocp.robot.shapes.obstacles.Obstacle
build_obstacle = uvms_ocp.robot.shapes.obstacles.build_obstacle
describe_obstacle = uvms_ocp.robot.shapes.obstacles.describe_obstacle
mesh_shape = uvms_ocp.robot.shapes.obstacles.mesh_shape
obstacle = uvms_ocp.robot.shapes.obstacles.obstacle
parse_obstacle = uvms_ocp.robot.shapes.obstacles.parse_obstacle
read_obstacles = uvms_ocp.robot.shapes.obstacles.read_obstacles
