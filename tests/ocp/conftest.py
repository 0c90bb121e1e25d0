"""The robot that reaches, and a planner that needs to be built once."""

from __future__ import annotations

import pytest
from reaches import patient, reach

from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.planner import Planner


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


@pytest.fixture(scope="session")
def planner(robot: Robot) -> Planner:
    return patient(reach(robot))
