"""Fallbacks for an estimate that is missing: the last valid one, the last altimeter echo, and the
watchdog of its age.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Annotated

import casadi as ca
import numpy as np

from uvms_ocp.checks import checked, checked_on_failure, replace_unchecked
from uvms_ocp.codegen.kernel_layout import (
    FunctionField,
    Layout,
    Sized,
    Vector,
    assign,
    doubles,
    structure_of,
)
from uvms_ocp.errors import InvalidInput
from uvms_ocp.robot import Robot, StateEstimate, SymbolicModel
from uvms_ocp.robot.dimensions import dimensions_of
from uvms_ocp.robot.kinematics import STEEP

UNSEEN_SLOPE = 0.3
"""Slope of a floor that nobody sees: it rises or falls by so much of the way."""
_FORGETTING = 0.05  # [m/s] with which the highest floor sinks to the present one
_UNIT = 1e-3  # by which the norm of a quaternion may differ from 1, as in records
_LEVEL = (
    1e-6  # cosine of a tilt; a beam nearer to the horizon has no range that stands for a height
)


class Freshness(enum.IntEnum):
    """Degree to which an estimate can be trusted."""

    FRESH = 0
    """Go on."""
    STALE = 1
    """Hold: brake along a ramp, without feedback from what is stale. So at the beginning, while
    first readings are under way.
    """
    LOST = 2
    """Stop: no thrust; motors hold the arm."""


@checked
@dataclass(slots=True)
class Watchdog:
    """Judges the age of measurements and logs every change of its verdict in `alarms`.

    Readings that are on their way at first are no reason for an alarm, unless they take
    `stop_after`.

    Raises `InvalidInput` unless 0 < hold_after < stop_after.
    """

    hold_after: float = 0.6
    """[s] three periods of the slowest sensor that an estimate needs, a 5 Hz DVL."""
    stop_after: float = 3.0
    """[s] after which the thrust is cut."""
    alarms: list[tuple[float, str]] = field(default_factory=list)
    """Time [s] and text of each."""
    _verdict: Freshness = field(default=Freshness.FRESH, init=False)
    """Verdict that was logged last."""
    _begun: float = field(default=math.nan, init=False)
    """[s] time of the first call."""
    _waits: bool = field(default=True, init=False)
    """There has been no measurement yet."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.stop_after) and 0 < self.hold_after < self.stop_after):
            problem = (
                f"watchdog: hold_after = {self.hold_after} s, stop_after = {self.stop_after} s"
            )
            raise InvalidInput(f"{problem}; give 0 < hold_after < stop_after")

    @property
    def verdict(self) -> Freshness:
        """Verdict of the last call of `judge`; at first fresh."""
        return self._verdict

    @checked_on_failure
    def judge(self, age: float, t: float, channel: str = "") -> Freshness:
        """Return the verdict at time t [s] on an estimate of an age [s]; nan counts as lost.
        channel: the oldest one, named in alarms.
        """
        verdict = Freshness(freshness_of(age, self.hold_after, self.stop_after))
        self._waits = self._waits and age == math.inf
        if math.isnan(self._begun):
            self._begun = t
        is_early = self._waits and is_under_way(t - self._begun, self.stop_after)
        if verdict is self._verdict or is_early:
            return verdict
        self._verdict = verdict
        if age == math.inf:
            text = f"no {channel or 'measurements'}: stopped"
        else:
            what = f"{channel} is" if channel else "measurements are"
            text = _TEXTS[verdict].format(what=what, age=age)
        self.alarms.append((t, text))
        return verdict


def freshness_of(age: float, hold_after: float, stop_after: float) -> int:
    """Return the `Freshness` of an estimate of an age [s], by `hold_after` [s] and `stop_after` [s]
    of a `Watchdog`. A kernel.
    """
    if age <= hold_after:
        return Freshness.FRESH
    if age <= stop_after:
        return Freshness.STALE
    return Freshness.LOST


