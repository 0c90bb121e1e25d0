"""One plan from what an engineer asks for: a robot, where it starts, where it goes, and what stands in the way."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from uvms_ocp.arrays import Array
from uvms_ocp.collision.coal_distances import CoalDistances
from uvms_ocp.collision.collision_scene import CollisionScene, collision_scene
from uvms_ocp.collision.coordinates import VEHICLE_AXES, Coordinates, coordinates
from uvms_ocp.collision.obstacle_file import ObstacleData, check_names
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.model.robot import Robot
from uvms_ocp.planning.inverse_kinematics import ToolGoalOptions, tool_goal
from uvms_ocp.planning.path_cost import CostWeights
from uvms_ocp.planning.sampling import SamplingOptions
from uvms_ocp.planning.soft_collision import (
    CollisionPlan,
    SoftCollisionOptions,
    plan_soft_collision,
)
from uvms_ocp.trajectories.segment_times import MotionLimits

Triple = tuple[float, float, float]

AXES = ("level", "all", "joints")
"""Planned axes: all but roll and pitch, all, or the joints alone."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ToolGoal:
    """A frame of the robot at p_WF [m], with R_WF from roll, pitch, yaw [rad], or any orientation where that is None."""

    position: Triple
    rpy: Triple | None = None
    frame: str = "tool"

    def __post_init__(self) -> None:
        if not np.isfinite([*self.position, *(self.rpy or ())]).all():
            raise InvalidInput(f"the goal of {self.frame!r} is {self.position}, {self.rpy}; give finite numbers.")

    @property
    def target(self) -> pin.SE3 | Array:
        """X_WF, or p_WF (3,)."""
        p = np.array(self.position)
        return p if self.rpy is None else pin.SE3(pin.rpy.rpyToMatrix(np.array(self.rpy)), p)


@dataclass(frozen=True, kw_only=True, slots=True)
class PostureGoal:
    """Vehicle position [m] and roll, pitch, yaw [rad], and joints by name; what is left out stays as at the start."""

    position: Triple | None = None
    rpy: Triple | None = None
    joints: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlanRequest:
    """What to plan."""

    robot: Robot
    start: Array
    """(n_q,) configuration."""
    goal: ToolGoal | PostureGoal
    obstacles: tuple[ObstacleData, ...] = ()
    axes: str = AXES[0]
    clearance: float = 0.06
    """[m] wanted from everything; what is verified is that nothing touches."""
    seed: int = 0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlanResult:
    """The scene that was built, and the plan; None where no posture reaches the tool's goal."""

    request: PlanRequest
    scene: CollisionScene
    plan: CollisionPlan | None

    @property
    def collision_free(self) -> bool:
        return self.plan is not None and self.plan.collision_free


def solve(request: PlanRequest) -> PlanResult:
    """Find where to go, then how.

    Raises:
        NameNotFound: unknown axes, joint or frame.
        InvalidInput: a start or goal in collision or outside limits, a goal on axes that are not planned, a start that
            is the goal, or two obstacles of one name.
    """
    check_names(request.obstacles)
    planned = _planned_axes(request)
    scene = collision_scene(planned, [item.build() for item in request.obstacles])
    start = planned.x(request.start)
    goal = _goal(request, scene, start)
    if goal is None:
        return PlanResult(request=request, scene=scene, plan=None)
    limits = request.robot.limits
    plan = plan_soft_collision(
        scene,
        np.stack([start, goal]),
        limits=MotionLimits(
            velocity=limits.velocity[planned.planned], acceleration=limits.acceleration[planned.planned]
        ),
        options=_options(request),
    )
    return PlanResult(request=request, scene=scene, plan=plan)


def _options(request: PlanRequest) -> SoftCollisionOptions:
    return SoftCollisionOptions(
        weights=CostWeights(clearance=request.clearance),
        sampling=SamplingOptions(seed=request.seed),
        seed=request.seed,
    )


def _planned_axes(request: PlanRequest) -> Coordinates:
    if request.axes not in AXES:
        raise NameNotFound("axes", request.axes, AXES)
    robot = request.robot
    vehicle = VEHICLE_AXES if robot.n_vehicle else ()
    kept = {"all": vehicle, "joints": (), "level": tuple(axis for axis in vehicle if axis not in ("roll", "pitch"))}
    return coordinates(robot, reference=request.start, axes=(*kept[request.axes], *robot.joint_names))


def _goal(request: PlanRequest, scene: CollisionScene, start: Array) -> Array | None:
    """Planned axes (n_axes,) at the goal, or None where no posture was found."""
    if isinstance(request.goal, ToolGoal):
        goal = request.goal
        options = ToolGoalOptions(seed=request.seed)
        return tool_goal(CoalDistances(scene), goal.frame, goal.target, start, options)
    return _posture(request, request.goal, scene.coordinates)


def _posture(request: PlanRequest, goal: PostureGoal, planned: Coordinates) -> Array:
    robot = request.robot
    every = coordinates(robot)
    values = dict(zip(every.names, every.x(request.start), strict=True))
    given = _given_axes(goal)
    for name, value in given.items():
        if name not in values:
            raise NameNotFound("axis", name, every.names)
        if not np.isfinite(value):
            raise InvalidInput(f"the goal has {name} = {value}; give a finite number.")
        if name not in planned.names and abs(value - values[name]) > _SAME:
            raise InvalidInput(
                f"the goal moves {name} from {values[name]:.6g} to {value:.6g}, but it is not among the planned axes; "
                f"leave it or plan others (axes: {', '.join(AXES)})."
            )
    return np.array([given.get(name, values[name]) for name in planned.names])


_SAME = 1e-9


def _given_axes(goal: PostureGoal) -> dict[str, float]:
    parts = (goal.position or (), goal.rpy or ())
    vehicle = [
        (name, value)
        for names, part in zip((VEHICLE_AXES[:3], VEHICLE_AXES[3:]), parts, strict=True)
        for name, value in zip(names, part, strict=False)
    ]
    return {**dict(vehicle), **goal.joints}
