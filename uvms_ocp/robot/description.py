"""Schema and reader of ``robots/<name>/hydrodynamics.yaml``: what a URDF cannot say about a robot
under water.

North-east-down data become forward-left-up here, once; nothing after it knows of the other axes.

SI units throughout; angles in rad. Vectors are in the link's own frame, forward-left-up unless the
file says ``convention: NED``. ``RobotDescription.model_json_schema()`` is the same schema for
editors and other tools.
"""

from __future__ import annotations

import logging
import math
from collections import Counter
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import Field, ValidationError, ValidationInfo, field_validator, model_validator

from uvms_ocp.errors import InvalidInput, RobotDataError
from uvms_ocp.model_errors import FileModel, one_line, problems_of
from uvms_ocp.record.yaml_file import BoundedLoader, read_yaml
from uvms_ocp.robot.hydrodynamics import (
    check_added_mass,
    check_flow_drag,
    check_linear_drag,
    check_quadratic_drag,
)

_log = logging.getLogger(__name__)

NonNegative = Annotated[float, Field(ge=0.0)]
Positive = Annotated[float, Field(gt=0.0)]
# [m]; larger numbers are millimetres by mistake
Coordinate = Annotated[float, Field(ge=-50.0, le=50.0)]
Point = tuple[Coordinate, Coordinate, Coordinate]
Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
NonNegative6 = tuple[NonNegative, NonNegative, NonNegative, NonNegative, NonNegative, NonNegative]
Positive6 = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
Channel = Literal[
    "position",
    "depth",
    "attitude",
    "angular_velocity",
    "linear_velocity",
    "joint_positions",
    "joint_velocities",
    "altimeter_range",
    "specific_force",
]
Matrix6 = tuple[Vector6, Vector6, Vector6, Vector6, Vector6, Vector6]

DragBy = Annotated[
    Literal["axes", "flow"],
    Field(
        description=(
            "quadratic drag of translation counts the speed along each axis, or of the whole flow:"
            " the same on axes"
        )
    ),
]

_ROUNDED = 0.01  # relative: what is further apart is no rounding, however few digits there are

# A half turn about x: a rotation, so twists and wrenches turn like any other vectors.
_TURN6 = np.kron(np.eye(2), np.diag([1.0, -1.0, -1.0]))

_VECTORS = ("position", "rpy", "direction", "centre_of_buoyancy")
_MATRICES = ("added_mass", "linear_drag", "quadratic_drag")


class _Section(FileModel, allow_inf_nan=False, use_attribute_docstrings=True):
    """A part of the file: unknown keys, NaN and infinity are refused, values cannot be changed."""


class Pose(_Section):
    """Pose of a coefficient frame in the frame of its link."""

    position: Point = (0.0, 0.0, 0.0)
    """origin [m]"""
    rpy: Vector3 = (0.0, 0.0, 0.0)
    """roll, pitch, yaw [rad], R = Rz Ry Rx"""


