"""Case 1 of the paper: way point, alignment, landing, tool frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import Magnitude, Point, checked
from uvms_ocp.mission.conditions import DONE, Below, Transition
from uvms_ocp.mission.phase import Phase
from uvms_ocp.model.robot import Robot
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.scenarios.parts import abort_phase, mission_of, on
from uvms_ocp.scenarios.run_options import run_options
from uvms_ocp.tasks.altitude import LandingAltitude, MinimumAltitude
from uvms_ocp.tasks.attitude import Alignment, HorizontalAttitude
from uvms_ocp.tasks.joints import JointLimits, JointTracking
from uvms_ocp.tasks.pose import ToolPose, VehiclePose
from uvms_ocp.tasks.reference import PoseReference
from uvms_ocp.tasks.task import Task
from uvms_ocp.tasks.velocity import NullVelocity

_N_POSTURE_JOINTS = 4  # MP holds the last four joints ([Gao2022] Case 2)


@checked
@dataclass(frozen=True, kw_only=True, slots=True)
class Thresholds:
    """What ends the phases of Case 1."""

    way_point: Magnitude = 0.1
    """[m] A to B."""
    misalignment: Magnitude = 0.07
    """[rad] B to C, and held through C."""
    landing_altitude: Magnitude = 0.17
    """[m] C to D."""
    landing_hold: Magnitude = 0.2
    """[s] for which the landing altitude is held."""
    tool_position: Magnitude = 1e-3
    """[m] end of D."""
    tool_orientation: Magnitude = 1e-3
    """[rad] end of D."""
    tool_hold: Magnitude = 1.0
    """[s] for which the tool is held."""

    @staticmethod
    def suggested(*, plant: str, noise: bool) -> Thresholds:
        """The paper's on the kinematic plant; a real hull touches down earlier, and noise hides millimetres."""
        landing = 0.17 if plant == "kinematic" else 0.2
        tool = (5e-3, 1e-2) if noise else (1e-3, 1e-3)
        return Thresholds(landing_altitude=landing, tool_position=tool[0], tool_orientation=tool[1])


@checked
def case1(
    *,
    start: pin.SE3 | None = None,
    posture: np.ndarray | None = None,
    way_point: pin.SE3 | None = None,
    target: Point = (12.2025, 37.3748, -39.886),
    tool_goal: pin.SE3 | PoseReference | None = None,
    tasks: Mapping[str, Mapping[str, Any]] | None = None,
    order: Sequence[str] | None = None,
    thresholds: Thresholds | None = None,
    **options: Any,
) -> Scenario:
    """Way point, alignment, landing, tool frame ([Gao2022] Case 1, Tables 3 and 4).

    start, way_point: X_WB. posture (n_joints,) [rad]: joints at the start, the stowed posture by default. target (3,) [m]
    in W: where AT points. tool_goal: X_WT or a motion of it, at the target with the tool pointing down by default. tasks:
    field overrides by task name, such as ``{"PC": {"gain_linear": 0.3}}``. order: task names, highest priority first,
    instead of the order of the classes. options: those of `RunOptions`.

    Raises `UvmsError` where a name is unknown or a number is impossible.
    """
    run = run_options(options)
    origin = start or pose_at((8.5, 38.5, -36.0), (0.0, -0.06, 0.5))
    goal = way_point or pose_at((10.8, 37.45, -38.0), (0.0, -0.06, 0.5))
    point = np.asarray(target, dtype=float)
    tool = tool_goal or pose_at(tuple(point), (np.pi, 0.0, 0.0))
    limits = thresholds or Thresholds.suggested(plant=run.plant, noise=run.noise)
    listed, phases = case1_tasks(run.robot, goal, point, tool), case1_phases(limits)
    return run.scenario(
        name="case1",
        mission=mission_of(
            run.robot, listed, phases, order=order, overrides=tasks, abort=abort_phase("JL", "MAC", "HA", "MP")
        ),
        start=run.start(origin, posture),
        markers={"target": tuple(point), "way point": tuple(goal.translation)},
    )


@checked
def case1_unreachable(**options: Any) -> Scenario:
    """Case 1 with a way point from which, once landed, the arm stays 0.2 to 0.4 m short of its target.

    Pre-flight refuses it and suggests a way point that is near enough. Options as for `case1`.
    """
    return replace(
        case1(**{"way_point": pose_at((10.2, 37.5, -38.0), (0.0, -0.06, 0.5)), **options}), name="case1_unreachable"
    )


def case1_tasks(robot: Robot, way_point: pin.SE3, target: np.ndarray, tool_goal: pin.SE3 | PoseReference) -> list[Task]:
    """[Gao2022] Table 3, for the goals X_WB, target (3,) [m] in W and X_WT."""
    wrist = robot.joint_names[-_N_POSTURE_JOINTS:]
    return [
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
