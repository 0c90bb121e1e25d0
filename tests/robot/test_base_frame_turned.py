"""One robot whose base frame is turned about its vertical axis is the same robot, from kinematics to runs:
which side of a vehicle its file calls its bow is a way to describe it.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from functools import cache
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from compiler import long_without_compiler
from edited_robots import load_edited
from turned_robots import configuration, turn, turn_files, twist_turn

from uvms_ocp.mission.phase import Below
from uvms_ocp.record.meta_values import DONE
from uvms_ocp.record.record import Record
from uvms_ocp.robot import Kinematics, list_robots, load_robot
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import robot_folder
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import largest_wrench, thruster_matrix
from uvms_ocp.scenario.options import abort_phase, mission_of, phase_of, run_options
from uvms_ocp.scenario.scenario import Scenario, pose_at
from uvms_ocp.tasks import (
    HorizontalAttitude,
    JointLimits,
    JointTracking,
    MinimumAltitude,
    ToolPosition,
    VehiclePose,
)

VEHICLES = [name for name in list_robots() if load_robot(name).n_vehicle]
WITH_ARMS = [name for name in VEHICLES if load_robot(name).n_joints]
QUARTERS = (1, 2)
"""Right angles by which the base frame is turned: limits of a vehicle are along its axes."""


@cache
def turned(name: str, quarters: int) -> Robot:
    """Load a shipped robot whose base link has other axes."""
    folder = robot_folder(name)
    tree = ET.parse(folder / "robot.urdf")
    data = yaml.safe_load((folder / "hydrodynamics.yaml").read_text(encoding="utf-8"))
    turn_files(tree.getroot(), data, "base_link", quarters)
    return load_edited(tree, data)


@pytest.mark.sampled
@pytest.mark.parametrize("quarters", QUARTERS)
@pytest.mark.parametrize("name", VEHICLES)
def test_kinematics_and_dynamics_are_the_same(name: str, quarters: int) -> None:
    robot = load_robot(name)
    same = turned(name, quarters)
    T = twist_turn(quarters, robot.n_v)
    rng = np.random.default_rng(3)
    q = np.array(robot.configuration())
    q[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.2, -0.1, 0.4)).coeffs()
    v = rng.uniform(-0.5, 0.5, robot.n_v)
    a = rng.uniform(-0.5, 0.5, robot.n_v)
    (q_same,) = configuration(q, quarters)
    for frame in robot.tools:
        expected = Kinematics(robot, q)
        found = Kinematics(same, q_same)
        np.testing.assert_allclose(
            found.pose(frame).homogeneous, expected.pose(frame).homogeneous, atol=1e-12
        )
        np.testing.assert_allclose(found.jacobian(frame) @ T, expected.jacobian(frame), atol=1e-12)
    tau = robot_dynamics(robot).inverse_dynamics(q, v, a)
    tau_same = robot_dynamics(same).inverse_dynamics(q_same, T @ v, T @ a)
    np.testing.assert_allclose(tau_same, T @ tau, atol=1e-9 * np.abs(tau).max())
    np.testing.assert_allclose(
        thruster_matrix(same), T[:6, :6] @ thruster_matrix(robot)[:6], atol=1e-12
    )
    wrench = largest_wrench(robot)
    if quarters == 2:
        np.testing.assert_allclose(largest_wrench(same)[[2, 5]], wrench[[2, 5]], rtol=1e-9)
    np.testing.assert_allclose(same.limits.velocity, np.abs(T @ robot.limits.velocity), rtol=1e-12)


def hover_and_reach(robot: Robot, quarters: int, *, plant: str, seed: int) -> Scenario:
    """A vehicle goes to a pose in a current, and its tool to a place near it."""
    rng = np.random.default_rng(seed)
    X_BN = pin.SE3(turn(quarters).T, np.zeros(3))
    goal = pose_at((0.8, -0.5, -5.4), (0.0, 0.0, 0.6))
    start = pose_at((0.0, 0.0, -5.0), (0.0, 0.0, 0.1))
    tasks: list[Any] = [
        JointLimits(),
        MinimumAltitude(),
        HorizontalAttitude(),
        VehiclePose(goal=goal * X_BN),
        JointTracking(joints=robot.joint_names, goal=robot.home),
    ]
    at_home = Kinematics(robot, robot.configuration()).pose("tool")
    tool = goal * X_BN * at_home
    tasks.insert(3, ToolPosition(goal=tool))
    names = tuple(task.name for task in tasks)
    reach = phase_of(
        "A", "reach", names, DONE, Below(quantity="TP.position_error", limit=0.02), hold=1.0
    )
    options = {
        "robot": robot,
        "plant": plant,
        "dt": 0.02,
        "duration": 6.0,
        "current": rng.uniform(-0.12, 0.12, 3),
    }
    run = run_options(options, seabed=-10.0)
    return run.scenario(
        name="reach",
        mission=mission_of(robot, tasks, (reach,), abort=abort_phase("JL", "MAC", "HA", "MP")),
        start=run.start(start * X_BN),
        markers={},
    )


def require_same(record: Record, expected: Record, quarters: int) -> None:
    """Require the record of a robot whose base is turned to be the expected one."""
    times, expected_times = (
        [event.t for event in run.run_meta.events] for run in (record, expected)
    )
    assert times == expected_times
    q = configuration(expected["q"], quarters)
    sign = np.sign(np.sum(q[:, 3:7] * record["q"][:, 3:7], axis=1))
    q[:, 3:7] *= sign[:, None]
    T = twist_turn(quarters, record["v"].shape[1])
    np.testing.assert_allclose(record["q"], q, atol=1e-6)
    np.testing.assert_allclose(record["v"], expected["v"] @ T.T, atol=1e-5)
    if "thrust" in expected.series:
        np.testing.assert_allclose(record["thrust"], expected["thrust"], atol=1e-3)


@long_without_compiler
@pytest.mark.slow
@pytest.mark.parametrize("quarters", QUARTERS)
@pytest.mark.parametrize("plant", ["kinematic", "dynamic"])
@pytest.mark.parametrize("name", WITH_ARMS)
def test_pre_flight_and_a_short_campaign_are_the_same(name: str, plant: str, quarters: int) -> None:
    for seed in range(3):
        as_is = hover_and_reach(load_robot(name), 0, plant=plant, seed=seed)
        otherwise = hover_and_reach(turned(name, quarters), quarters, plant=plant, seed=seed)
        judged, judged_otherwise = (
            [
                (finding.severity, finding.check, finding.phase)
                for finding in scenario.check().findings
            ]
            for scenario in (as_is, otherwise)
        )
        assert judged_otherwise == judged
        require_same(otherwise.run(), as_is.run(), quarters)