def is_under_way(waited: float, stop_after: float) -> bool:
    """Return whether a first reading that has been waited for [s] may still be on its way;
    `stop_after` [s] of a `Watchdog`. A kernel.
    """
    return waited <= stop_after


_TEXTS = {
    Freshness.FRESH: "measurements are back: going on",
    Freshness.STALE: "{what} {age:.2f} s old: holding",
    Freshness.LOST: "{what} {age:.2f} s old: stopped",
}


# What stands in for a measurement that is missing: the last one, older by the time since.


class LastValidMemory(Layout):
    """The last estimate that was sound, which replaces one that is not."""

    n_units: int
    """Parts of q that have norm 1."""
    unit: Annotated[list[list[int]], Sized("n_v", 2)]
    """(n_units, 2) first entry in q of each, and the one after its last."""
    q: Annotated[Vector, Sized("n_q")]
    """(n_q,) [m, rad] configuration of the last sound estimate."""
    v: Annotated[Vector, Sized("n_v")]
    """(n_v,) [m/s, rad/s] velocity of the last sound estimate."""
    since: float
    """[s] time of the tick of the last sound estimate."""
    was: Annotated[Vector, Sized(2)]
    """(2,) [s] age of the last sound estimate, and of its joints, at that tick."""
    age: float
    """[s] age of the estimate now, or of the one that replaces it."""
    joint_age: float
    """[s] age of the joints in the estimate now, or in the one that replaces it."""
    is_valid: bool
    """True where the estimate of now is sound."""


def hold_last_valid(
    last_valid: LastValidMemory, t: float, q: Vector, v: Vector, age: float, joint_age: float
) -> None:
    """Keep an estimate q [m, rad], v [m/s, rad/s] at t [s], or, where it is not sound, replace it
    by the last that was. A kernel.

    age, joint_age [s]: of the estimate and of its joints; the memory holds those of what replaces
    it.
    """
    last_valid.is_valid = _is_sound(last_valid, q, v)
    if last_valid.is_valid:
        last_valid.q[:] = q
        last_valid.v[:] = v
        last_valid.since = t
        last_valid.was[0] = age
        last_valid.was[1] = joint_age
        last_valid.age = age
        last_valid.joint_age = joint_age
        return
    q[: len(last_valid.q)] = last_valid.q[: len(last_valid.q)]
    v[: len(last_valid.v)] = last_valid.v[: len(last_valid.v)]
    last_valid.age = max(age, last_valid.was[0] + t - last_valid.since)
    last_valid.joint_age = max(joint_age, last_valid.was[1] + t - last_valid.since)


def level_attitude(q: Vector) -> None:
    """Replace the attitude of a vehicle, the quaternion at entries 3 to 6 of q, by a level one of the
    same heading; of one upside down by heading 0. A kernel.
    """
    norm = math.sqrt(q[5] * q[5] + q[6] * q[6])
    q[3] = 0.0
    q[4] = 0.0
    if norm > _LEVEL:
        q[5] /= norm
        q[6] /= norm
    else:
        q[5] = 0.0
        q[6] = 1.0


def _is_sound(last_valid: LastValidMemory, q: Vector, v: Vector) -> bool:
    """Check that all numbers are finite, and that what should have norm 1 does."""
    sound = True
    for i in range(len(last_valid.q)):
        sound = sound and math.isfinite(q[i])
    for i in range(len(last_valid.v)):
        sound = sound and math.isfinite(v[i])
    for k in range(last_valid.n_units):
        unit = last_valid.unit[k]
        square = 0.0
        for i in range(unit[0], unit[1]):
            square += q[i] * q[i]
        sound = sound and abs(math.sqrt(square) - 1.0) <= _UNIT
    return sound


