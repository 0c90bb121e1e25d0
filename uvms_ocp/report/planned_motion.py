"""What came out of a plan request: the content of ``report.json``, and the motion as a ``Record``."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.arrays import Array
from uvms_ocp.collision.coal_distances import CoalDistances
from uvms_ocp.collision.conservative_advancement import clearance_along
from uvms_ocp.planning.goals import ToolGoal
from uvms_ocp.planning.request import PlanResult
from uvms_ocp.planning.soft_collision import CollisionPlan
from uvms_ocp.record import Record
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial
from uvms_ocp.version import __version__

_PERIOD = 0.02  # [s] of the record, longer where it would have more rows than this:
_MAX_ROWS = 5000
_UNREACHED = "no posture reaches the goal"
_UNREACHED_ADVICE = "move the goal or the obstacles, leave its orientation free, or plan more axes."
_RATES = ("velocity", "acceleration")


def plan_report(result: PlanResult) -> dict[str, Any]:
    """The content of ``report.json``: lengths in m, angles in rad, times in s."""
    request, scene = result.request, result.scene
    report = {
        "robot": request.robot.name,
        "collision_free": result.collision_free,
        "status": _UNREACHED if result.plan is None else result.plan.status.value,
        "advice": _UNREACHED_ADVICE if result.plan is None else result.plan.status.advice,
        "axes": list(scene.coordinates.names),
        "obstacles": [item.model_dump(mode="json") for item in request.obstacles],
        "n_pairs": scene.n_pairs,
        "clearance_wanted_m": request.clearance,
        "seed": request.seed,
        "versions": {"uvms_ocp": __version__} | {name: version(name) for name in ("pin", "coal", "casadi", "numpy")},
    }
    return report if result.plan is None else report | _of_plan(result, result.plan)


def _of_plan(result: PlanResult, plan: CollisionPlan) -> dict[str, Any]:
    curve, (when, least, pair) = plan.trajectory, _smallest(result, plan)
    ends = curve.evaluate([curve.start, curve.end])
    return {
        "start": ends[0].tolist(),
        "goal": ends[1].tolist(),
        "duration_s": curve.duration,
        "piece_durations_s": curve.durations.tolist(),
        "limit_ratios": _limit_ratios(result, curve),
        "min_clearance_m": least if np.isfinite(least) else None,
        "min_clearance_at_s": when,
        "min_clearance_between": pair,
        "n_samples_certified": plan.clearance.n_samples,
        "tool_error": _tool_error(result, ends[1]),
        "attempts": plan.attempts,
        "iterations": plan.iterations,
        "solve_time_s": plan.solve_time,
    }


def _limit_ratios(result: PlanResult, curve: PiecewisePolynomial) -> dict[str, dict[str, float]]:
    """Largest rate of each axis by its limit; 0 where there is no limit."""
    planned, limits = result.scene.coordinates, result.request.robot.limits
    allowed = (limits.velocity[planned.planned], limits.acceleration[planned.planned])
    return {
        name: dict(zip(planned.names, (curve.peak(order) / limit).tolist(), strict=True))
        for order, (name, limit) in enumerate(zip(_RATES, allowed, strict=True), start=1)
    }


def _tool_error(result: PlanResult, x: Array) -> dict[str, float] | None:
    """Distance [m] and angle [rad] of the frame from its goal at the end of the plan."""
    goal = result.request.goal
    if not isinstance(goal, ToolGoal):
        return None
    X_WF = _frame_pose(result, x, goal.frame)
    target = goal.target
    if not isinstance(target, pin.SE3):
        return {"position_m": float(np.linalg.norm(X_WF.translation - target))}
    return {
        "position_m": float(np.linalg.norm(X_WF.translation - target.translation)),
        "orientation_rad": float(np.linalg.norm(pin.log3(X_WF.rotation.T @ target.rotation))),
    }


def motion_record(result: PlanResult, plan: CollisionPlan) -> Record:
    """The planned motion: series t (n,) [s], q (n, n_q), v (n, n_v), x, its rates up to the snap, and clearance.

    ``x``, ``x_rate``, ``x_acceleration``, ``x_jerk`` and ``x_snap`` are (n, n_axes); ``clearance`` (n, n_groups) is the
    smallest distance to each obstacle and between links, as ``meta["clearance_groups"]`` names them.
    """
    curve, planned = plan.trajectory, result.scene.coordinates
    t, d = _clearances(result, curve)
    x = [curve.evaluate(t, order) for order in range(5)]
    names = ("x", "x_rate", "x_acceleration", "x_jerk", "x_snap")
    series = {
        "t": t,
        "q": planned.configurations(x[0]),
        "v": (planned.velocity_map(x[0]) @ x[1][..., None])[..., 0],
        **dict(zip(names, x, strict=True)),
    }
    groups = result.scene.groups()
    if groups:
        series["clearance"] = np.stack([d[:, pairs].min(axis=1) for pairs in groups.values()], axis=1)
        series["quantities"] = d.min(axis=1)[:, None]
    return Record(series=series, meta=_meta(result, plan) | {"clearance_groups": list(groups)})


def _clearances(result: PlanResult, curve: PiecewisePolynomial) -> tuple[Array, Array]:
    """Times of the record and the distance of every pair at them, both ends included."""
    n = min(int(np.ceil(curve.duration / _PERIOD)) + 1, _MAX_ROWS)
    return clearance_along(CoalDistances(result.scene), curve, max(n, 2))


def _smallest(result: PlanResult, plan: CollisionPlan) -> tuple[float, float, str]:
    """Time, distance and pair of the smallest distance met, by the certificate or along the record."""
    found = (plan.clearance.time, plan.clearance.min_clearance, plan.clearance.pair)
    t, d = _clearances(result, plan.trajectory)
    if d.min(initial=np.inf) >= found[1]:
        return found
    row, pair = np.unravel_index(int(np.argmin(d)), d.shape)
    return float(t[row]), float(d[row, pair]), result.scene.pairs[pair].name


def _meta(result: PlanResult, plan: CollisionPlan) -> dict[str, Any]:
    request, planned = result.request, result.scene.coordinates
    limits, chosen = request.robot.limits, planned.planned
    ends = plan.trajectory.evaluate([plan.trajectory.start, plan.trajectory.end])
    frame = request.goal.frame if isinstance(request.goal, ToolGoal) else "tool"
    has_frame = request.robot.has_frame(frame)
    return {
        "scenario": f"plan, {plan.status.value}",
        "robot": request.robot.name,
        "joints": list(request.robot.joint_names),
        "axes": list(planned.names),
        "axis_limits": {
            "x_rate": limits.velocity[chosen].tolist(),
            "x_acceleration": limits.acceleration[chosen].tolist(),
        },
        "breaks": plan.trajectory.breaks.tolist(),
        "phases": [{"name": "plan", "title": ""}],
        "clearance_wanted": request.clearance,
        "min_clearance": list(_smallest(result, plan)),
        "quantities": ["plan.clearance"] if result.scene.n_pairs else [],
        "obstacles": [item.model_dump(mode="json") for item in request.obstacles],
        "frames": {"goal": pin.SE3ToXYZQUAT(_frame_pose(result, ends[1], frame)).tolist()} if has_frame else {},
    }


def _frame_pose(result: PlanResult, x: Array, frame: str) -> pin.SE3:
    robot = result.request.robot
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, result.scene.coordinates.configurations(x[None])[0])
    return data.oMf[robot.frame_id(frame)].copy()
