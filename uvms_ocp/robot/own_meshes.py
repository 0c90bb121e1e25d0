"""Write a robot file as a URDF with its meshes beside it, for a folder of its own."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

from uvms_ocp.record.xml_file import read_xml_text
from uvms_ocp.robot.dialects.robot_xml import read_robot_xml
from uvms_ocp.robot.urdf_meshes import find_mesh

_DECLARED_ENCODING = re.compile(r"""(<\?xml[^>]*\sencoding\s*=\s*)["'][^"'>]*["']""")


def with_own_meshes(path: Path, package_dirs: Sequence[Path] = ()) -> tuple[str, dict[str, Path]]:
    """Return the text of a robot file as a URDF in UTF-8, whose meshes are in the folder ``meshes``
    beside it, and the files of which these are copies.

    Meshes that are not found keep their names.
    """
    robot_xml = read_robot_xml(path, package_dirs)
    if robot_xml.is_urdf:
        text = _DECLARED_ENCODING.sub(r'\1"utf-8"', read_xml_text(path), count=1)
    else:
        ElementTree.indent(robot_xml.root)
        text = ElementTree.tostring(robot_xml.root, encoding="unicode") + "\n"
    folders = (*(folder.resolve() for folder in package_dirs), *path.resolve().parents)
    meshes = robot_xml.root.iter("mesh")
    copies: dict[str, Path] = {}
    for filename in dict.fromkeys(mesh.get("filename", "") for mesh in meshes):
        mesh_file = find_mesh(path, filename, folders)
        if mesh_file is None:
            continue
        name = f"meshes/{mesh_file.name}"
        while copies.get(name, mesh_file) != mesh_file:
            name = name.replace("meshes/", "meshes/_", 1)
        copies[name] = mesh_file
        text = text.replace(f'"{filename}"', f'"{name}"').replace(f"'{filename}'", f"'{name}'")
    return text, copies
