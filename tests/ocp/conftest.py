"""The robot that reaches, and planners that need to be built once."""

from __future__ import annotations

import pytest
from reaches import patient, reach

from uvms_ocp.ocp.planner import Planner
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.solvers.nlp.options import PLUGINS


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot("girona_maris7_full")


@pytest.fixture(scope="session")
def planner(robot: Robot) -> Planner:
    return patient(reach(robot))


@pytest.fixture(scope="session", params=PLUGINS)
def plugin(request: pytest.FixtureRequest) -> str:
    """Laws of plans hold with every one of them."""
    return str(request.param)


@pytest.fixture(scope="session")
def planner_of_each(robot: Robot, plugin: str) -> Planner:
    return patient(reach(robot), plugin)
