"""What to do about measurements that stop coming."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field

from uvms_ocp.arguments import checked, late
from uvms_ocp.exceptions import InvalidInput


class Freshness(enum.IntEnum):
    """How far a measurement can be trusted."""

    FRESH = 0
    """Go on."""
    STALE = 1
    """Hold: brake along a ramp, without feedback from what is stale."""
    LOST = 2
    """Stop: no thrust; motors hold the arm."""


@checked
@dataclass(slots=True)
class Watchdog:
    """Judges the age of measurements and logs every change of its verdict in `alarms`.

    That the first readings are under way is none, unless they take `stop_after`.

    Raises `InvalidInput` unless 0 < hold_after < stop_after.
    """

    hold_after: float = 0.6
    """[s] three periods of the slowest sensor that an estimate needs, a 5 Hz DVL."""
    stop_after: float = 3.0
    """[s] after which the thrust is cut."""
    alarms: list[tuple[float, str]] = field(default_factory=list)
    """Time [s] and text of each."""
    _verdict: Freshness = field(default=Freshness.FRESH, init=False)
    """The last one that was told."""
    _begun: float = field(default=math.nan, init=False)
    """[s] time of the first question."""
    _waits: bool = field(default=True, init=False)
    """There has been no measurement yet."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.stop_after) and 0 < self.hold_after < self.stop_after):
            raise InvalidInput(
                f"watchdog: hold_after = {self.hold_after} s, stop_after = {self.stop_after} s; "
                "give 0 < hold_after < stop_after"
            )

    @property
    def verdict(self) -> Freshness:
        """The last one that was told; at first fresh."""
        return self._verdict

    @late
    def judge(self, age: float, t: float, channel: str = "") -> Freshness:
        """The verdict on a measurement of `age` [s] at time t [s], that of `channel` if known; nan counts as lost."""
        verdict = Freshness(verdict_on(age, self.hold_after, self.stop_after))
        early = self._is_early(age, t)
        if verdict is not self._verdict and not early:
            self.alarms.append((t, _told(verdict, age, channel)))
            self._verdict = verdict
        return verdict

    def _is_early(self, age: float, t: float) -> bool:
        """Whether the first readings may still be under way."""
        self._waits = self._waits and age == math.inf
        self._begun = t if math.isnan(self._begun) else self._begun
        return self._waits and t - self._begun <= self.stop_after


def verdict_on(age: float, hold_after: float, stop_after: float) -> int:
    """The `Freshness` of a measurement of `age` [s], by `hold_after` [s] and `stop_after` [s] of a `Watchdog`. A kernel."""
    if age <= hold_after:
        return Freshness.FRESH
    return Freshness.STALE if age <= stop_after else Freshness.LOST


def _told(verdict: Freshness, age: float, channel: str) -> str:
    if age == math.inf:
        return f"no {channel or 'measurements'}: stopped"
    return _TEXTS[verdict].format(what=f"{channel} is" if channel else "measurements are", age=age)


_TEXTS = {
    Freshness.FRESH: "measurements are back: going on",
    Freshness.STALE: "{what} {age:.2f} s old: holding",
    Freshness.LOST: "{what} {age:.2f} s old: stopped",
}
