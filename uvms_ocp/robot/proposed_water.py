"""Propose the coefficients in water of the links of a URDF, as the file states them or by their
shapes, and a volume of the hull with which the vehicle floats level.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.robot import hydrodynamics, link_boxes, static_balance
from uvms_ocp.robot.coefficients import links_in_water, placement_of
from uvms_ocp.robot.description import Box, LinkDescription, Pose, RobotDescription, checked_copy
from uvms_ocp.robot.proposed_hull import hull_added_mass, hull_drag
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.simulator_water import SimulatorWater
from uvms_ocp.robot.unknowns import link_inertia, link_masses
from uvms_ocp.robot.urdf import UrdfModels

WATER_DENSITY = 1025.0
"""[kg/m3] of the sea."""
LIFT_SHARE = 0.12
"""Height of buoyancy above mass over that of the hull."""
TURBULENT_SPEED = 0.15
"""[m/s] at which linear drag is as large as quadratic drag, of published vehicles."""
TURBULENT_RATE = 0.4
"""[rad/s] of the same about the axes."""
_MAX_DENSITY_RATIO = 20.0
"""Mass of water in the shapes of a link over that of the link, and over 1 kg: with more, its shapes
are no hull, or in millimetres.
"""
_MIN_SIDE = 1e-3  # [m] of a box


def proposed_links(
    models: UrdfModels, stated: Mapping[str, SimulatorWater], *, floats: bool
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return coefficients by link, and where they come from: those that the file states, and others
    by shapes, of the vehicle those of a box around all that is fixed to it.
    """
    links, sources = _links_by_shape(models, stated, floats=floats)
    for name, water in stated.items():
        if name not in links:
            continue
        coefficients = {**links[name]["coefficients"], **water.coefficients}
        if water.coefficients.keys() & {"added_mass", "linear_drag", "quadratic_drag"}:
            coefficients.pop("pose", None)  # at the link's origin, as they are stated
        if "quadratic_drag" in water.coefficients:
            coefficients["drag_by"] = "axes"
        rest = coefficients.keys() - water.coefficients.keys() - {"pose", "drag_by"}
        source = water.source
        if rest:
            source += f"; the rest: {sources[name]}"
        links[name] = {"coefficients": coefficients}
        sources[name] = source
    return links, sources


def _links_by_shape(
    models: UrdfModels, stated: Mapping[str, SimulatorWater], *, floats: bool
) -> tuple[dict[str, Any], dict[str, str]]:
    """Return coefficients by link by shapes alone, and where they come from."""
    descriptions = dict[str, Any]()
    sources = dict[str, str]()
    hull = hull_of(models.model, stated, floats=floats)
    vehicle_joint = 1 if floats else 0
    for name, link_mass in link_masses(models.model).items():
        mass = link_mass
        if name == hull and mass <= 0.0:
            mass = models.model.inertias[1].mass
        if mass <= 0.0:
            continue
        on_vehicle = _carrier(models.model, name) <= vehicle_joint
        if on_vehicle and not hull:
            descriptions[name] = {"coefficients": {}}
            sources[name] = "does not move"
        elif on_vehicle and name != hull:
            descriptions[name] = {"coefficients": {}}
            sources[name] = f"in the water of {hull}"
        else:
            coefficients, source = _by_shape(models, name, mass, is_hull=name == hull)
            descriptions[name] = {"coefficients": coefficients}
            sources[name] = source
    return descriptions, sources


def hull_of(model: pin.Model, stated: Mapping[str, SimulatorWater], *, floats: bool) -> str:
    """Return the link of the vehicle that has the coefficients: the one of which the file states
    some, else the heaviest; "" for none.
    """
    if not floats:
        return ""
    masses_on_vehicle = dict[str, float]()
    for name, mass in link_masses(model).items():
        if _carrier(model, name) == 1 and (mass > 0.0 or name in stated):
            masses_on_vehicle[name] = mass
    with_water = [name for name in masses_on_vehicle if name in stated]
    candidates = with_water or [*masses_on_vehicle]
    return max(candidates, key=lambda name: masses_on_vehicle[name], default="")


def _carrier(model: pin.Model, link: str) -> int:
    """Return the index of the joint that moves a link."""
    return int(model.frames[model.getFrameId(link)].parentJoint)


def _by_shape(
    models: UrdfModels, name: str, mass: float, *, is_hull: bool
) -> tuple[dict[str, Any], str]:
    """Return coefficients of one link and their source: of the box or cylinder around its shapes,
    or of a box with its inertia. is_hull: around all that is fixed to the vehicle.
    """
    model = models.model
    mass_on_vehicle = mass
    if is_hull:
        mass_on_vehicle = model.inertias[_carrier(model, name)].mass
        joint = _carrier(model, name)
        inertia = model.frames[model.getFrameId(name)].placement.actInv(model.inertias[joint])
        source = "box around its shapes"
    else:
        joint = None
        inertia = link_inertia(model, name)
        source = "cylinder around its shapes"
    box = link_boxes.smallest_box(model, models.collision, name, joint=joint)
    if box is None:
        box = link_boxes.smallest_box(model, models.visual, name, joint=joint)
    if box is None or holds_too_much(box.size, mass):
        box = _box_by_inertia(inertia, mass)
        source = "box with its mass and inertia, as it has no fitting shapes"
    cylinder = None if is_hull else link_boxes.cylinder_in(box.corners)
    if cylinder is None:
        size = np.maximum(box.size, _MIN_SIDE).tolist()
        pose = _pose(box.rotation, box.centre)
        link = LinkDescription(box=Box(size=tuple(size), pose=pose, drag_by="flow"))
    else:
        X_BC = placement_of(cylinder.pose)
        pose = _pose(box.rotation @ X_BC.rotation, box.centre)
        link = LinkDescription(cylinder=cylinder.model_copy(update={"pose": pose}))
    description = RobotDescription(links={name: link}, water_density=WATER_DENSITY)
    (water,) = links_in_water(description)
    if is_hull:
        sides = np.maximum(box.size, _MIN_SIDE)
        water = replace(
            water,
            added_mass=np.diag(hull_added_mass(sides, mass_on_vehicle, WATER_DENSITY)),
            quadratic_drag=np.diag(hull_drag(sides, np.diag(water.quadratic_drag))),
        )
    sides_text = " x ".join(f"{side:.3g}" for side in box.size)
    return _coefficients(water, mass), f"{source}, {sides_text} m"


