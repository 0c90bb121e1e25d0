"""EnvironmentSampler of a mission as constraints: a level floor that hull and arm stay above, and obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission_plan.segments import GreedyRollout, HorizonSegment, Margins, active_tasks
from uvms_ocp.ocp import ShapeClearance, Trajectory
from uvms_ocp.ocp.clearance_certificate import SteppedMotion, certificate, shortfall
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.planning.conservative_advancement import ClearanceReport
from uvms_ocp.planning.scene import CollisionScene, collision_scene, coordinates
from uvms_ocp.robot.robot import Robot
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim.dynamic_step import skid_points
from uvms_ocp.tasks import Clearance, MinimumAltitude
from uvms_ocp.tasks.task import Residual, bounded_residual
from uvms_ocp.types import Mask

# Hull and arm stay above a level floor: the height of what is lowest of every shape, which needs no distance.

_VERTICAL = 1e-6  # keeps the root of a sine differentiable where a cylinder stands upright


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rim:
    """A point, or a circle around it, fixed to a joint: the end of a shape."""

    joint: int
    centre: np.ndarray
    """(3,) [m] in the frame of the joint."""
    axis: np.ndarray
    """(3,) normal of the circle, in the same frame."""
    radius: float = 0.0
    """[m] of the circle."""
    rounding: float = 0.0
    """[m] of a ball around the point."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FloorClearance(Term):
    """One row per rim: its lowest point above `height` [m]."""

    at: At = At.PATH
    rims: tuple[Rim, ...]
    height: float
    """[m] in W, of the floor and the margin above it."""

    @property
    def name(self) -> str:
        return "floor"

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        rows = []
        for rim in self.rims:
            pose = stage.tick.kinematics.joint_poses[rim.joint]
            upright = (pose.R @ ca.DM(rim.axis))[2]
            sag = rim.radius * ca.sqrt(ca.fmax(1 - upright**2, 0) + _VERTICAL)
            rows.append((pose.p + pose.R @ ca.DM(rim.centre))[2] - sag - rim.rounding)
        return bounded_residual(ca.vertcat(ca.SX(0, 1), *rows), lower=self.height)


def rims_of(robot: Robot) -> tuple[Rim, ...]:
    """Return the rims of the lower side of the hull, and of every shape of the arm."""
    hull = [Rim(joint=1, centre=point, axis=np.zeros(3)) for point in skid_points(robot)]
    first = 2 if robot.n_vehicle else 1
    arm = [rim for shape in robot.collision_model.geometryObjects if shape.parentJoint >= first for rim in _rims(shape)]
    return (*hull, *arm)


def _rims(shape: pin.GeometryObject) -> list[Rim]:
    geometry, X = shape.geometry, shape.placement
    if isinstance(geometry, coal.Sphere):
        return [Rim(joint=shape.parentJoint, centre=X.translation, axis=np.zeros(3), rounding=geometry.radius)]
    if isinstance(geometry, coal.Cylinder | coal.Capsule):
        ends = [X.act(np.array([0.0, 0.0, side * geometry.halfLength])) for side in (-1, 1)]
        size = {"rounding" if isinstance(geometry, coal.Capsule) else "radius": geometry.radius}
        return [Rim(joint=shape.parentJoint, centre=end, axis=X.rotation[:, 2], **size) for end in ends]
    return [Rim(joint=shape.parentJoint, centre=X.act(corner), axis=np.zeros(3)) for corner in _corners(geometry)]


def _corners(geometry: coal.CollisionGeometry) -> np.ndarray:
    """(8, 3) [m] of the bounding box."""
    geometry.computeLocalAABB()
    extremes = np.array([geometry.aabb_local.min_, geometry.aabb_local.max_])
    return extremes[np.indices((2, 2, 2)).reshape(3, -1).T, np.arange(3)]


# What surrounds a mission, as an optimal control problem takes it: one current, a level floor, obstacles.

