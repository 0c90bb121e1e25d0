"""Parameters that can be varied in a scenario, by name, and the scenario with the values that a run
has drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from itertools import chain
from typing import Any

from uvms_ocp.campaign.current_parameters import flow_parameters
from uvms_ocp.campaign.distributions import Parameter, distribution_of
from uvms_ocp.campaign.machine_parameters import machine_parameters
from uvms_ocp.campaign.mission_parameters import objective_parameters, own_parameters
from uvms_ocp.campaign.place_parameters import place_parameters
from uvms_ocp.campaign.sensor_parameters import sensor_parameters
from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.errors import InvalidInput, NameNotFound, require_known
from uvms_ocp.scenario.scenario import Scenario
from uvms_ocp.sim import GustyCurrent
from uvms_ocp.types import Count

_FAMILIES = (
    flow_parameters,
    machine_parameters,
    sensor_parameters,
    place_parameters,
    objective_parameters,
    own_parameters,
)
"""Functions that list the parameters of a scenario, in the order in which these are applied."""


@checked
def available_parameters(scenario: Scenario) -> dict[str, Parameter]:
    """Return every parameter that can be varied: water, machine, sensors, start, floor, obstacles,
    goals, own parts.

    What concerns the robot and its sensors is the truth that the plant has: the controller goes on
    with its model. It knows the delays of its sensors, but not parameters that end in
    ``unmodelled_delay``.
    """
    parameters = chain.from_iterable(family(scenario) for family in _FAMILIES)
    return {parameter.name: parameter for parameter in parameters}


@checked_dataclass(kw_only=False)
class Variation:
    """One uncertain parameter, such as ``Variation("water.drag", LogNormal(1.0, 0.3))``.

    Raises `InvalidInput` for an empty name and for what is no distribution.
    """

    name: str
    """Name of one of `available_parameters`, or any where `apply` is given."""
    distribution: Any
    """Distribution of its values: one of this package, or a frozen one of scipy.stats."""
    apply: Callable[[Scenario, float], Scenario] | None = field(default=None, kw_only=True)
    """For a parameter of your own: function that returns the scenario with a value [its unit] of
    it.
    """

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise InvalidInput("a variation without a name; give the one of a parameter")
        object.__setattr__(self, "distribution", distribution_of(self.distribution))

    def __str__(self) -> str:
        if self.apply is None:
            suffix = ""
        else:
            suffix = f" by {getattr(self.apply, '__qualname__', 'a function')}"
        return f"{self.name}: {self.distribution!r}{suffix}"


def require_available(variations: Sequence[Variation], scenario: Scenario) -> None:
    """Raise `NameNotFound` for a parameter that the scenario does not have, `InvalidInput` for one
    that is varied twice.
    """
    available = available_parameters(scenario)
    names = [variation.name for variation in variations]
    for variation in variations:
        if names.count(variation.name) > 1:
            raise InvalidInput(
                f"{variation.name} is varied twice; give each parameter one distribution"
            )
        if variation.apply is None and variation.name not in available:
            raise NameNotFound(
                "parameter", variation.name, available, "`uvms-ocp campaign MISSION --parameters`"
            )


@checked
def vary(
    scenario: Scenario,
    values: Mapping[str, float],
    *,
    variations: Sequence[Variation] = (),
    seed: Count | None = None,
) -> Scenario:
    """Return the scenario with these values [unit of each] by name of a parameter: tasks, goals and
    gains need no code.

    seed: of everything else that is random; left out: the scenario's. variations: parameters of
    one's own, which come last; others in the order of `available_parameters`. Raises `NameNotFound`
    for a parameter that the scenario does not have, and what a value that is impossible raises.
    """
    available = available_parameters(scenario)
    custom = {v.name: v.apply for v in variations if v.apply is not None}
    for name in values:
        if name not in custom:
            require_known("parameter in values", name, available)
    if seed is None:
        changed = scenario
    else:
        changed = seeded(scenario, seed)
    for name, parameter in available.items():
        if name in values and name not in custom:
            changed = parameter.apply(changed, values[name])
    for name, apply in custom.items():
        changed = apply(changed, values[name])
    return changed


def seeded(scenario: Scenario, seed: int) -> Scenario:
    """Return the scenario with this seed of sensors and gusts."""
    water = scenario.environment.current
    environment = scenario.environment
    if isinstance(water, GustyCurrent):
        environment = replace(environment, current=replace(water, seed=seed))
    return replace(scenario, seed=seed, environment=environment)


def quantiles(variations: Sequence[Variation], u: Sequence[float]) -> dict[str, float]:
    """Return the values, by name, that numbers u (n_variations,) from 0 to 1 stand for."""
    values = {}
    for variation, share in zip(variations, u, strict=True):
        values[variation.name] = float(variation.distribution.quantile(float(share)))
    return values
