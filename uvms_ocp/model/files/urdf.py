"""URDF text to Pinocchio models.

The XML is checked before Pinocchio sees it, because its parser writes to stderr and its messages do not say
which element is wrong; and the models are checked against the XML, because it leaves out what it cannot read.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from uvms_ocp.exceptions import InvalidInput, RobotDataError
from uvms_ocp.model.files.urdf_agreement import check_agreement
from uvms_ocp.model.files.urdf_checks import check_urdf
from uvms_ocp.model.files.urdf_words import unread_words
from uvms_ocp.untrusted.regular_file import tell_read
from uvms_ocp.untrusted.xml_file import read_xml

Element = ElementTree.Element

_log = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class UrdfModels:
    """What one URDF gives: the mechanism and its two sets of shapes."""

    name: str
    model: pin.Model
    visual: pin.GeometryModel
    collision: pin.GeometryModel


def read_urdf(
    path: Path, *, free_flyer: bool, package_dirs: Sequence[Path] = (), let_mimic: bool = False
) -> UrdfModels:
    """Read a URDF file; every mistake in it is a one-line ``RobotDataError``, and so is a number that gets lost.

    What the file holds beside a URDF is one warning, see `uvms_ocp.model.files.urdf_words`.

    ``package://name/...`` is searched as ``<dir>/name/...`` in ``package_dirs`` and in the folders above the
    file; other mesh paths are relative to the file. Joints that
    mimic another one are refused, unless ``let_mimic`` makes them joints of their own.
    """
    root = _parse(path)
    unread = unread_words(path, root)
    check_urdf(path, root, let_mimic=let_mimic)
    if unread:
        _log.warning("%s: not read, since it is no part of URDF: %s", path, unread)
    for joint in root.findall("joint[mimic]"):
        _log.warning("%s: joint %r moves on its own, its <mimic> is not kept", path, joint.get("name"))
    _resolve_meshes(path, root, (*(folder.resolve() for folder in package_dirs), *path.resolve().parents))
    return _build(path, root, free_flyer)


def _parse(path: Path) -> Element:
    try:
        root = read_xml(path)
    except OSError as error:
        raise RobotDataError(path, f"cannot be read ({error.strerror or error})") from None
    except InvalidInput as error:
        raise RobotDataError(path, f"not a URDF, {error}") from None
    if root.tag != "robot":
        raise RobotDataError(path, f"not a URDF, the root element is <{root.tag}>; allowed: <robot>")
    return root


def _resolve_meshes(path: Path, root: Element, search: Iterable[Path]) -> None:
    folders = tuple(search)
    for mesh in root.iter("mesh"):
        mesh.set("filename", str(_resolve_mesh(path, mesh.get("filename", ""), folders)))


def _resolve_mesh(path: Path, filename: str, folders: Sequence[Path]) -> Path:
    for candidate in _mesh_candidates(path, filename, folders):
        if candidate.is_file():
            tell_read(candidate)
            return candidate
    advice = (
        "give package_dirs=[folder that contains the package], `check-robot --packages DIR`; or put that above the URDF"
    )
    raise RobotDataError(path, f"mesh {filename!r} not found; {advice}")


def _mesh_candidates(path: Path, filename: str, folders: Sequence[Path]) -> list[Path]:
    if filename.startswith("package://"):
        relative = filename.removeprefix("package://")
        return [folder / relative for folder in folders]
    plain = Path(filename.removeprefix("file://"))
    return [path.resolve().parent / plain, *(folder / plain for folder in folders)]


def _build(path: Path, root: Element, free_flyer: bool) -> UrdfModels:
    text = ElementTree.tostring(root, encoding="unicode")
    try:
        model = pin.buildModelFromXML(text, *([pin.JointModelFreeFlyer()] if free_flyer else []))
        shapes = [
            pin.buildGeomFromUrdfString(model, text, kind)
            for kind in (pin.GeometryType.VISUAL, pin.GeometryType.COLLISION)
        ]
    except (ValueError, RuntimeError) as error:
        raise RobotDataError(path, f"Pinocchio refuses it ({' '.join(str(error).split())})") from None
    check_agreement(path, root, model, shapes)
    name = root.get("name", path.stem)
    model.name = name
    return UrdfModels(name=name, model=model, visual=shapes[0], collision=shapes[1])
