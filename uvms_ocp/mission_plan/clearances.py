"""Constraints that keep the robot of a mission plan away from the floor, from obstacles and from itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission_plan.segments import GreedyRollout, HorizonSegment, PlanMargins, active_tasks
from uvms_ocp.ocp import Trajectory
from uvms_ocp.ocp.clearance_certificate import SteppedMotion, certificate, shortfall
from uvms_ocp.ocp.shape_clearance import ShapeClearance
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.planning.conservative_advancement import ClearanceReport
from uvms_ocp.planning.planned_axes import coordinates
from uvms_ocp.planning.scene import CollisionScene, collision_scene
from uvms_ocp.robot.link_boxes import box_corners
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.shapes.hull import skid_points
from uvms_ocp.robot.size import size
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.tasks import Clearance, MinimumAltitude
from uvms_ocp.tasks.task import Residual, bounded_residual
from uvms_ocp.types import Mask

_ROUNDING = 1e-6  # keeps the root of a sine differentiable where a cylinder stands upright
# sizes of the robot, and [m] at most
_LEVEL = (0.2, 0.05)  # between heights of a floor, up to which it counts as level
_MISSED = (0.008, 2e-3)  # by which a plan may fall short of a margin
_NEAR = (0.04, 0.01)  # from its margin, from which on a pair of links gets rows
_PAIR_ROWS = 4  # rows per node and pair of links


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rim:
    """A point, or a circle around it, fixed to a joint: the end of a shape."""

    joint: int
    centre: np.ndarray
    """(3,) [m] centre in the frame of the joint."""
    axis: np.ndarray
    """(3,) normal of the circle, in the same frame."""
    radius: float = 0.0
    """[m] radius of the circle."""
    rounding: float = 0.0
    """[m] radius of a ball around the point."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FloorClearance(Term):
    """Keep the lowest point of every rim above `height` [m], one row per rim."""

    name = "floor"
    at: At = At.PATH
    rims: tuple[Rim, ...]
    """Ends of the shapes that could touch the floor."""
    height: float
    """[m] height in W of the floor and the margin above it."""

    def residual(self, stage: StageSymbols, parameters: ca.SX) -> Residual:
        heights = []
        for rim in self.rims:
            pose = stage.tick.kinematics.joint_poses[rim.joint]
            upright = (pose.R @ ca.DM(rim.axis))[2]
            sag = rim.radius * ca.sqrt(ca.fmax(1 - upright**2, 0) + _ROUNDING)
            centre_height = (pose.p + pose.R @ ca.DM(rim.centre))[2]
            heights.append(centre_height - sag - rim.rounding)
        return bounded_residual(ca.vertcat(ca.SX(0, 1), *heights), lower=self.height)


def rims_of(robot: Robot) -> tuple[Rim, ...]:
    """Return the rims of the lower side of the hull, and of every shape of the arm."""
    rims = []
    for point in skid_points(robot):
        rims.append(Rim(joint=1, centre=point, axis=np.zeros(3)))
    first_arm_joint = 2 if robot.n_vehicle else 1
    for shape in robot.collision_model.geometryObjects:
        if shape.parentJoint >= first_arm_joint:
            rims += _rims(shape)
    return tuple(rims)


def _rims(shape: pin.GeometryObject) -> list[Rim]:
    """Return the ends of a shape: centre of a sphere, two rims of a cylinder or capsule, corners of
    any other shape's box.
    """
    geometry = shape.geometry
    joint = shape.parentJoint
    placement = shape.placement
    no_axis = np.zeros(3)
    if isinstance(geometry, coal.Sphere):
        return [
            Rim(joint=joint, centre=placement.translation, axis=no_axis, rounding=geometry.radius)
        ]
    rims = []
    if isinstance(geometry, coal.Cylinder | coal.Capsule):
        if isinstance(geometry, coal.Capsule):
            radius = 0.0
            rounding = geometry.radius
        else:
            radius = geometry.radius
            rounding = 0.0
        for side in (-1, 1):
            centre = placement.act(np.array([0.0, 0.0, side * geometry.halfLength]))
            axis = placement.rotation[:, 2]
            rims.append(
                Rim(joint=joint, centre=centre, axis=axis, radius=radius, rounding=rounding)
            )
        return rims
    for corner in box_corners(geometry):
        rims.append(Rim(joint=joint, centre=placement.act(corner), axis=no_axis))
    return rims


def floor_height(scenario: Scenario, rollout: GreedyRollout) -> float:
    """Return the height [m] of the floor below a rollout; raises `InvalidInput` where it is not
    level.
    """
    if not scenario.robot.n_vehicle:
        return -np.inf
    seafloor = scenario.environment.seafloor
    heights = [seafloor.height(float(x), float(y)) for x, y in rollout.q[:, :2]]
    lowest = min(heights)
    highest = max(heights)
    level = _length(_LEVEL, scenario.robot)
    if highest - lowest > level:
        problem = f"the floor rises by {highest - lowest:.2g} m along the way"
        raise InvalidInput(f"{problem}; a plan needs one that is level within {level:.2g} m")
    return highest


