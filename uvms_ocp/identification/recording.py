"""Recordings of a moving vehicle as values: channels of samples, resampling, and cuts at gaps.

Frames are those of `uvms_ocp.robot.spatial`: W with z up, B forward-left-up. What a file has
otherwise is turned when it is read, see `uvms_ocp.identification.mapped_recordings`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files

import numpy as np
import tomllib

from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.robot.spatial import quaternion_to_matrix
from uvms_ocp.types import frozen_mapping, read_only

CHANNEL_TABLE = tomllib.loads(
    (files("uvms_ocp.identification") / "channels.toml").read_text(encoding="utf-8")
)
"""Channels, and units that their values may be given in."""

SECONDS: Mapping[str, float] = CHANNEL_TABLE["units"]["s"]
"""[s] of the units that times are given in."""
GRID = 0.05
"""[s] between uniform samples before they are smoothed."""
LONGEST_GAP = 2.0
"""[s] without a sample of any channel, from which on a recording is cut."""
SHORTEST = 5.0
"""[s] of a part that is kept: less tells next to nothing."""
_MOST = 20_000_000  # uniform samples: 11 days
_NORM = 1e-2  # by which quaternions may differ from 1: they are stored with few digits


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelKind:
    """Kind of a channel: unit, columns and frame of its values."""

    unit: str
    columns: tuple[str, ...] = ()
    """Names; empty where a vehicle has as many as it has joints or thrusters."""
    frame: str = ""
    """Frame of its vectors, W or B."""
    command: bool = False
    """Asked for, not measured: held from one sample to the next."""


CHANNEL_KINDS: Mapping[str, ChannelKind] = {
    name: ChannelKind(**entry | {"columns": tuple(entry.get("columns", ()))})
    for name, entry in CHANNEL_TABLE["channels"].items()
}
"""Every channel that a recording may have, by its name."""


def _units_by_spelling() -> dict[str, str]:
    """Return the names of all units of the table by their letters, lower case and without blanks."""
    units_by_spelling = {}
    for units in CHANNEL_TABLE["units"].values():
        for name in units:
            units_by_spelling[name.lower().replace(" ", "")] = name
    return units_by_spelling


_BY_SPELLING = _units_by_spelling()


def unit_named(spelling: str) -> str:
    """Find the name of a unit in the table of channels from any spelling; empty for an unknown
    unit.
    """
    plain = spelling.lower()
    for pattern, name in CHANNEL_TABLE["spelling"]["in_place_of"]:
        plain = re.sub(pattern, name, plain)
    return _BY_SPELLING.get(plain, "")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Channel:
    """Samples of one thing, at times of their own. Raises InvalidInput for times that do not
    increase, and wrong shapes.
    """

    t: np.ndarray
    """(n,) [s] when it was measured, or sent."""
    values: np.ndarray
    """(n, k) [unit of its kind], finite."""
    delay: float = 0.0
    """[s] by which its times are known to be late."""
    back: float = 0.0
    """[s] by which times went back in the file at most, whose samples are in order here."""
    repeated: int = 0
    """Samples left out, for another had their time."""
    echoes: int = 0
    """Number of samples left out because they repeat the one before."""
    missing: int = 0
    """Samples left out, for something in them was not measured."""
    columns: tuple[str, ...] = ()
    """Names of joints or thrusters, where whoever recorded them says so."""
    constants: tuple[int, ...] = ()
    """Places of columns that were not measured: their numbers are whoever's gave the mapping."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", read_only(self.t, np.float64))
        object.__setattr__(self, "values", read_only(self.values, np.float64))
        if (
            self.t.ndim != 1
            or self.values.ndim != 2
            or len(self.t) != len(self.values)
            or len(self.t) < 2
        ):
            raise InvalidInput(
                f"{self.t.shape} times, {self.values.shape} values given; allowed: (n,) and (n, k),"
                " n > 1"
            )
        if not (
            np.isfinite(self.t).all() and np.isfinite(self.values).all() and np.isfinite(self.delay)
        ):
            raise InvalidInput("NaN or infinity given; leave out samples that are not known")
        if not (np.diff(self.t) > 0.0).all():
            first = int(np.argmin(np.diff(self.t) > 0.0))
            raise InvalidInput(
                f"time goes from {self.t[first]:.6f} to {self.t[first + 1]:.6f} s; allowed:"
                " increasing"
            )

    def of(self, names: tuple[str, ...], where: str) -> Channel:
        """Put the columns in the order of names, as far as the channel names them itself.

        Raises InvalidInput for a channel of others; `where` says which.
        """
        if not self.columns or self.columns == names:
            return self
        if sorted(self.columns) != sorted(names):
            raise InvalidInput(
                f"{where} is of {', '.join(self.columns)}; allowed: {', '.join(names) or 'none'}"
            )
        return replace(
            self, values=self.values[:, [self.columns.index(name) for name in names]], columns=names
        )

    @property
    def rate(self) -> float:
        """[Hz] samples in a second, on average."""
        return float((len(self.t) - 1) / (self.t[-1] - self.t[0]))

    @property
    def undelayed_t(self) -> np.ndarray:
        """(n,) [s] without the delay."""
        if self.delay:
            return self.t - self.delay
        return self.t


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Recording:
    """Channels by the names of `CHANNEL_KINDS`, their times on one clock. Raises NameNotFound and
    InvalidInput.
    """

    name: str
    channels: Mapping[str, Channel]
    issues_in_file: tuple[tuple[str, str], ...] = ()
    """Issues that the file itself reports, as pairs of channel and text."""
    layout: tuple[str, ...] = ()
    """How files were understood."""
    whole: str = ""
    """Name of the recording that it is a part of."""
    at_once: bool = False
    """True where commands act from their times on, as in runs of this toolkit."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", frozen_mapping(self.channels))
        for name, channel in self.channels.items():
            require_known("channel", name, CHANNEL_KINDS)
            column_names = CHANNEL_KINDS[name].columns
            width = channel.values.shape[1]
            if column_names and width != len(column_names):
                raise InvalidInput(
                    f"{self.name}: {name}: {width} columns given; allowed: {len(column_names)},"
                    f" {', '.join(column_names)}"
                )
        attitude = self.channels.get("attitude")
        if (
            attitude is not None
            and np.abs(np.linalg.norm(attitude.values, axis=1) - 1.0).max() > _NORM
        ):
            raise InvalidInput(
                f"{self.name}: attitude holds no unit quaternions; say what it holds by its format"
            )

    @property
    def source(self) -> str:
        """Name of the recording that it is, or is a part of."""
        return self.whole or self.name

    def channel(self, name: str) -> Channel:
        """Return a channel by its name. Raises InvalidInput with those that there are."""
        if name not in self.channels:
            recorded_text = f"{self.name}: no {name} is recorded, only {', '.join(self.channels)}"
            needs = (
                "a fit needs attitude, linear_velocity or position, commands, and positions of"
                " joints: map it too"
            )
            needs += ", or give the axes along which alone it moves"
            raise InvalidInput(
                f"{recorded_text}; {needs}, or see what `uvms-ocp check-recording` says of these alone"
            )
        return self.channels[name]

    @property
    def span(self) -> tuple[float, float]:
        """[s] from when to when all channels are known."""
        times = [channel.undelayed_t for channel in self.channels.values()]
        return max(t[0] for t in times), min(t[-1] for t in times)


# Channels at any times: commands as they are held, measurements smoothed.


class ZeroOrderHold:
    """A command that stays from one sample to the next; before the first it is as the first."""

    def __init__(self, channel: Channel) -> None:
        t = channel.undelayed_t
        values = channel.values
        self.channel = channel
        self._t = t
        self._whole = np.cumsum(
            np.vstack([np.zeros(values.shape[1]), values[:-1] * np.diff(t)[:, None]]), axis=0
        )
        """(n, k) [unit of the channel times s] integral up to each sample."""

    def at(self, t: np.ndarray) -> np.ndarray:
        """Return values (m, k) [unit of the channel] at t (m,) [s]."""
        return self.channel.values[self._index(t)]

    def mean(self, edges: np.ndarray) -> np.ndarray:
        """Compute means (m - 1, k) [unit of the channel] between edges (m,) [s]: smooth in these,
        whatever the samples do.
        """
        return np.asarray(np.diff(self.total(edges), axis=0) / np.diff(edges)[:, None])

    def total(self, t: np.ndarray) -> np.ndarray:
        """Integral (m, k) [unit of the channel times s] from the first sample to t (m,) [s]."""
        index = self._index(t)
        return self._whole[index] + self.channel.values[index] * (t - self._t[index])[:, None]

    def mean_slope(self, edges: np.ndarray) -> np.ndarray:
        """Rate (m - 1, k) [unit of the channel per s] of these means where all edges (m,) [s] move
        together.
        """
        return np.asarray(np.diff(self.at(edges), axis=0) / np.diff(edges)[:, None])

    def _index(self, t: np.ndarray) -> np.ndarray:
        return np.asarray(
            np.clip(np.searchsorted(self._t, t, side="right") - 1, 0, len(self.channel.t) - 1)
        )


def interpolated(at: np.ndarray, t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values (m, k) [any] at times at (m,) [s], linear between samples (n, k) [any] at t
    (n,) [s].
    """
    return np.column_stack([np.interp(at, t, column) for column in values.T])


