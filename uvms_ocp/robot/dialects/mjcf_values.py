"""Attributes of MJCF: defaults by class, orientations in five notations, included files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.untrusted import note_file_read
from uvms_ocp.record.xml_file import read_xml
from uvms_ocp.robot.urdf_elements import Element, quoted, to_floats

_MAX_INCLUDED = 50  # files
_MAIN = "main"
_ACTUATORS = {"motor", "position", "velocity", "general", "intvelocity", "damper", "cylinder"}
_UNREAD_OPTIONS = ("boundmass", "boundinertia", "balanceinertia")
_OFF = ("0", "0.0", "false")
_SHORTEST = 1e-9  # norm of a quaternion or an axis


@dataclass(kw_only=True, slots=True)
class Defaults:
    """Attributes that elements have where they do not state them."""

    classes: dict[str, dict[str, dict[str, str]]] = field(default_factory=lambda: {_MAIN: {}})
    """Attributes by name of the class and tag of the element."""

    def read(self, element: Element, above: str | None = None) -> None:
        """Read a <default> with those inside it; above: class of the one around it."""
        name = element.get("class") or (above or _MAIN)
        inherited = self.classes.get(above or _MAIN, {})
        values = {tag: dict(attributes) for tag, attributes in inherited.items()}
        for tag, attributes in self.classes.get(name, {}).items():
            values.setdefault(tag, {}).update(attributes)
        for child in element:
            if child.tag != "default":
                values.setdefault(child.tag, {}).update(child.attrib)
        self.classes[name] = values
        for child in element.findall("default"):
            self.read(child, name)

    def attributes(self, element: Element, childclass: str | None) -> dict[str, str]:
        """Return the attributes of an element in a body of a class. Raises `InvalidInput` for a
        class that is not there.
        """
        name = element.get("class") or childclass or _MAIN
        if name not in self.classes:
            raise InvalidInput(f"<{element.tag}>: class {quoted(name)} is not among the defaults")
        known = self.classes[name]
        values = dict[str, str]()
        if element.tag in _ACTUATORS:
            values.update(known.get("general", {}))
        values.update(known.get(element.tag, {}))
        values.update(element.attrib)
        return values


@dataclass(frozen=True, kw_only=True, slots=True)
class Compiler:
    """Options of <compiler> that change what is read."""

    in_degrees: bool = True
    """True where angles are in degrees, not radians."""
    euler_axes: str = "xyz"
    """Axes of the three Euler angles; small letters for axes that turn with the frame."""
    limits_by_range: bool = True
    """True where a stated range alone limits a joint."""
    mesh_folder: str = ""
    """Folder of meshes, relative to the file."""
    inertia_of_geoms: str = "auto"
    """``auto``: where a body states none, ``true``: always, ``false``: never."""
    geom_groups: tuple[int, int] = (0, 5)
    """Groups of geoms that have inertia."""
    total_mass: float = 0.0
    """[kg] total mass to which all bodies are scaled; 0 where they are not."""
    unread: tuple[str, ...] = ()
    """Options that change inertias and are not read."""

    def angle(self, value: float) -> float:
        """Return an angle of the file in [rad]."""
        if self.in_degrees:
            return float(np.deg2rad(value))
        return value


def read_compiler(root: Element) -> Compiler:
    """Read the <compiler> elements of a file. Raises `InvalidInput` for coordinates that MJCF no
    longer has.
    """
    words = dict[str, str]()
    for element in root.findall("compiler"):
        words.update(element.attrib)
    if words.get("coordinate", "local") != "local":
        raise InvalidInput("<compiler> coordinate: given 'global'; allowed: local")
    low, high = (int(value) for value in words.get("inertiagrouprange", "0 5").split())
    return Compiler(
        in_degrees=words.get("angle", "degree") == "degree",
        euler_axes=words.get("eulerseq", "xyz"),
        limits_by_range=words.get("autolimits", "true") == "true",
        mesh_folder=words.get("meshdir", words.get("assetdir", "")),
        inertia_of_geoms=words.get("inertiafromgeom", "auto"),
        geom_groups=(low, high),
        total_mass=max(number(words, "settotalmass", -1.0), 0.0),
        unread=tuple(word for word in _UNREAD_OPTIONS if words.get(word, "0") not in _OFF),
    )


def vector(values: dict[str, str], key: str, default: Sequence[float]) -> np.ndarray:
    """Return the numbers of an attribute, as many as the default has, or any number of them where it
    is empty. Raises `InvalidInput`.
    """
    if key not in values:
        return np.array(default, dtype=float)
    numbers = np.array(to_floats(" ".join(values[key].split())))
    if not np.isfinite(numbers).all() or (len(default) and numbers.size != len(default)):
        allowed = f"{len(default)} numbers" if len(default) else "numbers"
        raise InvalidInput(f"{key}: given {quoted(values[key])}; allowed: {allowed}")
    return numbers


def number(values: dict[str, str], key: str, default: float) -> float:
    """Return the number of an attribute. Raises `InvalidInput`."""
    return float(vector(values, key, [default])[0])


def rotation(values: dict[str, str], compiler: Compiler) -> np.ndarray:
    """Return the orientation (3, 3) that an element states. Raises `InvalidInput`."""
    if "quat" in values:
        w, x, y, z = _unit(vector(values, "quat", [1.0, 0.0, 0.0, 0.0]), "quat")
        return np.asarray(pin.Quaternion(w, x, y, z).matrix())
    if "axisangle" in values:
        stated = vector(values, "axisangle", [0.0, 0.0, 1.0, 0.0])
        return np.asarray(pin.exp3(_unit(stated[:3], "axisangle") * compiler.angle(stated[3])))
    if "euler" in values:
        return _euler(vector(values, "euler", [0.0, 0.0, 0.0]), compiler)
    if "xyaxes" in values:
        stated = vector(values, "xyaxes", [1.0, 0.0, 0.0, 0.0, 1.0, 0.0])
        x_axis = _unit(stated[:3], "xyaxes")
        y_axis = _unit(stated[3:] - x_axis * (x_axis @ stated[3:]), "xyaxes")
        return np.column_stack([x_axis, y_axis, np.cross(x_axis, y_axis)])
    if "zaxis" in values:
        return z_axis_to(vector(values, "zaxis", [0.0, 0.0, 1.0]))
    return np.eye(3)


def z_axis_to(direction: np.ndarray) -> np.ndarray:
    """Return the smallest rotation (3, 3) of the z axis to a direction (3,). Raises
    `InvalidInput`.
    """
    unit = _unit(direction, "zaxis")
    axis = np.cross([0.0, 0.0, 1.0], unit)
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, unit[2]))
    if sine < _SHORTEST:
        axis = np.array([1.0, 0.0, 0.0])
        sine = 1.0
    return np.asarray(pin.exp3(axis / sine * angle))


def pose(values: dict[str, str], compiler: Compiler) -> pin.SE3:
    """Return the pose that an element states. Raises `InvalidInput`."""
    return pin.SE3(rotation(values, compiler), vector(values, "pos", [0.0, 0.0, 0.0]))


def _unit(values: np.ndarray, key: str) -> np.ndarray:
    """Return the vector scaled to length 1. Raises `InvalidInput` for one of length 0."""
    norm = float(np.linalg.norm(values))
    if norm < _SHORTEST:
        raise InvalidInput(f"{key}: of length 0; allowed: another length")
    return np.asarray(values / norm)


def _euler(angles: np.ndarray, compiler: Compiler) -> np.ndarray:
    """Return the rotation (3, 3) of three Euler angles about the axes of the compiler's options."""
    R = np.eye(3)
    for letter, angle in zip(compiler.euler_axes, angles, strict=True):
        axis = np.eye(3)["xyz".index(letter.lower())]
        turn = np.asarray(pin.exp3(axis * compiler.angle(angle)))
        turns_with_frame = letter.islower()
        if turns_with_frame:
            R = R @ turn
        else:
            R = turn @ R
    return R


def with_included(path: Path, root: Element) -> None:
    """Put the content of included files in place of each <include>. Raises `InvalidInput`."""
    n_included = 0
    waiting = [root]
    while waiting:
        element = waiting.pop()
        for include in element.findall("include"):
            n_included += 1
            if n_included > _MAX_INCLUDED:
                raise InvalidInput(f"more than {_MAX_INCLUDED} files are included")
            file = path.parent / include.get("file", "")
            try:
                content = read_xml(file)
            except (OSError, InvalidInput) as error:
                raise InvalidInput(
                    f"<include> of {quoted(include.get('file', ''))}: {error}"
                ) from None
            note_file_read(file)
            place = list(element).index(include)
            element[place : place + 1] = list(content)
        waiting += list(element)
