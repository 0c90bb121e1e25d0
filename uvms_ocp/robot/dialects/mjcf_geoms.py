"""Geoms of MJCF: sizes, poses, inertia and the shapes of a URDF."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot.dialects import solids
from uvms_ocp.robot.dialects.mjcf_values import Compiler, number, pose, vector, z_axis_to
from uvms_ocp.robot.dialects.urdf_writer import WrittenShape, words
from uvms_ocp.robot.urdf_elements import quoted

_DENSITY = 1000.0  # [kg/m3] of geoms that state neither mass nor density
_LONG = ("capsule", "cylinder", "box", "ellipsoid")
"""Kinds that may be stated by both ends."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MeshAsset:
    """A mesh that geoms name."""

    file: Path
    scale: np.ndarray
    """Factors (3,)."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Geom:
    """A geom in its body."""

    kind: str
    X: pin.SE3
    """Pose in the body."""
    size: np.ndarray
    """Half sides, radii, or radius and half length [m]."""
    mesh: MeshAsset | None
    values: dict[str, str]
    """All attributes, with defaults."""

    @property
    def collides(self) -> bool:
        """True where it may touch something."""
        types = (number(self.values, "contype", 1.0), number(self.values, "conaffinity", 1.0))
        return any(types)

    @property
    def colour(self) -> np.ndarray | None:
        """Colour (4,) where it states one."""
        if "rgba" not in self.values:
            return None
        return vector(self.values, "rgba", [0.5, 0.5, 0.5, 1.0])

    def inertia(self) -> pin.Inertia | None:
        """Return its inertia in the body; `None` of one without volume."""
        density = number(self.values, "density", _DENSITY)
        if self.kind == "mesh":
            assert self.mesh is not None  # as it was read
            solid = solids.mesh_inertia(1.0, self.mesh.file, self.mesh.scale)
        else:
            solid = _solid(self.kind, self.size)
        if solid is None:
            return None
        factor = density
        if "mass" in self.values:
            factor = number(self.values, "mass", 0.0) / solid.mass
        scaled = pin.Inertia(solid.mass * factor, solid.lever, np.array(solid.inertia) * factor)
        return self.X.act(scaled)

    def shape(self) -> WrittenShape | None:
        """Return it in words of a URDF; `None` for what that does not have."""
        if self.kind == "mesh":
            assert self.mesh is not None  # as it was read
            attributes = {"filename": str(self.mesh.file), "scale": words(self.mesh.scale)}
            return WrittenShape(tag="mesh", attributes=attributes)
        if self.kind in ("box", "ellipsoid"):
            return WrittenShape(tag="box", attributes={"size": words(2.0 * self.size)})
        if self.kind == "sphere":
            return WrittenShape(tag="sphere", attributes={"radius": repr(float(self.size[0]))})
        if self.kind in ("cylinder", "capsule"):
            radius, half = map(float, self.size[:2])
            sizes = {"radius": repr(radius), "length": repr(2.0 * half)}
            return WrittenShape(tag=self.kind, attributes=sizes)
        return None


def _solid(kind: str, size: np.ndarray) -> pin.Inertia | None:
    """Return the inertia of a solid of 1 kg/m3."""
    if kind == "box":
        return solids.box_inertia(1.0, 2.0 * size)
    if kind == "ellipsoid":
        return solids.ellipsoid_inertia(1.0, size)
    if kind == "sphere":
        return solids.ellipsoid_inertia(1.0, np.full(3, size[0]))
    if kind == "cylinder":
        return solids.cylinder_inertia(1.0, float(size[0]), 2.0 * float(size[1]))
    if kind == "capsule":
        return solids.capsule_inertia(1.0, float(size[0]), 2.0 * float(size[1]))
    return None


def read_geom(values: dict[str, str], meshes: dict[str, MeshAsset], compiler: Compiler) -> Geom:
    """Read a geom of these attributes. Raises `InvalidInput`."""
    kind = values.get("type", "mesh" if "mesh" in values else "sphere")
    size = vector(values, "size", [])
    X = pose(values, compiler)
    mesh = None
    if "mesh" in values:
        if values["mesh"] not in meshes:
            raise InvalidInput(f"<geom>: mesh {quoted(values['mesh'])} is not among the assets")
        if kind == "mesh":
            mesh = meshes[values["mesh"]]
        else:
            raise InvalidInput(f"<geom>: a {kind} fitted to a mesh; allowed: its size in numbers")
    if "fromto" in values and kind in _LONG:
        ends = vector(values, "fromto", [0.0] * 6).reshape(2, 3)
        along = ends[0] - ends[1]  # z points from the second end to the first
        half = float(np.linalg.norm(along)) / 2.0
        X = pin.SE3(z_axis_to(along), ends.mean(axis=0))
        width = float(size[0]) if size.size else 0.0
        if kind in ("capsule", "cylinder"):
            size = np.array([width, half])
        else:
            size = np.array([width, width, half])
    n_needed = {"box": 3, "ellipsoid": 3, "cylinder": 2, "capsule": 2, "sphere": 1}.get(kind, 0)
    if size.size < n_needed:
        raise InvalidInput(
            f"<geom> size: given {size.size} numbers; allowed of a {kind}: {n_needed}"
        )
    size = size[:n_needed]
    return Geom(kind=kind, X=X, size=size, mesh=mesh, values=values)
