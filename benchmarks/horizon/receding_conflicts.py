"""Goals that exclude each other for a while, over a receding horizon: who gives way, and who comes
back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from horizon.following import CURRENT, start_of
from uvms_ocp.ocp.ball_clearance import Ball, BallClearance
from uvms_ocp.ocp.problem import OcpLevel, OcpProblem, single_phase
from uvms_ocp.ocp.terms import At, Effort, Posture, Smoothness, StageSymbols, TaskTerm, Term
from uvms_ocp.robot.kinematics import Kinematics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import State
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.goals import PoseReference
from uvms_ocp.tasks.pose import ToolPose, VehiclePose
from uvms_ocp.tasks.task import Residual

WAY = 0.9  # [m] of a goal, out and back
SPEED = 0.3  # [m/s] of a goal
WAIT = 0.5
"""[s] before a goal leaves and before it comes back."""
SETTLING = 1.5
"""[s] after its return, from when on the tool must be back."""
STRETCHED = (0.0, -1.2, 0.0, 0.0, 0.0, -0.9, 0.0)
"""[rad] joints with a straight elbow, from where no small motion brings the tool nearer to the
vehicle.
"""
CHEAP = OcpLevel(name="effort", terms=(Effort(), Smoothness(weight=0.09)))
MARGIN = 0.05  # [m] of clearance that is wanted
LEEWAY = 0.012  # [m] that plans keep on top: gusts, and the ways between nodes, take some


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OutAndBack:
    """How far along its way something is that goes out and comes back, at rest before, between and
    after.
    """

    way: float
    """[m]"""
    speed: float
    """[m/s]"""
    begin: float = WAIT
    """[s] when it leaves; before 0 for something that is out at first."""

    @property
    def returned(self) -> float:
        """[s] when it is back."""
        return self.begin + 2 * self.way / self.speed + WAIT

    def at(self, t: float) -> tuple[float, float]:
        """[m] and [m/s]."""
        duration = self.way / self.speed
        back = self.begin + duration + WAIT
        place = min(max(t - self.begin, 0.0), duration) - min(max(t - back, 0.0), duration)
        rate = float(self.begin < t < self.begin + duration) - float(back < t < self.returned)
        return self.speed * place, self.speed * rate


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MovingGoal:
    """A pose that goes out and back along a direction."""

    first: pin.SE3
    direction: np.ndarray
    """(3,) in W."""
    motion: OutAndBack

    def __call__(self, t: float) -> tuple[pin.SE3, np.ndarray]:
        place, rate = self.motion.at(t)
        moved = self.first.translation + place * self.direction
        velocity = np.concatenate([rate * self.direction, np.zeros(3)])
        return pin.SE3(self.first.rotation, moved), velocity


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ClosingIn(Term):
    """Clearance from one obstacle that comes and goes."""

    at: At = At.PATH
    clearance: BallClearance
    direction: np.ndarray
    """(3,) in W, from where it is at first."""
    motion: OutAndBack

    @property
    def name(self) -> str:
        return self.clearance.name

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        return self.clearance.residual(stage, parameters)

    def n_parameters(self, robot: Robot) -> int:
        return self.clearance.n_parameters(robot)

    def reference(self, t: float) -> np.ndarray:
        moved = self.clearance.reference(t)
        moved[:3] += self.motion.at(t)[0] * self.direction
        return moved

    def gap(self, robot: Robot, q: np.ndarray, t: float) -> float:
        """[m] true distance at a configuration q (n_q,)."""
        place = self.reference(t)
        data = robot.model.createData()
        pin.framesForwardKinematics(robot.model, data, q)
        gaps = []
        for ball in self.clearance.robot_balls:
            X_WF = data.oMf[robot.frame_id(str(ball.frame))]
            centre = X_WF.act(np.array(ball.centre))
            gaps.append(float(np.linalg.norm(centre - place[:3])) - ball.radius)
        return min(gaps) - place[3] + self.clearance.margin


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RecedingConflict:
    """A problem whose levels are in each other's way for a while."""

    name: str
    problem: OcpProblem
    goal: PoseReference
    """Goal of the tool over time."""
    returned: float
    """[s] when the goal, or what keeps the tool from it, is back where it was."""
    obstacle: ClosingIn | None = None

    @property
    def seconds(self) -> float:
        """[s] of a run."""
        return self.returned + SETTLING + 2.0

    def as_sum(self, weight: float) -> OcpProblem:
        """One level, in which the terms of a level weigh so many times those of the next."""
        terms = []
        levels_below = len(self.problem.levels)
        for level in self.problem.levels:
            levels_below -= 1
            for term in level.terms:
                terms.append(replace(term, weight=term.weight * weight**levels_below))
        return replace(self.problem, levels=(OcpLevel(name="sum", terms=tuple(terms)),))


