"""Small values that metadata of records are made of."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import chain, pairwise
from types import MappingProxyType
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, model_validator

from uvms_ocp.model_errors import FileModel, one_line_errors

_MESH = "mesh"
N_SIZES: Mapping[str, int] = MappingProxyType(
    {"sphere": 1, "capsule": 2, "cylinder": 2, "cone": 2, "box": 3, "ellipsoid": 3, _MESH: 0}
)
"""Number of sizes of each shape."""
FARTHEST = 1e5
"""[m] largest distance from the origin, and largest size: beyond it single precision, which meshes are
kept in, loses centimetres.
"""
_Metres = Annotated[FiniteFloat, Field(ge=-FARTHEST, le=FARTHEST)]
Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Point = tuple[_Metres, _Metres, _Metres]

PLANTS = ("dynamic", "kinematic")
"""Plants of the toolkit, by name."""
DONE = "done"
"""End of a mission that succeeded."""
ABORT = "abort"
"""End of a mission that was given up."""
OWN_QUANTITIES = (
    "mission.time",
    "phase.time",
    "phase.visits",
    "vehicle.load",
    "mission.energy",
    "phase.energy",
)
"""Quantities that no task measures, for conditions: time since the start of the mission [s], time
since the start of the phase [s], how often the phase has begun, this time included, the net weight
[N] that thrusters bear beyond the robot's own, negative where something lifts, and the electrical
energy [J] of thrusters and joints since the start of the mission and of the phase. Load and energy
are estimated by the controller of forces; without one they are 0.
"""
ENERGIES = OWN_QUANTITIES[4:]
"""Quantities of `OWN_QUANTITIES` that are energies [J]."""
LARGEST = 1e30
"""Largest number of reports and figures: its square is finite, and single precision, which scenes
are kept in, holds it.
"""
Number = Annotated[FiniteFloat, Field(ge=-LARGEST, le=LARGEST)]
UNIT_NORM_TOLERANCE = 1e-3
"""Largest error of the norm of a stored unit quaternion."""


@one_line_errors
class ObstacleMeta(FileModel):
    """One obstacle as files and records keep it: a primitive shape with its sizes, or a mesh with
    its triangles; `uvms_ocp.robot.shapes.obstacles` builds its shape.
    """

    name: Annotated[str, Field(min_length=1)]
    """Name of the obstacle."""
    shape: Literal["sphere", "capsule", "cylinder", "cone", "box", "ellipsoid", "mesh"]
    """Kind of shape."""
    size: tuple[Annotated[FiniteFloat, Field(gt=0.0, le=FARTHEST)], ...] = ()
    """[m] (radius) of a sphere, (radius, length) of a capsule, cylinder or cone along z, (x, y, z)
    of a box, half axes of an ellipsoid; a capsule's length is that of its straight part.
    """
    vertices: tuple[Point, ...] = ()
    """Vertices (n, 3) [m] of a mesh, in its own frame."""
    triangles: tuple[tuple[int, int, int], ...] = ()
    """Indices of the vertices of triangles (m, 3)."""
    position: Point
    """Position of the middle (3,) [m] in W."""
    rpy: Triple = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw (3,) [rad], R = Rz Ry Rx."""

    @model_validator(mode="after")
    def _has_its_sizes(self) -> ObstacleMeta:
        if len(self.size) != N_SIZES[self.shape]:
            raise ValueError(
                f"a {self.shape} has {N_SIZES[self.shape]} sizes, not {len(self.size)}"
            )
        is_mesh = self.shape == _MESH
        corners = [*chain.from_iterable(self.triangles)]
        are_vertices = all(0 <= corner < len(self.vertices) for corner in corners)
        if is_mesh != bool(corners) or not are_vertices:
            raise ValueError(
                "a mesh, and only a mesh, has triangles, with indices from 0 below the number of"
                " vertices"
            )
        return self


class MetaValue(FileModel, ser_json_inf_nan="constants"):
    """Base of all values of metadata: they refuse unknown keys, cannot be changed, and keep infinity
    and NaN in JSON.
    """


class RobotFilesMeta(MetaValue):
    """Paths of the files of a user's robot, and all that they say beside the URDF."""

    urdf: Annotated[str, Field(max_length=4096)] | None
    """Relative to where the record was made, or folder and name alone; `None`: that of the
    library's robot of this name.
    """
    description: str
    """JSON of hydrodynamics.yaml, with what was given in its place."""


