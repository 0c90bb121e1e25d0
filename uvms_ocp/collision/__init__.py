"""A robot and obstacles in, how near things are out, and proof of it between samples."""

from uvms_ocp.collision.coal_distances import CoalDistances as CoalDistances
from uvms_ocp.collision.collision_scene import CollisionScene as CollisionScene
from uvms_ocp.collision.collision_scene import collision_scene as collision_scene
from uvms_ocp.collision.conservative_advancement import check_clearance as check_clearance
from uvms_ocp.collision.conservative_advancement import clearance_along as clearance_along
from uvms_ocp.collision.coordinates import Coordinates as Coordinates
from uvms_ocp.collision.coordinates import coordinates as coordinates
from uvms_ocp.collision.obstacle_file import build_obstacle as build_obstacle
from uvms_ocp.collision.obstacle_file import describe_obstacle as describe_obstacle
from uvms_ocp.collision.obstacle_file import obstacle_from_words as obstacle_from_words
from uvms_ocp.collision.obstacle_file import read_obstacles as read_obstacles
from uvms_ocp.model.shapes.obstacles import Obstacle as Obstacle
from uvms_ocp.model.shapes.obstacles import mesh_shape as mesh_shape
from uvms_ocp.model.shapes.obstacles import obstacle as obstacle
from uvms_ocp.obstacle_data import ObstacleData as ObstacleData
