"""The table of channels: what each sensor of a robot tells, and what sensors, filter, health, faults
and records have to know of it. A sensor of a user's own is one more row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.types import Count, Finite, Magnitude, Range

if TYPE_CHECKING:
    from uvms_ocp.robot.robot import Robot

LARGEST_OWN = 3
"""Numbers of a channel of a user's own at most: a filter compares so many at once."""


@checked_dataclass()
class SensorSpec:
    """Rate, noise and delay of one channel, for the simulated sensors and the estimator alike.
    Raises `InvalidInput` for a value outside its range.
    """

    rate: float = math.inf
    """Readings per second [Hz]; inf is once per tick."""
    sigma: Magnitude = 0.0
    """Standard deviation [unit of the channel] of the noise of every component."""
    bias: Finite | tuple[Finite, ...] = 0.0
    """Constant error [unit of the channel], of all components or of each."""
    delay: Magnitude = 0.0
    """Time [s] between taking a reading and delivering it."""
    dropout: Annotated[float, Range(0.0, 1.0)] = 0.0
    """Probability that a reading is lost."""

    def __post_init__(self) -> None:
        if not self.rate > 0:
            raise InvalidInput(
                f"sensor rate = {self.rate} Hz; give a number > 0, or inf for once per tick"
            )

    @property
    def biases(self) -> tuple[float, ...]:
        """`bias` as one value for all components, or one per component."""
        if isinstance(self.bias, tuple):
            return self.bias
        return (self.bias,)

    @property
    def exact(self) -> bool:
        """True where readings equal the truth."""
        return self.sigma == 0.0 and not any(self.biases)


@checked_dataclass()
class Channel:
    """One channel: a row of the table of those of the toolkit, or a sensor of a user's own, which has
    a `measure`.

    Raises `InvalidInput` for a name that is no identifier, and for a channel of one's own that is
    larger than `LARGEST_OWN` numbers.
    """

    name: str
    """Name of the channel, in readings, faults, alarms and records."""
    unit: str
    """Unit of its errors, and of its value unless that is a quaternion."""
    size: Count = 1
    """Numbers of a value: one is a float, more are an array. 0 for those of the joints."""
    frame: str = "-"
    """Frame in which it is expressed: W, B, or - for neither."""
    sensor: SensorSpec | None = SensorSpec()
    """Rate, noise and delay; of the toolkit's channels those that robots have unless their files say
    otherwise, `None` for no such sensor.
    """
    measure: Callable[..., Any] | None = None
    """Measurement function of a channel of one's own: takes a `MeasuredState` and returns the value
    without errors as a CasADi expression (size,).
    """
    n_errors: Count = 0
    """Components of its error where these are fewer than numbers of its value; 0: as many."""
    orders: Count = 2
    """Integrations from an acceleration to what the channel tells: 2 of a place, 1 of a rate."""
    first: Count = 0
    """Index at which it begins in q, of a place, or in v, of a rate; of joints, among theirs."""
    of_joints: bool = False
    """True for what encoders tell."""
    needed: bool = True
    """True where no other channel replaces it, so that an estimate is as old as its readings are."""
    of_motion: bool = False
    """True where q and v of a vehicle rest on it."""
    jolt: Magnitude = 0.0
    """[m/s2, rad/s2] unplanned acceleration that gates allow: light vehicles turn so fast, and light
    joints fall so fast under a load. Gates that allow more find nothing. Linear motion is slow and
    seen rarely; positions of joints tell their velocities as soon.
    """
    rivals: tuple[str, ...] = ()
    """Up to two channels that may be the reason why the estimate does not agree with this one."""
    of_one_piece: bool = False
    """True where its components cannot be judged one by one, as some hardly change."""
    of_several_sensors: bool = False
    """True where its components may come from instruments of their own, with resolutions of their
    own.
    """

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise InvalidInput(f"channel {self.name!r}; give a name of letters, digits and _")
        if self.measure is not None and not 1 <= self.size <= LARGEST_OWN:
            raise InvalidInput(
                f"channel {self.name} of {self.size} numbers; give 1 to {LARGEST_OWN}, and several"
                " channels for more"
            )

    @property
    def rows(self) -> int:
        """Entries of the error of one reading; of one joint for the joints' channels."""
        if self.of_joints:
            return 1
        return self.n_errors or self.size


