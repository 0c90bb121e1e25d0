"""Rigid bodies and joints as CasADi expressions: poses, twists, wrenches, inertias, and steps on
joint manifolds.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import spatial

# Poses, twists, wrenches and inertias of rigid bodies as CasADi expressions, each in its body's own
# frame.

_EQUAL = 1e-15  # relative, of the diagonal of an isotropic matrix

_ROUNDING = 1e-14  # entries of constant matrices below this are structural zeros


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SymbolicPose:
    """A pose as expressions: R (3, 3) and p (3,) [m]."""

    R: ca.SX
    p: ca.SX

    @staticmethod
    def identity() -> SymbolicPose:
        """The pose of a frame in itself."""
        return SymbolicPose(R=ca.SX.eye(3), p=ca.SX(3, 1))

    def then(self, R: ca.SX | ca.DM, p: ca.SX | ca.DM) -> SymbolicPose:
        """Product with the pose (R, p)."""
        return SymbolicPose(R=self.R @ R, p=self.p + self.R @ p)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Twist:
    """A spatial velocity or acceleration in the body's own frame: linear (3,), angular (3,)."""

    linear: ca.SX
    angular: ca.SX

    def __add__(self, other: Twist) -> Twist:
        return Twist(linear=self.linear + other.linear, angular=self.angular + other.angular)

    def stacked(self) -> ca.SX:
        """Six rows, linear first."""
        return ca.vertcat(self.linear, self.angular)

    def cross(self, other: Twist) -> Twist:
        """Rate of the other twist when it is carried along by this one."""
        return Twist(
            linear=spatial.cross(self.angular, other.linear)
            + spatial.cross(self.linear, other.angular),
            angular=spatial.cross(self.angular, other.angular),
        )

    def into_child(self, local: SymbolicPose) -> Twist:
        """The twist in the frame of a child body whose pose in this frame is ``local``."""
        return Twist(
            linear=local.R.T @ (self.linear + spatial.cross(self.angular, local.p)),
            angular=local.R.T @ self.angular,
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Wrench:
    """A force (3,) [N] and a moment (3,) [N m] about the origin of the body's own frame."""

    force: ca.SX
    moment: ca.SX

    def __add__(self, other: Wrench) -> Wrench:
        return Wrench(force=self.force + other.force, moment=self.moment + other.moment)

    def onto_parent(self, local: SymbolicPose) -> Wrench:
        """The wrench in the frame of the parent body, in which this body's pose is ``local``."""
        force = local.R @ self.force
        return Wrench(force=force, moment=local.R @ self.moment + spatial.skew(local.p) @ force)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TwistToWrench:
    """A symmetric matrix (6, 6) ``[[A, B], [B.T, C]]`` from twists to wrenches, blocks (3, 3),
    linear first.
    """

    A: ca.SX
    B: ca.SX
    C: ca.SX

    @staticmethod
    def of(matrix: ca.DM | ca.SX) -> TwistToWrench:
        """Take the blocks of a symmetric matrix (6, 6)."""
        blocks = ca.SX(matrix)
        return TwistToWrench(A=blocks[:3, :3], B=blocks[:3, 3:], C=blocks[3:, 3:])

    def __add__(self, other: TwistToWrench) -> TwistToWrench:
        return TwistToWrench(A=self.A + other.A, B=self.B + other.B, C=self.C + other.C)

    def times(self, linear: ca.DM, angular: ca.DM) -> Wrench:
        """Wrenches of twists, one per column."""
        return Wrench(
            force=self.A @ linear + self.B @ angular, moment=self.B.T @ linear + self.C @ angular
        )

    def onto_parent(self, local: SymbolicPose) -> TwistToWrench:
        """Express the map in the frame of the parent body, in which this body has the pose ``local``."""
        R = local.R
        shift = spatial.skew(local.p)
        if _is_isotropic(self.A):
            A = self.A
        else:
            A = _symmetric(R @ self.A @ R.T)
        B = R @ self.B @ R.T
        C = _symmetric(R @ self.C @ R.T)
        moved = B - A @ shift
        return TwistToWrench(A=A, B=moved, C=_symmetric(C - B.T @ shift + shift @ moved))


def _symmetric(square: ca.SX) -> ca.SX:
    return ca.triu2symm(ca.triu(square))


def _is_isotropic(A: ca.SX) -> bool:
    if not A.is_constant():
        return False
    values = np.asarray(ca.DM(A), dtype=float)
    return bool(
        np.allclose(values, values[0, 0] * np.eye(3), rtol=0, atol=_EQUAL * abs(values[0, 0]))
    )


def inertial_wrench(inertia: ca.DM, velocity: Twist, acceleration: Twist) -> Wrench:
    """``I a + v x* (I v)`` of a body with a constant 6x6 inertia, all in the frame of the body."""
    momentum = _times(inertia, velocity)
    rate = _times(inertia, acceleration)
    return Wrench(
        force=rate.force + spatial.cross(velocity.angular, momentum.force),
        moment=rate.moment
        + spatial.cross(velocity.angular, momentum.moment)
        + spatial.cross(velocity.linear, momentum.force),
    )


def _times(inertia: ca.DM, twist: Twist) -> Wrench:
    rows = inertia @ twist.stacked()
    return Wrench(force=rows[:3], moment=rows[3:])


# Joints of a Pinocchio model as CasADi expressions: poses across them, and steps on their
# manifolds.


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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SymbolicJoint:
    """One joint: where it sits in the tree, in q and v, and its constant motion subspace."""

    name: str
    kind: JointKind
    parent: int
    q: slice
    v: slice
    R_PJ: ca.DM
    """(3, 3) of its fixed frame in the parent body."""
    p_PJ: ca.DM
    """(3,) [m]"""
    S: np.ndarray
    """(6, n) motion subspace in the child body, n being the joint's size in v."""
    S_linear: ca.DM
    """(3, n) first rows of S."""
    S_angular: ca.DM
    """(3, n) last rows of S."""

    def pose(self, q: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Pose (R, p) of this joint's body in the parent body, from the whole configuration."""
        R, p = self.kind.pose(self.S, q[self.q])
        return self.R_PJ @ R, self.p_PJ + self.R_PJ @ p


def sparse(constant: np.ndarray) -> ca.DM:
    """The constant matrix or vector (...) [any] with rounding errors and zeros removed from its
    sparsity.
    """
    return ca.sparsify(ca.DM(np.where(np.abs(constant) < _ROUNDING, 0.0, constant)))


def symbolic_joint(model: pin.Model, index: int) -> SymbolicJoint:
    """Read one joint of a model. Raises InvalidInput for a joint type that is not supported."""
    joint = model.joints[index]
    name = model.names[index]
    X_PJ = model.jointPlacements[index]
    S = np.asarray(joint.createData().S, dtype=float).reshape(6, joint.nvExtended)
    follows = joint.shortname() == "JointModelMimic"
    return SymbolicJoint(
        name=name,
        kind=_following(joint.extract(), S) if follows else _kind(joint.shortname(), name),
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
    """A joint that mimics another one, of one coordinate as it is itself: it moves with that one's
    q and v, and has none.
    """
    leader_kind = REVOLUTE if S[3:].any() else PRISMATIC
    scaling = joint.scaling
    offset = joint.offset
    nothing = ca.SX(0, 1)
    return JointKind(
        pose=lambda S, q: leader_kind.pose(S / scaling, scaling * q + offset),
        integrate=lambda q, v: nothing,
        difference=lambda q0, q1: nothing,
    )


def _kind(shortname: str, joint_name: str) -> JointKind:
    if shortname not in JOINT_KINDS:
        supported = ", ".join(name.removeprefix("JointModel") for name in JOINT_KINDS)
        raise InvalidInput(
            f"joint {joint_name!r} has type {shortname.removeprefix('JointModel')}; supported:"
            f" {supported}"
        )
    return JOINT_KINDS[shortname]


# --- free-flyer: q = (p (3), quaternion xyzw (4)), v = body twist (6) -----------------------------


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
    """One Newton step of normalisation: rounding errors do not accumulate, and nothing is
    divided.
    """
    return x * ((3 - ca.sumsqr(x)) / 2)


# --- planar: q = (x, y, cos, sin), v = (v_x, v_y in the body, rate) -------------------------------


def _planar_pose(S: np.ndarray, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    return spatial.matrix((q[2], -q[3], 0), (q[3], q[2], 0), (0, 0, 1)), ca.vertcat(
        q[0], q[1], ca.SX(1, 1)
    )


def _planar_integrate(q: ca.SX, v: ca.SX) -> ca.SX:
    p = spatial.exp6_translation(ca.vertcat(v[0], v[1], 0, 0, 0, v[2]))
    moved = ca.vertcat(q[0] + q[2] * p[0] - q[3] * p[1], q[1] + q[3] * p[0] + q[2] * p[1])
    return ca.vertcat(moved, _circle_integrate(q[2:], v[2]))


def _planar_difference(q0: ca.SX, q1: ca.SX) -> ca.SX:
    d = q1[:2] - q0[:2]
    angle = _circle_difference(q0[2:], q1[2:])
    p = ca.vertcat(q0[2] * d[0] + q0[3] * d[1], q0[2] * d[1] - q0[3] * d[0], 0)
    return ca.vertcat(spatial.log6_translation(ca.vertcat(0, 0, angle), p)[:2], angle)


# --- unbounded revolute: q = (cos, sin) -----------------------------------------------------------


def _circle_pose(S: np.ndarray, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    return _rotation_about(S[3:, 0], q[0], q[1]), ca.SX(3, 1)


def _circle_integrate(q: ca.SX, v: ca.SX) -> ca.SX:
    c = ca.cos(v)
    s = ca.sin(v)
    return _towards_unit(ca.vertcat(q[0] * c - q[1] * s, q[1] * c + q[0] * s))


def _circle_difference(q0: ca.SX, q1: ca.SX) -> ca.SX:
    return ca.atan2(q0[0] * q1[1] - q0[1] * q1[0], q0[0] * q1[0] + q0[1] * q1[1])


# --- one coordinate -------------------------------------------------------------------------------


def _revolute_pose(S: np.ndarray, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    return _rotation_about(S[3:, 0], ca.cos(q), ca.sin(q)), ca.SX(3, 1)


def _rotation_about(axis: np.ndarray, c: ca.SX, s: ca.SX) -> ca.SX:
    """Rodrigues' formula with a constant axis; zeros of an aligned axis stay structural."""
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
