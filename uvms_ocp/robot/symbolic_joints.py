"""Joints of a Pinocchio model as CasADi expressions: poses across them, and steps on their
manifolds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import spatial
from uvms_ocp.robot.symbolic_bodies import sparse


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SymbolicJoint:
    """One joint: where it sits in the tree, in q and v, and its constant motion subspace."""

    name: str
    kind: JointKind
    parent: int
    q: slice
    v: slice
    R_PJ: ca.DM
    """Rotation (3, 3) of its fixed frame in the parent body."""
    p_PJ: ca.DM
    """Position (3,) [m] of its fixed frame in the parent body."""
    S: np.ndarray
    """Motion subspace (6, n) in the child body, n being the joint's size in v."""
    S_linear: ca.DM
    """First rows (3, n) of S."""
    S_angular: ca.DM
    """Last rows (3, n) of S."""

    def pose(self, q: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the pose (R, p) of this joint's body in the parent body, from the whole configuration."""
        R, p = self.kind.pose(self.S, q[self.q])
        return self.R_PJ @ R, self.p_PJ + self.R_PJ @ p


@dataclass(frozen=True, kw_only=True, slots=True)
class JointKind:
    """Terms that differ between joint types, as functions of the joint's own part of q and v."""

    pose: Callable[[np.ndarray, ca.SX], tuple[ca.SX, ca.SX]]
    """Function of S (6, n) and q: R (3, 3) and p (3,) [m] of the child body in the joint's fixed
    frame.
    """
    integrate: Callable[[ca.SX, ca.SX], ca.SX]
    """Function of q and v: q after one second of v."""
    difference: Callable[[ca.SX, ca.SX], ca.SX]
    """Function of q0 and q1: the v that moves one to the other in one second."""


def symbolic_joint(model: pin.Model, index: int) -> SymbolicJoint:
    """Read one joint of a model. Raises InvalidInput for a joint type that is not supported."""
    joint = model.joints[index]
    name = model.names[index]
    X_PJ = model.jointPlacements[index]
    S = np.asarray(joint.createData().S, dtype=float).reshape(6, joint.nvExtended)
    if joint.shortname() == "JointModelMimic":
        kind = _following(joint.extract(), S)
    else:
        kind = _kind(joint.shortname(), name)
    return SymbolicJoint(
        name=name,
        kind=kind,
        parent=model.parents[index],
        q=slice(joint.idx_q, joint.idx_q + (joint.nq or 1)),
        v=slice(joint.idx_v, joint.idx_v + joint.nvExtended),
        R_PJ=sparse(X_PJ.rotation),
        p_PJ=sparse(X_PJ.translation),
        S=S,
        S_linear=sparse(S[:3]),
        S_angular=sparse(S[3:]),
    )


def _following(joint: pin.JointModelMimic, S: np.ndarray) -> JointKind:
    """Return the kind of a joint that mimics another one, of one coordinate as it is itself: it
    moves with that one's q and v, and has none.
    """
    leader_kind = REVOLUTE if S[3:].any() else PRISMATIC
    scaling = joint.scaling
    offset = joint.offset
    no_coordinate = ca.SX(0, 1)
    return JointKind(
        pose=lambda S, q: leader_kind.pose(S / scaling, scaling * q + offset),
        integrate=lambda q, v: no_coordinate,
        difference=lambda q0, q1: no_coordinate,
    )


def _kind(shortname: str, joint_name: str) -> JointKind:
    if shortname not in JOINT_KINDS:
        supported = ", ".join(name.removeprefix("JointModel") for name in JOINT_KINDS)
        raise InvalidInput(
            f"joint {joint_name!r} has type {shortname.removeprefix('JointModel')}; supported:"
            f" {supported}"
        )
    return JOINT_KINDS[shortname]


# Free-flyer: q = (p (3), quaternion xyzw (4)), v = body twist (6).


def _free_flyer_pose(S: np.ndarray, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    return spatial.quaternion_to_matrix(q[3:]), q[:3]


def _free_flyer_integrate(q: ca.SX, v: ca.SX) -> ca.SX:
    step = spatial.quaternion_exp(v[3:])
    step *= ca.if_else(
        step[3] < 0, -1, 1
    )  # stay in the hemisphere of the old quaternion, as Pinocchio does
    quaternion = _towards_unit(spatial.quaternion_multiply(q[3:], step))
    return ca.vertcat(
        q[:3] + spatial.quaternion_to_matrix(q[3:]) @ spatial.exp6_translation(v), quaternion
    )


def _free_flyer_difference(q0: ca.SX, q1: ca.SX) -> ca.SX:
    turn: ca.SX = spatial.quaternion_log(
        spatial.quaternion_multiply(spatial.quaternion_conjugate(q0[3:]), q1[3:])
    )
    return ca.vertcat(
        spatial.log6_translation(turn, spatial.quaternion_to_matrix(q0[3:]).T @ (q1[:3] - q0[:3])),
        turn,
    )


def _towards_unit(x: ca.SX) -> ca.SX:
    """Normalise by one Newton step: rounding errors do not accumulate, and nothing is divided."""
    return x * ((3 - ca.sumsqr(x)) / 2)


# Planar: q = (x, y, cos, sin), v = (v_x, v_y in the body, rate).


def _planar_pose(S: np.ndarray, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    rotation = spatial.matrix((q[2], -q[3], 0), (q[3], q[2], 0), (0, 0, 1))
    position = ca.vertcat(q[0], q[1], ca.SX(1, 1))
    return rotation, position


def _planar_integrate(q: ca.SX, v: ca.SX) -> ca.SX:
    x, y, c, s = ca.vertsplit(q)
    step = spatial.exp6_translation(ca.vertcat(v[0], v[1], 0, 0, 0, v[2]))
    moved_x = x + c * step[0] - s * step[1]
    moved_y = y + s * step[0] + c * step[1]
    return ca.vertcat(moved_x, moved_y, _circle_integrate(q[2:], v[2]))


def _planar_difference(q0: ca.SX, q1: ca.SX) -> ca.SX:
    _, _, c, s = ca.vertsplit(q0)
    d = q1[:2] - q0[:2]
    angle = _circle_difference(q0[2:], q1[2:])
    in_body = ca.vertcat(c * d[0] + s * d[1], c * d[1] - s * d[0], 0)
    turn = ca.vertcat(0, 0, angle)
    translation = spatial.log6_translation(turn, in_body)
    return ca.vertcat(translation[:2], angle)


# Unbounded revolute: q = (cos, sin).


def _circle_pose(S: np.ndarray, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    return _rotation_about(S[3:, 0], q[0], q[1]), ca.SX(3, 1)


def _circle_integrate(q: ca.SX, v: ca.SX) -> ca.SX:
    c = ca.cos(v)
    s = ca.sin(v)
    return _towards_unit(ca.vertcat(q[0] * c - q[1] * s, q[1] * c + q[0] * s))


def _circle_difference(q0: ca.SX, q1: ca.SX) -> ca.SX:
    return ca.atan2(q0[0] * q1[1] - q0[1] * q1[0], q0[0] * q1[0] + q0[1] * q1[1])


# One coordinate.


def _revolute_pose(S: np.ndarray, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    return _rotation_about(S[3:, 0], ca.cos(q), ca.sin(q)), ca.SX(3, 1)


def _rotation_about(axis: np.ndarray, c: ca.SX, s: ca.SX) -> ca.SX:
    """Evaluate Rodrigues' formula with a constant axis; zeros of an aligned axis stay structural."""
    outer = np.outer(axis, axis)
    return sparse(outer) + c * sparse(np.eye(3) - outer) + s * sparse(spatial.skew(axis))


FREE_FLYER = JointKind(
    pose=_free_flyer_pose, integrate=_free_flyer_integrate, difference=_free_flyer_difference
)
PLANAR = JointKind(pose=_planar_pose, integrate=_planar_integrate, difference=_planar_difference)
UNBOUNDED = JointKind(pose=_circle_pose, integrate=_circle_integrate, difference=_circle_difference)
REVOLUTE = JointKind(
    pose=_revolute_pose, integrate=lambda q, v: q + v, difference=lambda q0, q1: q1 - q0
)
PRISMATIC = replace(REVOLUTE, pose=lambda S, q: (ca.SX.eye(3), sparse(S[:3, 0]) * q))

JOINT_KINDS: Mapping[str, JointKind] = {
    "JointModelFreeFlyer": FREE_FLYER,
    "JointModelPlanar": PLANAR,
    **dict.fromkeys(
        ("JointModelRX", "JointModelRY", "JointModelRZ", "JointModelRevoluteUnaligned"), REVOLUTE
    ),
    **dict.fromkeys(
        (
            "JointModelRUBX",
            "JointModelRUBY",
            "JointModelRUBZ",
            "JointModelRevoluteUnboundedUnaligned",
        ),
        UNBOUNDED,
    ),
    **dict.fromkeys(
        ("JointModelPX", "JointModelPY", "JointModelPZ", "JointModelPrismaticUnaligned"), PRISMATIC
    ),
}
"""Joint types of Pinocchio that have a symbolic form."""
