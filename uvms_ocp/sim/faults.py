"""Faults: targets, kinds and values in one table, the fault as a value, and its notation
``TARGET:KIND=VALUES@ONSET-END``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files

import tomllib

from uvms_ocp.checks import checked, checked_constructor, checked_dataclass
from uvms_ocp.errors import InvalidInput, NameNotFound, require_known, short
from uvms_ocp.robot.channels import CHANNELS
from uvms_ocp.types import DAY, Bound

_LARGEST = 1e6
_SHORT_NAMES = {"altimeter": "altimeter_range"}
_COUNTER = re.compile(r"[1-9]\d{0,3}")

_ENCODERS = {"position": "joint_positions", "velocity": "joint_velocities"}

_EARLY = 1e-9  # [s] a tick that rounding puts just before a time counts

_FORM = (
    "TARGET:KIND=VALUES@ONSET-END, such as altimeter:frozen@8, position:bias=5,0,0@10-20 or"
    " thruster3:dead@20"
)
_DECIMAL = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TEXT = re.compile(
    r"(?P<target>\w+):(?P<kind>\w+)"
    rf"(?:=(?P<values>{_DECIMAL}(?:,{_DECIMAL})*))?"
    rf"(?:@(?P<onset>{_DECIMAL})(?:-(?P<end>{_DECIMAL}))?)?",
    re.ASCII,
)
_LONGEST = 200


@dataclass(frozen=True, kw_only=True, slots=True)
class ValueRange:
    """Range of a number that a kind of fault takes."""

    what: str
    """Meaning of the number in words, with its unit."""
    lower: float = -_LARGEST
    """[unit of the value] lowest number that is allowed, or, where `above`, not allowed any more.
    """
    upper: float = _LARGEST
    """[unit of the value] highest number that is allowed, or, where `below`, not allowed any more.
    """
    above: bool = False
    """True where `lower` itself is too little."""
    below: bool = False
    """True where `upper` itself is too much."""

    def holds(self, value: float) -> bool:
        """Check that a value [unit of the value] is allowed."""
        if self.above and value == self.lower:
            return False
        if self.below and value == self.upper:
            return False
        return self.lower <= value <= self.upper

    def __str__(self) -> str:
        lower = f"more than {self.lower:g}" if self.above else f"{self.lower:g}"
        upper = f"less than {self.upper:g}" if self.below else f"{self.upper:g}"
        return f"{self.what}, {lower} to {upper}"


@dataclass(frozen=True, kw_only=True, slots=True)
class FaultModel:
    """Effect and values of one kind of fault."""

    effect: str
    """Effect in words."""
    values: tuple[ValueRange, ...] = ()
    fewest: int | None = None
    """Number of values that must be given; all by default."""
    for_each: bool = False
    """True where its one value may also be given for each component of the channel."""

    def takes(self, n: int) -> bool:
        """Check that n values may be given."""
        if self.for_each:
            return n >= 1
        return self.least <= n <= len(self.values)

    @property
    def least(self) -> int:
        """Number of values that must be given."""
        if self.fewest is None:
            return len(self.values)
        return self.fewest

    def range_of(self, index: int) -> ValueRange:
        """Return the allowed range of the value at index."""
        if self.for_each:
            return self.values[0]
        return self.values[index]


def _families() -> dict[str, dict[str, FaultModel]]:
    """Read the kinds in the table ``faults.toml``; encoders have those of sensors that concern the
    values of a reading.
    """
    table = tomllib.loads((files("uvms_ocp.sim") / "faults.toml").read_text(encoding="utf-8"))
    families = dict[str, dict[str, FaultModel]]()
    for family, kinds in table.items():
        families[family] = {}
        for name, kind in kinds.items():
            values = tuple(ValueRange(**value_range) for value_range in kind.pop("values", ()))
            families[family][name] = FaultModel(**kind, values=values)
    encoder = families.pop("values")
    messages = families.pop("messages")
    return {"sensor": encoder | messages, "encoder": encoder, **families}


FAMILIES: Mapping[str, dict[str, FaultModel]] = _families()
"""Kinds by the family of their target: a channel, one joint's reading in it, a thruster, a joint,
the water, the tool.
"""


@dataclass(frozen=True, kw_only=True, slots=True)
class FaultTarget:
    """Part that a fault affects."""

    name: str
    """Spelling in faults."""
    family: str
    """Key of `FAMILIES`."""
    channel: str = ""
    """One of `CHANNELS` or a user's own, for sensors and encoders."""
    number: int = 0
    """Number of a thruster, joint or tool, from 1; 0 of what has none, and of the first tool where
    none is given.
    """


@lru_cache(maxsize=1024)
def target_of(name: str) -> FaultTarget:
    """Return the target of that name, such as ``altimeter``, ``joint3_position``, ``joint2``, ``current``
    or ``payload2``; ``own_NAME`` is a user's own channel NAME.

    Raises `NameNotFound` for any other.
    """
    name = _SHORT_NAMES.get(name, name)
    if name in CHANNELS:
        return FaultTarget(name=name, family="sensor", channel=name)
    own = re.fullmatch(r"own_(\w+)", name, re.ASCII)
    if own is not None:
        return FaultTarget(name=name, family="sensor", channel=own[1])
    if name in ("current", "payload"):
        return FaultTarget(name=name, family=name)
    numbered = re.fullmatch(
        rf"(thruster|joint|payload)({_COUNTER.pattern})(?:_(position|velocity))?", name
    )
    if numbered is None or (numbered[1] != "joint" and numbered[3]):
        raise NameNotFound("target of a fault", name, fault_targets(name))
    if numbered[3]:
        channel = _ENCODERS[numbered[3]]
        return FaultTarget(name=name, family="encoder", channel=channel, number=int(numbered[2]))
    return FaultTarget(name=name, family=numbered[1], number=int(numbered[2]))


