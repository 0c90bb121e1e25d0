"""Which shapes have a form in C, and a memory of their pairs that kernels work on."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import coal
import numpy as np
import pinocchio as pin

from uvms_ocp.model.shapes.distance_kernels.solids import Solid
from uvms_ocp.model.spatial import skew
from uvms_ocp.model.symbolic.bodies import Pose
from uvms_ocp.model.symbolic.joint_types import SymbolicJoint
from uvms_ocp.model.symbolic.tree import SymbolicModel, function

_STEP = 8  # sizes are multiples of it, so that models of about the same size share machine code


def has_c_form(shape: coal.CollisionGeometry) -> bool:
    """Whether it is a sphere, a capsule, a cylinder or a box."""
    return isinstance(shape, (coal.Sphere, coal.Capsule, coal.Cylinder, coal.Box))


def distance_sizes(model: pin.Model, *, n_solids: int, n_pairs: int) -> dict[str, Any]:
    """What `structure_of` a layout with a `DistanceMemory` needs for that many solids and pairs [-], or fewer."""
    places = _places(model)
    return {
        "places": places,
        "n_placements": max(1, places.numel_out(0)),
        "n_twists": max(1, places.numel_out(1)),
        "n_v": model.nv,
        "n_solids": -(-n_solids // _STEP) * _STEP,
        "n_pairs": -(-n_pairs // _STEP) * _STEP,
    }


def write_distances(
    memory: Any, model: pin.Model, shapes: Sequence[pin.GeometryObject], pairs: Sequence[tuple[int, int]]
) -> None:
    """Into a `DistanceMemory`: pairs of the shapes, by index, which have a form in C as far as they are used."""
    used = sorted({k for pair in pairs for k in pair})
    places = {k: i for i, k in enumerate(used)}
    memory.n_solids, memory.n_pairs = len(used), len(pairs)
    for k, i in places.items():
        _write_solid(memory.solids[i], shapes[k])
        memory.moves[i][:] = _movers(model, shapes[k].parentJoint)
    for pair, (first, second) in zip(memory.pairs, pairs, strict=False):
        pair.first, pair.second, pair.known = places[first], places[second], False


def _write_solid(solid: Solid, shape: pin.GeometryObject) -> None:
    half, disk, ball = _sums(shape.geometry)
    solid.half[:], solid.disk, solid.ball = half, disk, ball
    solid.size = float(np.hypot(np.hypot(half[0], half[1]) + disk, half[2])) + ball
    solid.joint = int(shape.parentJoint) - 1
    R, p = shape.placement.rotation.ravel().tolist(), shape.placement.translation.tolist()
    solid.R_JS[:], solid.p_JS[:], solid.R[:], solid.p[:] = R, p, R, p


def _sums(shape: Any) -> tuple[list[float], float, float]:
    """Half sides of a box, radius of a disk, radius of a ball [m]."""
    swept = float(shape.getSweptSphereRadius())
    if isinstance(shape, coal.Box):
        return np.asarray(shape.halfSide).tolist(), 0.0, swept
    if isinstance(shape, coal.Sphere):
        return [0.0, 0.0, 0.0], 0.0, shape.radius + swept
    if isinstance(shape, coal.Capsule):
        return [0.0, 0.0, shape.halfLength], 0.0, shape.radius + swept
    return [0.0, 0.0, shape.halfLength], shape.radius, swept


def _movers(model: pin.Model, joint: int) -> list[int]:
    """(n_v,) 1 for axes that move a joint's body, 0 for others."""
    found = [0] * model.nv
    for index in model.supports[joint]:
        if index:
            first = model.joints[index].idx_v
            found[first : first + model.joints[index].nv] = [1] * model.joints[index].nv
    return found


@lru_cache(maxsize=8)
def _places(model: pin.Model) -> ca.Function:
    """q -> placements of joints, row after row, and twists of axes at the origin of W, column after column."""
    q, symbolic = ca.SX.sym("q", model.nq), SymbolicModel(model)
    poses = symbolic.forward_kinematics(q).joint_poses[1:]
    placements = [ca.vertcat(ca.vec(ca.densify(pose.R).T), pose.p) for pose in poses]
    twists = [_twists(joint, pose) for joint, pose in zip(symbolic.joints, poses, strict=True)]
    found = {"placements": ca.vertcat(*placements), "twists": ca.vec(ca.densify(ca.horzcat(*twists)))}
    return function("places", {"q": q}, found)


def _twists(joint: SymbolicJoint, pose: Pose) -> ca.SX:
    """(6, n) of a joint's axes at unit speed."""
    angular = pose.R @ joint.S_angular
    return ca.vertcat(pose.R @ joint.S_linear + skew(pose.p) @ angular, angular)
