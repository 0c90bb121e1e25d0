"""Distributions of one parameter, each by its quantiles: what a number from 0 to 1 stands for.

A sampler draws such numbers, so that a distribution serves random, Latin hypercube and Sobol' samples alike. Any frozen
distribution of scipy.stats can stand in their place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Protocol

from uvms_ocp.arguments import Finite, Positive, Range, checked
from uvms_ocp.exceptions import InvalidInput

Share = Annotated[float, Range(0.0, 1.0)]


class Distribution(Protocol):
    """Of the values of one parameter."""

    def quantile(self, u: float) -> Any:
        """The value below which a share u [-] of all values lies."""


@checked
@dataclass(frozen=True, slots=True)
class Uniform(Distribution):
    """Every value between two is as likely. Raises `InvalidInput` where they are in the wrong order."""

    lower: Finite
    """[unit of the parameter]"""
    upper: Finite
    """[unit of the parameter]"""

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise InvalidInput(f"Uniform: lower = {self.lower:g}, upper = {self.upper:g}; give a larger upper bound")

    def quantile(self, u: Share) -> float:
        """The value [unit of the parameter] below which a share u [-] lies."""
        return self.lower + u * (self.upper - self.lower)


@checked
@dataclass(frozen=True, slots=True)
class Normal(Distribution):
    """Gauss's bell; it has no bounds, so that a parameter that cannot be below 0 is better a `LogNormal`."""

    mean: Finite
    """[unit of the parameter]"""
    sigma: Positive
    """[unit of the parameter] standard deviation."""

    def quantile(self, u: Share) -> float:
        """The value [unit of the parameter] below which a share u [-] lies."""
        return self.mean + self.sigma * _standard_normal(u)


@checked
@dataclass(frozen=True, slots=True)
class LogNormal(Distribution):
    """A factor that is as likely to be twice as large as half as large: the logarithm is normal."""

    median: Positive = 1.0
    """[unit of the parameter]"""
    sigma: Positive = 0.2
    """[-] standard deviation of the natural logarithm; while small, a relative error."""

    def quantile(self, u: Share) -> float:
        """The value [unit of the parameter] below which a share u [-] lies."""
        return self.median * math.exp(self.sigma * _standard_normal(u))


@checked
@dataclass(frozen=True, slots=True)
class Triangular(Distribution):
    """Most likely at a mode, never beyond two bounds. Raises `InvalidInput` where they are in the wrong order."""

    lower: Finite
    """[unit of the parameter]"""
    mode: Finite
    """[unit of the parameter]"""
    upper: Finite
    """[unit of the parameter]"""

    def __post_init__(self) -> None:
        if not (self.lower <= self.mode <= self.upper and self.lower < self.upper):
            given = f"Triangular({self.lower:g}, {self.mode:g}, {self.upper:g})"
            raise InvalidInput(f"{given}; give lower bound, mode and upper bound in this order")

    def quantile(self, u: Share) -> float:
        """The value [unit of the parameter] below which a share u [-] lies."""
        width, left = self.upper - self.lower, self.mode - self.lower
        if u * width <= left:
            return self.lower + math.sqrt(u * width * left)
        return self.upper - math.sqrt((1.0 - u) * width * (self.upper - self.mode))


@checked
@dataclass(frozen=True, slots=True)
class Choice(Distribution):
    """One of several numbers, each as likely. Raises `InvalidInput` for none."""

    values: Sequence[Finite]
    """[unit of the parameter]"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(map(float, self.values)))
        if not self.values:
            raise InvalidInput("Choice of no values; give one or more")

    def quantile(self, u: Share) -> float:
        """The value [unit of the parameter] that a number u [-] stands for."""
        return float(self.values[min(int(u * len(self.values)), len(self.values) - 1)])


@dataclass(frozen=True, slots=True)
class OfScipy(Distribution):
    """A frozen distribution of scipy.stats."""

    frozen: Any

    def quantile(self, u: float) -> float:
        """The value [unit of the parameter] below which a share u [-] lies."""
        return float(self.frozen.ppf(u))

    def __repr__(self) -> str:
        given = [*map(repr, self.frozen.args), *(f"{name}={value!r}" for name, value in self.frozen.kwds.items())]
        return f"scipy.stats.{self.frozen.dist.name}({', '.join(given)})"


def distribution_of(given: Any) -> Distribution:
    """One of ours as it is, one of scipy.stats in our words. Raises `InvalidInput` for what is neither."""
    if hasattr(given, "quantile"):
        return given
    if hasattr(given, "ppf") and hasattr(given, "dist"):
        return OfScipy(given)
    allowed = "Uniform, Normal, LogNormal, Triangular, Choice or a frozen distribution of scipy.stats"
    raise InvalidInput(f"distribution = {given!r}; give {allowed}")


def _standard_normal(u: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(min(max(u, 1e-16), 1.0 - 1e-16)))  # finite at the ends, which samplers can give
