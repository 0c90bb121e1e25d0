"""A low transit over a rough floor: one cell of Table 2 of the paper."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.mission.conditions import DONE, Below, Transition
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Phase
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import IDEAL_SENSORS, sensors_of
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.scenarios.parts import always_underactuated, current_field, on, underactuation
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.height_field import HeightField
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.joints import JointLimits
from uvms_ocp.tasks.pose import VehiclePose

_PLANE = -40.0  # [m] floor between the protuberances
_BELOW = 0.8  # [m] way point above the plane: low enough for the minimum altitude to decide the height everywhere


def transit(
    *,
    relief: str = "small",
    threshold: float = 1.0,
    length: float = 30.0,
    robot: Robot | str = "girona_maris7_full",
    solver: HierarchySolver | None = None,
    plant: str = "dynamic",
    current: Any = None,
    noise: bool = False,
    seed: int = 0,
    dt: float = 1 / 50,
    duration: float = 150.0,
) -> Scenario:
    """A transit of `length` [m] towards a way point near the floor, held up by the minimum altitude alone.

    relief: a name in `uvms_ocp.sim.height_field.RELIEFS`. threshold [m]: h_min. seed: of floor and noise. The altimeter
    looks straight down and sees a slope only when above it: over steep protuberances a low threshold is not safe.
    """
    machine = load_robot(robot) if isinstance(robot, str) else robot
    floor = HeightField.random(relief, z=_PLANE, centre=(length / 2, 0.0), extent=length + 20.0, seed=seed)
    ground = max(floor.height(x, y) for x in np.linspace(-2.0, 2.0, 9) for y in np.linspace(-1.0, 1.0, 5))
    start = pose_at((0.0, 0.0, ground + threshold + 1.5))
    goal = pose_at((length, 0.0, max(_PLANE, floor.height(length, 0.0)) + _BELOW))
    tasks = [
        *underactuation(machine),
        JointLimits(),
        MinimumAltitude(threshold=threshold, margin=1.0),
        HorizontalAttitude(),
        VehiclePose(goal=goal),
    ]
    arrived = Below(quantity="PC.horizontal_error", limit=1.0)
    phase = Phase(
        name="A",
        title="transit",
        gates=on("JL", "MAC", "HA", "PC"),
        transitions=(Transition(to=DONE, when=(arrived,)),),
    )
    return Scenario(
        name="transit",
        robot=machine,
        mission=Mission(hierarchy=Hierarchy(tasks), phases=always_underactuated(machine, (phase,))),
        environment=Environment(seafloor=floor, current=current_field(current)),
        start=machine.configuration(
            position=start.translation, quaternion=pin.Quaternion(start.rotation).coeffs(), joints=machine.home
        ),
        solver=solver or LexicographicActiveSet(),
        plant=plant,
        sensors=sensors_of(machine.description) if noise else IDEAL_SENSORS,
        seed=seed,
        dt=dt,
        duration=duration,
        markers={"way point": tuple(goal.translation.tolist())},
    )
