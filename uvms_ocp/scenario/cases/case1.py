"""Case 1 of the paper, way point, alignment, landing, tool frame, and its variants: current drift,
priority swap, two targets.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked, checked_dataclass
from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.errors import InvalidInput
from uvms_ocp.mission.phase import Above, Below, Phase, Transition
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.robot import Kinematics, Robot
from uvms_ocp.scenario.options import (
    SAFETY,
    abort_phase,
    mission_of,
    override,
    phase_of,
    run_options,
    with_defaults,
)
from uvms_ocp.scenario.preflight.arm_reach import ArmReach, ReachResult
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.sim.currents import OnsetCurrent
from uvms_ocp.tasks import Alignment, JointTracking, LandingAltitude
from uvms_ocp.tasks.goals import PoseReference
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.pose import ToolPose, ToolPosition, VehiclePose
from uvms_ocp.tasks.task import Task
from uvms_ocp.tasks.vehicle_velocity import NullVelocity
from uvms_ocp.types import Finite, Magnitude, Point

_N_POSTURE_JOINTS = 4  # MP holds the last four joints ([Gao2022] Case 2)
_DISTANCE = 1.4  # [m] horizontal distance of the way point from the target
_REACHING = 0.55  # share of its length by which the arm bridges that distance
# [rad] bearing of the tool's goal from the bow, for an arm whose first joint is at a limit when it
# points straight ahead
_ASIDE = 0.15

ADRIFT = Above(quantity="PC.horizontal_error", limit=0.5, release=0.4)
"""[m] Distance off the way point at which a vehicle counts as adrift, until it is nearer again."""

_APPROACH = np.array([-1.4025, 0.0752, 1.886])  # [m] from a target to its way point

DRIFT_DEFAULTS: Mapping[str, Any] = {
    "current": OnsetCurrent((-0.75, 0.2, 0.0), start=40.0, rise=1.0),
    "duration": 150.0,
}
"""Defaults of `current_drift` that are not those of `RunOptions`; duration [s]."""
TWICE_DEFAULTS: Mapping[str, Any] = {"duration": 240.0}
"""Defaults of `two_targets` that are not those of `RunOptions`; duration [s]."""


@checked_dataclass()
class Thresholds:
    """Thresholds that end the phases of Case 1."""

    way_point: Magnitude = 0.1
    """[m] distance to the way point at which phase A ends."""
    misalignment: Magnitude = 0.07
    """[rad] misalignment at which phase B ends, and which phase C keeps."""
    landing_altitude: Magnitude = 0.17
    """[m] altitude at which phase C ends."""
    landing_hold: Magnitude = 0.2
    """[s] time for which the landing altitude is held."""
    tool_position: Magnitude = 1e-3
    """[m] position error of the tool at which phase D ends."""
    tool_orientation: Magnitude = 1e-3
    """[rad] orientation error of the tool at which phase D ends."""
    tool_hold: Magnitude = 1.0
    """[s] time for which the tool is held."""

    @staticmethod
    def suggested(*, plant: str, noise: bool) -> Thresholds:
        """Return the paper's thresholds on the kinematic plant; larger ones for a real hull, which
        touches down earlier, and for noise, which hides millimetres.
        """
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
    """Return Case 1 of the paper: way point, alignment, landing, tool frame ([Gao2022] Tables 3 and
    4).

    For an arm that is shorter than the paper's the way point is nearer to the target. An arm of less
    than six joints, which meets no pose from where the vehicle stands, brings its tool to the
    position alone, and beside the target where its first joint is at a limit straight ahead.

    start, way_point: X_WB. posture (n_joints,) [rad]: joints at the start, the stowed posture by
    default. target (3,) [m] in W: where AT points. tool_goal: X_WT or a motion of it, at the target
    with the tool pointing down by default. tasks: field overrides by task name, such as ``{"PC":
    {"gain_linear": 0.3}}``. order: task names, highest priority first, instead of the order of the
    classes. options: those of `RunOptions`.

    Raises `UvmsError` where a name is unknown or a number is impossible, and `InvalidInput` where
    no joint moves a tool.
    """
    run = run_options(options)
    origin = start or pose_at((8.5, 38.5, -36.0), (0.0, -0.06, 0.5))
    point = np.asarray(target, dtype=float)
    default = np.array([10.8, 37.45, -38.0])
    arm = _arm_setting(run.robot)
    goal = way_point or pose_at(
        tuple(default - (1.0 - arm.shares) * (default - point)), (0.0, -0.06, 0.5)
    )
    tool = tool_goal or pose_at(_beside(point, goal, arm.bearing), (np.pi, 0.0, 0.0))
    limits = thresholds or Thresholds.suggested(plant=run.plant, noise=run.noise)
    nominal_tasks = case1_tasks(run.robot, goal, point, tool, arm.posture)
    has_pose = any(isinstance(task, ToolPose) for task in nominal_tasks)
    phases = case1_phases(limits, pose=has_pose)
    return run.scenario(
        name="case1",
        mission=mission_of(
            run.robot,
            nominal_tasks,
            phases,
            order=order,
            overrides=tasks,
            abort=abort_phase("JL", "MAC", "HA", "MP"),
        ),
        start=run.start(origin, arm.posture if posture is None else posture),
        markers={"target": tuple(point), "way point": tuple(goal.translation)},
    )


@checked
def case1_unreachable(**options: Any) -> Scenario:
    """Return Case 1 with a way point from which, once landed, the arm stays 0.2 to 0.4 m short of
    its target.

    Pre-flight refuses it and suggests a way point that is near enough. Options as for `case1`.
    """
    return replace(
        case1(**with_defaults(options, way_point=pose_at((10.2, 37.5, -38.0), (0.0, -0.06, 0.5)))),
        name="case1_unreachable",
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _ArmSetting:
    """Setting of Case 1 for the arm of a robot."""

    shares: np.ndarray
    """(3,) shares of the paper's distances between way point and target, at most 1."""
    posture: np.ndarray
    """(n_joints,) [rad or m] posture at the start: the stowed one, or, of an arm that is too short,
    one that is carried ahead, where nothing is in its way when the vehicle is on the floor.
    """
    bearing: float
    """[rad] bearing of the tool's goal from the bow, at which the first joint is off its limits."""


