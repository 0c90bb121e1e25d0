"""A parameter and its distribution, and a scenario with the values that a run has drawn."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from uvms_ocp.arguments import checked
from uvms_ocp.campaign.variations.distributions import Distribution, distribution_of
from uvms_ocp.campaign.variations.known_parameters import known_parameters
from uvms_ocp.exceptions import InvalidInput, NameNotFound
from uvms_ocp.scenario import Scenario
from uvms_ocp.sim.currents import GustyCurrent


@checked
@dataclass(frozen=True, slots=True)
class Variation:
    """One uncertain parameter, such as ``Variation("water.drag", LogNormal(1.0, 0.3))``.

    Raises `InvalidInput` for an empty name and for what is no distribution.
    """

    name: str
    """As `uvms_ocp.campaign.variations.known_parameters` has it, or any where `apply` is given."""
    distribution: Any
    """Of its values: one of ours, or a frozen one of scipy.stats."""
    apply: Callable[[Scenario, float], Scenario] | None = field(default=None, kw_only=True)
    """For a parameter of your own: the scenario with this value [its unit] of it."""

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise InvalidInput("a variation without a name; give the one of a parameter")
        object.__setattr__(self, "distribution", distribution_of(self.distribution))

    def __str__(self) -> str:
        own = "" if self.apply is None else f" by {getattr(self.apply, '__qualname__', 'a function')}"
        return f"{self.name}: {self.distribution!r}{own}"


@checked
def require_known(variations: Sequence[Variation], scenario: Scenario) -> None:
    """Raise `NameNotFound` for a parameter that the scenario does not have, `InvalidInput` for one that is varied twice."""
    known, names = known_parameters(scenario), [variation.name for variation in variations]
    for variation in variations:
        if names.count(variation.name) > 1:
            raise InvalidInput(f"{variation.name} is varied twice; give each parameter one distribution")
        if variation.apply is None and variation.name not in known:
            raise NameNotFound("parameter", variation.name, known, "`uvms-ocp campaign MISSION --parameters`")


@checked
def varied(scenario: Scenario, variations: Sequence[Variation], values: Mapping[str, float], seed: int) -> Scenario:
    """The scenario with these `values` [unit of each] by name of a parameter, and everything else that is random by `seed` [-].

    Parameters are applied in the order in which `known_parameters` has them, those of one's own last. Raises what a value
    that is impossible raises.
    """
    known, own = known_parameters(scenario), {v.name: v.apply for v in variations if v.apply is not None}
    changed = seeded(scenario, seed)
    for name, parameter in known.items():
        if name in values and name not in own:
            changed = parameter.apply(changed, values[name])
    for name, apply in own.items():
        changed = apply(changed, values[name])
    return changed


def seeded(scenario: Scenario, seed: int) -> Scenario:
    """The scenario with this seed [-] of sensors and gusts."""
    water, environment = scenario.environment.current, scenario.environment
    if isinstance(water, GustyCurrent):
        environment = replace(environment, current=replace(water, seed=seed))
    return replace(scenario, seed=seed, environment=environment)


def quantiles(variations: Sequence[Variation], u: Sequence[float]) -> dict[str, float]:
    """Values by name of the numbers u (n_variations,) [-] from 0 to 1."""

    def value(distribution: Distribution, share: float) -> float:
        return float(distribution.quantile(float(share)))

    return {v.name: value(v.distribution, share) for v, share in zip(variations, u, strict=True)}
