"""Filter of points: accepted are those that no point seen before beats in cost and violation alike
[Waechter2006].
"""

from __future__ import annotations

from dataclasses import dataclass, field

_SUFFICIENT_SHARE = 1e-5  # share of the violation by which it, or the cost, must become less
_ARMIJO = 1e-4  # share of the descent that the slope promises
# violation, beside the first one, above which descent of the cost alone never decides: it chooses
# between two rules of acceptance, and no end of a search depends on it
_LARGE_VIOLATION = 1e-4
_NO_VIOLATION = 1e-12  # violation that is rounding
# [1/unit of the row] cost, as a share of itself or of 1, that a point may rise by for what it
# breaks less. Without it a hair of a violation would allow any rise.
_LARGEST_PRICE = 1e4


@dataclass(kw_only=True, slots=True)
class Filter:
    """Filter of a line search, which remembers the points that must not come again."""

    first_violation: float
    """Violation of the first point."""
    largest_violation: float
    """Violation above which no point is accepted."""
    entries: list[FilterMerit] = field(default_factory=list)
    """Points that were left for less violation."""

    def accepts(
        self, trial: FilterMerit, merit: FilterMerit, slope: float, step_length: float
    ) -> bool:
        """Check whether a point may be taken after a share of a step, along which the cost has the
        `slope`.
        """
        if not trial.violation <= self.largest_violation:
            return False
        if not all(_is_better(trial, entry) for entry in self.entries):
            return False
        rounding = 1e-13 * max(1.0, abs(merit.cost))
        if self.descends(merit, slope, step_length):
            return trial.cost <= merit.cost + _ARMIJO * step_length * slope + rounding
        if _is_better(trial, merit):
            return True
        return trial.violation <= _NO_VIOLATION and trial.cost <= merit.cost + rounding

    def descends(self, merit: FilterMerit, slope: float, step_length: float) -> bool:
        """Check whether a share of a step along the slope is taken for descent of the cost."""
        if merit.violation > _LARGE_VIOLATION * max(1.0, self.first_violation) or slope >= 0.0:
            return False
        return bool(step_length * (-slope) ** 2.3 > merit.violation**1.1)


@dataclass(frozen=True, kw_only=True, slots=True)
class FilterMerit:
    """Merit of a point: cost and violation."""

    cost: float
    """Half square of the residual."""
    violation: float
    """[unit of the row] sum over all rows."""

    @property
    def residual(self) -> float:
        """Norm whose half square is the cost."""
        return float((2 * self.cost) ** 0.5)


def _is_better(trial: FilterMerit, entry: FilterMerit) -> bool:
    """Check that a point improves on another by enough, in violation or in cost."""
    reduction = entry.violation - trial.violation
    largest_rise = _LARGEST_PRICE * max(1.0, entry.cost) * reduction
    is_worth_its_cost = trial.cost - entry.cost <= largest_rise
    has_less_violation = reduction >= _SUFFICIENT_SHARE * entry.violation and is_worth_its_cost
    has_less_cost = trial.cost <= entry.cost - _SUFFICIENT_SHARE * entry.violation
    return has_less_violation or has_less_cost
