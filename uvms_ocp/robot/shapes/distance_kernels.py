"""Signed distances of all pairs of spheres, capsules, cylinders and boxes in machine code; coal is
their oracle.

A layout that is to measure distances has a field ``DistanceMemory``; what `structure_of` needs for
it are the dimensions `with_distances` and `places_function`, and `CollisionModel.write` writes into
it what never changes. Then, in a kernel of one's own:

    chosen_distances(m.distances, m.q)          # m.distances.value[k] [m] of the chosen pairs, at q
    value = distance_of(m.distances, k)         # of one pair, after `place_solids(m.distances, m.q)`
    bound = distance_lower_bound(m.distances, k)      # no more than that, by what was found last: ten times as fast
    pair_gradient(m.distances, k, row)          # (n_v,) rate of the distance of the pair measured last, per unit of velocity

Bounded: a pair takes at most `ROUNDS` differences of its solids, and where they overlap `GROWTH`
more, and `ROUNDS` for each look at how they part.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Annotated, Any

import casadi as ca
import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.codegen.kernel_layout import FunctionField, Layout, Sized, Vector, zeros
from uvms_ocp.robot import spatial, symbolic_bodies, symbolic_joints, symbolic_model
from uvms_ocp.robot.dimensions import Dimensions
from uvms_ocp.robot.shapes import gjk
from uvms_ocp.robot.shapes.penetration import Polytope, expand_polytope, try_axes, try_axis
from uvms_ocp.robot.shapes.shape_pairs import shapes_in

_SHIFT = 1e-3  # [m] that overlapping solids are taken apart by, for their nearest points
_POLISH = 3  # separations of solids whose direction a polytope gives to 1e-7 m only
_NOTHING = 1e-5
"""[-, m] Rate of an axis that does not change a distance, but for what a search that ends leaves: a
hierarchy would heed it.
"""
_STEP = 8  # sizes are multiples of it, so that models of about the same size share machine code


def measure_solids(
    m: gjk.RelativePlacement, polytope: Polytope, a: gjk.Solid, b: gjk.Solid
) -> None:
    """Measure distance, normal and nearest point of A, balls included, in the frame of A. A kernel."""
    gjk.place_relative(m, a, b)
    if not gjk.search_apart(m, a, b):
        overlap_solids(m, polytope, a, b)
    m.distance -= a.ball + b.ball
    for i in range(3):
        m.at[i] += a.ball * m.normal[i]


def overlap_solids(
    m: gjk.RelativePlacement, polytope: Polytope, a: gjk.Solid, b: gjk.Solid
) -> None:
    """Find the shallowest direction, and the points that part last along it. A kernel."""
    try_axes(m, a, b)
    if is_curved(a, b):
        expand_polytope(polytope, m, a, b)
    for _ in range(_POLISH if is_curved(a, b) else 1):
        separate_solids(m, a, b)


def is_curved(a: gjk.Solid, b: gjk.Solid) -> bool:
    """Check for faces of the difference that `axes` does not cover. A kernel."""
    return (a.disk > 0.0 and not is_ball(b)) or (b.disk > 0.0 and not is_ball(a))


def is_ball(s: gjk.Solid) -> bool:
    """Check that a solid is nothing but its ball. A kernel."""
    return s.disk == 0.0 and s.half[0] == 0.0 and s.half[1] == 0.0 and s.half[2] == 0.0


def separate_solids(m: gjk.RelativePlacement, a: gjk.Solid, b: gjk.Solid) -> None:
    """Take B away from A along the normal; what is nearest then parts last, and tells the direction
    again. A kernel.
    """
    p = zeros(3)
    n = zeros(3)
    distance = m.distance
    for i in range(3):
        p[i] = m.p[i]
        n[i] = m.normal[i]
        m.p[i] += (_SHIFT - distance) * n[i]
    gjk.search_apart(m, a, b)
    m.p[:] = p
    p[:3] = m.normal[:3]
    m.normal[:] = n
    m.distance = distance
    try_axis(m, a, b, p)


class SolidPair(Layout):
    """Two solids, and what was found of them last."""

    first: int
    """Solid, by its index."""
    second: int
    """Solid, by its index."""
    known: bool
    """True where the distance of the pair has been measured."""
    normal: Annotated[Vector, Sized(3)]
    """(3,) in W, from the first to the second."""
    at: Annotated[Vector, Sized(3)]
    """(3,) [m] in W, the nearest point of the first."""


class DistanceMemory(Layout):
    """Solids of a robot and its obstacles, and their pairs."""

    places: FunctionField
    """q -> placements of all joints and twists of all axes."""
    placements: Annotated[Vector, Sized("n_placements")]
    """(12 n_joints,) R_WJ, row after row, and p_WJ [m] of each joint."""
    twists: Annotated[Vector, Sized("n_twists")]
    """(6 n_axes,) twists of the axes of each joint at the origin of W: linear [m, or 1], angular
    [1].
    """
    axes: Annotated[list[int], Sized("n_axes")]
    """(n_axes,) velocity that turns or shifts each axis; the same for joints that mimic others."""
    n_solids: int
    """Number of solids that are used."""
    solids: Annotated[list[gjk.Solid], Sized("n_solids")]
    """(n_solids,) convex shapes of links and obstacles."""
    moves: Annotated[list[list[int]], Sized("n_solids", "n_axes")]
    """(n_solids, n_axes) 1 where the axis moves the solid, else 0."""
    n_pairs: int
    """Number of pairs that are used."""
    pairs: Annotated[list[SolidPair], Sized("n_pairs")]
    """(n_pairs,) pairs of solids, by index."""
    value: Annotated[Vector, Sized("n_pairs")]
    """(n_pairs,) [m] signed distances as measured last."""
    gradient: Annotated[list[Vector], Sized("n_pairs", "n_v")]
    """(n_pairs, n_v) [-, m] rates of the chosen distances per unit of each velocity, one after the
    other.
    """
    n_chosen: int
    """Number of pairs that are chosen."""
    chosen: Annotated[list[int], Sized("n_pairs")]
    """(n_chosen,) pairs that `chosen_distances` measures."""
    meeting: gjk.RelativePlacement
    """Relative placement of the pair measured last, in the frame of its first solid."""
    polytope: Polytope
    """Working memory of `expand_polytope`."""


def chosen_distances(distances: DistanceMemory, q: Vector) -> None:
    """Measure the `value` of the chosen pairs, at their places, at q (n_q,) [m, rad]. A kernel."""
    place_solids(distances, q)
    for k in range(distances.n_chosen):
        distances.value[distances.chosen[k]] = distance_of(distances, distances.chosen[k])


def chosen_gradients(distances: DistanceMemory) -> None:
    """Compute the `gradient` of the chosen pairs, where they were measured last. A kernel."""
    for k in range(distances.n_chosen):
        pair_gradient(distances, distances.chosen[k], distances.gradient[k])


def place_solids(distances: DistanceMemory, q: Vector) -> None:
    """Place joints, axes and solids at q (n_q,) [m, rad]. A kernel."""
    distances.places(q, distances.placements, distances.twists)
    for k in range(distances.n_solids):
        if distances.solids[k].joint >= 0:
            place_solid(distances.solids[k], distances.placements)


def place_solid(s: gjk.Solid, placements: Vector) -> None:
    """Place a solid that a joint carries. A kernel."""
    R = zeros(9)
    p = zeros(3)
    first = 12 * s.joint
    for i in range(9):
        R[i] = placements[first + i]
    gjk.rotate(R, s.p_JS, p)
    for i in range(3):
        s.p[i] = placements[first + 9 + i] + p[i]
        for j in range(3):
            s.R[3 * i + j] = (
                R[3 * i] * s.R_JS[j] + R[3 * i + 1] * s.R_JS[3 + j] + R[3 * i + 2] * s.R_JS[6 + j]
            )


def distance_of(distances: DistanceMemory, k: int) -> float:
    """Measure the signed distance [m] of pair k, as its solids are placed. A kernel."""
    pair = distances.pairs[k]
    meeting = distances.meeting
    a, b = distances.solids[pair.first], distances.solids[pair.second]
    measure_solids(meeting, distances.polytope, a, b)
    gjk.rotate(a.R, meeting.normal, pair.normal)
    gjk.rotate(a.R, meeting.at, pair.at)
    for i in range(3):
        pair.at[i] += a.p[i]
    pair.known = True
    return meeting.distance


def distance_lower_bound(distances: DistanceMemory, k: int) -> float:
    """Bound the distance [m] of pair k from below: along the direction of the last measurement, or by
    the balls around. A kernel.
    """
    pair = distances.pairs[k]
    way = zeros(3)
    turned = zeros(3)
    a, b = distances.solids[pair.first], distances.solids[pair.second]
    gjk.subtract(b.p, a.p, way)
    bound = math.sqrt(gjk.dot(way, way)) - a.size - b.size
    if pair.known:
        gjk.rotate_back(a.R, pair.normal, turned)
        along = gjk.dot(pair.normal, way) - gjk.support_function(a, turned) - a.ball
        gjk.rotate_back(b.R, pair.normal, turned)
        bound = max(bound, along - gjk.support_function(b, turned) - b.ball)
    return bound


def pair_gradient(distances: DistanceMemory, k: int, row: Vector) -> None:
    """Compute the rate (n_v,) [-, m] of the distance of pair k per unit of each velocity, where it
    was measured last. A kernel.
    """
    pair = distances.pairs[k]
    moment = zeros(3)
    n_v = len(distances.gradient[0])
    n, x = pair.normal, pair.at
    gjk.cross(x, n, moment)
    for i in range(n_v):
        row[i] = 0.0
    for k_axis in range(len(distances.axes)):
        sign = distances.moves[pair.second][k_axis] - distances.moves[pair.first][k_axis]
        i = distances.axes[k_axis]
        for c in range(3):
            row[i] += sign * (
                n[c] * distances.twists[6 * k_axis + c]
                + moment[c] * distances.twists[6 * k_axis + 3 + c]
            )
    for i in range(n_v):
        if abs(row[i]) < _NOTHING:
            row[i] = 0.0


def has_kernel(shape: coal.CollisionGeometry) -> bool:
    """Check for a shape with a form in C: a sphere, a capsule, a cylinder or a box."""
    return isinstance(shape, (coal.Sphere, coal.Capsule, coal.Cylinder, coal.Box))


def with_distances(
    dimensions: Dimensions, model: pin.Model, *, n_solids: int, n_pairs: int
) -> Dimensions:
    """Return the dimensions with those of a `DistanceMemory` of at most that many solids and pairs."""
    places = places_function(model)
    return replace(
        dimensions,
        n_v=model.nv,
        n_placements=max(1, places.numel_out(0)),
        n_axes=max(1, places.numel_out(1) // 6),
        n_solids=-(-n_solids // _STEP) * _STEP,
        n_pairs=-(-n_pairs // _STEP) * _STEP,
    )


def write_distances(
    memory: DistanceMemory,
    model: pin.Model,
    shapes: Sequence[pin.GeometryObject],
    pairs: Sequence[tuple[int, int]],
) -> None:
    """Write pairs of shapes, by index, into a `DistanceMemory`; shapes that are used have a form in
    C.
    """
    used = sorted(shapes_in(pairs))
    places = {shape: solid for solid, shape in enumerate(used)}
    memory.n_solids = len(used)
    memory.n_pairs = len(pairs)
    axes = list[int]()  # of what mimics, its leader's
    joint_of_axis = list[int]()
    for index, joint in enumerate(model.joints):
        if index > 0:
            axes += range(joint.idx_v, joint.idx_v + joint.nvExtended)
            joint_of_axis += [index] * joint.nvExtended
    memory.axes[:] = axes
    for shape, solid in places.items():
        _write_solid(memory.solids[solid], shapes[shape])
        carriers = list(model.supports[shapes[shape].parentJoint])
        memory.moves[solid][:] = [int(joint in carriers) for joint in joint_of_axis]
    for pair, (first, second) in zip(memory.pairs, pairs, strict=False):
        pair.first = places[first]
        pair.second = places[second]
        pair.known = False


def _write_solid(solid: gjk.Solid, shape: pin.GeometryObject) -> None:
    """Write a shape in the frame of its joint; one of the world is placed by it already."""
    half, disk, ball = _sums(shape.geometry)
    solid.half[:] = half
    solid.disk = disk
    solid.ball = ball
    solid.size = float(np.hypot(np.hypot(half[0], half[1]) + disk, half[2])) + ball
    solid.joint = int(shape.parentJoint) - 1
    R = shape.placement.rotation.ravel().tolist()
    p = shape.placement.translation.tolist()
    solid.R_JS[:] = R
    solid.p_JS[:] = p
    solid.R[:] = R
    solid.p[:] = p


def _sums(shape: Any) -> tuple[list[float], float, float]:
    """Return the half sides of a box, the radius of a disk and the radius of a ball [m] whose sum a
    shape is.
    """
    swept = float(shape.getSweptSphereRadius())
    if isinstance(shape, coal.Box):
        return np.asarray(shape.halfSide).tolist(), 0.0, swept
    if isinstance(shape, coal.Sphere):
        return [0.0, 0.0, 0.0], 0.0, shape.radius + swept
    if isinstance(shape, coal.Capsule):
        return [0.0, 0.0, shape.halfLength], 0.0, shape.radius + swept
    return [0.0, 0.0, shape.halfLength], shape.radius, swept


@lru_cache(maxsize=8)
def places_function(model: pin.Model) -> ca.Function:
    """Build ``q -> placements`` of joints, row after row, ``twists`` of axes at the origin of W,
    column after column.
    """
    q = ca.SX.sym("q", model.nq)
    symbolic = symbolic_model.SymbolicModel(model)
    poses = symbolic.forward_kinematics(q).joint_poses[1:]
    placements = [ca.vertcat(ca.vec(ca.densify(pose.R).T), pose.p) for pose in poses]
    twists = [_twists(joint, pose) for joint, pose in zip(symbolic.joints, poses, strict=True)]
    outputs = {
        "placements": ca.vertcat(*placements),
        "twists": ca.vec(ca.densify(ca.horzcat(*twists))),
    }
    return symbolic_model.function("places", {"q": q}, outputs)


def _twists(joint: symbolic_joints.SymbolicJoint, pose: symbolic_bodies.SymbolicPose) -> ca.SX:
    """Return twists (6, n) of a joint's axes at unit speed, linear rows first."""
    angular = pose.R @ joint.S_angular
    return ca.vertcat(pose.R @ joint.S_linear + spatial.skew(pose.p) @ angular, angular)
