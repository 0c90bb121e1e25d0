"""The robot as a value: mechanism, shapes, limits, configurations and the description of the water
on it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.checks import checked_dataclass, checked_on_failure, finite_array
from uvms_ocp.errors import FrameNotFound, InvalidInput, require_known
from uvms_ocp.record.display import SmallTable
from uvms_ocp.robot import coefficients, roles
from uvms_ocp.robot.description import RobotDescription, checked_copy
from uvms_ocp.robot.hydrodynamics import LinkHydrodynamics
from uvms_ocp.robot.limits import Joint, Limits, from_joint_values
from uvms_ocp.robot.moved_frames import (
    check_movable,
    frames_fixed_to,
    shifted_frames,
    shifted_shapes,
)
from uvms_ocp.types import Range, Shape

_LIMIT_TOLERANCE = 1e-9  # [rad or m] largest excess over a limit of a position
_UNIT_TOLERANCE = 1e-6  # largest error of the norm of a quaternion or (cos, sin)


@checked_dataclass(weakref_slot=True, eq=False, repr=False)
class Robot:
    """A vehicle with an arm, or a fixed-base arm; see `uvms_ocp.robot.loading.load_robot`.

    For a free-flyer ``q`` is Pinocchio's [p_WB, quaternion xyzw, joints] and ``v`` is [v_B,
    omega_B, joint rates]; W has z up. ``model`` and the geometry models are shared between copies
    and must not be changed.
    """

    name: str
    """Name of the robot."""
    model: pin.Model
    """Joints, links and frames."""
    visual_model: pin.GeometryModel
    """Shapes that are drawn."""
    collision_model: pin.GeometryModel
    """Shapes whose distances count."""
    description: RobotDescription
    """Content of its hydrodynamics file."""
    joints: tuple[Joint, ...]
    """Arm joints of a free-flyer, all joints otherwise."""
    limits: Limits
    """Limits of vehicle and joints."""
    home: Annotated[np.ndarray, Range(open=True)]
    """Stowed posture (n_joints,) [rad or m], one number per degree of freedom."""
    hydrodynamics: tuple[LinkHydrodynamics, ...]
    """Links in water; floats and ballast add their volume."""
    urdf: Path | None = None
    """File that it was read from; `None` for a robot of the library with all options at their
    defaults.
    """

    def __repr__(self) -> str:
        base = "free-flyer" if self.n_vehicle else "fixed base"
        return (
            f"Robot({self.name!r}, {base}, {self.n_joints} joints,"
            f" {len(self.description.thrusters)} thrusters)"
        )

    def _repr_html_(self) -> str:
        rows = list[tuple[str, ...]]()
        limits = zip(self.limits.position_lower, self.limits.position_upper, strict=True)
        for joint, (lower, upper) in zip(self.joints, limits, strict=False):
            rows.append((joint.name, f"{lower:.4g}", f"{upper:.4g}"))
        table = SmallTable(title=repr(self), head=("joint", "lower", "upper"), rows=tuple(rows))
        return table.html()

    @property
    def n_q(self) -> int:
        """Size of q."""
        return int(self.model.nq)

    @property
    def n_v(self) -> int:
        """Size of v."""
        return int(self.model.nv)

    @property
    def n_vehicle(self) -> int:
        """Velocity degrees of freedom of the vehicle: 6, or 0 for a fixed base."""
        if self.description.base == "free_flyer":
            return 6
        return 0

    @property
    def n_joints(self) -> int:
        """Velocity degrees of freedom of the joints."""
        return self.n_v - self.n_vehicle

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in the order of q."""
        return tuple(joint.name for joint in self.joints)

    @property
    def joint_of_axis(self) -> tuple[str, ...]:
        """Name of the joint that each of the n_joints velocities belongs to, of planar joints three."""
        return tuple(
            joint.name for joint in self.joints for _ in range(joint.v.start, joint.v.stop)
        )

    @property
    def endless_joints(self) -> tuple[str, ...]:
        """Names of the joints that turn without end."""
        return tuple(joint.name for joint in self.joints if joint.endless)

    @property
    def leading_joints(self) -> tuple[str, ...]:
        """Names of the joints that others mimic."""
        followed = {joint.idx_v for joint in list(self.model.joints)[1:] if not joint.nv}
        return tuple(joint.name for joint in self.joints if joint.idx_v in followed)

    @property
    def drawn_shapes(self) -> tuple[pin.GeometryObject, ...]:
        """Visual shapes, and the collision shapes of links without any, such as those whose meshes
        are missing.
        """
        visual = self.visual_model.geometryObjects
        drawn_frames = {shape.parentFrame for shape in visual}
        drawn = [*visual]
        for shape in self.collision_model.geometryObjects:
            if shape.parentFrame not in drawn_frames:
                drawn.append(shape)
        return tuple(drawn)

    @property
    def thruster_names(self) -> tuple[str, ...]:
        """Names of the thrusters in the order of thrust."""
        return tuple(thruster.name for thruster in self.description.thrusters)

    @property
    def tools(self) -> tuple[str, ...]:
        """Frames of the tools, one for each arm; the first is the frame ``tool``."""
        tools = roles.tools_of(self.description)
        if not tools and self.has_frame(roles.TOOL):
            return (roles.TOOL,)
        return tools

    @checked_on_failure
    def arm_shapes(self, tool: str) -> tuple[str, ...]:
        """Return names of the collision shapes on the joints that move a tool, a frame. Raises
        `FrameNotFound`.
        """
        carrier = self.model.frames[self.frame_id(tool)].parentJoint
        first_joint = 2 if self.n_vehicle else 1
        joints = [*self.model.supports[carrier]][first_joint:]
        shapes = self.collision_model.geometryObjects
        return tuple(shape.name for shape in shapes if shape.parentJoint in joints)

    @property
    def vehicle_v(self) -> slice:
        """The vehicle's part of v."""
        return slice(0, self.n_vehicle)

    @property
    def configuration_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper limits (n_q,) [m, rad] of q; infinite where there is none, and for entries
        that belong together, such as a quaternion.
        """
        lower = np.full(self.n_q, -np.inf)
        upper = np.full(self.n_q, np.inf)
        for joint in self.joints:
            if joint.n_q == joint.n_v:
                first = joint.idx_v - self.n_vehicle
                axes = slice(first, first + joint.n_v)
                lower[joint.q] = self.limits.position_lower[axes]
                upper[joint.q] = self.limits.position_upper[axes]
        return lower, upper

    @property
    def limited_positions(self) -> np.ndarray:
        """Indices (n,) in q of the joints that `configuration_bounds` may limit."""
        all_places = np.arange(self.n_q)
        places = [np.zeros(0, dtype=int)]
        for joint in self.joints:
            if joint.n_q == joint.n_v:
                places.append(all_places[joint.q])
        return np.concatenate(places)

    @property
    def joint_v(self) -> slice:
        """The joints' part of v."""
        return slice(self.n_vehicle, self.n_v)

    @property
    def joint_q(self) -> slice:
        """The joints' part of q, where a joint that turns without end has two entries, (cos, sin);
        see `joint_values`.
        """
        return slice(7 if self.n_vehicle else 0, self.n_q)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of all frames, without Pinocchio's universe."""
        return tuple(frame.name for frame in self.model.frames[1:])

    @checked_on_failure
    def has_frame(self, name: str) -> bool:
        """Check whether a frame exists."""
        return name in self.frame_names

    @checked_on_failure
    def frame_id(self, name: str) -> int:
        """Return Pinocchio's index of a frame. Raises ``FrameNotFound`` with the alternatives."""
        if not self.has_frame(name):
            raise FrameNotFound(name, self.frame_names)
        return int(self.model.getFrameId(name))

    @checked_on_failure
    def joint(self, name: str) -> Joint:
        """Return a joint by name. Raises ``NameNotFound`` with the alternatives."""
        require_known("joint", name, self.joint_names)
        return self.joints[self.joint_names.index(name)]

    __getitem__ = joint

    def _ipython_key_completions_(self) -> tuple[str, ...]:
        return self.joint_names

    def with_frame_pose(self, frame: str, X_parent: pin.SE3) -> Robot:
        """Return a copy whose fixed frame sits at ``X_parent`` in the moving link that carries it.

        Frames, shapes and joints on that frame move along; masses fixed to the moving link stay.
        The description of the copy has the new pose in ``loading.frames``, where files may have
        poses too. Raises ``InvalidInput`` for a frame that is itself a moving link, and
        ``FrameNotFound``.
        """
        moved = with_moved_frame(self, frame, X_parent)
        frame_pose = {
            "frame": frame,
            "position": X_parent.translation.tolist(),
            "rpy": pin.rpy.matrixToRpy(X_parent.rotation).tolist(),
        }
        loading = self.description.loading.model_dump()
        loading["frames"] = (*loading["frames"], frame_pose)
        return replace(moved, description=checked_copy(self.description, loading=loading))

    def with_water_density(self, density: float) -> Robot:
        """Return a copy in water of another density [kg/m3].

        Buoyancy and the added mass of shapes change with it; published coefficients and the trim do
        not.
        """
        description = checked_copy(self.description, water_density=density)
        return replace(
            self, description=description, hydrodynamics=coefficients.links_in_water(description)
        )

    @checked_on_failure
    def configuration(
        self,
        position: ArrayLike | None = None,
        rpy: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        joints: ArrayLike | Mapping[str, float] | None = None,
    ) -> np.ndarray:
        """Return a checked q (n_q,); parts left out are zero for the vehicle and ``home`` for the
        joints.

        ``position`` (3,) [m] p_WB; ``rpy`` (3,) [rad], R = Rz Ry Rx, or ``quaternion`` (4,) xyzw;
        ``joints`` (n_joints,) [rad or m], or values by name on top of ``home``. Raises
        ``InvalidInput`` for a wrong shape or what `check_configuration` refuses, and
        ``NameNotFound`` for an unknown joint.
        """
        vehicle_part = _vehicle_part(self, position, rpy, quaternion)
        joint_part = _joint_part(self, joints)
        return _checked(self, np.concatenate([vehicle_part, joint_part]))

    @checked_on_failure
    def joint_values(self, q: Annotated[np.ndarray, Shape("self.n_q")]) -> np.ndarray:
        """Return one number per degree of freedom of the joints (n_joints,) [rad or m] at q (n_q,)
        [m, rad].

        Joints that turn without end are from -pi to pi.
        """
        q = np.asarray(q, dtype=float)
        motion = pin.difference(self.model, pin.neutral(self.model), q)
        return np.asarray(motion[self.n_vehicle :])

    @checked_on_failure
    def with_joint_values(
        self,
        q: Annotated[np.ndarray, Shape("self.n_q")],
        values: Annotated[np.ndarray, Shape("self.n_joints")],
    ) -> np.ndarray:
        """Return q (n_q,) [m, rad] with its joints at `values` (n_joints,) [rad or m], which may be
        beyond the limits.
        """
        return from_joint_values(self.model, values, q)

    @checked_on_failure
    def check_configuration(self, q: ArrayLike) -> np.ndarray:
        """Return q (n_q,) [m, rad] as a read-only array. Raises ``InvalidInput`` for a wrong size, a
        norm that is not 1, or a joint beyond its limits.
        """
        return _checked(self, q)


