"""What goes wrong with recordings: one thing at a time, by a drawn amount, with the doubts that are
to find it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from spoiled.sound import DURATION
from uvms_ocp.identification.channel_mapping import RecordingMapping
from uvms_ocp.identification.mapped_recordings import mapped_recording
from uvms_ocp.identification.recording import Channel, Recording
from uvms_ocp.identification.recording_gaps import split_at_gaps
from uvms_ocp.identification.resampling import interpolated, rotations
from uvms_ocp.identification.tables import write_columns
from uvms_ocp.robot.spatial import continuous_quaternions

Rng = np.random.Generator
Spoil = Callable[[Recording, Rng], Recording]


@dataclass(frozen=True, slots=True)
class Kind:
    """A way to spoil a recording."""

    group: str
    """Group of ways, in tables."""
    how: str
    """Description of the way."""
    channel: str
    """Name of the channel that is wrong."""
    meant: tuple[str, ...]
    """Patterns of the doubts that are to find it."""
    spoil: Spoil
    """Function that spoils a recording."""


def _change(name: str, change: Callable[[Channel, Rng], Channel]) -> Spoil:
    """Make a way that changes a channel."""

    def spoil(recording: Recording, rng: Rng) -> Recording:
        return _with_channel(recording, name, change(recording.channels[name], rng))

    return spoil


def _with_channel(recording: Recording, name: str, channel: Channel) -> Recording:
    return replace(recording, channels={**recording.channels, name: channel})


def _values(name: str, change: Callable[[np.ndarray, Rng], np.ndarray]) -> Spoil:
    """Make a way that changes the values of a channel."""
    return _change(name, lambda channel, rng: replace(channel, values=change(channel.values, rng)))


def _times(name: str, change: Callable[[np.ndarray, Rng], np.ndarray]) -> Spoil:
    """Make a way that changes the times of a channel."""
    return _change(name, lambda channel, rng: replace(channel, t=change(channel.t, rng)))


def _without(spoil: Spoil, *names: str) -> Spoil:
    """Make a way that spoils a recording after some channels were left out."""

    def spoil_others(recording: Recording, rng: Rng) -> Recording:
        channels = {}
        for name, channel in recording.channels.items():
            if name not in names:
                channels[name] = channel
        return spoil(replace(recording, channels=channels), rng)

    return spoil_others


def _scaled(factor: float) -> Callable[[np.ndarray, Rng], np.ndarray]:
    return lambda values, _: values * factor


def _exchanged(width: int, first: int = 0) -> Callable[[np.ndarray, Rng], np.ndarray]:
    """Make a change that exchanges two of `width` columns from `first` on."""

    def change(values: np.ndarray, rng: Rng) -> np.ndarray:
        order = np.arange(values.shape[1])
        i, j = first + rng.choice(width, size=2, replace=False)
        order[[i, j]] = j, i
        return values[:, order]

    return change


def _flipped(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Reverse the sign of one column."""
    return values * np.where(np.arange(values.shape[1]) == rng.integers(values.shape[1]), -1.0, 1.0)


def _with_one_dead(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Set one column to 0."""
    return values * (np.arange(values.shape[1]) != rng.integers(values.shape[1]))


def _saturated(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Clip all columns to 0.3 to 0.7 of their ranges."""
    middle = np.median(values, axis=0)
    largest = np.abs(middle) + rng.uniform(0.3, 0.7) * np.abs(values - middle).max(axis=0)
    return np.clip(values, -largest, largest)


def _stuck(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Repeat one row 30 to 200 times."""
    first = int(rng.integers(100, 300))
    n = int(rng.integers(30, 200))
    return np.vstack([values[:first], np.tile(values[first], (n, 1)), values[first + n :]])


def _sometimes(
    value: float, least_share: float, largest_share: float, spread: float = 0.0
) -> Callable[[np.ndarray, Rng], np.ndarray]:
    """Make a change that puts a value, or one up to `spread` above it, in a share of all samples."""

    def change(values: np.ndarray, rng: Rng) -> np.ndarray:
        lost = rng.uniform(size=(len(values), 1)) < rng.uniform(least_share, largest_share)
        return np.where(lost, round(value + spread * rng.uniform(), 2), values)

    return change


def _turned(
    world: Sequence[float], body: Sequence[float]
) -> Callable[[np.ndarray, Rng], np.ndarray]:
    """Make a change of attitudes to those of other axes of world and body, by quaternions x, y, z,
    w.
    """
    from scipy.spatial.transform import Rotation

    def change(values: np.ndarray, _: Rng) -> np.ndarray:
        turned = Rotation.from_quat(world) * Rotation.from_quat(values) * Rotation.from_quat(body)
        return np.asarray(turned.as_quat())

    return change


def _heading(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Turn the heading by 30 to 60 deg."""
    angle = np.deg2rad(rng.uniform(30.0, 60.0)) * rng.choice([-1.0, 1.0])
    about_z = (0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2))
    turn = _turned(about_z, (0.0, 0.0, 0.0, 1.0))
    return turn(values, rng)


def _slightly_turned(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Turn the heading by 4 to 20 deg."""
    angle = np.deg2rad(rng.uniform(4.0, 20.0)) * rng.choice([-1.0, 1.0])
    turn = _turned((0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2)), (0.0, 0.0, 0.0, 1.0))
    return turn(values, rng)


def _flattened(values: np.ndarray, _: Rng) -> np.ndarray:
    """Make attitudes of roll and pitch in rad that are read as deg, beside yaw."""
    from scipy.spatial.transform import Rotation

    angles = Rotation.from_quat(values).as_euler("xyz") * [np.pi / 180.0, np.pi / 180.0, 1.0]
    return np.asarray(Rotation.from_euler("xyz", angles).as_quat())


def _tilted(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Turn axes by 4 to 15 deg about a horizontal one."""
    from scipy.spatial.transform import Rotation

    angle = np.deg2rad(rng.uniform(4.0, 15.0)) * rng.choice([-1.0, 1.0])
    axis = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]][rng.integers(2)]
    return np.asarray(values @ Rotation.from_rotvec(angle * np.array(axis)).as_matrix().T)