class LastValidEstimate:
    """Filter that replaces an estimate with a q or v that is not finite, or a quaternion that is
    none, by the last sound one with its true age.
    """

    __slots__ = ("_last", "_shapes", "memory")

    def __init__(self, robot: Robot, memory: LastValidMemory | None = None) -> None:
        """memory: a `LastValidMemory` of the caller's, who asks the kernel."""
        if memory is None:
            self.memory = structure_of(LastValidMemory, dimensions_of(robot))()
        else:
            self.memory = memory
        self._last = StateEstimate(
            q=robot.configuration(), v=np.zeros(robot.n_v), altimeter_range=np.nan
        )
        self._shapes = self._last.q.shape, self._last.v.shape
        # Where quaternions, and cosine and sine of joints without end, are in q.
        lengths = {"JointModelFreeFlyer": 4, "JointModelSpherical": 4, "JointModelPlanar": 2}
        units = list[tuple[int, int]]()
        for joint in robot.model.joints:
            if joint.nq > joint.nv:
                end = joint.idx_q + joint.nq
                units.append((end - lengths.get(joint.shortname(), 2), end))
        assign(self.memory, q=self._last.q, since=-math.inf, n_units=len(units))
        if units:
            assign(self.memory, unit=units)

    def __call__(self, estimate: StateEstimate, t: float) -> StateEstimate:
        """Return the estimate, or the last valid one; t [s]: time of the tick. Raises
        `InvalidInput` for a q or v of another robot's size.
        """
        self.check(estimate)
        q = doubles(estimate.q)
        v = doubles(estimate.v)
        hold_last_valid(self.memory, t, q, v, estimate.age, estimate.joint_age)
        return self.substitute(estimate)

    def check(self, estimate: StateEstimate) -> None:
        """Raise `InvalidInput` for a q or v of another robot's size."""
        if (estimate.q.shape, estimate.v.shape) == self._shapes:
            return
        problems = list[str]()
        for name, value, shape in zip("qv", (estimate.q, estimate.v), self._shapes, strict=True):
            if value.shape != shape:
                problems.append(f"measurement.{name} has shape {value.shape}; give {shape}")
        raise InvalidInput(", ".join(problems))

    def substitute(self, estimate: StateEstimate) -> StateEstimate:
        """Return the estimate that the kernel was given, if it is sound, or its replacement."""
        if self.memory.is_valid:
            self._last = estimate
            return estimate
        return replace_unchecked(
            self._last,
            altimeter_range=estimate.altimeter_range,
            age=self.memory.age,
            oldest=estimate.oldest,
            joint_age=self.memory.joint_age,
            health=estimate.health,
        )


class AltimeterMemory(Layout):
    """Memory of `LastFloorRange`, and the beam of the altimeter: along -z of its frame."""

    look: FunctionField
    """Function of q that gives `beam` and `height_jacobian`."""
    exists: bool
    """True where the robot has an altimeter."""
    beam: Annotated[Vector, Sized(4)]
    """(4,) [m] origin in W, and cosine of the angle between the beam and straight down."""
    height_jacobian: Annotated[Vector, Sized("n_v")]
    """(n_v,) [-, m] rise of the origin per unit of each velocity."""
    floor: float
    """[m] z in W of the floor below the last echo; NaN before the first."""
    highest: float
    """[m] highest z in W of the floor of late; NaN before the first echo."""
    place: Annotated[Vector, Sized(2)]
    """(2,) [m] horizontal position in W of the altimeter, when the range was asked for last."""
    since: float
    """[s] time of the last echo, 0 before the first."""


def point_altimeter(altimeter: AltimeterMemory, q: Vector) -> None:
    """Point the beam of the altimeter at q [m, rad]. A kernel."""
    if altimeter.exists:
        altimeter.look(q, altimeter.beam, altimeter.height_jacobian)


