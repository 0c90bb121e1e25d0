"""Read a robot of MJCF, the format of MuJoCo, as a URDF: bodies, joints, geoms, inertias, sites,
actuators and joints that follow others.

A body has its joints inside it, several in a row, each at a place of its own; a URDF has one joint
between two links. See https://mujoco.readthedocs.io/en/stable/XMLreference.html.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput, RobotDataError
from uvms_ocp.robot.dialects.mjcf_actuators import SiteForce, effort_limits, leaders, site_forces
from uvms_ocp.robot.dialects.mjcf_geoms import Geom, MeshAsset, read_geom
from uvms_ocp.robot.dialects.mjcf_values import (
    Defaults,
    number,
    pose,
    read_compiler,
    vector,
    with_included,
)
from uvms_ocp.robot.dialects.urdf_writer import UrdfWriter, WrittenJoint, words
from uvms_ocp.robot.urdf_elements import Element, quoted
from uvms_ocp.robot.urdf_findings import Findings

_WORLD = "world"
_SEEN_GROUPS = 3  # geoms of higher groups are not drawn
_READ = {"inertial", "joint", "freejoint", "geom", "site", "body", "frame"}
_WITHOUT_EFFECT = {"camera", "light"}
_REFUSED = {"attach", "replicate", "composite", "flexcomp"}
_URDF_KINDS = {"hinge": "revolute", "slide": "prismatic"}
_SECTIONS = {"compiler", "default", "asset", "worldbody", "actuator", "equality"}
_SECTIONS_WITHOUT_EFFECT = {
    "option",
    "size",
    "visual",
    "statistic",
    "contact",
    "sensor",
    "keyframe",
    "custom",
}


def urdf_of_mjcf(path: Path, root: Element) -> tuple[Element, tuple[str, ...]]:
    """Return the URDF of the robot in a <mujoco>, and what has no place there, one line each.

    Raises ``RobotDataError`` with all mistakes.
    """
    findings = Findings(path)
    try:
        with_included(path, root)
        reader = _MjcfReader(findings, path, root)
        robot = reader.written(root.get("model") or path.stem)
    except InvalidInput as error:
        raise RobotDataError(path, *findings.faults, str(error)) from None
    findings.refuse()
    return robot, tuple(findings.notes)


class _MjcfReader:
    """Bodies, joints and shapes of a file, collected from all its sections."""

    def __init__(self, findings: Findings, path: Path, root: Element) -> None:
        self.findings = findings
        self.root = root
        self.compiler = read_compiler(root)
        self.defaults = Defaults()
        for element in root.findall("default"):
            self.defaults.read(element)
        self.meshes = self._read_meshes(path)
        self.efforts = effort_limits(root, self.defaults)
        self.leaders = leaders(findings, root, self.defaults)
        self.forces: dict[str, list[SiteForce]] = site_forces(root, self.defaults)
        self.unread = Counter[str]()
        self.armatures = list[str]()
        self.n_unnamed = 0

    def _read_meshes(self, path: Path) -> dict[str, MeshAsset]:
        """Read the meshes of the file by name; those without a file of their own are noted."""
        meshes = dict[str, MeshAsset]()
        folder = path.resolve().parent / self.compiler.mesh_folder
        for element in self.root.findall("asset/mesh"):
            values = self.defaults.attributes(element, None)
            file = values.get("file")
            if file is None:
                self.findings.notes.append(
                    f"mesh {quoted(values.get('name', ''))}: of vertices in the file, is not read"
                )
                continue
            name = values.get("name") or Path(file).stem
            meshes[name] = MeshAsset(
                file=folder / file, scale=vector(values, "scale", [1.0, 1.0, 1.0])
            )
        return meshes

    def written(self, name: str) -> Element:
        """Return the <robot>. Raises `InvalidInput` for what cannot be read."""
        writer = UrdfWriter(name)
        body, X_WB = self._only_robot()
        is_free = self._frees(body)
        if is_free:
            self._add_body(writer, body, parent=None, X_PB=X_WB, childclass=None)
        else:
            writer.add_link(_WORLD)
            self._add_body(writer, body, parent=_WORLD, X_PB=X_WB, childclass=None)
        if self.compiler.total_mass > 0.0:
            writer.scale_masses(self.compiler.total_mass)
        self._note_unread()
        return writer.root

    def _only_robot(self) -> tuple[Element, pin.SE3]:
        """Return the body of the world that is the robot: the only one with joints, the only one of
        several that actuators drive, or else the only one.
        """
        bodies = list[tuple[Element, pin.SE3]]()
        for world in self.root.findall("worldbody"):
            bodies += self._bodies_in(world, pin.SE3.Identity())
        moving = []
        for body, X in bodies:
            tags = {element.tag for element in body.iter()}
            if tags & {"joint", "freejoint"}:
                moving.append((body, X))
        candidates = moving or bodies
        if len(candidates) > 1:
            driven = [(body, X) for body, X in candidates if self._is_driven(body)]
            candidates = driven if len(driven) == 1 else candidates
        if len(candidates) != 1:
            names = ", ".join(body.get("name", "unnamed") for body, _ in candidates[:10])
            raise InvalidInput(
                f"{len(candidates)} bodies of the world, {names or 'none'}; allowed: the file of one"
                " robot"
            )
        for body, _ in bodies:
            if body is not candidates[0][0]:
                self.unread["body of the world"] += 1
        return candidates[0]

    def _is_driven(self, body: Element) -> bool:
        """Check whether an actuator drives a joint of a body, or of those that hang on it."""
        return any(joint.get("name") in self.efforts for joint in body.iter("joint"))

    def _bodies_in(self, element: Element, X: pin.SE3) -> Iterator[tuple[Element, pin.SE3]]:
        """Yield bodies in an element of pose X, with the pose of the frame that each stands in."""
        for child in element:
            if child.tag == "body":
                yield child, X
            elif child.tag == "frame":
                yield from self._bodies_in(child, X * pose(dict(child.attrib), self.compiler))

    def _frees(self, body: Element) -> bool:
        """Check whether a body floats in the world."""
        if body.find("freejoint") is not None:
            return True
        joints = body.findall("joint")
        return any(self.defaults.attributes(joint, None).get("type") == "free" for joint in joints)

    def _add_body(
        self,
        writer: UrdfWriter,
        body: Element,
        *,
        parent: str | None,
        X_PB: pin.SE3,
        childclass: str | None,
    ) -> None:
        """Add a body with its joints and all that hangs on it. X_PB: of the frame that its pose is
        stated in.
        """
        self.n_unnamed += not body.get("name")
        name = body.get("name") or f"body_{self.n_unnamed}"
        name = writer.free_name(name, "link")
        childclass = body.get("childclass") or childclass
        X_PB = X_PB * pose(dict(body.attrib), self.compiler)
        content = list(self._content(body, pin.SE3.Identity(), childclass))
        geoms = list[Geom]()
        for element, X, class_of_geom in content:
            if element.tag == "geom":
                geoms += self._geom(element, X, class_of_geom)
        link = writer.add_link(name, self._inertia(body, geoms, name))
        self._add_geoms(writer, link, geoms)
        joints = [item for item in content if item[0].tag in ("joint", "freejoint")]
        self._join(writer, name, parent, X_PB, joints)
        for element, X, class_of_part in content:
            if element.tag == "site":
                self._add_site(writer, element, name, X, class_of_part)
            elif element.tag == "body":
                self._add_body(writer, element, parent=name, X_PB=X, childclass=class_of_part)

    def _content(
        self, element: Element, X: pin.SE3, childclass: str | None
    ) -> Iterator[tuple[Element, pin.SE3, str | None]]:
        """Yield the elements in a body with pose and class of the <frame> around each. Raises
        `InvalidInput`.
        """
        for child in element:
            if child.tag in _REFUSED:
                raise InvalidInput(f"<{child.tag}> is not read; give the file that MuJoCo saves")
            if child.tag == "frame":
                inner = X * pose(dict(child.attrib), self.compiler)
                yield from self._content(child, inner, child.get("childclass") or childclass)
            elif child.tag in _READ:
                yield child, X, childclass
            elif child.tag not in _WITHOUT_EFFECT:
                self.unread[child.tag] += 1

    def _geom(self, element: Element, X: pin.SE3, childclass: str | None) -> list[Geom]:
        """Return the geom of an element in a list, empty for kinds that are not read."""
        values = self.defaults.attributes(element, childclass)
        if "fluidshape" in values and values["fluidshape"] != "none":
            self.unread["fluidshape"] += 1
        if values.get("type") in ("plane", "hfield", "sdf"):
            self.unread[f"geom {values['type']}"] += 1
            return []
        geom = read_geom(values, self.meshes, self.compiler)
        return [
            Geom(kind=geom.kind, X=X * geom.X, size=geom.size, mesh=geom.mesh, values=geom.values)
        ]

    def _inertia(self, body: Element, geoms: list[Geom], name: str) -> pin.Inertia:
        """Return the inertia of a body in its frame: as stated, or else the sum of its geoms."""
        inertial = body.find("inertial")
        of_geoms = self.compiler.inertia_of_geoms
        if of_geoms != "true" and inertial is not None:
            return self._stated_inertia(dict(inertial.attrib), name)
        total = pin.Inertia.Zero()
        if of_geoms == "false":
            return total
        low, high = self.compiler.geom_groups
        for geom in geoms:
            if not low <= number(geom.values, "group", 0.0) <= high:
                continue
            if number(geom.values, "mass", 1.0) == 0.0:
                continue
            solid = geom.inertia()
            if solid is None:
                self.findings.notes.append(
                    f"body {quoted(name)}: a {geom.kind} without volume, or without its file, has no"
                    " mass"
                )
                continue
            total += solid
        return total

    def _stated_inertia(self, values: dict[str, str], name: str) -> pin.Inertia:
        """Return the inertia that attributes of an <inertial> state, in the frame of the body."""
        mass = number(values, "mass", 0.0)
        if "fullinertia" in values:
            xx, yy, zz, xy, xz, yz = vector(values, "fullinertia", [0.0] * 6)
            moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        else:
            moments = np.diag(vector(values, "diaginertia", [0.0] * 3))
        return pose(values, self.compiler).act(pin.Inertia(mass, np.zeros(3), moments))

    def _add_geoms(self, writer: UrdfWriter, link: Element, geoms: list[Geom]) -> None:
        """Add geoms to a link as visual and collision shapes."""
        for geom in geoms:
            shape = geom.shape()
            if shape is None:
                self.unread[f"geom {geom.kind}"] += 1
                continue
            if geom.kind == "ellipsoid":
                self.findings.notes.append(
                    f"body {quoted(link.get('name', ''))}: an ellipsoid is taken as the box around it"
                )
            if number(geom.values, "group", 0.0) < _SEEN_GROUPS:
                writer.add_shape(link, "visual", geom.X, shape, geom.colour)
            if geom.collides:
                writer.add_shape(link, "collision", geom.X, shape)

    def _join(
        self,
        writer: UrdfWriter,
        name: str,
        parent: str | None,
        X_PB: pin.SE3,
        joints: list[tuple[Element, pin.SE3, str | None]],
    ) -> None:
        """Join a body to its parent by its joints, one after the other."""
        if parent is None:
            if len(joints) > 1:
                raise InvalidInput(
                    f"body {quoted(name)}: a free joint and others; allowed: the free joint alone"
                )
            return
        if not joints:
            writer.add_fixed(parent, name, X_PB)
            return
        X_before = X_PB  # of the frame in which the next joint is stated
        above = parent
        for k, (element, X, childclass) in enumerate(joints):
            is_last = k == len(joints) - 1
            values = self.defaults.attributes(element, childclass)
            joint_name = values.get("name") or f"{name}_joint_{k + 1}"
            kind = values.get("type", "hinge")
            if kind not in _URDF_KINDS or element.tag == "freejoint":
                raise InvalidInput(
                    f"joint {quoted(joint_name)}: type {quoted(kind)}; allowed: hinge, slide, and a"
                    " free one of the body on the world"
                )
            place = X.act(vector(values, "pos", [0.0, 0.0, 0.0]))
            axis = X.rotation @ vector(values, "axis", [0.0, 0.0, 1.0])
            if not np.linalg.norm(axis) > 0.0:
                raise InvalidInput(f"joint {quoted(joint_name)}: axis of length 0")
            axis = axis / np.linalg.norm(axis)
            back = _moved(kind, axis, -self._position(values, "ref", 0.0, kind))
            X_PJ = X_before * pin.SE3(np.eye(3), place) * back
            X_JC = pin.SE3(np.eye(3), -place)
            between = name if is_last else writer.free_name(f"{joint_name}_link", "link")
            joint = self._joint(values, joint_name, kind)
            writer.add_joint(
                replace(
                    joint,
                    parent=above,
                    child=between,
                    X_PJ=X_PJ,
                    X_JC=X_JC if is_last else pin.SE3.Identity(),
                    axis=axis,
                )
            )
            if not is_last:
                writer.add_link(between)
                above = between
                X_before = X_JC

    def _position(self, values: dict[str, str], key: str, default: float, kind: str) -> float:
        """Read a position of a joint [rad or m]."""
        value = number(values, key, default)
        if kind == "hinge":
            return self.compiler.angle(value)
        return value

    def _joint(self, values: dict[str, str], name: str, kind: str) -> WrittenJoint:
        """Return a joint with all but its links, frames and axis."""
        lower = -np.inf
        upper = np.inf
        stated = values.get("limited", "auto")
        is_limited = stated == "true" or (
            stated == "auto" and self.compiler.limits_by_range and "range" in values
        )
        if is_limited:
            lower, upper = vector(values, "range", [0.0, 0.0])
            if kind == "hinge":
                lower = self.compiler.angle(lower)
                upper = self.compiler.angle(upper)
        armature = number(values, "armature", 0.0)
        if armature:
            self.armatures.append(f"{name} {armature:g}")
        urdf_kind = _URDF_KINDS[kind]
        if kind == "hinge" and not is_limited:
            urdf_kind = "continuous"
        effort = self.efforts.get(name, 0.0)
        own_range = vector(values, "actuatorfrcrange", [0.0, 0.0])
        if own_range.any():
            effort = float(np.abs(own_range).max())
        return WrittenJoint(
            name=name,
            kind=urdf_kind,
            parent="",
            child="",
            X_PJ=pin.SE3.Identity(),
            X_JC=pin.SE3.Identity(),
            axis=np.zeros(3),
            lower=float(lower),
            upper=float(upper),
            effort=effort,
            damping=max(float(vector(values, "damping", [])[:1].sum()), 0.0),
            friction=max(number(values, "frictionloss", 0.0), 0.0),
            mimics=self.leaders.get(name),
        )

    def _add_site(
        self, writer: UrdfWriter, element: Element, body: str, X: pin.SE3, childclass: str | None
    ) -> None:
        """Add a site as an empty link, and a thruster for each force at it."""
        values = self.defaults.attributes(element, childclass)
        site = values.get("name")
        if not site:
            return
        X_BS = X * pose(values, self.compiler)
        link = writer.free_name(site, "link")
        writer.add_link(link)
        writer.add_fixed(body, link, X_BS)
        for force in self.forces.get(site, []):
            writer.add_block(_thruster_block(force, link))

    def _note_unread(self) -> None:
        """Note the content of the file that has no place in a URDF."""
        for element in self.root:
            if element.tag not in _SECTIONS | _SECTIONS_WITHOUT_EFFECT:
                self.unread[element.tag] += 1
        self.unread.update(f"compiler {word}" for word in self.compiler.unread)
        option = self.root.find("option")
        if option is not None and (option.get("density") or option.get("viscosity")):
            self.unread["option density, viscosity"] += 1
        if self.unread:
            counted = []
            for tag, n in self.unread.items():
                counted.append(tag if n == 1 else f"{tag} ({n} times)")
            self.findings.notes.append(f"not read of MJCF: {', '.join(counted)}")
        if self.armatures:
            self.findings.notes.append(
                f"armature is not read: joint {', '.join(self.armatures)}; it is `rotor_inertia` of"
                " joints in hydrodynamics.yaml"
            )


def _moved(kind: str, axis: np.ndarray, position: float) -> pin.SE3:
    """Return the motion of a joint to a position [rad or m]."""
    if kind == "hinge":
        return pin.SE3(pin.exp3(axis * position), np.zeros(3))
    return pin.SE3(np.eye(3), axis * position)


def _thruster_block(force: SiteForce, link: str) -> Element:
    """Return the block of a thruster at a link, as simulators of water have it."""
    plugin = ElementTree.Element("plugin", {"name": "thruster", "filename": "mujoco"})
    ElementTree.SubElement(plugin, "link_name").text = link
    ElementTree.SubElement(plugin, "axis").text = words(force.direction)
    if force.minimum < force.maximum:
        ElementTree.SubElement(plugin, "min_thrust_cmd").text = repr(force.minimum)
        ElementTree.SubElement(plugin, "max_thrust_cmd").text = repr(force.maximum)
    return plugin
