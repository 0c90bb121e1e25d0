"""Read a model of SDF, the format of Gazebo, as a URDF: links, joints, frames, nested and included
models, and blocks of water and thrusters.

SDF places every link in the model, a URDF in its parent; its joints may lie beside the origin of
their child. A link without <inertial> has 1 kg and 1 kg m2 there. See
http://sdformat.org/tutorials?tut=pose_frame_semantics.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from uvms_ocp.errors import InvalidInput, RobotDataError
from uvms_ocp.record.untrusted import note_file_read
from uvms_ocp.record.xml_file import read_xml
from uvms_ocp.robot.dialects.sdf_frames import FrameGraph, PlacedFrame, read_pose, relative_to
from uvms_ocp.robot.dialects.sdf_joints import SdfJoint, written_joints
from uvms_ocp.robot.dialects.sdf_shapes import add_shapes, read_inertia
from uvms_ocp.robot.dialects.urdf_writer import UrdfWriter
from uvms_ocp.robot.simulator_thrusters import name_of_plugin
from uvms_ocp.robot.urdf_elements import Element, quoted
from uvms_ocp.robot.urdf_findings import Findings

_TOP = "__model__"
_MAX_DEPTH = 8  # of models inside models
_MAX_MODELS = 100  # of included models
_NAMES_OF_PLUGINS = ("link_name", "joint_name", "linkName", "jointName", "bodyName")
_OF_MODEL = {"link", "joint", "frame", "model", "include", "plugin", "pose"}
_WITHOUT_EFFECT = {"static", "self_collide", "allow_auto_disable", "enable_wind", "gripper"}
_OF_LINK = {"pose", "inertial", "collision", "visual"}
_IGNORED_OF_LINK = {"self_collide", "kinematic", "must_be_base_link", "enable_wind", "light"}
_SENSORS = {"dvl": "dvl", "altimeter": "altimeter"}
"""Kinds of sensors that become frames, by words of their type."""


def urdf_of_sdf(
    path: Path, root: Element, folders: Sequence[Path]
) -> tuple[Element, tuple[str, ...]]:
    """Return the URDF of the model in an <sdf>, and what has no place there, one line each.

    folders: where included models are. Raises ``RobotDataError`` with all mistakes.
    """
    findings = Findings(path)
    model = _only_model(path, root)
    reader = _SdfReader(findings, version=_version(root), folders=folders)
    reader.collect(model, scope="", frame=_TOP, folder=path.resolve().parent, depth=0)
    reader.blocks += [plugin for plugin in root.findall("world/plugin") if _is_buoyancy(plugin)]
    robot = reader.written(model.get("name") or path.stem)
    findings.refuse()
    return robot, tuple(findings.notes)


def _version(root: Element) -> float:
    """Return the version of the format, the newest where it is none."""
    try:
        return float(root.get("version", ""))
    except ValueError:
        return 2.0


def _only_model(path: Path, root: Element) -> Element:
    """Return the model of a file, in a world the only one that moves. Raises ``RobotDataError``."""
    models = [*root.findall("model"), *root.findall("world/model")]
    if len(models) > 1:
        models = [model for model in models if not _is_static(model)]
    if len(models) == 1:
        return models[0]
    if not models:
        raise RobotDataError(path, "no <model> in the <sdf>; allowed: the file of one model")
    names = ", ".join(model.get("name", "") for model in models[:10])
    raise RobotDataError(path, f"{len(models)} models, {names}; allowed: the file of one model")


def _is_buoyancy(plugin: Element) -> bool:
    """Check whether a plugin of a world states the density of its water."""
    return "buoyancy" in name_of_plugin(plugin)


def _is_static(model: Element) -> bool:
    """Check whether a model says that it never moves."""
    return model.findtext("static", "").strip() in ("true", "1")


class _SdfReader:
    """Parts of a model with all models inside it, by their full names."""

    def __init__(self, findings: Findings, *, version: float, folders: Sequence[Path]) -> None:
        self.findings = findings
        self.version = version
        self.folders = folders
        self.graph = FrameGraph(top=_TOP)
        self.links = dict[str, tuple[Element, Path]]()
        """Links with the folders that their meshes are relative to."""
        self.joints = dict[str, SdfJoint]()
        self.named_frames = list[str]()
        self.blocks = list[Element]()
        self.unread = Counter[str]()
        self.n_included = 0

    def collect(self, model: Element, *, scope: str, frame: str, folder: Path, depth: int) -> None:
        """Collect the parts of a model. scope: prefix of its names, with ``::``; frame: the name of
        its own frame.
        """
        placed = self.graph.frames.get(frame)
        self.graph.frames[frame] = PlacedFrame(
            above=placed.above if placed else _TOP,
            X=placed.X if placed else pin.SE3.Identity(),
            attached_to=scope + _canonical_link(model),
        )
        for element in model:
            name = scope + element.get("name", "")
            if element.tag == "link":
                self._place(element, name, scope, frame, default=frame, attached_to=None)
                self.links[name] = (element, folder)
            elif element.tag == "joint":
                child = self._scoped(element.findtext("child", ""), scope, frame)
                self._place(element, name, scope, frame, default=child, attached_to=child)
                parent = self._scoped(element.findtext("parent", ""), scope, frame)
                self.joints[name] = SdfJoint(
                    element=element, parent=parent, child=child, scope=scope, frame=frame
                )
            elif element.tag == "frame":
                attached = self._scoped(element.get("attached_to", ""), scope, frame)
                self._place(element, name, scope, frame, default=attached, attached_to=attached)
                self.named_frames.append(name)
            elif element.tag == "model":
                self._nest(element, scope, frame, folder, depth, placed=element)
            elif element.tag == "include":
                self._include(element, scope, frame, depth)
            elif element.tag == "plugin":
                self.blocks.append(_scoped_plugin(element, scope))
            elif element.tag not in _OF_MODEL | _WITHOUT_EFFECT:
                self.unread[element.tag] += 1

    def _scoped(self, name: str, scope: str, frame: str) -> str:
        """Return the full name of a part of the model of that scope and frame."""
        name = name.strip()
        if name in ("", "__model__"):
            return frame
        if name == "world":
            return name
        return scope + name

    def _place(
        self,
        element: Element,
        name: str,
        scope: str,
        frame: str,
        *,
        default: str,
        attached_to: str | None,
    ) -> None:
        """Place a part of the model of that frame, relative to the frame that its pose names, or to
        `default`.
        """
        pose = element.find("pose")
        stated = relative_to(pose)
        above = self._scoped(stated, scope, frame) if stated else default
        X = self._attempt_pose(pose, f"{element.tag} {quoted(name)}")
        if name in self.graph.frames:
            self.findings.faults.append(f"{element.tag} {quoted(name)}: its name is taken")
        self.graph.frames[name] = PlacedFrame(above=above, X=X, attached_to=attached_to)

    def _attempt_pose(self, pose: Element | None, where: str) -> pin.SE3:
        """Read a pose; a mistake becomes a fault."""
        try:
            return read_pose(pose, where)
        except InvalidInput as error:
            self.findings.faults.append(str(error))
            return pin.SE3.Identity()

    def _nest(
        self,
        model: Element,
        scope: str,
        frame: str,
        folder: Path,
        depth: int,
        *,
        placed: Element,
        name: str = "",
        merges: bool = False,
    ) -> None:
        """Collect a model inside another one. placed: the element with its <pose>."""
        name = name or model.get("name", "")
        if depth >= _MAX_DEPTH:
            self.findings.faults.append(
                f"model {quoted(name)}: more than {_MAX_DEPTH} in one another"
            )
            return
        inner_frame = f"{scope}{name}::__model__"
        pose = placed.find("pose")
        if pose is None:
            pose = model.find("pose")
        if model.get("placement_frame") or placed.findtext("placement_frame"):
            self.findings.notes.append(
                f"model {quoted(name)}: its placement_frame is not read, its own frame is placed"
            )
        self.graph.frames[inner_frame] = PlacedFrame(
            above=self._scoped(relative_to(pose), scope, frame),
            X=self._attempt_pose(pose, f"model {quoted(name)}"),
            attached_to="",
        )
        inner_scope = scope if merges else f"{scope}{name}::"
        self.collect(model, scope=inner_scope, frame=inner_frame, folder=folder, depth=depth + 1)

    def _include(self, include: Element, scope: str, frame: str, depth: int) -> None:
        """Collect the model of another file."""
        uri = include.findtext("uri", "").strip()
        file = self._included_file(uri)
        self.n_included += 1
        if file is None or self.n_included > _MAX_MODELS:
            self.findings.faults.append(
                f"<include> of {quoted(uri)}: not found; --packages DIR names a folder of models"
            )
            return
        try:
            model = _only_model(file, read_xml(file))
        except (OSError, InvalidInput, RobotDataError) as error:
            self.findings.faults.append(f"<include> of {quoted(uri)}: {error}")
            return
        note_file_read(file)
        self._nest(
            model,
            scope,
            frame,
            file.parent,
            depth,
            placed=include,
            name=include.findtext("name", "").strip(),
            merges=include.get("merge", "").lower() in ("true", "1"),
        )
        self.blocks += [_scoped_plugin(plugin, scope) for plugin in include.findall("plugin")]

    def _included_file(self, uri: str) -> Path | None:
        """Return the file of an included model; `None` where it is not there."""
        plain = uri.removeprefix("model://").removeprefix("file://").removeprefix("package://")
        for folder in self.folders:
            place = folder / plain
            if place.is_file():
                return place
            candidates = [place / "model.sdf", *sorted(place.glob("*.sdf"))]
            for candidate in candidates:
                if candidate.is_file():
                    return candidate
        return None

    def written(self, name: str) -> Element:
        """Return the <robot>; mistakes become faults."""
        writer = UrdfWriter(name.replace("::", "_"))
        elements = dict[str, Element]()
        for link, (element, folder) in self.links.items():
            try:
                inertia = read_inertia(self.findings, element, link)
                elements[link] = writer.add_link(link, inertia)
                add_shapes(self.findings, writer, elements[link], element, folder)
                self._add_added_mass(writer, element, link)
                self._count_unread(element)
            except InvalidInput as error:
                self.findings.faults.append(str(error))
        self._add_joints(writer)
        for frame in self.named_frames:
            try:
                self._add_frame(writer, frame)
            except InvalidInput as error:
                self.findings.faults.append(f"frame {quoted(frame)}: {error}")
        for link, (element, _) in self.links.items():
            self._add_sensors(writer, element, link)
        for block in self.blocks:
            writer.add_block(block)
        if self.unread:
            counted = []
            for tag, n in self.unread.items():
                counted.append(f"<{tag}>" if n == 1 else f"<{tag}> ({n} times)")
            self.findings.notes.append(f"not read of SDF: {', '.join(counted)}")
        return writer.root

    def _add_joints(self, writer: UrdfWriter) -> None:
        """Add all joints, and a link for the world where a joint begins there."""
        has_world = any(joint.parent == "world" for joint in self.joints.values())
        if has_world:
            writer.add_link("world")
            self.graph.frames["world"] = PlacedFrame(
                above=_TOP, X=pin.SE3.Identity(), attached_to=None
            )
        for name, joint in self.joints.items():
            try:
                for written in written_joints(self.graph, name, joint, self.version):
                    writer.add_joint(written)
                    if written.child not in self.links:
                        writer.add_link(written.child)
            except InvalidInput as error:
                self.findings.faults.append(f"joint {quoted(name)}: {error}")

    def _add_frame(self, writer: UrdfWriter, frame: str) -> None:
        """Add a named frame as an empty link, unless a link has its name."""
        link = self.graph.link_of(frame)
        X = self.graph.placement(link).actInv(self.graph.placement(frame))
        writer.add_link(frame)
        writer.add_fixed(link, frame, X)

    def _add_sensors(self, writer: UrdfWriter, element: Element, link: str) -> None:
        """Add a frame for each DVL and altimeter."""
        for sensor in element.findall("sensor"):
            types = [sensor.get("type", ""), *sensor.attrib.values()]
            for kind, word in _SENSORS.items():
                if not any(kind in text.lower() for text in types):
                    continue
                name = sensor.get("name", word)
                if word not in name.lower():
                    name = f"{name}_{word}"
                name = writer.free_name(name, "link")
                X = self._attempt_pose(sensor.find("pose"), f"sensor {quoted(name)}")
                writer.add_link(name)
                writer.add_fixed(link, name, X)
                break

    def _add_added_mass(self, writer: UrdfWriter, element: Element, link: str) -> None:
        """Add the block of a link's added mass."""
        added = element.find("inertial/fluid_added_mass")
        if added is not None:
            writer.add_block(added, link)

    def _count_unread(self, link: Element) -> None:
        """Count the elements of a link that have no place in a URDF."""
        for child in link:
            is_weightless = child.tag == "gravity" and (child.text or "").strip() in ("0", "false")
            if child.tag == "sensor" or child.tag in _OF_LINK | _IGNORED_OF_LINK:
                continue
            if child.tag != "gravity" or is_weightless:
                self.unread[child.tag] += 1


def _canonical_link(model: Element) -> str:
    """Return the link, or model inside, that the frame of a model is fixed to: the first."""
    stated = model.get("canonical_link")
    if stated:
        return stated
    for tag, end in (("link", ""), ("model", "::__model__"), ("include", "::__model__")):
        first = model.find(tag)
        if first is not None:
            name = first.get("name") or first.findtext("name", "").strip()
            return f"{name}{end}"
    return ""


def _scoped_plugin(plugin: Element, scope: str) -> Element:
    """Return a plugin whose names of links and joints are full ones."""
    if not scope:
        return plugin
    copy = ElementTree.fromstring(ElementTree.tostring(plugin))
    for tag in _NAMES_OF_PLUGINS:
        for element in copy.iter(tag):
            element.text = scope + (element.text or "").strip()
    for element in copy.findall("link"):
        element.set("name", scope + element.get("name", ""))
    return copy
