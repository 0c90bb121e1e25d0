"""Tell of what kind the joints are that are no part of an arm: they turn propellers, sensors or spinning
tools, close grippers, slide ballast, or move nothing.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from uvms_ocp.robot.link_tree import LinkTree
from uvms_ocp.robot.size import size

_BALANCED = 0.1
"""Distance of a propeller's centre of mass from its axis, at most, over that from its joint."""
_SHORT = 0.1
"""[m] Distance of a centre of mass from the joint that is counted at least, or `_SHORT_SHARE` if that is
less.
"""
_SHORT_SHARE = 0.4
"""Sizes of the robot, of the same distance."""
_GIMBAL_JOINTS = 2  # between the vehicle and a thruster that they point, at most
HEAD_JOINTS = 2  # of a head that pans and tilts
_FINGER_JOINTS = 3  # of a finger that bends, no more than the arm has that it is on
_ALONG = 0.99  # cosine to an axis of the vehicle, of what slides along it
_SLIDING = ("JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismaticUnaligned")

KINDS = (
    "propellers",
    "sensors",
    "fingers",
    "empty",
    "held",
    "gimbals",
    "spinners",
    "ballast",
    "heads",
    "branches",
)
"""Fields of `Roles` that say of what kind joints are."""


def kinds_of(tree: LinkTree) -> Iterator[tuple[int, str]]:
    """Yield joints that are no part of an arm, with what they do."""
    for joint in tree.moving:
        below = tree.below(joint)
        if _carries_propellers_alone(tree, joint):
            yield joint, "gimbals" if tree.children(joint) else "propellers"
        elif _bends_a_fin(tree, joint):
            yield joint, "gimbals"
        elif not any(tree.model.inertias[k].mass for k in below):
            yield joint, "empty"
        elif _has_no_range(tree, joint):
            yield joint, "held"
        elif _carries_sensors_alone(tree, joint):
            yield joint, "sensors"
        elif _whirls(tree, joint):
            yield joint, "propellers"
        elif _spins_a_tool(tree, joint):
            yield joint, "spinners"
        elif _is_finger(tree, joint):
            for finger_joint in below:
                yield finger_joint, "fingers"
        elif _slides_ballast(tree, joint):
            yield joint, "ballast"
        elif _points_sensors(tree, joint):
            for head_joint in below:
                yield head_joint, "heads"
        elif _is_beside_longer_part(tree, joint):
            yield joint, "branches"


def _carries_propellers_alone(tree: LinkTree, joint: int) -> bool:
    """Check whether a joint turns a propeller of the vehicle, or points some of them: what ends in
    one after more joints, or after a joint and before an end stop, or holds a tool beside it, is an
    arm.
    """
    if tree.ends_in_tool(joint):
        return False
    for k in tree.below(joint):
        if tree.children(k):
            continue
        names = tree.names(k)
        if not tree.words.is_called("propeller", *names):
            return False
        n_above = len(tree.above(k))
        has_end = tree.has_range(k) and not tree.is_endless(k)
        is_arm = n_above > 0 and has_end and not tree.words.is_called("fin", *names)
        if is_arm or n_above > _GIMBAL_JOINTS:
            return False
    return True


def _has_no_range(tree: LinkTree, joint: int) -> bool:
    """Check whether a joint has no range, and either carries joints that have some, or is part of a
    chain of which none has. At the end of an arm it fixes its hand.
    """
    if tree.has_range(joint):
        return False
    carries_moving = any(tree.has_range(k) for k in tree.below(joint))
    return carries_moving or not any(tree.has_range(k) for k in tree.above(joint))


def _bends_a_fin(tree: LinkTree, joint: int) -> bool:
    """Check whether a joint is one of a fin of the vehicle, such as that of its tab."""
    if tree.carrier == 0:
        return False
    chain = [*tree.above(joint), joint]
    chain += tree.below(joint)[1:]
    if len(chain) > _GIMBAL_JOINTS or tree.ends_in_tool(chain[0]):
        return False
    names = list[str]()
    for k in chain:
        names += tree.names(k)
    return tree.words.is_called("fin", *names)


def _spins_a_tool(tree: LinkTree, joint: int) -> bool:
    """Check whether a joint without end is the last of an arm, and is called a blade or alike."""
    is_last = not tree.children(joint)
    if not (tree.is_endless(joint) and is_last and tree.above(joint)):
        return False
    names = tree.names(joint)
    return tree.words.is_called("spinner", *names) or tree.words.is_called("propeller", *names)


