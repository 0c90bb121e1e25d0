"""Cut recordings into shooting segments: what a simulation needs of them, commands step by step and the
samples of each sensor.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.errors import InvalidInput
from uvms_ocp.identification import recording as recordings
from uvms_ocp.identification.model import N_Q, PAST, PAST_STEP, Vehicle
from uvms_ocp.identification.resampling import (
    ZeroOrderHold,
    angular_rate,
    interpolated,
    pose_velocity,
    rotations,
    smoothed,
)
from uvms_ocp.robot import limits

RATE_WINDOW = 0.6
"""[s] over which attitude is smoothed for an angular velocity that is not recorded."""
POSE_INTERVAL = 0.2
"""[s] between the poses from which a linear velocity is taken that is not recorded."""
COMMANDS = ("thrust", "wrench", "propeller_commands")
"""Channels that may hold the commands of a recording."""
_JOINT_WINDOW = 0.4  # [s] over which the positions of joints are smoothed
_LEARNT_DELAY = 0.2  # [s] by which a delay of commands that is learnt may be more than assumed
_MOST_LEFT_OUT = 0.2  # share of a recording that may be left out at its beginning


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Segment:
    """Segment of one recording for multiple shooting, in steps of equal length."""

    recording: str
    """Name of the recording."""
    edges: np.ndarray
    """(n + 1,) [s] edges of its steps."""
    commands: ZeroOrderHold
    """Commands of the actuators."""
    joints: np.ndarray
    """(3 n_j, n) [rad, rad/s, rad/s2] motion of the joints in the middle of each step, as in
    `StageFunctions`.
    """
    t: tuple[np.ndarray, ...]
    """Three of (m,) [s]: times of the samples of each sensor."""
    measured: tuple[np.ndarray, ...]
    """Three of (m, 3) [m/s, rad/s, -] samples of each sensor."""
    q: np.ndarray
    """(7,) [m, -] measured pose at the beginning, its position 0."""
    v: np.ndarray
    """(6,) [m/s, rad/s] measured velocity in B at the beginning."""

    @property
    def step(self) -> float:
        """[s] length of a step."""
        return float(self.edges[1] - self.edges[0])

    def first(self, duration: float) -> Segment:
        """Return the first part of the segment, of a duration [s] and at least a step."""
        n = min(max(1, round(duration / self.step)), len(self.edges) - 1)
        return _cut(self, 0, n, self.q, self.v)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PreparedRecording:
    """A recording with the angular velocity, commands of actuators and joints that follow from its
    channels.
    """

    recording: recordings.Recording
    """Recording with a linear velocity, as measured or taken from its positions."""
    has_velocity: bool
    """True if the linear velocity was measured."""
    rate: recordings.Channel
    """Angular velocity in B [rad/s], as measured or taken from the attitude."""
    commands: ZeroOrderHold
    """Commands of the actuators [N, N m]."""
    joints: recordings.Channel | None
    """Positions [rad or m] of the joints, where the vehicle has any."""
    vertical: np.ndarray
    """(n, 3) [-] W's vertical in B, of each sample of the attitude."""
    span: tuple[float, float]
    """[s] begin and end of the time in which all channels, and all commands that act, are known."""

    @staticmethod
    def of(
        recording: recordings.Recording, vehicle: Vehicle, window: float = RATE_WINDOW
    ) -> PreparedRecording:
        """Prepare a recording; window: [s] over which attitude is smoothed where no angular
        velocity is recorded.

        Without a linear velocity means between positions take its place.

        Raises InvalidInput for a channel that is missing or of other joints or actuators, and for
        channels that have no time in common.
        """
        attitude = recording.channel("attitude")
        channels = recording.channels
        begin, end = recording.span
        if not begin < end:
            spans = f"one channel begins at {begin:.6g} s, and another has ended at {end:.6g} s"
            raise InvalidInput(
                f"{recording.name}: {spans}; give channels of one clock, with times in common"
            )
        has_velocity = "linear_velocity" in channels
        if not has_velocity and "position" in channels:
            velocity = pose_velocity(channels["position"], attitude, POSE_INTERVAL)
            recording = replace(recording, channels={**channels, "linear_velocity": velocity})
        recording.channel("linear_velocity")
        rate = recording.channels.get("angular_velocity")
        if rate is None:
            grid, omega = angular_rate(attitude, window)
            t = attitude.undelayed_t
            t = t[(t >= grid[0]) & (t <= grid[-1])]
            rate = recordings.Channel(t=t, values=interpolated(t, grid, omega))
        actuator_commands = _actuator_commands(recording, vehicle)
        joints = _joint_positions(recording, vehicle)
        vertical = rotations(attitude, attitude.undelayed_t)[:, 2, :].copy()
        return PreparedRecording(
            recording=recording,
            has_velocity=has_velocity,
            rate=rate,
            commands=ZeroOrderHold(actuator_commands),
            joints=joints,
            vertical=vertical,
            span=(_begin_of_known_commands(begin, end, actuator_commands, vehicle), end),
        )

    def segments(self, step: float, duration: float | None = None) -> tuple[Segment, ...]:
        """Cut the recording, in steps of `step` [s], into equal segments of about `duration` [s];
        by default into one.

        Raises InvalidInput where they would not have a step.
        """
        begin, end = self.span
        n_steps = int((end - begin) / step)
        n_segments = 1
        if duration:
            n_segments = max(1, round(n_steps * step / duration))
        if n_steps < n_segments:
            request = (
                f"{self.recording.name}: {end - begin:.4g} s in stretches of"
                f" {duration or np.inf:g} s"
            )
            raise InvalidInput(
                f"{request}; a step takes {step:g} s: record more, or give longer stretches or"
                " shorter steps"
            )
        whole = self._whole(begin + step * np.arange(n_steps + 1))
        n_each = n_steps // n_segments
        return self._parts(whole, n_each * np.arange(n_segments), n_each)

    def windows(self, step: float, start_window: float, horizon: float) -> tuple[Segment, ...]:
        """Cut segments in steps of `step` [s], of the times `start_window` [s] and `horizon` [s]
        after it, that begin a horizon apart.

        Their horizons follow each other without gaps; the last one, if it is cut off, is left out.
        """
        (whole,) = self.segments(step)
        n_before = round(start_window / step)
        n_after = round(horizon / step)
        n_steps = len(whole.edges) - 1
        begins = np.arange(0, n_steps - n_before - n_after + 1, n_after)
        return self._parts(whole, begins, n_before + n_after)

    def _whole(self, edges: np.ndarray) -> Segment:
        """Make one segment of the whole recording, in steps with edges (n + 1,) [s]; its pose and
        velocity at the beginning are left at 0.
        """
        attitude = self.recording.channel("attitude")
        velocity = self.recording.channel("linear_velocity")
        return Segment(
            recording=self.recording.name,
            edges=edges,
            commands=self.commands,
            joints=_joint_motion(self.joints, edges),
            t=(velocity.undelayed_t, self.rate.undelayed_t, attitude.undelayed_t),
            measured=(velocity.values, self.rate.values, self.vertical),
            q=np.zeros(7),
            v=np.zeros(6),
        )

    def _parts(self, whole: Segment, begins: np.ndarray, n: int) -> tuple[Segment, ...]:
        """Cut segments of n steps from a whole recording; begins: (m,) index of their first edges."""
        t = whole.edges[begins]
        attitude = self.recording.channel("attitude")
        turns = interpolated(t, attitude.undelayed_t, attitude.values)
        attitudes = turns / np.linalg.norm(turns, axis=1, keepdims=True)
        q = np.hstack([np.zeros((len(t), 3)), attitudes])
        linear = interpolated(t, whole.t[0], whole.measured[0])
        angular = interpolated(t, whole.t[1], whole.measured[1])
        v = np.hstack([linear, angular])
        parts = []
        for i, k in enumerate(begins.tolist()):
            parts.append(_cut(whole, k, k + n, q[i], v[i]))
        return tuple(parts)