class LinkCoefficients(_Section):
    """Hydrodynamic coefficients of one link, linear axes before angular ones."""

    pose: Pose = Pose()
    """frame of added mass and drag, in the link frame"""
    added_mass: Vector6 | Matrix6 = (0.0,) * 6
    """diagonal (6) or full matrix (6x6) [kg, kg m, kg m2], symmetric, not indefinite"""
    linear_drag: Vector6 | Matrix6 = (0.0,) * 6
    """diagonal (6) or full matrix (6x6) [N/(m/s), N m/(rad/s)], dissipative"""
    quadratic_drag: NonNegative6 | Matrix6 = (0.0,) * 6
    """factor of v|v| per axis (6), >= 0, or full matrix (6x6), dissipative [N/(m/s)^2, N m/(rad/s)^2]"""
    drag_by: DragBy = "axes"
    volume: float = Field(default=0.0, ge=0.0, le=1e4)
    """displaced volume [m3]"""
    centre_of_buoyancy: Point | None = None
    """in the link frame [m]; needs a volume"""

    @field_validator("added_mass")
    @classmethod
    def _added_mass_is_an_inertia(cls, value: Vector6 | Matrix6) -> Vector6 | Matrix6:
        value = symmetric_within_rounding(value)
        check_added_mass(as_matrix6(value))
        return value

    @field_validator("linear_drag", "quadratic_drag")
    @classmethod
    def _drag_dissipates(cls, value: Vector6 | Matrix6, info: ValidationInfo) -> Vector6 | Matrix6:
        if info.field_name == "linear_drag":
            check_linear_drag(as_matrix6(value))
        else:
            check_quadratic_drag(np.zeros((6, 6)), as_matrix6(value))
        return value

    @model_validator(mode="after")
    def _drag_by_the_flow_is_a_diagonal_and_buoyancy_has_a_volume(self) -> LinkCoefficients:
        check_flow_drag(as_matrix6(self.quadratic_drag), self.drag_by == "flow", "quadratic_drag ")
        if self.centre_of_buoyancy is not None and self.volume == 0.0:
            raise ValueError("centre_of_buoyancy without volume; allowed: volume > 0 m3")
        return self


class _ShapeBase(_Section):
    """Common part of the shape rules."""

    pose: Pose = Pose()
    """centre and axes of the shape, in the link frame"""
    skin_drag: NonNegative = 0.4
    """linear drag of translation [N/(m/s)]"""
    drag_coefficient: float = Field(default=0.6, ge=0.0, le=5.0)
    """C_D on the frontal area [-]"""
    drag_by: DragBy = "axes"


class Cylinder(_ShapeBase):
    """Cylinder rule; the axis is z of ``pose``."""

    radius: float = Field(gt=0.0, le=10.0)
    """[m]"""
    length: float = Field(gt=0.0, le=100.0)
    """[m]"""
    axial_added_mass: float = Field(default=0.1, ge=0.0, le=1.0)
    """axial share of the displaced mass [-]"""


class Box(_ShapeBase):
    """Box rule; the sides are along the axes of ``pose``."""

    size: tuple[Positive, Positive, Positive]
    """full side lengths [m]"""


class Sphere(_ShapeBase):
    """Sphere rule."""

    radius: float = Field(gt=0.0, le=10.0)
    """[m]"""


class LinkDescription(_Section):
    """Water on one link: exactly one of the four keys."""

    coefficients: LinkCoefficients | None = None
    cylinder: Cylinder | None = None
    box: Box | None = None
    sphere: Sphere | None = None

    @model_validator(mode="after")
    def _exactly_one_way(self) -> LinkDescription:
        sources = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(sources) != 1:
            raise ValueError(
                f"give exactly one of coefficients, cylinder, box, sphere; given: {sources}"
            )
        return self


class TrimBody(_Section):
    """A float or a ballast weight fixed to a link; it adds mass and volume, no drag."""

    name: str
    link: str = "base_link"
    position: Point
    """centre, in the link frame [m]"""
    mass: float = Field(ge=0.0, le=1e6)
    """[kg]"""
    volume: float = Field(ge=0.0, le=1e4)
    """displaced volume [m3]"""


class Power(_Section):
    """Electrical power of a thruster, ``watts (|T| / thrust) ** exponent``."""

    thrust: float = Field(gt=0.0, le=1e6)
    """reference thrust [N]"""
    watts: float = Field(gt=0.0, le=1e8)
    """power at the reference thrust [W]"""
    exponent: float = Field(default=1.5, ge=1.0, le=3.0)
    """[-]"""


