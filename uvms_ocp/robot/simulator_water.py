"""Water that a robot file states for simulators, in ``<gazebo><plugin>``: of uuv_simulator (Manhães
et al., UUV Simulator, 2016) and of Gazebo's own hydrodynamics, and in ``<fluid_added_mass>`` of SDF.

Both follow Fossen: added mass [kg, kg m, kg m2] and drag act at the origin of the link, and drag is
written as the derivative of the force, below 0. uuv_simulator has its matrices in axes forward,
starboard, down, and a centre of buoyancy in those of the link; Gazebo has numbers on the diagonal,
whose sign files write either way. SDF has the upper half of the matrix of added mass, above 0.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic import ValidationError

from uvms_ocp.robot.description import LinkCoefficients, as_matrix6
from uvms_ocp.robot.simulator_thrusters import (
    SimulatorThruster,
    simulator_thrusters,
    thruster_name,
)
from uvms_ocp.robot.urdf_elements import Element, quoted, to_float, to_floats

_STARBOARD_DOWN = np.diag([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
"""Turns a twist from forward, left, up to forward, starboard, down, and back."""
_SDF_AXES = "xyzpqr"
_AXES = ("xU", "yV", "zW", "kP", "mQ", "nR")
_WORDS = {
    "added_mass": "added mass",
    "linear_drag": "linear drag",
    "quadratic_drag": "quadratic drag",
    "volume": "volume",
    "centre_of_buoyancy": "centre of buoyancy",
}
_READ_BY_UUV = {"added_mass", "linear_damping", "quadratic_damping", "type"}
_SETTINGS = {"link_name", "water_density", "waterDensity", "namespace", "default_current", "topic"}


@dataclass(frozen=True, kw_only=True, slots=True)
class SimulatorWater:
    """Water of one link as a plugin states it."""

    simulator: str
    """Simulator or format whose plugin states it."""
    coefficients: Mapping[str, Any]
    """Fields of `LinkCoefficients` that are stated, in the link's axes at its origin."""

    @property
    def source(self) -> str:
        """Words for what is stated and where."""
        stated = [_WORDS[key] for key in self.coefficients]
        return f"{', '.join(stated)} of its {self.simulator}"


@dataclass(kw_only=True, slots=True)
class SimulatorBlocks:
    """Statements of the plugins of a URDF about the water on its links."""

    links: dict[str, SimulatorWater] = field(default_factory=dict)
    """Water by link."""
    thrusters: list[SimulatorThruster] = field(default_factory=list)
    """Thrusters in the order of the file."""
    density: float | None = None
    """[kg/m3] density of the water; `None` where no plugin states it."""
    unread: list[str] = field(default_factory=list)
    """Elements of plugins that are not used, one line each."""


def simulator_blocks(root: Element) -> SimulatorBlocks:
    """Read the water that the plugins of a <robot> state."""
    blocks = SimulatorBlocks()
    links = {link.get("name", "") for link in root.findall("link")}
    for plugin in (*root.findall("gazebo/plugin"), *root.findall("plugin")):
        name = f"{plugin.get('name', '')} {plugin.get('filename', '')}".lower()
        if plugin.find("link/hydrodynamic_model") is not None:
            _read_uuv(blocks, plugin, links)
        elif "hydrodynamics" in name and plugin.find("link_name") is not None:
            _read_gazebo(blocks, plugin, links)
    for block in root.findall("gazebo[@reference]"):
        for element in block.iter("fluid_added_mass"):
            _read_added_mass(blocks, element, block.get("reference", ""), links)
    _read_thrusters(blocks, root, links)
    return blocks


def _read_thrusters(blocks: SimulatorBlocks, root: Element, links: set[str]) -> None:
    """Keep the thrusters whose joint or link is there."""
    joints = {joint.get("name", "") for joint in root.findall("joint")}
    unread_words = dict[str, None]()
    for thruster, words in simulator_thrusters(root):
        if thruster.joint not in joints and thruster.link not in links:
            name = thruster_name(thruster)
            blocks.unread.append(f"thruster plugin of {name}: no such joint or link")
            continue
        blocks.thrusters.append(thruster)
        unread_words.update(dict.fromkeys(words))
    if unread_words:
        blocks.unread.append(f"of thruster plugins: <{'>, <'.join(unread_words)}>")
    if blocks.thrusters:
        blocks.unread.append("curves of thruster plugins beyond their limits, see `thrusters`")


def _read_added_mass(blocks: SimulatorBlocks, element: Element, name: str, links: set[str]) -> None:
    """Read the added mass of SDF, at the origin of the link in its axes. It is added to that of a
    plugin, as in Gazebo.
    """
    where = f"<fluid_added_mass> of link {quoted(name)}"
    if name not in links:
        blocks.unread.append(f"{where}: no such link")
        return
    matrix = np.zeros((6, 6))
    for row, first in enumerate(_SDF_AXES):
        for column, second in enumerate(_SDF_AXES[row:], start=row):
            text = element.findtext(first + second)
            if text is not None:
                matrix[row, column] = matrix[column, row] = to_float(text.strip())
    stated: dict[str, Any] = {}
    simulator = "SDF"
    if name in blocks.links:
        stated.update(blocks.links[name].coefficients)
        simulator = f"{blocks.links[name].simulator} and SDF"
    if "added_mass" in stated:
        matrix = matrix + as_matrix6(stated["added_mass"])
    stated["added_mass"] = _matrix_of_rows(matrix)
    _take(blocks, name, simulator, stated, where)