class QuantityMeta(MetaValue):
    """One value of a measured quantity."""

    name: str
    """Name, ``task.quantity``."""
    value: float
    """Value [m] or [rad]; NaN where it was not known."""


class ConditionMeta(MetaValue):
    """A limit on a measured quantity."""

    quantity: str
    """Name, ``task.quantity``."""
    limit: Number
    """Limit [m] or [rad], as the quantity."""
    sign: Literal["<", ">"]
    """Side of the limit on which the condition is true."""


class ThresholdMeta(ConditionMeta):
    """A condition that a phase waits for."""

    phase: str
    """Name of the phase."""


class MetConditionMeta(ConditionMeta):
    """A condition that came true."""

    estimated: float
    """Estimated value [m] or [rad], by which the mission went."""
    release: Number | None = None
    """[m] or [rad] up to where it stayed true once it was; `None`: the limit, and in older records.
    """


class EventMeta(MetaValue):
    """Why a phase ended."""

    t: Number
    """Time of the event [s]."""
    source: str
    """Name of the phase that ended."""
    target: str
    """The phase that began, or ``done``, or ``abort``."""
    reason: str
    """The conditions, as estimated, in words, or why the mission is given up."""
    conditions: tuple[MetConditionMeta, ...] = ()
    """All conditions of the transition; empty where the mission is given up, and in older records.
    """
    true_quantities: tuple[QuantityMeta, ...] = ()
    """Quantities at the true state at that moment; empty in older records."""

    @property
    def truth(self) -> dict[str, float]:
        """Values of `true_quantities` [m] or [rad] by their names."""
        return {item.name: item.value for item in self.true_quantities}


class AlarmMeta(MetaValue):
    """Alarm of the watchdog, or of the monitor of the sensors, which names the channel first."""

    t: Number
    """Time of the alarm [s]."""
    text: str
    """Text of the alarm."""


class FaultMeta(MetaValue):
    """Fault that was injected."""

    text: str
    """The fault in the words of the command line, ``TARGET:KIND=VALUES@ONSET-END``."""
    target: str
    """Name of the channel, actuator or part of the environment that fails."""
    kind: str
    """Kind of fault."""
    t: Annotated[Number, Field(ge=0.0)]
    """Time [s] from which it was there."""
    end: Number | None = None
    """Time [s] until which it was there; `None`: for ever."""

    @model_validator(mode="after")
    def _lasts(self) -> FaultMeta:
        if self.end is not None and not self.t < self.end:
            raise ValueError(
                f"the fault {self.text[:60]!r} ends at {self.end:g} s, not after {self.t:g} s"
            )
        return self


class PhaseMeta(MetaValue):
    """One action of a mission."""

    name: str
    """Short name of the phase."""
    title: str = ""
    """Words beside the name."""
    tasks: tuple[str, ...] = ()
    """Names of the tasks that are on."""


class TaskMeta(MetaValue):
    """A task of the hierarchy."""

    name: str
    """Name of the task."""
    label: str
    """The paper's bracket, such as ``[R,E,AD]``."""
    tool: str | None = None
    """The frame of a tool that it brings to its goal; older records lack it."""


class LevelMeta(MetaValue):
    """A level of the hierarchy; its rows follow those of the level above."""

    name: str
    """Name of the level."""
    rows: Annotated[int, Field(ge=0)]
    """Number of rows."""


class LimitsMeta(MetaValue):
    """Limits of a robot, infinite where there is none; positions are of the joints, all else of the
    vehicle's axes too.
    """

    position_lower: tuple[float, ...]
    """Lower limits of position (n_joints,) [rad or m]."""
    position_upper: tuple[float, ...]
    """Upper limits of position (n_joints,) [rad or m]."""
    velocity: tuple[float, ...]
    """Limits of velocity (n_v,) [m/s, rad/s]."""
    acceleration: tuple[float, ...]
    """Limits of acceleration (n_v,) [m/s2, rad/s2]."""
    effort: tuple[float, ...]
    """Limits of torque or force (n_joints,) [N m or N]."""

    @model_validator(mode="after")
    def _are_limits(self) -> LimitsMeta:
        if not len(self.position_lower) == len(self.position_upper) == len(self.effort):
            raise ValueError("position_lower, position_upper and effort have one number per joint")
        if len(self.velocity) != len(self.acceleration):
            raise ValueError("velocity and acceleration have one number per axis")
        for lower, upper in zip(self.position_lower, self.position_upper, strict=True):
            if not lower <= upper:
                raise ValueError("position_lower is not above position_upper")
        for limit in (*self.velocity, *self.acceleration, *self.effort):
            if not limit >= 0.0:
                raise ValueError("limits of velocity, acceleration and effort are not negative")
        return self


