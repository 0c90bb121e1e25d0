"""What the files of a robot leave open, and what comes of it: valid files whose gaps a user has to
know of.
"""

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

_ROUNDING = 1e-9  # relative, of masses that are added and taken away again
_SINGULAR = 1e-13  # relative to the largest eigenvalue

_ASSUMED = (
    f"what is missing is {ASSUMED_VELOCITY:g} rad/s and {ASSUMED_ACCELERATION:g} rad/s2, those of"
    " the arm in [Gao2022], with motors that bear it"
)


def unknowns(model: pin.Model, description: RobotDescription) -> Iterator[tuple[str, str]]:
    """Subject and one sentence for everything that stays unknown or is left out. model: without
    trim bodies.
    """
    dry = links_without_water(model, description)
    if description.links and dry:
        yield (
            "water",
            (
                f"no water acts on link {', '.join(dry)}: give each an entry in links,"
                " {coefficients: {}} if dry"
            ),
        )
    elif description.base == "free_flyer" and not description.links:
        yield "water", "no link is in water: give a hydrodynamics.yaml with links"
    floats = description.base == "free_flyer"
    joints = joints_of(model, free_flyer=floats)
    held = held_joints(model, joints)
    if held:
        yield (
            "joints",
            f"joint {', '.join(held)} has no range, lower = upper: it is held there; make it fixed",
        )
    if floats and (open_ones := open_joints(model, joints)):
        yield (
            "limits",
            (
                f"no limit of velocity or effort for joint {', '.join(open_ones)}: {_ASSUMED}; give"
                " <limit>"
            ),
        )
    unknown = [thruster.name for thruster in description.thrusters if thruster.power is None]
    if unknown:
        yield (
            "energy",
            (
                f"no power is given for thruster {', '.join(unknown)}: the energy of the thrusters"
                " is not known"
            ),
        )


def links_without_water(model: pin.Model, description: RobotDescription) -> tuple[str, ...]:
    """Names of the links with a mass that the description does not mention. model: without trim
    bodies.
    """
    return tuple(
        name
        for name, mass in link_masses(model).items()
        if mass > 0.0 and name not in description.links
    )


def link_masses(model: pin.Model) -> dict[str, float]:
    """Mass [kg] by link, as the URDF gives it.

    Pinocchio keeps the mass of a link behind a fixed joint with the frame of that joint, that of
    the root of a fixed base with the link's own frame, and of a moving link only the sum with all
    that is fixed to it.
    """
    on_frames = np.zeros(model.njoints)
    masses = {}
    for frame in model.frames:
        on_frames[frame.parentJoint] += frame.inertia.mass
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY:
            continue
        above = model.frames[frame.parentFrame]
        if frame.inertia.mass or above.type == pin.FrameType.FIXED_JOINT:
            masses[frame.name] = frame.inertia.mass or above.inertia.mass
        else:
            total = model.inertias[frame.parentJoint].mass
            rest = total - on_frames[frame.parentJoint]
            masses[frame.name] = rest if rest > _ROUNDING * total else 0.0
    return masses


def joints_without_inertia(model: pin.Model, M: np.ndarray) -> Iterator[str]:
    """Say, for each joint that a mass matrix M (n_v, n_v) [kg, kg m2] gives nothing to move, which
    links are behind it.

    Forces then have no acceleration, and nothing can be simulated.
    """
    values, vectors = np.linalg.eigh(M)
    empty = (vectors[:, values <= _SINGULAR * values.max(initial=0.0)] ** 2).sum(axis=1) > 0.1
    for index in range(1, model.njoints):
        joint = model.joints[index]
        if empty[joint.idx_v : joint.idx_v + joint.nv].any():
            links = [
                frame.name
                for frame in model.frames
                if frame.type == pin.FrameType.BODY and frame.parentJoint == index
            ]
            yield f"link {', '.join(links)} behind joint {model.names[index]!r}"
