"""Find the thrusters of a vehicle: those that the file states for a simulator, else joints that turn a
propeller and links that are called thrusters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.robot.name_words import NameWords
from uvms_ocp.robot.proposal_draft import ProposedThruster
from uvms_ocp.robot.roles import Roles
from uvms_ocp.robot.simulator_water import SimulatorBlocks
from uvms_ocp.robot.size import size
from uvms_ocp.robot.urdf import UrdfModels

# sizes of the robot between a link called a thruster and the propeller that turns in it, at most
_NEARBY = 0.4
_SAME_PLACE = 0.1  # where not all of these links have a propeller nearby
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


def thrusters_by_structure(models: UrdfModels, roles: Roles) -> list[ProposedThruster]:
    """Return a thruster for each joint of the vehicle that turns a propeller, and for each link fixed
    to the vehicle that is called one, by itself or by its joint, and is no duct of such a joint.

    Those that are called otherwise than most are doubtful.
    """
    model = models.model
    words = NameWords(model)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    propellers = [_propeller(model, data, name) for name in roles.propellers]
    propellers = [thruster for thruster in propellers if not words.is_called("fin", thruster.name)]
    places = [thruster.X.translation for thruster in propellers]  # (3,) [m] in B
    links = _thruster_links(model, words)
    ducts = _ducts(links, [data.oMf[i].translation for i in links], places, size(model))
    fixed_thrusters = [_fixed_thruster(models, data, i) for i in links if i not in ducts]
    thrusters = [*propellers, *fixed_thrusters]
    names = [_name_of_link(model, thruster.name) for thruster in thrusters]
    alike = words.alike(names, besides="propeller")
    are_called = [words.is_called("propeller", *_names_of(model, t.name)) for t in thrusters]
    marked = list[ProposedThruster]()
    for thruster, is_alike, is_called in zip(thrusters, alike, are_called, strict=True):
        is_doubtful = not is_alike or (not is_called and any(are_called))
        marked.append(replace(thruster, is_doubtful=is_doubtful))
    return marked


def _propeller(model: pin.Model, data: pin.Data, joint: str) -> ProposedThruster:
    """Return the thruster that a joint turns."""
    index = model.getJointId(joint)
    X = data.oMi[index]
    S = np.array(model.joints[index].createData().S)
    return ProposedThruster(
        name=joint, X=X, direction=X.rotation @ S.ravel()[3:], source="axis of the joint"
    )


def _fixed_thruster(models: UrdfModels, data: pin.Data, frame: int) -> ProposedThruster:
    """Return the thruster of a link, by the index of its frame."""
    X = data.oMf[frame]
    cylinder = _cylinder_of(models.visual, frame)
    if cylinder is None:
        direction = X.rotation[:, 0]
        source = "x axis of the link"
    else:
        direction = cylinder.placement.rotation[:, 2]
        source = "axis of its cylinder"
    name = models.model.frames[frame].name
    return ProposedThruster(name=name, X=X, direction=direction, source=source)


def _ducts(
    links: Sequence[int],
    link_places: Sequence[np.ndarray],
    propeller_places: Sequence[np.ndarray],
    robot_size: float,
) -> set[int]:
    """Return the links in which a propeller turns: those at its place, or all where each has one
    nearby.

    places: (3,) [m] in B.
    """
    distances = dict[int, float]()  # [m] to the nearest propeller
    for i, place in zip(links, link_places, strict=True):
        to_propellers = [float(np.linalg.norm(place - other)) for other in propeller_places]
        distances[i] = min(to_propellers, default=np.inf)
    nearby = {i for i, distance in distances.items() if distance < _NEARBY * robot_size}
    if len(nearby) == len(links):
        return nearby
    return {i for i, distance in distances.items() if distance < _SAME_PLACE * robot_size}


def _name_of_link(model: pin.Model, name: str) -> str:
    """Return the name of the link that a joint moves, or of the link itself."""
    if not model.existJointName(name):
        return name
    joint = model.getJointId(name)
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.parentJoint == joint:
            return str(frame.name)
    return name


def _names_of(model: pin.Model, name: str) -> list[str]:
    """Return the names of a thruster's link and of the joint that carries it."""
    link = _name_of_link(model, name)
    frame = model.frames[model.getFrameId(link)]
    return [link, str(model.frames[frame.parentFrame].name)]


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
