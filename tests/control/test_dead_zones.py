"""A hover with thrusters that have a dead zone and a lag ends as near as one without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import uvms_ocp as uo
from uvms_ocp.robot.description import checked_copy
from uvms_ocp.robot.robot import Robot
from uvms_ocp.tasks import VehiclePose

GOAL = (0.3, 0.2, -5.2)
NEAR = 0.01  # [m]


def thrusting(dead_zone: float, time_constant: float) -> Robot:
    robot = uo.load_robot("bluerov2_alpha5")
    change = {"dead_zone": dead_zone, "time_constant": time_constant}
    thrusters = tuple(
        thruster.model_copy(update=change) for thruster in robot.description.thrusters
    )
    return replace(robot, description=checked_copy(robot.description, thrusters=thrusters))


def hover(robot: Robot) -> uo.Record:
    endless = uo.Transition(
        to=uo.DONE, when=(uo.Below(quantity="PC.position_error", limit=1e-9),), hold=1e4
    )
    phase = uo.Phase(name="hover", activations={"PC": 1}, transitions=(endless,))
    scenario = uo.Scenario(
        name="hover",
        robot=robot,
        mission=uo.Mission(
            hierarchy=uo.Hierarchy([VehiclePose(goal=uo.pose_at(GOAL))]), phases=(phase,)
        ),
        environment=uo.Environment(
            seafloor=uo.FlatSeafloor(z=-40), current=uo.UniformCurrent([0.1, 0.05, 0])
        ),
        start=robot.configuration(position=(0.25, 0.15, -5.15)),
        duration=20.0,
        dt=0.02,
    )
    return scenario.run()


@pytest.mark.slow
@pytest.mark.parametrize(("dead_zone", "time_constant"), [(1.0, 0.1), (3.0, 0.0), (3.0, 0.2)])
def test_a_hover_ends_as_near_as_without_dead_zones_and_asks_for_nothing_inside_them(
    dead_zone: float, time_constant: float
) -> None:
    record = hover(thrusting(dead_zone, time_constant))
    away = np.linalg.norm(record["q"][-100:, :3] - np.array(GOAL), axis=1)
    requested = np.abs(record["asked_thrust"])
    assert away.max() < NEAR
    assert not ((requested > 1e-9) & (requested < dead_zone * (1 - 1e-9))).any()