def _cut(segment: Segment, first: int, last: int, q: np.ndarray, v: np.ndarray) -> Segment:
    """Return the part of a segment between two of its edges, which begins at pose q (7,) and
    velocity v (6,).
    """
    edges = segment.edges[first : last + 1]
    times = []
    measured = []
    for t, values in zip(segment.t, segment.measured, strict=True):
        begin = np.searchsorted(t, edges[0])
        end = np.searchsorted(t, edges[-1], side="right")
        times.append(t[begin:end])
        measured.append(values[begin:end])
    return replace(
        segment,
        edges=edges,
        joints=segment.joints[:, first:last],
        t=tuple(times),
        measured=tuple(measured),
        q=q,
        v=v,
    )


def _begin_of_known_commands(
    begin: float, end: float, commands: recordings.Channel, vehicle: Vehicle
) -> float:
    """Return the time [s] from which on all commands that act are among those recorded, in a recording
    from begin to end [s].

    What was commanded before the first row acts on for as long as actuators lag, and its commands
    are late. It is known where the first row commands nothing; in a recording that is too short for
    anything else the first commands are taken as held for long.
    """
    if not commands.values[0].any():
        return begin
    delay = vehicle.shared.declaration.quantities["delay"]
    lead = PAST * PAST_STEP + delay.value.item()
    if delay.free.any():
        lead += _LEARNT_DELAY
    known_from = max(begin, float(commands.undelayed_t[0]) + lead)
    if known_from - begin > _MOST_LEFT_OUT * (end - begin):
        return begin
    return known_from


