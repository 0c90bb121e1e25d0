"""Build a URDF element by element from poses and inertias."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.urdf_elements import DRAWN, Element

_SAME_FRAME = 1e-12  # [m] and of entries of rotations, below which two frames are one
_UNLIMITED = 1e16
"""[rad or m] where a format has no limit of a slider."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WrittenShape:
    """A shape as a URDF states it."""

    tag: str
    """``box``, ``sphere``, ``cylinder``, ``capsule`` or ``mesh``."""
    attributes: Mapping[str, str]
    """Sizes, or the file and scale of a mesh."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WrittenJoint:
    """A joint between two links at the zero of its position."""

    name: str
    kind: str
    """Type of the joint in words of URDF."""
    parent: str
    child: str
    X_PJ: pin.SE3
    """Frame of the joint in that of the parent."""
    X_JC: pin.SE3
    """Frame of the child in that of the joint."""
    axis: np.ndarray
    """Direction (3,) in the frame of the joint."""
    lower: float = -np.inf
    """[rad or m] lower limit."""
    upper: float = np.inf
    """[rad or m] upper limit."""
    velocity: float = 0.0
    """[rad/s or m/s], 0 for no limit."""
    effort: float = 0.0
    """[N m or N], 0 for no limit."""
    damping: float = 0.0
    """[N m s/rad or N s/m] viscous friction."""
    friction: float = 0.0
    """[N m or N] dry friction."""
    mimics: tuple[str, float, float] | None = None
    """Joint that it follows, multiplier and offset."""


class UrdfWriter:
    """A <robot> that grows by links, joints and blocks of simulators."""

    def __init__(self, name: str) -> None:
        self.root = ElementTree.Element("robot", {"name": name})
        self._n_materials = 0

    def add_link(self, name: str, inertia: pin.Inertia | None = None) -> Element:
        """Add a link with its inertia in its own frame; without one it has no mass."""
        link = ElementTree.SubElement(self.root, "link", {"name": name})
        if inertia is None or inertia.mass == 0.0:
            return link
        inertial = ElementTree.SubElement(link, "inertial")
        ElementTree.SubElement(inertial, "origin", {"xyz": words(inertia.lever)})
        ElementTree.SubElement(inertial, "mass", {"value": repr(float(inertia.mass))})
        rows = np.array(inertia.inertia)
        moments = {
            "ixx": rows[0, 0],
            "ixy": rows[0, 1],
            "ixz": rows[0, 2],
            "iyy": rows[1, 1],
            "iyz": rows[1, 2],
            "izz": rows[2, 2],
        }
        texts = {key: repr(float(value)) for key, value in moments.items()}
        ElementTree.SubElement(inertial, "inertia", texts)
        return link

    def add_shape(
        self,
        link: Element,
        kind: str,
        X: pin.SE3,
        shape: WrittenShape,
        rgba: np.ndarray | None = None,
    ) -> None:
        """Add a visual or collision shape at a pose in the link, with a colour (4,) if given."""
        element = ElementTree.SubElement(link, kind)
        element.append(_origin(X))
        geometry = ElementTree.SubElement(element, "geometry")
        ElementTree.SubElement(geometry, shape.tag, dict(shape.attributes))
        if rgba is not None and kind == DRAWN[0]:
            self._n_materials += 1
            name = f"colour_{self._n_materials}"
            material = ElementTree.SubElement(element, "material", {"name": name})
            ElementTree.SubElement(material, "color", {"rgba": words(np.clip(rgba, 0.0, 1.0))})

    def add_joint(self, joint: WrittenJoint) -> None:
        """Add a joint; where the child's frame is not that of the joint, an empty link between."""
        if joint.X_JC.isApprox(pin.SE3.Identity(), _SAME_FRAME):
            self._add_joint_element(joint, joint.child, joint.X_PJ)
            return
        if joint.kind == "fixed":
            self._add_joint_element(joint, joint.child, joint.X_PJ * joint.X_JC)
            return
        between = self.free_name(f"{joint.name}_frame", "link")
        self.add_link(between)
        self._add_joint_element(joint, between, joint.X_PJ)
        self.add_fixed(between, joint.child, joint.X_JC)

    def add_fixed(self, parent: str, child: str, X_PC: pin.SE3) -> None:
        """Fix a link to another one."""
        name = self.free_name(f"{child}_fixed", "joint")
        self._add_ends(name, "fixed", parent, child, X_PC)

    def scale_masses(self, total: float) -> None:
        """Scale masses and moments of all links so that they weigh so much together [kg]."""
        masses = self.root.findall("link/inertial/mass")
        present = sum(float(mass.get("value", "0")) for mass in masses)
        if not present > 0.0:
            return
        for element in (*masses, *self.root.findall("link/inertial/inertia")):
            for key, value in element.attrib.items():
                element.set(key, repr(float(value) * total / present))

    def free_name(self, name: str, tag: str) -> str:
        """Return the name, or a longer one where a link or joint has it already."""
        names = {element.get("name") for element in self.root.findall(tag)}
        free = name
        while free in names:
            free += "_"
        return free

    def add_block(self, block: Element, link: str | None = None) -> None:
        """Add a block of a simulator, of the robot or of one link."""
        reference = {} if link is None else {"reference": link}
        ElementTree.SubElement(self.root, "gazebo", reference).append(block)

    def _add_ends(self, name: str, kind: str, parent: str, child: str, X: pin.SE3) -> Element:
        element = ElementTree.SubElement(self.root, "joint", {"name": name, "type": kind})
        element.append(_origin(X))
        ElementTree.SubElement(element, "parent", {"link": parent})
        ElementTree.SubElement(element, "child", {"link": child})
        return element

    def _add_joint_element(self, joint: WrittenJoint, child: str, X: pin.SE3) -> None:
        element = self._add_ends(joint.name, joint.kind, joint.parent, child, X)
        if joint.kind == "fixed":
            return
        ElementTree.SubElement(element, "axis", {"xyz": words(joint.axis)})
        limit = {"velocity": repr(joint.velocity), "effort": repr(joint.effort)}
        if joint.kind in ("revolute", "prismatic"):
            limit["lower"] = repr(float(max(joint.lower, -_UNLIMITED)))
            limit["upper"] = repr(float(min(joint.upper, _UNLIMITED)))
        ElementTree.SubElement(element, "limit", limit)
        if joint.damping or joint.friction:
            losses = {"damping": repr(joint.damping), "friction": repr(joint.friction)}
            ElementTree.SubElement(element, "dynamics", losses)
        if joint.mimics is not None:
            leader, multiplier, offset = joint.mimics
            relation = {"joint": leader, "multiplier": repr(multiplier), "offset": repr(offset)}
            ElementTree.SubElement(element, "mimic", relation)


def words(values: np.ndarray) -> str:
    """Write numbers in full, with spaces between."""
    return " ".join(repr(float(value)) for value in np.asarray(values).ravel())


def _origin(X: pin.SE3) -> Element:
    rpy = pin.rpy.matrixToRpy(X.rotation)
    return ElementTree.Element("origin", {"xyz": words(X.translation), "rpy": words(rpy)})
