"""Signed distances by coal that know the inside of closed triangle meshes.

To coal a mesh is a surface: what is wholly inside it is as far as from outside, and what crosses it
is pushed to whichever side is nearer. Here a mesh whose triangles close, each edge shared by two
that run along it in opposite directions, is a solid: a point is inside where the surface winds
around it (Jacobson, Kavan, Sorkine-Hornung: Robust inside-outside segmentation using generalized
winding numbers, 2013). Depth is the way out through the place of the surface that is nearest: of
what is inside, or crosses, its deepest point along the normal there. An open mesh, such as a patch
of seafloor, stays a surface.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import coal
import numpy as np
import pinocchio as pin

_NEXT = 1e-6  # [m] beside a surface, where it is asked which side is inside
_SAME = 1e-9  # share of the size of a mesh within which two of its vertices are one
_UNIT = 1e-6  # by which the length of a normal that coal has set may differ from 1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PairContact:
    """Nearest points of two shapes, or the deepest ones of an overlap."""

    distance: float
    """[m] signed."""
    normal: np.ndarray
    """(3,) in W, from the first shape to the second; zero where there is none."""
    first: np.ndarray
    """(3,) [m] in W, on the first shape."""
    second: np.ndarray
    """(3,) [m] in W, on the second."""


class SignedDistances:
    """Pairs of a geometry model, whose closed meshes are solids."""

    def __init__(self, geometry: pin.GeometryModel) -> None:
        self._geometry = geometry
        pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
        used = {k for pair in pairs for k in pair}
        bodies = {k: Body(geometry.geometryObjects[k].geometry) for k in used}
        self._bodies = bodies
        self._has_mesh = [bodies[a].is_mesh or bodies[b].is_mesh for a, b in pairs]
        self._pairs = pairs

    def distance(self, data: pin.GeometryData, pair: int) -> float:
        """[m] of a pair, with the shapes placed as in the data; see `coal` for what it fails at."""
        result = pin.computeDistance(self._geometry, data, pair)
        if not self._has_mesh[pair]:
            return float(result.min_distance)
        return self._signed(data, pair, result).distance

    def contact(self, data: pin.GeometryData, pair: int) -> PairContact:
        """Find the nearest points of a pair."""
        result = pin.computeDistance(self._geometry, data, pair)
        if self._has_mesh[pair]:
            return self._signed(data, pair, result)
        return _by_coal(result)

    def _signed(
        self, data: pin.GeometryData, pair: int, result: coal.DistanceResult
    ) -> PairContact:
        a, b = self._pairs[pair]
        places = (data.oMg[a], data.oMg[b])
        return signed_contact((self._bodies[a], self._bodies[b]), places, result)


def open_surfaces(geometry: pin.GeometryModel) -> tuple[str, ...]:
    """Return the names of the shapes that are open meshes: nothing tells of what is behind them."""
    bodies = [(item.name, Body(item.geometry)) for item in geometry.geometryObjects]
    return tuple(name for name, body in bodies if body.is_mesh and body.solid is None)


def signed_contact(
    bodies: tuple[Body, Body], places: tuple[pin.SE3, pin.SE3], result: coal.DistanceResult
) -> PairContact:
    """The contact of two bodies at their places, of which coal has found the surfaces' own."""
    near = _by_coal(result)
    if near.distance > 0.0:
        for inner in (1, 0):
            outer = bodies[1 - inner].solid
            point = near.second if inner else near.first
            if outer is not None and outer.holds(places[1 - inner].actInv(point)):
                way = near.first - near.second if inner else near.second - near.first
                surface = near.first if inner else near.second
                out = way / np.linalg.norm(way)
                return _way_out(surface, out, bodies[inner], places[inner], inner)
        return near
    if bodies[0].is_mesh and bodies[1].is_mesh:
        return _crossing_meshes(bodies, places, near)
    mesh = 0 if bodies[0].is_mesh else 1
    solid = bodies[mesh].solid
    if solid is None:
        return near
    surface = near.second if mesh else near.first
    out = -near.normal if mesh else near.normal
    if solid.holds(places[mesh].actInv(surface + _NEXT * out)):
        out = -out
    return _way_out(surface, out, bodies[1 - mesh], places[1 - mesh], 1 - mesh)


def _by_coal(result: coal.DistanceResult) -> PairContact:
    """With a normal by the nearest points where coal leaves it unset, as it does for two meshes."""
    first = np.array(result.getNearestPoint1())
    second = np.array(result.getNearestPoint2())
    normal = np.array(result.normal)
    if not abs(np.linalg.norm(normal) - 1.0) < _UNIT:
        way = second - first
        length = float(np.linalg.norm(way))
        normal = way / length if length > 0.0 else np.zeros(3)
    return PairContact(
        distance=float(result.min_distance), normal=normal, first=first, second=second
    )


