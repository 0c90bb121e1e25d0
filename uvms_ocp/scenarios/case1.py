"""Case 1 of the paper: way point, alignment, landing, tool frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.mission.conditions import DONE, Below, Transition
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Phase
from uvms_ocp.model.files.description import TrimBody
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import IDEAL_SENSORS, sensors_of
from uvms_ocp.model.trim import with_trim
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.scenarios.parts import (
    always_underactuated,
    current_field,
    full_order,
    on,
    override,
    underactuation,
)
from uvms_ocp.sim.currents import Current
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.solvers.hierarchy.active_set.solver import LexicographicActiveSet
from uvms_ocp.tasks.altitude import LandingAltitude, MinimumAltitude
from uvms_ocp.tasks.attitude import Alignment, HorizontalAttitude
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.joints import JointLimits, JointTracking
from uvms_ocp.tasks.pose import ToolPose, VehiclePose
from uvms_ocp.tasks.task import Task
from uvms_ocp.tasks.velocity import NullVelocity

_N_POSTURE_JOINTS = 4  # MP holds the last four joints ([Gao2022] Case 2)


@dataclass(frozen=True, kw_only=True, slots=True)
class Thresholds:
    """What ends the phases of Case 1."""

    way_point: float = 0.1  # [m] A -> B
    misalignment: float = 0.07  # [rad] B -> C, and held through C
    landing_altitude: float = 0.17  # [m] C -> D
    landing_hold: float = 0.2  # [s]
    tool_position: float = 1e-3  # [m] end of D
    tool_orientation: float = 1e-3  # [rad]
    tool_hold: float = 1.0  # [s]

    @staticmethod
    def suggested(*, plant: str, noise: bool) -> Thresholds:
        """The paper's on the kinematic plant; a real hull touches down earlier, and noise hides millimetres."""
        landing = 0.17 if plant == "kinematic" else 0.2
        tool = (5e-3, 1e-2) if noise else (1e-3, 1e-3)
        return Thresholds(landing_altitude=landing, tool_position=tool[0], tool_orientation=tool[1])


def case1(
    *,
    robot: Robot | str = "girona_maris7_full",
    altimeter_pose: pin.SE3 | None = None,
    start: pin.SE3 | None = None,
    posture: np.ndarray | None = None,
    way_point: pin.SE3 | None = None,
    target: Sequence[float] = (12.2025, 37.3748, -39.886),
    tool_goal: pin.SE3 | None = None,
    seabed: float = -40.0,
    tasks: Mapping[str, Mapping[str, Any]] | None = None,
    order: Sequence[str] | None = None,
    thresholds: Thresholds | None = None,
    solver: HierarchySolver | None = None,
    plant: str = "dynamic",
    current: Current | Sequence[float] | None = None,
    noise: bool = False,
    observer: bool = True,
    payload: TrimBody | None = None,
    seed: int = 0,
    dt: float = 1 / 200,
    duration: float = 120.0,
) -> Scenario:
    """Way point, alignment, landing, tool frame ([Gao2022] Case 1, Tables 3 and 4).

    robot: a name or a `Robot`. altimeter_pose: X_BS. start, way_point: X_WB. posture (n_joints,): joints at the start,
    the stowed posture by default. target (3,) [m] in W: where AT points. tool_goal: X_WT, at the target with the tool
    pointing down by default. seabed [m]: height of the floor. tasks: field overrides by task name, such as
    ``{"PC": {"gain_linear": 0.3}}``. order: task names, highest priority first, instead of the order of the classes.
    current: a field, or a uniform velocity (3,) [m/s] in W. noise: of the sensors. observer: of disturbances. payload: a
    body that the plant carries and the controller does not know, such as ``TrimBody(name="sample", link="tool", ...)``.

    Raises `UvmsError` where a name is unknown or a number is impossible.
    """
    machine = load_robot(robot) if isinstance(robot, str) else robot
    if altimeter_pose is not None:
        machine = machine.with_frame_pose("altimeter", altimeter_pose)
    origin = start or pose_at((8.5, 38.5, -36.0), (0.0, -0.06, 0.5))
    goal = way_point or pose_at((10.8, 37.45, -38.0), (0.0, -0.06, 0.5))
    point = np.asarray(target, dtype=float)
    tool = tool_goal or pose_at(tuple(point), (np.pi, 0.0, 0.0))
    joints = machine.home if posture is None else posture
    limits = thresholds or Thresholds.suggested(plant=plant, noise=noise)
    return Scenario(
        name="case1",
        robot=machine,
        mission=Mission(
            hierarchy=Hierarchy(
                override(case1_tasks(machine, goal, point, tool), tasks or {}), full_order(machine, order)
            ),
            phases=always_underactuated(machine, case1_phases(limits)),
        ),
        environment=Environment(seafloor=FlatSeafloor(z=seabed), current=current_field(current)),
        start=machine.configuration(
            position=origin.translation, quaternion=pin.Quaternion(origin.rotation).coeffs(), joints=joints
        ),
        solver=solver or LexicographicActiveSet(),
        plant=plant,
        sensors=sensors_of(machine.description) if noise else IDEAL_SENSORS,
        gains=VelocityGains() if observer else VelocityGains(observer_vehicle=0.0),
        plant_robot=None if payload is None else with_trim(machine, [payload]),
        seed=seed,
        dt=dt,
        duration=duration,
        markers={"target": tuple(point), "way point": tuple(goal.translation)},
    )


