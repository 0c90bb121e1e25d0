"""What the checks look at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
import pinocchio as pin

from uvms_ocp.arguments import Finite, Period, Shape, checked
from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.mission.mission import Mission
from uvms_ocp.model.robot import Robot
from uvms_ocp.model.sensing import IDEAL_SENSORS, SensorSpecs
from uvms_ocp.sim.environment import Environment


@checked
@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Setup:
    """A mission before it begins."""

    robot: Robot
    mission: Mission
    environment: Environment
    start: Annotated[np.ndarray, Shape("robot.n_q")]
    """(n_q,) [m, rad]"""
    altimeter_frame: str | None
    """`None` for a robot without an altimeter."""
    with_forces: bool
    """The plant has thrusters and water, so that forces matter."""
    dt: Period
    """[s] control period."""
    duration: Finite
    """[s] time limit."""
    sensors: SensorSpecs = IDEAL_SENSORS
    """What the mission is judged by while it runs."""
    own_parts: Mapping[str, str] = field(default_factory=dict)
    """Names of the parts that are not the toolkit's, by what they are, such as ``plant``."""
    gains: VelocityGains = field(default_factory=VelocityGains)
    """Of the loops, before they are less where sensors are known to be late."""
    load_bandwidth: Finite | None = None
    """[rad/s] of the observer from which the controller is to learn what the tool carries; `None` where it is not to."""

    def floor_at(self, x: float, y: float) -> float:
        """Height [m] of the floor in W at x [m], y [m]."""
        return self.environment.seafloor.height(float(x), float(y))

    def altimeter_pose(self, q: Annotated[np.ndarray, Shape("self.robot.n_q")]) -> pin.SE3:
        """X_WS at q (n_q,) [m, rad]; the vehicle's own pose without an altimeter."""
        if self.altimeter_frame is None:
            return pin.XYZQUATToSE3(np.asarray(q[:7]))
        return frame_pose(self.robot, q, self.altimeter_frame)

    def altimeter_height(self) -> float:
        """Height [m] of the altimeter above the vehicle's origin while the vehicle is level."""
        return float(self.altimeter_pose(self.robot.configuration()).translation[2])


def frame_pose(robot: Robot, q: np.ndarray, frame: str) -> pin.SE3:
    """X_WF of a frame at q (n_q,) [m, rad], which may be outside the limits. Raises `FrameNotFound`."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return pin.updateFramePlacement(robot.model, data, robot.frame_id(frame)).copy()
