"""All parameters that a scenario has, by name, in the order in which they are applied."""

from __future__ import annotations

from itertools import chain

from uvms_ocp.arguments import checked
from uvms_ocp.campaign.variations.flow import flow_parameters
from uvms_ocp.campaign.variations.machine import machine_parameters
from uvms_ocp.campaign.variations.objectives import objective_parameters
from uvms_ocp.campaign.variations.own_settings import own_parameters
from uvms_ocp.campaign.variations.parameter import Parameter
from uvms_ocp.campaign.variations.places import place_parameters
from uvms_ocp.campaign.variations.sensing import sensor_parameters
from uvms_ocp.scenario import Scenario

_FAMILIES = (
    *(flow_parameters, machine_parameters, sensor_parameters),
    *(place_parameters, objective_parameters, own_parameters),
)


@checked
def known_parameters(scenario: Scenario) -> dict[str, Parameter]:
    """Of water and current, of what moves, of the sensors, of start, floor and obstacles, of goals and tasks, of own parts.

    What concerns the robot and its sensors is the truth that the plant has: the controller goes on with what it knows. Of delays
    of sensors it is told, but for those that are called untold.
    """
    return {parameter.name: parameter for parameter in chain.from_iterable(family(scenario) for family in _FAMILIES)}
