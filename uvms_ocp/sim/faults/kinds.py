"""Every kind of fault: what it can strike, its values and their ranges. One table for values, text and messages."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from uvms_ocp.exceptions import NameNotFound
from uvms_ocp.model.sensing import CHANNELS

_LARGEST = 1e6
_SHORT_NAMES = {"altimeter": "altimeter_range"}
_NUMBER = re.compile(r"[1-9]\d{0,3}")


@dataclass(frozen=True, kw_only=True, slots=True)
class ValueRange:
    """One number that a kind takes."""

    what: str
    """In words, with its unit."""
    lower: float = -_LARGEST
    """[unit of the value]"""
    upper: float = _LARGEST
    """[unit of the value]"""
    above: bool = False
    """Whether `lower` itself is too little."""
    below: bool = False
    """Whether `upper` itself is too much."""

    def holds(self, value: float) -> bool:
        """Whether a value [unit of the value] is allowed."""
        inside = self.lower <= value <= self.upper
        return inside and not (self.above and value == self.lower) and not (self.below and value == self.upper)

    def __str__(self) -> str:
        ends = (
            f"{'more than ' if self.above else ''}{self.lower:g} to {'less than ' if self.below else ''}{self.upper:g}"
        )
        return f"{self.what}, {ends}"


@dataclass(frozen=True, kw_only=True, slots=True)
class Kind:
    """What one kind of fault does and takes."""

    does: str
    """In words."""
    values: tuple[ValueRange, ...] = ()
    fewest: int | None = None
    """[-] number of values that must be given; all by default."""
    for_each: bool = False
    """Whether its one value may also be given for each component of the channel."""

    def takes(self, n: int) -> bool:
        """Whether n [-] values may be given."""
        return n >= 1 if self.for_each else self.least <= n <= len(self.values)

    @property
    def least(self) -> int:
        """[-] number of values that must be given."""
        return len(self.values) if self.fewest is None else self.fewest

    def range_of(self, index: int) -> ValueRange:
        """Of the value at index [-]."""
        return self.values[0] if self.for_each else self.values[index]


def _unit(what: str) -> ValueRange:
    return ValueRange(what=f"{what} [unit of the channel]")


_OF_VALUES: Mapping[str, Kind] = {
    "frozen": Kind(does="repeats its last value, with new time stamps"),
    "nan": Kind(does="reads what is no number"),
    "spikes": Kind(
        does="a share of the readings is off in one component, drawn, by the size, either way",
        values=(
            ValueRange(what="size [unit of the channel]", lower=0.0, above=True),
            ValueRange(what="share of the readings [-]", lower=0.0, upper=1.0, above=True),
        ),
    ),
    "bias": Kind(does="is off by a constant", values=(_unit("offset"),), for_each=True),
    "stuck": Kind(does="reads one value", values=(_unit("value"),), for_each=True),
}
_OF_MESSAGES: Mapping[str, Kind] = {
    "lost": Kind(does="delivers nothing new"),
    "late": Kind(
        does="delivers later than it should",
        values=(ValueRange(what="extra delay [s]", lower=0.0, upper=1e3, above=True),),
    ),
    "ahead": Kind(
        does="stamps readings with a time in the future",
        values=(ValueRange(what="by how much [s]", lower=0.0, above=True),),
    ),
}
_OF_THRUSTERS: Mapping[str, Kind] = {
    "dead": Kind(does="gives no thrust and takes no power"),
    "stuck": Kind(
        does="stays at its thrust, or goes to the one given",
        values=(ValueRange(what="thrust [N]", lower=-1e5, upper=1e5),),
        fewest=0,
    ),
    "weak": Kind(
        does="gives a share of what it should",
        values=(ValueRange(what="share [-]", lower=0.0, upper=1.0, below=True),),
    ),
    "reversed": Kind(does="pushes the other way"),
}
_FLOW = ValueRange(what="velocity in W [m/s]", lower=-10.0, upper=10.0)

FAMILIES: Mapping[str, Mapping[str, Kind]] = {
    "sensor": {**_OF_VALUES, **_OF_MESSAGES},
    "encoder": _OF_VALUES,
    "thruster": _OF_THRUSTERS,
    "joint": {"jam": Kind(does="cannot move any more")},
    "current": {
        "step": Kind(
            does="adds a current that rises over 2 s; its vertical part falls to 0 at the floor", values=(_FLOW,) * 3
        )
    },
    "payload": {
        "mass": Kind(
            does="picks up with the tool what lies still",
            values=(
                ValueRange(what="mass [kg]", lower=0.0, upper=1e4, above=True),
                ValueRange(what="displaced volume [m3]", lower=0.0, upper=10.0),
            ),
            fewest=1,
        )
    },
}
"""Kinds by the family of their target: a channel, one joint's reading in it, a thruster, a joint, the water, the tool."""

_ENCODERS = {"position": "joint_positions", "velocity": "joint_velocities"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Target:
    """What a fault strikes."""

    name: str
    """As faults spell it."""
    family: str
    """Key of `FAMILIES`."""
    channel: str = ""
    """Of sensors and encoders, one of `CHANNELS`."""
    number: int = 0
    """[-] of a thruster or joint, from 1."""


@lru_cache(maxsize=1024)
def target_of(name: str) -> Target:
    """The target of that name, such as ``altimeter``, ``joint3_position``, ``thruster3``, ``joint2``, ``current`` or ``payload``.

    Raises `NameNotFound` for any other.
    """
    name = _SHORT_NAMES.get(name, name)
    if name in CHANNELS:
        return Target(name=name, family="sensor", channel=name)
    if name in ("current", "payload"):
        return Target(name=name, family=name)
    numbered = re.fullmatch(rf"(thruster|joint)({_NUMBER.pattern})(?:_(position|velocity))?", name)
    if numbered is None or (numbered[1] == "thruster" and numbered[3]):
        raise NameNotFound("target of a fault", name, known_targets(name))
    if numbered[3]:
        return Target(name=name, family="encoder", channel=_ENCODERS[numbered[3]], number=int(numbered[2]))
    return Target(name=name, family=numbered[1], number=int(numbered[2]))


def known_targets(like: str = "") -> tuple[str, ...]:
    """Names of targets, with the number of the name that they are to be like."""
    found = _NUMBER.search(like)
    k = found[0] if found else "1"
    numbered = (f"thruster{k}", f"joint{k}", f"joint{k}_position", f"joint{k}_velocity")
    return (*CHANNELS, *_SHORT_NAMES, *numbered, "current", "payload")


def kind_of(target: Target, name: str) -> Kind:
    """The kind of that name. Raises `NameNotFound` where the target has no such fault."""
    kinds = FAMILIES[target.family]
    if name not in kinds:
        raise NameNotFound(f"fault of {target.name}", name, kinds)
    return kinds[name]
