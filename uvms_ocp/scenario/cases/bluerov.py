"""Missions of a small vehicle with an arm: reach a position, turn a valve."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked
from uvms_ocp.mission.phase import Below
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.robot import Kinematics, load_robot
from uvms_ocp.scenario.options import (
    SAFETY,
    abort_phase,
    approach_phase,
    mission_of,
    phase_of,
    run_options,
)
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.tasks import FieldOfView, JointTracking, ToolPosition, VehiclePose
from uvms_ocp.types import Period, Point, Positive, Range

DEFAULTS: Mapping[str, Any] = {"robot": "bluerov2_alpha5", "seabed": -10.0}
"""Defaults of these scenarios that are not those of `RunOptions`; seabed [m]."""


@checked
def reach(
    *,
    variant: str | None = None,
    target: Point | None = None,
    start: pin.SE3 | None = None,
    tolerance: Positive = 0.01,
    **options: Any,
) -> Scenario:
    """Return a mission in which a small floating vehicle brings the tool of its four-joint arm to a
    position: approach, then reach.

    The tool stays within tolerance [m] of the target (3,) [m] in W for 1 s; vehicle and arm reach
    together, the pose of the vehicle comes second. variant: of the water on the plant's vehicle,
    such as another published set of drag; the controller keeps the nominal one. target: by default
    drawn from `seed`, 2 to 4 m from the start. start: X_WB. options: those of `RunOptions`; the
    robot is bluerov2_alpha5, the floor at -10 m.

    Raises `UvmsError` where a name is unknown or a number is impossible.
    """
    run = run_options(options, **DEFAULTS)
    robot = run.robot
    origin = start or pose_at((0.0, 0.0, -5.0))
    rng = np.random.default_rng(run.seed)
    azimuth = rng.uniform(-np.pi, np.pi)
    distance = rng.uniform(2.0, 4.0)
    drop = rng.uniform(0.5, 1.5)
    drawn_point = (
        origin.translation
        + distance * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
        - [0.0, 0.0, drop]
    )
    if target is None:
        point = drawn_point
    else:
        point = np.asarray(target, dtype=float)
    q0 = run.start(origin)
    way_point = pose_facing(origin, point, Kinematics(robot, q0))
    posture = VehiclePose(goal=way_point), JointTracking(joints=robot.joint_names, goal=robot.home)
    tasks = [*SAFETY, ToolPosition(goal=pin.SE3(np.eye(3), point)), *posture]
    tool_condition = Below(quantity="TP.position_error", limit=tolerance)
    reaching = phase_of(
        "B", "reach", ("JL", "MAC", "HA", "TP", "PC", "MP"), DONE, tool_condition, hold=1.0
    )
    return run.scenario(
        name="reach",
        mission=mission_of(
            robot, tasks, (approach_phase(), reaching), abort=abort_phase("JL", "MAC", "HA", "MP")
        ),
        start=q0,
        plant_robot=None if variant is None else load_robot(robot.name, variant=variant),
        markers={"target": tuple(point), "way point": tuple(way_point.translation)},
    )


def pose_facing(origin: pin.SE3, target: np.ndarray, start: Kinematics) -> pin.SE3:
    """Return the vehicle pose, level and facing the target (3,) [m] in W, from which the tool at
    its present posture is just there.
    """
    p_BT = start.pose("base_link").actInv(start.pose("tool").translation)
    direction = target - origin.translation
    R_WB = pin.rpy.rpyToMatrix(0.0, 0.0, float(np.arctan2(direction[1], direction[0])))
    return pin.SE3(R_WB, target - R_WB @ p_BT)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Circle:
    """A point that goes around a circle in a vertical plane, starting and ending at rest at its
    top: a reference.
    """

    centre: np.ndarray
    """(3,) [m] centre in W."""
    across: np.ndarray
    """(3,) horizontal unit vector in the plane of the circle."""
    radius: float
    """[m] radius of the circle."""
    turns: float
    """Number of turns."""
    duration: float
    """[s] duration of all turns."""

    @property
    def end(self) -> float:
        """Time [s] at which the point is at rest again."""
        return float(self.duration)

    def __call__(self, t: float) -> tuple[pin.SE3, np.ndarray]:
        """Return the pose, of which the orientation has no meaning, and its rate (6,) at time t
        [s].
        """
        s = min(max(t / self.duration, 0.0), 1.0)
        angle = 2 * math.pi * self.turns * s**2 * (3.0 - 2.0 * s)
        speed = 2 * math.pi * self.turns * 6.0 * s * (1.0 - s) / self.duration
        up = np.array([0.0, 0.0, 1.0])
        point = self.centre + self.radius * (math.sin(angle) * self.across + math.cos(angle) * up)
        rate = self.radius * speed * (math.cos(angle) * self.across - math.sin(angle) * up)
        return pin.SE3(np.eye(3), point), np.concatenate([rate, np.zeros(3)])


@checked
def bluerov_inspection(
    *,
    target: Point = (2.5, 1.0, -6.0),
    radius: Annotated[float, Range(0.0, 10.0)] = 0.1,
    turns: Annotated[float, Range(-100.0, 100.0)] = 2.0,
    turning: Period = 24.0,
    **options: Any,
) -> Scenario:
    """Return a mission of valve turning by a BlueROV2 with a four-joint arm: approach, hold, follow
    a circular tool path.

    The tool goes turns times around a circle of radius [m] about the valve, target (3,) [m] in W,
    within turning [s] and stays within 0.02 m of it all the time, while the valve stays within 0.4
    rad of the axis of a camera on the vehicle that is tilted towards the stowed tool. Vehicle and
    arm move together; the pose of the vehicle comes last. With noise the tolerance is 0.06 m.
    options: those of `RunOptions`; the robot is bluerov2_alpha5, the floor at -10 m.

    Raises `UvmsError` where a name is unknown or a number is impossible.
    """
    run = run_options(options, **DEFAULTS)
    centre = np.asarray(target, dtype=float)
    origin = pose_at((0.0, 0.0, -5.0))
    q0 = run.start(origin)
    start = Kinematics(run.robot, q0)
    way_point = pose_facing(origin, centre, start)
    circle = Circle(
        centre=centre, across=way_point.rotation[:, 1], radius=radius, turns=turns, duration=turning
    )
    # Direction of the tool, from the vehicle and in its frame.
    p_BT = start.pose("base_link").actInv(start.pose("tool").translation)
    x, y, z = (p_BT / np.linalg.norm(p_BT)).tolist()
    posture = (
        VehiclePose(goal=way_point),
        JointTracking(joints=run.robot.joint_names, goal=run.robot.home),
    )
    tasks = [
        *SAFETY,
        FieldOfView(goal=centre, axis=(x, y, z)),
        ToolPosition(goal=circle(0.0)[0]),
        *posture,
    ]
    outer_condition = Below(quantity="TP.position_error", limit=0.06 if run.noise else 0.02)
    active_tasks = ("JL", "MAC", "HA", "FV", "TP", "PC", "MP")
    inner_condition = replace(outer_condition, limit=outer_condition.limit / 2)
    turn = phase_of("C", "turn", active_tasks, DONE, outer_condition, hold=turning + 1.0, TP=circle)
    phases = (
        approach_phase(),
        phase_of("B", "hold", active_tasks, "C", inner_condition, hold=1.0),
        turn,
    )
    return run.scenario(
        name="bluerov_inspection",
        mission=mission_of(run.robot, tasks, phases, abort=abort_phase("JL", "MAC", "HA", "MP")),
        start=q0,
        markers={
            "valve": tuple(centre.tolist()),
            "way point": tuple(way_point.translation.tolist()),
        },
    )