def _read_uuv(blocks: SimulatorBlocks, plugin: Element, links: set[str]) -> None:
    """Read the plugin of uuv_simulator, which has an element for each link."""
    _note_density(blocks, plugin.findtext("fluid_density"))
    for element in plugin.findall("link"):
        name = element.get("name", "")
        model = element.find("hydrodynamic_model")
        if model is None:
            continue
        where = f"water of link {quoted(name)} (uuv_simulator)"
        kind = model.findtext("type", "").strip()
        if name not in links:
            blocks.unread.append(f"{where}: no such link")
            continue
        if kind != "fossen":
            blocks.unread.append(f"{where}: type {quoted(kind)} is not read, only fossen")
            continue
        for part in model:
            if part.tag not in _READ_BY_UUV:
                blocks.unread.append(f"{where}: <{part.tag}> is not modelled")
        stated = dict[str, Any]()
        for key, tag, sign in (
            ("added_mass", "added_mass", 1.0),
            ("linear_drag", "linear_damping", -1.0),
            ("quadratic_drag", "quadratic_damping", -1.0),
        ):
            text = model.findtext(tag)
            if text is not None:
                stated[key] = _matrix(text, sign)
        volume = element.findtext("volume")
        is_neutral = element.findtext("neutrally_buoyant", "0").strip().lower() in ("1", "true")
        if volume is not None and not is_neutral:
            stated["volume"] = to_float(volume.strip())
            centre = to_floats(" ".join(element.findtext("center_of_buoyancy", "0 0 0").split()))
            stated["centre_of_buoyancy"] = centre
        _take(blocks, name, "uuv_simulator plugin", stated, where)


def _read_gazebo(blocks: SimulatorBlocks, plugin: Element, links: set[str]) -> None:
    """Read Gazebo's plugin, which has one number for each axis."""
    name = plugin.findtext("link_name", "").strip()
    where = f"water of link {quoted(name)} (Gazebo)"
    if name not in links:
        blocks.unread.append(f"{where}: no such link")
        return
    _note_density(blocks, plugin.findtext("water_density") or plugin.findtext("waterDensity"))
    quadratic = [f"{axis}{axis[1]}" for axis in _AXES]
    quadratic_of_speed = [f"{axis}abs{axis[1]}" for axis in _AXES]
    added = [f"{axis[0]}Dot{axis[1]}" for axis in _AXES]
    stated = dict[str, Any]()
    for key, tags in (
        ("added_mass", [(tag,) for tag in added]),
        ("linear_drag", [(tag,) for tag in _AXES]),
        ("quadratic_drag", list(zip(quadratic, quadratic_of_speed, strict=True))),
    ):
        values = [_first_number(plugin, names) for names in tags]
        if any(values):
            stated[key] = tuple(abs(value) for value in values)
    read = {*_AXES, *quadratic, *quadratic_of_speed, *added, *_SETTINGS}
    unread_tags = [part.tag for part in plugin if part.tag not in read and to_float(part.text)]
    if unread_tags:
        blocks.unread.append(f"{where}: <{'>, <'.join(unread_tags)}> is not modelled")
    _take(blocks, name, "Gazebo plugin", stated, where)


def _first_number(plugin: Element, tags: tuple[str, ...]) -> float:
    """Return the number of the first of these elements that is there, 0 without any."""
    for tag in tags:
        text = plugin.findtext(tag)
        if text is not None:
            return to_float(text.strip())
    return 0.0


def _matrix(text: str, sign: float) -> Any:
    """Return 6 numbers, or 36 as rows in the link's axes, times a sign; `None` for other texts."""
    values = sign * np.array(to_floats(" ".join(text.split())))
    if values.size == 6:
        return tuple((values + 0.0).tolist())
    if values.size != 36:
        return None
    return _matrix_of_rows(_STARBOARD_DOWN @ values.reshape(6, 6) @ _STARBOARD_DOWN + 0.0)


def _matrix_of_rows(matrix: np.ndarray) -> Any:
    """Return rows of a matrix (6, 6), or its diagonal where it has nothing beside."""
    if not np.any(matrix - np.diag(np.diag(matrix))):
        return tuple(np.diag(matrix).tolist())
    return tuple(tuple(row) for row in matrix.tolist())


def _note_density(blocks: SimulatorBlocks, text: str | None) -> None:
    """Keep the density that a plugin states, if any."""
    density = to_float(text.strip()) if text is not None else 0.0
    if density > 0.0:
        blocks.density = density


def _take(
    blocks: SimulatorBlocks, name: str, simulator: str, stated: Mapping[str, Any], where: str
) -> None:
    """Keep the coefficients of a link that water can have, and name the others."""
    possible = dict[str, Any]()
    for key, value in stated.items():
        try:
            fields = {"volume": 1.0} if key == "centre_of_buoyancy" else {}
            LinkCoefficients.model_validate(fields | {key: value})
        except ValidationError as error:
            reason = error.errors()[0]["msg"].removeprefix("Value error, ")
            blocks.unread.append(f"{where}: {_WORDS[key]} is not used, {reason}")
            continue
        possible[key] = value
    if not possible.get("volume"):
        possible.pop("volume", None)
        possible.pop("centre_of_buoyancy", None)
    if possible:
        blocks.links[name] = SimulatorWater(simulator=simulator, coefficients=possible)


def unread_lines(blocks: SimulatorBlocks) -> Iterator[str]:
    """Yield what is taken from the plugins and what is not, one line each."""
    for name, water in blocks.links.items():
        yield f"water of {name}: {water.source}"
    for line in dict.fromkeys(blocks.unread):
        yield f"not read: {line}"
