"""A planned trajectory sampled as the series of a record: states, the tool, forces, and the energy
taken so far.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.ocp.trajectory import TOLERANCE, Trajectory, admissible_configurations
from uvms_ocp.planning.planned_axes import Coordinates, coordinates
from uvms_ocp.record.meta_values import AxisLimitsMeta, PhaseMeta, SurroundingsMeta
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import PlanMeta, packages
from uvms_ocp.robot import Robot, recorded_robots
from uvms_ocp.types import Array

TOOL = "tool"
_PERIOD = 0.02  # [s] between samples, longer where there would be too many of them
_LARGEST_NUMBER_OF_SAMPLES = 5000

Powers = tuple[Array, Array]
"""[W] of every thruster (N, n_thrusters) and of every joint (N, n_joints) at the steps of a
trajectory.
"""


def plan_record(
    robot: Robot,
    trajectory: Trajectory,
    powers: Powers,
    *,
    title: str,
    surroundings: SurroundingsMeta,
) -> Record:
    """Return the record of a plan of any problem. Axes are left out of robots whose joints are no
    single axes.
    """
    t = sample_times(float(trajectory.t[-1]))
    q = admissible_configurations(robot, trajectory.states_at(robot.model, t)[0], TOLERANCE)
    series = motion_series(robot, trajectory, powers, t, q)
    names: tuple[str, ...] = ()
    limits = AxisLimitsMeta(x_rate=())
    if all(joint.n_v == 1 for joint in robot.joints):
        planned = coordinates(robot)
        names = planned.names
        x = np.array([planned.x_beyond_limits(configuration) for configuration in q])
        x[:, planned.endless] = np.unwrap(x[:, planned.endless], axis=0)
        series |= axis_series(planned, x, series["v"])
        rate_limits = planned.rate_limits(x)[0]
        limits = AxisLimitsMeta(x_rate=tuple(rate_limits.tolist()))
    meta = PlanMeta(
        scenario=title,
        **recorded_robots.robot_meta(robot),
        phases=(PhaseMeta(name="plan"),),
        surroundings=surroundings,
        packages=packages(),
        axes=names,
        axis_limits=limits,
        breaks=(0.0, float(t[-1])),
        clearance_wanted=0.0,
    )
    return Record(series=series, meta=meta)


def sample_times(duration: float) -> Array:
    """Return times (n,) [s] from 0 to `duration` [s], both included."""
    n_samples = min(int(np.ceil(duration / _PERIOD)) + 1, _LARGEST_NUMBER_OF_SAMPLES)
    return np.linspace(0.0, duration, max(2, n_samples))


def motion_series(
    robot: Robot, trajectory: Trajectory, powers: Powers, t: Array, q: Array
) -> dict[str, Array]:
    """Return the series of a record at times t (n,) [s], where the configurations are q (n, n_q)
    [m, rad].

    ``thrust`` (n, n_thrusters), or ``wrench`` (n, n_vehicle) of `Actuation.WRENCH`, and ``torque``
    (n, n_joints) are those of the steps; ``thruster_energy`` (n, n_thrusters) and ``joint_energy``
    (n,) [J] what was taken so far; ``tool`` (n, 7) [m, -] the pose X_WT where there is a tool.
    """
    _, v, steps = trajectory.states_at(robot.model, t)
    thruster_powers, joint_powers = powers
    thruster_energy = _energy_so_far(trajectory.t, thruster_powers, t)
    joint_energy = _energy_so_far(trajectory.t, joint_powers, t)
    series: dict[str, Array] = {"t": t, "q": q, "v": v}
    if robot.has_frame(TOOL):
        series[TOOL] = tool_series(robot, q)
    force_name = "wrench" if trajectory.has_wrench else "thrust"
    series[force_name] = trajectory.thrust[steps]
    series["torque"] = trajectory.torque[steps]
    series["thruster_energy"] = thruster_energy
    series["joint_energy"] = joint_energy.sum(axis=1)
    return series


def _energy_so_far(nodes: Array, power: Array, t: Array) -> Array:
    """Integrate powers (n_steps, n) [W] that are constant between nodes, up to times t (m,) [s];
    returns (m, n) [J].
    """
    n = power.shape[1]
    energy_of_steps = np.diff(nodes)[:, None] * power
    total = np.vstack([np.zeros(n), np.cumsum(energy_of_steps, axis=0)])
    columns = np.array([np.interp(t, nodes, column) for column in total.T])
    return columns.reshape(n, len(t)).T


def tool_series(robot: Robot, q: Array) -> Array:
    """Return poses X_WT (n, 7) [m, -], quaternions xyzw, at configurations q (n, n_q) [m, rad]."""
    return np.array([pin.SE3ToXYZQUAT(pose) for pose in frame_poses(robot, TOOL, q)])


def axis_series(planned: Coordinates, x: Array, v: Array) -> dict[str, Array]:
    """Return ``x`` (n, n_axes) [m, rad] and its rates [m/s, rad/s], where velocities are v (n, n_v)
    [m/s, rad/s].
    """
    rates = np.linalg.solve(planned.velocity_map(x), v[..., None])[..., 0]
    return {"x": x, "x_rate": np.asarray(rates, dtype=float)}


def frame_poses(robot: Robot, frame: str, q: np.ndarray) -> list[pin.SE3]:
    """Return X_WF at configurations q (n, n_q) [m, rad]. Raises `FrameNotFound` for an unknown
    frame.
    """
    data = robot.model.createData()
    index = robot.frame_id(frame)
    poses = []
    for configuration in q:
        pin.framesForwardKinematics(robot.model, data, configuration)
        poses.append(data.oMf[index].copy())
    return poses
