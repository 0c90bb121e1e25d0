"""From the description of a robot to the water on each of its links: given coefficients, or the rule of a shape.

Rules, with rho the water's density, V the displaced volume, C_D the drag coefficient and A a frontal area:

- cylinder (radius r, length L, axis z): added mass rho V across and 0.1 rho V along the axis, rotational
  rho pi r^2 L^3 / 12 across; quadratic drag rho C_D A / 2 per axis, and across the axis the moment of the same drag
  spread evenly along it, rho C_D r L^4 / 32; linear skin drag d, and its moment d L^2 / 12 [Fossen2021, sec. 6.3].
- box: along each axis the added mass of a cylinder across the flow with the frontal sides as diameter and length;
  moments and drag as for the cylinder, about each axis the sum over the two sides that swing.
- sphere: added mass rho V / 2, exact for an ideal fluid; no moment.

[Fossen2021] T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., Wiley, 2021.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pinocchio as pin

from uvms_ocp.model.description import (
    Box,
    Cylinder,
    LinkCoefficients,
    LinkDescription,
    Pose,
    RobotDescription,
    Sphere,
    TrimBody,
    as_matrix6,
)
from uvms_ocp.model.hydrodynamics import LinkHydrodynamics


def water_on_links(description: RobotDescription) -> tuple[LinkHydrodynamics, ...]:
    """Return one entry per link in water; floats and ballast add their volume to the link that carries them."""
    density = description.water_density
    waters = {name: _water_on(name, link, density) for name, link in description.links.items()}
    for body in description.trim:
        waters[body.link] = _with_volume(waters.get(body.link, LinkHydrodynamics(frame=body.link)), body)
    return tuple(waters.values())


def _water_on(name: str, link: LinkDescription, density: float) -> LinkHydrodynamics:
    if link.coefficients is not None:
        return _from_coefficients(name, link.coefficients)
    if link.cylinder is not None:
        return _on_cylinder(name, link.cylinder, density)
    if link.box is not None:
        return _on_box(name, link.box, density)
    return (
        _on_sphere(name, link.sphere, density) if link.sphere is not None else LinkHydrodynamics(frame=name)
    )


def _from_coefficients(name: str, water: LinkCoefficients) -> LinkHydrodynamics:
    X_FL = _se3(water.pose)
    centre = X_FL.translation if water.centre_of_buoyancy is None else water.centre_of_buoyancy
    return LinkHydrodynamics(
        frame=name,
        X_FL=X_FL,
        added_mass=as_matrix6(water.added_mass),
        linear_drag=as_matrix6(water.linear_drag),
        quadratic_drag=np.array(water.quadratic_drag),
        volume=water.volume,
        centre_of_buoyancy=np.array(centre),
    )


def _on_cylinder(name: str, cylinder: Cylinder, density: float) -> LinkHydrodynamics:
    r, L = cylinder.radius, cylinder.length
    volume = np.pi * r**2 * L
    across, along = density * volume, cylinder.axial_added_mass * density * volume
    turning = density * np.pi * r**2 * L**3 / 12.0
    pressure = 0.5 * density * cylinder.drag_coefficient
    skin = cylinder.skin_drag
    return _shape_water(
        name,
        cylinder.pose,
        volume,
        added_mass=(across, across, along, turning, turning, 0.0),
        linear_drag=(skin, skin, skin, skin * L**2 / 12.0, skin * L**2 / 12.0, 0.0),
        quadratic_drag=pressure
        * np.array([2 * r * L, 2 * r * L, np.pi * r**2, r * L**4 / 16.0, r * L**4 / 16.0, 0.0]),
    )


def _on_box(name: str, box: Box, density: float) -> LinkHydrodynamics:
    sides = np.array(box.size)
    volume = float(sides.prod())
    others = np.array([np.delete(sides, axis) for axis in range(3)])
    areas = others.prod(axis=1)
    # Cylinder across the flow: its diameter is the shorter frontal side, its length the longer one.
    translation = density * np.pi / 4.0 * others.min(axis=1) ** 2 * others.max(axis=1)
    pressure = 0.5 * density * box.drag_coefficient
    skin = np.full(3, box.skin_drag)
    return _shape_water(
        name,
        box.pose,
        volume,
        added_mass=(*translation, *_swing(translation, sides**2) / 12.0),
        linear_drag=(*skin, *_swing(skin, sides**2) / 12.0),
        quadratic_drag=pressure * np.concatenate([areas, _swing(areas, sides**3) / 32.0]),
    )


def _swing(values: np.ndarray, levers: np.ndarray) -> np.ndarray:
    """Moment about each axis (3,) of translational values (3,) spread along the two sides that swing about it."""
    return np.roll(values, -1) * np.roll(levers, -2) + np.roll(values, -2) * np.roll(levers, -1)


def _on_sphere(name: str, sphere: Sphere, density: float) -> LinkHydrodynamics:
    volume = 4.0 / 3.0 * np.pi * sphere.radius**3
    pressure = 0.5 * density * sphere.drag_coefficient * np.pi * sphere.radius**2
    return _shape_water(
        name,
        sphere.pose,
        volume,
        added_mass=(0.5 * density * volume,) * 3 + (0.0,) * 3,
        linear_drag=(sphere.skin_drag,) * 3 + (0.0,) * 3,
        quadratic_drag=(pressure,) * 3 + (0.0,) * 3,
    )


def _shape_water(
    name: str,
    pose: Pose,
    volume: float,
    *,
    added_mass: Iterable[float],
    linear_drag: Iterable[float],
    quadratic_drag: Iterable[float],
) -> LinkHydrodynamics:
    X_FL = _se3(pose)
    return LinkHydrodynamics(
        frame=name,
        X_FL=X_FL,
        added_mass=np.diag(tuple(added_mass)),
        linear_drag=np.diag(tuple(linear_drag)),
        quadratic_drag=np.diag(tuple(quadratic_drag)),
        volume=volume,
        centre_of_buoyancy=X_FL.translation,
    )


def _with_volume(water: LinkHydrodynamics, body: TrimBody) -> LinkHydrodynamics:
    volume = water.volume + body.volume
    if volume == 0.0:
        return water
    moment = water.volume * water.centre_of_buoyancy + body.volume * np.array(body.position)
    return replace(water, volume=volume, centre_of_buoyancy=moment / volume)


def _se3(pose: Pose) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(np.array(pose.rpy)), np.array(pose.position))