def floor_terms(
    scenario: Scenario, segments: Sequence[HorizonSegment], floor: float, margins: PlanMargins
) -> list[Term]:
    """Return terms that keep hull and arm above the floor [m], one for each segment without a task
    on altitude.
    """
    if not np.isfinite(floor):
        return []
    rims = rims_of(scenario.robot)
    terms = list[Term]()
    for segment in segments:
        if not _keeps_altitude(scenario, segment):
            height = floor + margins.altitude
            terms.append(FloorClearance(rims=rims, height=height, phase=segment.ocp.name))
    return terms


def _keeps_altitude(scenario: Scenario, segment: HorizonSegment) -> bool:
    """Check for a task on altitude that holds all along a segment."""
    phase = scenario.mission.phases[segment.phase]
    for task in active_tasks(phase, scenario.mission.hierarchy.tasks):
        if isinstance(task, MinimumAltitude) and task.name not in segment.waits_for:
            return True
    return False


def shape_clearance(scenario: Scenario, margins: PlanMargins) -> ShapeClearance | None:
    """Return the term that keeps the robot away from obstacles and from itself, each pair by the
    largest threshold that tasks of the mission have for it; `None` where nothing can meet.

    Links that are near each other by design keep half of their distance at rest, and at the start
    the distance that they have there.
    """
    scene = collision_scene(
        coordinates(scenario.robot, reference=scenario.start), scenario.environment.obstacles
    )
    if not scene.pairs:
        return None
    largest_threshold: dict[str, float] = {}
    for task in scenario.mission.hierarchy.tasks:
        if isinstance(task, Clearance):
            for name in task.model.pair_names:
                previous = largest_threshold.get(name, -np.inf)
                largest_threshold[name] = max(task.threshold, previous)
    thresholds = [largest_threshold.get(pair.name, 0.0) for pair in scene.pairs]
    minimum_margins = np.where(_links(scene), margins.links, margins.position)
    pair_margins = np.minimum(np.maximum(minimum_margins, thresholds), scene.room)
    return ShapeClearance(scene=scene, margins=pair_margins)


def _links(scene: CollisionScene) -> Mask:
    """Return True for pairs (n_pairs,) of two links."""
    return np.isfinite(scene.room)


def _length(number: tuple[float, float], robot: Robot) -> float:
    """Return a length [m] that is a share of the robot's size, with the largest that it is [m]."""
    share, largest = number
    return min(share * size(robot.model), largest)


def obstacle_pairs(shapes: ShapeClearance) -> ShapeClearance:
    """Select the pairs with obstacles."""
    return _among(shapes, ~_links(shapes.scene))


def link_pairs(shapes: ShapeClearance, pairs: Mask) -> ShapeClearance:
    """Select the chosen (n_pairs,) pairs of links, with rows of their own."""
    return replace(_among(shapes, pairs), n_pair_rows=_PAIR_ROWS)


def _among(shapes: ShapeClearance, pairs: Mask) -> ShapeClearance:
    """Select the chosen (n_pairs,) pairs."""
    return replace(
        shapes,
        scene=shapes.scene.among(np.flatnonzero(pairs).tolist()),
        margins=shapes.margins[pairs],
    )


def violated_links(shapes: ShapeClearance, trajectory: Trajectory) -> Mask:
    """Return True for pairs (n_pairs,) of links that do not keep their margins along a trajectory,
    at its nodes and between them.
    """
    largest_shortfall = shortfall(shapes, trajectory, 0.0).max(axis=0)
    missed = _length(_MISSED, shapes.scene.coordinates.robot)
    return (largest_shortfall > missed) & _links(shapes.scene)


def near_links(shapes: ShapeClearance, trajectory: Trajectory) -> Mask:
    """Return True for pairs (n_pairs,) of links that nearly miss their margins along a
    trajectory.
    """
    nearer = shapes.margins + _length(_NEAR, shapes.scene.coordinates.robot)
    return violated_links(replace(shapes, margins=nearer), trajectory)


def certify_along(shapes: ShapeClearance, trajectory: Trajectory) -> ClearanceReport:
    """Certify that all pairs stay apart along a trajectory, with the smallest distance on it, at
    its nodes too.
    """
    report = certificate(shapes, trajectory)
    sampled = SteppedMotion(term=shapes, trajectory=trajectory).nearest()
    if sampled.distance < report.nearest.distance:
        return replace(report, nearest=sampled)
    return report
