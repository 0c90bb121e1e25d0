"""The robot as a value: mechanism, shapes, limits and the description of the water on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from uvms_ocp.exceptions import FrameNotFound, InvalidInput, NameNotFound, RobotDataError
from uvms_ocp.model import configuration, frames
from uvms_ocp.model.coefficients import links_in_water
from uvms_ocp.model.conventions import forward_left_up
from uvms_ocp.model.description import RobotDescription, TrimBody, checked_copy, read_description
from uvms_ocp.model.hydrodynamics import LinkHydrodynamics
from uvms_ocp.model.library import list_robots as list_robots
from uvms_ocp.model.library import list_variants as list_variants
from uvms_ocp.model.library import robot_folder, variant_file
from uvms_ocp.model.limits import Joint as Joint
from uvms_ocp.model.limits import Limits as Limits
from uvms_ocp.model.limits import home_of, joints_of, limits_of
from uvms_ocp.model.urdf import UrdfModels, read_urdf


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Robot:
    """A vehicle with an arm, or a fixed-base arm; see ``load_robot``.

    For a free-flyer ``q`` is Pinocchio's [p_WB, quaternion xyzw, joints] and ``v`` is [v_B, omega_B, joint
    rates]; W has z up. ``model`` and the geometry models are shared between copies and must not be changed.
    """

    name: str
    model: pin.Model
    visual_model: pin.GeometryModel
    collision_model: pin.GeometryModel
    description: RobotDescription
    joints: tuple[Joint, ...]  # arm joints of a free-flyer, all joints otherwise
    limits: Limits
    home: np.ndarray  # (n_q - 7,) or (n_q,) stowed posture, the joint part of q
    hydrodynamics: tuple[LinkHydrodynamics, ...]  # links in water; floats and ballast add their volume

    def __repr__(self) -> str:
        base = "free-flyer" if self.n_vehicle else "fixed base"
        return f"Robot({self.name!r}, {base}, {self.n_joints} joints, {len(self.description.thrusters)} thrusters)"

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

    def has_frame(self, name: str) -> bool:
        """Tell whether the frame exists."""
        return name in self.frame_names

    def frame_id(self, name: str) -> int:
        """Return Pinocchio's index of a frame. Raises ``FrameNotFound`` with the alternatives."""
        if not self.has_frame(name):
            raise FrameNotFound(name, self.frame_names)
        return int(self.model.getFrameId(name))

    def joint(self, name: str) -> Joint:
        """Return a joint by name. Raises ``NameNotFound`` with the alternatives."""
        for joint in self.joints:
            if joint.name == name:
                return joint
        raise NameNotFound("joint", name, self.joint_names)

    def with_frame_pose(self, frame: str, X_parent: pin.SE3) -> Robot:
        """Return a copy whose fixed frame sits at ``X_parent`` in the moving link that carries it.

        Frames, shapes and joints on that frame move along; masses fixed to the moving link stay. Raises
        ``InvalidInput`` for a frame that is itself a moving link.
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

    def configuration(
        self,
        position: ArrayLike | None = None,
        rpy: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        joints: ArrayLike | Mapping[str, float] | None = None,
    ) -> np.ndarray:
        """Return a checked q (n_q,); parts left out are zero for the vehicle and ``home`` for the joints.

        ``position`` (3,) p_WB [m]; ``rpy`` (3,) [rad], R = Rz Ry Rx, or ``quaternion`` (4,) xyzw; ``joints``
        one value per joint degree of freedom [rad or m], or values by name on top of ``home``.
        """
        vehicle = configuration.vehicle_part(self, position, rpy, quaternion)
        return self.check_configuration(np.concatenate([vehicle, configuration.joint_part(self, joints)]))

    def check_configuration(self, q: ArrayLike) -> np.ndarray:
        """Return q (n_q,) as a read-only array. Raises ``InvalidInput`` naming what is wrong."""
        return configuration.checked(self, q)


def load_robot(
    name: str | None = None,
    *,
    urdf: Path | str | None = None,
    hydrodynamics: Path | str | None = None,
    variant: str | None = None,
    base: Literal["free_flyer", "fixed"] | None = None,
    package_dirs: Sequence[Path | str] = (),
) -> Robot:
    """Load a robot by name, or from a URDF file and, if there is one, its hydrodynamics file.

    ``variant`` is another published data set of a named robot, see ``list_variants``. ``base`` overrides the file
    (default: free_flyer). ``package_dirs`` are searched for ``package://`` meshes. Raises ``NameNotFound`` and
    ``RobotDataError``.
    """
    urdf_path, yaml_path = _paths(name, urdf, hydrodynamics)
    description = _description(name, yaml_path, variant)
    if base is not None:
        description = checked_copy(description, base=base)
    free_flyer = description.base == "free_flyer"
    models = read_urdf(urdf_path, free_flyer=free_flyer, package_dirs=[Path(folder) for folder in package_dirs])
    return assemble(models, description, yaml_path or urdf_path, name)


def _paths(name: str | None, urdf: Path | str | None, hydrodynamics: Path | str | None) -> tuple[Path, Path | None]:
    if (name is None) == (urdf is None):
        raise InvalidInput("load_robot needs either a name or urdf=PATH; list_robots() gives the names")
    given = None if hydrodynamics is None else Path(hydrodynamics)
    if name is None:
        return Path(str(urdf)), given
    folder = robot_folder(name)
    return folder / "robot.urdf", given or folder / "hydrodynamics.yaml"


def _description(name: str | None, path: Path | None, variant: str | None) -> RobotDescription:
    if path is None:
        return RobotDescription()
    if variant is None:
        return read_description(path)
    if name is None:
        raise InvalidInput(f"variant {variant!r} without a robot's name; variants belong to named robots")
    return read_description(path, variant_file(name, variant))


def assemble(models: UrdfModels, description: RobotDescription, path: Path, name: str | None = None) -> Robot:
    """Join the mechanism and its description; ``path`` is the file blamed for names that do not fit."""
    description = forward_left_up(description)
    _check_names(models.model, description, path)
    trimmed = replace(models, model=_with_trim(models.model, description.trim))
    robot = robot_of(trimmed, description, name or models.name)
    _check_home(robot, path)
    return robot


def robot_of(models: UrdfModels, description: RobotDescription, name: str) -> Robot:
    """Return the robot of a mechanism that already carries its trim bodies."""
    joints = joints_of(models.model, free_flyer=description.base == "free_flyer")
    limits = limits_of(models.model, description, joints)
    return Robot(
        name=name,
        model=models.model,
        visual_model=models.visual,
        collision_model=models.collision,
        description=description,
        joints=joints,
        limits=limits,
        home=home_of(models.model, description, joints, limits),
        hydrodynamics=links_in_water(description),
    )


def _check_home(robot: Robot, path: Path) -> None:
    try:
        robot.configuration()
    except InvalidInput as error:
        raise RobotDataError(path, f"home: {error}") from None


def _check_names(model: pin.Model, description: RobotDescription, path: Path) -> None:
    known_frames = tuple(frame.name for frame in model.frames[1:])
    altimeter = [("altimeter", description.altimeter)] if description.altimeter else []
    wanted = [
        *(("links", link) for link in description.links),
        *((f"trim {body.name!r} link", body.link) for body in description.trim),
        *((f"thruster {thruster.name!r} link", thruster.link) for thruster in description.thrusters),
        *altimeter,
    ]
    _check_known(path, wanted, known_frames)
    _check_known(path, [("joints", joint) for joint in description.joints], tuple(model.names)[1:])
    _check_thrusters(model, description, path)


def _check_thrusters(model: pin.Model, description: RobotDescription, path: Path) -> None:
    carrier = 1 if description.base == "free_flyer" else 0
    for thruster in description.thrusters:
        if model.frames[model.getFrameId(thruster.link)].parentJoint != carrier:
            problem = f"thruster {thruster.name!r} link: given {thruster.link!r}; allowed: links fixed to the vehicle"
            raise RobotDataError(path, problem)


def _check_known(path: Path, wanted: Sequence[tuple[str, str]], known: Sequence[str]) -> None:
    for key, name in wanted:
        if name not in known:
            raise RobotDataError(path, f"{key}: {name!r} is not in the URDF; allowed: {', '.join(known)}")


def _with_trim(model: pin.Model, trim: Sequence[TrimBody]) -> pin.Model:
    model = model.copy()
    for body in trim:
        joint, inertia = trim_inertia(model, body)
        model.inertias[joint] += inertia
    return model


def trim_inertia(model: pin.Model, body: TrimBody) -> tuple[int, pin.Inertia]:
    """Return the joint that carries a float or ballast, and its point mass in the frame of that joint."""
    frame = model.frames[model.getFrameId(body.link)]
    point_mass = pin.Inertia(body.mass, np.array(body.position), np.zeros((3, 3)))
    return frame.parentJoint, frame.placement.act(point_mass)
