"""What was measured while a vehicle moved, as a value.

Frames are those of `uvms_ocp.model.spatial`: W with z up, B forward-left-up. What a file has otherwise is turned when it is
read, see `uvms_ocp.identification.recordings.mapping`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from uvms_ocp.arguments.frozen import frozen_mapping, read_only
from uvms_ocp.exceptions import InvalidInput, NameNotFound


@dataclass(frozen=True, kw_only=True, slots=True)
class Kind:
    """What the channels of one name hold."""

    unit: str
    columns: tuple[str, ...] = ()
    """Names; empty where a vehicle has as many as it has joints or thrusters."""
    frame: str = ""
    """Of its vectors, W or B."""
    command: bool = False
    """Asked for, not measured: held from one sample to the next."""


_XYZ = ("x", "y", "z")
KINDS: Mapping[str, Kind] = {
    "position": Kind(unit="m", columns=_XYZ, frame="W"),
    "attitude": Kind(unit="-", columns=("qx", "qy", "qz", "qw"), frame="W"),
    "linear_velocity": Kind(unit="m/s", columns=_XYZ, frame="B"),
    "angular_velocity": Kind(unit="rad/s", columns=_XYZ, frame="B"),
    "specific_force": Kind(unit="m/s2", columns=_XYZ, frame="B"),
    "current": Kind(unit="m/s", columns=_XYZ, frame="W"),
    "joint_positions": Kind(unit="rad or m"),
    "joint_velocities": Kind(unit="rad/s or m/s"),
    "joint_torques": Kind(unit="N m or N"),
    "wrench": Kind(unit="N, N m", columns=("fx", "fy", "fz", "mx", "my", "mz"), frame="B", command=True),
    "thrust": Kind(unit="N", command=True),
    "propeller_commands": Kind(unit="-", command=True),
}
"""Every channel that a recording may have, by its name."""
_NORM = 1e-2  # by which quaternions may differ from 1: they are stored with few digits


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Channel:
    """Samples of one thing, at times of their own. Raises InvalidInput for times that do not increase, and wrong shapes."""

    t: np.ndarray
    """(n,) [s] when it was measured, or sent."""
    values: np.ndarray
    """(n, k) [unit of its kind], finite."""
    delay: float = 0.0
    """[s] by which its times are known to be late."""
    back: float = 0.0
    """[s] by which times went back in the file at most, whose samples are in order here."""
    repeated: int = 0
    """[-] samples left out, for another had their time."""
    columns: tuple[str, ...] = ()
    """Names of joints or thrusters, where whoever recorded them says so."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", read_only(self.t, np.float64))
        object.__setattr__(self, "values", read_only(self.values, np.float64))
        if self.t.ndim != 1 or self.values.ndim != 2 or len(self.t) != len(self.values) or len(self.t) < 2:
            raise InvalidInput(
                f"{self.t.shape} times, {self.values.shape} values given; allowed: (n,) and (n, k), n > 1"
            )
        if not (np.isfinite(self.t).all() and np.isfinite(self.values).all() and np.isfinite(self.delay)):
            raise InvalidInput("NaN or infinity given; leave out samples that are not known")
        if not (np.diff(self.t) > 0.0).all():
            first = int(np.argmin(np.diff(self.t) > 0.0))
            raise InvalidInput(f"time goes from {self.t[first]:.6f} to {self.t[first + 1]:.6f} s; allowed: increasing")

    def of(self, names: tuple[str, ...], where: str) -> Channel:
        """The same with its columns in the order of names, as far as it names them itself.

        Raises InvalidInput for a channel of others; `where` says which.
        """
        if not self.columns or self.columns == names:
            return self
        if sorted(self.columns) != sorted(names):
            raise InvalidInput(f"{where} is of {', '.join(self.columns)}; allowed: {', '.join(names) or 'none'}")
        order = [self.columns.index(name) for name in names]
        return replace(self, values=self.values[:, order], columns=names)

    @property
    def rate(self) -> float:
        """[Hz] samples in a second, on average."""
        return float((len(self.t) - 1) / (self.t[-1] - self.t[0]))

    @property
    def known_t(self) -> np.ndarray:
        """(n,) [s] without the delay."""
        return self.t - self.delay


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Recording:
    """Channels by the names of `KINDS`, their times on one clock. Raises NameNotFound and InvalidInput."""

    name: str
    channels: Mapping[str, Channel]
    known_doubts: tuple[tuple[str, str], ...] = ()
    """What speaks against which channel, as far as its file says so itself."""
    at_once: bool = False
    """Whether it is known that commands act from their times on, as in runs of this toolkit."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", frozen_mapping(self.channels))
        for name, channel in self.channels.items():
            if name not in KINDS:
                raise NameNotFound("channel", name, KINDS)
            _check_width(f"{self.name}: {name}", KINDS[name], channel)
        attitude = self.channels.get("attitude")
        if attitude is not None and np.abs(np.linalg.norm(attitude.values, axis=1) - 1.0).max() > _NORM:
            raise InvalidInput(f"{self.name}: attitude holds no unit quaternions; say what it holds by its format")

    def channel(self, name: str) -> Channel:
        """One of them. Raises NameNotFound with those that there are."""
        if name not in self.channels:
            raise NameNotFound("channel", name, self.channels)
        return self.channels[name]

    @property
    def span(self) -> tuple[float, float]:
        """[s] from when to when all channels are known."""
        times = [channel.known_t for channel in self.channels.values()]
        return max(t[0] for t in times), min(t[-1] for t in times)


def _check_width(where: str, kind: Kind, channel: Channel) -> None:
    width = channel.values.shape[1]
    if kind.columns and width != len(kind.columns):
        raise InvalidInput(f"{where}: {width} columns given; allowed: {len(kind.columns)}, {', '.join(kind.columns)}")
