"""Compute the coefficients of links from a robot's description: shape rules, floats and ballast.

The shape rules are strip theory: the displaced mass as lateral added mass, and drag on the frontal
area; integrated along the shape they give the rotational terms. They are estimates for slender
links, not measurements.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.robot import description as data
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics

_SQUARE_PRISM = 0.725 / 16
"""Added inertia of a long square prism over its displaced mass and the square of its side: 0.725 rho
a^4 a metre, with sides of 2 a (DNV-RP-C205, table D-1).
"""


def links_in_water(
    description: data.RobotDescription, density: float | None = None
) -> tuple[LinkHydrodynamics, ...]:
    """Compute the coefficients of every wet link of a description, in forward-left-up axes.

    density [kg/m3] is what the shape rules use, default the description's. Floats and ballast add
    their volume to their link.
    """
    rho = description.water_density if density is None else density
    description = data.forward_left_up(description)
    links = {name: _link(name, link, rho) for name, link in description.links.items()}
    for body in description.trim:
        wet = links.get(body.link, LinkHydrodynamics(frame=body.link))
        links[body.link] = _with_volume(wet, body.volume, np.array(body.position))
    return tuple(links.values())


def _link(name: str, link: data.LinkDescription, rho: float) -> LinkHydrodynamics:
    if link.coefficients is not None:
        return _from_coefficients(name, link.coefficients)
    if link.cylinder is not None:
        return _cylinder(name, link.cylinder, rho)
    if link.box is not None:
        return _box(name, link.box, rho)
    assert link.sphere is not None  # as descriptions have one of the four
    return _sphere(name, link.sphere, rho)


def _from_coefficients(name: str, coefficients: data.LinkCoefficients) -> LinkHydrodynamics:
    return LinkHydrodynamics(
        frame=name,
        X_FL=placement_of(coefficients.pose),
        added_mass=data.as_matrix6(coefficients.added_mass),
        linear_drag=data.as_matrix6(coefficients.linear_drag),
        quadratic_drag=data.as_matrix6(coefficients.quadratic_drag),
        by_flow=coefficients.drag_by == "flow",
        volume=coefficients.volume,
        centre_of_buoyancy=np.array(coefficients.centre_of_buoyancy or (0.0, 0.0, 0.0)),
    )


def coefficients_of(link: LinkHydrodynamics) -> data.LinkCoefficients:
    """State the coefficients of a link as a robot file would, its matrices in full."""
    rpy = pin.rpy.matrixToRpy(link.X_FL.rotation)
    pose = data.Pose(position=tuple(link.X_FL.translation.tolist()), rpy=tuple(rpy.tolist()))
    return data.LinkCoefficients(
        pose=pose,
        added_mass=_rows(link.added_mass),
        linear_drag=_rows(link.linear_drag),
        quadratic_drag=_rows(link.quadratic_drag),
        drag_by="flow" if link.by_flow else "axes",
        volume=link.volume,
        centre_of_buoyancy=tuple(link.centre_of_buoyancy.tolist()) if link.volume else None,
    )


def _rows(matrix: np.ndarray) -> Any:
    return tuple(map(tuple, matrix.tolist()))


def _cylinder(name: str, shape: data.Cylinder, rho: float) -> LinkHydrodynamics:
    radius = shape.radius
    length = shape.length
    volume = np.pi * radius**2 * length
    mass = rho * volume
    tumbling = rho * volume * length**2 / 12
    side = 2 * radius * length
    end = np.pi * radius**2
    turning = _strips(2 * radius, length)
    return _shaped(
        name,
        shape,
        volume,
        added_mass=(mass, mass, shape.axial_added_mass * mass, tumbling, tumbling, 0.0),
        areas=rho / 2 * np.array([side, side, end, turning, turning, 0.0]),
    )


def _box(name: str, shape: data.Box, rho: float) -> LinkHydrodynamics:
    x, y, z = shape.size
    volume = x * y * z
    mass = rho * volume
    added_inertias = [_added_inertia(mass, a, b) for a, b in ((y, z), (z, x), (x, y))]
    turning = [
        _strips(x, y) + _strips(x, z),
        _strips(y, z) + _strips(y, x),
        _strips(z, x) + _strips(z, y),
    ]
    return _shaped(
        name,
        shape,
        volume,
        added_mass=(mass, mass, mass, *added_inertias),
        areas=rho / 2 * np.array([y * z, z * x, x * y, *turning]),
    )


def _added_inertia(mass: float, a: float, b: float) -> float:
    """Return the added moment of inertia [kg m2] of a box about an axis, with sides a, b [m] across
    it and so much displaced mass [kg]: strips of a slender one, that of a long prism where it is
    square, and both shares in between.
    """
    strips = (a**2 - b**2) ** 2 / 12
    corners = 2 * _SQUARE_PRISM * a**2 * b**2
    return mass * (strips + corners) / (a**2 + b**2)


def _sphere(name: str, shape: data.Sphere, rho: float) -> LinkHydrodynamics:
    volume = 4 / 3 * np.pi * shape.radius**3
    area = np.pi * shape.radius**2
    mass = rho * volume / 2
    return _shaped(
        name,
        shape,
        volume,
        added_mass=(mass, mass, mass, 0.0, 0.0, 0.0),
        areas=rho / 2 * np.repeat([area, 0.0], 3),
    )


def _strips(width: float, length: float) -> float:
    """Integrate the moment of ``|x omega| (x omega)`` over a plate of a width that turns about its
    middle [m5].
    """
    return width * length**4 / 32


def _shaped(
    name: str,
    shape: data.Cylinder | data.Box | data.Sphere,
    volume: float,
    added_mass: Iterable[float],
    areas: np.ndarray,
) -> LinkHydrodynamics:
    return LinkHydrodynamics(
        frame=name,
        X_FL=placement_of(shape.pose),
        added_mass=np.array(tuple(added_mass)),
        linear_drag=np.array([shape.skin_drag] * 3 + [0.0] * 3),
        quadratic_drag=shape.drag_coefficient * areas,
        by_flow=shape.drag_by == "flow",
        volume=volume,
        centre_of_buoyancy=np.array(shape.pose.position),
    )


def _with_volume(link: LinkHydrodynamics, volume: float, centre: np.ndarray) -> LinkHydrodynamics:
    """Return the link with another displaced volume fixed to it."""
    total = link.volume + volume
    if total == 0.0:
        return link
    moment = link.volume * link.centre_of_buoyancy + volume * centre
    return replace(link, volume=total, centre_of_buoyancy=moment / total)


def placement_of(pose: data.Pose) -> pin.SE3:
    """Return the pose as a transform."""
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(pose.rpy)), np.array(pose.position))
