"""Shapes of a robot and its obstacles, and which pairs of them can meet."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import chain, combinations

import numpy as np
import pinocchio as pin

from uvms_ocp.robot import unknowns
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.obstacles import Obstacle
from uvms_ocp.robot.shapes.signed_distance import SignedDistances


def shapes_among(robot: Robot, obstacles: Sequence[Obstacle]) -> pin.GeometryModel:
    """Return the robot's collision shapes, then the obstacles, and no pairs yet."""
    geometry = with_pairs(robot.collision_model, ())
    for item in obstacles:
        geometry.addGeometryObject(pin.GeometryObject(item.name, 0, item.X_WO, item.shape))
    return geometry


def self_pairs(robot: Robot) -> list[tuple[int, int]]:
    """Return pairs of shapes on links that are no neighbours and stay apart in the stowed posture:
    others are built to touch.
    """
    joints = [int(shape.parentJoint) for shape in robot.collision_model.geometryObjects]
    parents = list(robot.model.parents)
    separate = list[tuple[int, int]]()
    for (a, joint_a), (b, joint_b) in combinations(enumerate(joints), 2):
        are_neighbours = parents[joint_a] == joint_b or parents[joint_b] == joint_a
        if joint_a != joint_b and not are_neighbours:
            separate.append((a, b))
    distances = stowed_distances(robot, with_pairs(robot.collision_model, separate))
    return [pair for pair, distance in zip(separate, distances, strict=True) if distance > 0.0]


def shapes_in(pairs: Iterable[tuple[int, int]]) -> set[int]:
    """Return the indices of the shapes that are in some pair."""
    return set(chain.from_iterable(pairs))


def stowed_distances(robot: Robot, geometry: pin.GeometryModel) -> np.ndarray:
    """Return the signed distance (n_pairs,) [m] of every pair of the shapes in the stowed posture."""
    data = geometry.createData()
    pin.updateGeometryPlacements(
        robot.model, robot.model.createData(), geometry, data, robot.configuration()
    )
    signed = SignedDistances(geometry)
    return np.array([signed.distance(data, k) for k in range(len(geometry.collisionPairs))])


def with_pairs(shapes: pin.GeometryModel, pairs: Iterable[tuple[int, int]]) -> pin.GeometryModel:
    """Return a copy of the shapes whose pairs are these (by index) alone."""
    geometry = pin.GeometryModel(shapes)
    geometry.removeAllCollisionPairs()
    for first, second in pairs:
        geometry.addCollisionPair(pin.CollisionPair(first, second))
    return geometry


def links_without_shape(robot: Robot) -> tuple[str, ...]:
    """Return the names of the links that have a mass and no collision shape, of which no clearance
    tells, in the order of the robot's frames.
    """
    frames = robot.model.frames
    shapes = robot.collision_model.geometryObjects
    with_shape = {frames[shape.parentFrame].name for shape in shapes}
    names = list[str]()
    for name, mass in unknowns.link_masses(robot.model).items():
        if mass > 0.0 and name not in with_shape:
            names.append(name)
    return tuple(names)
