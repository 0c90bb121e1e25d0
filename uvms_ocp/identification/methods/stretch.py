"""A stretch of a recording as a simulation needs it: what was commanded step by step, and what was seen when."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.identification.models.stage import N_Q, Vehicle
from uvms_ocp.identification.recordings.recording import Channel, Recording
from uvms_ocp.identification.recordings.sampling import Held, angular_rate, rotations, smoothed

N_SEEN = 9
"""[-] rows of what is seen, as `Stage.seen` has them: velocity, angular velocity, vertical; three of each."""
RATE_WINDOW = 0.6
"""[s] over which attitude is smoothed for an angular velocity that is not recorded."""
COMMANDS = ("thrust", "wrench", "propeller_commands")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Stretch:
    """Of one recording, all steps as long."""

    recording: str
    edges: np.ndarray
    """(n + 1,) [s] of its steps."""
    commands: Held
    """Of actuators."""
    joints: np.ndarray
    """(3 n_j, n) [rad, rad/s, rad/s2] in the middle of each step, as `Stage` has them."""
    t: tuple[np.ndarray, ...]
    """Three of (m,) [s]: of the samples of each sensor."""
    seen: tuple[np.ndarray, ...]
    """Three of (m, 3) [m/s, rad/s, -]"""
    q: np.ndarray
    """(7,) [m, -] about where the vehicle was at the beginning."""
    v: np.ndarray
    """(6,) [m/s, rad/s]"""

    @property
    def step(self) -> float:
        """[s]"""
        return float(self.edges[1] - self.edges[0])

    def first(self, duration: float) -> Stretch:
        """Its first part of some duration [s], at least a step."""
        n = min(max(1, round(duration / self.step)), len(self.edges) - 1)
        return _cut(self, 0, n, self.q, self.v)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Prepared:
    """A recording with what follows from its channels: a rate of turning, commands of actuators, joints."""

    recording: Recording
    rate: Channel
    commands: Held
    joints: Channel | None
    """Their positions, where the vehicle has any."""

    @staticmethod
    def of(recording: Recording, vehicle: Vehicle, window: float = RATE_WINDOW) -> Prepared:
        """window: [s] over which attitude is smoothed where no angular velocity is recorded.

        Raises NameNotFound for a channel that is missing, and InvalidInput for one of other joints or actuators and for
        channels that have no time in common.
        """
        attitude, _ = recording.channel("attitude"), recording.channel("linear_velocity")
        _require_span(recording)
        rate = recording.channels.get("angular_velocity")
        if rate is None:
            t, omega = angular_rate(attitude, window)
            at = attitude.known_t[(attitude.known_t >= t[0]) & (attitude.known_t <= t[-1])]
            rate = Channel(t=at, values=np.column_stack([np.interp(at, t, column) for column in omega.T]))
        commands = Held(_told(recording, vehicle))
        return Prepared(recording=recording, rate=rate, commands=commands, joints=_moved(recording, vehicle))

    def stretches(self, step: float, duration: float | None = None) -> tuple[Stretch, ...]:
        """The recording in steps of `step` [s], cut into equal stretches of about `duration` [s]; all of it by default.

        Raises InvalidInput where they would not have a step.
        """
        begin, end = self.recording.span
        total = int((end - begin) / step)
        n = max(1, round(total * step / duration)) if duration else 1
        if total < n:
            given = f"{self.recording.name}: {end - begin:.4g} s in stretches of {duration or np.inf:g} s"
            raise InvalidInput(
                f"{given}; a step takes {step:g} s: record more, or give longer stretches or shorter steps"
            )
        size, whole = total // n, self._whole(begin + step * np.arange(total + 1))
        return tuple(self._stretch(whole, k * size, (k + 1) * size) for k in range(n))

    def windows(self, step: float, known: float, horizon: float) -> tuple[Stretch, ...]:
        """Stretches in steps of `step` [s], of the times `known` [s] and `horizon` [s] after it, that begin a horizon apart.

        Their horizons follow each other without gaps; the last one, if it is cut off, is left out.
        """
        (whole,) = self.stretches(step)
        before, after, n = round(known / step), round(horizon / step), len(whole.edges) - 1
        begins = range(0, n - before - after + 1, after)
        return tuple(self._stretch(whole, first, first + before + after) for first in begins)

    def _whole(self, edges: np.ndarray) -> Stretch:
        attitude, velocity = self.recording.channel("attitude"), self.recording.channel("linear_velocity")
        vertical = rotations(attitude, attitude.known_t)[:, 2, :]
        seen = (velocity.known_t, velocity.values), (self.rate.known_t, self.rate.values), (attitude.known_t, vertical)
        return Stretch(
            recording=self.recording.name,
            edges=edges,
            commands=self.commands,
            joints=_joints(self.joints, edges),
            t=tuple(t for t, _ in seen),
            seen=tuple(values for _, values in seen),
            q=np.zeros(7),
            v=np.zeros(6),
        )

    def _stretch(self, whole: Stretch, first: int, last: int) -> Stretch:
        t = whole.edges[first]
        attitude = self.recording.channel("attitude")
        quaternion = np.array([np.interp(t, attitude.known_t, column) for column in attitude.values.T])
        v = [np.interp(t, whole.t[k], column) for k in (0, 1) for column in whole.seen[k].T]
        q = np.concatenate([np.zeros(3), quaternion / np.linalg.norm(quaternion)])
        return _cut(whole, first, last, q, np.array(v))


def _cut(whole: Stretch, first: int, last: int, q: np.ndarray, v: np.ndarray) -> Stretch:
    edges = whole.edges[first : last + 1]
    inside = [(t >= edges[0]) & (t <= edges[-1]) for t in whole.t]
    return Stretch(
        recording=whole.recording,
        edges=edges,
        commands=whole.commands,
        joints=whole.joints[:, first:last],
        t=tuple(t[chosen] for t, chosen in zip(whole.t, inside, strict=True)),
        seen=tuple(values[chosen] for values, chosen in zip(whole.seen, inside, strict=True)),
        q=q,
        v=v,
    )


def _told(recording: Recording, vehicle: Vehicle) -> Channel:
    """What each actuator was told."""
    name = vehicle.actuators.commands or _only_commands(recording)
    channel, allocation = recording.channel(name), vehicle.actuators.allocation
    if name == "thrust":
        channel = channel.of(vehicle.actuators.names, f"{recording.name}: thrust")
    if channel.values.shape[1] != allocation.shape[1]:
        given = f"{recording.name}: {name} has {channel.values.shape[1]} columns"
        raise InvalidInput(f"{given}; the actuators' allocation takes {allocation.shape[1]}")
    return Channel(t=channel.t, values=channel.values @ allocation.T, delay=channel.delay)


def _only_commands(recording: Recording) -> str:
    names = [name for name in COMMANDS if name in recording.channels]
    if len(names) != 1:
        raise InvalidInput(f"{recording.name}: commands {names} recorded; allowed: one of {', '.join(COMMANDS)}")
    return names[0]


def _moved(recording: Recording, vehicle: Vehicle) -> Channel | None:
    """Positions of the vehicle's joints, in its order."""
    names = tuple(vehicle.dynamics.model.names)[2:]  # after the universe and the vehicle
    if not names and "joint_positions" not in recording.channels:
        return None
    channel = recording.channel("joint_positions").of(names, f"{recording.name}: joint_positions")
    if channel.values.shape[1] != vehicle.dynamics.model.nq - N_Q:
        given = f"{recording.name}: joint_positions has {channel.values.shape[1]} columns"
        raise InvalidInput(f"{given}; the vehicle has joints {', '.join(names) or 'of no arm'}")
    return channel


def _require_span(recording: Recording) -> None:
    begin, end = recording.span
    if not begin < end:
        given = f"one channel begins at {begin:.6g} s, and another has ended at {end:.6g} s"
        raise InvalidInput(f"{recording.name}: {given}; give channels of one clock, with times in common")


def _joints(channel: Channel | None, edges: np.ndarray, window: float = 0.4) -> np.ndarray:
    middle = (edges[1:] + edges[:-1]) / 2
    if channel is None:
        return np.zeros((0, len(middle)))
    parts = [smoothed(channel.known_t, channel.values, window, derivative) for derivative in range(3)]
    return np.array([np.interp(middle, t, column) for t, values in parts for column in values.T])
