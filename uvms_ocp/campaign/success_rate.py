"""A share of runs with its confidence interval."""

from __future__ import annotations

from typing import Any

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.types import AtLeastOne, Count

_FEW = 10  # runs with or without the event, below which Wilson's normal approximation does not hold


@checked_dataclass()
class Rate:
    """Rate of an event with its confidence interval. Raises `InvalidInput` for more cases than
    runs.
    """

    number: Count
    """Number of runs with the event."""
    runs: AtLeastOne
    """Number of all runs."""

    def __post_init__(self) -> None:
        if self.number > self.runs:
            raise InvalidInput(f"{self.number} of {self.runs} runs; give at most all of them")

    @property
    def share(self) -> float:
        """Share of the runs with the event."""
        return self.number / self.runs

    @property
    def method(self) -> str:
        """Name of the interval: Wilson's, or the exact one of Clopper and Pearson where runs with or
        without the event are rare.
        """
        if min(self.number, self.runs - self.number) < _FEW:
            return "Clopper-Pearson"
        return "Wilson"

    @property
    def interval(self) -> tuple[float, float]:
        """(lower, upper) [-] interval that holds the true share in 95 % of all campaigns."""
        from scipy.stats import binomtest

        kind: Any = "exact" if self.method == "Clopper-Pearson" else "wilson"
        confidence = binomtest(self.number, self.runs).proportion_ci(0.95, method=kind)
        return float(confidence.low), float(confidence.high)

    def to_dict(self) -> dict[str, Any]:
        """Return the rate, its interval and the method as JSON values."""
        lower, upper = self.interval
        counts = {"number": self.number, "runs": self.runs, "share": self.share}
        return {**counts, "lower": lower, "upper": upper, "method": self.method}

    def __str__(self) -> str:
        lower, upper = self.interval
        shown = f"{100 * self.share:.2f} % ({self.number} of {self.runs})"
        return f"{shown}, 95 % interval {100 * lower:.2f} to {100 * upper:.2f} % ({self.method})"
