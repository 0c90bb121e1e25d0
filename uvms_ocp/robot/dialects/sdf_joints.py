"""Joints of SDF as those of a URDF: their axes may be stated in other frames, and one joint may turn
about two axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.dialects.sdf_frames import FrameGraph
from uvms_ocp.robot.dialects.urdf_writer import WrittenJoint
from uvms_ocp.robot.urdf_elements import Element, quoted, to_float, to_floats

_ENDLESS = 1e15  # [rad or m] a limit beyond it is none
_AXES_OF_MODEL_BEFORE = 1.5
"""Version up to which axes were stated in the frame of the model."""
_KINDS = ("revolute", "continuous", "prismatic", "fixed", "revolute2", "universal")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SdfJoint:
    """A joint with the full names of what it joins."""

    element: Element
    parent: str
    child: str
    scope: str
    """Prefix of names in its model."""
    frame: str
    """Frame of its model."""


def written_joints(
    graph: FrameGraph, name: str, joint: SdfJoint, version: float
) -> Iterator[WrittenJoint]:
    """Yield the joints of a URDF that one of SDF is. Raises `InvalidInput` for kinds that a URDF
    does not have.
    """
    kind = joint.element.get("type", "")
    if kind not in _KINDS:
        raise InvalidInput(f"type {quoted(kind)}; allowed: {', '.join(_KINDS)}")
    parent = joint.parent if joint.parent == "world" else graph.link_of(joint.parent)
    child = graph.link_of(joint.child)
    X_J = graph.placement(name)
    whole = WrittenJoint(
        name=name,
        kind=kind,
        parent=parent,
        child=child,
        X_PJ=graph.placement(parent).actInv(X_J),
        X_JC=X_J.actInv(graph.placement(child)),
        axis=np.array([0.0, 0.0, 1.0]),
    )
    if kind == "fixed":
        yield whole
        return
    if kind in ("revolute2", "universal"):
        between = f"{name}_between"
        first = replace(
            whole, name=f"{name}_1", kind="revolute", child=between, X_JC=pin.SE3.Identity()
        )
        second = replace(
            whole, name=f"{name}_2", kind="revolute", parent=between, X_PJ=pin.SE3.Identity()
        )
        yield _with_axis(first, graph, joint, "axis", version)
        yield _with_axis(second, graph, joint, "axis2", version)
        return
    yield _with_axis(whole, graph, joint, "axis", version)


def _with_axis(
    written: WrittenJoint, graph: FrameGraph, joint: SdfJoint, tag: str, version: float
) -> WrittenJoint:
    """Return the joint with its axis, limits and losses."""
    axis = joint.element.find(tag)
    if axis is None:
        raise InvalidInput(f"no <{tag}>; allowed: one, with its <xyz>")
    lower = _limit(axis, "lower", -np.inf)
    upper = _limit(axis, "upper", np.inf)
    kind = written.kind
    if kind == "revolute" and np.isinf([lower, upper]).all():
        kind = "continuous"
    return replace(
        written,
        kind=kind,
        axis=_direction(axis, graph, joint, version),
        lower=lower,
        upper=upper,
        velocity=_largest(axis, "velocity"),
        effort=_largest(axis, "effort"),
        damping=max(_number(axis, "dynamics/damping", 0.0), 0.0),
        friction=max(_number(axis, "dynamics/friction", 0.0), 0.0),
        mimics=_leader(axis, joint.scope),
    )


def _direction(axis: Element, graph: FrameGraph, joint: SdfJoint, version: float) -> np.ndarray:
    """Return the axis (3,) in the frame of the joint."""
    xyz = axis.find("xyz")
    text = "0 0 1" if xyz is None else " ".join((xyz.text or "").split())
    direction = np.array(to_floats(text))
    if direction.size != 3 or not np.linalg.norm(direction) > 0.0:
        raise InvalidInput(f"<xyz>: given {quoted(text)}; allowed: three numbers, not all 0")
    X_J = graph.placement(joint.scope + joint.element.get("name", ""))
    stated_in = "" if xyz is None else xyz.get("expressed_in", "")
    if stated_in == "__model__":
        X_stated = graph.placement(joint.frame)
    elif stated_in:
        X_stated = graph.placement(joint.scope + stated_in)
    elif _is_of_model(axis, version):
        X_stated = graph.placement(joint.frame)
    else:
        return direction
    return np.asarray(X_J.rotation.T @ X_stated.rotation @ direction)


def _is_of_model(axis: Element, version: float) -> bool:
    """Check whether the axis is stated in the frame of the model, as in older versions."""
    words = axis.findtext("use_parent_model_frame")
    if words is None:
        return version < _AXES_OF_MODEL_BEFORE
    return words.strip().lower() in ("1", "true")


def _number(element: Element, place: str, default: float) -> float:
    text = element.findtext(place)
    if text is None:
        return default
    if text.strip().lower().lstrip("+-") in ("inf", "infinity"):
        return -np.inf if text.strip().startswith("-") else np.inf
    value = to_float(text.strip())
    if np.isnan(value):
        raise InvalidInput(f"<{place.rpartition('/')[2]}>: given {quoted(text)}; allowed: a number")
    return value


def _limit(axis: Element, word: str, default: float) -> float:
    value = _number(axis, f"limit/{word}", default)
    if abs(value) > _ENDLESS:
        return default
    return value


def _largest(axis: Element, word: str) -> float:
    """Return the largest speed or effort, 0 for no limit, which SDF writes as -1 or infinite."""
    value = _number(axis, f"limit/{word}", 0.0)
    if not 0.0 < value < _ENDLESS:
        return 0.0
    return value


def _leader(axis: Element, scope: str) -> tuple[str, float, float] | None:
    """Return the joint that this one follows, with multiplier and offset."""
    mimic = axis.find("mimic")
    if mimic is None:
        return None
    multiplier = _number(mimic, "multiplier", 1.0)
    offset = _number(mimic, "offset", 0.0) - multiplier * _number(mimic, "reference", 0.0)
    return scope + mimic.get("joint", ""), multiplier, offset