def _one_of_three(factor: float, rng: Rng) -> np.ndarray:
    """Return factors of three columns, of which one has `factor`."""
    return np.where(np.arange(3) == rng.integers(3), factor, 1.0)


def _from_air(values: np.ndarray, _: Rng) -> np.ndarray:
    """Turn heights to pressures in kPa of a vehicle that begins at the surface."""
    depth = values[0, 2] - values[:, 2]
    return np.column_stack([values[:, :2], 101.3 + 9.807 * np.abs(depth)])


def _from_a_lever(recording: Recording, rng: Rng) -> Recording:
    """Measure the velocity 0.08 to 0.4 m away from the origin of the body."""
    velocity = recording.channels["linear_velocity"]
    rate = recording.channels["angular_velocity"]
    turning = interpolated(velocity.t, rate.t, rate.values)
    direction = rng.normal(size=3)
    place = rng.uniform(0.08, 0.4) * direction / np.linalg.norm(direction)
    values = velocity.values + np.cross(turning, place)
    return _with_channel(recording, "linear_velocity", replace(velocity, values=values))


def _turned_gyro(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Turn axes by 5 to 20 deg about any axis."""
    from scipy.spatial.transform import Rotation

    direction = rng.normal(size=3)
    angle = np.deg2rad(rng.uniform(5.0, 20.0))
    turn = Rotation.from_rotvec(angle * direction / np.linalg.norm(direction))
    return np.asarray(values @ turn.as_matrix())


def _biased(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Add 0.02 to 0.1 rad/s to one of the axes."""
    bias = rng.uniform(0.02, 0.1) * rng.choice([-1.0, 1.0])
    return values + bias * (np.arange(3) == rng.integers(3))


def _of_another_time(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Begin somewhere in the middle, and go on with the beginning after the end."""
    n = len(values)
    return np.roll(values, int(rng.integers(n // 3, 2 * n // 3)), axis=0)


def _lost_attitude(channel: Channel, rng: Rng) -> Channel:
    """Turn an attitude by 30 to 90 deg about any axis for 1 to 5 s."""
    from scipy.spatial.transform import Rotation

    direction = rng.normal(size=3)
    angle = np.deg2rad(rng.uniform(30.0, 90.0))
    turn = Rotation.from_rotvec(angle * direction / np.linalg.norm(direction))
    first = rng.uniform(10.0, 45.0)
    is_lost = (channel.t > first) & (channel.t < first + rng.uniform(1.0, 5.0))
    turned = (turn * Rotation.from_quat(channel.values)).as_quat()
    values = np.where(is_lost[:, None], turned, channel.values)
    return replace(channel, values=continuous_quaternions(values))


def _set_anew(channel: Channel, rng: Rng) -> Channel:
    """Move a position from some time on by 2 to 30 m."""
    direction = rng.normal(size=3)
    distance = rng.uniform(2.0, 30.0) * direction / np.linalg.norm(direction)
    is_later = channel.t[:, None] > rng.uniform(0.2, 0.8) * DURATION
    return replace(channel, values=channel.values + np.where(is_later, distance, 0.0))


def _of_two_senders(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Move a half, or a fifth, of the samples by 1 to 20 m."""
    is_other = rng.uniform(size=(len(values), 1)) < rng.choice([0.5, 0.2])
    direction = rng.normal(size=3)
    distance = rng.uniform(1.0, 20.0) * direction / np.linalg.norm(direction)
    return np.where(is_other, values + distance, values)


def _in_another_order(order: str, axes: Sequence[int]) -> Callable[[np.ndarray, Rng], np.ndarray]:
    """Read roll, pitch and yaw of turns about some axes as those of 3-2-1."""
    from scipy.spatial.transform import Rotation

    def change(values: np.ndarray, _: Rng) -> np.ndarray:
        angles = np.empty((len(values), 3))
        angles[:, axes] = Rotation.from_quat(values).as_euler(order)
        read = Rotation.from_euler("xyz", angles).as_quat()
        return continuous_quaternions(read)

    return change


def _with_few_digits(shortest: float, longest: float) -> Callable[[np.ndarray, Rng], np.ndarray]:
    """Round one of three columns to multiples of a step of `shortest` to `longest`."""

    def change(values: np.ndarray, rng: Rng) -> np.ndarray:
        step = rng.uniform(shortest, longest)
        return np.where(np.arange(3) == rng.integers(3), step * np.round(values / step), values)

    return change


def _in_world(recording: Recording, _: Rng) -> Recording:
    """Express the velocity in W."""
    velocity = recording.channels["linear_velocity"]
    R = rotations(recording.channels["attitude"], velocity.t)
    values = np.einsum("nij,nj->ni", R, velocity.values)
    return _with_channel(recording, "linear_velocity", replace(velocity, values=values))


def _ungravitated(recording: Recording, _: Rng) -> Recording:
    """Take gravity out of the specific force."""
    force = recording.channels["specific_force"]
    values = force.values - 9.81 * rotations(recording.channels["attitude"], force.t)[:, 2]
    return _with_channel(recording, "specific_force", replace(force, values=values))


def _lost(channel: Channel, rng: Rng) -> Channel:
    """Lose the samples of 1.5 to 6 s."""
    first = rng.uniform(15.0, 40.0)
    is_kept = (channel.t < first) | (channel.t > first + rng.uniform(1.5, 6.0))
    return replace(channel, t=channel.t[is_kept], values=channel.values[is_kept])


def _silent(recording: Recording, rng: Rng) -> Recording:
    """Lose the samples of all channels for 3 to 10 s."""
    first = rng.uniform(15.0, 30.0)
    last = first + rng.uniform(3.0, 10.0)
    channels = {}
    for name, channel in recording.channels.items():
        is_kept = (channel.t < first) | (channel.t > last)
        channels[name] = replace(channel, t=channel.t[is_kept], values=channel.values[is_kept])
    return split_at_gaps([replace(recording, channels=channels)])[0]


def _bursts(t: np.ndarray, rng: Rng) -> np.ndarray:
    """Deliver samples in bursts of 4 to 8."""
    period = float(np.median(np.diff(t))) * rng.integers(4, 9)
    arrived = period * np.ceil(t / period)
    return np.asarray(arrived + 1e-4 * np.arange(len(t)))


def _jump(shortest: float, longest: float) -> Callable[[np.ndarray, Rng], np.ndarray]:
    """Make a change of a clock that jumps in the middle of a recording, by a time [s] of a range."""
    return lambda t, rng: np.asarray(t + rng.uniform(shortest, longest) * (t > DURATION / 2))


def _of_two(channel: Channel, rng: Rng) -> Channel:
    """Insert the samples of another sensor, which is a little off, right after its own."""
    signs = rng.choice([-1.0, 1.0], size=channel.values.shape[1])
    by_second = channel.values + 3.0 * np.diff(channel.values, axis=0).std() * signs
    t = np.column_stack([channel.t, channel.t + 0.001]).ravel()
    values = np.stack([channel.values, by_second], axis=1).reshape(len(t), -1)
    return replace(channel, t=t, values=values)


def _clock(t: np.ndarray, rng: Rng) -> np.ndarray:
    """Shift commands so that they come too late to be the cause of anything, or much too early."""
    if rng.uniform() < 0.5:
        shift = rng.uniform(0.7, 1.6)
    else:
        shift = -rng.uniform(1.6, 2.4)
    return np.asarray(t + shift)


def _of_off_propellers(recording: Recording, rng: Rng) -> Recording:
    """Make pulses of 0 before the first command, read as shares of the largest one."""
    thrust = recording.channels["thrust"]
    is_off = thrust.t[:, None] < rng.uniform(1.0, 6.0)
    shares = np.where(is_off, -3.75, thrust.values / np.abs(thrust.values).max())
    return _with_channel(recording, "propeller_commands", replace(thrust, values=shares))


def _of_other_pulses(recording: Recording, _: Rng) -> Recording:
    """Read pulses of 1500 +- 500 us as if they were of 1500 +- 400 us."""
    thrust = recording.channels["thrust"]
    shares = 1.25 * thrust.values / np.abs(thrust.values).max()
    return _with_channel(recording, "propeller_commands", replace(thrust, values=shares))


def _in_current(recording: Recording, rng: Rng) -> Recording:
    """Add the channel of a steady current."""
    t = recording.channels["position"].t
    velocity = [*rng.uniform(0.05, 0.4, size=2), 0.0]
    current = Channel(t=t, values=np.tile(velocity, (len(t), 1)))
    return _with_channel(recording, "current", current)


_Columns = dict[str, np.ndarray]
_Spoil = Callable[[_Columns, dict[str, Any], Rng], None]


def _as_file(
    name: str,
    spoil: _Spoil,
    more: Mapping[str, Any] | None = None,
    rows: Callable[[str, Rng], str] | None = None,
) -> Spoil:
    """Make a way that writes a channel to a table and reads it back, with a mistake in the table or
    the mapping.
    """

    def change(recording: Recording, rng: Rng) -> Recording:
        channel = recording.channels[name]
        columns = {"t": channel.t}
        for k, values in enumerate(channel.values.T):
            columns[f"c{k}"] = values
        mapping: dict[str, Any] = {"time": "t", "columns": list(columns)[1:], **(more or {})}
        spoil(columns, mapping, rng)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"{recording.name}.csv"
            write_columns(path, columns)
            if rows:
                path.write_text(rows(path.read_text(), rng))
            channels = RecordingMapping.model_validate({"channels": {name: mapping}})
            read = mapped_recording(path, channels)
        read_channel = read.channels[name]
        at_its_time = replace(read_channel, t=read_channel.t + channel.t[0])
        spoiled = _with_channel(recording, name, at_its_time)
        return replace(spoiled, issues_in_file=read.issues_in_file)

    return change


def _angles(columns: _Columns, mapping: dict[str, Any], _: Rng) -> None:
    from scipy.spatial.transform import Rotation

    values = np.column_stack([columns.pop(f"c{k}") for k in range(4)])
    angles = Rotation.from_quat(values).as_euler("xyz", degrees=True)
    angles = angles * [0.02, 0.02, 1.0]  # of a vehicle that is level
    columns |= dict(zip(("roll", "pitch", "yaw"), angles.T, strict=True))
    mapping |= {"columns": ["roll", "pitch", "yaw"], "format": "rpy"}


def _globe(columns: _Columns, mapping: dict[str, Any], _: Rng) -> None:
    columns |= {"lat": 60.0 + columns.pop("c1") / 1.1e5, "lon": 10.0 + columns.pop("c0") / 5.5e4}
    mapping["columns"] = ["lon", "lat", "c2"]


def _weakened(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Command one thruster more than it gives."""
    given = np.ones(values.shape[1])
    given[rng.integers(len(given))] = rng.uniform(0.1, 0.5)
    return np.asarray(values / given)


def _twice(columns: _Columns, mapping: dict[str, Any], rng: Rng) -> None:
    i, j = rng.choice(3, size=2, replace=False)
    mapping["columns"][i] = mapping["columns"][j]


def _open_cells(columns: _Columns, mapping: dict[str, Any], rng: Rng) -> None:
    lost = rng.uniform(size=len(columns["t"])) < rng.uniform(0.005, 0.2)
    lost[1] = True
    columns["c1"] = np.where(lost, np.nan, columns["c1"])


def _unit(columns: _Columns, mapping: dict[str, Any], rng: Rng) -> None:
    unit = str(rng.choice(["ft/s", "counts", "km/h"]))
    for k in range(3):
        columns[f"c{k} [{unit}]"] = columns.pop(f"c{k}")
    mapping["columns"] = [name for name in columns if name != "t"]


def _few_digits(columns: _Columns, mapping: dict[str, Any], _: Rng) -> None:
    columns["t"] = np.round(columns["t"])


def _set_back(columns: _Columns, mapping: dict[str, Any], rng: Rng) -> None:
    columns["t"] = columns["t"] - rng.uniform(1.0, 10.0) * (columns["t"] > DURATION / 2)


def _cut(text: str, rng: Rng) -> str:
    """Cut a file in the middle of its last row."""
    whole, last = text.rstrip("\n").rsplit("\n", 1)
    return f"{whole}\n{last.split(',')[0]}"


_ALONE = "times the way that the velocity says"
_VELOCITY = "linear_velocity"
_RATE = "angular_velocity"
_FORCE = "specific_force"
_ATTITUDE = "attitude"
_AXES = "its axes fit the \\S+ of the \\S+ as"
_FACTOR = "times the rate of the"
_FAST = "for a tenth of the time: is it in"
_LIES = "the vehicle lies on its back"
_HELD = "held up against gravity downwards"
_DOWN = (1.0, 0.0, 0.0, 0.0)
_SAME = (0.0, 0.0, 0.0, 1.0)
_READS = "reads better with .* it agrees with"
_LATE = "against the rate of the"
_GAPS = "gaps, the longest"
_JUMPED = "differ at the end by another time than at the beginning"
_MIXED = "the vehicle accelerates as with"
_EARLY = "its times are late, give delay"
_WEAK = "of what it is commanded, measured by the others"
_SPIKES = "jumps to .* and back"
_UPWARDS = np.array([0.0, 0.0, 1.0])
_FLIP_Z = np.array([1.0, -1.0, -1.0])
_SENSORS = (_VELOCITY, _RATE)


def _jumping_clock(name: str, shortest: float, longest: float, pattern: str) -> Kind:
    """Make the kind of a clock that jumps by `shortest` to `longest` [s]; pattern: of its doubt."""
    how = f"clock of {name} jumps by {shortest:g} to {longest:g} s"
    return Kind("time", how, name, (pattern,), _times(name, _jump(shortest, longest)))


KINDS = (
    Kind("unit", "velocity in mm/s", _VELOCITY, (_FACTOR, _FAST), _values(_VELOCITY, _scaled(1e3))),
    Kind("unit", "rate in deg/s", _RATE, (_FACTOR,), _values(_RATE, _scaled(180.0 / np.pi))),
    Kind("unit", "position in mm", "position", (_FACTOR, _FAST), _values("position", _scaled(1e3))),
    Kind("unit", "force in g", _FORCE, ("in g, not in m/s2",), _values(_FORCE, _scaled(1 / 9.81))),
    Kind(
        "unit",
        "force in ft/s2, or counts",
        _FORCE,
        ("and at rest it is .*: its units",),
        _values(_FORCE, lambda x, rng: x * rng.choice([3.2808, 100.0, 1670.0])),
    ),
    Kind(
        "unit",
        "joints in deg",
        "joint_positions",
        (_FACTOR, _FAST),
        _values("joint_positions", _scaled(180.0 / np.pi)),
    ),
    Kind(
        "unit",
        "rates of joints in deg/s",
        "joint_velocities",
        (_FACTOR,),
        _values("joint_velocities", _scaled(180.0 / np.pi)),
    ),
    *(
        Kind("axis", f"two axes of {name} exchanged", name, (_AXES,), _values(name, _exchanged(3)))
        for name in _SENSORS
    ),
    Kind(
        "axis",
        "vertical axis of the accelerometer exchanged",
        _FORCE,
        ("at rest it is along z: axes swapped",),
        _values(_FORCE, lambda x, rng: x[:, [[2, 1, 0], [0, 2, 1]][rng.integers(2)]]),
    ),
    Kind(
        "axis",
        "horizontal axes of the accelerometer exchanged",
        _FORCE,
        (_AXES,),
        _values(_FORCE, lambda x, _: x[:, [1, 0, 2]]),
    ),
    Kind(
        "axis",
        "two forces of the wrench exchanged",
        "wrench",
        ("fit the acceleration as",),
        _values("wrench", _exchanged(3)),
    ),
    Kind(
        "axis",
        "two joints exchanged",
        "joint_velocities",
        ("fits .*the rate of position",),
        _values("joint_velocities", _exchanged(3)),
    ),
    *(
        Kind("sign", f"an axis of {name} reversed", name, (_AXES,), _values(name, _flipped))
        for name in _SENSORS
    ),
    Kind(
        "sign",
        "a joint reversed",
        "joint_velocities",
        ("fits .*the rate of position",),
        _values("joint_velocities", _flipped),
    ),
    Kind(
        "sign",
        "accelerometer with z down",
        _FORCE,
        ("points down on average",),
        _values(_FORCE, lambda x, _: x * _FLIP_Z),
    ),
    Kind(
        "frame", "velocity in W", _VELOCITY, ("its axes fit the rate of the \\S+ in W",), _in_world
    ),
    Kind(
        "frame",
        "velocity with z down",
        _VELOCITY,
        (_AXES,),
        _values(_VELOCITY, lambda x, _: x * _FLIP_Z),
    ),
    Kind(
        "frame",
        "position with z down",
        "position",
        ("its rate fits the velocity with axes",),
        _values("position", lambda x, _: x * _FLIP_Z),
    ),
    Kind(
        "frame",
        "depth as height, without an accelerometer",
        "position",
        ("above a surface at 0: z down",),
        _without(_values("position", lambda x, _: x * _FLIP_Z), _FORCE),
    ),
    Kind(
        "frame",
        "pressure as height, without velocity and accelerometer",
        "position",
        (": a pressure in",),
        _without(
            _values("position", lambda x, _: x * [1.0, 1.0, -98.0] + [0.0, 0.0, 1013.0]),
            _FORCE,
            _VELOCITY,
        ),
    ),
    Kind(
        "frame",
        "pressure in kPa as height",
        "position",
        (_ALONE,),
        _values("position", lambda x, _: x * [1.0, 1.0, -9.807] + [0.0, 0.0, 101.3]),
    ),
    Kind(
        "frame",
        "pressure in kPa as height, from the surface on, without velocity and accelerometer",
        "position",
        ("begins as large as air in kPa",),
        _without(_values("position", _from_air), _FORCE, _VELOCITY),
    ),
    Kind(
        "frame",
        "a height of the other sign",
        "position",
        ("moves against the velocity",),
        _values("position", lambda x, _: x * [1.0, 1.0, -1.0]),
    ),
    Kind(
        "frame",
        "heights from far below",
        "position",
        ("from where, or in which unit",),
        _values("position", lambda x, rng: x + rng.uniform(150.0, 600.0) * _UPWARDS),
    ),
    Kind(
        "unit",
        "one velocity in mm/s",
        _VELOCITY,
        ("alone up to",),
        _values(_VELOCITY, lambda x, rng: x * _one_of_three(1e3, rng)),
    ),
    Kind(
        "unit",
        "one rate in deg/s",
        _RATE,
        ("times as fast as the attitude: in deg/s",),
        _values(_RATE, lambda x, rng: x * _one_of_three(180.0 / np.pi, rng)),
    ),
    Kind(
        "unit",
        "roll and pitch in rad beside yaw in deg",
        _ATTITUDE,
        ("in rad beside deg",),
        _values(_ATTITUDE, _flattened),
    ),
    Kind(
        "mounting",
        "a velocity of another scale",
        _VELOCITY,
        ("times the way that the position goes",),
        _values(_VELOCITY, lambda x, rng: x * rng.choice([0.85, 0.93, 1.05, 1.15, 1.3])),
    ),
    Kind(
        "mounting",
        "a velocity of turned axes",
        _VELOCITY,
        ("how is it mounted",),
        _values(_VELOCITY, _tilted),
    ),
    Kind(
        "mounting",
        "a heading that is turned a little",
        _ATTITUDE,
        ("beside the way of the position",),
        _values(_ATTITUDE, _slightly_turned),
    ),
    Kind(
        "mounting",
        "a lever arm of 0.08 to 0.4 m",
        _VELOCITY,
        ("measured elsewhere than the position",),
        _from_a_lever,
    ),
    Kind(
        "mounting",
        "a gyro of another scale",
        _RATE,
        ("times the rate at which the attitude turns",),
        _values(_RATE, lambda x, rng: x * rng.choice([0.85, 0.93, 1.05, 1.15, 1.3])),
    ),
    Kind(
        "mounting",
        "a gyro of turned axes",
        _RATE,
        ("are not those of the attitude, but turned by",),
        _values(_RATE, _turned_gyro),
    ),
    Kind(
        "mounting",
        "a bias of the gyro",
        _RATE,
        ("while the attitude stands for what is right",),
        _values(_RATE, _biased),
    ),
    Kind(
        "identity",
        "an attitude that is lost for a while",
        _ATTITUDE,
        ("turns otherwise than the angular_velocity at",),
        _change(_ATTITUDE, _lost_attitude),
    ),
    *(
        Kind(
            "identity",
            f"{name} of another time",
            name,
            ("is explained by the other; of another run", _LATE, "and goes on from there"),
            _values(name, _of_another_time),
        )
        for name in ("position", _VELOCITY, _RATE, _FORCE)
    ),
    Kind(
        "identity",
        "a position that is set anew",
        "position",
        ("and goes on from there",),
        _change("position", _set_anew),
    ),
    Kind(
        "identity",
        "two senders of positions",
        "position",
        ("goes to and fro between two series",),
        _values("position", _of_two_senders),
    ),
    *(
        Kind(
            "attitude",
            f"roll, pitch and yaw in the order {name}",
            _ATTITUDE,
            ("reads better with .*were it of roll, pitch and yaw",),
            _values(_ATTITUDE, _in_another_order(order, axes)),
        )
        for name, order, axes in (
            ("3-1-2", "ZXY", (2, 0, 1)),
            ("2-1-3", "YXZ", (1, 0, 2)),
            ("1-2-3", "XYZ", (0, 1, 2)),
        )
    ),
    *(
        Kind(
            "digits",
            f"a column of {name} with few digits",
            name,
            ("too few digits, which make an error",),
            _values(name, _with_few_digits(shortest, longest)),
        )
        for name, shortest, longest in (
            ("position", 0.12, 0.5),
            (_VELOCITY, 0.06, 0.2),
            (_RATE, 0.06, 0.2),
        )
    ),
    Kind(
        "attitude",
        "world and body with z down",
        _ATTITUDE,
        (_READS,),
        _values(_ATTITUDE, _turned(_DOWN, _DOWN)),
    ),
    Kind(
        "attitude",
        "world with z down",
        _ATTITUDE,
        (_LIES, _HELD),
        _values(_ATTITUDE, _turned(_DOWN, _SAME)),
    ),
    Kind(
        "attitude",
        "from W to B",
        _ATTITUDE,
        (_READS,),
        _values(_ATTITUDE, lambda x, _: x * [-1.0, -1.0, -1.0, 1.0]),
    ),
    Kind(
        "attitude",
        "w first",
        _ATTITUDE,
        (_READS,),
        _values(_ATTITUDE, lambda x, _: x[:, [3, 0, 1, 2]]),
    ),
    Kind(
        "attitude",
        "w first, and the attitude alone",
        _ATTITUDE,
        ("it is level then, which it is not as it is",),
        _without(
            _values(_ATTITUDE, lambda x, _: x[:, [3, 0, 1, 2]]),
            _FORCE,
            _VELOCITY,
            _RATE,
            "thrust",
            "wrench",
        ),
    ),
    Kind(
        "attitude",
        "a body that stands on its nose",
        _ATTITUDE,
        ("with it what holds the vehicle up is",),
        _values(_ATTITUDE, _turned(_SAME, (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)))),
    ),
    Kind(
        "attitude",
        "heading turned by 30 to 60 deg",
        _ATTITUDE,
        ("points elsewhere",),
        _values(_ATTITUDE, _heading),
    ),
    Kind(
        "attitude",
        "angles in deg as rad",
        _ATTITUDE,
        ("rad: in deg",),
        _as_file(_ATTITUDE, _angles),
    ),
    *(
        Kind(
            "time",
            f"times of {name} in ms",
            name,
            ("s between samples: the unit of its times",),
            _times(name, lambda t, _: 1e3 * t),
        )
        for name in ("position", _VELOCITY)
    ),
    *(_jumping_clock(name, 0.45, 0.7, _JUMPED) for name in _SENSORS),
    *(_jumping_clock(name, 1.0, 5.0, _GAPS) for name in _SENSORS),
    *(
        Kind("time", f"samples of {name} lost for a while", name, (_GAPS,), _change(name, _lost))
        for name in _SENSORS
    ),
    Kind("time", "messages held up", _VELOCITY, ("arrives in bursts",), _times(_VELOCITY, _bursts)),
    Kind(
        "time",
        "clock of another day",
        _RATE,
        ("other clocks, or other units of times|too few to look at|no time is in all channels",),
        _times(_RATE, lambda t, rng: t + rng.uniform(1e2, 1e5)),
    ),
    Kind(
        "time",
        "clock of the commands",
        "thrust",
        ("the vehicle accelerates .* what it says: a clock of its own", _EARLY),
        _times("thrust", _clock),
    ),
    Kind(
        "time",
        "commands logged late",
        "thrust",
        (_EARLY,),
        _times("thrust", lambda t, rng: t + rng.uniform(0.3, 0.9)),
    ),
    Kind("time", "silence", "times", ("nothing is recorded for",), _silent),
    Kind(
        "time",
        "times without decimals",
        "position",
        ("samples had the time of another",),
        _as_file("position", _few_digits),
    ),
    Kind(
        "time",
        "a clock set back",
        "position",
        ("times go back by up to",),
        _as_file("position", _set_back),
    ),
    *(
        Kind(
            "delay",
            f"{name} 0.3 to 1.5 s late",
            name,
            (_LATE,),
            _times(name, lambda t, rng: t + rng.uniform(0.3, 1.5)),
        )
        for name in (*_SENSORS, "joint_velocities")
    ),
    *(
        Kind(
            "repeats",
            f"{name} stops for 3 to 20 s",
            name,
            ("stays exactly as it is from",),
            _values(name, _stuck),
        )
        for name in ("position", *_SENSORS)
    ),
    *(
        Kind(
            "sentinels",
            f"{value:g} in 1 to 8 % of {name}",
            name,
            ("samples, all others",),
            _values(name, _sometimes(value, 0.01, 0.08)),
        )
        for value, name in ((-32.768, _VELOCITY), (-9999.0, "position"))
    ),
    Kind(
        "sentinels",
        "-32.768 in 12 to 20 % of the velocity",
        _VELOCITY,
        ("samples, all others",),
        _values(_VELOCITY, _sometimes(-32.768, 0.12, 0.2)),
    ),
    Kind(
        "sentinels",
        "a value near the others in 2 to 8 % of the velocity",
        _VELOCITY,
        (_SPIKES,),
        _values(_VELOCITY, _sometimes(1.0, 0.02, 0.08, spread=2.0)),
    ),
    Kind(
        "sentinels",
        "0 in 2 to 20 % of the velocity",
        _VELOCITY,
        ("samples are exactly zero: lost ones",),
        _values(_VELOCITY, _sometimes(0.0, 0.02, 0.2)),
    ),
    *(
        Kind(
            "dead",
            f"an axis of {name} stays 0",
            name,
            ("dead: .* stay within",),
            _values(name, _with_one_dead),
        )
        for name in _SENSORS
    ),
    Kind(
        "dead",
        "a position of a joint stays 0",
        "joint_positions",
        ("stays where it is, and its velocity does not",),
        _values("joint_positions", _with_one_dead),
    ),
    Kind(
        "dead",
        "a velocity of a joint stays 0",
        "joint_velocities",
        ("stays as it is, and its position moves",),
        _values("joint_velocities", _with_one_dead),
    ),
    Kind(
        "dead",
        "one command throughout",
        "thrust",
        ("nothing in it ever changes",),
        _values("thrust", lambda x, _: 0.0 * x + x[0]),
    ),
    Kind(
        "dead",
        "commands of 0 throughout",
        "thrust",
        ("zero throughout, and the vehicle moves",),
        _values("thrust", _scaled(0.0)),
    ),
    Kind(
        "dead",
        "velocities of two joints of three",
        "joint_velocities",
        ("of them, and .* positions",),
        _values("joint_velocities", lambda x, _: x[:, :2]),
    ),
    Kind("thrusters", "two exchanged", "thrust", (_MIXED,), _values("thrust", _exchanged(8))),
    Kind("thrusters", "one reversed", "thrust", (_MIXED,), _values("thrust", _flipped)),
    Kind(
        "thrusters",
        "one gives half of its command or less",
        "thrust",
        (_WEAK,),
        _values("thrust", _weakened),
    ),
    Kind(
        "thrusters",
        "pulses of 1500 +- 400 us as newtons",
        "thrust",
        ("pulse widths in us",),
        _values("thrust", lambda x, _: 1500.0 + 400.0 * x / np.abs(x).max()),
    ),
    Kind(
        "thrusters",
        "shares as newtons",
        "thrust",
        ("shares of the largest command\\?",),
        _values("thrust", lambda x, _: x / np.abs(x).max()),
    ),
    Kind(
        "thrusters",
        "counts about an offset",
        "thrust",
        ("never near 0: its offset",),
        _values("thrust", lambda x, rng: x / np.abs(x).max() * 60.0 + rng.uniform(160.0, 500.0)),
    ),
    Kind(
        "thrusters",
        "1500 +- 500 us as +- 400",
        "propeller_commands",
        ("largest command are at most 1",),
        _of_other_pulses,
    ),
    Kind(
        "thrusters",
        "pulses of 0 as shares",
        "propeller_commands",
        ("of its numbers, all others within 1",),
        _of_off_propellers,
    ),
    Kind(
        "thrusters",
        "more than they can give",
        "thrust",
        ("than they can give: a fit takes it for given",),
        _values("thrust", _scaled(10.0)),
    ),
    *(
        Kind(
            "saturation",
            f"{name} within 0.3 to 0.7 of its range",
            name,
            ("is never beyond",),
            _values(name, _saturated),
        )
        for name in _SENSORS
    ),
    Kind("gravity", "taken out", _FORCE, ("gravity taken out",), _ungravitated),
    Kind(
        "time",
        "two sensors in one table",
        _VELOCITY,
        ("two sensors\\?",),
        _change(_VELOCITY, _of_two),
    ),
    Kind(
        "file",
        "latitude and longitude as position",
        "position",
        ("degrees on the globe",),
        _as_file("position", _globe),
    ),
    Kind(
        "file",
        "a column given twice",
        _VELOCITY,
        ("stands for more than one of its axes",),
        _as_file(_VELOCITY, _twice),
    ),
    Kind(
        "file",
        "cells without a number",
        _VELOCITY,
        ("rows have NaN",),
        _as_file(_VELOCITY, _open_cells),
    ),
    Kind(
        "file",
        "a unit that is not known",
        _VELOCITY,
        ("as the file says, and taken for",),
        _as_file(_VELOCITY, _unit),
    ),
    Kind(
        "file",
        "a last row that breaks off",
        _RATE,
        ("breaks off",),
        _as_file(_RATE, lambda *_: None, rows=_cut),
    ),
    Kind(
        "water",
        "a current of 0.07 to 0.6 m/s",
        "current",
        ("that a fit takes for still water",),
        _in_current,
    ),
)
