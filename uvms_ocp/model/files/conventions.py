"""North-east-down data to forward-left-up, once, when a file is read; nothing after it knows of the other axes."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from uvms_ocp.model.files.description import (
    Box,
    Cylinder,
    LinkCoefficients,
    LinkDescription,
    Matrix6,
    Pose,
    RobotDescription,
    Sphere,
    Thruster,
    TrimBody,
    Vector3,
    Vector6,
)

# A half turn about x: a rotation, so twists and wrenches turn like any other vectors.
_TURN = np.diag([1.0, -1.0, -1.0])
_TURN6 = np.kron(np.eye(2), _TURN)

_Shape = TypeVar("_Shape", Cylinder, Box, Sphere)


def forward_left_up(description: RobotDescription) -> RobotDescription:
    """Return the same robot with ``convention: FLU``."""
    if description.convention == "FLU":
        return description
    return description.model_copy(
        update={
            "convention": "FLU",
            "links": {name: _link(link) for name, link in description.links.items()},
            "trim": tuple(_trim_body(body) for body in description.trim),
            "thrusters": tuple(_thruster(thruster) for thruster in description.thrusters),
        }
    )


def _link(link: LinkDescription) -> LinkDescription:
    return LinkDescription(
        coefficients=None if link.coefficients is None else _coefficients(link.coefficients),
        cylinder=None if link.cylinder is None else _shape(link.cylinder),
        box=None if link.box is None else _shape(link.box),
        sphere=None if link.sphere is None else _shape(link.sphere),
    )


def _coefficients(water: LinkCoefficients) -> LinkCoefficients:
    centre = water.centre_of_buoyancy
    return water.model_copy(
        update={
            "pose": _pose(water.pose),
            "added_mass": _matrix(water.added_mass),
            "linear_drag": _matrix(water.linear_drag),
            "centre_of_buoyancy": None if centre is None else _vector(centre),
        }
    )


def _shape(shape: _Shape) -> _Shape:
    return shape.model_copy(update={"pose": _pose(shape.pose)})


def _trim_body(body: TrimBody) -> TrimBody:
    return body.model_copy(update={"position": _vector(body.position)})


def _thruster(thruster: Thruster) -> Thruster:
    turned = {"position": _vector(thruster.position), "direction": _vector(thruster.direction)}
    return thruster.model_copy(update=turned)


def _pose(pose: Pose) -> Pose:
    roll, pitch, yaw = pose.rpy
    return Pose(position=_vector(pose.position), rpy=(roll, -pitch, -yaw))


def _vector(vector: Vector3) -> Vector3:
    x, y, z = vector
    return (x, -y, -z)


def _matrix(value: Vector6 | Matrix6) -> Vector6 | Matrix6:
    array = np.array(value)
    if array.ndim == 1:
        return value
    turned = _TURN6 @ array @ _TURN6
    return tuple(tuple(row) for row in turned.tolist())  # type: ignore[return-value]