def _actuator_commands(recording: recordings.Recording, vehicle: Vehicle) -> recordings.Channel:
    """Return the commands of the actuators: the recorded ones, turned to theirs by the allocation."""
    name = vehicle.actuators.commands or _only_commands(recording)
    channel = recording.channel(name)
    allocation = vehicle.actuators.allocation
    if name == "thrust":
        channel = channel.of(vehicle.actuators.names, f"{recording.name}: thrust")
    if channel.values.shape[1] != allocation.shape[1]:
        problem = f"{recording.name}: {name} has {channel.values.shape[1]} columns"
        raise InvalidInput(f"{problem}; the actuators' allocation takes {allocation.shape[1]}")
    return recordings.Channel(
        t=channel.t, values=channel.values @ allocation.T, delay=channel.delay
    )


def _only_commands(recording: recordings.Recording) -> str:
    """Return the name of the one channel of `COMMANDS` that a recording has."""
    names = [name for name in COMMANDS if name in recording.channels]
    if len(names) != 1:
        raise InvalidInput(
            f"{recording.name}: commands {names} recorded; allowed: one of {', '.join(COMMANDS)}"
        )
    return names[0]


def _joint_positions(
    recording: recordings.Recording, vehicle: Vehicle
) -> recordings.Channel | None:
    """Return the positions of the vehicle's joints, in its order."""
    names = tuple(joint.name for joint in limits.joints_of(vehicle.dynamics.model, free_flyer=True))
    if not names and "joint_positions" not in recording.channels:
        return None
    channel = recording.channel("joint_positions").of(names, f"{recording.name}: joint_positions")
    if channel.values.shape[1] != vehicle.dynamics.model.nq - N_Q:
        problem = f"{recording.name}: joint_positions has {channel.values.shape[1]} columns"
        raise InvalidInput(f"{problem}; the vehicle has joints {', '.join(names) or 'of no arm'}")
    return channel


def _joint_motion(channel: recordings.Channel | None, edges: np.ndarray) -> np.ndarray:
    """Compute position, velocity and acceleration (3 n_j, n) of the joints in the middle of steps
    with edges (n + 1,) [s].
    """
    middle = (edges[1:] + edges[:-1]) / 2
    if channel is None:
        return np.zeros((0, len(middle)))
    rows = []
    for derivative in range(3):
        t, values = smoothed(channel.undelayed_t, channel.values, _JOINT_WINDOW, derivative)
        rows += [np.interp(middle, t, column) for column in values.T]
    return np.array(rows)
