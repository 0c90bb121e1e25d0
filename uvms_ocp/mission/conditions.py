"""What ends a phase: conditions on measured quantities, and transitions that wait for them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, TypeAlias

from uvms_ocp.arguments import checked, late
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.meta_values import ABORT as ABORT
from uvms_ocp.meta_values import DONE as DONE


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class Below:
    """True once a measured quantity, named ``task.quantity``, is below `limit`, until it reaches `release` again.

    Without `release` there is no hysteresis: both are the same. Raises `InvalidInput` for a limit that is not > 0 and a
    release below it.
    """

    sign: ClassVar[str] = "<"
    """Between quantity and limit."""
    quantity: str
    """``task.quantity``"""
    limit: float
    """[unit of the quantity] more than 0."""
    release: float | None = None
    """[unit of the quantity] at least the limit."""

    def __post_init__(self) -> None:
        _check_threshold(self.quantity, self.limit)
        if self.release is not None and not (math.isfinite(self.release) and self.release >= self.limit):
            raise InvalidInput(f"release of {self.quantity} = {self.release}; give at least the limit {self.limit:g}")

    @late
    def holds(self, quantities: Mapping[str, float], held: bool = False) -> bool:
        """Whether it is true of the quantities [in their units], given whether it was `held` to be true before.

        Raises `NameNotFound` where they lack its own.
        """
        limit = self.limit if self.release is None or not held else self.release
        return is_met(measured(self.quantity, quantities), limit, True)

    def describe(self, quantities: Mapping[str, float]) -> str:
        """One clause with the value among the quantities [in their units], true or not."""
        return _described(self, quantities)


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class Above:
    """True once a measured quantity exceeds `limit`, and until it falls to `release`; mirror of `Below`.

    Raises `InvalidInput` for a limit that is not > 0 and a release above it.
    """

    sign: ClassVar[str] = ">"
    """Between quantity and limit."""
    quantity: str
    """``task.quantity``"""
    limit: float
    """[unit of the quantity] more than 0."""
    release: float | None = None
    """[unit of the quantity] at most the limit."""

    def __post_init__(self) -> None:
        _check_threshold(self.quantity, self.limit)
        if self.release is not None and not (math.isfinite(self.release) and self.release <= self.limit):
            raise InvalidInput(f"release of {self.quantity} = {self.release}; give at most the limit {self.limit:g}")

    @late
    def holds(self, quantities: Mapping[str, float], held: bool = False) -> bool:
        """Whether it is true of the quantities [in their units], given whether it was `held` to be true before.

        Raises `NameNotFound` where they lack its own.
        """
        limit = self.limit if self.release is None or not held else self.release
        return is_met(measured(self.quantity, quantities), limit, False)

    def describe(self, quantities: Mapping[str, float]) -> str:
        """One clause with the value among the quantities [in their units], true or not."""
        return _described(self, quantities)


Condition: TypeAlias = Below | Above


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class Transition:
    """Leads to phase `to` (or `DONE`, or `ABORT`) once every condition has held for `hold` seconds without a gap.

    A transition to an earlier phase is a back-step. It fires at most `retries` times; the next time the mission is
    given up, with that as the reason. Raises `InvalidInput` where `when` is not a tuple or empty, and for a hold or retries
    below 0.
    """

    to: str
    """Name of a phase, `DONE` or `ABORT`."""
    when: tuple[Condition, ...]
    """All of them, at once."""
    hold: float = 0.0
    """[s]"""
    retries: int | None = None
    """[-] None: as often as it likes."""

    def __post_init__(self) -> None:
        if not isinstance(self.when, tuple):
            raise InvalidInput(f"transition to {self.to!r}: when = {self.when!r}; give a tuple of conditions")
        if not self.when:
            raise InvalidInput(f"transition to {self.to!r} has no conditions; give at least one")
        if not (math.isfinite(self.hold) and self.hold >= 0):
            raise InvalidInput(f"transition to {self.to!r}: hold = {self.hold} s; give a finite time >= 0")
        if self.retries is not None and self.retries < 0:
            raise InvalidInput(f"transition to {self.to!r}: retries = {self.retries}; give 0 or more")

    @late
    def holds(self, quantities: Mapping[str, float], held: bool = False) -> bool:
        """Whether all conditions are true of the quantities [in their units], given whether they were `held` to be."""
        return all(condition.holds(quantities, held) for condition in self.when)

    def describe(self, quantities: Mapping[str, float]) -> str:
        """The clauses of its conditions, with the quantities [in their units]."""
        return ", ".join(condition.describe(quantities) for condition in self.when)


def is_met(value: float, limit: float, below: bool) -> bool:
    """Whether a value is on the wanted side of a limit [its unit]: below it, or above. A kernel."""
    return value < limit if below else value > limit


def measured(quantity: str, quantities: Mapping[str, float]) -> float:
    """One of the quantities [in its unit]. Raises `NameNotFound` where they lack it."""
    try:
        return quantities[quantity]
    except KeyError:
        raise NameNotFound("quantity", quantity, quantities) from None


def _described(condition: Condition, quantities: Mapping[str, float]) -> str:
    value = measured(condition.quantity, quantities)
    if math.isnan(value):
        return f"{condition.quantity} is not known, asked {condition.sign} {condition.limit:g}"
    sign = condition.sign if condition.holds(quantities) else f"not {condition.sign}"
    return f"{condition.quantity} = {value:.4g} {sign} {condition.limit:g}"


def _check_threshold(quantity: str, limit: float) -> None:
    if not (math.isfinite(limit) and limit > 0):
        raise InvalidInput(f"threshold of {quantity} = {limit}; give a finite value > 0")
