"""Recordings of a moving vehicle as values: channels of samples, with their units and frames.

Frames are those of `uvms_ocp.robot.spatial`: W with z up, B forward-left-up. What a file has
otherwise is turned when it is read, see `uvms_ocp.identification.mapped_recordings`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
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
"""[s] length of each unit that times may be given in."""
ASPECTS = ("source", "unit", "axes", "time", "delay", "offset")
"""What there is to know of a channel: where its numbers come from, their unit and scale, the frame, the
order and the signs of its columns, the unit and the beginning of its times, by how much these are
late, and what is added to its values.
"""
_NORM_ERROR = 1e-2  # of quaternions, which are stored with few digits


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Recording:
    """Channels of a moving vehicle, their times on one clock. Raises NameNotFound for an unknown
    channel, and InvalidInput for columns that it does not have.
    """

    name: str
    """Name of the recording, such as that of its file."""
    channels: Mapping[str, Channel]
    """Channels by the names of `CHANNEL_KINDS`."""
    issues_in_file: tuple[tuple[str, str], ...] = ()
    """Issues that the file itself reports, as pairs of channel and text."""
    layout: tuple[str, ...] = ()
    """Notes on how files were read, such as units of times."""
    stated: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    """What the file or its mapping states of channels, by channel and one of `ASPECTS`."""
    whole: str = ""
    """Name of the recording that it is a part of; empty for a whole one."""
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
            and np.abs(np.linalg.norm(attitude.values, axis=1) - 1.0).max() > _NORM_ERROR
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
            problem = f"{self.name}: no {name} is recorded, only {', '.join(self.channels)}"
            needs = (
                "a fit needs attitude, linear_velocity or position, commands, and positions of"
                " joints: map it too"
            )
            needs += ", or give the axes along which alone it moves"
            raise InvalidInput(
                f"{problem}; {needs}, or see what `uvms-ocp check-recording` says of these alone"
            )
        return self.channels[name]

    @property
    def span(self) -> tuple[float, float]:
        """[s] begin and end of the time in which all channels are known."""
        times = [channel.undelayed_t for channel in self.channels.values()]
        begin = max(t[0] for t in times)
        end = min(t[-1] for t in times)
        return begin, end


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Channel:
    """Samples of one quantity with their times. Raises InvalidInput for times that do not increase,
    and wrong shapes.
    """

    t: np.ndarray
    """(n,) [s] times at which samples were measured, or commands sent."""
    values: np.ndarray
    """(n, k) [unit of the channel's kind] samples, finite."""
    delay: float = 0.0
    """[s] by which the times are known to be late."""
    back: float = 0.0
    """[s] largest step back of the times in the file; samples are in order of time."""
    repeated: int = 0
    """Number of samples left out because another has their time."""
    echoes: int = 0
    """Number of samples left out because they repeat the one before."""
    missing: int = 0
    """Number of samples left out because a part of them was not measured."""
    columns: tuple[str, ...] = ()
    """Names of joints or thrusters, where the file has them."""
    constants: tuple[int, ...] = ()
    """Indices of columns that were not measured: the mapping gives their numbers."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", read_only(self.t, np.float64))
        object.__setattr__(self, "values", read_only(self.values, np.float64))
        has_shape = self.t.ndim == 1 and self.values.ndim == 2
        if not has_shape or len(self.t) != len(self.values) or len(self.t) < 2:
            raise InvalidInput(
                f"{self.t.shape} times, {self.values.shape} values given; allowed: (n,) and (n, k),"
                " n > 1"
            )
        is_known = np.isfinite(self.t).all() and np.isfinite(self.values).all()
        if not (is_known and np.isfinite(self.delay)):
            raise InvalidInput("NaN or infinity given; leave out samples that are not known")
        if not (np.diff(self.t) > 0.0).all():
            first = int(np.argmin(np.diff(self.t) > 0.0))
            raise InvalidInput(
                f"time goes from {self.t[first]:.6f} to {self.t[first + 1]:.6f} s; allowed:"
                " increasing"
            )

    def of(self, names: tuple[str, ...], where: str) -> Channel:
        """Put the columns in the order of names; a channel without names stays as it is.

        where: name of the channel in messages. Raises InvalidInput for columns of other names.
        """
        if not self.columns or self.columns == names:
            return self
        if sorted(self.columns) != sorted(names):
            raise InvalidInput(
                f"{where} is of {', '.join(self.columns)}; allowed: {', '.join(names) or 'none'}"
            )
        order = [self.columns.index(name) for name in names]
        return replace(self, values=self.values[:, order], columns=names)

    @property
    def rate(self) -> float:
        """[Hz] mean number of samples in a second."""
        return float((len(self.t) - 1) / (self.t[-1] - self.t[0]))

    @property
    def undelayed_t(self) -> np.ndarray:
        """(n,) [s] times less the delay."""
        if self.delay:
            return self.t - self.delay
        return self.t


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelKind:
    """Kind of a channel: unit, columns and frame of its values."""

    unit: str
    """Unit of its values."""
    columns: tuple[str, ...] = ()
    """Names of the columns; empty where there is one for each joint or thruster."""
    frame: str = ""
    """Frame of its vectors, W or B."""
    command: bool = False
    """True for a command, which is held from one sample to the next; False for a measurement."""


def stated_by_format(names: Iterable[str], aspects: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return what this toolkit's own files state of channels: some aspects, or all, of each."""
    stated = dict.fromkeys(aspects, "format of this toolkit")
    return dict.fromkeys(names, stated)


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


def _channel_kinds() -> dict[str, ChannelKind]:
    """Return the kinds of channels in the table."""
    kinds = {}
    for name, entry in CHANNEL_TABLE["channels"].items():
        columns = tuple(entry.get("columns", ()))
        kinds[name] = ChannelKind(**entry | {"columns": columns})
    return kinds


CHANNEL_KINDS: Mapping[str, ChannelKind] = _channel_kinds()
"""Every channel that a recording may have, by its name."""


_BY_SPELLING = _units_by_spelling()
