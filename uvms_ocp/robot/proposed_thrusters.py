"""Find the thrusters of a vehicle: those that the file states for a simulator, else joints that turn a
propeller and links that are called thrusters.
"""

from __future__ import annotations

from collections.abc import Iterator

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.robot.name_words import NameWords
from uvms_ocp.robot.proposal_draft import ProposedThruster
from uvms_ocp.robot.roles import Roles
from uvms_ocp.robot.simulator_water import SimulatorBlocks
from uvms_ocp.robot.size import size
from uvms_ocp.robot.urdf import UrdfModels

# sizes of the robot between a link called a thruster and the propeller that turns in it
_SAME_PLACE = 0.4
_VEHICLE = 1  # joint of the free-flyer


def stated_thrusters(model: pin.Model, blocks: SimulatorBlocks) -> Iterator[ProposedThruster]:
    """Yield the thrusters that plugins state and that push the vehicle itself, with their limits."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    for stated in blocks.thrusters:
        if stated.joint is not None and model.existJointName(stated.joint):
            joint = model.getJointId(stated.joint)
            if model.parents[joint] != _VEHICLE:
                continue
            X = data.oMi[joint]
            S = np.array(model.joints[joint].createData().S)
            direction = S.ravel()[3:]
            source = "axis of the joint of its plugin"
        else:
            name = stated.link if stated.link is not None else stated.joint
            frame = model.getFrameId(str(name))
            if frame >= model.nframes or model.frames[frame].parentJoint > _VEHICLE:
                continue
            X = data.oMf[frame]
            direction = np.array([1.0, 0.0, 0.0])
            source = "x axis of the link of its plugin"
            if stated.direction is not None:
                direction = stated.direction / np.linalg.norm(stated.direction)
                source = "direction of its plugin"
        yield ProposedThruster(
            name=str(stated.joint or stated.link),
            X=X,
            direction=X.rotation @ direction,
            source=source,
            minimum=stated.minimum,
            maximum=stated.maximum,
            time_constant=stated.time_constant,
        )


def thrusters_by_structure(models: UrdfModels, roles: Roles) -> Iterator[ProposedThruster]:
    """Yield a thruster for each joint of the vehicle that turns a propeller, and for each link fixed
    to the vehicle that is called one, by itself or by its joint, and carries no such joint.
    """
    model = models.model
    words = NameWords(model)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    places = list[np.ndarray]()  # (3,) [m] in B
    for name in roles.propellers:
        if words.is_called("fin", name):
            continue
        index = model.getJointId(name)
        X = data.oMi[index]
        places.append(X.translation)
        S = np.array(model.joints[index].createData().S)
        yield ProposedThruster(
            name=name, X=X, direction=X.rotation @ S.ravel()[3:], source="axis of the joint"
        )
    same_place = _SAME_PLACE * size(model)
    for i in _thruster_links(model, words):
        X = data.oMf[i]
        if any(np.linalg.norm(X.translation - place) < same_place for place in places):
            continue
        cylinder = _cylinder_of(models.visual, i)
        if cylinder is None:
            direction = X.rotation[:, 0]
            source = "x axis of the link"
        else:
            direction = cylinder.placement.rotation[:, 2]
            source = "axis of its cylinder"
        name = model.frames[i].name
        yield ProposedThruster(name=name, X=X, direction=direction, source=source)


def _thruster_links(model: pin.Model, words: NameWords) -> list[int]:
    """Return frames of links fixed to the vehicle that are called thrusters, or whose joints are:
    of those on one another the outermost that is no mount.
    """
    links = list[int]()
    mounts = list[int]()
    for i, frame in enumerate(model.frames):
        if frame.type != pin.FrameType.BODY or frame.parentJoint > 1:
            continue
        joint_frame = model.frames[frame.parentFrame]
        names = [frame.name]
        if joint_frame.type == pin.FrameType.FIXED_JOINT:
            names.append(joint_frame.name)
        if not words.is_called("propeller", *names) or words.is_called("fin", *names):
            continue
        above = joint_frame.parentFrame
        if above in links:
            continue
        if words.is_called("mount", frame.name):
            mounts.append(i)
        else:
            links.append(i)
    bearing = {model.frames[model.frames[i].parentFrame].parentFrame for i in links}
    links += [i for i in mounts if i not in bearing]
    return sorted(links)


def _cylinder_of(visual: pin.GeometryModel, frame: int) -> pin.GeometryObject | None:
    """Return the first cylinder that is drawn for the link of that frame."""
    for shape in visual.geometryObjects:
        if shape.parentFrame == frame and isinstance(shape.geometry, coal.Cylinder):
            return shape
    return None