def _pose(rotation: np.ndarray, position: np.ndarray) -> Pose:
    return Pose(
        position=tuple(position.tolist()), rpy=tuple(pin.rpy.matrixToRpy(rotation).tolist())
    )


def holds_too_much(size: np.ndarray, mass: float) -> bool:
    """Check whether a box with sides (3,) [m] holds so much water that it is no hull of a link of a mass
    [kg].
    """
    return bool(np.prod(size) * WATER_DENSITY > _MAX_DENSITY_RATIO * max(mass, 1.0))


def _box_by_inertia(inertia: pin.Inertia, mass: float) -> link_boxes.TurnedBox:
    """Return a box that has the principal moments of a link, along their axes, or a cube as heavy as
    water where no box has them.
    """
    _, principal_axes = np.linalg.eigh(inertia.inertia)
    rotation = link_boxes.nearest_axes(principal_axes)
    a, b, c = np.diag(rotation.T @ inertia.inertia @ rotation)
    squared_sides = 6.0 / max(inertia.mass, 1e-9) * np.array([b + c - a, c + a - b, a + b - c])
    cube = np.full(3, (mass / WATER_DENSITY) ** (1 / 3))
    size = np.sqrt(squared_sides) if (squared_sides > 0.0).all() else cube
    if holds_too_much(size, mass):
        size = cube
    middle = rotation.T @ inertia.lever
    corners = np.array([middle - size / 2, middle + size / 2])
    return link_boxes.TurnedBox(rotation=rotation, corners=corners)


def _coefficients(water: hydrodynamics.LinkHydrodynamics, mass: float) -> dict[str, Any]:
    """Return coefficients in the words of a file. No link floats by itself: what its shape holds of
    air or water is not known.
    """
    pose = {
        "position": rounded(water.X_FL.translation),
        "rpy": rounded(pin.rpy.matrixToRpy(water.X_FL.rotation), 7),
    }
    quadratic = np.diag(water.quadratic_drag)
    turbulent_from = np.array([TURBULENT_SPEED] * 3 + [TURBULENT_RATE] * 3)  # [m/s, rad/s]
    return {
        "pose": pose,
        "added_mass": rounded(np.diag(water.added_mass)),
        "linear_drag": rounded(turbulent_from * quadratic),
        "quadratic_drag": rounded(quadratic),
        "drag_by": "flow" if water.by_flow else "axes",
        "volume": float(f"{min(water.volume, mass / WATER_DENSITY):.4g}"),
        "centre_of_buoyancy": rounded(water.centre_of_buoyancy),
    }


def rounded(values: np.ndarray, digits: int = 4) -> list[float]:
    """Round numbers to so many significant digits; of rounding errors nothing is left."""
    numbers = list[float]()
    for value in np.asarray(values, dtype=float):
        is_significant = abs(value) > 1e-9
        numbers.append(float(f"{value:.{digits}g}") if is_significant else 0.0)
    return numbers


def trimmed(robot: Robot, links: dict[str, Any], hull: str) -> dict[str, Any]:
    """Return the links with so much volume of the hull, and there, that the vehicle floats level
    with its arm stowed.

    robot: with these links as they are.
    """
    if not hull:
        return links
    coefficients = dict(links[hull]["coefficients"])
    coefficients.pop("volume", None)
    coefficients.pop("centre_of_buoyancy", None)
    trimmed_links = {**links, hull: {"coefficients": coefficients}}
    bare = checked_copy(robot.description, links=trimmed_links)
    bare_robot = replace(robot, description=bare, hydrodynamics=links_in_water(bare))
    arms, lift = static_balance.lifts(bare_robot, robot.configuration())
    total = -float(lift.sum())  # [N]
    if total <= 0.0:
        return links
    centre = -(arms.T @ lift) / total  # [m] in B
    centre[2] = robot.model.inertias[1].lever[2] + LIFT_SHARE * _hull_height(robot, hull)
    gravity = float(np.linalg.norm(robot.model.gravity.linear))
    X_BF = robot.model.frames[robot.frame_id(hull)].placement
    coefficients["volume"] = float(f"{total / (gravity * robot.description.water_density):.6g}")
    coefficients["centre_of_buoyancy"] = [float(f"{value:.6g}") for value in X_BF.actInv(centre)]
    return trimmed_links


def _hull_height(robot: Robot, hull: str) -> float:
    """Return the height [m] of all that is fixed to the vehicle, of a cube of its mass in water
    where it has no fitting shapes.
    """
    model = robot.model
    mass = model.inertias[1].mass
    for shapes in (robot.collision_model, robot.visual_model):
        box = link_boxes.smallest_box(model, shapes, hull, joint=1)
        if box is not None and not holds_too_much(box.size, mass):
            R_BF = model.frames[robot.frame_id(hull)].placement.rotation
            return float(np.abs(R_BF @ box.rotation)[2] @ box.size)
    return float(np.cbrt(mass / WATER_DENSITY))
