"""Inertia of solid shapes of one density, for formats that leave it to the reader."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pinocchio as pin


def box_inertia(density: float, sides: np.ndarray) -> pin.Inertia:
    """Return the inertia of a box with sides (3,) [m] of a density [kg/m3]."""
    mass = density * float(np.prod(sides))
    return pin.Inertia.FromBox(mass, *map(float, sides))


def ellipsoid_inertia(density: float, radii: np.ndarray) -> pin.Inertia:
    """Return the inertia of an ellipsoid with radii (3,) [m] of a density [kg/m3]."""
    mass = density * 4.0 / 3.0 * np.pi * float(np.prod(radii))
    return pin.Inertia.FromEllipsoid(mass, *map(float, radii))


def cylinder_inertia(density: float, radius: float, length: float) -> pin.Inertia:
    """Return the inertia of a cylinder along z, sizes in [m], of a density [kg/m3]."""
    mass = density * np.pi * radius**2 * length
    return pin.Inertia.FromCylinder(mass, radius, length)


def capsule_inertia(density: float, radius: float, length: float) -> pin.Inertia:
    """Return the inertia of a capsule along z with a straight part of `length` [m], of a density
    [kg/m3].
    """
    ends = density * 4.0 / 3.0 * np.pi * radius**3  # [kg] both half balls
    middle = cylinder_inertia(density, radius, length)
    # A half ball has its mass 3/8 of the radius beyond its flat face.
    spin = 0.4 * ends * radius**2
    tumble = spin + ends * (length**2 / 4.0 + 3.0 / 8.0 * length * radius)
    moments = np.array(middle.inertia) + np.diag([tumble, tumble, spin])
    return pin.Inertia(float(middle.mass + ends), np.zeros(3), moments)


def mesh_inertia(density: float, file: Path, scale: np.ndarray) -> pin.Inertia | None:
    """Return the inertia of a closed mesh of a density [kg/m3]; `None` of one that encloses
    nothing.
    """
    try:
        mesh = coal.MeshLoader().load(str(file), scale)
    except (ValueError, RuntimeError):
        return None
    vertices = np.array(mesh.vertices(), dtype=float).reshape(-1, 3)
    triangles = []
    for i in range(mesh.num_tris):
        triangle = mesh.tri_indices(i)
        triangles.append([triangle[0], triangle[1], triangle[2]])
    corners = vertices[triangles]
    # Tetrahedra between the origin and each triangle.
    volumes = np.linalg.det(corners) / 6.0
    volume = float(volumes.sum())
    if abs(volume) < 1e-12:
        return None
    centres = corners.sum(axis=1) / 4.0
    centre = volumes @ centres / volume
    sums = corners.sum(axis=1)
    outer = np.einsum("n,nki,nkj->ij", volumes, corners, corners)
    outer += np.einsum("n,ni,nj->ij", volumes, sums, sums)
    second = outer / 20.0 / volume - np.outer(centre, centre)  # [m2] mean of x x'
    mass = density * abs(volume)
    moments = mass * (np.trace(second) * np.eye(3) - second)
    return pin.Inertia(mass, centre, moments)
