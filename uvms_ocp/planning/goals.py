"""Where a plan is to end: a frame of the robot at a place, or the vehicle and joints in a posture.

A goal says itself what it means for a path in planned axes, and for optimal control with tasks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import Finite, checked
from uvms_ocp.arrays import Array
from uvms_ocp.collision.conservative_advancement import PairDistances
from uvms_ocp.collision.coordinates import VEHICLE_AXES, coordinates
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.model.kinematics import Kinematics
from uvms_ocp.model.robot import Robot
from uvms_ocp.planning.inverse_kinematics import ToolGoalOptions, tool_goal
from uvms_ocp.tasks.joints import JointTracking
from uvms_ocp.tasks.pose import ToolPose, ToolPosition, VehiclePose
from uvms_ocp.tasks.task import Task

Triple: TypeAlias = tuple[float, float, float]
FiniteTriple: TypeAlias = tuple[Finite, Finite, Finite]

_SAME = 1e-9  # [m or rad] difference between a goal and a start that is none
_FARTHEST, _MOST_TURN = 1e4, 4 * np.pi  # [m] and [rad]


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class ToolGoal:
    """A frame of the robot at a place. Raises `InvalidInput` for numbers that are not finite."""

    position: FiniteTriple
    """[m] p_WF."""
    rpy: FiniteTriple | None = None
    """[rad] Roll, pitch, yaw of R_WF; None for any orientation."""
    frame: str = "tool"

    def __post_init__(self) -> None:
        _check_turn(self.rpy)

    @property
    def target(self) -> pin.SE3 | Array:
        """X_WF, or p_WF (3,) [m]."""
        p = np.array(self.position)
        return p if self.rpy is None else pin.SE3(pin.rpy.rpyToMatrix(np.array(self.rpy)), p)

    def as_coordinates(self, distances: PairDistances, *, seed: int) -> Array | None:
        """Planned axes (n_axes,) [m, rad] with the frame at its goal and nothing touching, or None where no posture was found.

        Raises `FrameNotFound` where the robot has no such frame.
        """
        planned = distances.scene.coordinates
        start = planned.reference[planned.planned]
        return tool_goal(distances, self.frame, self.target, start, ToolGoalOptions(seed=seed))

    def as_tasks(self, robot: Robot, start: Array) -> tuple[Task, ...]:
        """The task that has the goal as its own, wherever the start (n_q,) [m, rad] is.

        Raises `FrameNotFound` where the robot has no such frame.
        """
        robot.frame_id(self.frame)
        if isinstance(self.target, pin.SE3):
            return (ToolPose(frame=self.frame, goal=self.target),)
        return (ToolPosition(frame=self.frame, goal=pin.SE3(np.eye(3), self.target)),)


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class PostureGoal:
    """A posture of the vehicle and joints; what is left out stays as at the start.

    Raises `InvalidInput` for angles beyond two turns.
    """

    position: FiniteTriple | None = None
    """[m] of the vehicle."""
    rpy: FiniteTriple | None = None
    """[rad] Roll, pitch, yaw of the vehicle."""
    joints: Mapping[str, float] = field(default_factory=dict)
    """[m or rad] by name."""

    def __post_init__(self) -> None:
        _check_turn(self.rpy)

    def as_coordinates(self, distances: PairDistances, *, seed: int) -> Array:
        """Planned axes (n_axes,) [m, rad] at the goal.

        Raises `NameNotFound` for an axis that the robot does not have, `InvalidInput` for a number that is not finite and for
        a goal away from the start on an axis that is not planned.
        """
        planned = distances.scene.coordinates
        names = coordinates(planned.robot).names
        values = dict(zip(names, planned.reference.tolist(), strict=True))
        for name, value in self._axes().items():
            if name not in values:
                raise NameNotFound("axis", name, names)
            if not np.isfinite(value):
                raise InvalidInput(f"the goal has {name} = {value}; give a finite number.")
            if name not in planned.names and abs(value - values[name]) > _SAME:
                raise InvalidInput(
                    f"the goal moves {name} from {values[name]:.6g} to {value:.6g}, but the planned axes are "
                    f"{', '.join(planned.names)}; leave it where it is, or plan all axes."
                )
            values[name] = value
        return np.array([values[name] for name in planned.names])

    def _axes(self) -> dict[str, float]:
        """Values of the axes that the goal names."""
        place = dict(zip(VEHICLE_AXES[:3], self.position or (), strict=False))
        attitude = dict(zip(VEHICLE_AXES[3:], self.rpy or (), strict=False))
        return {**place, **attitude, **self.joints}

    def as_tasks(self, robot: Robot, start: Array) -> tuple[Task, ...]:
        """Tasks of the vehicle and of the joints that the goal names; start (n_q,) [m, rad]: configuration.

        Raises `NameNotFound` for a joint that the robot does not have, `InvalidInput` for values outside limits and for a goal
        of the vehicle where there is none.
        """
        q = robot.configuration(position=self.position, rpy=self.rpy, joints=dict(self.joints))
        tasks: list[Task] = []
        if self.position is not None or self.rpy is not None:
            here = Kinematics(robot, start).pose("base_link")
            there = Kinematics(robot, q).pose("base_link")
            position = here.translation if self.position is None else there.translation
            tasks.append(VehiclePose(goal=pin.SE3((here if self.rpy is None else there).rotation, position)))
        if self.joints:
            values = np.array(list(self.joints.values()))
            tasks.append(JointTracking(joints=tuple(self.joints), goal=values))
        return tuple(tasks)


Goal: TypeAlias = ToolGoal | PostureGoal


def check_way(robot: Robot, start: Array, goal: Goal) -> None:
    """Raise `InvalidInput` for a goal that is very far from the start (n_q,) [m, rad]: plans are sampled densely."""
    if goal.position is None or not np.isfinite(goal.position).all():
        return  # said by others, with the axis
    here = start[:3] if robot.n_vehicle else np.zeros(3)
    # Within what can be squared.
    way = float(np.linalg.norm(np.clip(goal.position, -1e99, 1e99) - np.clip(here, -1e99, 1e99)))
    if way > _FARTHEST:
        text = f"the goal {tuple(goal.position)} m is {way:.3g} m from the start; give one within {_FARTHEST:g} m"
        raise InvalidInput(f"{text}: a plan is proven clear every few centimetres, in memory")


def _check_turn(rpy: Triple | None) -> None:
    if rpy is not None and np.isfinite(rpy).all() and np.abs(rpy).max() > _MOST_TURN:
        raise InvalidInput(
            f"roll, pitch and yaw of the goal are {rpy} rad; give angles within two turns, {_MOST_TURN:.4g} rad"
        )
