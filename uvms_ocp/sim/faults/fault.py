"""A fault: what goes wrong, how much, from when and until when."""

from __future__ import annotations

import math
from dataclasses import dataclass

from uvms_ocp.arguments import DAY, Bound, checked, late
from uvms_ocp.exceptions import InvalidInput
from uvms_ocp.sim.faults.kinds import Target, kind_of, target_of

_EARLY = 1e-9  # [s] a tick that rounding puts just before a time counts


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class Fault:
    """One fault. `uvms_ocp.sim.faults.kinds` has the table of targets, kinds and values.

    Raises `NameNotFound` for an unknown target or kind, and `InvalidInput` for values or times that are impossible.
    """

    target: str
    """A channel such as ``altimeter``, or ``joint3_position``, ``thruster3``, ``joint2``, ``current``, ``payload``."""
    kind: str
    """Of that target, such as ``frozen``."""
    values: tuple[float, ...] = ()
    """[units of the kind]"""
    onset: float = 0.0
    """[s]"""
    end: Bound = math.inf
    """[s] from which all is well again; inf: never."""

    def __post_init__(self) -> None:
        target = target_of(self.target)
        object.__setattr__(self, "target", target.name)
        for name in ("values", "onset", "end"):  # whole numbers are numbers too
            value = getattr(self, name)
            object.__setattr__(self, name, tuple(map(float, value)) if name == "values" else float(value))
        _require_values(self)
        if not 0.0 <= self.onset <= DAY:
            raise InvalidInput(f"onset of {self.target}:{self.kind} = {self.onset:g} s; give 0 to {DAY:g} s")
        if not (self.onset < self.end and (self.end <= DAY or self.end == math.inf)):
            times = f"onset = {self.onset:g} s, end = {self.end:g} s"
            raise InvalidInput(f"{self.target}:{self.kind} with {times}; give an end after the onset, within a day")

    def __str__(self) -> str:
        """As `parse_fault` reads it."""
        values = f"={','.join(map(plain, self.values))}" if self.values else ""
        until = "" if self.end == math.inf else f"-{plain(self.end)}"
        return f"{self.target}:{self.kind}{values}@{plain(self.onset)}{until}"

    @property
    def strikes(self) -> Target:
        """What it strikes, looked up."""
        return target_of(self.target)

    @late
    def active(self, t: float) -> bool:
        """Whether it is there at time t [s]."""
        return is_on(self.onset, self.end, t)


def is_on(onset: float, end: float, t: float) -> bool:
    """Whether something that lasts from `onset` [s] to `end` [s] is there at time t [s]."""
    return onset <= t + _EARLY < end


def plain(number: float) -> str:
    """The shortest text that `float` reads as the same number [any unit]."""
    return repr(number).removesuffix(".0")


def _require_values(fault: Fault) -> None:
    kind, n = kind_of(fault.strikes, fault.kind), len(fault.values)
    what = f"{fault.target}:{fault.kind}"
    if not kind.takes(n):
        wanted = "; ".join(map(str, kind.values)) or "none"
        optional = f", the first {kind.least} of them" if kind.least < len(kind.values) else ""
        each = ", or one for each component" if kind.for_each else ""
        raise InvalidInput(f"{what} with {n} values; give {wanted}{optional}{each}")
    for index, value in enumerate(fault.values):
        if not kind.range_of(index).holds(value):
            raise InvalidInput(f"{what} with the value {value:g}; give {kind.range_of(index)}")