class Thruster(_Section):
    """One thruster fixed to a link."""

    name: str
    link: str = "base_link"
    position: Point
    """in the link frame [m]"""
    direction: Vector3
    """of positive thrust on the vehicle, in the link frame; any length from 1e-9 to 1e9"""
    minimum: float = Field(ge=-1e6, le=0.0)
    """thrust limit [N]"""
    maximum: float = Field(ge=0.0, le=1e6)
    """thrust limit [N]; 0 for a thruster that pushes against its direction alone"""
    time_constant: float = Field(ge=0.0, le=10.0)
    """first-order lag [s]; 0 is instantaneous"""
    dead_zone: NonNegative = 0.0
    """commands smaller than this give no thrust [N]"""
    curve: tuple[tuple[float, float], ...] = ()
    """(command [-], thrust [N]) points, commands increasing, thrust never falling; empty is linear
    between the limits
    """
    power: Power | None = None

    @field_validator("direction")
    @classmethod
    def _direction_is_not_zero(cls, value: Vector3) -> Vector3:
        if not 1e-9 <= math.hypot(*value) <= 1e9:
            raise ValueError("direction must have a length from 1e-9 to 1e9")
        return value

    @field_validator("curve")
    @classmethod
    def _curve_increases(
        cls, value: tuple[tuple[float, float], ...]
    ) -> tuple[tuple[float, float], ...]:
        if not value:
            return value
        (command, thrust) = np.transpose(value)
        n = len(value)
        wrong = np.flatnonzero((np.diff(command) <= 0.0) | (np.diff(thrust) < 0.0))
        if len(wrong):
            rule = "curve needs increasing commands and thrust that never falls"
            raise ValueError(f"{rule}; point {wrong[0] + 2}, {list(value[wrong[0] + 1])}, does not")
        if n < 2 or thrust[0] == thrust[-1]:
            raise ValueError("curve needs two or more points of different thrust")
        return value

    @model_validator(mode="after")
    def _dead_zone_is_inside_the_limits(self) -> Thruster:
        if self.largest_thrust == 0.0:
            raise ValueError("maximum or minimum must differ from 0 N")
        if self.dead_zone >= self.largest_thrust:
            raise ValueError(
                f"dead_zone {self.dead_zone} N outside [0, {self.largest_thrust} N), what it can"
                " give"
            )
        return self

    @property
    def largest_thrust(self) -> float:
        """Largest thrust in either direction [N]."""
        return max(self.maximum, -self.minimum)


class VehicleLimits(_Section):
    """Limits of the vehicle: surge, sway, heave, roll, pitch, yaw rates in the body frame."""

    velocity: Positive6
    """[m/s, rad/s]"""
    acceleration: Positive6
    """[m/s2, rad/s2]"""


class JointDescription(_Section):
    """Home, acceleration limit and rotor of a joint, which the URDF lacks."""

    home: float | None = None
    """stowed position [rad or m]; left out: 0, or mid-range where 0 is not allowed"""
    acceleration: Positive | None = None
    """limit [rad/s2 or m/s2]; none is unlimited"""
    rotor_inertia: NonNegative = 0.0
    """of the motor, as the joint feels it: times the reduction squared [kg m2 or kg]"""


class SensorDescription(_Section):
    """One channel of the sensors; what is left out has the default of
    `uvms_ocp.robot.signals.SensorSpecs`.
    """

    rate: Positive | None = None
    """[Hz]"""
    sigma: NonNegative | None = None
    """standard deviation of the noise [unit of the channel]"""
    bias: float | tuple[float, ...] | None = None
    """constant error [unit of the channel]"""
    delay: NonNegative | None = None
    """[s]"""
    dropout: float | None = Field(default=None, ge=0.0, le=1.0)
    """probability that a reading is lost [-]"""


class FramePlacement(Pose):
    """Another place of a frame that is fixed to a link."""

    frame: str


class LoadingDescription(_Section):
    """Options of reading the URDF; options of commands with the same names take their place."""

    packages: tuple[str, ...] = ()
    """folders with the packages of meshes, from this file's"""
    meshes: Literal["yes", "no"] = "yes"
    """no: shapes that are meshes are left out"""
    mimic: Literal["coupled", "free", "fixed"] = "coupled"
    """joints that mimic another one: one with it, of their own, or fixed where its lock, or home,
    puts them
    """
    lock: dict[str, float] = Field(default={})
    """joints that do not move, with their position [rad or m]"""
    drop: tuple[str, ...] = ()
    """links that are left out, with all that hangs on them"""
    frames: tuple[FramePlacement, ...] = ()
    """fixed frames moved, one after the other, to a pose in the moving link that carries them"""