class AxisLimitsMeta(MetaValue):
    """Limits of the planned axes, by the series that they bound, where they hold all the way.

    The vehicle's limits are along its own axes: infinite for x, y and z where it looks along none
    of them or turns.
    """

    x_rate: tuple[float, ...]
    """Limits of velocity (n_axes,) [m/s, rad/s]."""
    x_acceleration: tuple[float, ...] | None = None
    """Limits of acceleration (n_axes,) [m/s2, rad/s2]; `None` where the method limits forces
    instead.
    """


class FrameMeta(MetaValue):
    """A pose to draw."""

    name: str
    """Name beside the drawn frame."""
    pose: tuple[Number, Number, Number, Number, Number, Number, Number]
    """(7,) X_WF: p_WF [m] and quaternion xyzw; where it is first, if it moves."""
    phase: str | None = None
    """Phase with whose beginning its way begins; `None`: with the run."""
    way: tuple[tuple[Number, Number, Number, Number, Number, Number, Number, Number], ...] = ()
    """Times t [s] since then, and poses; empty where it stays."""

    @model_validator(mode="after")
    def _turns(self) -> FrameMeta:
        norm = math.hypot(*self.pose[3:])
        if abs(norm - 1.0) > UNIT_NORM_TOLERANCE:
            raise ValueError(
                f"the quaternion of a pose, its last four numbers, has norm 1, not {norm:g}"
            )
        return self


class MarkerMeta(MetaValue):
    """A point to draw."""

    name: str
    """Name beside the drawn point."""
    position: Point
    """Position (3,) [m] in W."""


class PackageMeta(MetaValue):
    """A package, or Python itself, and its version."""

    name: str
    """Name of the package."""
    version: str
    """Version of the package."""


class ClearanceMeta(MetaValue):
    """The smallest distance along a plan."""

    t: Number
    """Time [s]."""
    distance: Number
    """Distance [m]; negative in collision."""
    between: str
    """Names of the two shapes."""


class FloorRelief(MetaValue):
    """Heights of a rectangle of the floor, on a grid."""

    x: tuple[Number, ...]
    """Positions of the columns (n,) [m] in W, ascending."""
    y: tuple[Number, ...]
    """Positions of the rows (m,) [m] in W, ascending."""
    z: tuple[tuple[Number, ...], ...]
    """Heights (m, n) [m] in W."""

    @model_validator(mode="after")
    def _is_a_grid(self) -> FloorRelief:
        for axis in (self.x, self.y):
            ascends = all(value < next_value for value, next_value in pairwise(axis))
            if len(axis) < 2 or not ascends:
                raise ValueError("x and y of a floor ascend, with two values or more each")
        if len(self.z) != len(self.y) or any(len(row) != len(self.x) for row in self.z):
            raise ValueError(f"z of this floor has {len(self.y)} rows of {len(self.x)} heights")
        return self


class SurroundingsMeta(MetaValue):
    """Surroundings of the robot that are drawn."""

    frames: tuple[FrameMeta, ...] = ()
    """Frames such as goals."""
    markers: tuple[MarkerMeta, ...] = ()
    """Points such as way points."""
    obstacles: tuple[ObstacleMeta, ...] = ()
    """Obstacles around the robot."""
    floor_z: Number | None = None
    """Height of the floor [m] in W, below the start."""
    floor: FloorRelief | None = None
    """The floor around the way where it is not flat."""


def require_unique(what: str, names: Iterable[str]) -> None:
    """Raise `ValueError` for two of one name."""
    for name, n in Counter(names).items():
        if n > 1:
            raise ValueError(f"two {what} are called {name[:60]!r}")
