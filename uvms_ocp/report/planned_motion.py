"""What came out of a plan request: the content of ``report.json``, and the motion as a ``Record``."""

from __future__ import annotations

from typing import Any

import numpy as np

from uvms_ocp.arguments import checked
from uvms_ocp.collision.coal_distances import CoalDistances
from uvms_ocp.collision.collision_scene import Nearest
from uvms_ocp.collision.conservative_advancement import clearance_along
from uvms_ocp.meta_values import AxisLimitsMeta
from uvms_ocp.model.shapes.unshaped import links_without_shape
from uvms_ocp.planning.request import PlanResult
from uvms_ocp.planning.soft_collision import CollisionPlan
from uvms_ocp.record import Record
from uvms_ocp.report.motion import Motion, nearest_entries, plan_meta
from uvms_ocp.run_meta import packages, versions
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial

_PERIOD = 0.02  # [s] of the record, longer where it would have more rows than this:
_MAX_ROWS = 5000
_UNREACHED = "no posture reaches the goal"
_UNREACHED_ADVICE = "move the goal or the obstacles, leave its orientation free, or plan more axes."
_RATES = ("velocity", "acceleration")


@checked
def plan_report(result: PlanResult) -> dict[str, Any]:
    """The content of ``report.json``: lengths in m, angles in rad, times in s."""
    request, scene = result.request, result.scene
    report = {
        "robot": request.robot.name,
        "collision_free": result.collision_free,
        "links_without_shape": list(links_without_shape(request.robot)),
        "status": _UNREACHED if result.plan is None else result.plan.status.value,
        "advice": _UNREACHED_ADVICE if result.plan is None else result.plan.status.advice,
        "axes": list(scene.coordinates.names),
        "obstacles": [item.model_dump(mode="json") for item in request.obstacles],
        "n_pairs": scene.n_pairs,
        "clearance_wanted_m": request.clearance,
        "seed": request.seed,
        "versions": versions(packages()),
    }
    return report if result.plan is None else report | _of_plan(result, result.plan)


def _of_plan(result: PlanResult, plan: CollisionPlan) -> dict[str, Any]:
    curve, motion = plan.trajectory, _motion(result, plan.trajectory)
    ends = curve.evaluate([curve.start, curve.end])
    return {
        "start": ends[0].tolist(),
        "goal": ends[1].tolist(),
        "duration_s": curve.duration,
        "piece_durations_s": curve.durations.tolist(),
        "limit_ratios": _limit_ratios(result, curve),
        **nearest_entries(_nearest(plan, motion)),
        "n_samples_certified": plan.clearance.n_samples,
        "tool_error": motion.tool_error(),
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


@checked
def motion_record(result: PlanResult, plan: CollisionPlan) -> Record:
    """The planned motion: series t (n,) [s], q (n, n_q), v (n, n_v), x, its rates up to the snap, and clearance.

    ``x``, ``x_rate``, ``x_acceleration``, ``x_jerk`` and ``x_snap`` are (n, n_axes); ``clearance`` (n, n_groups) is the
    smallest distance to each obstacle and between links, as `PlanMeta.clearance_groups` names them.
    """
    curve, planned, limits = plan.trajectory, result.scene.coordinates, result.request.robot.limits
    motion = _motion(result, curve)
    x = [curve.evaluate(motion.t, order) for order in range(5)]
    names = ("x", "x_rate", "x_acceleration", "x_jerk", "x_snap")
    series = {
        "t": motion.t,
        "q": motion.q,
        "v": (planned.velocity_map(x[0]) @ x[1][..., None])[..., 0],
        **dict(zip(names, x, strict=True)),
        **motion.clearance_series(),
    }
    meta = plan_meta(
        motion,
        scenario=f"plan, {plan.status.value}",
        axis_limits=AxisLimitsMeta(
            x_rate=tuple(limits.velocity[planned.planned].tolist()),
            x_acceleration=tuple(limits.acceleration[planned.planned].tolist()),
        ),
        breaks=tuple(curve.breaks.tolist()),
        nearest=_nearest(plan, motion),
    )
    return Record(series=series, meta=meta)


def _motion(result: PlanResult, curve: PiecewisePolynomial) -> Motion:
    n = min(int(np.ceil(curve.duration / _PERIOD)) + 1, _MAX_ROWS)
    t, distances = clearance_along(CoalDistances(result.scene), curve, max(n, 2))
    q = result.scene.coordinates.configurations(curve.evaluate(t))
    return Motion(request=result.request, scene=result.scene, t=t, q=q, distances=distances)


def _nearest(plan: CollisionPlan, motion: Motion) -> Nearest:
    """The smallest distance met, by the certificate or along the record."""
    return min(plan.clearance.nearest, motion.nearest, key=lambda nearest: nearest.distance)
