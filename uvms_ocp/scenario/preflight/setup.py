"""What pre-flight checks look at: the mission before it begins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked_dataclass
from uvms_ocp.control.force.dynamic import VelocityGains
from uvms_ocp.mission import Mission
from uvms_ocp.robot import IDEAL_SENSORS, Robot, SensorSpecs, static_balance
from uvms_ocp.robot.robot import require_normalized
from uvms_ocp.sim.environment import Environment
from uvms_ocp.tasks.goals import PoseGoal, evaluate_pose
from uvms_ocp.types import Finite, Period, Shape

_N_TIMES = 5  # samples of a goal that moves


@checked_dataclass(eq=False)
class Setup:
    """A mission before it begins, with all that the checks look at."""

    robot: Robot
    mission: Mission
    environment: Environment
    start: Annotated[np.ndarray, Shape("robot.n_q")]
    """(n_q,) [m, rad] configuration at t = 0."""
    altimeter_frame: str | None
    """Name of the altimeter's frame; `None` for a robot without one."""
    with_forces: bool
    """True where the plant has thrusters and water, so that forces matter."""
    dt: Period
    """[s] control period."""
    duration: Finite
    """[s] time limit."""
    sensors: SensorSpecs = IDEAL_SENSORS
    """Specifications of the sensors that it is monitored by while it runs."""
    own_parts: Mapping[str, str] = field(default_factory=dict)
    """Names of the parts that are not the toolkit's, by what they are, such as ``plant``."""
    gains: VelocityGains = field(default_factory=VelocityGains)
    """Gains of the loops, before they are lowered for sensors that are late."""
    load_bandwidth: Finite | None = None
    """[rad/s] of the observer from which the controller is to learn what the tool carries; `None`
    where it is not to.
    """

    def floor_at(self, x: float, y: float) -> float:
        """Return the height [m] of the floor in W at x [m], y [m]."""
        return self.environment.seafloor.height(float(x), float(y))

    def altimeter_pose(self, q: Annotated[np.ndarray, Shape("self.robot.n_q")]) -> pin.SE3:
        """Return X_WS at q (n_q,) [m, rad]; the vehicle's own pose without an altimeter."""
        require_normalized(self.robot.model, q)
        if self.altimeter_frame is None:
            return pin.XYZQUATToSE3(np.asarray(q[:7]))
        return frame_pose(self.robot, q, self.altimeter_frame)

    def altimeter_height(self) -> float:
        """Return the height [m] of the altimeter above the vehicle's origin while the vehicle rests as
        thrusters and water leave it.
        """
        p_BS: np.ndarray = self.altimeter_pose(self.robot.configuration()).translation
        if not self.with_forces:
            return float(p_BS[2])
        R_WB = static_balance.rotation_at_rest(self.robot, self.start)
        return float(R_WB[2] @ p_BS)


def frame_pose(robot: Robot, q: np.ndarray, frame: str) -> pin.SE3:
    """Return X_WF of a frame at q (n_q,) [m, rad], which may be outside the limits. Raises
    `FrameNotFound`.
    """
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return pin.updateFramePlacement(robot.model, data, robot.frame_id(frame)).copy()


def goals_of(setup: Setup, name: str, goal: PoseGoal) -> list[pin.SE3]:
    """Return the goal; where it comes to rest if it moves; samples of it if it never rests."""
    last_pose, rate = evaluate_pose(name, goal, setup.duration)
    if not callable(goal) or not rate.any():
        return [last_pose]
    return [evaluate_pose(name, goal, t)[0] for t in np.linspace(0.0, setup.duration, _N_TIMES)]
