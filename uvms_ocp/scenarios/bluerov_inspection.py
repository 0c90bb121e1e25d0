"""A small vehicle turns a valve: approach, hold, and a circular tool path, in view of its camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from uvms_ocp.control.velocity.kinematic import HierarchySolver
from uvms_ocp.mission.conditions import DONE, Below, Transition
from uvms_ocp.mission.mission import Mission
from uvms_ocp.mission.phase import Phase
from uvms_ocp.model.kinematics import Kinematics
from uvms_ocp.model.loading import load_robot
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import IDEAL_SENSORS, sensors_of
from uvms_ocp.scenario import Scenario, pose_at
from uvms_ocp.scenarios.parts import (
    always_underactuated,
    approach_phase,
    current_field,
    on,
    underactuation,
)
from uvms_ocp.scenarios.reach import facing
from uvms_ocp.sim.currents import Current
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.seafloor import FlatSeafloor
from uvms_ocp.solvers.hierarchy.cascade.solver import LexicographicQp
from uvms_ocp.tasks.altitude import MinimumAltitude
from uvms_ocp.tasks.attitude import FieldOfView, HorizontalAttitude
from uvms_ocp.tasks.hierarchy import Hierarchy
from uvms_ocp.tasks.joints import JointLimits, JointTracking
from uvms_ocp.tasks.pose import ToolPosition, VehiclePose


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Circle:
    """A point that goes around a circle in a vertical plane, starting and ending at rest at its top: a `Reference`."""

    centre: np.ndarray  # (3,) [m] in W
    across: np.ndarray  # (3,) horizontal unit vector in the plane of the circle
    radius: float  # [m]
    turns: float
    duration: float  # [s] of all turns

    def __call__(self, t: float) -> tuple[pin.SE3, np.ndarray]:
        """Pose, of which the orientation has no meaning, and rate (6,) at time t [s]."""
        s = min(max(t / self.duration, 0.0), 1.0)
        angle = 2 * math.pi * self.turns * s**2 * (3.0 - 2.0 * s)
        speed = 2 * math.pi * self.turns * 6.0 * s * (1.0 - s) / self.duration
        up = np.array([0.0, 0.0, 1.0])
        point = self.centre + self.radius * (math.sin(angle) * self.across + math.cos(angle) * up)
        rate = self.radius * speed * (math.cos(angle) * self.across - math.sin(angle) * up)
        return pin.SE3(np.eye(3), point), np.concatenate([rate, np.zeros(3)])


def bluerov_inspection(
    *,
    robot: Robot | str = "bluerov2_alpha5",
    valve: Sequence[float] = (2.5, 1.0, -6.0),
    radius: float = 0.1,
    turns: float = 2.0,
    turning: float = 24.0,
    seabed: float = -10.0,
    solver: HierarchySolver | None = None,
    plant: str = "dynamic",
    current: Current | Sequence[float] | None = None,
    noise: bool = False,
    seed: int = 0,
    dt: float = 1 / 200,
    duration: float = 120.0,
) -> Scenario:
    """Valve turning by a BlueROV2 with a four-joint arm: approach, hold, follow a circular tool path.

    The tool goes `turns` times around a circle of `radius` [m] about the valve (3,) [m] within `turning` [s] and stays
    within 0.02 m of it all the time, while the valve stays within 0.4 rad of the axis of a camera on the vehicle that is
    tilted towards the stowed tool. Vehicle and arm move together; the pose of the vehicle comes last. noise widens the
    tolerance to 0.06 m. Raises `UvmsError` for unknown names and impossible numbers.
    """
    machine = load_robot(robot) if isinstance(robot, str) else robot
    centre = np.asarray(valve, dtype=float)
    origin = pose_at((0.0, 0.0, -5.0))
    q0 = machine.configuration(position=origin.translation, quaternion=pin.Quaternion(origin.rotation).coeffs())
    start = Kinematics(machine, q0)
    way_point = facing(origin, centre, start)
    circle = Circle(centre=centre, across=way_point.rotation[:, 1], radius=radius, turns=turns, duration=turning)
    tasks = [
        *underactuation(machine),
        JointLimits(),
        MinimumAltitude(),
        HorizontalAttitude(),
        FieldOfView(goal=centre, axis=_towards_tool(start)),
        ToolPosition(goal=circle(0.0)[0]),
        VehiclePose(goal=way_point),
        JointTracking(joints=machine.joint_names, goal=machine.home),
    ]
    phases = _phases(circle, turning, tolerance=0.06 if noise else 0.02)
    return Scenario(
        name="bluerov_inspection",
        robot=machine,
        mission=Mission(hierarchy=Hierarchy(tasks), phases=always_underactuated(machine, phases)),
        environment=Environment(seafloor=FlatSeafloor(z=seabed), current=current_field(current)),
        start=q0,
        solver=solver or LexicographicQp(),
        plant=plant,
        sensors=sensors_of(machine.description) if noise else IDEAL_SENSORS,
        seed=seed,
        dt=dt,
        duration=duration,
        markers={"valve": tuple(centre.tolist()), "way point": tuple(way_point.translation.tolist())},
    )


def _towards_tool(start: Kinematics) -> tuple[float, float, float]:
    """Direction of the tool, from the vehicle and in its frame."""
    p_BT = start.pose("base_link").actInv(start.pose("tool").translation)
    x, y, z = (p_BT / np.linalg.norm(p_BT)).tolist()
    return x, y, z


def _phases(circle: Circle, turning: float, tolerance: float) -> tuple[Phase, ...]:
    there = Below(quantity="TP.position_error", limit=tolerance)
    return (
        approach_phase(),
        Phase(
            name="B",
            title="hold",
            gates=on("JL", "MAC", "HA", "FV", "TP", "PC", "MP"),
            transitions=(Transition(to="C", when=(replace(there, limit=tolerance / 2),), hold=1.0),),
        ),
        Phase(
            name="C",
            title="turn",
            gates=on("JL", "MAC", "HA", "FV", "TP", "PC", "MP"),
            goals={"TP": circle},
            transitions=(Transition(to=DONE, when=(there,), hold=turning + 1.0),),
        ),
    )
