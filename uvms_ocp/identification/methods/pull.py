"""A number of the unknowns that is drawn to a value, as if it had been measured.

Where a search ends, the number is a little off the value, and all else is where it is best for the number as it is there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Pull:
    """Of one number."""

    number: Callable[[np.ndarray], tuple[float, np.ndarray]]
    """From the unknowns (n,) [as `Unknowns.start`]: the number [any], and its slope (n,) [any per unknown]."""
    target: float
    """[as the number]"""
    sigma: float
    """[as the number] by which it may be off at the price of a half."""

    def cost(self, shared: np.ndarray) -> float:
        """[-] at the unknowns shared (n,) [as `Unknowns.start`]."""
        return ((self.number(shared)[0] - self.target) / self.sigma) ** 2 / 2

    def normal(self, shared: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What it adds to the normal equations, (n, n) and (n,), at the unknowns shared (n,) [as `Unknowns.start`]."""
        value, slope = self.number(shared)
        return np.outer(slope, slope) / self.sigma**2, slope * (value - self.target) / self.sigma**2
