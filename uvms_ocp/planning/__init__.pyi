import uvms_ocp.robot.shapes.obstacles

from .conservative_advancement import check_clearance as check_clearance
from .conservative_advancement import clearance_along as clearance_along
from .distances import CoalDistances as CoalDistances
from .request import AXES as AXES
from .request import PlanRequest as PlanRequest
from .request import PlanResult as PlanResult
from .request import PostureGoal as PostureGoal
from .request import ToolGoal as ToolGoal
from .request import plan_path as plan_path
from .request import tool_goal as tool_goal
from .scene import CollisionScene as CollisionScene
from .scene import Coordinates as Coordinates
from .scene import collision_scene as collision_scene
from .scene import coordinates as coordinates
from .soft_collision import CollisionPlan as CollisionPlan
from .soft_collision import PlanStatus as PlanStatus
from .soft_collision import SoftCollisionOptions as SoftCollisionOptions
from .soft_collision import plan_soft_collision as plan_soft_collision
from .soft_collision import sampled_waypoints as sampled_waypoints

Obstacle = uvms_ocp.robot.shapes.obstacles.Obstacle
build_obstacle = uvms_ocp.robot.shapes.obstacles.build_obstacle
describe_obstacle = uvms_ocp.robot.shapes.obstacles.describe_obstacle
mesh_shape = uvms_ocp.robot.shapes.obstacles.mesh_shape
obstacle = uvms_ocp.robot.shapes.obstacles.obstacle
parse_obstacle = uvms_ocp.robot.shapes.obstacles.parse_obstacle
read_obstacles = uvms_ocp.robot.shapes.obstacles.read_obstacles
