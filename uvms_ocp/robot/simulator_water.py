"""Water that a robot file states for simulators, in ``<gazebo><plugin>``: of uuv_simulator (Manhães
et al., UUV Simulator, 2016), of Gazebo's own hydrodynamics and buoyancy, and in
``<fluid_added_mass>`` of SDF.

Both follow Fossen: added mass [kg, kg m, kg m2] and drag act at the origin of the link, and drag is
written as the derivative of the force, below 0. uuv_simulator has its matrices in axes forward,
starboard, down, and a centre of buoyancy in those of the link; Gazebo has numbers on the diagonal,
whose sign files write either way. SDF has the upper half of the matrix of added mass, above 0.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic import ValidationError

from uvms_ocp.robot.description import LinkCoefficients, as_matrix6
from uvms_ocp.robot.simulator_shapes import OPTIONS, SIZES, missing_sizes, shaped_water
from uvms_ocp.robot.simulator_thrusters import (
    SimulatorThruster,
    first_text,
    name_of_plugin,
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
_ADDED_MASS = [f"{axis[0]}Dot{axis[1]}" for axis in _AXES]
_QUADRATIC_DRAG = [f"{axis}{axis[1]}" for axis in _AXES]
_QUADRATIC_OF_SPEED = [f"{axis}abs{axis[1]}" for axis in _AXES]
_GAZEBO_NUMBERS = {*_AXES, *_ADDED_MASS, *_QUADRATIC_DRAG, *_QUADRATIC_OF_SPEED}
_READ_BY_UUV = {"added_mass", "linear_damping", "quadratic_damping", "type"}
_UUV_OF_LINK = {"volume", "center_of_buoyancy", "neutrally_buoyant", "hydrodynamic_model", "box"}
_UUV_DENSITY = 1028.0  # [kg/m3] where a plugin of uuv_simulator states none
_UUV_OF_PLUGIN = {"link", "fluid_density", "use_global_current", "debug"}
_NAMES_OF_LINK = ("link_name", "bodyName")
_DENSITIES = (
    "fluid_density",
    "water_density",
    "waterDensity",
    "uniform_fluid_density",
    "graded_buoyancy/default_density",
)
_SETTINGS = {*_NAMES_OF_LINK, *_DENSITIES, "namespace", "default_current", "topic"}
_OF_WATER = re.compile(r"hydro(?!phone)|buoy|drag|added_?mass|damping|fluid|wave")
"""Words in the name of a plugin, or of its elements, that speak of water."""


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
        if "thruster" in name_of_plugin(plugin):
            continue
        for place in _DENSITIES:
            _note_density(blocks, plugin.findtext(place))
        if plugin.find("link/hydrodynamic_model") is not None:
            _read_uuv(blocks, plugin, root, links)
        elif first_text(plugin, _NAMES_OF_LINK) and _states_numbers(plugin):
            _read_gazebo(blocks, plugin, links)
        elif plugin.find("link/volume") is not None:
            _read_buoyancy(blocks, plugin, links)
        elif _is_of_water(plugin):
            name = quoted(plugin.get("name") or plugin.get("filename") or "")
            blocks.unread.append(f"plugin {name}, which speaks of water")
    for block in root.findall("gazebo[@reference]"):
        for element in block.iter("fluid_added_mass"):
            _read_added_mass(blocks, element, block.get("reference", ""), links)
    _read_thrusters(blocks, root, links)
    return blocks


def _states_numbers(plugin: Element) -> bool:
    """Check whether a plugin states any number of Gazebo's hydrodynamics."""
    return any(part.tag in _GAZEBO_NUMBERS for part in plugin)


def _is_of_water(plugin: Element) -> bool:
    """Check whether a plugin speaks of water, and states more than the density of it."""
    name = name_of_plugin(plugin)
    tags = [part.tag.lower() for part in plugin if part.tag not in _SETTINGS]
    states_density = any(plugin.find(place) is not None for place in _DENSITIES)
    if states_density and not tags:
        return False
    return any(_OF_WATER.search(word) for word in (name, *tags))


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
    stated, simulator = _with_former(blocks, name, "SDF")
    if "added_mass" in stated:
        matrix = matrix + as_matrix6(stated["added_mass"])
    stated["added_mass"] = _matrix_of_rows(matrix)
    _take(blocks, name, simulator, stated, where)


