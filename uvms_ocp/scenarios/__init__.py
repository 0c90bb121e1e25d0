"""Ready-made scenarios; every number in them can be overridden."""

from __future__ import annotations

from collections.abc import Callable

from uvms_ocp.scenario import Scenario
from uvms_ocp.scenarios.case1 import Thresholds as Thresholds
from uvms_ocp.scenarios.case1 import case1 as case1
from uvms_ocp.scenarios.case1 import case1_unreachable as case1_unreachable

SCENARIOS: dict[str, Callable[..., Scenario]] = {
    "case1": case1,
    "case1_unreachable": case1_unreachable,
}
"""Scenarios by the name that the command line knows."""
