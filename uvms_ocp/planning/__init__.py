"""Paths around obstacles: scenes, distances, proof between samples, and curves that bend."""

from uvms_ocp.planning.conservative_advancement import check_clearance as check_clearance
from uvms_ocp.planning.conservative_advancement import clearance_along as clearance_along
from uvms_ocp.planning.distances import CoalDistances as CoalDistances
from uvms_ocp.planning.request import AXES as AXES
from uvms_ocp.planning.request import PlanRequest as PlanRequest
from uvms_ocp.planning.request import PlanResult as PlanResult
from uvms_ocp.planning.request import PostureGoal as PostureGoal
from uvms_ocp.planning.request import ToolGoal as ToolGoal
from uvms_ocp.planning.request import plan_path as plan_path
from uvms_ocp.planning.request import tool_goal as tool_goal
from uvms_ocp.planning.scene import CollisionScene as CollisionScene
from uvms_ocp.planning.scene import Coordinates as Coordinates
from uvms_ocp.planning.scene import collision_scene as collision_scene
from uvms_ocp.planning.scene import coordinates as coordinates
from uvms_ocp.planning.soft_collision import CollisionPlan as CollisionPlan
from uvms_ocp.planning.soft_collision import PlanStatus as PlanStatus
from uvms_ocp.planning.soft_collision import SoftCollisionOptions as SoftCollisionOptions
from uvms_ocp.planning.soft_collision import plan_soft_collision as plan_soft_collision
from uvms_ocp.planning.soft_collision import sampled_waypoints as sampled_waypoints
from uvms_ocp.robot.shapes.obstacles import Obstacle as Obstacle
from uvms_ocp.robot.shapes.obstacles import build_obstacle as build_obstacle
from uvms_ocp.robot.shapes.obstacles import describe_obstacle as describe_obstacle
from uvms_ocp.robot.shapes.obstacles import mesh_shape as mesh_shape
from uvms_ocp.robot.shapes.obstacles import obstacle as obstacle
from uvms_ocp.robot.shapes.obstacles import parse_obstacle as parse_obstacle
from uvms_ocp.robot.shapes.obstacles import read_obstacles as read_obstacles
