"""Actuators of MJCF as limits of effort and forces at sites, and joints that follow others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from uvms_ocp.robot.dialects.mjcf_values import Defaults, vector
from uvms_ocp.robot.urdf_elements import Element, quoted
from uvms_ocp.robot.urdf_findings import Findings

_DIRECT = ("motor", "general")
"""Actuators whose force is gear times what is asked of them."""
_FOLLOWS = "joint"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SiteForce:
    """A force that an actuator exerts at a site."""

    direction: np.ndarray
    """Unit vector (3,) in the frame of the site."""
    minimum: float
    """[N], equal to `maximum` where the file states no limit."""
    maximum: float
    """[N] largest force."""


def _actuators(root: Element, defaults: Defaults) -> Iterator[tuple[Element, dict[str, str]]]:
    for section in root.findall("actuator"):
        for element in section:
            yield element, defaults.attributes(element, None)


def _force_range(element: Element, values: dict[str, str]) -> tuple[float, float]:
    """Return the least and the largest force before the gear, equal where none is stated."""
    if "forcerange" in values:
        low, high = vector(values, "forcerange", [0.0, 0.0])
        return float(low), float(high)
    is_direct = element.tag == "motor" or "biastype" not in values
    if element.tag in _DIRECT and is_direct and "ctrlrange" in values:
        low, high = vector(values, "ctrlrange", [0.0, 0.0])
        gain = 1.0
        if element.tag == "general" and "gainprm" in values:
            gain = float(vector(values, "gainprm", [])[0])
        return float(min(low * gain, high * gain)), float(max(low * gain, high * gain))
    return 0.0, 0.0


def effort_limits(root: Element, defaults: Defaults) -> dict[str, float]:
    """Return the largest effort [N m or N] of joints by name, as their actuators have it."""
    efforts = dict[str, float]()
    for element, values in _actuators(root, defaults):
        joint = values.get("joint") or values.get("jointinparent")
        if joint is None:
            continue
        low, high = _force_range(element, values)
        gear = 1.0
        if "gear" in values:
            gear = float(vector(values, "gear", [])[:1].sum())
        effort = max(abs(low), abs(high)) * abs(gear)
        efforts[joint] = max(efforts.get(joint, 0.0), effort)
    return efforts


def site_forces(root: Element, defaults: Defaults) -> dict[str, list[SiteForce]]:
    """Return the forces at sites by the name of the site; torques and forces that are stated in the
    frame of another site are none.
    """
    forces = dict[str, list[SiteForce]]()
    for element, values in _actuators(root, defaults):
        site = values.get("site")
        if site is None or "refsite" in values:
            continue
        gear = np.zeros(6)
        stated = vector(values, "gear", [])
        gear[: stated.size] = stated[:6]
        gain = float(np.linalg.norm(gear[:3]))
        if gain == 0.0:
            continue
        low, high = _force_range(element, values)
        force = SiteForce(direction=gear[:3] / gain, minimum=low * gain, maximum=high * gain)
        forces.setdefault(site, []).append(force)
    return forces


def leaders(
    findings: Findings, root: Element, defaults: Defaults
) -> dict[str, tuple[str, float, float]]:
    """Return the joints that follow another one, by name, with that one's name, multiplier and
    offset; other equalities are noted.
    """
    followers = dict[str, tuple[str, float, float]]()
    for section in root.findall("equality"):
        for element in section:
            values = defaults.attributes(element, None)
            leader = values.get("joint2")
            polynomial = np.zeros(5)
            polynomial[1] = 1.0
            stated = vector(values, "polycoef", [])
            polynomial[: stated.size] = stated
            is_linear = element.tag == _FOLLOWS and leader and not polynomial[2:].any()
            if is_linear and leader is not None:
                follower = values.get("joint1", "")
                followers[follower] = (leader, float(polynomial[1]), float(polynomial[0]))
            else:
                name = quoted(values.get("name", ""))
                findings.notes.append(f"<equality> <{element.tag}> {name} is not kept")
    return followers
