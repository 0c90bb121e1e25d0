"""Uncertain parameters of a scenario, and their distributions by quantiles.

A sampler draws numbers from 0 to 1, which quantiles turn to values: a distribution serves random, Latin
hypercube and Sobol' samples alike. Any frozen distribution of scipy.stats can stand in for one of these.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Any, Protocol

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.types import Finite, Positive, Range

Share = Annotated[float, Range(0.0, 1.0)]


@dataclass(frozen=True, slots=True)
class Parameter:
    """Parameter of a scenario: name, unit, meaning, and how a value is applied."""

    name: str
    """Name, as in a variation."""
    unit: str
    """Unit of its values."""
    meaning: str
    """Meaning in words, for tables."""
    apply: Callable[[Scenario, float], Scenario]
    """Returns a scenario with a value [unit] of the parameter."""


def real_numbers(value: Any) -> list[str]:
    """Return the names of the fields of a dataclass that are real numbers and that it is made from."""
    names = []
    for item in fields(value):
        if item.init and type(getattr(value, item.name)) is float:
            names.append(item.name)
    return names


class Distribution(Protocol):
    """Distribution of the values of one parameter."""

    def quantile(self, u: float) -> Any:
        """Return the value below which a share u of all values lies."""


@checked_dataclass(kw_only=False)
class Uniform(Distribution):
    """Uniform distribution between two bounds. Raises `InvalidInput` where they are in the wrong
    order.
    """

    lower: Finite
    """[unit of the parameter] lower bound."""
    upper: Finite
    """[unit of the parameter] upper bound."""

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise InvalidInput(
                f"Uniform: lower = {self.lower:g}, upper = {self.upper:g}; give a larger upper"
                " bound"
            )

    def quantile(self, u: Share) -> float:
        """Return the value [unit of the parameter] below which a share u lies."""
        return self.lower + u * (self.upper - self.lower)


@checked_dataclass(kw_only=False)
class Normal(Distribution):
    """Normal distribution. It has no bounds: for a parameter that cannot be below 0 a `LogNormal` is
    better.
    """

    mean: Finite
    """[unit of the parameter] mean."""
    sigma: Positive
    """[unit of the parameter] standard deviation."""

    def quantile(self, u: Share) -> float:
        """Return the value [unit of the parameter] below which a share u lies."""
        return self.mean + self.sigma * _standard_normal(u)


@checked_dataclass(kw_only=False)
class LogNormal(Distribution):
    """Log-normal distribution: above twice the median is as likely as below half of it."""

    median: Positive = 1.0
    """[unit of the parameter] median."""
    sigma: Positive = 0.2
    """Standard deviation of the natural logarithm; while small, a relative error."""

    def quantile(self, u: Share) -> float:
        """Return the value [unit of the parameter] below which a share u lies."""
        return self.median * math.exp(self.sigma * _standard_normal(u))


@checked_dataclass(kw_only=False)
class Triangular(Distribution):
    """Triangular distribution between two bounds, most likely at a mode. Raises `InvalidInput` where
    they are in the wrong order.
    """

    lower: Finite
    """[unit of the parameter] lower bound."""
    mode: Finite
    """[unit of the parameter] most likely value."""
    upper: Finite
    """[unit of the parameter] upper bound."""

    def __post_init__(self) -> None:
        if not (self.lower <= self.mode <= self.upper and self.lower < self.upper):
            text = f"Triangular({self.lower:g}, {self.mode:g}, {self.upper:g})"
            raise InvalidInput(f"{text}; give lower bound, mode and upper bound in this order")

    def quantile(self, u: Share) -> float:
        """Return the value [unit of the parameter] below which a share u lies."""
        width = self.upper - self.lower
        rise = self.mode - self.lower
        if u * width <= rise:
            return self.lower + math.sqrt(u * width * rise)
        return self.upper - math.sqrt((1.0 - u) * width * (self.upper - self.mode))


@checked_dataclass(kw_only=False)
class Choice(Distribution):
    """One of several numbers, each as likely. Raises `InvalidInput` for none."""

    values: Sequence[Finite]
    """[unit of the parameter] values to choose from."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(map(float, self.values)))
        if not self.values:
            raise InvalidInput("Choice of no values; give one or more")

    def quantile(self, u: Share) -> float:
        """Return the value [unit of the parameter] that a number u stands for."""
        return float(self.values[min(int(u * len(self.values)), len(self.values) - 1)])


@dataclass(frozen=True, slots=True)
class OfScipy(Distribution):
    """A frozen distribution of scipy.stats."""

    frozen: Any
    """Distribution with its parameters, such as ``scipy.stats.beta(2, 5)``."""

    def quantile(self, u: float) -> float:
        """Return the value [unit of the parameter] below which a share u lies."""
        return float(self.frozen.ppf(u))

    def __repr__(self) -> str:
        arguments = [
            *map(repr, self.frozen.args),
            *(f"{name}={value!r}" for name, value in self.frozen.kwds.items()),
        ]
        return f"scipy.stats.{self.frozen.dist.name}({', '.join(arguments)})"


def distribution_of(value: Any) -> Distribution:
    """Return a `Distribution` as it is, and one of scipy.stats as `OfScipy`. Raises `InvalidInput` for
    anything else.
    """
    if hasattr(value, "quantile"):
        return value
    if hasattr(value, "ppf") and hasattr(value, "dist"):
        return OfScipy(value)
    allowed = (
        "Uniform, Normal, LogNormal, Triangular, Choice or a frozen distribution of scipy.stats"
    )
    raise InvalidInput(f"distribution = {value!r}; give {allowed}")


def _standard_normal(u: float) -> float:
    """Return the quantile of the standard normal distribution, finite at u = 0 and 1 too, which
    samplers can give.
    """
    from scipy.special import ndtri

    return float(ndtri(min(max(u, 1e-16), 1.0 - 1e-16)))
