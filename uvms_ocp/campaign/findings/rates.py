"""A share of runs with its interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from uvms_ocp.arguments import AtLeastOne, Count, checked
from uvms_ocp.exceptions import InvalidInput

_FEW = 10  # of either kind, below which Wilson's normal approximation is left


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class Rate:
    """How often something happened. Raises `InvalidInput` for more cases than runs."""

    number: Count
    """[-] of the runs in which it did."""
    runs: AtLeastOne
    """[-] of all."""

    def __post_init__(self) -> None:
        if self.number > self.runs:
            raise InvalidInput(f"{self.number} of {self.runs} runs; give at most all of them")

    @property
    def share(self) -> float:
        """[-]"""
        return self.number / self.runs

    @property
    def method(self) -> str:
        """Wilson's interval, or the exact one of Clopper and Pearson where either kind is rare."""
        return "Clopper-Pearson" if min(self.number, self.runs - self.number) < _FEW else "Wilson"

    @property
    def interval(self) -> tuple[float, float]:
        """(lower, upper) [-] that holds the true share in 95 % of all campaigns."""
        from scipy.stats import binomtest

        kind: Any = "exact" if self.method == "Clopper-Pearson" else "wilson"
        found = binomtest(self.number, self.runs).proportion_ci(0.95, method=kind)
        return float(found.low), float(found.high)

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        lower, upper = self.interval
        own = {"number": self.number, "runs": self.runs, "share": self.share}
        return {**own, "lower": lower, "upper": upper, "method": self.method}

    def __str__(self) -> str:
        lower, upper = self.interval
        shown = f"{100 * self.share:.2f} % ({self.number} of {self.runs})"
        return f"{shown}, 95 % interval {100 * lower:.2f} to {100 * upper:.2f} % ({self.method})"
