"""Boxes around the shapes of links, and cylinders in them, for links of which nothing but the shapes
is known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.robot.description import Cylinder, LinkDescription, Pose, Vector3
from uvms_ocp.robot.robot import Robot

_MIN_RADIUS = 1e-4  # [m]; flatter links displace no water worth counting
_ALONG: tuple[Vector3, Vector3, Vector3] = (
    (0.0, np.pi / 2, 0.0),
    (-np.pi / 2, 0.0, 0.0),
    (0.0, 0.0, 0.0),
)
"""Roll, pitch and yaw [rad] that turn a cylinder's z axis to x, y, z."""


_LEAST_GAIN = 0.9  # of the volume along the link's axes: a turned box is smaller than that
_MAX_SHAPES = 20  # of a link whose own axes are tried


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnedBox:
    """A box in the frame of a link."""

    rotation: np.ndarray
    """R (3, 3) from the axes of the box to those of the link."""
    corners: np.ndarray
    """Lower and upper corner (2, 3) [m] along the axes of the box, from the link's origin."""

    @property
    def size(self) -> np.ndarray:
        """Sides (3,) [m] of the box."""
        return np.asarray(np.ptp(self.corners, axis=0))

    @property
    def centre(self) -> np.ndarray:
        """Middle (3,) [m] in the frame of the link."""
        return np.asarray(self.rotation @ self.corners.mean(axis=0))


def cylinders_around_links(robot: Robot) -> dict[str, LinkDescription]:
    """Return one cylinder per frame that carries collision shapes (visual ones where there are
    none).

    The cylinder lies along the longest side of the box around the link's shapes; its diameter is
    the mean of the other two sides, or less where the body would float: boxes around hollow or bent
    links hold more than these. Give measured data where there are any.
    """
    shapes = robot.collision_model if robot.collision_model.ngeoms else robot.visual_model
    cylinders = dict[str, tuple[int, Cylinder]]()
    volumes = dict[int, float]()  # [m3] by joint
    for index in dict.fromkeys(shape.parentFrame for shape in shapes.geometryObjects):
        frame = robot.model.frames[index]
        cylinder = cylinder_in(box_around(robot.model, shapes, frame.name))
        if cylinder is not None:
            cylinders[frame.name] = (frame.parentJoint, cylinder)
            volume = np.pi * cylinder.radius**2 * cylinder.length
            volumes[frame.parentJoint] = volumes.get(frame.parentJoint, 0.0) + volume
    descriptions = dict[str, LinkDescription]()
    for name, (joint, cylinder) in cylinders.items():
        displaced = robot.description.water_density * volumes[joint]  # [kg]
        mass = float(robot.model.inertias[joint].mass)
        thinner = cylinder
        if 0.0 < mass < displaced:
            radius = cylinder.radius * float(np.sqrt(mass / displaced))
            thinner = cylinder.model_copy(update={"radius": radius})
        descriptions[name] = LinkDescription(cylinder=thinner)
    return descriptions


def box_around(
    model: pin.Model, shapes: pin.GeometryModel, frame: str, *, joint: int | None = None
) -> np.ndarray:
    """Return corners (2, 3) [m] of the box around the shapes of a link, in its frame; nan without
    shapes.

    joint: take the shapes of all links that this joint carries.
    """
    index = model.getFrameId(frame)
    X_JF = model.frames[index].placement
    corners = list[np.ndarray]()
    for shape in shapes.geometryObjects:
        if joint is None:
            is_included = shape.parentFrame == index
        else:
            is_included = shape.parentJoint == joint
        if is_included:
            for corner in box_corners(shape.geometry):
                corners.append(X_JF.actInv(shape.placement.act(corner)))
    if not corners:
        return np.full((2, 3), np.nan)
    return np.array([np.min(corners, axis=0), np.max(corners, axis=0)])


def smallest_box(
    model: pin.Model, shapes: pin.GeometryModel, frame: str, *, joint: int | None = None
) -> TurnedBox | None:
    """Return the smallest box around the shapes of a link along its own axes, along those of one of
    the shapes, or along the principal axes of their points; `None` without shapes.

    The link's own axes count unless another box is clearly smaller. joint: take the shapes of all
    links that this joint carries.
    """
    index = model.getFrameId(frame)
    X_JF = model.frames[index].placement
    rotations = [np.eye(3)]
    clouds = list[np.ndarray]()
    for shape in shapes.geometryObjects:
        if joint is None:
            is_included = shape.parentFrame == index
        else:
            is_included = shape.parentJoint == joint
        if is_included:
            X_FS = X_JF.actInv(shape.placement)
            rotations.append(X_FS.rotation)
            clouds.append(_points_of(shape.geometry) @ X_FS.rotation.T + X_FS.translation)
    if not clouds:
        return None
    points = np.concatenate(clouds)
    deviations = points - points.mean(axis=0)
    _, principal_axes = np.linalg.eigh(deviations.T @ deviations)
    smallest: TurnedBox | None = None
    least_volume = np.inf
    for rotation in (*rotations[: _MAX_SHAPES + 1], principal_axes):
        turned = nearest_axes(rotation)
        along = points @ turned
        box = TurnedBox(rotation=turned, corners=np.array([along.min(axis=0), along.max(axis=0)]))
        volume = float(np.prod(box.size))
        if smallest is None or volume < least_volume:
            smallest = box
            least_volume = _LEAST_GAIN * volume
    return smallest


def nearest_axes(rotation: np.ndarray) -> np.ndarray:
    """Return the axes, columns (3, 3) of either sign and in any order, as the rotation that turns
    least.
    """
    return max(_orders_of(rotation), key=lambda turned: float(np.trace(turned)))


def _orders_of(axes: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the 24 rotations whose columns are these axes (3, 3) or their opposites."""
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            turned = axes[:, order] * np.array(signs)
            if np.linalg.det(turned) > 0.0:
                yield turned


def _points_of(geometry: coal.CollisionGeometry) -> np.ndarray:
    """Return points (n, 3) [m] that span a shape, in its own frame: its vertices, or the corners of
    the box around it.
    """
    if isinstance(geometry, coal.BVHModelBase):
        return np.array(geometry.vertices(), dtype=float).reshape(-1, 3)
    if isinstance(geometry, coal.ConvexBase):
        return np.array(geometry.points(), dtype=float).reshape(-1, 3)
    return box_corners(geometry)


def box_corners(geometry: coal.CollisionGeometry) -> np.ndarray:
    """Return corners (8, 3) [m] of the box around a shape, in its own frame."""
    geometry.computeLocalAABB()
    box = geometry.aabb_local
    return np.array(list(product(*zip(box.min_, box.max_, strict=True))))


def cylinder_in(corners: np.ndarray) -> Cylinder | None:
    """Return the cylinder along the longest side of a box with corners (n, 3) [m]; `None` for a
    flat one.
    """
    lower = corners.min(axis=0)
    upper = corners.max(axis=0)
    sides = upper - lower
    axis = int(np.argmax(sides))
    radius = float(np.delete(sides, axis).mean()) / 2.0
    if not radius >= _MIN_RADIUS:
        return None
    x, y, z = (0.5 * (lower + upper)).tolist()
    return Cylinder(
        radius=radius, length=float(sides[axis]), pose=Pose(position=(x, y, z), rpy=_ALONG[axis])
    )
