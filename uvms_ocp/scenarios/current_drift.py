"""A current that sets in while the arm works, and a mission that steps back because of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from uvms_ocp.arguments import checked
from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.mission.conditions import Above, Transition
from uvms_ocp.mission.phase import Phase
from uvms_ocp.scenario import Scenario
from uvms_ocp.scenarios.case1 import case1
from uvms_ocp.sim.currents import OnsetCurrent

ADRIFT = Above(quantity="PC.horizontal_error", limit=0.5, release=0.4)  # [m] off the way point


@checked
def current_drift(*, back_steps: bool = True, retries: int = 3, **options: Any) -> Scenario:
    """Case 1 in a current that sets in during phase D and pushes the vehicle off, for null velocity is not position.

    With back-steps the manager sees the vehicle adrift, returns to A and completes D at the second attempt, in the
    current. Without them the vehicle ends more than 0.3 m off its place and the tool never reaches the target. The
    velocity loop is a plain one, slow to reset and without observer: the default one drifts less than the arm can make
    up for. retries: how often D may be left for A. Other options as for `case1`.
    """
    current = OnsetCurrent((-0.75, 0.2, 0.0), start=40.0, rise=1.0)
    defaults: dict[str, Any] = {"current": current, "duration": 150.0}
    scenario = case1(**{**defaults, **options})
    if back_steps:
        phases = tuple(with_back_step(phase, retries) for phase in scenario.mission.phases)
        scenario = replace(scenario, mission=replace(scenario.mission, phases=phases))
    return replace(scenario, name="current_drift", gains=VelocityGains(vehicle_reset=0.2, observer_vehicle=0.0))


def with_back_step(phase: Phase, retries: int) -> Phase:
    """Phase D with a way back to A where the vehicle is adrift; other phases as they are."""
    if phase.name != "D":
        return phase
    back = Transition(to="A", when=(ADRIFT,), hold=0.5, retries=retries)
    return replace(phase, transitions=(*phase.transitions, back))
