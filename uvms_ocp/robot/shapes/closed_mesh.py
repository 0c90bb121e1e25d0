"""The solid inside of a closed triangle mesh: which points are in it, and how far its surface is.

A point is inside where the surface winds around it (Jacobson, Kavan, Sorkine-Hornung: Robust
inside-outside segmentation using generalized winding numbers, 2013).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import coal
import numpy as np

_PARALLEL = 1.0 - 1e-8  # cosine of directions that are one
_IN_PLANE = 1e-5  # share of the size of a mesh
_SAME_VERTEX = 1e-9  # share of the size of a mesh within which two of its vertices are one


@dataclass(frozen=True, kw_only=True, eq=False)
class Solid:
    """The inside of a closed surface, in the frame of the mesh."""

    corners: np.ndarray
    """Corners (n, 3, 3) [m] of every triangle."""

    def holds(self, point: np.ndarray) -> bool:
        """Check whether a point (3,) [m] is inside."""
        return bool(self.inside(point[None])[0])

    def inside(self, points: np.ndarray) -> np.ndarray:
        """Return (n,) True for points (n, 3) [m] around which the surface winds."""
        lower, upper = self._box
        is_inside = np.zeros(len(points), dtype=bool)
        in_box = np.flatnonzero(((points > lower) & (points < upper)).all(axis=1))
        is_inside[in_box] = [self._winds(point) for point in points[in_box]]
        return is_inside

    def nearest(self, point: np.ndarray) -> np.ndarray:
        """Return the point (3,) [m] of the surface nearest to one (3,) [m]."""
        candidates = _nearest_on_triangles(self.corners, point)
        distances = np.linalg.norm(candidates - point, axis=1)
        return np.asarray(candidates[int(np.argmin(distances))])

    def has_face(self, point: np.ndarray, direction: np.ndarray) -> bool:
        """Check whether a triangle lies in the plane of a point (3,) [m] across a direction (3,) of
        unit length.
        """
        is_across = np.abs(self._normals @ direction) > _PARALLEL
        heights = (point - self.corners[is_across, 0]) @ direction
        return bool((np.abs(heights) < _IN_PLANE * np.ptp(self._box)).any())

    @cached_property
    def _normals(self) -> np.ndarray:
        """Normals (n, 3) of unit length of the triangles; zero where one has no area."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        normals = np.cross(b - a, c - a)
        lengths = np.linalg.norm(normals, axis=1)
        return np.asarray(normals / np.maximum(lengths, np.finfo(float).tiny)[:, None])

    @cached_property
    def _box(self) -> tuple[np.ndarray, np.ndarray]:
        points = self.corners.reshape(-1, 3)
        return points.min(axis=0), points.max(axis=0)

    def _winds(self, point: np.ndarray) -> bool:
        """Sum the solid angles of the triangles (van Oosterom, Strackee 1983), in turns."""
        a, b, c = np.moveaxis(self.corners - point, 1, 0)
        length_a = np.linalg.norm(a, axis=1)
        length_b = np.linalg.norm(b, axis=1)
        length_c = np.linalg.norm(c, axis=1)
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        denominator = (
            length_a * length_b * length_c
            + _dot(a, b) * length_c
            + _dot(b, c) * length_a
            + _dot(c, a) * length_b
        )
        turns = 2.0 * np.arctan2(volume, denominator).sum() / (4.0 * np.pi)
        return bool(abs(turns) > 0.5)


def closed_solid(vertices: np.ndarray, triangles: np.ndarray) -> Solid | None:
    """Return the inside of a mesh of vertices (n, 3) [m] and triangles (m, 3); `None` where it is
    open: each edge of a closed one is shared by two triangles that run along it in opposite
    directions.
    """
    size = float(np.ptp(vertices, axis=0).max(initial=0.0))
    if not size > 0.0:
        return None
    rounded = np.round((vertices - vertices.min(axis=0)) / (_SAME_VERTEX * size))
    _, merged_index = np.unique(rounded, axis=0, return_inverse=True)
    merged = merged_index.reshape(-1)[triangles]
    is_triangle = (merged != np.roll(merged, 1, axis=1)).all(axis=1)
    merged = merged[is_triangle]
    edges = np.concatenate([merged[:, [0, 1]], merged[:, [1, 2]], merged[:, [2, 0]]])
    forward, n_forward = np.unique(edges, axis=0, return_counts=True)
    backward, n_backward = np.unique(edges[:, ::-1], axis=0, return_counts=True)
    if not (np.array_equal(forward, backward) and np.array_equal(n_forward, n_backward)):
        return None
    return Solid(corners=vertices[triangles[is_triangle]])


def mesh_triangles(shape: coal.BVHModelBase) -> list[list[int]]:
    """Return the indices of the vertices of every triangle of a mesh, three each."""
    triangles = list[list[int]]()
    for k in range(shape.num_tris):
        a, b, c = (shape.tri_indices(k)[i] for i in range(3))
        triangles.append([a, b, c])
    return triangles


def _nearest_on_triangles(corners: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the point (n, 3) [m] of each triangle (n, 3, 3) nearest to a point (3,): its foot in
    the plane where that is inside, else the nearest of its edges.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    edges = ((a, b), (b, c), (c, a))
    normal = np.cross(b - a, c - a)
    square = np.maximum(_dot(normal, normal), np.finfo(float).tiny)
    foot = point - (_dot(point - a, normal) / square)[:, None] * normal
    sides = [_dot(np.cross(q - p, foot - p), normal) for p, q in edges]
    is_inside: np.ndarray = np.all(np.array(sides) >= 0.0, axis=0)
    on_edges = np.stack([_nearest_on_edges(p, q, point) for p, q in edges])
    distances = np.linalg.norm(on_edges - point, axis=2)
    on_nearest_edge = on_edges[distances.argmin(axis=0), np.arange(len(corners))]
    return np.asarray(np.where(is_inside[:, None], foot, on_nearest_edge))


def _nearest_on_edges(p: np.ndarray, q: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return the point (n, 3) [m] of each edge from p to q (n, 3) nearest to a point (3,)."""
    edge = q - p
    square = np.maximum(_dot(edge, edge), np.finfo(float).tiny)
    share = np.clip(_dot(point - p, edge) / square, 0.0, 1.0)
    return np.asarray(p + share[:, None] * edge)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("ij,ij->i", a, b))