class RobotDescription(_Section):
    """The whole file."""

    base: Literal["free_flyer", "fixed"] = "free_flyer"
    base_link: str | None = None
    """link that stands for the vehicle; left out: base_link, or the root"""
    tool: str | tuple[str, ...] | None = None
    """frame of the tool, of several arms one each; left out: tool, or the only end of a chain"""
    loading: LoadingDescription = LoadingDescription()
    convention: Literal["FLU", "NED"] = "FLU"
    """axes of every vector and matrix in links"""
    water_density: float = Field(default=998.0, ge=900.0, le=1300.0)
    """[kg/m3], fresh 998, sea 1025"""
    altimeter: str | None = None
    """frame of the range sensor, which looks along its -z"""
    dvl: str | None = None
    """frame of the Doppler velocity log; its readings are carried to base_link"""
    vehicle_limits: VehicleLimits | None = None
    joints: dict[str, JointDescription] = Field(default={})
    """by joint name"""
    joint_efficiency: float = Field(default=0.6, gt=0.0, le=1.0)
    """mechanical / electrical power [-]"""
    links: dict[str, LinkDescription] = Field(default={})
    """by link name; links left out are dry, with a warning"""
    trim: tuple[TrimBody, ...] = ()
    """floats and ballast"""
    thrusters: tuple[Thruster, ...] = ()
    sensors: dict[Channel, SensorDescription | None] = Field(default={})
    """by channel; null is a robot without this sensor"""

    @field_validator("trim", "thrusters")
    @classmethod
    def _names_are_unique(
        cls, value: tuple[TrimBody | Thruster, ...]
    ) -> tuple[TrimBody | Thruster, ...]:
        names = [entry.name for entry in value]
        if len(set(names)) != len(names):
            raise ValueError(f"names must be unique; given: {names}")
        return value


def as_matrix6(value: Vector6 | Matrix6) -> np.ndarray:
    """Return (6, 6) from a diagonal or a full matrix."""
    array = np.array(value, dtype=float)
    if array.ndim == 1:
        return np.diag(array)
    return array


def symmetric_within_rounding(value: Vector6 | Matrix6) -> Vector6 | Matrix6:
    """Return the mean of both halves of a matrix whose entries differ by one unit of their last
    written digit at most.

    Other differences are left as they are.
    """
    array = np.array(value, dtype=float)
    if array.ndim == 1 or (array == array.T).all():
        return value
    units = np.array([_last_digit(number) for number in array.ravel().tolist()])
    units = units.reshape(array.shape)
    difference = np.abs(array - array.T)
    size = np.minimum(np.abs(array), np.abs(array.T))
    allowed = np.minimum(1.001 * np.maximum(units, units.T), _ROUNDED * size)
    symmetric = np.where(difference <= allowed, array / 2 + array.T / 2, array)
    return tuple(tuple(row) for row in symmetric.tolist())  # type: ignore[return-value]


def _last_digit(number: float) -> float:
    """Return the unit of the last digit of a number as it is written, 0.01 of 55.12."""
    exponent = int(Decimal(repr(number)).normalize().as_tuple().exponent)
    return 10.0 ** min(exponent, 0)


def checked_copy(description: RobotDescription, **changes: object) -> RobotDescription:
    """Return a copy with other top-level values, validated. Raises ``InvalidInput``."""
    try:
        return RobotDescription.model_validate({**dict(description), **changes})
    except ValidationError as error:
        raise InvalidInput(one_line(error, RobotDescription)) from None


