from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from synthetic_record import synthetic_record

from uvms_ocp.record.record import Record
from uvms_ocp.robot.loading import load_robot
from uvms_ocp.robot.robot import Robot
from uvms_ocp.viz.scene.pictures import browser, missing


@pytest.fixture(scope="session")
def robot() -> Robot:
    return load_robot("girona_maris7")


@pytest.fixture(scope="session")
def record(robot: Robot) -> Record:
    return synthetic_record(robot)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    if missing():
        pytest.skip(missing())
    with browser() as found:
        yield found
