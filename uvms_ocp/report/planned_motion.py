"""Make reports and records of planned motions: smooth curves, and plans of optimal control."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.checks import checked
from uvms_ocp.ocp.motion_record import axis_series, motion_series
from uvms_ocp.ocp.plan import OcpStatus
from uvms_ocp.ocp.request import OcpRequest, OcpResult
from uvms_ocp.planning import (
    CoalDistances,
    CollisionPlan,
    PlanRequest,
    PlanResult,
    ToolGoal,
    clearance_along,
)
from uvms_ocp.planning.request import curve_limits
from uvms_ocp.planning.scene import CollisionScene, NearestPair
from uvms_ocp.record.meta_values import (
    AxisLimitsMeta,
    ClearanceMeta,
    FrameMeta,
    PhaseMeta,
    SurroundingsMeta,
)
from uvms_ocp.record.record import Record
from uvms_ocp.record.run_meta import PlanMeta, packages, versions
from uvms_ocp.record.series_checks import PLANNED
from uvms_ocp.robot import kinematics, recorded_robots, thrusters
from uvms_ocp.robot.shapes import obstacles, shape_pairs
from uvms_ocp.robot.shapes.signed_distance import open_surfaces
from uvms_ocp.trajectories.polynomial import PiecewisePolynomial
from uvms_ocp.types import Array

_TOOL = "tool"

_PERIOD = 0.02  # [s] between rows of the record, longer where there would be too many
_MAX_ROWS = 5000
_UNREACHED = "no posture reaches the goal"
_UNREACHED_ADVICE = "move the goal or the obstacles, leave its orientation free, or plan more axes."

_TOUCHING = "two shapes touch: add way for them, move the goal, or plan a curve"
_ADVICE = {  # where a request has other means than a problem
    OcpStatus.UNFINISHED: (
        "the solver stopped early: give a longer duration, a nearer goal or fewer steps, or raise"
        " time_limit"
    )
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlannedMotion:
    """Samples of a planned motion, both ends included, and the distances at them."""

    request: PlanRequest | OcpRequest
    """Robot, start, goal and surroundings that the motion was planned for."""
    scene: CollisionScene
    """Shapes among which it moves, and its axes."""
    t: Array
    """(n,) [s] times of the samples."""
    q: Array
    """(n, n_q) [m, rad] configurations."""
    distances: Array
    """(n, n_pairs) [m] distances of all pairs of shapes."""

    @property
    def nearest(self) -> NearestPair:
        """The smallest distance at any sample."""
        return self.scene.nearest(self.t, self.distances)

    def goal_pose(self) -> pin.SE3 | None:
        """Return X_WF at the end, of the frame that has a goal, else of the tool; `None` without
        such a frame.
        """
        robot = self.request.robot
        goal = self.request.goal
        frame = _TOOL
        if isinstance(goal, ToolGoal):
            frame = goal.frame
        if robot.has_frame(frame):
            return kinematics.Kinematics(robot, self.q[-1]).pose(frame)
        return None

    def tool_error(self) -> dict[str, float] | None:
        """Return distance [m] and angle [rad] of the frame from its goal at the end; `None` for the
        goal of a posture.
        """
        goal = self.request.goal
        X_WF = self.goal_pose()
        if X_WF is None or not isinstance(goal, ToolGoal):
            return None
        if not isinstance(goal.target, pin.SE3):
            distance = np.linalg.norm(X_WF.translation - goal.target)
            return {"position_m": float(distance)}
        distance = np.linalg.norm(X_WF.translation - goal.target.translation)
        angle = np.linalg.norm(pin.log3(X_WF.rotation.T @ goal.target.rotation))
        return {"position_m": float(distance), "orientation_rad": float(angle)}

    def clearance_series(self) -> dict[str, Array]:
        """``clearance`` (n, n_groups) [m] and ``quantities`` (n, 1) [m] of a record; none where
        nothing can meet.
        """
        groups = self.scene.groups()
        if not groups:
            return {}
        group_clearances = [self.distances[:, pairs].min(axis=1) for pairs in groups.values()]
        clearance = self.distances.min(axis=1)
        return {
            "clearance": np.stack(group_clearances, axis=1),
            "quantities": clearance[:, None],
        }


def _request_entries(request: PlanRequest | OcpRequest) -> dict[str, Any]:
    """Return the entries of a report on robot, surroundings and versions."""
    shapes = shape_pairs.shapes_among(request.robot, request.obstacles)
    obstacle_metas = obstacles.describe_obstacles(request.obstacles)
    link_clearance = request.link_clearance
    if link_clearance is None:
        link_clearance = request.clearance
    return {
        "robot": request.robot.name,
        "links_without_shape": list(shape_pairs.links_without_shape(request.robot)),
        "open_surfaces": list(open_surfaces(shapes)),
        "obstacles": [obstacle.model_dump(mode="json") for obstacle in obstacle_metas],
        "clearance_wanted_m": request.clearance,
        "link_clearance_wanted_m": link_clearance,
        "versions": versions(packages()),
    }


def nearest_entries(
    nearest: NearestPair | None, motion: PlannedMotion | OcpResult
) -> dict[str, Any]:
    """Return the entries of a report on the smallest distance of all, and the smallest ones to each
    obstacle and between links; values are `None` where nothing is measured.
    """
    if nearest is None:
        return {
            "min_clearance_m": None,
            "min_clearance_at_s": None,
            "min_clearance_between": None,
            "clearances_m": None,
        }
    clearances = {}
    for name, pairs in motion.scene.groups().items():
        clearances[name] = float(motion.distances[:, pairs].min())
    min_clearance = None
    if np.isfinite(nearest.distance):
        min_clearance = nearest.distance
    return {
        "min_clearance_m": min_clearance,
        "min_clearance_at_s": nearest.time,
        "min_clearance_between": nearest.pair,
        "clearances_m": clearances,
    }


def plan_meta(
    motion: PlannedMotion,
    *,
    scenario: str,
    axis_limits: AxisLimitsMeta,
    breaks: tuple[float, ...],
    nearest: NearestPair,
) -> PlanMeta:
    """Describe a planned motion as the metadata of its record.

    breaks [s] are where the pieces of its trajectory meet; `nearest` is the smallest distance that
    the method met.
    """
    request = motion.request
    scene = motion.scene
    frames = []
    X_WF = motion.goal_pose()
    if X_WF is not None:
        frames.append(FrameMeta(name="goal", pose=tuple(pin.SE3ToXYZQUAT(X_WF).tolist())))
    measured = dict[str, Any]()
    if scene.n_pairs:
        measured["quantities"] = ("plan.clearance",)
        measured["min_clearance"] = ClearanceMeta(
            t=nearest.time, distance=nearest.distance, between=nearest.pair
        )
    return PlanMeta(
        scenario=scenario,
        **recorded_robots.robot_meta(request.robot),
        phases=(PhaseMeta(name="plan"),),
        surroundings=SurroundingsMeta(
            frames=tuple(frames), obstacles=obstacles.describe_obstacles(request.obstacles)
        ),
        packages=packages(),
        axes=scene.coordinates.names,
        axis_limits=axis_limits,
        breaks=breaks,
        clearance_wanted=request.clearance,
        link_clearance_wanted=request.link_clearance,
        clearance_groups=tuple(scene.groups()),
        **measured,
    )


@checked
def plan_report(result: PlanResult) -> dict[str, Any]:
    """Return the content of ``report.json`` of a smooth curve: lengths in m, angles in rad, times in
    s.
    """
    request = result.request
    scene = result.scene
    plan = result.plan
    status = _UNREACHED
    advice = _UNREACHED_ADVICE
    if plan is not None:
        status = plan.status.value
        advice = plan.status.advice
    report = {
        **_request_entries(request),
        "collision_free": result.collision_free,
        "status": status,
        "advice": advice,
        "axes": list(scene.coordinates.names),
        "n_pairs": scene.n_pairs,
        "seed": request.seed,
    }
    if plan is None:
        return report
    return report | _curve_entries(result, plan)


def _curve_entries(result: PlanResult, plan: CollisionPlan) -> dict[str, Any]:
    """Return the entries of a report on a smooth curve that was found."""
    curve = plan.trajectory
    motion = _curve_motion(result, curve)
    ends = curve.evaluate([curve.start, curve.end])
    # Largest velocities and accelerations by their limits; 0 where there is no limit.
    robot = result.request.robot
    shares = curve_limits(result.scene.coordinates, ends).ratios(curve)
    names = (*thrusters.AXES[: robot.n_vehicle], *robot.joint_names)
    velocity_shares = dict(zip(names, shares[0].tolist(), strict=True))
    acceleration_shares = dict(zip(names, shares[1].tolist(), strict=True))
    return {
        "start": ends[0].tolist(),
        "goal": ends[1].tolist(),
        "duration_s": curve.duration,
        "piece_durations_s": curve.durations.tolist(),
        "limit_ratios": {"velocity": velocity_shares, "acceleration": acceleration_shares},
        **nearest_entries(_nearest(plan, motion), motion),
        "n_samples_certified": plan.clearance.n_samples,
        "tool_error": motion.tool_error(),
        "attempts": plan.attempts,
        "iterations": plan.iterations,
        "solve_time_s": plan.solve_time,
    }


@checked
def motion_record(result: PlanResult, plan: CollisionPlan) -> Record:
    """Return a smooth curve as a record: series t (n,) [s], q (n, n_q), v (n, n_v), x, its rates up
    to the snap, and clearance.

    ``x``, ``x_rate``, ``x_acceleration``, ``x_jerk`` and ``x_snap`` are (n, n_axes); ``clearance``
    (n, n_groups) is the smallest distance to each obstacle and between links, as
    `PlanMeta.clearance_groups` names them.
    """
    curve = plan.trajectory
    planned = result.scene.coordinates
    motion = _curve_motion(result, curve)
    x = [curve.evaluate(motion.t, order) for order in range(len(PLANNED))]
    limits = planned.rate_limits(x[0])
    v = (planned.velocity_map(x[0]) @ x[1][..., None])[..., 0]
    series = {
        "t": motion.t,
        "q": motion.q,
        "v": v,
        **dict(zip(PLANNED, x, strict=True)),
        **motion.clearance_series(),
    }
    meta = plan_meta(
        motion,
        scenario=f"plan, {plan.status.value}",
        axis_limits=AxisLimitsMeta(
            x_rate=tuple(limits[0].tolist()), x_acceleration=tuple(limits[1].tolist())
        ),
        breaks=tuple(curve.breaks.tolist()),
        nearest=_nearest(plan, motion),
    )
    return Record(series=series, meta=meta)


def _curve_motion(result: PlanResult, curve: PiecewisePolynomial) -> PlannedMotion:
    """Sample a smooth curve."""
    n = min(int(np.ceil(curve.duration / _PERIOD)) + 1, _MAX_ROWS)
    t, distances = clearance_along(CoalDistances(result.scene), curve, max(n, 2))
    q = result.scene.coordinates.configurations(curve.evaluate(t))
    return PlannedMotion(request=result.request, scene=result.scene, t=t, q=q, distances=distances)


def _nearest(plan: CollisionPlan, motion: PlannedMotion) -> NearestPair:
    """Return the smallest distance that the certificate or the samples of the record have met."""
    return min(plan.clearance.nearest, motion.nearest, key=lambda nearest: nearest.distance)


@checked
def ocp_report(result: OcpResult) -> dict[str, Any]:
    """Return the content of ``report.json`` of optimal control: lengths in m, angles in rad, times
    in s, energy in J, thrust in N.

    Energy, thrust, distances and errors of the motion are `None` where the plan is not usable.
    """
    request = result.request
    plan = result.plan
    summary = plan.summary()
    usable = plan.status.usable
    is_free = usable and result.collision_free
    energy = None
    peak_thrust = None
    nearest = None
    tool_error = None
    if usable:
        energy = summary["energy"]
        peak_thrust = summary["peak_thrust"]
        nearest = result.nearest
        tool_error = _ocp_motion(result).tool_error()
    if usable and not is_free:
        advice = _TOUCHING
    else:
        advice = _ADVICE.get(plan.status, summary["advice"])
    return {
        **_request_entries(request),
        "method": "ocp",
        "status": summary["status"],
        "reason": summary["reason"],
        "advice": advice,
        "collision_free": is_free,
        "duration_s": summary["duration"],
        "n_steps": request.n_steps,
        "energy_j": energy,
        "peak_thrust_n": peak_thrust,
        "levels": summary["levels"],
        **nearest_entries(nearest, result),
        "tool_error": tool_error,
        "current_m_s": list(request.current),
        "solver": plan.plugin or request.plugin,
        "iterations": summary["iterations"],
        "solve_time_s": summary["solve_time"],
    }


@checked
def ocp_record(result: OcpResult) -> Record:
    """Return a plan of optimal control as a record: t (n,) [s], q (n, n_q), v (n, n_v), axes ``x``
    and their rates, clearance, and efforts.

    ``thrust`` and ``torque`` are those of the steps, ``thruster_energy`` and ``joint_energy`` the
    energies taken so far [J]. ``clearance`` (n, n_groups) is the smallest distance to each obstacle and
    between links.
    """
    motion = _ocp_motion(result)
    plan = result.plan
    planned = result.scene.coordinates
    robot = result.request.robot
    series = motion_series(robot, plan.trajectory, plan.powers(), motion.t, motion.q)
    series |= axis_series(planned, result.coordinates, series["v"])
    series |= motion.clearance_series()
    rate_limits = planned.rate_limits(result.coordinates)[0]
    meta = plan_meta(
        motion,
        scenario=f"plan by optimal control, {plan.status.value}",
        axis_limits=AxisLimitsMeta(x_rate=tuple(rate_limits.tolist())),
        breaks=(0.0, plan.duration),
        nearest=motion.nearest,
    )
    return Record(series=series, meta=meta)


def _ocp_motion(result: OcpResult) -> PlannedMotion:
    """Return the samples of a plan of optimal control."""
    t, q = result.samples
    return PlannedMotion(
        request=result.request, scene=result.scene, t=t, q=q, distances=result.distances
    )