def ahead(robot: Robot) -> np.ndarray:
    """(3,) where the robot looks at first, in W."""
    pose = Kinematics(robot, start_of(robot)).pose("base_link")
    return np.asarray(pose.rotation[:, 0])


def tool_level(goal: PoseReference, *more: Term) -> OcpLevel:
    """Along the way and at its end."""
    task = ToolPose(goal=goal)
    return OcpLevel(
        name="tool",
        terms=(
            TaskTerm(task=task, at=At.PATH, weight=100.0),
            TaskTerm(task=task, weight=9.0),
            *more,
        ),
    )


def _problem(robot: Robot, levels: list[OcpLevel], q: np.ndarray) -> OcpProblem:
    """Make a problem over the receding horizon, from rest at q (n_q,)."""
    start = State(q=q, v=np.zeros(robot.n_v))
    return single_phase(
        robot=robot, start=start, duration=3.0, n_steps=20, levels=levels, current=CURRENT
    )


def moving_goal(robot: Robot, begin: float = WAIT) -> MovingGoal:
    first = Kinematics(robot, start_of(robot)).pose("tool")
    return MovingGoal(
        first=first, direction=ahead(robot), motion=OutAndBack(way=WAY, speed=SPEED, begin=begin)
    )


def tilt_above(robot: Robot) -> RecedingConflict:
    """The vehicle must stay level and go along."""
    goal = moving_goal(robot)
    tilt = OcpLevel(
        name="tilt", terms=(TaskTerm(task=HorizontalAttitude(), at=At.PATH, weight=100.0),)
    )
    problem = _problem(robot, [tilt, tool_level(goal), CHEAP], start_of(robot))
    return RecedingConflict(
        name="tilt above tool", problem=problem, goal=goal, returned=goal.motion.returned
    )


def vehicle_above(robot: Robot, *, stretched: bool = False) -> RecedingConflict:
    """The vehicle must stay where it is: the goal leaves the reach of the arm, or is out of it at
    first.

    A little weight of posture in the tool's own level says on which side the elbow bends. One end
    of its range is just beyond the straight arm, and an elbow that is pressed against it would stay
    there.
    """
    if stretched:
        name = "vehicle above tool, from a stretched arm"
        goal = moving_goal(robot, -3.0)
        q = robot.configuration(position=(0, 0, -5), rpy=(0, 0, 0.5), joints=STRETCHED)
    else:
        name = "vehicle above tool"
        goal = moving_goal(robot)
        q = start_of(robot)
    vehicle = VehiclePose(goal=Kinematics(robot, start_of(robot)).pose("base_link"))
    stay = OcpLevel(name="vehicle", terms=(TaskTerm(task=vehicle, at=At.PATH, weight=100.0),))
    level = tool_level(goal, Posture(q=start_of(robot), weight=1.0))
    return RecedingConflict(
        name=name,
        problem=_problem(robot, [stay, level, CHEAP], q),
        goal=goal,
        returned=goal.motion.returned,
    )


def clearance_above(robot: Robot) -> RecedingConflict:
    """A ball comes to where the tool is to be, and leaves again."""
    first = Kinematics(robot, start_of(robot)).pose("tool")
    side = np.array([-ahead(robot)[1], ahead(robot)[0], 0.0])
    centre = first.translation - 1.0 * side
    balls = (Ball(frame="tool", radius=0.06), Ball(frame="flange", radius=0.08))
    clearance = BallClearance(
        robot_balls=balls,
        obstacles=(Ball(centre=tuple(centre.tolist()), radius=0.15),),
        margin=MARGIN + LEEWAY,
    )
    motion = OutAndBack(way=0.9, speed=0.2)
    obstacle = ClosingIn(clearance=clearance, direction=side, motion=motion, weight=100.0)
    goal: Any = _Still(first)
    levels = [OcpLevel(name="clearance", terms=(obstacle,)), tool_level(goal), CHEAP]
    problem = _problem(robot, levels, start_of(robot))
    return RecedingConflict(
        name="clearance above tool",
        problem=problem,
        goal=goal,
        returned=motion.returned,
        obstacle=obstacle,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Still:
    pose: pin.SE3

    def __call__(self, t: float) -> tuple[pin.SE3, np.ndarray]:
        return self.pose, np.zeros(6)


def _stretched(robot: Robot) -> RecedingConflict:
    return vehicle_above(robot, stretched=True)


CONFLICTS: tuple[Callable[[Robot], RecedingConflict], ...] = (
    tilt_above,
    vehicle_above,
    _stretched,
    clearance_above,
)
