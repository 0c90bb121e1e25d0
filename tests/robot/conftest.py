"""The machines in water, each built once for a file of laws."""

from __future__ import annotations

import pytest
from wet_machines import FLOATING, MACHINES

from uvms_ocp.robot.dynamics import Dynamics


@pytest.fixture(params=MACHINES, scope="module")
def dynamics(request: pytest.FixtureRequest) -> Dynamics:
    return MACHINES[request.param]()


@pytest.fixture(params=FLOATING, scope="module")
def floating(request: pytest.FixtureRequest) -> Dynamics:
    return FLOATING[request.param]()