def _arm_setting(robot: Robot) -> _ArmSetting:
    """Choose the setting for the arm of a robot. Raises `InvalidInput` where no joint moves a tool."""
    joints = _tool_joints(robot)
    if not joints:
        raise InvalidInput(
            f"{robot.name} has no tool that joints move; allowed: a robot with an arm, or a"
            " scenario without tool"
        )
    start = Kinematics(robot, robot.configuration())
    places = [*(start.pose(joint).translation for joint in joints), start.pose("tool").translation]
    reach = float(sum(np.linalg.norm(end - begin) for begin, end in pairwise(places)))
    share = min(1.0, (places[0][0] + _REACHING * reach) / _DISTANCE)
    posture = robot.home.copy()
    bearing = 0.0
    height = float(places[0][2])
    postures = [robot.home]
    if share < 1.0:
        arm = ArmReach(robot, "tool", rotation_weight=0.0)
        arm_joints = [robot.joint_names.index(joint) for joint in joints]
        reaches: dict[float, ReachResult] = {}
        for angle in (0.0, _ASIDE, -_ASIDE):
            ahead = share * _DISTANCE * np.array([np.cos(angle), np.sin(angle)])
            reaches[angle] = arm.solve(pin.SE3.Identity(), pose_at((*ahead, height)), postures)
            postures.append(reaches[angle].joints)
        bearing = max(
            reaches,
            key=lambda angle: (
                reaches[angle].reached,
                min(_spare(robot, reaches[angle].joints)[arm_joints[0]], _ASIDE),
            ),
        )
        posture[arm_joints] = reaches[bearing].joints[arm_joints]
    return _ArmSetting(shares=np.array([share, share, 1.0]), posture=posture, bearing=bearing)


