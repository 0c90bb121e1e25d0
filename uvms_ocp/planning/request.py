"""One plan from what an engineer asks for: a robot, where it starts, where it goes, and what stands in the way."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from uvms_ocp.arguments import Count, Magnitude, Range, Shape, checked
from uvms_ocp.arrays import Array
from uvms_ocp.collision.coal_distances import CoalDistances
from uvms_ocp.collision.collision_scene import CollisionScene, collision_scene
from uvms_ocp.collision.coordinates import VEHICLE_AXES, Coordinates, coordinates
from uvms_ocp.collision.obstacle_file import build_obstacles
from uvms_ocp.exceptions import NameNotFound
from uvms_ocp.model.robot import Robot
from uvms_ocp.obstacle_data import ObstacleData
from uvms_ocp.planning.goals import Goal, check_way
from uvms_ocp.planning.path_cost import CostWeights
from uvms_ocp.planning.sampling import SamplingOptions
from uvms_ocp.planning.soft_collision import (
    CollisionPlan,
    SoftCollisionOptions,
    plan_soft_collision,
)
from uvms_ocp.trajectories.segment_times import MotionLimits

AXES = ("level", "all", "joints")
"""Planned axes: all but roll and pitch, all, or the joints alone."""


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlanRequest:
    """What to plan."""

    robot: Robot
    start: Annotated[Array, Shape("robot.n_q"), Range(open=True)]
    """(n_q,) [m, rad] configuration."""
    goal: Goal
    obstacles: tuple[ObstacleData, ...] = ()
    axes: str = AXES[0]
    clearance: Magnitude = 0.06
    """[m] wanted from everything; what is verified is that nothing touches."""
    seed: Count = 0


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlanResult:
    """The scene that was built, and the plan; None where no posture reaches the tool's goal."""

    request: PlanRequest
    scene: CollisionScene
    plan: CollisionPlan | None

    @property
    def collision_free(self) -> bool:
        return self.plan is not None and self.plan.collision_free


@checked
def solve(request: PlanRequest) -> PlanResult:
    """Find where to go, then how.

    Raises `NameNotFound` for unknown axes, joints or frames, `InvalidInput` for a start or goal in collision or outside limits,
    a goal on axes that are not planned, a start that is the goal, and two obstacles of one name.
    """
    check_way(request.robot, request.start, request.goal)
    planned = _planned_axes(request)
    scene = collision_scene(planned, build_obstacles(request.obstacles))
    goal = request.goal.as_coordinates(CoalDistances(scene), seed=request.seed)
    if goal is None:
        return PlanResult(request=request, scene=scene, plan=None)
    limits = request.robot.limits
    plan = plan_soft_collision(
        scene,
        np.stack([planned.x(request.start), goal]),
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
