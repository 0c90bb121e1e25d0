"""Recordings of a moving vehicle as values: channels of samples, with their units and frames.

Frames are those of `uvms_ocp.robot.spatial`: W with z up, B forward-left-up. What a file has
otherwise is turned when it is read, see `uvms_ocp.identification.mapped_recordings`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files

import numpy as np
import tomllib

from uvms_ocp.errors import InvalidInput, require_known
from uvms_ocp.types import frozen_mapping, read_only

CHANNEL_TABLE = tomllib.loads(
    (files("uvms_ocp.identification") / "channels.toml").read_text(encoding="utf-8")
)
"""Channels, and units that their values may be given in."""
SECONDS: Mapping[str, float] = CHANNEL_TABLE["units"]["s"]
"""[s] of the units that times are given in."""
_NORM = 1e-2  # by which quaternions may differ from 1: they are stored with few digits


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


def _units_by_spelling() -> dict[str, str]:
    """Return the names of all units of the table by their letters, lower case and without blanks."""
    units_by_spelling = {}
    for units in CHANNEL_TABLE["units"].values():
        for name in units:
            units_by_spelling[name.lower().replace(" ", "")] = name
    return units_by_spelling


def unit_named(spelling: str) -> str:
    """Find the name of a unit in the table of channels from any spelling; empty for an unknown
    unit.
    """
    plain = spelling.lower()
    for pattern, name in CHANNEL_TABLE["spelling"]["in_place_of"]:
        plain = re.sub(pattern, name, plain)
    return _BY_SPELLING.get(plain, "")


CHANNEL_KINDS: Mapping[str, ChannelKind] = {
    name: ChannelKind(**entry | {"columns": tuple(entry.get("columns", ()))})
    for name, entry in CHANNEL_TABLE["channels"].items()
}
"""Every channel that a recording may have, by its name."""


_BY_SPELLING = _units_by_spelling()
