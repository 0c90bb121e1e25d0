"""A trajectory sampled as the series of a record: states, the tool, forces, and the energy taken so far."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from uvms_ocp.arrays import Array
from uvms_ocp.collision.coordinates import Coordinates, coordinates
from uvms_ocp.meta_values import AxisLimitsMeta, PhaseMeta, SurroundingsMeta
from uvms_ocp.model.robot import Robot
from uvms_ocp.ocp.plans.mismatch import frame_poses
from uvms_ocp.ocp.trajectory import Trajectory
from uvms_ocp.record import Record
from uvms_ocp.run_meta import PlanMeta, packages

TOOL = "tool"
_PERIOD = 0.02  # [s] between samples, longer where there would be more of them than this:
_MOST_SAMPLES = 5000

Powers = tuple[Array, Array]
"""[W] of every thruster (N, n_thrusters) and of every joint (N, n_joints) at the steps of a trajectory."""


def sample_times(duration: float) -> Array:
    """Times (n,) [s] from 0 to `duration` [s], both included."""
    n = max(2, min(int(np.ceil(duration / _PERIOD)) + 1, _MOST_SAMPLES))
    return np.linspace(0.0, duration, n)


def motion_series(robot: Robot, trajectory: Trajectory, powers: Powers, t: Array, q: Array) -> dict[str, Array]:
    """Series of a record at times t (n,) [s], where the configurations are q (n, n_q) [m, rad].

    ``thrust`` (n, n_thrusters), or ``wrench`` (n, n_vehicle) of `Actuation.WRENCH`, and ``torque`` (n, n_joints) are those of
    the steps; ``thruster_energy`` (n, n_thrusters) and ``joint_energy`` (n,) [J] what was taken so far; ``tool`` (n, 7) [m, -]
    the pose X_WT where there is a tool.
    """
    states = [trajectory.state_at(robot.model, float(moment)) for moment in t]
    steps = [trajectory.step_at(float(moment)) for moment in t]
    thrusters, joints = (_taken(trajectory.t, power, t) for power in powers)
    series: dict[str, Array] = {"t": t, "q": q, "v": np.array([state[1] for state in states], dtype=float)}
    if robot.has_frame(TOOL):
        series[TOOL] = tool_series(robot, q)
    return series | {
        "wrench" if trajectory.has_wrench else "thrust": trajectory.thrust[steps],
        "torque": trajectory.torque[steps],
        "thruster_energy": thrusters,
        "joint_energy": joints.sum(axis=1),
    }


def tool_series(robot: Robot, q: Array) -> Array:
    """(n, 7) [m, -] poses X_WT, quaternions xyzw, at configurations q (n, n_q) [m, rad]."""
    return np.array([pin.SE3ToXYZQUAT(pose) for pose in frame_poses(robot, TOOL, q)])


def axis_series(planned: Coordinates, x: Array, v: Array) -> dict[str, Array]:
    """``x`` (n, n_axes) [m, rad] and its rates [m/s, rad/s], where velocities are v (n, n_v) [m/s, rad/s]."""
    return {"x": x, "x_rate": np.asarray(np.linalg.solve(planned.velocity_map(x), v[..., None])[..., 0], dtype=float)}


def plan_record(
    robot: Robot, trajectory: Trajectory, powers: Powers, *, title: str, surroundings: SurroundingsMeta
) -> Record:
    """The record of a plan of any problem. Axes are left out of robots whose joints are no single axes."""
    t = sample_times(float(trajectory.t[-1]))
    q = np.array([pin.normalize(robot.model, trajectory.state_at(robot.model, float(moment))[0]) for moment in t])
    series = motion_series(robot, trajectory, powers, t, q)
    names: tuple[str, ...] = ()
    if all(joint.n_q == joint.n_v == 1 for joint in robot.joints):
        planned = coordinates(robot, reference=q[0])
        names = planned.names
        series |= axis_series(planned, np.array([planned.x(row) for row in q]), series["v"])
    meta = PlanMeta(
        scenario=title,
        robot=robot.name,
        joints=robot.joint_names,
        phases=(PhaseMeta(name="plan"),),
        surroundings=surroundings,
        packages=packages(),
        axes=names,
        axis_limits=AxisLimitsMeta(x_rate=tuple(robot.limits.velocity.tolist()) if names else ()),
        breaks=(0.0, float(t[-1])),
        clearance_wanted=0.0,
    )
    return Record(series=series, meta=meta)


def _taken(nodes: Array, power: Array, t: Array) -> Array:
    """Integral (len(t), n) of powers (n_steps, n) that are constant between nodes."""
    total = np.vstack([np.zeros(power.shape[1]), np.cumsum(np.diff(nodes)[:, None] * power, axis=0)])
    return np.array([np.interp(t, nodes, column) for column in total.T]).reshape(power.shape[1], len(t)).T
