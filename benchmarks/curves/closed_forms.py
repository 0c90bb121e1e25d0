"""Distances of scenes of spheres and capsules in closed form, and the exact Hessian of their
collision cost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
import pinocchio as pin

from curves.capsules import Capsule, capsule_of
from curves.segments import segment_distance, symbolic_segment_distance
from uvms_ocp.planning.distances import NearPairs, no_near_pairs
from uvms_ocp.planning.path_cost import CostWeights
from uvms_ocp.planning.planned_axes import Coordinates
from uvms_ocp.planning.scene import CollisionScene
from uvms_ocp.robot.symbolic_bodies import SymbolicPose
from uvms_ocp.robot.symbolic_model import SymbolicModel
from uvms_ocp.types import Array, Indices


@dataclass(frozen=True, slots=True, eq=False)
class ClosedFormDistances:
    """Distances of a scene whose shapes are all spheres or capsules; equal to coal's, all samples
    at once.

    Raises:
        InvalidInput: a shape without closed form.
    """

    scene: CollisionScene
    _ends: ca.Function = field(init=False, repr=False)
    _radii: Array = field(init=False, repr=False)
    _data: pin.Data = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_ends", segment_ends(self.scene))
        object.__setattr__(self, "_radii", _pair_radii(self.scene))
        object.__setattr__(self, "_data", self.scene.coordinates.robot.model.createData())

    def distances(self, x: Array) -> Array:
        """(n, n_pairs) [m] signed distances at x (n, n_axes)."""
        axis_distance = segment_distance(*self._segments(x)).distance
        return axis_distance.reshape(len(x), -1) - self._radii.sum(axis=1)

    def near(self, x: Array, thresholds: Array) -> NearPairs:
        """The pairs closer than their thresholds (n_pairs,) [m] at x (n, n_axes), as
        ``CoalDistances.near``.
        """
        ends = self._segments(x)
        witness = segment_distance(*ends)
        distance = witness.distance.reshape(len(x), -1) - self._radii.sum(axis=1)
        sample, pair = np.nonzero(distance < thresholds)
        if not sample.size:
            return no_near_pairs(self.scene.fold)
        row = sample * self.scene.n_pairs + pair
        normal = witness.normal[row]
        screws = self._screws(x, sample)
        wrench = np.concatenate([normal, np.cross(witness.first[row], normal)], axis=1)
        slope = (wrench[:, None, :] @ screws)[:, 0] * self.scene.moved[pair]
        return NearPairs(
            sample=sample,
            pair=pair,
            distance=distance[sample, pair],
            gradient=slope @ self.scene.fold,
            screws=screws,
            centre=0.5 * (ends[2][row] + ends[3][row]),
        )

    def _segments(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """End points (n n_pairs, 3) of the first and of the second segment of each pair."""
        ends = _mapped(self._ends, x).reshape(len(x), -1, 2, 3)
        first = ends[:, [pair.first for pair in self.scene.pairs]].reshape(-1, 2, 3)
        second = ends[:, [pair.second for pair in self.scene.pairs]].reshape(-1, 2, 3)
        return first[:, 0], first[:, 1], second[:, 0], second[:, 1]

    def _screws(self, x: Array, sample: Indices) -> Array:
        model = self.scene.coordinates.robot.model
        samples = np.unique(sample)
        q = self.scene.coordinates.configurations(x[samples])
        jacobians = [pin.computeJointJacobians(model, self._data, row).copy() for row in q]
        screws: Array = np.array(jacobians) @ self.scene.coordinates.column_map(x[samples])
        return screws[np.searchsorted(samples, sample)]


def symbolic_configuration(planned: Coordinates, x: ca.SX) -> ca.SX:
    """(n_q,) expression of the configuration at x (n_axes,), as `Coordinates.configurations` has it
    in numbers.
    """
    robot = planned.robot
    full = ca.SX(ca.DM(planned.reference))
    full[planned.planned.tolist()] = x
    vehicle = full[: robot.n_vehicle]
    joints = ca.vertsplit(full[robot.n_vehicle :])
    if robot.n_vehicle:
        cr, cp, cy = ca.vertsplit(ca.cos(full[3:6] / 2.0))
        sr, sp, sy = ca.vertsplit(ca.sin(full[3:6] / 2.0))
        xyz = (
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
        vehicle = ca.vertcat(full[:3], *xyz, cr * cp * cy + sr * sp * sy)
    parts = []
    for joint, q in zip(robot.joints, joints, strict=True):
        if joint.endless:
            parts.append(ca.vertcat(ca.cos(q), ca.sin(q)))
        else:
            parts.append(q)
    return ca.vertcat(vehicle, *parts)


def segment_ends(scene: CollisionScene) -> ca.Function:
    """Function ``x (n_axes) -> ends (6 n_shapes)``: both end points in W of every shape's
    segment.
    """
    x = ca.SX.sym("x", scene.coordinates.n_axes)
    symbolic = SymbolicModel(scene.coordinates.robot.model)
    poses = symbolic.forward_kinematics(symbolic_configuration(scene.coordinates, x)).joint_poses
    ends = ca.densify(ca.vertcat(*_ends_at(scene, poses)))
    return ca.Function("segment_ends", [x], [ends], {"cse": True})


def collision_density(scene: CollisionScene, weights: CostWeights) -> ca.Function:
    """Function ``x, v -> cost``: the collision cost per second at one sample, the integrand of l2
    Jc.

    Twice differentiable by CasADi; its Hessian is exact, and not positive semi-definite in general.
    """
    n = scene.coordinates.n_axes
    x = ca.SX.sym("x", n)
    v = ca.SX.sym("v", n)
    symbolic = SymbolicModel(scene.coordinates.robot.model)
    poses = symbolic.forward_kinematics(symbolic_configuration(scene.coordinates, x)).joint_poses
    ends = _ends_at(scene, poses)
    spins = [0.5 * ca.sumsqr(ca.jtimes(ca.vec(pose.R), x, v)) for pose in poses]
    radii = _pair_radii(scene).sum(axis=1)
    widths = np.minimum(weights.clearance, scene.room)
    cost = ca.SX(0)
    for k, pair in enumerate(scene.pairs):
        a, b = ends[pair.first], ends[pair.second]
        distance = symbolic_segment_distance(a[:3], a[3:], b[:3], b[3:]) - radii[k]
        drift = ca.sumsqr(ca.jtimes(0.5 * (b[:3] + b[3:]), x, v))
        speed = ca.sqrt(
            drift + scene.gyration[k] ** 2 * spins[pair.second_joint] + weights.speed_floor**2
        )
        cost += _penalty(1.0 - distance / widths[k]) * speed
    return ca.Function(
        "collision_density", [x, v], [weights.collision * cost], ["x", "v"], ["cost"], {"cse": True}
    )


def density_hessian(density: ca.Function) -> ca.Function:
    """Function ``[x; v] -> exact Hessian (2 n_axes, 2 n_axes), gradient (2 n_axes)`` of a collision
    density.
    """
    n = density.numel_in(0)
    z = ca.SX.sym("z", 2 * n)
    hessian, gradient = ca.hessian(density(z[:n], z[n:]), z)
    return ca.Function(
        "density_hessian", [z], [ca.densify(hessian), ca.densify(gradient)], {"cse": True}
    )


def _pair_radii(scene: CollisionScene) -> Array:
    capsules = _capsules(scene)
    rows = [(capsules[pair.first].radius, capsules[pair.second].radius) for pair in scene.pairs]
    return np.array(rows).reshape(-1, 2)


def _capsules(scene: CollisionScene) -> list[Capsule]:
    return [capsule_of(item.geometry) for item in scene.geometry.geometryObjects]


def _ends_at(scene: CollisionScene, poses: Sequence[SymbolicPose]) -> list[ca.SX]:
    result = []
    for item, capsule in zip(scene.geometry.geometryObjects, _capsules(scene), strict=True):
        pose = poses[item.parentJoint]
        X = item.placement
        half = capsule.half_length * X.rotation[:, 2]
        low = ca.DM(X.translation - half)
        high = ca.DM(X.translation + half)
        result.append(ca.vertcat(pose.p + pose.R @ low, pose.p + pose.R @ high))
    return result


def _mapped(function: ca.Function, x: Array) -> Array:
    """(n, size) of the function at every row of x, without CasADi's conversions."""
    buffer, run = function.buffer()
    argument = np.empty(x.shape[1])
    result = np.empty(function.numel_out(0))
    buffer.set_arg(0, argument.data)
    buffer.set_res(0, result.data)
    rows = np.empty((len(x), result.size))
    for i, row in enumerate(x):
        argument[:] = row
        run()
        rows[i] = result
    return rows


def _penalty(y: ca.SX) -> ca.SX:
    """`uvms_ocp.planning.path_cost.penalty` as an expression."""
    inside = ca.fmin(ca.fmax(y, 0.0), 1.0)
    beyond = ca.fmax(y - 1.0, 0.0)
    return inside**3 / 6.0 + beyond * (0.5 + 0.5 * beyond)
