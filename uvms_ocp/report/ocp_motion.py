"""What came out of optimal control: the content of ``report.json``, and the motion as a ``Record``."""

from __future__ import annotations

from typing import Any

from uvms_ocp.arguments import checked
from uvms_ocp.meta_values import AxisLimitsMeta
from uvms_ocp.model.shapes.unshaped import links_without_shape
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.plans.motion_series import axis_series, motion_series
from uvms_ocp.ocp.request import OcpResult
from uvms_ocp.record import Record
from uvms_ocp.report.motion import Motion, nearest_entries, plan_meta
from uvms_ocp.run_meta import packages, versions

_TOUCHING = "two shapes touch: add way for them, move the goal, or plan a curve"
_ADVICE = {  # where a request has other means than a problem
    OcpStatus.UNFINISHED: "the solver stopped early: give a longer duration, a nearer goal or fewer steps, or raise time_limit",
}


@checked
def ocp_report(result: OcpResult) -> dict[str, Any]:
    """The content of ``report.json``: lengths in m, angles in rad, times in s, energy in J, thrust in N.

    What is measured along the motion is `None` where the plan is not usable: no motion is there to measure.
    """
    request, plan = result.request, result.plan
    summary = plan.summary()
    levels = summary.pop("levels")
    usable = plan.status.usable
    free = usable and result.collision_free
    return {
        "method": "ocp",
        "robot": summary["robot"],
        "status": summary["status"],
        "reason": summary["reason"],
        "advice": _TOUCHING if usable and not free else _ADVICE.get(plan.status, summary["advice"]),
        "collision_free": free,
        "links_without_shape": list(links_without_shape(request.robot)),
        "duration_s": summary["duration"],
        "n_steps": request.n_steps,
        "energy_j": summary["energy"] if usable else None,
        "peak_thrust_n": summary["peak_thrust"] if usable else None,
        "levels": levels,
        **nearest_entries(result.nearest if usable else None),
        "tool_error": _motion(result).tool_error() if usable else None,
        "clearance_wanted_m": request.clearance,
        "current_m_s": list(request.current),
        "obstacles": [item.model_dump(mode="json") for item in request.obstacles],
        "solver": request.plugin,
        "iterations": summary["iterations"],
        "solve_time_s": summary["solve_time"],
        "versions": versions(packages()),
    }


@checked
def ocp_record(result: OcpResult) -> Record:
    """The planned motion: t (n,) [s], q (n, n_q), v (n, n_v), axes ``x`` and their rates, clearance, and efforts.

    ``thrust`` and ``torque`` are those of the steps, ``thruster_energy`` and ``joint_energy`` what was taken so far [J].
    ``clearance`` (n, n_groups) is the smallest distance to each obstacle and between links.
    """
    motion, plan, robot = _motion(result), result.plan, result.request.robot
    series = motion_series(robot, plan.trajectory, plan.powers(), motion.t, motion.q)
    series |= axis_series(result.scene.coordinates, result.coordinates, series["v"]) | motion.clearance_series()
    meta = plan_meta(
        motion,
        scenario=f"plan by optimal control, {result.plan.status.value}",
        axis_limits=AxisLimitsMeta(x_rate=tuple(result.request.robot.limits.velocity.tolist())),
        breaks=(0.0, result.plan.duration),
        nearest=motion.nearest,
    )
    return Record(series=series, meta=meta)


def _motion(result: OcpResult) -> Motion:
    t, q = result.samples
    return Motion(request=result.request, scene=result.scene, t=t, q=q, distances=result.distances)
