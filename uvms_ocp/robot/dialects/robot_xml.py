"""Read a robot file of any format as a URDF: which format it is shows in its root element."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from uvms_ocp.errors import InvalidInput, RobotDataError
from uvms_ocp.record.xml_file import read_xml, read_xml_with_any_prefix
from uvms_ocp.robot.dialects.mjcf import urdf_of_mjcf
from uvms_ocp.robot.dialects.sdf import urdf_of_sdf
from uvms_ocp.robot.dialects.xacro_files import expanded, uses_xacro
from uvms_ocp.robot.urdf_elements import Element

ROBOT_SUFFIXES = (".urdf", ".sdf", ".xacro", ".xml", ".mjcf")
"""Endings of files that may hold a robot."""
_ALLOWED = "<robot> of URDF or xacro, <sdf>, <mujoco>"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RobotXml:
    """The <robot> of a file of any format."""

    root: Element
    notes: tuple[str, ...] = ()
    """Parts of the file that have no place in a URDF, a line each."""
    is_urdf: bool = True
    """True where the file itself is this URDF."""


def read_robot_xml(path: Path, package_dirs: Sequence[Path] = ()) -> RobotXml:
    """Return the <robot> of a file. Raises ``RobotDataError`` for what is none."""
    try:
        root = _read(path)
    except OSError as error:
        raise RobotDataError(path, f"cannot be read ({error.strerror or error})") from None
    except InvalidInput as error:
        raise RobotDataError(path, f"not a robot file, {error}") from None
    notes: tuple[str, ...] = ()
    is_urdf = True
    folders = (*(folder.resolve() for folder in package_dirs), *path.resolve().parents)
    if uses_xacro(path, root):
        root, notes = expanded(path, folders)
        is_urdf = False
    if root.tag == "robot":
        return RobotXml(root=root, notes=notes, is_urdf=is_urdf)
    if root.tag == "sdf":
        root, more_notes = urdf_of_sdf(path, root, folders)
    elif root.tag == "mujoco":
        root, more_notes = urdf_of_mjcf(path, root)
    elif root.tag == "scenario":
        raise RobotDataError(
            path,
            "a scene of Stonefish, whose masses come of its materials and meshes; allowed:"
            f" {_ALLOWED}, such as the URDF of its robot",
        )
    else:
        raise RobotDataError(
            path, f"not a robot file, the root element is <{root.tag}>; allowed: {_ALLOWED}"
        )
    return RobotXml(root=root, notes=(*notes, *more_notes), is_urdf=False)


def _read(path: Path) -> Element:
    """Read a file; one of SDF may have prefixes that it does not declare."""
    try:
        return read_xml(path)
    except InvalidInput as error:
        if "unbound prefix" not in str(error):
            raise
    return read_xml_with_any_prefix(path)


def robot_file_in(folder: Path) -> Path:
    """Return the robot file of a folder: robot.urdf, or of another format where that is the only
    one there.
    """
    urdf = folder / "robot.urdf"
    if urdf.is_file():
        return urdf
    candidates = list[Path]()
    for suffix in ROBOT_SUFFIXES:
        for name in ("robot", "model"):
            candidate = folder / f"{name}{suffix}"
            if candidate.is_file():
                candidates.append(candidate)
    if len(candidates) == 1:
        return candidates[0]
    return urdf
