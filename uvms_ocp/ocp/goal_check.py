"""A goal that only a robot inside something could reach is said so before anything is solved."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.collision.coal_distances import CoalDistances
from uvms_ocp.collision.collision_scene import CollisionScene
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot
from uvms_ocp.planning.goals import Goal, PostureGoal, ToolGoal


def check_goal(scene: CollisionScene, goal: Goal, start: np.ndarray) -> None:
    """Raise `InvalidInput` where shapes that a goal leaves no choice would touch; start (n_q,) [m, rad].

    It names the shapes and their depth: of a posture those of the vehicle and the joints that it says; of a tool in a pose those
    on its link; of a tool at a place the point itself.
    """
    if isinstance(goal, ToolGoal):
        _check_tool(scene, goal)
    scene.check_apart(goal_distances(scene, goal, start), "the goal")


def start_distances(scene: CollisionScene, start: np.ndarray) -> np.ndarray:
    """(n_pairs,) [m] at the start (n_q,) [m, rad]."""
    return CoalDistances(scene).distances_at(start[None])[0]


def goal_distances(scene: CollisionScene, goal: Goal, start: np.ndarray) -> np.ndarray:
    """(n_pairs,) [m] of the pairs whose places a posture decides, infinite for others; start (n_q,) [m, rad]."""
    if isinstance(goal, ToolGoal):
        return np.full(scene.n_pairs, np.inf)
    robot = scene.coordinates.robot
    q = robot.configuration(position=goal.position, rpy=goal.rpy, joints=dict(goal.joints)).copy()
    if robot.n_vehicle:
        q[:3] = start[:3] if goal.position is None else q[:3]
        q[3:7] = start[3:7] if goal.rpy is None else q[3:7]
    known = _known_joints(robot, goal)
    pairs = [{pair.first_joint, pair.second_joint} <= known for pair in scene.pairs]
    return np.where(pairs, start_distances(scene, q), np.inf)


def _known_joints(robot: Robot, goal: PostureGoal) -> set[int]:
    """Joints whose places the goal decides, the world among them: those behind joints that it all names."""
    known, model = {0}, robot.model
    for joint in range(1, model.njoints):
        vehicle = model.joints[joint].nv == 6
        named = goal.position is not None or goal.rpy is not None if vehicle else model.names[joint] in goal.joints
        if named and model.parents[joint] in known:
            known.add(joint)
    return known


def _check_tool(scene: CollisionScene, goal: ToolGoal) -> None:
    robot, shapes = scene.coordinates.robot, scene.geometry.geometryObjects
    frame = robot.model.frames[robot.frame_id(goal.frame)]
    placed: list[tuple[str, coal.CollisionGeometry, pin.SE3]] = []
    if isinstance(goal.target, pin.SE3):
        X_WJ = goal.target * frame.placement.inverse()
        own = [k for k, shape in enumerate(shapes) if shape.parentJoint == frame.parentJoint]
        placed = [(shapes[k].name, shapes[k].geometry, X_WJ * shapes[k].placement) for k in own if k < _first(scene)]
    else:
        placed = [(goal.frame, coal.Sphere(_POINT), pin.SE3(np.eye(3), goal.target))]
    for k in range(_first(scene), scene.geometry.ngeoms):
        for name, shape, X in placed:
            depth = -_distance(shapes[k].geometry, shapes[k].placement, shape, X)
            if depth >= 0.0:
                pair = f"{shapes[k].name} - {name}"
                text = f"the goal is in collision: {pair} overlap by {depth:.3g} m"
                raise InvalidInput(f"{text}; move it or the obstacle")


_POINT = 1e-6  # [m] radius of a ball that stands for a point


def _first(scene: CollisionScene) -> int:
    """Index of the first obstacle."""
    return int(scene.coordinates.robot.collision_model.ngeoms)


def _distance(
    first: coal.CollisionGeometry, X_first: pin.SE3, second: coal.CollisionGeometry, X_second: pin.SE3
) -> float:
    places = [coal.Transform3s(X.rotation, X.translation) for X in (X_first, X_second)]
    result = coal.DistanceResult()
    return float(coal.distance(first, places[0], second, places[1], coal.DistanceRequest(), result))
