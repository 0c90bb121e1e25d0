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
from uvms_ocp.model.description import RobotDescription, TrimBody, read_description
from uvms_ocp.model.library import list_robots as list_robots
from uvms_ocp.model.library import robot_folder
from uvms_ocp.model.urdf import UrdfModels, read_urdf

_LIMIT_TOLERANCE = 1e-9
_UNIT_TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True, slots=True)
class Joint:
    """Where one joint lives in q and v."""

    name: str
    idx_q: int
    idx_v: int
    n_q: int
    n_v: int


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Limits:
    """Actuator and position limits, infinite where there is none; read-only arrays."""

    position_lower: np.ndarray  # (n_joints,) [rad or m]
    position_upper: np.ndarray  # (n_joints,) [rad or m]
    velocity: np.ndarray  # (n_v,) [m/s, rad/s]
    acceleration: np.ndarray  # (n_v,) [m/s2, rad/s2]
    effort: np.ndarray  # (n_joints,) [N m or N]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Robot:
    """A vehicle with an arm, or a fixed-base arm; see ``load_robot``.

    ``q`` is Pinocchio's [p_WB, quaternion xyzw, joints] and ``v`` [v_B, omega_B, joint rates] for a free-flyer; W has
    z up. ``model`` and the geometry models are shared between copies and must not be changed.
    """

    name: str
    model: pin.Model
    visual_model: pin.GeometryModel
    collision_model: pin.GeometryModel
    description: RobotDescription
    joints: tuple[Joint, ...]  # arm joints of a free-flyer, all joints otherwise
    limits: Limits
    home: np.ndarray  # (n_q - 7 or n_q,) stowed posture, the joint part of q

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

        Frames and shapes fixed to that frame move along; masses stay. Raises ``InvalidInput`` for a frame that is
        itself a moving link.
        """
        index = self.frame_id(frame)
        _check_movable(self.model, index)
        moved = _frames_below(self.model, index)
        shift = X_parent * self.model.frames[index].placement.inverse()
        return replace(
            self,
            model=_shifted_frames(self.model, moved, shift),
            visual_model=_shifted_shapes(self.visual_model, moved, shift),
            collision_model=_shifted_shapes(self.collision_model, moved, shift),
        )

    def configuration(
        self,
        position: ArrayLike | None = None,
        rpy: ArrayLike | None = None,
        quaternion: ArrayLike | None = None,
        joints: ArrayLike | Mapping[str, float] | None = None,
    ) -> np.ndarray:
        """Return a checked q (n_q,) from parts; what is left out is zero for the vehicle, ``home`` for the joints.

        ``position`` (3,) p_WB [m]; ``rpy`` (3,) [rad], R = Rz Ry Rx, or ``quaternion`` (4,) xyzw; ``joints`` one value
        per joint degree of freedom [rad or m], or values by name on top of ``home``.
        """
        vehicle = _vehicle_part(self, position, rpy, quaternion)
        return self.check_configuration(np.concatenate([vehicle, _joint_part(self, joints)]))

    def check_configuration(self, q: ArrayLike) -> np.ndarray:
        """Return q (n_q,) as a read-only array. Raises ``InvalidInput`` naming what is wrong with it."""
        q = _finite("q", q, self.n_q)
        if self.n_vehicle:
            _check_unit("quaternion", q[3:7])
        for joint in self.joints:
            _check_joint(self, joint, q[joint.idx_q : joint.idx_q + joint.n_q])
        return _read_only(q)


def load_robot(
    name: str | None = None,
    *,
    urdf: Path | str | None = None,
    hydrodynamics: Path | str | None = None,
    base: Literal["free_flyer", "fixed"] | None = None,
    package_dirs: Sequence[Path | str] = (),
) -> Robot:
    """Load a robot by name, or from a URDF file and, if there is one, its hydrodynamics file.

    ``base`` overrides the file (default: free_flyer). ``package_dirs`` are searched for ``package://`` meshes. Raises
    ``NameNotFound`` and ``RobotDataError``.
    """
    if (name is None) == (urdf is None):
        raise InvalidInput("load_robot needs either a name or urdf=PATH; use list_robots() for the names")
    urdf_path = Path(urdf) if urdf is not None else robot_folder(str(name)) / "robot.urdf"
    yaml_path = Path(hydrodynamics) if hydrodynamics is not None else _yaml_beside(urdf_path, name)
    description = RobotDescription() if yaml_path is None else read_description(yaml_path)
    if base is not None:
        description = description.model_copy(update={"base": base})
    models = read_urdf(
        urdf_path, free_flyer=description.base == "free_flyer", package_dirs=[Path(d) for d in package_dirs]
    )
    return assemble(models, description, yaml_path or urdf_path, name)


def _yaml_beside(urdf: Path, name: str | None) -> Path | None:
    return urdf.parent / "hydrodynamics.yaml" if name is not None else None


def assemble(models: UrdfModels, description: RobotDescription, path: Path, name: str | None = None) -> Robot:
    """Join the mechanism and its description; ``path`` is the file blamed for names that do not fit."""
    _check_names(models.model, description, path)
    model = _with_trim(models.model, description.trim)
    joints = _joints(model, description)
    return Robot(
        name=name or models.name,
        model=model,
        visual_model=models.visual,
        collision_model=models.collision,
        description=description,
        joints=joints,
        limits=_limits(model, description, joints),
        home=_home(model, description, joints),
    )


def _check_names(model: pin.Model, description: RobotDescription, path: Path) -> None:
    frames = [frame.name for frame in model.frames]
    links = [*description.links, *(part.link for part in (*description.trim, *description.thrusters))]
    wanted = [*links, *([description.altimeter] if description.altimeter else [])]
    for kind, names, known in (
        ("link or frame", wanted, frames),
        ("joint", description.joints, list(model.names)),
    ):
        for unknown in (name for name in names if name not in known):
            raise RobotDataError(
                path, f"{kind} {unknown!r} is not in the URDF; known: {', '.join(known[1:])}"
            )


def _with_trim(model: pin.Model, trim: Sequence[TrimBody]) -> pin.Model:
    model = model.copy()
    for body in trim:
        frame = model.frames[model.getFrameId(body.link)]
        point_mass = pin.Inertia(body.mass, np.array(body.position), np.zeros((3, 3)))
        model.appendBodyToJoint(frame.parentJoint, point_mass, frame.placement)
    return model


def _joints(model: pin.Model, description: RobotDescription) -> tuple[Joint, ...]:
    first = 2 if description.base == "free_flyer" else 1
    return tuple(
        Joint(
            name=model.names[i],
            idx_q=int(model.joints[i].idx_q),
            idx_v=int(model.joints[i].idx_v),
            n_q=int(model.joints[i].nq),
            n_v=int(model.joints[i].nv),
        )
        for i in range(first, model.njoints)
    )


def _limits(model: pin.Model, description: RobotDescription, joints: tuple[Joint, ...]) -> Limits:
    n_vehicle = 6 if description.base == "free_flyer" else 0
    vehicle = description.vehicle_limits
    free = (np.inf,) * n_vehicle
    velocity = np.concatenate(
        [
            free if vehicle is None or not n_vehicle else vehicle.velocity,
            _or_unlimited(model.upperVelocityLimit[n_vehicle:]),
        ]
    )
    acceleration = np.concatenate(
        [
            free if vehicle is None or not n_vehicle else vehicle.acceleration,
            _joint_acceleration(description, joints),
        ]
    )
    lower, upper = _position_limits(model, joints)
    return Limits(
        position_lower=lower,
        position_upper=upper,
        velocity=_read_only(velocity),
        acceleration=_read_only(acceleration),
        effort=_read_only(_or_unlimited(model.upperEffortLimit[n_vehicle:])),
    )


def _or_unlimited(limit: np.ndarray) -> np.ndarray:
    # URDF has no way to say "unlimited" but 0 or leaving the value out.
    return np.where((limit <= 0.0) | (limit > 1e12), np.inf, limit)


def _joint_acceleration(description: RobotDescription, joints: tuple[Joint, ...]) -> list[float]:
    def limit(joint: Joint) -> float:
        entry = description.joints.get(joint.name)
        return np.inf if entry is None or entry.acceleration is None else entry.acceleration

    return [limit(joint) for joint in joints for _ in range(joint.n_v)]


def _position_limits(model: pin.Model, joints: tuple[Joint, ...]) -> tuple[np.ndarray, np.ndarray]:
    def along(limit: np.ndarray, joint: Joint, unlimited: float) -> np.ndarray:
        bounded = joint.n_q == joint.n_v
        values = limit[joint.idx_q : joint.idx_q + joint.n_q] if bounded else np.full(joint.n_v, unlimited)
        return np.where(np.abs(values) > 1e12, unlimited, values)

    empty = np.zeros(0)
    lower = np.concatenate([empty, *(along(model.lowerPositionLimit, joint, -np.inf) for joint in joints)])
    upper = np.concatenate([empty, *(along(model.upperPositionLimit, joint, np.inf) for joint in joints)])
    return _read_only(lower), _read_only(upper)


def _home(model: pin.Model, description: RobotDescription, joints: tuple[Joint, ...]) -> np.ndarray:
    angles = np.zeros(model.nv)
    for joint in joints:
        entry = description.joints.get(joint.name)
        angles[joint.idx_v : joint.idx_v + joint.n_v] = 0.0 if entry is None else entry.home
    n_vehicle_q = 7 if description.base == "free_flyer" else 0
    return _read_only(_from_joint_values(model, angles)[n_vehicle_q:])


def _from_joint_values(model: pin.Model, values: np.ndarray) -> np.ndarray:
    """Return q whose joints are displaced by ``values`` (n_v,) from neutral: the same for every joint type."""
    return pin.integrate(model, pin.neutral(model), values)


def _vehicle_part(
    robot: Robot, position: ArrayLike | None, rpy: ArrayLike | None, quaternion: ArrayLike | None
) -> np.ndarray:
    if not robot.n_vehicle:
        if position is not None or rpy is not None or quaternion is not None:
            raise InvalidInput(f"robot {robot.name!r} has a fixed base; give joints only")
        return np.zeros(0)
    if rpy is not None and quaternion is not None:
        raise InvalidInput("give either rpy or quaternion, not both")
    p = np.zeros(3) if position is None else _finite("position", position, 3)
    if quaternion is not None:
        return np.concatenate([p, _finite("quaternion", quaternion, 4)])
    angles = np.zeros(3) if rpy is None else _finite("rpy", rpy, 3)
    return np.concatenate([p, pin.Quaternion(pin.rpy.rpyToMatrix(angles)).coeffs()])


def _joint_part(robot: Robot, joints: ArrayLike | Mapping[str, float] | None) -> np.ndarray:
    if joints is None:
        return robot.home
    values = np.zeros(robot.n_v)
    if isinstance(joints, Mapping):
        values[robot.joint_v] = _home_values(robot)
        for name, value in joints.items():
            values[robot.joint(name).idx_v] = value
    else:
        values[robot.joint_v] = _finite("joints", joints, robot.n_joints)
    return _from_joint_values(robot.model, values)[robot.joint_q]


def _home_values(robot: Robot) -> np.ndarray:
    q = pin.neutral(robot.model)
    neutral = q.copy()
    q[robot.joint_q] = robot.home
    return pin.difference(robot.model, neutral, q)[robot.joint_v]


def _check_joint(robot: Robot, joint: Joint, values: np.ndarray) -> None:
    if joint.n_q != joint.n_v:
        return _check_unit(f"(cos, sin) of joint {joint.name!r}", values[-2:])
    first = joint.idx_v - robot.n_vehicle
    lower = robot.limits.position_lower[first : first + joint.n_v]
    upper = robot.limits.position_upper[first : first + joint.n_v]
    for value, low, high in zip(values, lower, upper, strict=True):
        if not low - _LIMIT_TOLERANCE <= value <= high + _LIMIT_TOLERANCE:
            raise InvalidInput(f"joint {joint.name!r}: given {value:.6g}; allowed: {low:.6g} to {high:.6g}")
    return None


def _check_unit(what: str, values: np.ndarray) -> None:
    norm = float(np.linalg.norm(values))
    if abs(norm - 1.0) > _UNIT_TOLERANCE:
        raise InvalidInput(f"{what} has norm {norm:.6g}; allowed: 1, divide it by its norm")


def _finite(what: str, values: ArrayLike, size: int) -> np.ndarray:
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise InvalidInput(f"{what}: given {values!r}; allowed: {size} numbers") from None
    if array.shape != (size,):
        raise InvalidInput(f"{what} has shape {array.shape}; allowed: ({size},)")
    if not np.isfinite(array).all():
        raise InvalidInput(
            f"{what} has NaN or infinite entries at {np.flatnonzero(~np.isfinite(array)).tolist()}"
        )
    return array


def _read_only(values: ArrayLike) -> np.ndarray:
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def _check_movable(model: pin.Model, index: int) -> None:
    frame = model.frames[index]
    carrier = model.frames[frame.parentFrame].type
    if pin.FrameType.JOINT in (frame.type, carrier if frame.type == pin.FrameType.BODY else frame.type):
        raise InvalidInput(f"frame {frame.name!r} is a moving link; only frames fixed to a link can be moved")


def _frames_below(model: pin.Model, index: int) -> frozenset[int]:
    moved = {index}
    # Pinocchio appends children after their parents, so one pass finds all descendants.
    for i in range(index + 1, model.nframes):
        frame = model.frames[i]
        if frame.parentFrame in moved and frame.type != pin.FrameType.JOINT:
            moved.add(i)
    return frozenset(moved)


def _shifted_frames(model: pin.Model, moved: frozenset[int], shift: pin.SE3) -> pin.Model:
    model = model.copy()
    for i in moved:
        model.frames[i].placement = shift * model.frames[i].placement
    return model


def _shifted_shapes(shapes: pin.GeometryModel, moved: frozenset[int], shift: pin.SE3) -> pin.GeometryModel:
    shapes = shapes.copy()
    for shape in shapes.geometryObjects:
        if shape.parentFrame in moved:
            shape.placement = shift * shape.placement
    return shapes
