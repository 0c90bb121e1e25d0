"""A small vehicle that reaches with its arm while floating."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import Point, Positive, checked
from uvms_ocp.mission.conditions import DONE, Below, Transition
from uvms_ocp.mission.phase import Phase
from uvms_ocp.model.kinematics import Kinematics
from uvms_ocp.model.loading import load_robot
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.scenarios.parts import abort_phase, approach_phase, mission_of, on
from uvms_ocp.scenarios.run_options import run_options
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.attitude import HorizontalAttitude
from uvms_ocp.tasks.joints import JointLimits, JointTracking
from uvms_ocp.tasks.pose import ToolPosition, VehiclePose


@checked
def reach(
    *,
    variant: str | None = None,
    target: Point | None = None,
    start: pin.SE3 | None = None,
    tolerance: Positive = 0.01,
    **options: Any,
) -> Scenario:
    """A small floating vehicle with a four-joint arm brings its tool to a position: approach, then reach.

    The tool stays within tolerance [m] of the target (3,) [m] in W for 1 s; vehicle and arm reach together, the pose
    of the vehicle comes second. variant: of the water on the plant's vehicle, such as another published set of drag; the
    controller keeps the nominal one. target: by default drawn from `seed`, 2 to 4 m from the start. start: X_WB.
    options: those of `RunOptions`; the robot is bluerov2_alpha5, the floor at -10 m.

    Raises `UvmsError` where a name is unknown or a number is impossible.
    """
    run = run_options(options, robot="bluerov2_alpha5", seabed=-10.0)
    robot = run.robot
    origin = start or pose_at((0.0, 0.0, -5.0))
    point = _random_target(origin, run.seed) if target is None else np.asarray(target, dtype=float)
    q0 = run.start(origin)
    way_point = facing(origin, point, Kinematics(robot, q0))
    tasks = [
        JointLimits(),
        MinimumAltitude(),
        HorizontalAttitude(),
        ToolPosition(goal=pin.SE3(np.eye(3), point)),
        VehiclePose(goal=way_point),
        JointTracking(joints=robot.joint_names, goal=robot.home),
    ]
    return run.scenario(
        name="reach",
        mission=mission_of(robot, tasks, _reach_phases(tolerance), abort=abort_phase("JL", "MAC", "HA", "MP")),
        start=q0,
        plant_robot=None if variant is None else load_robot(robot.name, variant=variant),
        markers={"target": tuple(point), "way point": tuple(way_point.translation)},
    )


def _random_target(origin: pin.SE3, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    azimuth, distance, drop = rng.uniform(-np.pi, np.pi), rng.uniform(2.0, 4.0), rng.uniform(0.5, 1.5)
    return origin.translation + distance * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]) - [0.0, 0.0, drop]


def facing(origin: pin.SE3, target: np.ndarray, start: Kinematics) -> pin.SE3:
    """Vehicle pose, level and facing the target (3,) [m] in W, from which the tool at its present posture is just there."""
    p_BT = start.pose("base_link").actInv(start.pose("tool").translation)
    d = target - origin.translation
    R_WB = pin.rpy.rpyToMatrix(0.0, 0.0, float(np.arctan2(d[1], d[0])))
    return pin.SE3(R_WB, target - R_WB @ p_BT)


def _reach_phases(tolerance: float) -> tuple[Phase, ...]:
    there = Below(quantity="TP.position_error", limit=tolerance)
    return (
        approach_phase(),
        Phase(
            name="B",
            title="reach",
            gates=on("JL", "MAC", "HA", "TP", "PC", "MP"),
            transitions=(Transition(to=DONE, when=(there,), hold=1.0),),
        ),
    )