def read_description(path: Path, variant: Path | None = None) -> RobotDescription:
    """Read and validate one YAML file; every mistake is a one-line ``RobotDataError``.

    The keys of ``variant``, a file of the same schema with some of its keys, replace those of the
    first file.
    """
    content = _read_mapping(path)
    if variant is not None:
        content = _overlaid(content, _read_mapping(variant))
    try:
        description = RobotDescription.model_validate(content)
    except ValidationError as error:
        raise RobotDataError(variant or path, *problems_of(error, RobotDescription)) from None
    for name, link in description.links.items():
        if not link.coefficients:
            continue
        written = content["links"][name].get("coefficients", {}) or {}
        written_mass = written.get("added_mass", (0.0,) * 6)
        if not np.array_equal(written_mass, link.coefficients.added_mass):
            _log.warning(
                "%s: links.%s.coefficients.added_mass: symmetric but for a last digit; the mean of"
                " both is taken",
                path,
                name,
            )
    return description


def _read_mapping(path: Path) -> dict[str, Any]:
    try:
        content = read_yaml(path, _RobotFile)
    except OSError as error:
        raise RobotDataError(path, f"cannot be read ({error.strerror or error})") from None
    except ValueError as error:
        raise RobotDataError(path, str(error)) from None
    if not isinstance(content, dict):
        raise RobotDataError(
            path, "the file must hold keys and values; it is empty or a bare value"
        )
    return content


def _overlaid(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Return the keys of both, those of `above` in place of those of `below`, section by section."""
    merged = dict(below)
    for key, value in above.items():
        if isinstance(value, dict) and isinstance(below.get(key), dict):
            merged[key] = _overlaid(below[key], value)
        else:
            merged[key] = value
    return merged


class _RobotFile(BoundedLoader):
    """PyYAML silently keeps the last of two equal keys; a robot file must not hide a value."""

    most_values = 50_000  # a robot of a hundred links has some 5,000


def _mapping_with_unique_keys(loader: _RobotFile, node: yaml.MappingNode) -> dict[Any, Any]:
    keys = [loader.construct_object(key, deep=True) for key, _ in node.value]
    mapping = loader.construct_mapping(node, deep=True)  # refuses keys that cannot be counted
    repeated = sorted(str(key) for key, n in Counter(keys).items() if n > 1)
    if repeated:
        raise yaml.constructor.ConstructorError(
            None, None, f"repeated key {repeated[:3]}", node.start_mark
        )
    return mapping


def _word(loader: _RobotFile, node: yaml.ScalarNode) -> str:
    """Read yes, no, true, ... as words: nothing in the file is true or false, and true must not
    pass as 1.0.
    """
    return str(loader.construct_scalar(node))


_RobotFile.add_constructor("tag:yaml.org,2002:bool", _word)
_RobotFile.add_constructor(
    yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _mapping_with_unique_keys
)


def forward_left_up(description: RobotDescription) -> RobotDescription:
    """Return the same robot with ``convention: FLU``: north-east-down data are turned once, and
    nothing after it knows of the other axes.
    """
    if description.convention == "FLU":
        return description
    turned: dict[str, Any] = {"convention": "FLU"}
    for name in ("links", "trim", "thrusters"):
        turned[name] = _turned(getattr(description, name))
    return description.model_copy(update=turned)


def _turned(value: Any, name: str = "") -> Any:
    """Return the value of a key of that name in forward-left-up axes: vectors, matrices, and
    sections and entries that have some.
    """
    if isinstance(value, _Section):
        return value.model_copy(update={key: _turned(part, key) for key, part in value})
    if isinstance(value, dict):
        return {key: _turned(part) for key, part in value.items()}
    if name in _VECTORS and value is not None:
        x, y, z = value
        return (x, -y, -z)
    if name in _MATRICES and np.ndim(value) == 2:
        return tuple(tuple(row) for row in (_TURN6 @ np.array(value) @ _TURN6).tolist())
    if isinstance(value, tuple) and name not in _MATRICES:
        return tuple(map(_turned, value))
    return value
