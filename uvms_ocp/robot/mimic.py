"""Joints that mimic another one: whom they follow in the end, where that puts them, and models in
which they move as one.

Where joints move as one there is one coordinate of q, and one of v, for all of them: that of the
first in Pinocchio's order.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.urdf_checks import Findings, read_number

Element = ElementTree.Element
Groups = dict[str, dict[str, tuple[float, float]]]
"""``multiplier`` and ``offset`` of all joints that move as one, by the name of their leader, which
is one of them.
"""


def leader_of(
    findings: Findings, root: Element, joint: Element, held: Collection[str]
) -> tuple[Element | None, float, float]:
    """The joint that one which mimics follows in the end, `None` for none, with ``multiplier`` and
    ``offset``.

    given: joints that follow none, as it is known where they are.
    """
    leader: Element | None = joint
    scale = 1.0
    offset = 0.0
    visited = [joint.get("name")]
    while leader is not None and (mimic := leader.find("mimic")) is not None:
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
    low, up = (
        _number(findings, limit, key, f"joint {name!r} {key}", 0.0) for key in ("lower", "upper")
    )
    bounded = joint.get("type") in ("revolute", "prismatic") and limit is not None
    if low <= 0.0 <= up or not bounded:
        return 0.0
    return (low + up) / 2


def coupled(model: pin.Model, groups: Groups) -> pin.Model:
    """Joints as one with those that they mimic: the first of them, in Pinocchio's order, has the
    coordinate of all.
    """
    for leader, group in groups.items():
        first, *others = sorted(group, key=model.getJointId)
        index = {name: model.getJointId(name) for name in group}
        follower, lead = model.joints[index[first]], model.joints[index[leader]]
        scale, offset = group[first]
        with np.errstate(over="ignore"):  # of what has no limit
            bounds = [
                scale * limit[lead.idx_q] + offset
                for limit in (model.lowerPositionLimit, model.upperPositionLimit)
            ]
            speed = abs(scale) * model.upperVelocityLimit[lead.idx_v]
            effort = model.upperEffortLimit[lead.idx_v] / abs(scale)
        damping = sum(
            (multiplier / scale) ** 2 * model.damping[model.joints[index[name]].idx_v]
            for name, (multiplier, _) in group.items()
        )
        model.lowerPositionLimit[follower.idx_q], model.upperPositionLimit[follower.idx_q] = sorted(
            bounds
        )
        for values, value in (
            (model.upperVelocityLimit, speed),
            (model.upperEffortLimit, effort),
            (model.damping, damping),
        ):
            values[follower.idx_v] = value
        for name in others:
            multiplier, shift = group[name]
            ratio = multiplier / scale
            model = pin.transformJointIntoMimic(
                model, index[first], index[name], ratio, shift - ratio * offset
            )
    return model
