"""What the loop records of commands to thrusters."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest

from uvms_ocp import load_robot
from uvms_ocp.errors import InvalidInput
from uvms_ocp.estimation.estimator import PassThrough
from uvms_ocp.record.recorder import Recorder
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import IDEAL_SENSORS, Command
from uvms_ocp.sim.loop import simulate
from uvms_ocp.sim.plant import KinematicPlant
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.sim.sensors import SensorSuite

DT = 0.1


@cache
def robot() -> Robot:
    return load_robot("girona_maris7_full")


class Told(KinematicPlant):
    """A plant that tells of thrusters, whose thrust does nothing here."""

    def telemetry(self) -> dict[str, Any]:
        return {"thrust": np.full(8, 7.0)}


def run(
    thrust: Mapping[int, np.ndarray | None], plant: type[KinematicPlant] = Told, **more: Any
) -> Recorder:
    """Ticks with thrust (8,) [N], the last of which finishes; more: telemetry of the controller."""

    def control(_: object, t: float) -> Command:
        k = round(t / DT)
        return Command(
            v=np.zeros(13), thrust=thrust[k], finished=k == len(thrust) - 1, telemetry=more
        )

    return simulate(
        plant=plant(robot(), robot().configuration(position=[0.0, 0.0, -5.0])),
        sensors=SensorSuite(robot(), FlatSeafloor(z=-20.0), IDEAL_SENSORS).read,
        estimator=PassThrough(robot()),
        controller=control,
        dt=DT,
        duration=1.0,
    )


def test_a_row_has_what_is_asked_from_its_time_on() -> None:
    requested = {k: np.arange(8.0) + k for k in range(3)}
    series = run(requested).series()
    np.testing.assert_array_equal(series["asked_thrust"], [requested[k] for k in range(3)])
    np.testing.assert_array_equal(series["thrust"], 7.0)


def test_a_last_command_without_thrust_asks_for_none() -> None:
    series = run({0: np.ones(8), 1: None}).series()
    np.testing.assert_array_equal(series["asked_thrust"], [np.ones(8), np.zeros(8)])


@pytest.mark.parametrize("plant", [Told, KinematicPlant])
def test_where_nothing_is_asked_there_is_no_series(plant: type[KinematicPlant]) -> None:
    assert "asked_thrust" not in run({0: None, 1: None}, plant).series()
    assert ("asked_thrust" in run({0: np.ones(8)}, plant).series()) == (plant is Told)


def test_a_controller_tells_nothing_under_that_name() -> None:
    with pytest.raises(InvalidInput, match=r"'asked_thrust'.* is what the loop records; rename it"):
        run({0: np.ones(8)}, asked_thrust=1.0)
