"""Inertia and shapes of a link of SDF."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.dialects import solids
from uvms_ocp.robot.dialects.sdf_frames import read_pose
from uvms_ocp.robot.dialects.urdf_writer import UrdfWriter, WrittenShape, words
from uvms_ocp.robot.urdf_elements import DRAWN, Element, quoted, to_float, to_floats
from uvms_ocp.robot.urdf_findings import Findings

_DEFAULT_DENSITY = 1000.0  # [kg/m3] default density of shapes with <inertial auto="true">
_COMPLETE = (
    "package://",
    "model://",
    "file://",
    "/",
)  # beginnings of addresses that need no folder


def read_inertia(findings: Findings, link: Element, name: str) -> pin.Inertia:
    """Return the inertia of a link in its frame: as stated, the sum of its shapes, or 1 kg and
    1 kg m2, the default of SDF. Raises `InvalidInput`.
    """
    where = f"link {quoted(name)}"
    inertial = link.find("inertial")
    if inertial is None:
        findings.notes.append(
            f"{where} has no <inertial>: of SDF it has 1 kg and 1 kg m2; state a mass, or fix what"
            " has none as a <frame>"
        )
        return pin.Inertia(1.0, np.zeros(3), np.eye(3))
    if inertial.get("auto", "").lower() in ("true", "1"):
        return _inertia_of_shapes(findings, link, inertial, where)
    mass = _number(inertial, "mass", 1.0, where)
    X = read_pose(inertial.find("pose"), f"{where} inertial")
    moments = np.eye(3)
    inertia = inertial.find("inertia")
    if inertia is not None:
        xx, yy, zz = (_number(inertia, key, 1.0, where) for key in ("ixx", "iyy", "izz"))
        xy, xz, yz = (_number(inertia, key, 0.0, where) for key in ("ixy", "ixz", "iyz"))
        moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return X.act(pin.Inertia(mass, np.zeros(3), moments))


def _number(element: Element, tag: str, default: float, where: str) -> float:
    """Read the number in a child of an element. Raises `InvalidInput`."""
    text = element.findtext(tag)
    if text is None:
        return default
    value = to_float(text.strip())
    if np.isnan(value):
        raise InvalidInput(f"{where} <{tag}>: given {quoted(text)}; allowed: a number")
    return value


def _inertia_of_shapes(
    findings: Findings, link: Element, inertial: Element, where: str
) -> pin.Inertia:
    """Sum up the inertia of all collision shapes of a link; shapes without one are faults."""
    total = pin.Inertia.Zero()
    density_of_link = _number(inertial, "density", _DEFAULT_DENSITY, where)
    for collision in link.findall("collision"):
        density = _number(collision, "density", density_of_link, where)
        X = read_pose(collision.find("pose"), f"{where} collision")
        for shape in collision.findall("geometry/*"):
            solid = _solid(shape, density, where)
            if solid is None:
                findings.faults.append(
                    f"{where}: inertia of <{shape.tag}> is left to the simulator; allowed: state it,"
                    " with mass, pose and inertia"
                )
                continue
            total += X.act(solid)
    return total


def _solid(shape: Element, density: float, where: str) -> pin.Inertia | None:
    """Return the inertia of a shape of a density [kg/m3]; `None` for kinds whose volume is not
    computed.
    """
    if shape.tag == "box":
        return solids.box_inertia(density, _vector(shape, "size", where))
    if shape.tag == "ellipsoid":
        return solids.ellipsoid_inertia(density, _vector(shape, "radii", where))
    radius = _number(shape, "radius", 0.5, where)
    length = _number(shape, "length", 1.0, where)
    if shape.tag == "sphere":
        return solids.ellipsoid_inertia(density, np.full(3, radius))
    if shape.tag == "cylinder":
        return solids.cylinder_inertia(density, radius, length)
    if shape.tag == "capsule":
        return solids.capsule_inertia(density, radius, length)
    return None


def _vector(element: Element, tag: str, where: str, default: str = "1 1 1") -> np.ndarray:
    """Read the three numbers in a child of an element. Raises `InvalidInput`."""
    text = " ".join(element.findtext(tag, default).split())
    values = np.array(to_floats(text))
    if values.size != 3 or not np.isfinite(values).all():
        raise InvalidInput(f"{where} <{tag}>: given {quoted(text)}; allowed: three numbers")
    return values


def add_shapes(
    findings: Findings, writer: UrdfWriter, target: Element, link: Element, folder: Path
) -> None:
    """Add the shapes of a link of SDF to `target`, the link of the URDF.

    folder: that of the SDF file, which addresses of meshes are relative to. Raises `InvalidInput`.
    """
    for kind in DRAWN:
        for element in link.findall(kind):
            where = f"link {quoted(target.get('name', ''))} {kind}"
            X = read_pose(element.find("pose"), where)
            colour = _colour(element)
            for shape in element.findall("geometry/*"):
                for written in _as_urdf(findings, shape, where, folder):
                    writer.add_shape(target, kind, X, written, colour)


def _as_urdf(
    findings: Findings, shape: Element, where: str, folder: Path
) -> Iterator[WrittenShape]:
    """Yield the shape for a URDF; nothing, with a note, for a shape that URDF does not have."""
    if shape.tag == "box":
        size = _vector(shape, "size", where)
        yield WrittenShape(tag="box", attributes={"size": words(size)})
    elif shape.tag in ("sphere", "cylinder", "capsule"):
        attributes = {"radius": repr(_number(shape, "radius", 0.5, where))}
        if shape.tag != "sphere":
            attributes["length"] = repr(_number(shape, "length", 1.0, where))
        yield WrittenShape(tag=shape.tag, attributes=attributes)
    elif shape.tag == "ellipsoid":
        findings.notes.append(f"{where}: <ellipsoid> is taken as the box around it")
        size = 2.0 * _vector(shape, "radii", where)
        yield WrittenShape(tag="box", attributes={"size": words(size)})
    elif shape.tag == "mesh":
        if shape.find("submesh") is not None:
            findings.notes.append(f"{where}: of a mesh with <submesh> all is taken")
        uri = shape.findtext("uri", "").strip()
        if not uri.startswith(_COMPLETE):
            uri = str(folder / uri)
        scale = _vector(shape, "scale", where)
        yield WrittenShape(tag="mesh", attributes={"filename": uri, "scale": words(scale)})
    elif shape.tag != "empty":
        findings.notes.append(f"{where}: <{shape.tag}> is left out, a URDF has no such shape")


def _colour(element: Element) -> np.ndarray | None:
    """Return the colour (4,) of a visual; `None` where it states none, or one that is no colour."""
    text = element.findtext("material/diffuse")
    if text is None:
        return None
    values = np.array(to_floats(" ".join(text.split())))
    if values.size == 3:
        values = np.append(values, 1.0)
    if values.size != 4 or not np.isfinite(values).all():
        return None
    return values