TABLE = (
    Channel(
        name="position",
        unit="m",
        size=3,
        frame="W",
        sensor=SensorSpec(rate=5.0, sigma=0.02),
        of_motion=True,
        rivals=("linear_velocity", "depth"),
        of_several_sensors=True,
    ),
    Channel(
        name="depth",
        unit="m",
        frame="W",
        sensor=SensorSpec(rate=10.0, sigma=0.01),
        first=2,
        needed=False,
        rivals=("position", "linear_velocity"),
    ),
    Channel(
        name="attitude",
        unit="rad",
        size=4,
        frame="W",
        sensor=SensorSpec(rate=100.0, sigma=0.001),
        n_errors=3,
        first=3,
        of_motion=True,
        jolt=30.0,
        rivals=("angular_velocity",),
        of_one_piece=True,
    ),
    Channel(
        name="angular_velocity",
        unit="rad/s",
        size=3,
        frame="B",
        sensor=SensorSpec(rate=100.0, sigma=0.002),
        orders=1,
        first=3,
        of_motion=True,
        jolt=30.0,
        rivals=("attitude",),
    ),
    Channel(
        name="linear_velocity",
        unit="m/s",
        size=3,
        frame="B",
        sensor=SensorSpec(rate=5.0, sigma=0.002),
        orders=1,
        of_motion=True,
        rivals=("position",),
    ),
    Channel(
        name="joint_positions",
        unit="rad or m",
        size=0,
        sensor=SensorSpec(rate=200.0, sigma=1e-4),
        of_joints=True,
        jolt=200.0,
    ),
    Channel(
        name="joint_velocities",
        unit="rad/s or m/s",
        size=0,
        sensor=None,
        orders=1,
        of_joints=True,
        needed=False,
    ),
    Channel(name="altimeter_range", unit="m", sensor=SensorSpec(rate=10.0, sigma=0.01)),
    Channel(
        name="specific_force",
        unit="m/s2",
        size=3,
        frame="B",
        sensor=None,
        orders=0,
        needed=False,
    ),
)
"""Channels of the toolkit, in the order of `uvms_ocp.robot.Readings`. Their noise is assumed."""

CHANNEL_OF: Mapping[str, Channel] = {channel.name: channel for channel in TABLE}
"""Rows of the table by name."""
CHANNELS = tuple(CHANNEL_OF)
"""Names of the channels of the toolkit."""
UNITS: Mapping[str, str] = {channel.name: channel.unit for channel in TABLE}
"""Units of the errors of each channel of the toolkit."""


OF_MOTION = tuple(
    channel.name
    for channel in sorted(TABLE, key=lambda channel: (-channel.orders, channel.first))
    if channel.of_motion
)
"""Channels that q and v of a vehicle rest on, in the order of their numbers there."""


def rows_by_name(own: Iterable[Channel] = ()) -> dict[str, Channel]:
    """Return the rows of the toolkit's channels, and of a user's own after them, by name."""
    return {**CHANNEL_OF, **{channel.name: channel for channel in own}}


def shape_of(channel: Channel, robot: Robot) -> tuple[int, ...]:
    """Return the shape of a value of a channel of a robot."""
    if not channel.of_joints:
        return () if channel.size == 1 else (channel.size,)
    if channel.orders > 1:
        return (robot.joint_q.stop - robot.joint_q.start,)
    return (robot.n_joints,)


def start_of(channel: Channel, robot: Robot) -> int:
    """Return the index at which a value begins in q, of a place, or in v, of a rate."""
    if not channel.of_joints:
        return channel.first
    if channel.orders > 1:
        return int(robot.joint_q.start)
    return int(robot.joint_v.start)


def shapes_of(robot: Robot, own: Iterable[Channel] = ()) -> dict[str, tuple[int, ...]]:
    """Return the shape of the value of each channel of the toolkit, and of a user's own."""
    return {name: shape_of(channel, robot) for name, channel in rows_by_name(own).items()}


def require_own(own: Iterable[Channel]) -> None:
    """Raise `InvalidInput` for channels of a user's own without a measurement function or a sensor,
    and for names that there are already.
    """
    names = set(CHANNELS)
    for channel in own:
        for missing in ("measure", "sensor"):
            if getattr(channel, missing) is None:
                raise InvalidInput(
                    f"channel {channel.name} without {missing}; give a channel of your own both"
                )
        if channel.name in names:
            raise InvalidInput(f"channel {channel.name!r} twice; give each a name of its own")
        names.add(channel.name)