def _with_former(blocks: SimulatorBlocks, name: str, simulator: str) -> tuple[dict[str, Any], str]:
    """Return what is stated of a link before this simulator, and the names of both."""
    if name not in blocks.links:
        return {}, simulator
    former = blocks.links[name]
    return dict(former.coefficients), f"{former.simulator} and {simulator}"


def _read_uuv(blocks: SimulatorBlocks, plugin: Element, root: Element, links: set[str]) -> None:
    """Read the plugin of uuv_simulator, which has an element for each link."""
    unread_settings = list[str]()
    for part in plugin:
        is_number = np.isfinite(to_float(plugin.findtext(part.tag)))
        if is_number and part.tag not in _UUV_OF_PLUGIN:
            unread_settings.append(part.tag)
    if unread_settings:
        blocks.unread.append(f"of uuv_simulator: <{'>, <'.join(unread_settings)}>")
    unread_models = dict[str, list[str]]()
    for element in plugin.findall("link"):
        model = element.find("hydrodynamic_model")
        if model is not None:
            _read_uuv_link(blocks, element, model, root, links, unread_models)
    for reason, names in unread_models.items():
        blocks.unread.append(f"water of link {', '.join(names)} (uuv_simulator): {reason}")


def _read_uuv_link(
    blocks: SimulatorBlocks,
    element: Element,
    model: Element,
    root: Element,
    links: set[str],
    unread_models: dict[str, list[str]],
) -> None:
    """Read the water of one link of uuv_simulator. unread_models: names of links by the reason why
    their added mass and drag are not read.
    """
    name = element.get("name", "")
    where = f"water of link {quoted(name)} (uuv_simulator)"
    if name not in links:
        unread_models.setdefault("no such link", []).append(quoted(name))
        return
    stated = dict[str, Any]()
    kind = model.findtext("type", "").strip()
    reason = _why_not_read(model)
    if reason:
        unread_models.setdefault(reason, []).append(quoted(name))
    else:
        stated |= _uuv_coefficients(model, blocks.density or _UUV_DENSITY)
    if not reason and kind == "cylinder":
        blocks.unread.append(
            f"{where}: added mass along the cylinder, which uuv_simulator has in kg/m; it is 0.1 of"
            " that across"
        )
    read = _READ_BY_UUV | {*SIZES.get(kind, ()), *OPTIONS.get(kind, ())}
    unread_parts = [part for part in model if part.tag not in read]
    unread_parts += [part for part in element if part.tag not in _UUV_OF_LINK]
    for part in unread_parts:
        blocks.unread.append(f"{where}: <{part.tag}> is not modelled")
    stated |= _uuv_volume(blocks, element, root, where)
    _take(blocks, name, "uuv_simulator plugin", stated, where)


def _why_not_read(model: Element) -> str:
    """Return why a model of uuv_simulator is not read; "" for one that is."""
    kind = model.findtext("type", "").strip()
    if kind not in SIZES:
        return (
            f"added mass and drag of type {quoted(kind)} are not read; allowed: {', '.join(SIZES)}"
        )
    missing = missing_sizes(model)
    if missing:
        return (
            f"added mass and drag of type {quoted(kind)} without <{'>, <'.join(missing)}>, for which"
            " the simulator looks at the box around the link"
        )
    return ""


def _uuv_coefficients(model: Element, density: float) -> dict[str, Any]:
    """Return added mass and drag of a model of uuv_simulator in water of a density [kg/m3]."""
    stated = dict[str, Any]()
    for key, tag, sign in (
        ("added_mass", "added_mass", 1.0),
        ("linear_drag", "linear_damping", -1.0),
        ("quadratic_drag", "quadratic_damping", -1.0),
    ):
        text = model.findtext(tag)
        if text is not None:
            stated[key] = _matrix(text, sign)
    if model.findtext("type", "").strip() != "fossen":
        stated |= shaped_water(model, stated, density)
    return stated