def _spare(robot: Robot, joints: np.ndarray) -> np.ndarray:
    """Return how far (n_joints,) [rad or m] joints are from their nearer limits."""
    return np.minimum(joints - robot.limits.position_lower, robot.limits.position_upper - joints)


def _beside(target: np.ndarray, way_point: pin.SE3, bearing: float) -> Point:
    """Return the target (3,) [m] turned about the way point by a bearing [rad]."""
    offset = target - way_point.translation
    x, y, z = target + (pin.rpy.rpyToMatrix(0.0, 0.0, bearing) @ offset - offset)
    return float(x), float(y), float(z)


def _tool_joints(robot: Robot) -> list[str]:
    """Return the joints that move the tool against the vehicle, from the first on."""
    model = robot.model
    if robot.has_frame("tool"):
        moving = model.supports[model.frames[robot.frame_id("tool")].parentJoint]
    else:
        moving = ()
    return [model.names[joint] for joint in moving if model.names[joint] in robot.joint_names]


def case1_tasks(
    robot: Robot,
    way_point: pin.SE3,
    target: np.ndarray,
    tool_goal: pin.SE3 | PoseReference,
    posture: np.ndarray,
) -> list[Task]:
    """Return the tasks of [Gao2022] Table 3, for the goals X_WB, target (3,) [m] in W and X_WT, and
    a posture (n_joints,) [rad or m].
    """
    wrist = robot.joint_names[-_N_POSTURE_JOINTS:]
    tool: ToolPose | ToolPosition
    if len(_tool_joints(robot)) >= 6:
        tool = ToolPose(goal=tool_goal)
    else:
        tool = ToolPosition(name="T", goal=tool_goal)
    posture_task = JointTracking(joints=wrist, goal=posture[-_N_POSTURE_JOINTS:])
    return [
        NullVelocity(),
        *SAFETY,
        Alignment(goal=target),
        LandingAltitude(),
        VehiclePose(goal=way_point),
        tool,
        posture_task,
    ]


def case1_phases(thresholds: Thresholds, *, pose: bool = True) -> tuple[Phase, ...]:
    """Return the phases of [Gao2022] Table 4; without pose the orientation of the tool is free."""
    aligned = Below(quantity="AT.misalignment", limit=thresholds.misalignment)
    arrived = Below(quantity="PC.position_error", limit=thresholds.way_point)
    landed = Below(quantity="LA.altitude", limit=thresholds.landing_altitude)
    reached = (
        Below(quantity="T.position_error", limit=thresholds.tool_position),
        Below(quantity="T.orientation_error", limit=thresholds.tool_orientation),
    )
    return (
        phase_of("A", "way point", ("JL", "MAC", "HA", "PC", "MP"), "B", arrived),
        phase_of("B", "alignment", ("JL", "MAC", "HA", "AT", "MP"), "C", aligned),
        phase_of(
            "C",
            "landing",
            ("JL", "HA", "AT", "LA", "MP"),
            "D",
            landed,
            aligned,
            hold=thresholds.landing_hold,
        ),
        phase_of(
            "D",
            "tool frame",
            ("NR", "JL", "HA", "T", "MP"),
            DONE,
            *reached[: 1 + pose],
            hold=thresholds.tool_hold,
        ),
    )


@checked
def current_drift(*, back_steps: bool = True, retries: int = 3, **options: Any) -> Scenario:
    """Return Case 1 in a current that sets in during phase D and pushes the vehicle off: no
    velocity is not a position.

    With back-steps the manager sees the vehicle adrift, returns to A and completes D at the second
    attempt, in the current. Without them the vehicle ends more than 0.3 m off its place and the
    tool never reaches the target. The velocity loop is a plain one, slow to reset and without
    observer: the default one drifts less than the arm can make up for. retries: how often D may be
    left for A. Other options as for `case1`.
    """
    scenario = case1(**with_defaults(options, **DRIFT_DEFAULTS))
    if back_steps:
        phases = tuple(with_back_step(phase, retries) for phase in scenario.mission.phases)
        scenario = replace(scenario, mission=replace(scenario.mission, phases=phases))
    return replace(
        scenario, name="current_drift", gains=VelocityGains(vehicle_reset=0.2, observer_vehicle=0.0)
    )


