"""Poses, twists, wrenches and inertias of rigid bodies as CasADi expressions, each in its body's own
frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from uvms_ocp.robot import spatial

_EQUAL = 1e-15  # relative difference of the diagonal entries of an isotropic matrix
_ROUNDING = 1e-14  # entries of constant matrices below this are structural zeros


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SymbolicPose:
    """A pose as expressions: R (3, 3) and p (3,) [m]."""

    R: ca.SX
    p: ca.SX

    @staticmethod
    def identity() -> SymbolicPose:
        """Return the pose of a frame in itself."""
        return SymbolicPose(R=ca.SX.eye(3), p=ca.SX(3, 1))

    def then(self, R: ca.SX | ca.DM, p: ca.SX | ca.DM) -> SymbolicPose:
        """Return the product with the pose (R, p)."""
        return SymbolicPose(R=self.R @ R, p=self.p + self.R @ p)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Twist:
    """A spatial velocity or acceleration in the body's own frame: linear (3,), angular (3,)."""

    linear: ca.SX
    angular: ca.SX

    def __add__(self, other: Twist) -> Twist:
        return Twist(linear=self.linear + other.linear, angular=self.angular + other.angular)

    def stacked(self) -> ca.SX:
        """Stack both parts into six rows, linear first."""
        return ca.vertcat(self.linear, self.angular)

    def cross(self, other: Twist) -> Twist:
        """Return the rate of a twist that is carried along by this one."""
        return Twist(
            linear=spatial.cross(self.angular, other.linear)
            + spatial.cross(self.linear, other.angular),
            angular=spatial.cross(self.angular, other.angular),
        )

    def into_child(self, local: SymbolicPose) -> Twist:
        """Express the twist in the frame of a child body whose pose in this frame is ``local``."""
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
        """Express the wrench in the frame of the parent body, in which this body's pose is
        ``local``.
        """
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
        """Compute the wrenches of twists, one per column."""
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
    """Return a matrix whose lower triangle repeats the upper one."""
    return ca.triu2symm(ca.triu(square))


def _is_isotropic(A: ca.SX) -> bool:
    """Check whether a matrix (3, 3) is a constant number times the identity."""
    if not A.is_constant():
        return False
    values = np.asarray(ca.DM(A), dtype=float)
    return bool(
        np.allclose(values, values[0, 0] * np.eye(3), rtol=0, atol=_EQUAL * abs(values[0, 0]))
    )


def inertial_wrench(inertia: ca.DM, velocity: Twist, acceleration: Twist) -> Wrench:
    """Compute ``I a + v x* (I v)`` of a body with a constant 6x6 inertia, all in the frame of the
    body.
    """
    momentum = _times(inertia, velocity)
    rate = _times(inertia, acceleration)
    return Wrench(
        force=rate.force + spatial.cross(velocity.angular, momentum.force),
        moment=rate.moment
        + spatial.cross(velocity.angular, momentum.moment)
        + spatial.cross(velocity.linear, momentum.force),
    )


def _times(inertia: ca.DM, twist: Twist) -> Wrench:
    """Compute the product of an inertia (6, 6) and a twist."""
    rows = inertia @ twist.stacked()
    return Wrench(force=rows[:3], moment=rows[3:])


def sparse(constant: np.ndarray) -> ca.DM:
    """Return the constant matrix or vector (...) [any] with rounding errors and zeros removed from its
    sparsity.
    """
    return ca.sparsify(ca.DM(np.where(np.abs(constant) < _ROUNDING, 0.0, constant)))
