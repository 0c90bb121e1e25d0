"""Rigid-body algorithms as CasADi SX expressions, read from a ``pin.Model``.

The pip wheels of Pinocchio carry no CasADi scalar type; these recursions supply it. Pinocchio stays
the numeric engine, and the oracle of the tests. Expressions keep structural zeros, so that
functions built from them stay small.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import FrameNotFound, InvalidInput
from uvms_ocp.robot import spatial
from uvms_ocp.robot.symbolic_bodies import (
    SymbolicPose,
    Twist,
    TwistToWrench,
    Wrench,
    sparse,
)
from uvms_ocp.robot.symbolic_joints import SymbolicJoint, symbolic_joint


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BodyMotions:
    """Velocity and acceleration of every joint body, in its own frame; index 0 is the universe.

    ``accelerations`` are spatial, the rates of the components of ``velocities``, relative to free
    fall.
    """

    poses: tuple[SymbolicPose, ...]
    velocities: tuple[Twist, ...]
    accelerations: tuple[Twist, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SymbolicKinematics:
    """Poses of all joints at one configuration; made by `SymbolicModel.forward_kinematics`."""

    model: SymbolicModel
    joint_poses: tuple[SymbolicPose, ...]

    def pose(self, frame: str) -> tuple[ca.SX, ca.SX]:
        """Return the pose X_WF of a frame: R_WF (3, 3) and p_WF (3,) [m]. Raises FrameNotFound."""
        joint, R_JF, p_JF = self.model.frame(frame)
        pose = self.joint_poses[joint].then(R_JF, p_JF)
        return pose.R, pose.p

    def jacobian(self, frame: str) -> ca.SX:
        """Return the Jacobian (6, n_v) of a frame's velocity at its origin, expressed in W, linear
        rows first.

        Columns of joints that do not carry the frame are structurally zero. Raises FrameNotFound.
        """
        joint, _, _ = self.model.frame(frame)
        _, p_WF = self.pose(frame)
        J = ca.SX(6, self.model.model.nv)
        while joint > 0:
            J[:, self.model.joints[joint - 1].v] += self._columns(joint, p_WF)
            joint = self.model.joints[joint - 1].parent
        return J

    def _columns(self, index: int, p_WF: ca.SX) -> ca.SX:
        joint = self.model.joints[index - 1]
        pose = self.joint_poses[index]
        angular = pose.R @ joint.S_angular
        linear = pose.R @ joint.S_linear
        if joint.S_angular.nnz():
            linear = linear - spatial.skew(p_WF - pose.p) @ angular
        return ca.vertcat(linear, angular)


@checked_dataclass(kw_only=False, eq=False)
class SymbolicModel:
    """A kinematic tree as CasADi expressions of q (n_q,) [m, rad], v (n_v,) [m/s, rad/s] and a
    (n_v,) [m/s2, rad/s2].

    Raises InvalidInput for joint types other than free-flyer, revolute, prismatic, planar and
    unbounded revolute.
    """

    model: pin.Model
    joints: tuple[SymbolicJoint, ...] = field(init=False, repr=False)
    """Joint i of Pinocchio is ``joints[i - 1]``; the universe has no entry."""

    def __post_init__(self) -> None:
        joints = tuple(symbolic_joint(self.model, i) for i in range(1, self.model.njoints))
        object.__setattr__(self, "joints", joints)

    # --- kinematics -------------------------------------------------------------------------------

    def frame(self, name: str) -> tuple[int, ca.DM, ca.DM]:
        """Return the joint that carries a frame and the frame's placement R_JF, p_JF on it. Raises
        FrameNotFound.
        """
        body_frame = find_frame(self.model, name)
        return (
            body_frame.parentJoint,
            sparse(body_frame.placement.rotation),
            sparse(body_frame.placement.translation),
        )

    def forward_kinematics(self, q: ca.SX) -> SymbolicKinematics:
        """Compute the poses of all joints at q. Raises InvalidInput for a q of another size."""
        return SymbolicKinematics(model=self, joint_poses=self.joint_poses(self.local_poses(q)))

    def local_poses(self, q: ca.SX) -> tuple[SymbolicPose, ...]:
        """Return the pose of every joint body in its parent body; index 0 is the universe. Raises
        InvalidInput for a q of another size.
        """
        self._check_rows("q", q, self.model.nq)
        poses = [SymbolicPose.identity()]
        for joint in self.joints:
            R, p = joint.pose(q)
            poses.append(SymbolicPose(R=R, p=p))
        return tuple(poses)

    def joint_poses(self, local_poses: Sequence[SymbolicPose]) -> tuple[SymbolicPose, ...]:
        """Return the pose X_WJ of every joint body; index 0 is the universe. Raises InvalidInput
        for another number of poses.
        """
        self._check_bodies(local_poses=local_poses)
        poses = [local_poses[0]]
        for joint, local in zip(self.joints, local_poses[1:], strict=True):
            poses.append(poses[joint.parent].then(local.R, local.p) if joint.parent else local)
        return tuple(poses)

    def integrate(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Return the configuration (n_q,) after moving from q for one second with the constant
        velocity v.

        Raises InvalidInput for a q or v of another size.
        """
        self._check_rows("q", q, self.model.nq)
        self._check_rows("v", v, self.model.nv)
        parts = [joint.kind.integrate(q[joint.q], v[joint.v]) for joint in self.joints]
        return ca.vertcat(ca.SX(0, 1), *parts)

    def difference(self, q0: ca.SX, q1: ca.SX) -> ca.SX:
        """Return the velocity (n_v,) that moves q0 to q1 in one second; rotations by at most pi.

        Raises InvalidInput for a q0 or q1 of another size.
        """
        self._check_rows("q0", q0, self.model.nq)
        self._check_rows("q1", q1, self.model.nq)
        parts = [joint.kind.difference(q0[joint.q], q1[joint.q]) for joint in self.joints]
        return ca.vertcat(ca.SX(0, 1), *parts)

    # --- dynamics ---------------------------------------------------------------------------------

    def _check_bodies(self, **sequences: Sequence[object]) -> None:
        for name, values in sequences.items():
            if len(values) != self.model.njoints:
                raise InvalidInput(
                    f"{name}: {len(values)} given, {self.model.njoints} wanted: the universe and"
                    " each joint"
                )

    def body_motions(self, local_poses: Sequence[SymbolicPose], v: ca.SX, a: ca.SX) -> BodyMotions:
        """Compute velocities and accelerations of all joint bodies: the outward pass.

        Raises InvalidInput for another size of v or a, or number of poses.
        """
        self._check_bodies(local_poses=local_poses)
        self._check_rows("v", v, self.model.nv)
        self._check_rows("a", a, self.model.nv)
        velocities = [Twist(linear=ca.SX(3, 1), angular=ca.SX(3, 1))]
        accelerations = [
            Twist(linear=ca.SX(sparse(-self.model.gravity.linear)), angular=ca.SX(3, 1))
        ]
        for joint, local in zip(self.joints, local_poses[1:], strict=True):
            relative = _across(joint, v)
            velocity = velocities[joint.parent].into_child(local) + relative
            carried = accelerations[joint.parent].into_child(local) + _across(joint, a)
            velocities.append(velocity)
            accelerations.append(carried + velocity.cross(relative))
        return BodyMotions(
            poses=self.joint_poses(local_poses),
            velocities=tuple(velocities),
            accelerations=tuple(accelerations),
        )

    def generalized_force(
        self, local_poses: Sequence[SymbolicPose], wrenches: Sequence[Wrench]
    ) -> ca.SX:
        """Compute the generalized force (n_v,) that balances a wrench on every joint body, else
        InvalidInput: the inward pass.
        """
        self._check_bodies(local_poses=local_poses, wrenches=wrenches)
        carried = list(wrenches)
        total = ca.SX(self.model.nv, 1)
        for index in range(len(self.joints), 0, -1):
            joint = self.joints[index - 1]
            wrench = carried[index]
            total[joint.v] += joint.S_linear.T @ wrench.force + joint.S_angular.T @ wrench.moment
            if joint.parent:
                carried[joint.parent] += wrench.onto_parent(local_poses[index])
        return total

    def congruence(
        self, local_poses: Sequence[SymbolicPose], matrices: Sequence[ca.DM | ca.SX]
    ) -> ca.SX:
        """Compute ``sum J_i.T X_i J_i`` (n_v, n_v) over the joint bodies, for symmetric X_i (6, 6)
        in their frames, else InvalidInput.
        """
        self._check_bodies(local_poses=local_poses, matrices=matrices)
        carried = [TwistToWrench.of(matrix) for matrix in matrices]
        total = ca.SX(self.model.nv, self.model.nv)
        for index in range(len(self.joints), 0, -1):
            self._fill_columns(total, index, carried[index], local_poses)
            parent = self.joints[index - 1].parent
            if parent:
                carried[parent] += carried[index].onto_parent(local_poses[index])
        return ca.triu2symm(ca.triu(total))

    def _fill_columns(
        self, total: ca.SX, index: int, carried: TwistToWrench, local: Sequence[SymbolicPose]
    ) -> None:
        joint = self.joints[index - 1]
        wrench = carried.times(joint.S_linear, joint.S_angular)
        columns = joint.v
        at = index
        while at:
            joint = self.joints[at - 1]
            block = joint.S_linear.T @ wrench.force + joint.S_angular.T @ wrench.moment
            # The upper triangle alone; of joints that move as one both halves count.
            if at != index and joint.v == columns:
                total[joint.v, columns] += block + block.T
            elif joint.v.start <= columns.start:
                total[joint.v, columns] += block
            else:
                total[columns, joint.v] += block.T
            wrench = wrench.onto_parent(local[at])
            at = joint.parent

    def _check_rows(self, name: str, value: ca.SX, n_rows: int) -> None:
        if value.shape != (n_rows, 1):
            raise InvalidInput(
                f"{name}: shape {value.shape} given, a column of {n_rows} rows wanted"
            )


def find_frame(model: pin.Model, name: str) -> pin.Frame:
    """Return the frame of a model by name; a body is preferred to a joint of the same name. Raises
    FrameNotFound.
    """
    candidates = [frame for frame in model.frames if frame.name == name]
    if not candidates:
        raise FrameNotFound(name, dict.fromkeys(frame.name for frame in model.frames))
    for frame in candidates:
        if frame.type == pin.FrameType.BODY:
            return frame
    return candidates[0]


def function(name: str, inputs: dict[str, ca.SX], outputs: dict[str, ca.SX]) -> ca.Function:
    """Build an SX function with named, dense inputs and outputs."""
    dense = [ca.densify(value) for value in outputs.values()]
    return ca.Function(
        name, list(inputs.values()), dense, list(inputs), list(outputs), {"cse": True}
    )


def _across(joint: SymbolicJoint, v: ca.SX) -> Twist:
    return Twist(linear=joint.S_linear @ v[joint.v], angular=joint.S_angular @ v[joint.v])