def with_back_step(phase: Phase, retries: int) -> Phase:
    """Return phase D with a way back to A where the vehicle is adrift; other phases as they are."""
    back = Transition(to="A", when=(ADRIFT,), hold=0.5, retries=retries)
    if phase.name == "D":
        return replace(phase, transitions=(*phase.transitions, back))
    return phase


@checked
def priority_swap(*, swapped: bool = True, **options: Any) -> Scenario:
    """Return Case 1 with a way point whose attitude is pitched by 0.3 rad, and PC above HA
    ([Gao2022], after Table 3).

    Swapped, the vehicle follows the way point's attitude and tilts by more than 0.1 rad; in the
    right order HA keeps the tilt below 0.1 rad. Both reach the target. Other options as for
    `case1`.
    """
    scenario = case1(**options)
    hierarchy = scenario.mission.hierarchy
    exchanged = {"HA": "PC", "PC": "HA"} if swapped else {}
    order = [exchanged.get(name, name) for name in hierarchy.names]
    if options.get("way_point") is None:
        pitched = {"goal": pose_at(scenario.markers["way point"], (0.0, -0.3, 0.5))}
    else:
        pitched = {}
    tasks = override(list(hierarchy.tasks), {"PC": pitched})
    scenario = replace(
        scenario, mission=replace(scenario.mission, hierarchy=Hierarchy(tasks, order))
    )
    return replace(scenario, name="priority_swap")


@checked
def two_targets(
    *, second: Point = (13.6, 36.2, -39.886), second_yaw: Finite = -0.7, **options: Any
) -> Scenario:
    """Return Case 1 twice: tool pose 1, then the vehicle takes off, moves 1.8 m, lands again and
    reaches tool pose 2.

    second (3,) [m]: the second target in W, second_yaw [rad]: the heading of the vehicle at its way
    point. Phases are A1 to D1 and A2 to D2, over one hierarchy; goals belong to the phases. Both
    tool errors end below the thresholds of `case1`, whose options apply. Raises `InvalidInput`
    where no joint moves a tool.
    """
    scenario = case1(**with_defaults(options, **TWICE_DEFAULTS))
    target = np.asarray(second, dtype=float)
    turn = pin.rpy.rpyToMatrix(0.0, 0.0, second_yaw)
    arm = _arm_setting(scenario.robot)
    way_point = pose_at(tuple(target + turn @ (arm.shares * _APPROACH)), (0.0, -0.06, second_yaw))
    goals = {
        "PC": way_point,
        "AT": target,
        "T": pose_at(_beside(target, way_point, arm.bearing), (np.pi, 0.0, second_yaw)),
    }
    first_phases = scenario.mission.phases
    second_phases = [replace(phase, goals=goals) for phase in first_phases]
    phases = (
        *_renamed(first_phases, "1", after="A2"),
        *_renamed(second_phases, "2", after=DONE),
    )
    markers = {**scenario.markers, "second target": tuple(target.tolist())}
    return replace(
        scenario,
        name="two_targets",
        mission=replace(scenario.mission, phases=phases),
        markers=markers,
    )


def _renamed(phases: Sequence[Phase], suffix: str, after: str) -> Iterator[Phase]:
    """Yield the phases with names that end in `suffix`; the last leads on to `after`."""
    names = {DONE: after, **{phase.name: phase.name + suffix for phase in phases}}
    for phase in phases:
        exits = tuple(
            replace(transition, to=names[transition.to]) for transition in phase.transitions
        )
        yield replace(phase, name=names[phase.name], transitions=exits)