def _uuv_volume(
    blocks: SimulatorBlocks, element: Element, root: Element, where: str
) -> dict[str, Any]:
    """Return volume and centre of buoyancy of a link of uuv_simulator, as far as it states them."""
    stated = dict[str, Any]()
    volume = element.findtext("volume")
    centre = element.findtext("center_of_buoyancy")
    if element.findtext("neutrally_buoyant", "0").strip().lower() in ("1", "true"):
        if centre is not None:
            blocks.density = blocks.density or _UUV_DENSITY
            stated["volume"] = _rigid_mass(root, element.get("name", "")) / blocks.density
    elif volume is not None:
        stated["volume"] = to_float(volume.strip())
    if "volume" in stated:
        stated["centre_of_buoyancy"] = _three_numbers(centre)
    elif centre is not None:
        blocks.unread.append(f"{where}: <center_of_buoyancy> without a volume")
    return stated


def _rigid_mass(root: Element, link: str) -> float:
    """Return the mass [kg] of a link of a <robot> with all that is fixed to it, as Gazebo lumps them
    together.
    """
    fixed_links = [link]
    fixed_joints = root.findall("joint[@type='fixed']")
    for carrier in fixed_links:
        for joint in fixed_joints:
            parent = joint.find("parent")
            child = joint.find("child")
            if parent is None or child is None or parent.get("link") != carrier:
                continue
            if child.get("link", "") not in fixed_links:
                fixed_links.append(child.get("link", ""))
    total = 0.0
    for element in root.findall("link"):
        mass = element.find("inertial/mass")
        if element.get("name") in fixed_links and mass is not None:
            total += to_float(mass.get("value"))
    return total


def _three_numbers(text: str | None) -> tuple[float, ...]:
    """Return the numbers of a place, the origin where none is stated."""
    return to_floats(" ".join((text or "0 0 0").split()))


def _read_buoyancy(blocks: SimulatorBlocks, plugin: Element, links: set[str]) -> None:
    """Read Gazebo's plugin of buoyancy, which has the volume of each link and the centre of it in the
    axes of the link.
    """
    for element in plugin.findall("link"):
        name = element.get("name", "")
        where = f"buoyancy of link {quoted(name)} (Gazebo)"
        volume = element.findtext("volume")
        if name not in links:
            blocks.unread.append(f"{where}: no such link")
            continue
        if volume is None:
            continue
        stated, simulator = _with_former(blocks, name, "Gazebo buoyancy plugin")
        stated["volume"] = to_float(volume.strip())
        stated["centre_of_buoyancy"] = _three_numbers(element.findtext("center_of_volume"))
        _take(blocks, name, simulator, stated, where)


def _read_gazebo(blocks: SimulatorBlocks, plugin: Element, links: set[str]) -> None:
    """Read Gazebo's plugin, which has one number for each axis."""
    name = first_text(plugin, _NAMES_OF_LINK) or ""
    if name not in links:
        name = name.rpartition("::")[2]  # with the name of the model before it
    where = f"water of link {quoted(name)} (Gazebo)"
    if name not in links:
        blocks.unread.append(f"{where}: no such link")
        return
    stated, simulator = _with_former(blocks, name, "Gazebo plugin")
    for key, tags in (
        ("added_mass", [(tag,) for tag in _ADDED_MASS]),
        ("linear_drag", [(tag,) for tag in _AXES]),
        ("quadratic_drag", list(zip(_QUADRATIC_DRAG, _QUADRATIC_OF_SPEED, strict=True))),
    ):
        values = [_first_number(plugin, names) for names in tags]
        if any(values):
            stated[key] = tuple(abs(value) for value in values)
    read = _GAZEBO_NUMBERS | _SETTINGS
    unread_tags = [part.tag for part in plugin if part.tag not in read and to_float(part.text)]
    if unread_tags:
        blocks.unread.append(f"{where}: <{'>, <'.join(unread_tags)}> is not modelled")
    _take(blocks, name, simulator, stated, where)


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
