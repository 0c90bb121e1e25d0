"""The robot as a value: mechanism, shapes, limits and the description of the water on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.arguments import Range, checked, late
from uvms_ocp.exceptions import FrameNotFound, NameNotFound
from uvms_ocp.model import frames
from uvms_ocp.model.configuration import ConfigurationSpace
from uvms_ocp.model.files.description import RobotDescription, checked_copy
from uvms_ocp.model.limits import Joint, Limits
from uvms_ocp.model.water.coefficients import links_in_water
from uvms_ocp.model.water.hydrodynamics import LinkHydrodynamics
from uvms_ocp.shown.small_table import SmallTable


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Robot:
    """A vehicle with an arm, or a fixed-base arm; see `uvms_ocp.model.loading.load_robot`.

    For a free-flyer ``q`` is Pinocchio's [p_WB, quaternion xyzw, joints] and ``v`` is [v_B, omega_B, joint
    rates]; W has z up. ``model`` and the geometry models are shared between copies and must not be changed.
    """

    name: str
    model: pin.Model
    visual_model: pin.GeometryModel
    collision_model: pin.GeometryModel
    description: RobotDescription
    joints: tuple[Joint, ...]
    """Arm joints of a free-flyer, all joints otherwise."""
    limits: Limits
    home: Annotated[np.ndarray, Range(open=True)]
    """(n_q - 7,) or (n_q,) [rad or m] stowed posture, the joint part of q."""
    hydrodynamics: tuple[LinkHydrodynamics, ...]
    """Links in water; floats and ballast add their volume."""

    def __repr__(self) -> str:
        base = "free-flyer" if self.n_vehicle else "fixed base"
        return f"Robot({self.name!r}, {base}, {self.n_joints} joints, {len(self.description.thrusters)} thrusters)"

    def _repr_html_(self) -> str:
        limits = zip(self.limits.position_lower, self.limits.position_upper, strict=True)
        rows = [
            (joint.name, f"{low:.4g}", f"{high:.4g}") for joint, (low, high) in zip(self.joints, limits, strict=False)
        ]
        return SmallTable(title=repr(self), head=("joint", "lower", "upper"), rows=tuple(rows)).html()

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
        return 6 if self.description.base == "free_flyer" else 0

    @property
    def n_joints(self) -> int:
        """Velocity degrees of freedom of the joints."""
        return self.n_v - self.n_vehicle

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in the order of q."""
        return tuple(joint.name for joint in self.joints)

    @property
    def thruster_names(self) -> tuple[str, ...]:
        """Names of the thrusters in the order of thrust."""
        return tuple(thruster.name for thruster in self.description.thrusters)

    @property
    def vehicle_v(self) -> slice:
        """The vehicle's part of v."""
        return slice(0, self.n_vehicle)

    @property
    def joint_v(self) -> slice:
        """The joints' part of v."""
        return slice(self.n_vehicle, self.n_v)

    @property
    def joint_q(self) -> slice:
        """The joints' part of q."""
        return slice(self.n_q - len(self.home), self.n_q)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of all frames, without Pinocchio's universe."""
        return tuple(frame.name for frame in self.model.frames[1:])

    @late
    def has_frame(self, name: str) -> bool:
        """Tell whether the frame exists."""
        return name in self.frame_names

    @late
    def frame_id(self, name: str) -> int:
        """Return Pinocchio's index of a frame. Raises ``FrameNotFound`` with the alternatives."""
        if not self.has_frame(name):
            raise FrameNotFound(name, self.frame_names)
        return int(self.model.getFrameId(name))

    @late
    def joint(self, name: str) -> Joint:
        """Return a joint by name. Raises ``NameNotFound`` with the alternatives."""
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise NameNotFound("joint", name, self.joint_names)

    def with_frame_pose(self, frame: str, X_parent: pin.SE3) -> Robot:
        """Return a copy whose fixed frame sits at ``X_parent`` in the moving link that carries it.

        Frames, shapes and joints on that frame move along; masses fixed to the moving link stay. Raises
        ``InvalidInput`` for a frame that is itself a moving link, and ``FrameNotFound``.
        """
        index = self.frame_id(frame)
        frames.check_movable(self.model, index)
        moved = frames.frames_fixed_to(self.model, index)
        shift = X_parent * self.model.frames[index].placement.inverse()
        return replace(
            self,
            model=frames.shifted_frames(self.model, moved, shift),
            visual_model=frames.shifted_shapes(self.visual_model, moved, shift),
            collision_model=frames.shifted_shapes(self.collision_model, moved, shift),
        )

    def with_water_density(self, density: float) -> Robot:
        """Return a copy in water of another density [kg/m3].

        Buoyancy and the added mass of shapes follow it, published coefficients and the trim do not.
        """
        description = checked_copy(self.description, water_density=density)
        return replace(self, description=description, hydrodynamics=links_in_water(description))

    @late
    def configuration(
        self,
        position: ArrayLike | None = None,
        rpy: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        joints: ArrayLike | Mapping[str, float] | None = None,
    ) -> np.ndarray:
        """Return a checked q (n_q,); parts left out are zero for the vehicle and ``home`` for the joints.

        ``position`` (3,) [m] p_WB; ``rpy`` (3,) [rad], R = Rz Ry Rx, or ``quaternion`` (4,) [-] xyzw; ``joints``
        (n_joints,) [rad or m], or values by name on top of ``home``. Raises ``InvalidInput`` for a wrong shape or what
        `check_configuration` refuses, and ``NameNotFound`` for an unknown joint.
        """
        space = self._space
        return space.checked(np.concatenate([space.vehicle_part(position, rpy, quaternion), space.joint_part(joints)]))

    @late
    def check_configuration(self, q: ArrayLike) -> np.ndarray:
        """Return q (n_q,) [m, rad] as a read-only array. Raises ``InvalidInput`` naming what is wrong."""
        return self._space.checked(q)

    @property
    def _space(self) -> ConfigurationSpace:
        return ConfigurationSpace(
            name=self.name, model=self.model, joints=self.joints, limits=self.limits, home=self.home
        )
