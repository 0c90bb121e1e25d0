"""Contact of the vehicle's hull with the seafloor: a spring and damper at each corner of its underside.

The floor pushes and never pulls; friction is Coulomb's, regularised below a creeping speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.model.robot import Robot


@dataclass(frozen=True, kw_only=True, slots=True)
class ContactModel:
    """Stiffness and damping per corner. Raises `InvalidInput` for a number that is not > 0.

    The values are assumed: no public measurement of a skid on sediment.
    """

    stiffness: float = 2e4
    """[N/m]"""
    damping: float = 2e3
    """[N s/m]"""
    friction: float = 0.5
    """[-]"""
    creep: float = 0.01
    """[m/s] speed below which friction is viscous."""

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping", "friction", "creep"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InvalidInput(f"contact {name} = {value}; give a finite value > 0")

    def force(self, depth: ca.SX, velocity_W: ca.SX, normal_W: ca.SX, dt: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Force (3,) [N] in W on a point `depth` [m] below the floor that moves with velocity_W (3,) [m/s], and its slope.

        The slope (3, 3) [N s/m], minus the derivative with respect to velocity over a step dt [s], makes the step implicit.
        """
        speed, damping = ca.dot(velocity_W, normal_W), self.damping + dt * self.stiffness
        pressing = ca.if_else(depth > 0, ca.fmax(self.stiffness * depth - damping * speed, 0), 0)
        sliding = velocity_W - speed * normal_W
        grip = self.friction * pressing / ca.sqrt(ca.sumsqr(sliding) + self.creep**2)
        across = ca.SX.eye(3) - normal_W @ normal_W.T
        slope = ca.if_else(pressing > 0, damping, 0) * (normal_W @ normal_W.T) + grip * across
        return pressing * normal_W - grip * sliding, slope


def skid_points(robot: Robot) -> np.ndarray:
    """Lower corners (4, 3) [m] of the box around the vehicle's collision shapes, in the frame of the vehicle.

    (0, 3) for a robot with a fixed base or without collision shapes on its vehicle.
    """
    hull = [shape for shape in robot.collision_model.geometryObjects if shape.parentJoint == 1]
    if not robot.n_vehicle or not hull:
        return np.zeros((0, 3))
    corners = np.concatenate([_box_corners(shape) for shape in hull])
    (x0, y0, z0), (x1, y1, _) = corners.min(axis=0), corners.max(axis=0)
    return np.array([[x0, y0, z0], [x0, y1, z0], [x1, y0, z0], [x1, y1, z0]])


def _box_corners(shape: object) -> np.ndarray:
    """Corners (8, 3) [m] of a shape's own bounding box, in the frame of the vehicle."""
    shape.geometry.computeLocalAABB()  # type: ignore[attr-defined]
    box = shape.geometry.aabb_local  # type: ignore[attr-defined]
    ends = np.array([box.min_, box.max_])
    corners = np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    placement = shape.placement  # type: ignore[attr-defined]
    return corners @ placement.rotation.T + placement.translation
