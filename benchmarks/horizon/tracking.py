"""A trajectory followed with feedback on the physical plant, measured without noise."""

from __future__ import annotations

import numpy as np

from uvms_ocp.control.force.computed_torque import TrackingGains
from uvms_ocp.control.plan_following import PlanTracker
from uvms_ocp.estimation.estimator import PassThrough
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.signals import IDEAL_SENSORS
from uvms_ocp.sim.dynamic_plant import DynamicPlant
from uvms_ocp.sim.environment import Environment
from uvms_ocp.sim.loop import simulate
from uvms_ocp.sim.sensors import SensorSuite


def tracked(
    robot: Robot,
    trajectory: Trajectory,
    environment: Environment,
    *,
    dt: float,
    duration: float,
    gains: TrackingGains | None = None,
) -> dict[str, np.ndarray]:
    """The series of the run, in ticks of dt [s], to the end of the trajectory or for `duration`
    [s].
    """
    dynamics = robot_dynamics(robot)
    return simulate(
        plant=DynamicPlant(robot, trajectory.q[0], dynamics=dynamics, environment=environment),
        sensors=SensorSuite(robot, environment.seafloor, IDEAL_SENSORS).read,
        estimator=PassThrough(robot),
        controller=PlanTracker(trajectory, robot, dynamics, dt=dt, gains=gains),
        dt=dt,
        duration=duration,
    ).series()