_LEVEL = 0.05  # [m] by which a floor may differ along the way
_MISSED = 2e-3  # [m] of a margin
_NEAR = 0.01  # [m] beyond its margin, within which a pair gets rows
_PAIR_ROWS = 4  # per node and pair of links


def floor_along(scenario: Scenario, way: GreedyRollout) -> float:
    """Height [m] of the floor below the way; raises `InvalidInput` where it is not level."""
    if not scenario.robot.n_vehicle:
        return -np.inf
    heights = [scenario.environment.seafloor.height(float(x), float(y)) for x, y in way.q[:, :2]]
    low, high = min(heights), max(heights)
    if high - low > _LEVEL:
        raise InvalidInput(
            f"the floor rises by {high - low:.2g} m along the way; a plan needs one that is level within {_LEVEL:g} m"
        )
    return high


def floor_terms(scenario: Scenario, segments: Sequence[HorizonSegment], floor: float, margins: Margins) -> list[Term]:
    """Hull and arm stay above the floor [m] wherever no task on altitude keeps the robot far from it."""
    if not np.isfinite(floor):
        return []
    rims, found = rims_of(scenario.robot), list[Term]()
    for segment in segments:
        phase = scenario.mission.phases[segment.phase]
        on = active_tasks(phase, scenario.mission.hierarchy.tasks)
        if not any(isinstance(task, MinimumAltitude) and task.name not in segment.waits_for for task in on):
            found.append(FloorClearance(rims=rims, height=floor + margins.altitude, phase=segment.ocp.name))
    return found


def clearance(scenario: Scenario, margins: Margins) -> ShapeClearance | None:
    """The robot keeps away from obstacles, by as much as the mission's own tasks on clearance ask for, and from itself.

    Links that are near each other by design keep half of what they have at rest, and at the start what they have there.
    """
    planned = coordinates(scenario.robot, reference=scenario.start)
    scene = collision_scene(planned, scenario.environment.obstacles)
    asked = [task.threshold for task in scenario.mission.hierarchy.tasks if isinstance(task, Clearance)]
    kept = np.where(_links(scene), np.minimum(margins.links, scene.room), max([margins.position, *asked]))
    return ShapeClearance(scene=scene, margins=kept) if scene.pairs else None


def _links(scene: CollisionScene) -> Mask:
    """(n_pairs,) True for two of them."""
    return np.isfinite(scene.room)


def obstacle_pairs(shapes: ShapeClearance) -> ShapeClearance:
    """Select the pairs with obstacles."""
    return _among(shapes, ~_links(shapes.scene))


def link_pairs(shapes: ShapeClearance, pairs: Mask) -> ShapeClearance:
    """Select the chosen (n_pairs,) pairs of links, with rows of their own."""
    return replace(_among(shapes, pairs), n_pair_rows=_PAIR_ROWS)


def _among(shapes: ShapeClearance, pairs: Mask) -> ShapeClearance:
    return replace(shapes, scene=shapes.scene.among(np.flatnonzero(pairs).tolist()), margins=shapes.margins[pairs])


def violated_links(shapes: ShapeClearance, way: Trajectory) -> Mask:
    """(n_pairs,) True for links that do not keep their margins along a way, at its nodes and between them."""
    return (shortfall(shapes, way, 0.0).max(axis=0) > _MISSED) & _links(shapes.scene)


def near_links(shapes: ShapeClearance, way: Trajectory) -> Mask:
    """(n_pairs,) True for links that nearly do not."""
    return violated_links(replace(shapes, margins=shapes.margins + _NEAR), way)


def certify_along(shapes: ShapeClearance, way: Trajectory) -> ClearanceReport:
    """The certificate that all pairs stay apart along a way, with the least distance that is met, at its nodes too."""
    report = certificate(shapes, way)
    sampled = SteppedMotion(term=shapes, trajectory=way).nearest()
    return replace(report, nearest=min(report.nearest, sampled, key=lambda nearest: nearest.distance))
