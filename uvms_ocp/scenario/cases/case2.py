"""Case 2 of the paper: the arm follows a trajectory that was planned around obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked
from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission.phase import Phase
from uvms_ocp.planning import (
    CoalDistances,
    collision_scene,
    coordinates,
    path_cost,
    soft_collision,
    tool_goal,
)
from uvms_ocp.robot import Kinematics, Obstacle, Robot, obstacle
from uvms_ocp.scenario.cases.case1 import case1
from uvms_ocp.scenario.preflight.phase_forecast import forecast
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.seafloor import floor_obstacle
from uvms_ocp.tasks import JointTracking, NullVelocity, ToolPose, ToolPosition, goals
from uvms_ocp.trajectories import MotionLimits, PiecewisePolynomial

ROCK = obstacle("rock", coal.Sphere(0.12), (12.25, 37.1, -39.8))
"""Obstacle beside the target, in the way of the elbow."""
_SHARE = 0.4  # of the joint limits that the plan uses: the rest is for the tool task to correct


@checked
def case2(
    *,
    with_mp: bool = True,
    obstacles: Sequence[Obstacle] = (ROCK,),
    clearance: float = 0.05,
    **options: Any,
) -> Scenario:
    """Return Case 1 with an arm trajectory planned by minimum snap and soft collision cost
    ([Gao2022] Case 2).

    The trajectory of all joints leads from the stowed posture to the goal, past obstacles, floor
    and hull, for the place where pre-flight expects the vehicle to land. In D the tool follows its
    tool path, and MP, at the lowest priority, the last four joints of it; JL is on in all phases.
    Planned and tracked tool path end within 1 mm, and the robot stays clear of the rock. with_mp:
    False is D of Case 1 with neither plan nor MP, to compare the joint motion. clearance [m]:
    wanted by the plan. Other options as for `case1`. Raises `InvalidInput` where no plan is free of
    collision.
    """
    scenario = case1(**options)
    scenario = replace(
        scenario,
        name="case2",
        environment=replace(scenario.environment, obstacles=tuple(obstacles)),
    )
    plan = plan_arm(scenario, clearance)
    if plan.status is not soft_collision.PlanStatus.FREE:
        raise InvalidInput(f"the plan of the arm is {plan.status.value}; {plan.status.advice}")
    phases = tuple(
        _following(scenario, phase, plan.trajectory, with_mp) for phase in scenario.mission.phases
    )
    return replace(scenario, mission=replace(scenario.mission, phases=phases))


def plan_arm(scenario: Scenario, clearance: float = 0.05) -> soft_collision.CollisionPlan:
    """Plan a trajectory of all joints from the start to the tool goal, for the vehicle where it is
    expected to land.

    clearance [m]: wanted from obstacles, floor and hull. Raises `InvalidInput` where no free
    posture reaches the goal.
    """
    robot = scenario.robot
    base = landed_configuration(scenario)
    x, y, _ = base[:3]
    around = (
        *scenario.environment.obstacles,
        floor_obstacle(scenario.environment.seafloor, centre=(x, y), extent=6.0),
    )
    planned = coordinates(robot, reference=base, axes=robot.joint_names)
    distances = CoalDistances(collision_scene(planned, around))
    goal = next(
        task
        for task in scenario.mission.hierarchy.tasks
        if isinstance(task, ToolPose | ToolPosition)
    )
    start = planned.x(base)
    pose, _ = goals.evaluate_pose(goal.name, goal.goal, 0.0)
    end = tool_goal(
        distances, goal.frame, pose if isinstance(goal, ToolPose) else pose.translation, start
    )
    if end is None:
        raise InvalidInput(
            f"no posture clear of collision reaches the goal of {goal.name} from where the vehicle"
            " lands"
        )
    velocity, acceleration = (
        _SHARE * axis_limits[robot.joint_v]
        for axis_limits in (robot.limits.velocity, robot.limits.acceleration)
    )
    limits = MotionLimits(velocity=velocity, acceleration=acceleration)
    options = soft_collision.SoftCollisionOptions(
        weights=path_cost.CostWeights(clearance=clearance)
    )
    return soft_collision.plan_soft_collision(
        distances.scene, np.stack([start, end]), limits=limits, options=options
    )


def landed_configuration(scenario: Scenario) -> np.ndarray:
    """Return q (n_q,) [m, rad] where the vehicle is expected to land, with the joints as at the
    start.
    """
    setup = scenario.setup()
    visit = next(visit for visit in forecast(setup) if visit.active(NullVelocity) is not None)
    return visit.stances[0].configuration(setup)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ToolPath:
    """The tool's pose along a trajectory of the joints, for a vehicle that stands still: a
    reference.
    """

    robot: Robot
    frame: str
    base: np.ndarray
    """(n_q,) [m, rad] configuration whose joints are replaced."""
    joints: PiecewisePolynomial

    @property
    def end(self) -> float:
        """Time [s] at which the joints are at rest again."""
        return self.joints.end

    def __call__(self, t: float) -> tuple[pin.SE3, np.ndarray]:
        """Return X_WT and its rate (6,) in W, linear rows first, at time t [s]."""
        value, rate = self.joints(t)
        q = self.base.copy()
        lower = self.robot.limits.position_lower
        upper = self.robot.limits.position_upper
        q[self.robot.joint_q] = np.clip(value, lower, upper)
        kinematics = Kinematics(self.robot, q)
        return kinematics.pose(self.frame), kinematics.jacobian(self.frame)[
            :, self.robot.joint_v
        ] @ rate


def _following(
    scenario: Scenario, phase: Phase, joints: PiecewisePolynomial, with_mp: bool
) -> Phase:
    """Return phase D with the planned goals; other phases as they are."""
    if phase.name != "D":
        return phase
    tasks = scenario.mission.hierarchy.tasks
    tool = next(task for task in tasks if isinstance(task, ToolPose | ToolPosition))
    posture = next(task for task in tasks if isinstance(task, JointTracking))
    path = ToolPath(
        robot=scenario.robot, frame=tool.frame, base=landed_configuration(scenario), joints=joints
    )
    wrist = [scenario.robot.joint_names.index(name) for name in posture.joints]
    if not with_mp:
        return replace(phase, activations={**phase.activations, posture.name: 0.0})
    return replace(phase, goals={**phase.goals, tool.name: path, posture.name: joints.axes(wrist)})
