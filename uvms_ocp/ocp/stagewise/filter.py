"""Filter of points: accepted are those that no point seen before beats in cost and violation alike
[Waechter2006].
"""

from __future__ import annotations

from dataclasses import dataclass, field

_SHARE = 1e-5  # of the violation by which one of both must become less
_ARMIJO = 1e-4  # of the descent that the slope promises
# violation, beside the first one, below which descent alone decides: it chooses between two rules of
# acceptance, and no end of a search depends on it
_LOUD = 1e-4


@dataclass(kw_only=True, slots=True)
class Filter:
    """Remembers what must not come again."""

    first: float
    """Violation of the first point."""
    most: float
    """Violation that is never accepted."""
    entries: list[FilterMerit] = field(default_factory=list)
    """Points that were left for less violation."""

    def accepts(self, trial: FilterMerit, merit: FilterMerit, slope: float, share: float) -> bool:
        """Check whether a `share` of a step may be taken along which the cost has the `slope`."""
        if not (
            trial.violation <= self.most and all(_better(trial, entry) for entry in self.entries)
        ):
            return False
        rounding = 1e-13 * max(1.0, abs(merit.cost))
        if self.descends(merit, slope, share):
            return trial.cost <= merit.cost + _ARMIJO * share * slope + rounding
        return _better(trial, merit) or (
            trial.violation <= 1e-12 and trial.cost <= merit.cost + rounding
        )

    def descends(self, merit: FilterMerit, slope: float, share: float) -> bool:
        """Check whether a share of a step along the slope is taken for descent of the cost."""
        if merit.violation > _LOUD * max(1.0, self.first) or slope >= 0.0:
            return False
        return bool(share * (-slope) ** 2.3 > merit.violation**1.1)


@dataclass(frozen=True, kw_only=True, slots=True)
class FilterMerit:
    """Merit of a point: cost and violation."""

    cost: float
    violation: float
    """Sum over all rows"""

    @property
    def residual(self) -> float:
        """Norm whose half square is the cost."""
        return float((2 * self.cost) ** 0.5)


def _better(trial: FilterMerit, entry: FilterMerit) -> bool:
    return (
        trial.violation <= (1 - _SHARE) * entry.violation
        or trial.cost <= entry.cost - _SHARE * entry.violation
    )
