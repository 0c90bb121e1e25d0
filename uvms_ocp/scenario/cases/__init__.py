"""Ready-made scenarios; every number in them can be overridden."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields
from inspect import Signature, signature
from typing import Any

from uvms_ocp.scenario.cases import bluerov, case1 as case1_missions
from uvms_ocp.scenario.cases.bluerov import bluerov_inspection, reach
from uvms_ocp.scenario.cases.case1 import (
    Thresholds as Thresholds,
    case1,
    case1_unreachable,
    current_drift,
    priority_swap,
    two_targets,
)
from uvms_ocp.scenario.cases.case2 import case2
from uvms_ocp.scenario.cases.transit import obstacle_field, transit
from uvms_ocp.scenario.options import ROBOT, RunOptions
from uvms_ocp.scenario.scenario import Scenario

_ALL = (
    *(case1, case1_unreachable, case2, priority_swap, two_targets, current_drift),
    *(bluerov_inspection, obstacle_field, reach, transit),
)

SCENARIOS: dict[str, Callable[..., Scenario]] = {scenario.__name__: scenario for scenario in _ALL}
"""Scenarios by the name that the command line knows."""


_OWN_DEFAULTS: dict[Callable[..., Scenario], Mapping[str, Any]] = {
    reach: bluerov.DEFAULTS,
    bluerov_inspection: bluerov.DEFAULTS,
    two_targets: case1_missions.TWICE_DEFAULTS,
    current_drift: case1_missions.DRIFT_DEFAULTS,
}
"""Defaults of options that differ from those of `RunOptions`, by scenario."""


def _signature_of(scenario: Callable[..., Any]) -> Signature:
    """Return the signature with the options of all scenarios, and their defaults, in the place of
    ``**options``, for help and completion.
    """
    declared_signature = signature(scenario)
    shared = signature(RunOptions).parameters
    defaults = {"robot": ROBOT, **_OWN_DEFAULTS.get(scenario, {})}
    for option in fields(RunOptions):
        if option.default is not MISSING:
            defaults.setdefault(option.name, option.default)
        elif option.default_factory is not MISSING and option.name not in defaults:
            defaults[option.name] = option.default_factory()
    parameters = [
        parameter
        for parameter in declared_signature.parameters.values()
        if parameter.kind is not parameter.VAR_KEYWORD
    ]
    shared_parameters = [
        parameter.replace(default=defaults[name])
        for name, parameter in shared.items()
        if name not in declared_signature.parameters
    ]
    return declared_signature.replace(parameters=[*parameters, *shared_parameters])


# `help`, completion and the command line read signatures, in which ``**options`` would say nothing:
# written out in each scenario, a new option would have to be added to all of them.
for _scenario in _ALL:
    vars(_scenario)["__signature__"] = _signature_of(_scenario)