def case1_unreachable(**options: Any) -> Scenario:
    """Case 1 with a way point from which, once landed, the arm stays 0.2 to 0.4 m short of its target.

    Pre-flight refuses it and suggests a way point that is near enough. Options as for `case1`.
    """
    return replace(
        case1(**{"way_point": pose_at((10.2, 37.5, -38.0), (0.0, -0.06, 0.5)), **options}), name="case1_unreachable"
    )


def case1_tasks(robot: Robot, way_point: pin.SE3, target: np.ndarray, tool_goal: pin.SE3) -> list[Task]:
    wrist = robot.joint_names[-_N_POSTURE_JOINTS:]
    return [
        *underactuation(robot),
        NullVelocity(),
        JointLimits(),
        MinimumAltitude(),
        HorizontalAttitude(),
        Alignment(goal=target),
        LandingAltitude(),
        VehiclePose(goal=way_point),
        ToolPose(goal=tool_goal),
        JointTracking(joints=wrist, goal=robot.home[-_N_POSTURE_JOINTS:]),
    ]


def case1_phases(thresholds: Thresholds) -> tuple[Phase, ...]:
    """[Gao2022] Table 4."""
    aligned = Below(quantity="AT.misalignment", limit=thresholds.misalignment)
    arrived = Below(quantity="PC.position_error", limit=thresholds.way_point)
    landed = Below(quantity="LA.altitude", limit=thresholds.landing_altitude)
    reached = (
        Below(quantity="T.position_error", limit=thresholds.tool_position),
        Below(quantity="T.orientation_error", limit=thresholds.tool_orientation),
    )
    return (
        Phase(
            name="A",
            title="way point",
            gates=on("JL", "MAC", "HA", "PC", "MP"),
            transitions=(Transition(to="B", when=(arrived,)),),
        ),
        Phase(
            name="B",
            title="alignment",
            gates=on("JL", "MAC", "HA", "AT", "MP"),
            transitions=(Transition(to="C", when=(aligned,)),),
        ),
        Phase(
            name="C",
            title="landing",
            gates=on("JL", "HA", "AT", "LA", "MP"),
            transitions=(Transition(to="D", when=(landed, aligned), hold=thresholds.landing_hold),),
        ),
        Phase(
            name="D",
            title="tool frame",
            gates=on("NR", "JL", "HA", "T", "MP"),
            transitions=(Transition(to=DONE, when=reached, hold=thresholds.tool_hold),),
        ),
    )