def with_moved_frame(robot: Robot, frame: str, X_parent: pin.SE3) -> Robot:
    """Return a copy as `Robot.with_frame_pose` does, with the description unchanged."""
    index = robot.frame_id(frame)
    check_movable(robot.model, index)
    moved = frames_fixed_to(robot.model, index)
    shift = X_parent * robot.model.frames[index].placement.inverse()
    return replace(
        robot,
        model=shifted_frames(robot.model, moved, shift),
        visual_model=shifted_shapes(robot.visual_model, moved, shift),
        collision_model=shifted_shapes(robot.collision_model, moved, shift),
    )


def _vehicle_part(
    robot: Robot, position: ArrayLike | None, rpy: ArrayLike | None, quaternion: ArrayLike | None
) -> np.ndarray:
    """Return [p_WB, quaternion] (7,), or (0,) for a fixed base.

    position (3,) [m]; rpy (3,) [rad] or quaternion (4,) xyzw. Raises `InvalidInput` for both of
    them, a wrong shape, or any of the three with a fixed base.
    """
    if not robot.n_vehicle:
        if position is not None or rpy is not None or quaternion is not None:
            joints = ", ".join(robot.joint_names) or "it has none"
            raise InvalidInput(f"robot {robot.name!r} has a fixed base; give joints only: {joints}")
        return np.zeros(0)
    p_WB = np.zeros(3)
    if position is not None:
        p_WB = finite_array("position", position, (3,))
    return np.concatenate([p_WB, _orientation(rpy, quaternion)])