def fault_targets(like: str = "") -> tuple[str, ...]:
    """Return the names of targets, with the number of the name that they are to be like."""
    counter = _COUNTER.search(like)
    k = counter[0] if counter is not None else "1"
    numbered = (
        f"thruster{k}",
        f"joint{k}",
        f"joint{k}_position",
        f"joint{k}_velocity",
        f"payload{k}",
    )
    return (*CHANNELS, *_SHORT_NAMES, *numbered, "current", "payload", "own_NAME")


def kind_of(target: FaultTarget, name: str) -> FaultModel:
    """Return the kind of that name. Raises `NameNotFound` where the target has no such fault."""
    kinds = FAMILIES[target.family]
    require_known(f"fault of {target.name}", name, kinds)
    return kinds[name]


@checked_dataclass(check=checked_constructor)
class Fault:
    """One fault. `uvms_ocp.sim.faults` has the table of targets, kinds and values.

    Raises `NameNotFound` for an unknown target or kind, and `InvalidInput` for values or times that
    are impossible.
    """

    target: str
    """A channel such as ``altimeter``, or ``joint3_position``, ``thruster3``, ``joint2``,
    ``current``, ``payload2``; ``own_NAME`` for a user's own channel NAME.
    """
    kind: str
    """Kind of fault of that target, such as ``frozen``."""
    values: tuple[float, ...] = ()
    """[units of the kind] numbers of the fault, such as a size or a share."""
    onset: float = 0.0
    """[s] time from which the fault is there."""
    end: Bound = math.inf
    """[s] Time from which all is well again; inf: never."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "target", target_of(self.target).name)
        # Whole numbers are numbers too.
        object.__setattr__(self, "values", tuple(float(value) for value in self.values))
        object.__setattr__(self, "onset", float(self.onset))
        object.__setattr__(self, "end", float(self.end))
        _require_values(self)
        if not 0.0 <= self.onset <= DAY:
            raise InvalidInput(
                f"onset of {self.target}:{self.kind} = {self.onset:g} s; give 0 to {DAY:g} s"
            )
        is_within_day = self.end <= DAY or self.end == math.inf
        if not (self.onset < self.end and is_within_day):
            times = f"onset = {self.onset:g} s, end = {self.end:g} s"
            raise InvalidInput(
                f"{self.target}:{self.kind} with {times}; give an end after the onset, within a day"
            )

    def __str__(self) -> str:
        """Return the text that `parse_fault` reads."""
        text = f"{self.target}:{self.kind}"
        if self.values:
            text += f"={','.join(plain(value) for value in self.values)}"
        text += f"@{plain(self.onset)}"
        if self.end != math.inf:
            text += f"-{plain(self.end)}"
        return text

    @property
    def location(self) -> FaultTarget:
        """The target, looked up by its name."""
        return target_of(self.target)

    def active(self, t: float) -> bool:
        """Check that it is there at time t [s]."""
        return is_active(self.onset, self.end, t)


def is_active(onset: float, end: float, t: float) -> bool:
    """Check that something that lasts from `onset` [s] to `end` [s] is there at time t [s]."""
    return onset <= t + _EARLY < end


def plain(number: float) -> str:
    """Return the shortest text that `float` reads as the same number [any unit]."""
    return repr(number).removesuffix(".0")


def _require_values(fault: Fault) -> None:
    kind = kind_of(fault.location, fault.kind)
    n = len(fault.values)
    fault_name = f"{fault.target}:{fault.kind}"
    if not kind.takes(n):
        allowed = "; ".join(map(str, kind.values)) or "none"
        optional = f", the first {kind.least} of them" if kind.least < len(kind.values) else ""
        each = ", or one for each component" if kind.for_each else ""
        raise InvalidInput(f"{fault_name} with {n} values; give {allowed}{optional}{each}")
    for index, value in enumerate(fault.values):
        if not kind.range_of(index).holds(value):
            raise InvalidInput(
                f"{fault_name} with the value {value:g}; give {kind.range_of(index)}"
            )


@checked
def parse_fault(text: str) -> Fault:
    """Return the fault that ``TARGET:KIND=VALUES@ONSET-END`` describes: without values, onset 0 and
    no end where these are left out; ``str`` of a fault is the way back.

    Times in s, values in the units of the kind. Raises `InvalidInput` and `NameNotFound`, in one
    line.
    """
    parts = _TEXT.fullmatch(text.strip()) if len(text) <= _LONGEST else None
    if parts is None:
        raise InvalidInput(f"fault {short(text)}; write {_FORM}")
    values: tuple[float, ...] = ()
    if parts["values"]:
        values = tuple(float(word) for word in parts["values"].split(","))
    onset = float(parts["onset"] or 0.0)
    end = float(parts["end"] or math.inf)
    return Fault(target=parts["target"], kind=parts["kind"], values=values, onset=onset, end=end)


def parse_faults(faults: Iterable[str | Fault]) -> tuple[Fault, ...]:
    """Return faults, of which some may be texts. Raises `InvalidInput` and `NameNotFound`, in one
    line.
    """
    if not isinstance(faults, Iterable):
        raise InvalidInput(f"faults = {short(faults)}; give a list of faults, each as {_FORM}")
    parsed = list[Fault]()
    for fault in faults:
        if isinstance(fault, Fault):
            parsed.append(fault)
        else:
            parsed.append(parse_fault(fault))
    return tuple(parsed)