def _way_out(
    surface: np.ndarray, out: np.ndarray, inner: Body, place: pin.SE3, number: int
) -> PairContact:
    """Contact of a body that is to leave a solid along `out` (3,) at a point of its surface (3,)
    [m]; number: whether it is the first (0) or the second (1) of the pair.
    """
    deepest = place.act(inner.lowest(place.rotation.T @ out))
    depth = float(out @ (surface - deepest))
    first, second = (surface, deepest) if number else (deepest, surface)
    return PairContact(
        distance=-max(depth, 0.0), normal=out if number else -out, first=first, second=second
    )


def _crossing_meshes(
    bodies: tuple[Body, Body], places: tuple[pin.SE3, pin.SE3], near: PairContact
) -> PairContact:
    """By the vertex of either that is deepest in the other; without one they touch."""
    best = near
    for inner in (1, 0):
        outer = bodies[1 - inner].solid
        if outer is None:
            continue
        between = places[1 - inner].actInv(places[inner])
        points = bodies[inner].vertices @ between.rotation.T + between.translation
        points = points[outer.inside(points)]
        for point in points:
            nearest = outer.nearest(point)
            depth = float(np.linalg.norm(nearest - point))
            if depth <= max(-best.distance, 0.0):
                continue
            surface = places[1 - inner].act(nearest)
            vertex = places[1 - inner].act(point)
            out = (surface - vertex) / depth
            first, second = (surface, vertex) if inner else (vertex, surface)
            best = PairContact(
                distance=-depth, normal=out if inner else -out, first=first, second=second
            )
    return best


class Body:
    """A shape, in its own frame."""

    def __init__(self, shape: coal.CollisionGeometry) -> None:
        self._shape = shape
        self.is_mesh = isinstance(shape, coal.BVHModelBase)

    @cached_property
    def vertices(self) -> np.ndarray:
        """(n, 3) [m] of a mesh or a polytope."""
        if self.is_mesh:
            return np.array(self._shape.vertices(), dtype=float).reshape(-1, 3)
        return np.array(self._shape.points(), dtype=float).reshape(-1, 3)

    @cached_property
    def solid(self) -> Solid | None:
        """The solid inside a closed mesh; `None` for an open one."""
        if not self.is_mesh:
            return None
        shape = self._shape
        triangles = [[shape.tri_indices(k)[i] for i in range(3)] for k in range(shape.num_tris)]
        return closed_solid(self.vertices, np.array(triangles, dtype=int).reshape(-1, 3))

    def lowest(self, direction: np.ndarray) -> np.ndarray:
        """(3,) [m] The point of it that is least along a direction (3,); its origin, where its form
        is not known here or has no end.
        """
        for kind, point in _LOWEST.items():
            if isinstance(self._shape, kind):
                return np.asarray(point(self._shape, direction))
        if self.is_mesh or isinstance(self._shape, coal.ConvexBase):
            return np.asarray(self.vertices[int(np.argmin(self.vertices @ direction))])
        return np.zeros(3)