def smoothed(
    t: np.ndarray, values: np.ndarray, window: float, derivative: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Uniform times (m,) [s] and there, by local quadratics over `window` [s], values or their
    derivative (m, k) [any].

    t: (n,) [s] and values: (n, k) [any] of the samples, interpolated between them. Raises
    InvalidInput for times that are too far apart or too near to each other.
    """
    from scipy.signal import savgol_filter  # half a second, which few need

    if not 2 * window < t[-1] - t[0] < GRID * _MOST:
        raise InvalidInput(
            f"times from {t[0]:g} to {t[-1]:g} s given; allowed: {2 * window:g} s to"
            f" {GRID * _MOST:g} s"
        )
    grid = np.arange(t[0], t[-1], GRID)
    length = max(3, round(window / GRID) // 2 * 2 + 1)
    return grid, savgol_filter(
        interpolated(grid, t, values), length, 2, deriv=derivative, delta=GRID, axis=0
    )


def angular_rate(attitude: Channel, window: float) -> tuple[np.ndarray, np.ndarray]:
    """Uniform times (m,) [s] and the angular velocity in B (m, 3) [rad/s] of an attitude, smoothed
    over `window` [s].
    """
    t, quaternions = smoothed(attitude.undelayed_t, attitude.values, window)
    _, rates = smoothed(attitude.undelayed_t, attitude.values, window, derivative=1)
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    a, b, c, d = rates.T
    # Twice the vector part of the conjugate times the rate.
    omega = 2 * np.column_stack(
        [
            w * a - x * d - y * c + z * b,
            w * b - y * d - z * a + x * c,
            w * c - z * d - x * b + y * a,
        ]
    )
    return t, omega


def pose_velocity(position: Channel, attitude: Channel, interval: float) -> Channel:
    """Compute mean velocities in B (m, 3) [m/s] between poses about `interval` [s] apart, in the
    middle of each.
    """
    times = position.undelayed_t
    span = attitude.undelayed_t[[0, -1]]
    stride = max(1, round(interval / float(np.median(np.diff(times)))))
    chosen = np.flatnonzero((times >= span[0]) & (times <= span[1]))[::stride]
    t = times[chosen]
    rates = np.diff(position.values[chosen], axis=0) / np.diff(times[chosen])[:, None]
    at = (t[1:] + t[:-1]) / 2
    return Channel(t=at, values=np.einsum("nji,nj->ni", rotations(attitude, at), rates))


def rotations(attitude: Channel, t: np.ndarray) -> np.ndarray:
    """Return R_WB (m, 3, 3) at t (m,) [s], interpolated between samples."""
    quaternions = interpolated(t, attitude.undelayed_t, attitude.values)
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return np.moveaxis(np.array(quaternion_to_matrix(quaternions.T)), -1, 0)


# Recordings with silences, cut there: what was commanded while nothing was recorded is known to
# nobody.
#
# A clock that is set while it records leaves one too, as long as it was moved.


def split_at_gaps(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Cut recordings into parts at their silences. Raises InvalidInput for one that has no part of
    `SHORTEST`.
    """
    parts: list[Recording] = []
    for recording in recordings:
        parts += _parts(recording)
    return tuple(parts)


def _parts(recording: Recording) -> list[Recording]:
    """Cut a recording at its silences; the first part says so. Channels without a time in common are
    no matter of silences.
    """
    silences = _silences(recording)
    begin, end = recording.span
    if not len(silences) or begin >= end:
        return [recording]
    lengths = silences[:, 1] - silences[:, 0]
    longest = int(np.argmax(lengths))
    begins = [-np.inf, *silences[:, 1]]
    ends = [*silences[:, 0], np.inf]
    parts: list[Recording] = []
    for begin, end in zip(begins, ends, strict=True):
        part = _between(recording, begin, end)
        if part is not None:
            name = f"{recording.name} part {len(parts) + 1}"
            parts.append(replace(part, name=name, whole=recording.name))
    if not parts:
        silence_text = (
            f"{recording.name}: nothing is recorded for up to {lengths[longest]:.3g} s, again and"
            " again"
        )
        raise InvalidInput(
            f"{silence_text}; allowed: {SHORTEST:g} s at least without {LONGEST_GAP:g} s of silence: look"
            " at its times"
        )
    silence = f"nothing is recorded for {lengths[longest]:.3g} s at {silences[longest, 0]:.3g} s"
    issue = ("times", f"{silence}: lost, or a clock that was set? It is cut where it is silent")
    parts[0] = replace(parts[0], issues_in_file=(*recording.issues_in_file, issue))
    return parts


def _silences(recording: Recording) -> np.ndarray:
    """Return silences (n, 2) [s]: the last sample before each, and the first after it."""
    t = np.unique(np.concatenate([channel.undelayed_t for channel in recording.channels.values()]))
    last = np.flatnonzero(np.diff(t) > LONGEST_GAP)
    return np.column_stack([t[last], t[last + 1]])


def _between(recording: Recording, begin: float, end: float) -> Recording | None:
    """Cut a recording from one time [s] to another; `None` if that is too short."""
    channels = {}
    for name, channel in recording.channels.items():
        inside = (channel.undelayed_t >= begin) & (channel.undelayed_t <= end)
        if inside.sum() < 2:
            return None
        channels[name] = replace(channel, t=channel.t[inside], values=channel.values[inside])
    part = replace(recording, channels=channels)
    if part.span[1] - part.span[0] < SHORTEST:
        return None
    return part
