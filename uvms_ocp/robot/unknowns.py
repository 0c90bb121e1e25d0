"""Find the gaps in valid files of a robot of which a user has to know, and their consequences."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.description import RobotDescription
from uvms_ocp.robot.limits import (
    ASSUMED_ACCELERATION,
    ASSUMED_VELOCITY,
    held_joints,
    joints_of,
    open_joints,
)

_ROUNDING = 1e-9  # relative error of a mass that is a difference of sums
_SINGULAR = 1e-13  # share of the largest eigenvalue below which a direction is singular
_SINGULAR_SHARE = 0.1  # squared share of a velocity in singular directions

_ASSUMED = (
    f"what is missing is {ASSUMED_VELOCITY:g} rad/s and {ASSUMED_ACCELERATION:g} rad/s2, those of"
    " the arm in [Gao2022], with motors that bear it"
)


def unknowns(model: pin.Model, description: RobotDescription) -> Iterator[tuple[str, str]]:
    """Yield subject and one sentence for everything that stays unknown or is left out. model: that
    of the robot without trim bodies.
    """
    floats = description.base == "free_flyer"
    dry_links = links_without_water(model, description)
    if description.links and dry_links:
        text = f"no water acts on link {', '.join(dry_links)}: give each an entry in links,"
        yield "water", text + " {coefficients: {}} if dry"
    elif floats and not description.links:
        yield "water", "no link is in water: give a hydrodynamics.yaml with links"
    joints = joints_of(model, free_flyer=floats)
    held = ", ".join(held_joints(model, joints))
    if held:
        text = f"joint {held} has no range, lower = upper: it is held there; make it fixed"
        yield "joints", text
    unlimited = ", ".join(open_joints(model, joints)) if floats else ""
    if unlimited:
        text = f"no limit of velocity or effort for joint {unlimited}: {_ASSUMED}; give <limit>"
        yield "limits", text
    no_power = [thruster.name for thruster in description.thrusters if thruster.power is None]
    if no_power:
        text = f"no power is given for thruster {', '.join(no_power)}"
        yield "energy", f"{text}: the energy of the thrusters is not known"


def links_without_water(model: pin.Model, description: RobotDescription) -> tuple[str, ...]:
    """Return names of the links with a mass that the description does not mention. model: without
    trim bodies.
    """
    heavy_links = [name for name, mass in link_masses(model).items() if mass > 0.0]
    return tuple(name for name in heavy_links if name not in description.links)


def link_masses(model: pin.Model) -> dict[str, float]:
    """Return the mass [kg] by link, as the URDF gives it.

    Pinocchio keeps the mass of a link behind a fixed joint with the frame of that joint, that of
    the root of a fixed base with the link's own frame, and of a moving link only the sum with all
    that is fixed to it.
    """
    mass_on_frames = np.zeros(model.njoints)  # [kg] by joint
    for frame in model.frames:
        mass_on_frames[frame.parentJoint] += frame.inertia.mass
    masses = {}
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY:
            continue
        above = model.frames[frame.parentFrame]
        if frame.inertia.mass or above.type == pin.FrameType.FIXED_JOINT:
            masses[frame.name] = frame.inertia.mass or above.inertia.mass
        else:
            total = model.inertias[frame.parentJoint].mass
            link_mass = total - mass_on_frames[frame.parentJoint]
            masses[frame.name] = link_mass if link_mass > _ROUNDING * total else 0.0
    return masses


def link_inertia(model: pin.Model, link: str) -> pin.Inertia:
    """Return the inertia of a link alone, in its frame, without what is fixed to it; see
    `link_masses`.
    """
    frame = model.frames[model.getFrameId(link)]
    above = model.frames[frame.parentFrame]
    if frame.inertia.mass:
        return frame.inertia
    if above.type == pin.FrameType.FIXED_JOINT:
        return frame.placement.actInv(above.placement.act(above.inertia))
    parameters = model.inertias[frame.parentJoint].toDynamicParameters()
    for fixed_frame in model.frames:
        if fixed_frame.parentJoint == frame.parentJoint and fixed_frame.inertia.mass:
            fixed_inertia = fixed_frame.placement.act(fixed_frame.inertia)
            parameters -= fixed_inertia.toDynamicParameters()
    return frame.placement.actInv(pin.Inertia.FromDynamicParameters(parameters))


def joints_without_inertia(model: pin.Model, M: np.ndarray) -> Iterator[str]:
    """Yield, for each joint without inertia in a mass matrix M (n_v, n_v) [kg, kg m2], a text with
    the links behind it.

    Such a robot cannot be simulated: forces have no finite acceleration.
    """
    eigenvalues, eigenvectors = np.linalg.eigh(M)
    is_singular = eigenvalues <= _SINGULAR * eigenvalues.max(initial=0.0)
    has_no_inertia = (eigenvectors[:, is_singular] ** 2).sum(axis=1) > _SINGULAR_SHARE
    for index in range(1, model.njoints):
        joint = model.joints[index]
        if has_no_inertia[joint.idx_v : joint.idx_v + joint.nv].any():
            links = list[str]()
            for frame in model.frames:
                if frame.type == pin.FrameType.BODY and frame.parentJoint == index:
                    links.append(frame.name)
            yield f"link {', '.join(links)} behind joint {model.names[index]!r}"
