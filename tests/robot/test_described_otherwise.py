"""One robot described in another way, with axes of joints the other way round, thrusters and files in
another order, is the same robot, from kinematics to a run.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import yaml
from compiler import long_without_compiler

from uvms_ocp.robot import Kinematics, list_robots, load_robot
from uvms_ocp.robot.dynamics import robot_dynamics
from uvms_ocp.robot.loading import robot_folder
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.thrusters import largest_force, largest_wrench, thruster_matrix
from uvms_ocp.scenario import reach

ROBOTS = [name for name in list_robots() if load_robot(name).n_joints]
VEHICLES_WITH_ARMS = [name for name in ROBOTS if load_robot(name).n_vehicle]


@dataclass(frozen=True, kw_only=True)
class Redescribed:
    """A robot and the same one described in another way."""

    robot: Robot
    same: Robot
    joint_signs: np.ndarray
    """(n_joints,) by which positions, velocities and torques of joints differ."""
    thruster_order: list[int]
    """Index in `robot` of each thruster of `same`."""

    def velocity(self, v: np.ndarray) -> np.ndarray:
        """(..., n_v) of `same` for one of `robot`, and the other way round; forces likewise."""
        v = v.copy()
        v[..., self.robot.joint_v] *= self.joint_signs
        return v

    def configuration(self, q: np.ndarray) -> np.ndarray:
        """(..., n_q) of `same` for one of `robot`, and the other way round."""
        q = q.copy()
        q[..., self.robot.joint_q] *= self.joint_signs
        return q


def _negate_joint(joint: ET.Element) -> None:
    """Turn the axis of a joint, with its limits."""
    axis = joint.find("axis")
    assert axis is not None
    components = [-float(word) for word in axis.attrib["xyz"].split()]
    axis.attrib["xyz"] = " ".join(map(repr, components))
    limit = joint.find("limit")
    if limit is not None and "lower" in limit.attrib:
        lower = float(limit.attrib["lower"])
        upper = float(limit.attrib["upper"])
        limit.attrib.update(lower=repr(-upper), upper=repr(-lower))


@cache
def redescribed(name: str) -> Redescribed:
    """Negate every other joint, reverse the order of links and joints in the URDF, and that of the
    thrusters.
    """
    robot = load_robot(name)
    negated = robot.joint_names[::2]
    folder = robot_folder(name)
    tree = ET.parse(folder / "robot.urdf")
    root = tree.getroot()
    for joint in root.findall("joint"):
        if joint.attrib["name"] in negated:
            _negate_joint(joint)
    root[:] = list(root)[::-1]
    data = yaml.safe_load((folder / "hydrodynamics.yaml").read_text(encoding="utf-8"))
    for joint_name in negated:
        entry = data["joints"][joint_name]
        entry["home"] = -entry.get("home", 0.0)
    thrusters = data.get("thrusters", [])
    data["thrusters"] = thrusters[::-1]
    with TemporaryDirectory() as place:
        urdf = Path(place) / "robot.urdf"
        tree.write(urdf)
        hydrodynamics = Path(place) / "hydrodynamics.yaml"
        hydrodynamics.write_text(yaml.safe_dump(data), encoding="utf-8")
        same = load_robot(urdf=urdf, hydrodynamics=hydrodynamics)
    assert same.joint_names == robot.joint_names
    signs = [-1.0 if joint_name in negated else 1.0 for joint_name in robot.joint_names]
    return Redescribed(
        robot=robot,
        same=same,
        joint_signs=np.array(signs),
        thruster_order=list(range(len(thrusters)))[::-1],
    )


@pytest.mark.sampled
@pytest.mark.parametrize("name", ROBOTS)
def test_kinematics_and_dynamics_are_the_same(name: str) -> None:
    pair = redescribed(name)
    robot, same = pair.robot, pair.same
    assert same.home == pytest.approx(robot.home * pair.joint_signs)
    rng = np.random.default_rng(7)
    lower = np.maximum(robot.limits.position_lower, -3.0)
    upper = np.minimum(robot.limits.position_upper, 3.0)
    joints = rng.uniform(lower, upper)
    q = robot.with_joint_values(robot.configuration(), joints)
    v = rng.uniform(-0.5, 0.5, robot.n_v)
    a = rng.uniform(-0.5, 0.5, robot.n_v)
    q_same = pair.configuration(q)
    v_same = pair.velocity(v)
    a_same = pair.velocity(a)
    for frame in robot.tools:
        J = Kinematics(robot, q).jacobian(frame)
        J_same = Kinematics(same, q_same).jacobian(frame)
        np.testing.assert_allclose(pair.velocity(J_same), J, atol=1e-12)
        np.testing.assert_allclose(
            Kinematics(same, q_same).pose(frame).homogeneous,
            Kinematics(robot, q).pose(frame).homogeneous,
            atol=1e-12,
        )
    tau = robot_dynamics(robot).inverse_dynamics(q, v, a)
    tau_same = robot_dynamics(same).inverse_dynamics(q_same, v_same, a_same)
    np.testing.assert_allclose(pair.velocity(tau_same), tau, atol=1e-9)


@pytest.mark.parametrize("name", ROBOTS)
def test_limits_and_thrusters_are_the_same(name: str) -> None:
    pair = redescribed(name)
    robot, same = pair.robot, pair.same
    np.testing.assert_allclose(same.limits.velocity, robot.limits.velocity)
    np.testing.assert_allclose(same.limits.effort, robot.limits.effort)
    positions = np.stack([robot.limits.position_lower, robot.limits.position_upper])
    described = pair.joint_signs * [same.limits.position_lower, same.limits.position_upper]
    np.testing.assert_allclose(np.sort(described, axis=0), positions)
    if not pair.thruster_order:
        return
    np.testing.assert_array_equal(
        thruster_matrix(same), thruster_matrix(robot)[:, pair.thruster_order]
    )
    np.testing.assert_allclose(largest_wrench(same), largest_wrench(robot), rtol=1e-9)
    np.testing.assert_allclose(largest_force(same), largest_force(robot), rtol=1e-9)


@long_without_compiler
@pytest.mark.slow
@pytest.mark.parametrize("plant", ["kinematic", "dynamic"])
@pytest.mark.parametrize("name", VEHICLES_WITH_ARMS)
def test_a_run_is_the_same(name: str, plant: str) -> None:
    pair = redescribed(name)
    as_is, otherwise = (
        reach(robot=robot, plant=plant, duration=3.0).run() for robot in (pair.robot, pair.same)
    )
    assert list(map(str, otherwise.meta.events)) == list(map(str, as_is.meta.events))
    np.testing.assert_allclose(pair.configuration(otherwise["q"]), as_is["q"], atol=1e-6)
    np.testing.assert_allclose(pair.velocity(otherwise["v"]), as_is["v"], atol=1e-5)
    if plant == "dynamic":
        thrust = as_is["thrust"][:, pair.thruster_order]
        np.testing.assert_allclose(otherwise["thrust"], thrust, atol=1e-3)
