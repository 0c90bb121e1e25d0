"""Tasks on poses: vehicle pose (PC), tool pose (T) and tool position."""

from __future__ import annotations

from typing import ClassVar

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.robot import spatial, thrusters
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks.approach_speed import saturate
from uvms_ocp.tasks.goals import PoseGoal, evaluate_pose
from uvms_ocp.tasks.task import (
    Residual,
    Rows,
    Task,
    TaskClass,
    TickSymbols,
    determined_by_goal,
    equality_rows,
    zero_residual,
)
from uvms_ocp.types import Positive

_N_POSE = 12 + 6  # p (3), R column by column (9), rate (6)
_POSE_NUMBERS = ("gain_linear", "gain_angular", "saturation_linear", "saturation_angular")
"""`symbolic_numbers` of tasks on a pose."""


@checked_dataclass(eq=False)
class PoseTask(Task):
    """A frame F reaches a pose and follows it ([Gao2022] eqs 28-33, and the tool's CartError).

    Rows: twist of F in W at its origin, linear rows first. Rate: feed-forward plus ``[gain_linear
    (p_goal - p); gain_angular log3(R_goal R')]``, each half saturated with its direction kept.
    Where F is fixed to a vehicle whose thrusters do not drive every axis, the angular rows and the
    orientation error are those about the axes of B that they drive.
    """

    symbolic_numbers: ClassVar[tuple[str, ...]] = _POSE_NUMBERS
    frame: str
    """F."""
    goal: PoseGoal
    """X_WF [m]."""
    gain_linear: Positive
    """[1/s] Rate that is asked for, per error."""
    gain_angular: Positive
    """[1/s] Rate that is asked for, per error."""
    saturation_linear: Positive = 0.5
    """[m/s] Largest rate that is asked for."""
    saturation_angular: Positive = 0.5
    """[rad/s] Largest rate that is asked for."""

    def __post_init__(self) -> None:
        evaluate_pose(self.name, self.goal, 0.0)

    def n_parameters(self, robot: Robot) -> int:
        return _N_POSE

    @determined_by_goal
    def reference(self, t: float) -> np.ndarray:
        return pose_parameters(*evaluate_pose(self.name, self.goal, t))

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """``[p_goal - p; log3(R_goal R')]`` = 0, [m] and [rad]."""
        R_WF, p_WF = symbols.kinematics.pose(self.frame)
        R_goal = ca.reshape(parameters[3:12], 3, 3)
        return zero_residual(ca.vertcat(parameters[:3] - p_WF, spatial.log3(R_goal @ R_WF.T)))

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        error_linear, error_angular = ca.vertsplit(self.residual(symbols, parameters).value, 3)
        jacobian = symbols.kinematics.jacobian(self.frame)
        ahead = parameters[12:]
        turns = thrusters.driven_turns(symbols.robot, self.frame)
        if turns is not None:
            about = symbols.R_WB[:, list(turns)].T
            error_angular = about @ error_angular
            jacobian = ca.vertcat(jacobian[:3, :], about @ jacobian[3:, :])
            ahead = ca.vertcat(ahead[:3, :], about @ ahead[3:, :])
        rate = ahead + ca.vertcat(
            saturate(self.gain_linear * error_linear, self.saturation_linear),
            saturate(self.gain_angular * error_angular, self.saturation_angular),
        )
        quantities = {
            "position_error": ca.norm_2(error_linear),
            "orientation_error": ca.norm_2(error_angular),
            "horizontal_error": ca.norm_2(error_linear[:2]),
        }
        return equality_rows(jacobian, rate, quantities)


@checked_dataclass(eq=False)
class VehiclePose(PoseTask):
    """PC: the vehicle reaches a way point."""

    symbolic_numbers: ClassVar[tuple[str, ...]] = _POSE_NUMBERS
    name: str = "PC"
    task_class: TaskClass = TaskClass.ACTION
    frame: str = "base_link"
    gain_linear: Positive = 0.2
    """[1/s] Rate that is asked for, per error."""
    gain_angular: Positive = 0.5
    """[1/s] Rate that is asked for, per error."""


@checked_dataclass(eq=False)
class ToolPose(PoseTask):
    """T: the tool reaches a pose."""

    symbolic_numbers: ClassVar[tuple[str, ...]] = _POSE_NUMBERS
    name: str = "T"
    task_class: TaskClass = TaskClass.ACTION
    frame: str = "tool"
    gain_linear: Positive = 0.6
    """[1/s] Rate that is asked for, per error."""
    gain_angular: Positive = 0.6
    """[1/s] Rate that is asked for, per error."""


@checked_dataclass(eq=False)
class ToolPosition(Task):
    """The origin of a frame reaches a position; its orientation stays free."""

    symbolic_numbers: ClassVar[tuple[str, ...]] = ("gain", "saturation")
    name: str = "TP"
    task_class: TaskClass = TaskClass.ACTION
    frame: str = "tool"
    """F."""
    goal: PoseGoal
    """X_WF [m], of which the translation is used."""
    gain: Positive = 0.6
    """[1/s] Rate that is asked for, per error."""
    saturation: Positive = 0.5
    """[m/s] Largest rate that is asked for."""

    def __post_init__(self) -> None:
        evaluate_pose(self.name, self.goal, 0.0)

    def n_parameters(self, robot: Robot) -> int:
        return 6

    @determined_by_goal
    def reference(self, t: float) -> np.ndarray:
        pose, rate = evaluate_pose(self.name, self.goal, t)
        return np.concatenate([pose.translation, rate[:3]])

    def residual(self, symbols: TickSymbols, parameters: ca.SX) -> Residual:
        """``p_goal - p`` = 0 [m]."""
        return zero_residual(parameters[:3] - symbols.kinematics.pose(self.frame)[1])

    def rows(self, symbols: TickSymbols, parameters: ca.SX) -> Rows:
        error = self.residual(symbols, parameters).value
        rate = parameters[3:] + saturate(self.gain * error, self.saturation)
        return equality_rows(
            symbols.kinematics.jacobian(self.frame)[:3, :],
            rate,
            {"position_error": ca.norm_2(error)},
        )


def pose_parameters(pose: pin.SE3, rate: np.ndarray) -> np.ndarray:
    """Return pose [m] and rate (6,) [m/s, rad/s] as the flat vector (18,) that `PoseTask.rows` reads."""
    return np.concatenate([pose.translation, pose.rotation.ravel(order="F"), rate])
