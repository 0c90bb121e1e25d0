"""Uncertain parameters: what one is, its distribution by quantiles, and the sampling design of all
runs.

A sampler draws numbers from 0 to 1, so that a distribution serves random, Latin hypercube and
Sobol' samples alike. Any frozen distribution of scipy.stats can stand in its place.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Annotated, Any, Protocol

import numpy as np

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.errors import InvalidInput, optional_module, require_known
from uvms_ocp.record.table_files import CAMPAIGN_EXTRA
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.types import Finite, Positive, Range

Share = Annotated[float, Range(0.0, 1.0)]

SAMPLERS = ("random", "latin", "sobol", "indices")
"""Independent draws; a Latin hypercube; a scrambled Sobol' sequence; the design that Sobol' indices
need.
"""
GROWING = ("random", "sobol")
"""Samplers whose design of more runs begins with that of fewer."""
# streams of a run
_DRAWN = 0
_SEED = 1


# One number of a scenario that can be set.


@dataclass(frozen=True, slots=True)
class Parameter:
    """Parameter of a scenario: name, unit, meaning, and how a value is applied."""

    name: str
    unit: str
    meaning: str
    apply: Callable[[Scenario, float], Scenario]
    """The scenario with a value [unit]."""


def real_numbers(value: Any) -> list[str]:
    """Return the fields of a dataclass that it is made of and that are real numbers."""
    names = []
    for item in fields(value):
        if item.init and type(getattr(value, item.name)) is float:
            names.append(item.name)
    return names


# Distributions of one parameter, each by its quantiles: what a number from 0 to 1 stands for.
#
# A sampler draws such numbers, so that a distribution serves random, Latin hypercube and Sobol'
# samples alike. Any frozen distribution of scipy.stats can stand in their place.


class Distribution(Protocol):
    """Distribution of the values of one parameter."""

    def quantile(self, u: float) -> Any:
        """Return the value below which a share u of all values lies."""


@checked_dataclass(kw_only=False)
class Uniform(Distribution):
    """Every value between two is as likely. Raises `InvalidInput` where they are in the wrong
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
    """Gauss's bell; it has no bounds, so that a parameter that cannot be below 0 is better a
    `LogNormal`.
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
    """A factor that is as likely to be twice as large as half as large: the logarithm is normal."""

    median: Positive = 1.0
    """[unit of the parameter] median."""
    sigma: Positive = 0.2
    """Standard deviation of the natural logarithm; while small, a relative error."""

    def quantile(self, u: Share) -> float:
        """Return the value [unit of the parameter] below which a share u lies."""
        return self.median * math.exp(self.sigma * _standard_normal(u))


@checked_dataclass(kw_only=False)
class Triangular(Distribution):
    """Most likely at a mode, never beyond two bounds. Raises `InvalidInput` where they are in the
    wrong order.
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
    """Return one of ours as it is, one of scipy.stats in our words. Raises `InvalidInput` for what
    is neither.
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
    from scipy.special import ndtri

    return float(
        ndtri(min(max(u, 1e-16), 1.0 - 1e-16))
    )  # finite at the ends, which samplers can give


# Numbers from 0 to 1 for every run: a table of which run k has row k, whatever runs before it.


@dataclass(frozen=True, kw_only=True, slots=True)
class Design:
    """Design of samples in the unit cube. Raises `NameNotFound` for a sampler, `InvalidInput` for a
    number of runs.
    """

    sampler: str
    runs: int
    parameters: int
    """Number of varied parameters."""
    seed: int

    def __post_init__(self) -> None:
        require_known("sampler", self.sampler, SAMPLERS)
        if self.sampler != "indices":
            return
        block = self.parameters + 2
        if self.parameters < 2:
            raise InvalidInput(
                f"the sampler indices with {self.parameters} parameters; give 2 or more to compare"
            )
        base = self.runs // block
        if base < 2 or base * block != self.runs or base & (base - 1):
            nearest_base = 2 ** max(1, round(np.log2(max(self.runs / block, 2))))
            allowed = (
                f"a power of 2 times {block}, the parameters and 2 more, such as"
                f" {nearest_base * block}"
            )
            raise InvalidInput(f"{self.runs} runs with the sampler indices; give {allowed}")

    def row(self, run: int) -> np.ndarray:
        """Return the numbers (parameters,) of a run, from 0 to 1. Raises `NotInstalled` for indices
        without SALib.
        """
        if not self.parameters:
            return np.zeros(0)
        if self.sampler == "random":
            return np.random.default_rng(self._entropy(run, _DRAWN)).random(self.parameters)
        return np.asarray(_table(self)[run])

    def seed_of(self, run: int) -> int:
        """Seed of everything else that is random in a run."""
        return int(self._entropy(run, _SEED).generate_state(1)[0])

    def _entropy(self, run: int, stream: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self.seed, spawn_key=(run, stream))


@lru_cache(maxsize=4)
def _table(design: Design) -> Any:
    """Draw the numbers of a design (runs, parameters), from 0 to 1."""
    from scipy.stats import qmc

    if design.sampler == "indices":
        sobol = optional_module("SALib.sample.sobol", "the sampler indices", CAMPAIGN_EXTRA)
        problem = problem_of([f"x{k}" for k in range(design.parameters)])
        return sobol.sample(
            problem,
            design.runs // (design.parameters + 2),
            calc_second_order=False,
            seed=design.seed,
        )
    if design.sampler == "latin":
        return qmc.LatinHypercube(design.parameters, rng=design.seed).random(design.runs)
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", message="The balance properties"
        )  # any number of runs is allowed
        return qmc.Sobol(design.parameters, rng=design.seed).random(design.runs)


def problem_of(names: list[str]) -> dict[str, Any]:
    """SALib's problem dictionary of these parameters, each from 0 to 1."""
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}
