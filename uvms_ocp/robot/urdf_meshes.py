"""Find the files of the meshes of a URDF, and say what is wrong with them."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import coal
import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.untrusted import note_file_read
from uvms_ocp.record.xml_file import read_xml, read_xml_text
from uvms_ocp.robot.urdf_elements import read_urdf_xml

_LFS = b"version https://git-lfs"
"""First bytes of a file that Git LFS has not fetched."""
_DECLARED_ENCODING = re.compile(r"""(<\?xml[^>]*\sencoding\s*=\s*)["'][^"'>]*["']""")


def find_mesh(path: Path, filename: str, folders: Sequence[Path]) -> Path | None:
    """Find the file of a mesh of a URDF at `path`; `None` where there is none."""
    for mesh_file in _mesh_candidates(path, filename, folders):
        if os.path.isfile(mesh_file):  # False for a name that no disk takes
            note_file_read(mesh_file)
            return mesh_file
    return None


def _mesh_candidates(path: Path, filename: str, folders: Sequence[Path]) -> list[Path]:
    """Return where a mesh may be, the likeliest first."""
    scheme, mark, relative = filename.partition("://")
    if mark and scheme in ("package", "model"):
        package, _, inside = relative.partition("/")
        candidates = list[Path]()
        for folder in folders:
            candidates.append(folder / relative)
            if _is_package(folder, package):
                candidates.append(folder / inside)
        return candidates
    plain = Path(filename.removeprefix("file://"))
    return [path.resolve().parent / plain, *(folder / plain for folder in folders)]


def _is_package(folder: Path, package: str) -> bool:
    """Check whether a folder is that package under another name, as a checkout may be."""
    manifest = folder / "package.xml"
    with suppress(OSError, InvalidInput):
        if os.path.isfile(manifest):
            return read_xml(manifest).findtext("name", "").strip() == package
    return False


def mesh_problem(file: Path, loader: coal.MeshLoader) -> str:
    """Return what is wrong with the file of a mesh; "" where coal can read it."""
    with suppress(OSError), file.open("rb") as stream:
        if stream.read(len(_LFS)) == _LFS:
            return (
                f"mesh {file.name!r} is a pointer of Git LFS, without content: `git lfs pull`"
                " fetches it"
            )
    try:
        loader.load(str(file), np.ones(3))
    except (ValueError, RuntimeError):
        return f"mesh {file.name!r} cannot be read; allowed: STL, DAE or OBJ with triangles"
    return ""


def with_own_meshes(path: Path, package_dirs: Sequence[Path] = ()) -> tuple[str, dict[str, Path]]:
    """Return the text of a URDF, for UTF-8, whose meshes stand in ``meshes`` beside it, and which
    files these are copies of.

    What is not found is named as it was.
    """
    text = _DECLARED_ENCODING.sub(r'\1"utf-8"', read_xml_text(path), count=1)
    folders = (*(folder.resolve() for folder in package_dirs), *path.resolve().parents)
    meshes = read_urdf_xml(path).iter("mesh")
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
