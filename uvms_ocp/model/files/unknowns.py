"""What the files of a robot leave open, and what comes of it: valid files whose gaps a user has to know of."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from uvms_ocp.model.files.description import RobotDescription

_ROUNDING = 1e-9  # relative, of masses that are added and taken away again


def unknowns(model: pin.Model, description: RobotDescription) -> Iterator[tuple[str, str]]:
    """Subject and one sentence for everything that stays unknown or is left out. model: without trim bodies."""
    dry = links_without_water(model, description)
    if description.links and dry:
        yield (
            "water",
            f"no water acts on link {', '.join(dry)}: give each an entry in links, {{coefficients: {{}}}} if dry",
        )
    elif description.base == "free_flyer" and not description.links:
        yield "water", "no link is in water: give a hydrodynamics.yaml with links"
    unknown = [thruster.name for thruster in description.thrusters if thruster.power is None]
    if unknown:
        yield "energy", f"no power is given for thruster {', '.join(unknown)}: the energy of the thrusters is not known"


def links_without_water(model: pin.Model, description: RobotDescription) -> tuple[str, ...]:
    """Names of the links with a mass that the description does not mention. model: without trim bodies."""
    masses = link_masses(model)
    return tuple(name for name, mass in masses.items() if mass > 0.0 and name not in description.links)


def link_masses(model: pin.Model) -> dict[str, float]:
    """Mass [kg] by link, as the URDF gives it.

    Pinocchio keeps the mass of a link behind a fixed joint with the frame of that joint, that of the root of a fixed base
    with the link's own frame, and of a moving link only the sum with all that is fixed to it.
    """
    on_frames, masses = np.zeros(model.njoints), {}
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