def _is_finger(tree: LinkTree, joint: int) -> bool:
    """Check whether a joint closes a gripper: by its name, as one of several alike at the end of an
    arm, or below a frame of its link which is called the tool.
    """
    palm = int(tree.model.parents[joint])
    n_joints = len(tree.below(joint))
    if _is_called_finger(tree, joint):
        return True
    if palm <= tree.carrier or n_joints > _FINGER_JOINTS:
        return False
    if n_joints > 1:
        is_end_of_arm = len(tree.above(joint)) >= n_joints
        is_fork = any(len(tree.children(k)) > 1 for k in tree.below(joint))
        if is_fork or not is_end_of_arm or tree.ends_in_tool(joint):
            return False
    fingers_alike = list[int]()
    for sibling in tree.children(palm):
        is_other = _carries_sensors_alone(tree, sibling) or _spins_a_tool(tree, sibling)
        if len(tree.below(sibling)) == n_joints and not is_other:
            fingers_alike.append(sibling)
    holds_tool = any(i not in tree.inner and tree.is_tip(i) for i in tree.bodies[palm])
    return len(fingers_alike) > 1 or holds_tool


def _is_called_finger(tree: LinkTree, joint: int) -> bool:
    """Check whether a joint is called a finger, and is no wrist that carries fingers."""
    if not tree.words.is_called("finger", *tree.names(joint)):
        return False
    is_palm = any(len(tree.children(k)) > 1 for k in tree.below(joint))
    if not is_palm:
        return True
    siblings = [k for k in tree.children(tree.model.parents[joint]) if k != joint]
    return any(tree.words.is_called("finger", *tree.names(sibling)) for sibling in siblings)


def _slides_ballast(tree: LinkTree, joint: int) -> bool:
    """Check whether a joint slides a mass along an axis of the vehicle: called so, or one of
    several, or beside an arm.
    """
    if not _is_slider(tree, joint):
        return False
    if tree.words.is_called("ballast", *tree.names(joint)):
        return True
    others = [k for k in tree.moving if k != joint and tree.model.parents[k] == tree.carrier]
    return any(_is_slider(tree, k) or len(tree.below(k)) > 1 for k in others)


def _is_slider(tree: LinkTree, joint: int) -> bool:
    """Check whether a joint of the vehicle slides one link, which is no tool, along one of its
    axes.
    """
    if tree.carrier == 0 or tree.model.parents[joint] != tree.carrier or tree.children(joint):
        return False
    moving = tree.model.joints[joint]
    if moving.shortname() not in _SLIDING:
        return False
    if tree.ends_in_tool(joint):
        return False
    direction = np.array(moving.createData().S).ravel()[:3]
    along = tree.model.jointPlacements[joint].rotation @ direction
    return bool(np.abs(along).max() > _ALONG)


def _carries_sensors_alone(tree: LinkTree, joint: int) -> bool:
    """Check whether all links that a joint moves are sensors, on no more joints than a head has."""
    if not _is_called_sensors(tree, joint):
        return False
    first = joint
    for k in tree.above(joint):
        if _is_called_sensors(tree, k):
            first = k
    n_above_first = len(tree.above(first))
    deepest = max(len(tree.above(k)) for k in tree.below(first))
    return deepest - n_above_first < HEAD_JOINTS


def _is_called_sensors(tree: LinkTree, joint: int) -> bool:
    """Check whether all links that a joint moves are called sensors."""
    links = list[int]()
    for k in tree.below(joint):
        links += tree.bodies[k]
    return bool(links) and all(tree.words.is_called("sensor", tree.name(i)) for i in links)


def _points_sensors(tree: LinkTree, joint: int) -> bool:
    """Check whether a joint of the vehicle is the first of a head that points sensors and holds
    nothing else.
    """
    chain = tree.below(joint)
    is_on_vehicle = tree.carrier > 0 and tree.model.parents[joint] == tree.carrier
    if not is_on_vehicle or len(chain) > HEAD_JOINTS:
        return False
    if any(len(tree.children(k)) > 1 for k in chain) or tree.ends_in_tool(joint):
        return False
    fixed_links = [tree.name(i) for i in tree.bodies[chain[-1]][1:]]
    if not fixed_links:
        return False
    return all(tree.words.is_called("sensor", name) for name in fixed_links)


def _is_beside_longer_part(tree: LinkTree, joint: int) -> bool:
    """Check whether a joint is the only one of a branch of an arm, beside the longer part of it: a
    piston that drives it, or a sensor without a name.
    """
    parent = tree.model.parents[joint]
    if parent <= tree.carrier or tree.children(joint) or tree.ends_in_tool(joint):
        return False
    return any(len(tree.below(sibling)) > 1 for sibling in tree.children(parent))


def _whirls(tree: LinkTree, index: int) -> bool:
    """Check whether a joint of the vehicle turns one balanced link without end, as a propeller
    does.
    """
    if tree.carrier == 0 or tree.model.parents[index] != tree.carrier:
        return False
    if len(tree.below(index)) > 1 or len(tree.bodies[index]) > 1:
        return False
    if not tree.is_endless(index):
        return False
    joint = tree.model.joints[index]
    axis = np.array(joint.createData().S).ravel()[3:]
    lever = np.asarray(tree.model.inertias[index].lever)  # [m]
    from_joint = float(np.linalg.norm(lever))  # [m]
    off_axis = float(np.linalg.norm(lever - axis * (axis @ lever)))  # [m]
    short = min(_SHORT, _SHORT_SHARE * size(tree.model))
    return off_axis <= _BALANCED * max(from_joint, short)
