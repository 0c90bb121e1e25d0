"""Ready-made scenarios; every number in them can be overridden."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Signature, signature
from typing import Any

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
from uvms_ocp.scenario.options import RunOptions
from uvms_ocp.scenario.scenario import Scenario

_ALL = (
    *(case1, case1_unreachable, case2, priority_swap, two_targets, current_drift),
    *(bluerov_inspection, obstacle_field, reach, transit),
)

SCENARIOS: dict[str, Callable[..., Scenario]] = {scenario.__name__: scenario for scenario in _ALL}
"""Scenarios by the name that the command line knows."""


def _signature_of(scenario: Callable[..., Any]) -> Signature:
    """With the options of all scenarios in the place of ``**options``, for help and completion."""
    own = signature(scenario)
    shared = signature(RunOptions).parameters
    kept = [each for each in own.parameters.values() if each.kind is not each.VAR_KEYWORD]
    more = [
        each.replace(default=None) for name, each in shared.items() if name not in own.parameters
    ]
    return own.replace(parameters=[*kept, *more])


for _scenario in _ALL:
    vars(_scenario)["__signature__"] = _signature_of(_scenario)
