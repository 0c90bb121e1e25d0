"""What came out of optimal control: the content of ``report.json``, and the motion as a ``Record``."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.arrays import Array
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.request import OcpResult
from uvms_ocp.planning.goals import ToolGoal
from uvms_ocp.record import Record
from uvms_ocp.version import __version__

_TOUCHING = "two shapes touch: add way for them, move the goal, or plan a curve"
_ADVICE = {  # where a request has other means than a problem
    OcpStatus.UNFINISHED: "the solver stopped early: give a longer duration, a nearer goal or fewer steps, or raise time_limit",
}


def ocp_report(result: OcpResult) -> dict[str, Any]:
    """The content of ``report.json``: lengths in m, angles in rad, times in s, energy in J, thrust in N.

    What is measured along the motion is `None` where the plan is not usable: no motion is there to measure.
    """
    request, plan = result.request, result.plan
    summary = plan.summary()
    levels = summary.pop("levels")
    usable = plan.status.usable
    when, least, pair = result.smallest if usable else (None, np.inf, None)
    free = usable and result.collision_free
    return {
        "method": "ocp",
        "robot": summary["robot"],
        "status": summary["status"],
        "reason": summary["reason"],
        "advice": _TOUCHING if usable and not free else _ADVICE.get(plan.status, summary["advice"]),
        "collision_free": free,
        "duration_s": summary["duration"],
        "n_steps": request.n_steps,
        "energy_j": summary["energy"] if usable else None,
        "peak_thrust_n": summary["peak_thrust"] if usable else None,
        "levels": levels,
        "min_clearance_m": least if np.isfinite(least) else None,
        "min_clearance_at_s": when,
        "min_clearance_between": pair,
        "tool_error": _tool_error(result) if usable else None,
        "clearance_wanted_m": request.clearance,
        "current_m_s": list(request.current),
        "obstacles": [item.model_dump(mode="json") for item in request.obstacles],
        "solver": request.plugin,
        "iterations": summary["iterations"],
        "solve_time_s": summary["solve_time"],
        "versions": {"uvms_ocp": __version__} | {name: version(name) for name in ("pin", "coal", "casadi", "numpy")},
    }


def _tool_error(result: OcpResult) -> dict[str, float] | None:
    """Distance [m] and angle [rad] of the frame from its goal at the end of the plan."""
    goal = result.request.goal
    if not isinstance(goal, ToolGoal):
        return None
    X_WF, target = _pose(result, goal.frame), goal.target
    if not isinstance(target, pin.SE3):
        return {"position_m": float(np.linalg.norm(X_WF.translation - target))}
    return {
        "position_m": float(np.linalg.norm(X_WF.translation - target.translation)),
        "orientation_rad": float(np.linalg.norm(pin.log3(X_WF.rotation.T @ target.rotation))),
    }


def ocp_record(result: OcpResult) -> Record:
    """The planned motion: t (n,) [s], q (n, n_q), v (n, n_v), axes ``x`` and their rates, clearance, and efforts.

    ``thrust`` and ``torque`` are those of the steps, ``thruster_energy`` and ``joint_energy`` what was taken so far [J].
    ``clearance`` (n, n_groups) is the smallest distance to each obstacle and between links.
    """
    (t, q), x = result.samples, result.coordinates
    trajectory, model = result.plan.trajectory, result.request.robot.model
    v = np.array([trajectory.state_at(model, moment)[1] for moment in t])
    steps = [trajectory.step_at(moment) for moment in t]
    thrusters, joints = (_taken(trajectory.t, power, t) for power in result.plan.powers())
    series = {
        "t": t,
        "q": q,
        "v": v,
        "x": x,
        "x_rate": np.linalg.solve(result.scene.coordinates.velocity_map(x), v[..., None])[..., 0],
        "thrust": trajectory.thrust[steps],
        "torque": trajectory.torque[steps],
        "thruster_energy": thrusters,
        "joint_energy": joints.sum(axis=1),
    }
    groups = result.scene.groups()
    if groups:
        d = result.distances
        series["clearance"] = np.stack([d[:, pairs].min(axis=1) for pairs in groups.values()], axis=1)
        series["quantities"] = d.min(axis=1)[:, None]
    return Record(series=series, meta=_meta(result) | {"clearance_groups": list(groups)})


def _taken(nodes: Array, power: Array, t: Array) -> Array:
    """Integral (len(t), n) of powers (n_steps, n) that are constant between nodes."""
    total = np.vstack([np.zeros(power.shape[1]), np.cumsum(np.diff(nodes)[:, None] * power, axis=0)])
    return np.array([np.interp(t, nodes, column) for column in total.T]).reshape(power.shape[1], len(t)).T


def _meta(result: OcpResult) -> dict[str, Any]:
    request, planned = result.request, result.scene.coordinates
    frame = request.goal.frame if isinstance(request.goal, ToolGoal) else "tool"
    has_frame = request.robot.has_frame(frame)
    return {
        "scenario": f"plan by optimal control, {result.plan.status.value}",
        "robot": request.robot.name,
        "joints": list(request.robot.joint_names),
        "axes": list(planned.names),
        "axis_limits": {"x_rate": request.robot.limits.velocity.tolist()},
        "breaks": [0.0, result.plan.duration],
        "phases": [{"name": "plan", "title": ""}],
        "clearance_wanted": request.clearance,
        "min_clearance": list(result.smallest),
        "quantities": ["plan.clearance"] if result.scene.n_pairs else [],
        "obstacles": [item.model_dump(mode="json") for item in request.obstacles],
        "frames": {"goal": pin.SE3ToXYZQUAT(_pose(result, frame)).tolist()} if has_frame else {},
    }


def _pose(result: OcpResult, frame: str) -> pin.SE3:
    """X_WF at the end of the plan."""
    robot = result.request.robot
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, result.samples[1][-1])
    return data.oMf[robot.frame_id(frame)].copy()
