"""Hull and arm stay above a level floor: the height of what is lowest of every shape, which needs no distance."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.terms import At, StageSymbols, Term
from uvms_ocp.sim.contact import skid_points
from uvms_ocp.tasks.task import Residual, bounded_residual

_VERTICAL = 1e-6  # keeps the root of a sine differentiable where a cylinder stands upright


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rim:
    """A point, or a circle around it, fixed to a joint: the end of a shape."""

    joint: int
    centre: np.ndarray
    """(3,) [m] in the frame of the joint."""
    axis: np.ndarray
    """(3,) [-] normal of the circle, in the same frame."""
    radius: float = 0.0
    """[m] of the circle."""
    rounding: float = 0.0
    """[m] of a ball around the point."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class AboveFloor(Term):
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
    """Of the lower side of the hull, and of every shape of the arm."""
    hull = [Rim(joint=1, centre=point, axis=np.zeros(3)) for point in skid_points(robot)]
    first = 2 if robot.n_vehicle else 1
    arm = [
        rim for shape in robot.collision_model.geometryObjects if shape.parentJoint >= first for rim in _rims(shape)
    ]
    return (*hull, *arm)


def _rims(shape: pin.GeometryObject) -> list[Rim]:
    geometry, X = shape.geometry, shape.placement
    if isinstance(geometry, coal.Sphere):
        return [Rim(joint=shape.parentJoint, centre=X.translation, axis=np.zeros(3), rounding=geometry.radius)]
    if isinstance(geometry, coal.Cylinder | coal.Capsule):
        ends = [X.act(np.array([0.0, 0.0, side * geometry.halfLength])) for side in (-1, 1)]
        size = {"rounding" if isinstance(geometry, coal.Capsule) else "radius": geometry.radius}
        return [Rim(joint=shape.parentJoint, centre=end, axis=X.rotation[:, 2], **size) for end in ends]
    geometry.computeLocalAABB()
    ends = np.array([geometry.aabb_local.min_, geometry.aabb_local.max_])
    corners = ends[np.indices((2, 2, 2)).reshape(3, -1).T, np.arange(3)]
    return [Rim(joint=shape.parentJoint, centre=X.act(corner), axis=np.zeros(3)) for corner in corners]
