"""Find the files of the meshes of a URDF, in which unit they are, and say what is wrong with them."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import coal
import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.record.untrusted import note_file_read
from uvms_ocp.record.xml_file import read_xml
from uvms_ocp.robot.urdf_elements import to_float

_LFS = b"version https://git-lfs"
"""First bytes of a file that Git LFS has not fetched."""
_WORKSPACE_DEPTH = 5  # folders above a file that may hold packages in groups, as workspaces do
_GROUPS = ("*", "*/*")  # folders of packages in a workspace, groups of them in repositories
_COLLADA_HEAD = 65536  # bytes within which a Collada file states its unit and axes
_UNITS = (1e-6, 1e6)  # [m] what a unit of length may be
_COLLADA_METRE = re.compile(rb"""<unit\b[^>]*\bmeter\s*=\s*["']\s*([^"'\s]+)\s*["']""")
_COLLADA_UP_AXIS = re.compile(rb"<up_axis>\s*([XYZ]_UP)\s*</up_axis>")


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


def find_package(package: str, folders: Sequence[Path]) -> Path | None:
    """Find the folder of a package in, among, or a little below these folders, the nearest first;
    `None` where it is not there.
    """
    for folder in folders:
        if _is_package(folder, package):
            return folder
        inside = folder / package
        if os.path.isdir(inside):
            return inside
    for folder in folders[:_WORKSPACE_DEPTH]:
        for groups in _GROUPS:
            for below in sorted(folder.glob(f"{groups}/{package}")):
                if (below / "package.xml").is_file():
                    return below
    return None


def _is_package(folder: Path, package: str) -> bool:
    """Check whether a folder is that package under another name, as a checkout may be."""
    manifest = folder / "package.xml"
    with suppress(OSError, InvalidInput):
        if os.path.isfile(manifest):
            return read_xml(manifest).findtext("name", "").strip() == package
    return False


@dataclass(frozen=True, kw_only=True, slots=True)
class ColladaAsset:
    """Statements of a Collada file about its coordinates."""

    metres: float = 1.0
    """Length of its unit [m]."""
    up_axis: str = "Z_UP"
    """The axis that points up: ``X_UP``, ``Y_UP`` or ``Z_UP``."""


def collada_asset(file: Path) -> ColladaAsset:
    """Read the unit and the axes of a mesh; metres with z up of one that states none."""
    if file.suffix.lower() != ".dae":
        return ColladaAsset()
    with suppress(OSError), file.open("rb") as stream:
        head = stream.read(_COLLADA_HEAD)
        unit = _COLLADA_METRE.search(head)
        metres = 1.0
        if unit:
            metres = to_float(unit[1].decode("latin-1"))
        if not _UNITS[0] <= metres <= _UNITS[1]:
            metres = 1.0
        up_axis = _COLLADA_UP_AXIS.search(head)
        return ColladaAsset(metres=metres, up_axis=up_axis[1].decode() if up_axis else "Z_UP")
    return ColladaAsset()


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
