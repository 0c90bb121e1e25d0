"""Signed distances by coal that know the inside of closed triangle meshes.

To coal a mesh is a surface: what is wholly inside it is as far as from outside, and what crosses it
is pushed to whichever side is nearer. Here a mesh whose triangles close is a solid. Depth is the
way out through the place of the surface that is nearest: of what is inside, or crosses, its deepest
point along the normal there. An open mesh, such as a patch of seafloor, stays a surface.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.robot.shapes.closed_mesh import Solid, closed_solid, mesh_triangles

_BESIDE = 1e-6  # [m] from a surface to where it is asked which side is inside
_UNIT = 1e-6  # by which the length of a normal that coal has set may differ from 1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PairContact:
    """Nearest points of two shapes, or the deepest ones of an overlap."""

    distance: float
    """Signed distance [m]."""
    normal: np.ndarray
    """Unit vector (3,) in W from the first shape to the second; zero where there is none."""
    first: np.ndarray
    """Point (3,) [m] in W on the first shape."""
    second: np.ndarray
    """Point (3,) [m] in W on the second shape."""


class SignedDistances:
    """Pairs of a geometry model, whose closed meshes are solids."""

    def __init__(self, geometry: pin.GeometryModel) -> None:
        self._geometry = geometry
        pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
        indices = set(chain.from_iterable(pairs))
        bodies = {k: Body(geometry.geometryObjects[k].geometry) for k in indices}
        self._bodies = bodies
        self._has_mesh = [bodies[a].is_mesh or bodies[b].is_mesh for a, b in pairs]
        self._pairs = pairs

    def distance(self, data: pin.GeometryData, pair: int) -> float:
        """Return the distance [m] of a pair, with the shapes placed as in the data; see `coal` for
        what it fails at.
        """
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
    names = list[str]()
    for item in geometry.geometryObjects:
        body = Body(item.geometry)
        if body.is_mesh and body.solid is None:
            names.append(item.name)
    return tuple(names)


def signed_contact(
    bodies: tuple[Body, Body], places: tuple[pin.SE3, pin.SE3], result: coal.DistanceResult
) -> PairContact:
    """Find the contact of two bodies at their places, of which coal has found that of the
    surfaces.
    """
    contact = _by_coal(result)
    points = (contact.first, contact.second)
    if contact.distance > 0.0:
        for inner in (1, 0):
            outer = 1 - inner
            solid = bodies[outer].solid
            if solid is not None and solid.holds(places[outer].actInv(points[inner])):
                way = points[outer] - points[inner]
                out = way / np.linalg.norm(way)
                on_face = solid.has_face(
                    places[outer].actInv(points[outer]), places[outer].rotation.T @ out
                )
                return _way_out(points[outer], out, bodies[inner], places[inner], inner, on_face)
        return contact
    if bodies[0].is_mesh and bodies[1].is_mesh:
        return _crossing_meshes(bodies, places, contact)
    mesh = 0 if bodies[0].is_mesh else 1
    primitive = 1 - mesh
    solid = bodies[mesh].solid
    if solid is None:
        return contact
    surface = points[mesh]
    out = contact.normal if mesh == 0 else -contact.normal
    if solid.holds(places[mesh].actInv(surface + _BESIDE * out)):
        out = -out
        on_face = solid.has_face(places[mesh].actInv(surface), places[mesh].rotation.T @ out)
        return _way_out(surface, out, bodies[primitive], places[primitive], primitive, on_face)
    return contact


def _by_coal(result: coal.DistanceResult) -> PairContact:
    """Return the contact of coal, with a normal by the nearest points where coal leaves it unset,
    as it does for two meshes.
    """
    first = np.array(result.getNearestPoint1())
    second = np.array(result.getNearestPoint2())
    normal = np.array(result.normal)
    if not abs(np.linalg.norm(normal) - 1.0) < _UNIT:
        way = second - first
        length = float(np.linalg.norm(way))
        normal = np.zeros(3)
        if length > 0.0:
            normal = way / length
    return PairContact(
        distance=float(result.min_distance), normal=normal, first=first, second=second
    )


def _way_out(
    surface: np.ndarray, out: np.ndarray, body: Body, place: pin.SE3, inner: int, on_face: bool
) -> PairContact:
    """Return the contact of a body that is to leave a solid along `out` (3,) at a point of its
    surface (3,) [m]; inner: whether it is the first (0) or the second (1) of the pair.

    The points are opposite each other, so that either is the place of the force: the deepest point
    of the body and its foot where `out` is normal to a face there, on_face, or else the point of the
    surface and its foot in the plane that leaves last, as `out` then turns with the body.
    """
    deepest = place.act(body.lowest(place.rotation.T @ out))
    depth = max(float(out @ (surface - deepest)), 0.0)
    if on_face:
        return _overlap(depth, deepest + depth * out, out, deepest, inner)
    return _overlap(depth, surface, out, surface - depth * out, inner)


def _overlap(
    depth: float, surface: np.ndarray, out: np.ndarray, deepest: np.ndarray, inner: int
) -> PairContact:
    """Return the contact at a depth [m] of the deepest point (3,) of the body `inner` below the
    surface (3,) of the other, along `out` (3,).
    """
    if inner == 1:
        return PairContact(distance=-depth, normal=out, first=surface, second=deepest)
    return PairContact(distance=-depth, normal=-out, first=deepest, second=surface)


def _crossing_meshes(
    bodies: tuple[Body, Body], places: tuple[pin.SE3, pin.SE3], contact: PairContact
) -> PairContact:
    """Return the contact by the vertex of either that is deepest in the other; without one they
    touch.
    """
    deepest = contact
    for inner in (1, 0):
        outer = 1 - inner
        solid = bodies[outer].solid
        if solid is None:
            continue
        X = places[outer].actInv(places[inner])
        vertices = bodies[inner].vertices @ X.rotation.T + X.translation
        for point in vertices[solid.inside(vertices)]:
            nearest = solid.nearest(point)
            depth = float(np.linalg.norm(nearest - point))
            if depth <= max(-deepest.distance, 0.0):
                continue
            surface = places[outer].act(nearest)
            vertex = places[outer].act(point)
            out = (surface - vertex) / depth
            deepest = _overlap(depth, surface, out, vertex, inner)
    return deepest


class Body:
    """A shape, in its own frame."""

    def __init__(self, shape: coal.CollisionGeometry) -> None:
        self._shape = shape
        self.is_mesh = isinstance(shape, coal.BVHModelBase)

    @cached_property
    def vertices(self) -> np.ndarray:
        """Vertices (n, 3) [m] of a mesh or a polytope."""
        if self.is_mesh:
            return np.array(self._shape.vertices(), dtype=float).reshape(-1, 3)
        return np.array(self._shape.points(), dtype=float).reshape(-1, 3)

    @cached_property
    def solid(self) -> Solid | None:
        """The solid inside a closed mesh; `None` for an open one."""
        if not self.is_mesh:
            return None
        triangles = np.array(mesh_triangles(self._shape), dtype=int).reshape(-1, 3)
        return closed_solid(self.vertices, triangles)

    def lowest(self, direction: np.ndarray) -> np.ndarray:
        """Return the point (3,) [m] of it that is least along a direction (3,); its origin, where
        its form is not known here or has no end.
        """
        for kind, point in _LOWEST.items():
            if isinstance(self._shape, kind):
                return np.asarray(point(self._shape, direction))
        if self.is_mesh or isinstance(self._shape, coal.ConvexBase):
            return np.asarray(self.vertices[int(np.argmin(self.vertices @ direction))])
        return np.zeros(3)


def _lowest_of_cylinder(shape: coal.Cylinder, d: np.ndarray) -> np.ndarray:
    return np.append(_rim(shape.radius, d), -shape.halfLength * np.sign(d[2]))


def _lowest_of_cone(shape: coal.Cone, d: np.ndarray) -> np.ndarray:
    top = np.array([0.0, 0.0, shape.halfLength])
    foot = np.append(_rim(shape.radius, d), -shape.halfLength)
    return min((top, foot), key=lambda point: float(point @ d))


def _rim(radius: float, d: np.ndarray) -> np.ndarray:
    """Return the point (2,) [m] of a circle about z that is least along d (3,)."""
    length = float(np.linalg.norm(d[:2]))
    if not length > 0.0:
        return np.zeros(2)
    return np.asarray(-radius * d[:2] / length)


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
