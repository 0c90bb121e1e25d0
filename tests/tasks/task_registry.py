"""One registry of tasks: a new member is tested by being listed here.

Each entry gives a task and, computed with Pinocchio alone, the displacement of its rows between two
configurations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks.altitude import LandingAltitude, MinimumAltitude
from uvms_ocp.tasks.attitude import Alignment, FieldOfView, HorizontalAttitude
from uvms_ocp.tasks.joints import JointLimits, JointTracking, Manipulability
from uvms_ocp.tasks.pose import ToolPose, ToolPosition, VehiclePose
from uvms_ocp.tasks.task import Task
from uvms_ocp.tasks.vehicle_velocity import NullVelocity, UnderActuation

Displacement = Callable[[Robot, np.ndarray, np.ndarray], np.ndarray]
TARGET = np.array([0.7, -1.1, -4.0])
GOAL = pin.SE3(pin.rpy.rpyToMatrix(0.2, -0.1, 0.9), np.array([0.4, 0.3, -1.0]))


@dataclass(frozen=True)
class Entry:
    task: Task
    displacement: Displacement


def _pose(robot: Robot, q: np.ndarray, frame: str) -> pin.SE3:
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    return data.oMf[robot.frame_id(frame)]


def _moved_frame(frame: str, rows: int = 6) -> Displacement:
    def displacement(robot: Robot, q0: np.ndarray, q1: np.ndarray) -> np.ndarray:
        X0 = _pose(robot, q0, frame)
        X1 = _pose(robot, q1, frame)
        turn = pin.log3(X1.rotation @ X0.rotation.T)
        return np.concatenate([X1.translation - X0.translation, turn])[:rows]

    return displacement


def _velocities(first: int, last: int) -> Displacement:
    return lambda robot, q0, q1: pin.difference(robot.model, q0, q1)[first:last]


def _scalar(value: Callable[[Robot, np.ndarray], float]) -> Displacement:
    return lambda robot, q0, q1: np.array([value(robot, q1) - value(robot, q0)])


def _height(robot: Robot, q: np.ndarray) -> float:
    return float(_pose(robot, q, "altimeter").translation[2])


def _tilt(robot: Robot, q: np.ndarray) -> float:
    return float(np.arccos(_pose(robot, q, "base_link").rotation[2, 2]))


def _misalignment(robot: Robot, q: np.ndarray) -> float:
    X_WB = _pose(robot, q, "base_link")
    d = (TARGET - X_WB.translation) * [1, 1, 0]
    return float(np.arccos(X_WB.rotation[:, 0] @ d / np.linalg.norm(d)))


def _view_angle(robot: Robot, q: np.ndarray) -> float:
    X_WC = _pose(robot, q, "tool")
    d = TARGET - X_WC.translation
    return float(np.arccos(X_WC.rotation[:, 2] @ d / np.linalg.norm(d)))


def _manipulability(robot: Robot, q: np.ndarray) -> float:
    J = pin.computeFrameJacobian(
        robot.model, robot.model.createData(), q, robot.frame_id("tool"), pin.ReferenceFrame.LOCAL
    )[:, robot.joint_v]
    return float(np.sqrt(np.linalg.det(J @ J.T)))


REGISTRY: dict[str, Entry] = {
    "NR": Entry(NullVelocity(), _velocities(0, 6)),
    "UA": Entry(
        UnderActuation(axes=(1, 3)),
        lambda robot, q0, q1: pin.difference(robot.model, q0, q1)[[1, 3]],
    ),
    "JL": Entry(JointLimits(), _velocities(6, 13)),
    "MAC": Entry(MinimumAltitude(), _scalar(_height)),
    "HA": Entry(HorizontalAttitude(), _scalar(_tilt)),
    "AT": Entry(Alignment(goal=TARGET), _scalar(_misalignment)),
    "FV": Entry(FieldOfView(goal=TARGET, frame="tool", axis=(0.0, 0.0, 1.0)), _scalar(_view_angle)),
    "MU": Entry(Manipulability(), _scalar(_manipulability)),
    "LA": Entry(LandingAltitude(), _scalar(_height)),
    "PC": Entry(VehiclePose(goal=GOAL), _moved_frame("base_link")),
    "T": Entry(ToolPose(goal=GOAL), _moved_frame("tool")),
    "TP": Entry(ToolPosition(goal=GOAL), _moved_frame("tool", 3)),
    "MP": Entry(
        JointTracking(joints=("joint4", "joint7"), goal=np.zeros(2)),
        lambda robot, q0, q1: (q1 - q0)[[10, 13]],
    ),
}