def echo_range(
    altimeter: AltimeterMemory, t: float, echo: float, unknown: float, distrusted: bool
) -> float:
    """Compute the range to the floor at t [s], of the echo [m] along the beam in memory, or
    `unknown` [m]. A kernel.
    """
    if distrusted and altimeter.exists:
        x = altimeter.beam[0] - altimeter.place[0]
        y = altimeter.beam[1] - altimeter.place[1]
        altimeter.highest += UNSEEN_SLOPE * math.sqrt(x * x + y * y)
        altimeter.floor = altimeter.highest
        altimeter.place[0] = altimeter.beam[0]
        altimeter.place[1] = altimeter.beam[1]
    if distrusted or not has_altitude(altimeter, echo):
        return range_to_last_floor(altimeter, unknown)
    floor = altimeter.beam[2] - altimeter.beam[3] * echo
    faded = altimeter.highest - _FORGETTING * (t - altimeter.since)
    altimeter.since = t
    altimeter.floor = floor
    altimeter.place[0] = altimeter.beam[0]
    altimeter.place[1] = altimeter.beam[1]
    if math.isfinite(faded):
        altimeter.highest = max(floor, faded)
    else:
        altimeter.highest = floor
    return echo


def has_altitude(altimeter: AltimeterMemory, echo: float) -> bool:
    """Return whether an echo [m] along the beam stands for a height. A kernel."""
    return altimeter.exists and math.isfinite(echo) and altimeter.beam[3] > STEEP


def range_to_last_floor(altimeter: AltimeterMemory, unknown: float) -> float:
    """Compute the range [m] to the floor of the last echo; before the first one, the one of an
    altitude of `unknown` [m]. A kernel.
    """
    if not altimeter.exists:
        return 0.0
    if math.isfinite(altimeter.floor):
        height = max(0.0, altimeter.beam[2] - altimeter.floor)
    else:
        height = unknown
    return height / math.copysign(max(abs(altimeter.beam[3]), _LEVEL), altimeter.beam[3])


class LastFloorRange:
    """Height of the altimeter above the floor: by its echo, or by the last one, carried along with
    the measured motion.

    Carrying takes the floor for level, except in doubt: then it is the highest of late, as the
    echoes may have lied for some time, and rises with the way. An echo along a beam that does not
    look down tells no height.
    """

    __slots__ = ("memory",)

    def __init__(
        self, robot: Robot, frame: str | None, memory: AltimeterMemory | None = None
    ) -> None:
        """frame: that of the altimeter; `None` or one that the robot does not have: no altitude is
        ever known.

        memory: an `AltimeterMemory` of the caller's, with the `beam_function` of the frame.
        """
        if memory is None:
            self.memory = structure_of(
                AltimeterMemory, dimensions_of(robot), look=beam_function(robot, frame)
            )()
        else:
            self.memory = memory
        self.memory.exists = frame is not None and robot.has_frame(frame)
        self.memory.floor = self.memory.highest = math.nan

    def at(self, estimate: StateEstimate) -> tuple[float, bool]:
        """Return the range [m], always finite, at an estimate that is not remembered, and whether
        its echo tells the altitude.
        """
        point_altimeter(self.memory, doubles(estimate.q))
        measured = has_altitude(self.memory, estimate.altimeter_range)
        if measured:
            return (estimate.altimeter_range, True)
        return (range_to_last_floor(self.memory, 0.0), False)


def beam_function(robot: Robot, frame: str | None) -> ca.Function:
    """Return the function `look` of an `AltimeterMemory` in this frame, if the robot has it."""
    if frame is not None and not robot.has_frame(frame):
        frame = None
    return _beam(robot, frame)


@lru_cache(maxsize=8)
def _beam(robot: Robot, frame: str | None) -> ca.Function:
    """Build the function from q to origin (3,) [m] and cosine of the beam, and how the origin rises
    with each velocity (n_v,) [m, or 1].
    """
    q = ca.SX.sym("q", robot.n_q)
    beam = ca.SX.zeros(4)
    height_jacobian = ca.SX.zeros(robot.n_v)
    if frame is not None:
        kinematics = SymbolicModel(robot.model).forward_kinematics(q)
        R_WS, p_WS = kinematics.pose(frame)
        beam = ca.vertcat(p_WS, R_WS[2, 2])
        height_jacobian = kinematics.jacobian(frame)[2, :].T
    outputs = [ca.densify(beam), ca.densify(height_jacobian)]
    return ca.Function("beam", [q], outputs, ["q"], ["beam", "height_jacobian"], {"cse": True})
