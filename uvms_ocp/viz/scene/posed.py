"""A robot that stands still in a configuration, and what the page needs to move its joints by sliders."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot
from uvms_ocp.viz.scene.animation import draw_robot, joint_node
from uvms_ocp.viz.scene.page.viewer import CommandLog, ScenePage, build_page
from uvms_ocp.viz.scene.page_details import robot_details
from uvms_ocp.viz.scene.shapes import shifted

_AROUND = 5.0  # [m] that the vehicle can be moved either way
_N_FREE = 6
_UNLIMITED = {"turn": np.pi, "slide": 1.0}  # [rad], [m] either way where a joint has no limit
_FROM_THE_SIDE = [0.5, -1.0, 0.45]


def posed_page(robot: Robot, q: np.ndarray, height: int) -> ScenePage:
    """The page of `robot` in the configuration q (n_q,) [m, rad]; height [px] of its frame in a notebook."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    places = np.array([X.translation for X in list(data.oMi)[1:]])
    centre = (places.min(axis=0) + places.max(axis=0)) / 2
    log = CommandLog()
    root = log.visualizer()["scene"]
    root.set_transform(shifted(-centre))
    draw_robot(root["robot"], robot)
    for joint in range(1, robot.model.njoints):
        root["robot"][joint_node(robot.model, joint)].set_transform(data.oMi[joint].homogeneous)
    log.animate({})
    details = STILL | robot_details(robot) | {"scenario": robot.name, "points": (places - centre).tolist()}
    joints = [_joint(robot, joint, q) for joint in range(1, robot.model.njoints)]
    return build_page(log, title=robot.name, details=details | {"joints": joints, "robot": ""}, height=height)


STILL: dict[str, Any] = {
    "known": "",
    "duration": 0.0,
    "speed": 1,
    "times": [0.0],
    "start_view": "mission",
    "direction": _FROM_THE_SIDE,
    "close_direction": _FROM_THE_SIDE,
    **dict.fromkeys(("floor", "relief", "witness")),
    **dict.fromkeys(("speeds", "labels", "phases", "faults", "health", "alarms"), ()),
    **dict.fromkeys(("trails", "arrows", "legend", "readouts", "annotations"), ()),
}
"""Of a page on which nothing moves by itself."""


def _joint(robot: Robot, joint: int, q: np.ndarray) -> dict[str, Any]:
    """What moves a joint of the model, by number, from its values at q (n_q,) [m, rad]."""
    model, own = robot.model, robot.model.joints[joint]
    data = own.createData()
    own.calc(data, q)
    return {
        "path": ["meshcat", "scene", "robot", joint_node(model, joint)],
        "parent": int(model.parents[joint]) - 1,
        "placement": pin.SE3ToXYZQUAT(model.jointPlacements[joint]).tolist(),
        "name": model.names[joint],
        **_motion(robot, own, data, q),
    }


def _motion(robot: Robot, own: Any, data: Any, q: np.ndarray) -> dict[str, Any]:
    """The kind of a joint, its axis (3,) [-], ranges and values [rad] or [m] at q (n_q,) [m, rad]; `held`: without."""
    if own.nv == _N_FREE and robot.n_vehicle:
        place, turn = data.M.translation, pin.rpy.matrixToRpy(data.M.rotation)
        ranges = [(x - _AROUND, x + _AROUND) for x in place.tolist()] + [(-np.pi, np.pi)] * 3
        return {"kind": "free", "ranges": ranges, "values": [*place.tolist(), *turn.tolist()]}
    axis = np.asarray(data.S).reshape(6, -1)
    if own.nv != 1 or (np.abs(axis[:3]).any() and np.abs(axis[3:]).any()):
        return {"kind": "held", "pose": pin.SE3ToXYZQUAT(data.M).tolist(), "values": [0.0]}
    kind, along = ("turn", axis[3:, 0]) if np.abs(axis[3:]).any() else ("slide", axis[:3, 0])
    value = q[own.idx_q] if own.nq == 1 else pin.log3(data.M.rotation) @ along  # an endless turn has two numbers
    return {"kind": kind, "axis": along.tolist(), "values": [float(value)], "ranges": [_range(robot, own, kind)]}


def _range(robot: Robot, own: Any, kind: str) -> tuple[float, float]:
    """Between the joint's limits [rad] or [m]."""
    k = own.idx_v - robot.n_vehicle
    lower, upper = float(robot.limits.position_lower[k]), float(robot.limits.position_upper[k])
    wide = _UNLIMITED[kind]
    return lower if np.isfinite(lower) else -wide, upper if np.isfinite(upper) else wide