def _joint_part(robot: Robot, joints: ArrayLike | Mapping[str, float] | None) -> np.ndarray:
    """Return the joint part of q from `joints`: one value per degree of freedom (n_joints,) [rad or
    m], or by name on ``home``.

    Raises `InvalidInput` for a wrong shape and `NameNotFound` for an unknown joint.
    """
    values = robot.home.copy()
    if isinstance(joints, Mapping):
        for name, value in joints.items():
            joint = robot.joint(name)
            first = joint.idx_v - robot.n_vehicle
            values[first : first + joint.n_v] = value
    elif joints is not None:
        values = finite_array("joints", joints, (robot.n_joints,))
    return from_joint_values(robot.model, values)[robot.joint_q]


def _checked(robot: Robot, q: ArrayLike) -> np.ndarray:
    """Return q (n_q,) [m, rad] read-only. Raises `InvalidInput` as `Robot.check_configuration`."""
    array = finite_array("q", q, (robot.n_q,))
    if robot.n_vehicle:
        _check_unit("q: its quaternion", array[3:7])
    for joint in robot.joints:
        values = array[joint.q]
        if joint.n_q != joint.n_v:
            _check_unit(f"(cos, sin) of joint {joint.name!r}", values[-2:])
            continue
        for i, value in enumerate(values, start=joint.idx_v - robot.n_vehicle):
            lower = robot.limits.position_lower[i]
            upper = robot.limits.position_upper[i]
            if not lower - _LIMIT_TOLERANCE <= value <= upper + _LIMIT_TOLERANCE:
                raise InvalidInput(
                    f"joint {joint.name!r}: given {value:.6g}; allowed: {lower:.6g} to {upper:.6g}"
                )
    return array


