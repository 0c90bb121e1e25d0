"""Signs that the z axis of a vehicle's file points down, as files of naval conventions have it: such
a vehicle would be flown upside down.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from uvms_ocp.robot import link_boxes
from uvms_ocp.robot.name_words import NameWords
from uvms_ocp.robot.size import size

_DOWNWARD_AXES = re.compile(r"(?<![a-z])(ned|frd|fsd|snamed?)(?![a-z])")
_TOP = 0.75  # of the height of the hull, above which nothing looks down
_ABOVE = 0.2  # sizes of the robot above the mass, the same of a hull without shapes
_UNSTABLE = 0.02  # sizes of the robot by which buoyancy is below mass
_VEHICLE = 1  # joint of the free-flyer

TURN = (
    "if so, turn it: a root link above it, without mass, fixed by a joint with"
    ' <origin rpy="3.14159265 0 0"/>'
)
"""Advice that turns such a file."""


def signs_of_z_down(
    model: pin.Model, shapes: pin.GeometryModel, buoyancy: np.ndarray | None
) -> Iterator[str]:
    """Yield what speaks for a z axis that points down, a few words each.

    shapes: of the vehicle. buoyancy: its centre (3,) [m] in the frame of the root as the file states
    it; `None` where it does not.
    """
    links = []
    for index, frame in enumerate(model.frames):
        if frame.type == pin.FrameType.BODY and frame.parentJoint == _VEHICLE:
            links.append((index, frame))
    if not links:
        return
    words = NameWords(model)
    root = str(links[0][1].name)
    if _DOWNWARD_AXES.search(words.plain(root).lower()):
        yield f"the root is called {root!r}"
    mass_height = float(model.inertias[_VEHICLE].lever[2])
    if buoyancy is not None and buoyancy[2] < mass_height - _UNSTABLE * size(model):
        below = mass_height - float(buoyancy[2])
        yield f"the centre of buoyancy stands {below:.2g} m below the mass along z"
    top = mass_height + _ABOVE * size(model)
    corners = link_boxes.box_around(model, shapes, root, joint=_VEHICLE)
    if np.isfinite(corners).all():
        X_BF = model.frames[model.getFrameId(root)].placement
        heights = [X_BF.act(corner)[2] for corner in corners]
        top = max(top, min(heights) + _TOP * (max(heights) - min(heights)))
    on_top = list[str]()
    for _, frame in links:
        name = str(frame.name)
        is_downward = words.is_called("dvl", name) or words.is_called("altimeter", name)
        if is_downward and frame.placement.translation[2] > top:
            on_top.append(name)
    if on_top:
        yield f"{', '.join(on_top)} would be on top of the hull"
