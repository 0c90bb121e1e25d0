"""Draw a robot that stands still in a configuration, with sliders that move its joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.robot import Robot
from uvms_ocp.viz.scene import shapes
from uvms_ocp.viz.scene.animation import draw_robot, joint_node
from uvms_ocp.viz.scene.details import robot_details
from uvms_ocp.viz.scene.page import CommandLog, ScenePage, Visualizer, build_page

_AROUND = 5.0  # [m] that the vehicle can be moved either way
_N_FREE = 6
_UNLIMITED = {"turn": np.pi, "slide": 1.0}  # [rad], [m] either way where a joint has no limit


def posed_page(
    robot: Robot, q: np.ndarray, height: int, live: Mapping[str, Any] | None = None
) -> ScenePage:
    """Return the page of `robot` in the configuration q (n_q,) [m, rad]; height [px] of its frame
    in a notebook. live: JSON values.
    """
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    places = np.array([X.translation for X in list(data.oMi)[1:]])
    centre = (places.min(axis=0) + places.max(axis=0)) / 2
    log = CommandLog()
    draw_still(log, robot, list(data.oMi), centre)
    log.animate({})
    details = robot_details(robot) | {"scenario": robot.name, "points": (places - centre).tolist()}
    details |= {
        "joints": [joint_motion(robot, joint, q) for joint in range(1, robot.model.njoints)],
        "robot": "",
        "live": live,
    }
    lines = links(robot, np.vstack([centre, places]))
    return build_page(
        log, title=robot.name, details=details, height=height, live=live is not None, lines=lines
    )


def links(robot: Robot, places: np.ndarray) -> list[np.ndarray]:
    """Return lines from joint to joint, at their places (n_joints + 1, 3) [m]."""
    return [places[[parent, joint]] for joint, parent in enumerate(robot.model.parents) if parent]


def draw_still(
    log: CommandLog, robot: Robot, placements: Sequence[pin.SE3], centre: np.ndarray
) -> Visualizer:
    """Draw the robot by the placements of its joints; return the root of the scene, whose origin is
    `centre` (3,) [m] in W.
    """
    root = log.visualizer()["scene"]
    root.set_transform(shapes.shifted(-centre))
    draw_robot(root["robot"], robot)
    for joint in range(1, robot.model.njoints):
        root["robot"][joint_node(robot.model, joint)].set_transform(placements[joint].homogeneous)
    return root


def joint_motion(robot: Robot, joint: int, q: np.ndarray) -> dict[str, Any]:
    """Return the transform of a joint of the model, by number, from its values at q (n_q,) [m,
    rad].
    """
    model = robot.model
    model_joint = robot.model.joints[joint]
    data = model_joint.createData()
    model_joint.calc(data, q)
    return {
        "path": ["meshcat", "scene", "robot", joint_node(model, joint)],
        "parent": int(model.parents[joint]) - 1,
        "placement": pin.SE3ToXYZQUAT(model.jointPlacements[joint]).tolist(),
        "name": model.names[joint],
        **_motion(robot, model_joint, data, q),
    }


def _leader(model: pin.Model, v_index: int) -> Any:
    """Return the joint with the velocity of this index, which others mimic."""
    return next(joint for joint in model.joints if joint.idx_v == v_index and joint.nv == 1)


def _motion(robot: Robot, joint_model: Any, data: Any, q: np.ndarray) -> dict[str, Any]:
    """Return the kind of a joint, with axis (3,), ranges and values [rad] or [m] at q (n_q,) [m,
    rad] unless it is held.
    """
    if joint_model.nv == _N_FREE and robot.n_vehicle:
        place = data.M.translation
        turn = pin.rpy.matrixToRpy(data.M.rotation)
        ranges = [(x - _AROUND, x + _AROUND) for x in place.tolist()] + [(-np.pi, np.pi)] * 3
        return {"kind": "free", "ranges": ranges, "values": [*place.tolist(), *turn.tolist()]}
    axis = np.asarray(data.S).reshape(6, -1)
    if np.abs(axis[3:]).any():
        kind = "turn"
        along = axis[3:, 0]
    else:
        kind = "slide"
        along = axis[:3, 0]
    if not joint_model.nv:  # it mimics another one
        mimic = joint_model.extract()
        leader = _leader(robot.model, joint_model.idx_v)
        follows = [leader.id - 1, mimic.scaling, mimic.offset]
        return {
            "kind": kind,
            "axis": (along / mimic.scaling).tolist(),
            "values": [0.0],
            "follows": follows,
        }
    if joint_model.nv != 1 or (np.abs(axis[:3]).any() and np.abs(axis[3:]).any()):
        return {"kind": "held", "pose": pin.SE3ToXYZQUAT(data.M).tolist(), "values": [0.0]}
    if joint_model.nq == 1:
        value = q[joint_model.idx_q]
    else:  # an endless turn has two numbers
        value = pin.log3(data.M.rotation) @ along
    return {
        "kind": kind,
        "axis": along.tolist(),
        "values": [float(value)],
        "ranges": [_range(robot, joint_model, kind)],
    }


def _range(robot: Robot, joint_model: Any, kind: str) -> tuple[float, float]:
    """Return the range between the joint's limits [rad] or [m]."""
    k = joint_model.idx_v - robot.n_vehicle
    lower = float(robot.limits.position_lower[k])
    upper = float(robot.limits.position_upper[k])
    unlimited = _UNLIMITED[kind]
    if not np.isfinite(lower):
        lower = -unlimited
    if not np.isfinite(upper):
        upper = unlimited
    return lower, upper