def _orientation(rpy: ArrayLike | None, quaternion: ArrayLike | None) -> np.ndarray:
    """Return the quaternion (4,) xyzw from rpy (3,) [rad] or quaternion (4,); by default that of no
    rotation. Raises `InvalidInput`.
    """
    if rpy is not None and quaternion is not None:
        raise InvalidInput("give either rpy or quaternion, not both")
    if quaternion is not None:
        return finite_array("quaternion", quaternion, (4,))
    angles = np.zeros(3)
    if rpy is not None:
        angles = finite_array("rpy", rpy, (3,))
    return np.asarray(pin.Quaternion(pin.rpy.rpyToMatrix(angles)).coeffs())


def _check_unit(what: str, values: np.ndarray) -> None:
    """Raise `InvalidInput` for values (n,) whose norm is not 1."""
    norm = float(np.linalg.norm(values))
    if abs(norm - 1.0) > _UNIT_TOLERANCE:
        raise InvalidInput(f"{what} has norm {norm:.6g}; allowed: 1, divide it by its norm")


def require_normalized(model: pin.Model, q: ArrayLike) -> None:
    """Raise `InvalidInput` where q (..., n_q) [m, rad] has a quaternion or (cos, sin) whose norm is
    not 1; rows with NaN pass.
    """
    for row in np.reshape(np.asarray(q, dtype=float), (-1, model.nq)):
        if not pin.isNormalized(model, row, _UNIT_TOLERANCE) and np.isfinite(row).all():
            raise InvalidInput(
                "q has a quaternion, or (cos, sin) of a joint, whose norm is not 1; divide it by"
                " its norm"
            )
