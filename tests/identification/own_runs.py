"""Runs of the toolkit's own whose thrusters are driven here and there, as slowly as a test wants
them to be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from uvms_ocp import load_robot, without_arm
from uvms_ocp.mission.phase import Below, Phase, Transition
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.record.record import Record
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import Command, StateEstimate
from uvms_ocp.scenario.options import activate, mission_of
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.tasks.pose import VehiclePose

LAG = 0.25
DEAD_ZONE = 0.2
"""[s], [N] of all thrusters."""


@cache
def slow(dead_zone: float = DEAD_ZONE) -> Robot:
    """A vehicle without its arm; dead_zone [N]."""
    robot = without_arm(load_robot("bluerov2_alpha5"))
    slower = {"time_constant": LAG, "dead_zone": dead_zone}
    thrusters = tuple(
        thruster.model_copy(update=slower) for thruster in robot.description.thrusters
    )
    return replace(robot, description=robot.description.model_copy(update={"thrusters": thrusters}))


def as_before(record: Record) -> Record:
    """As records were that did not hold what was asked of thrusters."""
    return replace(
        record,
        series={name: values for name, values in record.series.items() if name != "asked_thrust"},
    )


def driven_run(
    *,
    duration: float = 12.0,
    size: float = 6.0,
    held: float = 0.5,
    seed: int = 0,
    floor: float = -40.0,
    dead_zone: float = DEAD_ZONE,
    **options: Any,
) -> Record:
    """A run whose thrusters get random thrust of some size [N], each held [s] long; floor: [m] its
    height.

    dead_zone: [N] of thrusters. options: those of `Scenario`.
    """
    robot = slow(dead_zone)
    goal = pose_at((50.0, 0.0, -20.0))
    arrived = Transition(to=DONE, when=(Below(quantity="PC.position_error", limit=0.1),))
    phase = Phase(name="A", activations=activate("PC"), transitions=(arrived,))
    given = {
        "environment": Environment(seafloor=FlatSeafloor(z=floor)),
        "dt": 0.02,
        "duration": duration,
        **options,
    }
    return Scenario(
        name="driven",
        robot=robot,
        mission=mission_of(robot, [VehiclePose(goal=goal)], (phase,)),
        start=np.array(robot.configuration(position=[0.0, 0.0, -20.0])),
        controller=lambda scenario: _random(scenario, size, held, seed),
        **given,
    ).run()


def _random(
    scenario: Scenario, size: float, held: float, seed: int
) -> Callable[[StateEstimate, float], Command]:
    robot = scenario.robot
    rng = np.random.default_rng(seed)
    n = round(scenario.duration / held) + 2
    thrust = size * rng.normal(size=(n, len(robot.thruster_names)))
    still, arm = np.zeros(robot.n_v), np.zeros(robot.n_joints)
    return lambda measurement, t: Command(v=still, thrust=thrust[int(t / held + 1e-9)], torque=arm)
