"""Paths around obstacles: scenes, distances, proof between samples, and curves that bend."""

from uvms_ocp.lazy_names import attach_stub
from uvms_ocp.robot.shapes.obstacles import (
    Obstacle as Obstacle,
    build_obstacle as build_obstacle,
    describe_obstacle as describe_obstacle,
    mesh_shape as mesh_shape,
    obstacle as obstacle,
    parse_obstacle as parse_obstacle,
    read_obstacles as read_obstacles,
)

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
__all__ += [
    "Obstacle",
    "build_obstacle",
    "describe_obstacle",
    "mesh_shape",
    "obstacle",
    "parse_obstacle",
    "read_obstacles",
]
