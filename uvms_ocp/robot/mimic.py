"""Resolve joints that mimic another one: whom they follow in the end, where that puts them, and
models and descriptions in which they move as one.

Where joints move as one there is one coordinate of q, and one of v, for all of them: that of the
first in Pinocchio's order.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.description import JointDescription
from uvms_ocp.robot.urdf_elements import read_number
from uvms_ocp.robot.urdf_findings import Findings

Element = ElementTree.Element
Groups = dict[str, dict[str, tuple[float, float]]]
"""``multiplier`` and ``offset`` of all joints that move as one, by the name of their leader, which
is one of them.
"""


def leader_of(
    findings: Findings, root: Element, joint: Element, held: Collection[str]
) -> tuple[Element | None, float, float]:
    """Return the joint that one which mimics follows in the end, `None` for none, with
    ``multiplier`` and ``offset``.

    held: joints that follow none, as it is known where they are.
    """
    leader: Element | None = joint
    scale = 1.0
    offset = 0.0
    visited = [joint.get("name")]
    while leader is not None:
        mimic = leader.find("mimic")
        if mimic is None:
            break
        if leader is not joint and leader.get("name") in held:
            break
        where = f"joint {leader.get('name')!r} mimic"
        name = mimic.get("joint", "")
        offset += scale * _number(findings, mimic, "offset", f"{where} offset", 0.0)
        scale *= _number(findings, mimic, "multiplier", f"{where} multiplier", 1.0)
        if name in visited:
            leader = None
        else:
            leader = root.find(f"joint[@name={name!r}]")
        visited.append(name)
        if leader is None:
            findings.notes.append(
                f"joint {joint.get('name')!r} mimics {name!r}, which leads nowhere; that is taken"
                " as 0"
            )
    return leader, scale, offset


def _number(
    findings: Findings, element: Element | None, key: str, where: str, default: float
) -> float:
    number = findings.attempt(read_number, findings.path, element, key, where, default)
    if number is None:
        return default
    return number


def position_of(findings: Findings, joint: Element, held: Mapping[str, float]) -> float:
    """Return the position of a joint: as given, or else 0, or mid-range."""
    name = joint.get("name", "")
    limit = joint.find("limit")
    if name in held:
        return held[name]
    lower = _number(findings, limit, "lower", f"joint {name!r} lower", 0.0)
    upper = _number(findings, limit, "upper", f"joint {name!r} upper", 0.0)
    is_bounded = joint.get("type") in ("revolute", "prismatic") and limit is not None
    if lower <= 0.0 <= upper or not is_bounded:
        return 0.0
    return (lower + upper) / 2


def coupled(model: pin.Model, groups: Groups) -> pin.Model:
    """Couple joints with those that they mimic: the first of them, in Pinocchio's order, has the
    coordinate of all.
    """
    for leader_name, group in groups.items():
        first_name, *follower_names = sorted(group, key=model.getJointId)
        index = {name: model.getJointId(name) for name in group}
        first = model.joints[index[first_name]]
        leader = model.joints[index[leader_name]]
        scale, offset = group[first_name]
        with np.errstate(over="ignore"):  # of what has no limit
            bound_at_lower = scale * model.lowerPositionLimit[leader.idx_q] + offset
            bound_at_upper = scale * model.upperPositionLimit[leader.idx_q] + offset
            speed = abs(scale) * model.upperVelocityLimit[leader.idx_v]
            effort = model.upperEffortLimit[leader.idx_v] / abs(scale)
        damping = 0.0
        for name, (multiplier, _) in group.items():
            joint = model.joints[index[name]]
            damping += (multiplier / scale) ** 2 * model.damping[joint.idx_v]
        lower, upper = sorted((bound_at_lower, bound_at_upper))
        model.lowerPositionLimit[first.idx_q] = lower
        model.upperPositionLimit[first.idx_q] = upper
        model.upperVelocityLimit[first.idx_v] = speed
        model.upperEffortLimit[first.idx_v] = effort
        model.damping[first.idx_v] = damping
        for name in follower_names:
            multiplier, follower_offset = group[name]
            ratio = multiplier / scale
            shift = follower_offset - ratio * offset
            model = pin.transformJointIntoMimic(model, index[first_name], index[name], ratio, shift)
    return model


def coupled_entries(
    entries: Mapping[str, JointDescription], model: pin.Model, groups: Groups
) -> dict[str, JointDescription]:
    """Return the entries of a description by joint, of joints that move as one as one entry: that
    of the first, in its coordinate.

    model: in which they move as one.
    """
    coupled_entries = dict(entries)
    for group in groups.values():  # each has its leader first
        first_name = min(group, key=model.getJointId)
        members = {name: entries[name] for name in group if name in entries}
        if members.keys() <= {first_name}:
            continue
        for name in members:
            del coupled_entries[name]
        coupled_entries[first_name] = _entry_of_group(members, group, first_name)
    return coupled_entries


def _entry_of_group(
    members: Mapping[str, JointDescription],
    group: Mapping[str, tuple[float, float]],
    first_name: str,
) -> JointDescription:
    """Return the entry of joints that move as one, in the coordinate of the first.

    Rotors add up by the squares of their speeds, no joint exceeds its acceleration, and the home is
    the leader's, or else that of the first follower with one.
    """
    scale, offset = group[first_name]
    rotor_inertia = 0.0
    accelerations = list[float]()
    homes = list[float]()
    for name, entry in members.items():
        multiplier, member_offset = group[name]
        ratio = multiplier / scale
        rotor_inertia += ratio**2 * entry.rotor_inertia
        if entry.acceleration is not None:
            accelerations.append(entry.acceleration / abs(ratio))
        if entry.home is not None:
            homes.append(scale * (entry.home - member_offset) / multiplier + offset)
    return JointDescription(
        rotor_inertia=rotor_inertia,
        acceleration=min(accelerations, default=None),
        home=next(iter(homes), None),
    )
