import uvms_ocp.robot.shapes.obstacles

from .conservative_advancement import (
    check_clearance as check_clearance,
    clearance_along as clearance_along,
)
from .distances import CoalDistances as CoalDistances
from .request import (
    AXES as AXES,
    PlanRequest as PlanRequest,
    PlanResult as PlanResult,
    PostureGoal as PostureGoal,
    ToolGoal as ToolGoal,
    plan_path as plan_path,
    tool_goal as tool_goal,
)
from .scene import (
    CollisionScene as CollisionScene,
    Coordinates as Coordinates,
    collision_scene as collision_scene,
    coordinates as coordinates,
)
from .soft_collision import (
    CollisionPlan as CollisionPlan,
    PlanStatus as PlanStatus,
    SoftCollisionOptions as SoftCollisionOptions,
    plan_soft_collision as plan_soft_collision,
    sampled_waypoints as sampled_waypoints,
)

Obstacle = uvms_ocp.robot.shapes.obstacles.Obstacle
build_obstacle = uvms_ocp.robot.shapes.obstacles.build_obstacle
describe_obstacle = uvms_ocp.robot.shapes.obstacles.describe_obstacle
mesh_shape = uvms_ocp.robot.shapes.obstacles.mesh_shape
obstacle = uvms_ocp.robot.shapes.obstacles.obstacle
parse_obstacle = uvms_ocp.robot.shapes.obstacles.parse_obstacle
read_obstacles = uvms_ocp.robot.shapes.obstacles.read_obstacles
