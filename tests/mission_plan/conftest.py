"""A short mission of a small vehicle, its plan, and both flights: built once."""

from __future__ import annotations

import pytest

from uvms_ocp.mission_plan import MissionPlan, plan_mission
from uvms_ocp.record.record import Record
from uvms_ocp.scenario.cases import reach
from uvms_ocp.scenario.scenario import Scenario


@pytest.fixture(scope="session")
def mission() -> Scenario:
    return reach(seed=3)


@pytest.fixture(scope="session")
def greedy(mission: Scenario) -> Record:
    return mission.run()


@pytest.fixture(scope="session")
def planned(mission: Scenario, greedy: Record) -> MissionPlan:
    return plan_mission(mission, duration=float(greedy["t"][-1]), step=1.0)


@pytest.fixture(scope="session")
def flown(mission: Scenario, planned: MissionPlan) -> Record:
    return planned.fly(mission)