@dataclass(frozen=True, kw_only=True, eq=False)
class Solid:
    """The inside of a closed surface, in the frame of the mesh."""

    corners: np.ndarray
    """(n, 3, 3) [m] of every triangle."""

    def holds(self, point: np.ndarray) -> bool:
        """Check whether a point (3,) [m] is inside."""
        return bool(self.inside(point[None])[0])

    def inside(self, points: np.ndarray) -> np.ndarray:
        """(n,) True for points (n, 3) [m] around which the surface winds."""
        lower, upper = self._box
        result = np.zeros(len(points), dtype=bool)
        near = np.flatnonzero(((points > lower) & (points < upper)).all(axis=1))
        result[near] = [self._winds(point) for point in points[near]]
        return result

    def nearest(self, point: np.ndarray) -> np.ndarray:
        """(3,) [m] The point of the surface nearest to one (3,) [m]."""
        candidates = _nearest_on_triangles(self.corners, point)
        ways = np.linalg.norm(candidates - point, axis=1)
        return np.asarray(candidates[int(np.argmin(ways))])

    @cached_property
    def _box(self) -> tuple[np.ndarray, np.ndarray]:
        points = self.corners.reshape(-1, 3)
        return points.min(axis=0), points.max(axis=0)

    def _winds(self, point: np.ndarray) -> bool:
        """Sum the solid angles of the triangles (van Oosterom, Strackee 1983), in turns."""
        a, b, c = np.moveaxis(self.corners - point, 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        rest = la * lb * lc + _dot(a, b) * lc + _dot(b, c) * la + _dot(c, a) * lb
        turns = 2.0 * np.arctan2(volume, rest).sum() / (4.0 * np.pi)
        return bool(abs(turns) > 0.5)


def closed_solid(vertices: np.ndarray, triangles: np.ndarray) -> Solid | None:
    """The inside of a mesh of vertices (n, 3) [m] and triangles (m, 3); None where it is open."""
    size = float(np.ptp(vertices, axis=0).max(initial=0.0))
    if not size > 0.0:
        return None
    rounded = np.round((vertices - vertices.min(axis=0)) / (_SAME * size))
    _, same = np.unique(rounded, axis=0, return_inverse=True)
    own = same.reshape(-1)[triangles]
    distinct = (own != np.roll(own, 1, axis=1)).all(axis=1)
    own = own[distinct]
    edges = np.concatenate([own[:, [0, 1]], own[:, [1, 2]], own[:, [2, 0]]])
    there, n_there = np.unique(edges, axis=0, return_counts=True)
    back, n_back = np.unique(edges[:, ::-1], axis=0, return_counts=True)
    if not (np.array_equal(there, back) and np.array_equal(n_there, n_back)):
        return None
    return Solid(corners=vertices[triangles[distinct]])


def _nearest_on_triangles(corners: np.ndarray, point: np.ndarray) -> np.ndarray:
    """(n, 3) [m] The point of each triangle (n, 3, 3) nearest to a point (3,): its foot in the
    plane where that is inside, else the nearest of its edges.
    """
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    square = np.maximum(_dot(normal, normal), np.finfo(float).tiny)
    foot = point - (_dot(point - a, normal) / square)[:, None] * normal
    sides = [_dot(np.cross(q - p, foot - p), normal) for p, q in ((a, b), (b, c), (c, a))]
    inside: np.ndarray = np.all(np.array(sides) >= 0.0, axis=0)
    edges = np.stack([_nearest_on_edges(p, q, point) for p, q in ((a, b), (b, c), (c, a))])
    ways = np.linalg.norm(edges - point, axis=2)
    best = edges[ways.argmin(axis=0), np.arange(len(corners))]
    return np.asarray(np.where(inside[:, None], foot, best))


def _nearest_on_edges(p: np.ndarray, q: np.ndarray, point: np.ndarray) -> np.ndarray:
    way = q - p
    square = np.maximum(_dot(way, way), np.finfo(float).tiny)
    share = np.clip(_dot(point - p, way) / square, 0.0, 1.0)
    return np.asarray(p + share[:, None] * way)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _lowest_of_cylinder(shape: coal.Cylinder, d: np.ndarray) -> np.ndarray:
    return np.append(_rim(shape.radius, d), -shape.halfLength * np.sign(d[2]))


def _lowest_of_cone(shape: coal.Cone, d: np.ndarray) -> np.ndarray:
    top = np.array([0.0, 0.0, shape.halfLength])
    foot = np.append(_rim(shape.radius, d), -shape.halfLength)
    return min((top, foot), key=lambda point: float(point @ d))


def _rim(radius: float, d: np.ndarray) -> np.ndarray:
    """(2,) [m] of a circle about z."""
    length = float(np.linalg.norm(d[:2]))
    return np.asarray(-radius * d[:2] / length) if length > 0.0 else np.zeros(2)


def _lowest_of_capsule(shape: coal.Capsule, d: np.ndarray) -> np.ndarray:
    end = np.array([0.0, 0.0, -shape.halfLength * np.sign(d[2])])
    return np.asarray(end - shape.radius * d)


def _lowest_of_ellipsoid(shape: coal.Ellipsoid, d: np.ndarray) -> np.ndarray:
    scaled = np.array(shape.radii) * d
    return np.asarray(-np.array(shape.radii) * scaled / np.linalg.norm(scaled))


_LOWEST: Mapping[type, Callable[..., np.ndarray]] = {
    coal.Sphere: lambda shape, d: -shape.radius * d,
    coal.Capsule: _lowest_of_capsule,
    coal.Cylinder: _lowest_of_cylinder,
    coal.Cone: _lowest_of_cone,
    coal.Box: lambda shape, d: -np.array(shape.halfSide) * np.sign(d),
    coal.Ellipsoid: _lowest_of_ellipsoid,
}
