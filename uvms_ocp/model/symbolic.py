"""Rigid-body algorithms as CasADi SX expressions, read from a ``pin.Model``.

The pip wheels of Pinocchio carry no CasADi scalar type; these recursions supply it. Pinocchio stays the
numeric engine, and the oracle of the tests. Expressions keep structural zeros, so that functions built from
them stay small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np
import pinocchio as pin

from uvms_ocp.exceptions import FrameNotFound, InvalidInput
from uvms_ocp.model import spatial
from uvms_ocp.model.symbolic_joints import SymbolicJoint, sparse, symbolic_joint

Inertias = Sequence[np.ndarray]
"""One 6x6 spatial inertia per joint of the model, universe included, at the joint frame, linear first."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Pose:
    """A pose as expressions: R (3, 3) and p (3,) [m]."""

    R: ca.SX
    p: ca.SX

    def then(self, R: ca.SX | ca.DM, p: ca.SX | ca.DM) -> Pose:
        """Product with the pose (R, p)."""
        return Pose(R=self.R @ R, p=self.p + self.R @ p)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Twist:
    """A spatial velocity or acceleration in the body's own frame: linear (3,), angular (3,)."""

    linear: ca.SX
    angular: ca.SX

    def stacked(self) -> ca.SX:
        """Six rows, linear first."""
        return ca.vertcat(self.linear, self.angular)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Wrench:
    """A force (3,) [N] and a moment (3,) [N m] about the origin of the body's own frame."""

    force: ca.SX
    moment: ca.SX

    def __add__(self, other: Wrench) -> Wrench:
        return Wrench(force=self.force + other.force, moment=self.moment + other.moment)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BodyMotions:
    """Velocity and acceleration of every joint body, in its own frame; index 0 is the universe.

    ``accelerations`` are spatial, the rates of the components of ``velocities``, relative to free fall.
    """

    poses: tuple[Pose, ...]
    velocities: tuple[Twist, ...]
    accelerations: tuple[Twist, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SymbolicKinematics:
    """Poses of all joints at one configuration; made by `SymbolicModel.forward_kinematics`."""

    model: SymbolicModel
    joint_poses: tuple[Pose, ...]

    def pose(self, frame: str) -> tuple[ca.SX, ca.SX]:
        """Pose X_WF of a frame: R_WF (3, 3) and p_WF (3,) [m]. Raises FrameNotFound."""
        joint, R_JF, p_JF = self.model.frame(frame)
        pose = self.joint_poses[joint].then(R_JF, p_JF)
        return pose.R, pose.p

    def jacobian(self, frame: str) -> ca.SX:
        """Jacobian (6, n_v) of a frame's velocity at its origin, expressed in W, linear rows first.

        Columns of joints that do not carry the frame are structurally zero. Raises FrameNotFound.
        """
        joint, _, _ = self.model.frame(frame)
        _, p_WF = self.pose(frame)
        J = ca.SX(6, self.model.model.nv)
        while joint > 0:
            J[:, self.model.joints[joint - 1].v] = self._columns(joint, p_WF)
            joint = self.model.joints[joint - 1].parent
        return J

    def _columns(self, index: int, p_WF: ca.SX) -> ca.SX:
        joint, pose = self.model.joints[index - 1], self.joint_poses[index]
        angular = pose.R @ joint.S_angular
        linear = pose.R @ joint.S_linear
        if joint.S_angular.nnz():
            linear = linear - spatial.skew(p_WF - pose.p) @ angular
        return ca.vertcat(linear, angular)


@dataclass(frozen=True, slots=True, eq=False)
class SymbolicModel:
    """A kinematic tree as CasADi expressions.

    Raises InvalidInput for joint types other than free-flyer, revolute, prismatic, planar and unbounded
    revolute.
    """

    model: pin.Model
    joints: tuple[SymbolicJoint, ...] = field(init=False, repr=False)
    """Joint i of Pinocchio is ``joints[i - 1]``; the universe has no entry."""

    def __post_init__(self) -> None:
        joints = tuple(symbolic_joint(self.model, i) for i in range(1, self.model.njoints))
        object.__setattr__(self, "joints", joints)

    # --- kinematics -------------------------------------------------------------------------------

    def frame(self, name: str) -> tuple[int, ca.DM, ca.DM]:
        """Supporting joint of a frame and the frame's placement R_JF, p_JF on it. Raises FrameNotFound."""
        found = find_frame(self.model, name)
        return found.parentJoint, sparse(found.placement.rotation), sparse(found.placement.translation)

    def forward_kinematics(self, q: ca.SX) -> SymbolicKinematics:
        """Poses of all joints at the configuration q (n_q,)."""
        return SymbolicKinematics(model=self, joint_poses=self.joint_poses(self.local_poses(q)))

    def local_poses(self, q: ca.SX) -> tuple[Pose, ...]:
        """Pose of every joint body in its parent body; index 0 is the universe."""
        self._check_rows("q", q, self.model.nq)
        across = (joint.pose(q) for joint in self.joints)
        return (_identity(), *(Pose(R=R, p=p) for R, p in across))

    def joint_poses(self, local_poses: Sequence[Pose]) -> tuple[Pose, ...]:
        """Pose X_WJ of every joint body; index 0 is the universe."""
        poses = [local_poses[0]]
        for joint, local in zip(self.joints, local_poses[1:], strict=True):
            poses.append(poses[joint.parent].then(local.R, local.p) if joint.parent else local)
        return tuple(poses)

    def integrate(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Configuration (n_q,) after moving from q for one second with the constant velocity v (n_v,)."""
        self._check_rows("q", q, self.model.nq)
        self._check_rows("v", v, self.model.nv)
        return ca.vertcat(
            ca.SX(0, 1), *[joint.kind.integrate(q[joint.q], v[joint.v]) for joint in self.joints]
        )

    def difference(self, q0: ca.SX, q1: ca.SX) -> ca.SX:
        """Velocity (n_v,) that moves q0 to q1 in one second; rotations by at most pi."""
        self._check_rows("q0", q0, self.model.nq)
        self._check_rows("q1", q1, self.model.nq)
        parts = [joint.kind.difference(q0[joint.q], q1[joint.q]) for joint in self.joints]
        return ca.vertcat(ca.SX(0, 1), *parts)

    # --- dynamics ---------------------------------------------------------------------------------

    def rnea(
        self,
        q: ca.SX,
        v: ca.SX,
        a: ca.SX,
        inertias: Inertias | None = None,
        gravity: Sequence[float] | None = None,
    ) -> ca.SX:
        """Generalized force (n_v,) of the recursive Newton-Euler algorithm.

        inertias: 6x6 spatial inertia of each joint body, default the model's; added mass may be part of it.
        gravity: (3,) [m/s2] in W, default the model's.
        """
        local = self.local_poses(q)
        motions = self.body_motions(local, v, a, gravity)
        wrenches = [
            inertial_wrench(sparse(inertia), velocity, acceleration)
            for inertia, velocity, acceleration in zip(
                self._inertias(inertias), motions.velocities, motions.accelerations, strict=True
            )
        ]
        return self.generalized_force(local, wrenches) + self.model.armature * a

    def body_motions(
        self, local_poses: Sequence[Pose], v: ca.SX, a: ca.SX, gravity: Sequence[float] | None = None
    ) -> BodyMotions:
        """Velocities and accelerations of all joint bodies: the outward pass."""
        self._check_rows("v", v, self.model.nv)
        self._check_rows("a", a, self.model.nv)
        g = self.model.gravity.linear if gravity is None else np.asarray(gravity, dtype=float)
        velocities = [Twist(linear=ca.SX(3, 1), angular=ca.SX(3, 1))]
        accelerations = [Twist(linear=ca.SX(sparse(-g)), angular=ca.SX(3, 1))]
        for joint, local in zip(self.joints, local_poses[1:], strict=True):
            relative = _across(joint, v)
            velocity = _plus(_into_child(local, velocities[joint.parent]), relative)
            carried = _plus(_into_child(local, accelerations[joint.parent]), _across(joint, a))
            velocities.append(velocity)
            accelerations.append(_plus(carried, _motion_cross(velocity, relative)))
        return BodyMotions(
            poses=self.joint_poses(local_poses),
            velocities=tuple(velocities),
            accelerations=tuple(accelerations),
        )

    def generalized_force(self, local_poses: Sequence[Pose], wrenches: Sequence[Wrench]) -> ca.SX:
        """Generalized force (n_v,) that balances a wrench on every joint body: the inward pass."""
        carried = list(wrenches)
        rows = []
        for index in range(len(self.joints), 0, -1):
            joint, wrench = self.joints[index - 1], carried[index]
            rows.append(joint.S_linear.T @ wrench.force + joint.S_angular.T @ wrench.moment)
            if joint.parent:
                carried[joint.parent] += _onto_parent(local_poses[index], wrench)
        return ca.vertcat(ca.SX(0, 1), *reversed(rows))

    def mass_matrix(self, q: ca.SX, inertias: Inertias | None = None) -> ca.SX:
        """Mass matrix (n_v, n_v) of the composite-rigid-body algorithm, symmetric by construction."""
        local = self.local_poses(q)
        composite = [_Composite.of(inertia) for inertia in self._inertias(inertias)]
        M = ca.SX(self.model.nv, self.model.nv)
        for index in range(len(self.joints), 0, -1):
            self._fill_columns(M, index, composite[index], local)
            parent = self.joints[index - 1].parent
            if parent:
                composite[parent] = composite[parent].plus(composite[index].onto_parent(local[index]))
        return ca.triu2symm(ca.triu(M)) + ca.diag(sparse(np.asarray(self.model.armature)))

    def _fill_columns(self, M: ca.SX, index: int, composite: _Composite, local: Sequence[Pose]) -> None:
        joint = self.joints[index - 1]
        wrench = composite.times(joint.S_linear, joint.S_angular)
        columns = joint.v
        while index:
            joint = self.joints[index - 1]
            M[joint.v, columns] = joint.S_linear.T @ wrench.force + joint.S_angular.T @ wrench.moment
            wrench = _onto_parent(local[index], wrench)
            index = joint.parent

    def _inertias(self, inertias: Inertias | None) -> list[np.ndarray]:
        if inertias is None:
            return [np.zeros((6, 6)), *(Y.matrix() for Y in list(self.model.inertias)[1:])]
        if len(inertias) != self.model.njoints:
            raise InvalidInput(
                f"inertias: {len(inertias)} given, {self.model.njoints} wanted: the universe and each joint"
            )
        return list(inertias)

    def _check_rows(self, name: str, value: ca.SX, n_rows: int) -> None:
        if value.shape != (n_rows, 1):
            raise InvalidInput(f"{name}: shape {value.shape} given, a column of {n_rows} rows wanted")

    # --- ready-made functions ---------------------------------------------------------------------

    def pose_function(self, frame: str) -> ca.Function:
        """Function ``q -> R (3, 3), p (3,)`` of a frame."""
        q = self._q()
        R, p = self.forward_kinematics(q).pose(frame)
        return _function("pose", {"q": q}, {"R": R, "p": p})

    def jacobian_function(self, frame: str) -> ca.Function:
        """Function ``q -> J (6, n_v)`` of a frame."""
        q = self._q()
        return _function("jacobian", {"q": q}, {"J": self.forward_kinematics(q).jacobian(frame)})

    def integrate_function(self) -> ca.Function:
        """Function ``q, v -> q_next``."""
        q, v = self._q(), self._v("v")
        return _function("integrate", {"q": q, "v": v}, {"q_next": self.integrate(q, v)})

    def difference_function(self) -> ca.Function:
        """Function ``q0, q1 -> v``."""
        q0, q1 = self._q("q0"), self._q("q1")
        return _function("difference", {"q0": q0, "q1": q1}, {"v": self.difference(q0, q1)})

    def rnea_function(self) -> ca.Function:
        """Function ``q, v, a -> tau``."""
        q, v, a = self._q(), self._v("v"), self._v("a")
        return _function("rnea", {"q": q, "v": v, "a": a}, {"tau": self.rnea(q, v, a)})

    def mass_matrix_function(self) -> ca.Function:
        """Function ``q -> M (n_v, n_v)``."""
        q = self._q()
        return _function("mass_matrix", {"q": q}, {"M": self.mass_matrix(q)})

    def _q(self, name: str = "q") -> ca.SX:
        return ca.SX.sym(name, self.model.nq)

    def _v(self, name: str) -> ca.SX:
        return ca.SX.sym(name, self.model.nv)


def find_frame(model: pin.Model, name: str) -> pin.Frame:
    """Frame of a model by name; a body is preferred to a joint of the same name. Raises FrameNotFound."""
    named = [frame for frame in model.frames if frame.name == name]
    if not named:
        raise FrameNotFound(name, dict.fromkeys(frame.name for frame in model.frames))
    return next((frame for frame in named if frame.type == pin.FrameType.BODY), named[0])


def inertial_wrench(inertia: ca.DM, velocity: Twist, acceleration: Twist) -> Wrench:
    """``I a + v x* (I v)`` of a body with a constant 6x6 inertia, all in the frame of the body."""
    momentum, rate = _times(inertia, velocity), _times(inertia, acceleration)
    return Wrench(
        force=rate.force + spatial.cross(velocity.angular, momentum.force),
        moment=rate.moment
        + spatial.cross(velocity.angular, momentum.moment)
        + spatial.cross(velocity.linear, momentum.force),
    )


def _times(inertia: ca.DM, twist: Twist) -> Wrench:
    rows = inertia @ twist.stacked()
    return Wrench(force=rows[:3], moment=rows[3:])


def _identity() -> Pose:
    return Pose(R=ca.SX.eye(3), p=ca.SX(3, 1))


def _function(name: str, inputs: dict[str, ca.SX], outputs: dict[str, ca.SX]) -> ca.Function:
    dense = [ca.densify(value) for value in outputs.values()]
    return ca.Function(name, list(inputs.values()), dense, list(inputs), list(outputs), {"cse": True})


def _across(joint: SymbolicJoint, v: ca.SX) -> Twist:
    return Twist(linear=joint.S_linear @ v[joint.v], angular=joint.S_angular @ v[joint.v])


def _plus(a: Twist, b: Twist) -> Twist:
    return Twist(linear=a.linear + b.linear, angular=a.angular + b.angular)


def _into_child(local: Pose, twist: Twist) -> Twist:
    return Twist(
        linear=local.R.T @ (twist.linear + spatial.cross(twist.angular, local.p)),
        angular=local.R.T @ twist.angular,
    )


def _motion_cross(a: Twist, b: Twist) -> Twist:
    return Twist(
        linear=spatial.cross(a.angular, b.linear) + spatial.cross(a.linear, b.angular),
        angular=spatial.cross(a.angular, b.angular),
    )


def _onto_parent(local: Pose, wrench: Wrench) -> Wrench:
    force = local.R @ wrench.force
    return Wrench(force=force, moment=local.R @ wrench.moment + spatial.skew(local.p) @ force)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Composite:
    """A symmetric 6x6 inertia ``[[A, B], [B.T, C]]``, blocks (3, 3), linear rows first."""

    A: ca.SX
    B: ca.SX
    C: ca.SX

    @staticmethod
    def of(inertia: np.ndarray) -> _Composite:
        blocks = ca.SX(sparse(np.asarray(inertia, dtype=float)))
        return _Composite(A=blocks[:3, :3], B=blocks[:3, 3:], C=blocks[3:, 3:])

    def plus(self, other: _Composite) -> _Composite:
        return _Composite(A=self.A + other.A, B=self.B + other.B, C=self.C + other.C)

    def times(self, linear: ca.DM, angular: ca.DM) -> Wrench:
        return Wrench(force=self.A @ linear + self.B @ angular, moment=self.B.T @ linear + self.C @ angular)

    def onto_parent(self, local: Pose) -> _Composite:
        """The same inertia in the frame of the parent body."""
        R, shift = local.R, spatial.skew(local.p)
        A = self.A if _is_isotropic(self.A) else _symmetric(R @ self.A @ R.T)
        B, C = R @ self.B @ R.T, _symmetric(R @ self.C @ R.T)
        moved = B - A @ shift
        return _Composite(A=A, B=moved, C=_symmetric(C - B.T @ shift + shift @ moved))


def _symmetric(square: ca.SX) -> ca.SX:
    return ca.triu2symm(ca.triu(square))


def _is_isotropic(A: ca.SX) -> bool:
    if not A.is_constant():
        return False
    values = np.asarray(ca.DM(A), dtype=float)
    return bool(np.allclose(values, values[0, 0] * np.eye(3), rtol=0, atol=_EQUAL * abs(values[0, 0])))


_EQUAL = 1e-15
