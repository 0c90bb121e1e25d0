"""Thrusters that a file states for simulators: of uuv_simulator, of Gazebo, of forces at sites of
MuJoCo. They say which joint or link pushes, how much at most, and how fast.

uuv_simulator clamps what is asked, lags it, turns it into thrust and clamps that; thrust acts along
the axis of the joint. Gazebo's thrust acts along the axis of the joint, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from uvms_ocp.robot.urdf_elements import Element, quoted, to_float, to_floats

_READ = {
    "linkName",
    "link_name",
    "jointName",
    "joint_name",
    "axis",
    "gain",
    "clampMin",
    "clampMax",
    "thrustMin",
    "thrustMax",
    "min_thrust_cmd",
    "max_thrust_cmd",
    "thrust_efficiency",
    "propeller_efficiency",
    "dynamics",
    "conversion",
}
_NAMES_ONLY = {
    "namespace",
    "robotNamespace",
    "topic",
    "thrusterID",
    "velocity_control",
    "use_angvel_cmd",
    "thrust_coefficient",
    "fluid_density",
    "propeller_diameter",
    "p_gain",
    "i_gain",
    "d_gain",
}
"""Words by which a simulator turns a propeller, or talks; here thrust is commanded."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SimulatorThruster:
    """A thruster as a plugin states it."""

    link: str | None
    """Link that it pushes; `None` where only its joint is named."""
    joint: str | None
    """Joint along whose axis it pushes; `None` where only its link is named."""
    direction: np.ndarray | None
    """Direction (3,) in the link; `None` for the axis of the joint, or x of the link."""
    minimum: float | None
    """[N]; `None` where none is stated, as for the next two."""
    maximum: float | None
    """[N] largest thrust."""
    time_constant: float | None
    """[s] time constant."""


def simulator_thrusters(root: Element) -> Iterator[tuple[SimulatorThruster, list[str]]]:
    """Yield the thrusters that plugins of a <robot> state, each with its words that are not read; one
    that names no joint and no link has neither.
    """
    for plugin in (*root.findall("gazebo/plugin"), *root.findall("plugin")):
        name = name_of_plugin(plugin)
        link = first_text(plugin, ("linkName", "link_name"))
        joint = first_text(plugin, ("jointName", "joint_name"))
        is_thruster = "thruster" in name and "manager" not in name
        if not is_thruster:
            continue
        minimum, maximum = _limits(plugin)
        time_constant = _number(plugin, "dynamics/timeConstant")
        axis = np.array(to_floats(plugin.findtext("axis", "")))
        direction = axis if axis.size == 3 and np.isfinite(axis).all() else None
        thruster = SimulatorThruster(
            link=link,
            joint=joint,
            direction=direction,
            minimum=minimum,
            maximum=maximum,
            time_constant=time_constant if time_constant and time_constant > 0.0 else None,
        )
        yield thruster, [part.tag for part in plugin if part.tag not in _READ | _NAMES_ONLY]


def name_of_plugin(plugin: Element) -> str:
    """Return the name of a plugin and of its library, in small letters."""
    return f"{plugin.get('name', '')} {plugin.get('filename', '')}".lower()


def first_text(plugin: Element, tags: Sequence[str]) -> str | None:
    """Return the text of the first of these elements that has one; `None` without any."""
    for tag in tags:
        text = plugin.findtext(tag, "").strip()
        if text:
            return text
    return None


def _number(element: Element, place: str) -> float | None:
    """Return the number of an element, `None` where there is none."""
    text = element.findtext(place)
    if text is None:
        return None
    value = to_float(text.strip())
    return None if np.isnan(value) else value


def _limits(plugin: Element) -> tuple[float | None, float | None]:
    """Return the least and the largest thrust [N], both `None` unless both are stated and of either
    sign.
    """
    stated = (_number(plugin, "min_thrust_cmd"), _number(plugin, "max_thrust_cmd"))
    if None not in stated:
        return _of_either_sign(stated)
    at_clamps = list[float | None]()
    for word in ("clampMin", "clampMax"):
        at_clamps.append(_thrust_at(plugin, _number(plugin, word)))
    clamped = sorted(value for value in at_clamps if value is not None)
    low: float | None = None
    high: float | None = None
    if len(clamped) == 2:
        low, high = clamped
    for word in ("thrustMin", "thrustMax"):
        bound = _number(plugin, word)
        if bound is None:
            continue
        if word == "thrustMin":
            low = bound if low is None else max(low, bound)
        else:
            high = bound if high is None else min(high, bound)
    return _of_either_sign((low, high))


def _of_either_sign(
    limits: tuple[float | None, float | None],
) -> tuple[float | None, float | None]:
    low, high = limits
    if low is None or high is None or not low <= 0.0 < high:
        return None, None
    return low, high


def _thrust_at(plugin: Element, asked: float | None) -> float | None:
    """Return the steady thrust [N] of uuv_simulator at an input; `None` for a conversion that is
    not read.
    """
    if asked is None:
        return None
    conversion = plugin.find("conversion")
    gain = _number(plugin, "gain")
    propeller = _number(plugin, "propeller_efficiency")
    state = asked
    for factor in (gain, propeller):
        state *= 1.0 if factor is None else factor
    thrust = None if conversion is None else _converted(conversion, state)
    efficiency = _number(plugin, "thrust_efficiency")
    if thrust is None or efficiency is None:
        return thrust
    return efficiency * thrust


def _converted(conversion: Element, state: float) -> float | None:
    """Return the thrust [N] at a state of the rotor."""
    kind = conversion.findtext("type", "").strip()
    if kind == "Basic":
        constant = _number(conversion, "rotorConstant")
        if constant is None:
            return None
        return constant * abs(state) * state
    if kind == "Bessa":
        return _bessa(conversion, state)
    if kind == "LinearInterp":
        inputs = np.array(to_floats(" ".join(conversion.findtext("inputValues", "").split())))
        outputs = np.array(to_floats(" ".join(conversion.findtext("outputValues", "").split())))
        if inputs.size != outputs.size or inputs.size < 2 or not (np.diff(inputs) > 0.0).all():
            return None
        return float(np.interp(state, inputs, outputs))
    return None


def _bessa(conversion: Element, state: float) -> float | None:
    """Return the thrust [N] of a dead zone with another slope on either side."""
    words = ("rotorConstantL", "rotorConstantR", "deltaL", "deltaR")
    slope_left, slope_right, delta_left, delta_right = (_number(conversion, w) for w in words)
    if slope_left is None or slope_right is None or delta_left is None or delta_right is None:
        return None
    square = abs(state) * state
    if square <= delta_left:
        return slope_left * (square - delta_left)
    if square >= delta_right:
        return slope_right * (square - delta_right)
    return 0.0


def thruster_name(thruster: SimulatorThruster) -> str:
    """Return what a message calls it."""
    return quoted(thruster.joint or thruster.link or "")
