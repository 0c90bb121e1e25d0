"""Check that the tool reaches its goal from wherever the vehicle may stand, and suggest a way point
from which it does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.robot.size import size
from uvms_ocp.scenario.preflight.arm_reach import REACHED, ArmReach, ReachResult
from uvms_ocp.scenario.preflight.findings import Finding, Severity
from uvms_ocp.scenario.preflight.phase_forecast import Stance, Visit, forecast
from uvms_ocp.scenario.preflight.setup import Setup, goals_of
from uvms_ocp.tasks.goals import evaluate_pose
from uvms_ocp.tasks.pose import ToolPose, ToolPosition, VehiclePose
from uvms_ocp.tasks.vehicle_velocity import NullVelocity

CHECK = "reachability"
_STEP = 0.2  # sizes of the robot between suggested way points
_FARTHEST = 8.0  # sizes of the robot from the way point given
# starts from solved neighbours, and random ones beside them
_N_NEAR = 3
_N_FEW = 4

_cost = attrgetter("cost")


def check_tool(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """Return one finding per tool task that has to be fulfilled while the vehicle stands still.

    A note where the goal is reached from every stance, a warning where it is from the likely ones,
    else an error.
    """
    for visit in visits:
        task = visit.active(ToolPose) or visit.active(ToolPosition)
        if (
            task is not None
            and visit.active(NullVelocity) is not None
            and visit.phase.waits_for(task.name)
        ):
            yield _finding(setup, visit, task)


def _finding(setup: Setup, visit: Visit, task: ToolPose | ToolPosition) -> Finding:
    """Judge one tool task in one phase, with advice where its goal is not reached."""
    arm = ArmReach.of_task(setup, task)
    goals = goals_of(setup, task.name, task.goal)
    distances = distances_missing(arm, visit.stances, goals)
    figures: dict[str, Any] = distances.figures()
    if distances.worst.reached:
        text = (
            f"{task.name}: the goal is reached from all {len(visit.stances)} foreseen vehicle"
            " positions"
        )
        return Severity.NOTE.finding(CHECK, text, visit.phase.name, **figures)
    turned = distances
    if isinstance(task, ToolPose):
        turned = distances_missing(ArmReach.of_task(setup, task, turned=True), visit.stances, goals)
    figures["missing_best_with_free_orientation_m"] = turned.best.position
    figures["missing_worst_with_free_orientation_m"] = turned.worst.position
    suggestion = _suggestion(setup, arm, visit, goals)
    advice = "no way point towards it helps: move the goal or use another arm"
    if suggestion is not None:
        figures["suggested_way_point"] = [round(float(x), 3) for x in suggestion]
        advice = "try the way point ({:.2f}, {:.2f}, {:.2f})".format(*suggestion)
    elif isinstance(task, ToolPose) and turned.likely.position < REACHED:
        advice = (
            "its position alone is reached: ask for that, by ToolPosition, or use an arm of more"
            " joints"
        )
    text = (
        f"{task.name}: the arm misses the goal by {_missing_text(distances.best)} at best and"
        f" {_missing_text(distances.worst)} at worst over the vehicle positions foreseen"
    )
    severity = Severity.ERROR
    if distances.likely.reached:
        severity = Severity.WARNING
        text += ", though it reaches it from the likely ones"
    return severity.finding(CHECK, f"{text}; {advice}", visit.phase.name, **figures)


def _missing_text(reach: ReachResult) -> str:
    return f"{reach.position:.3f} m ({reach.orientation:.2f} rad)"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReachShortfall:
    """Shortfall over all stances, and at worst over those where the vehicle is likely to stand."""

    best: ReachResult
    """From the best stance."""
    worst: ReachResult
    """From the worst of all."""
    likely: ReachResult
    """From the worst of those that are likely."""

    def figures(self) -> dict[str, float]:
        """Return lengths [m] and angles [rad] by their names in a report."""
        reaches = {"best": self.best, "worst": self.worst, "likely": self.likely}
        lengths = {f"missing_{name}_m": value.position for name, value in reaches.items()}
        return lengths | {
            f"missing_{name}_rad": value.orientation for name, value in reaches.items()
        }


def distances_missing(
    robot_reach: ArmReach,
    stances: Sequence[Stance],
    goals: Sequence[pin.SE3],
    stop_at: float = np.inf,
) -> ReachShortfall:
    """Return the distances missing from every stance; ends early where one exceeds `stop_at` [m]."""
    reaches: list[ReachResult] = []
    likely: list[ReachResult] = []
    for stance in stances:
        for goal in goals:
            postures = [reach.joints for reach in sorted(reaches, key=_cost)[:_N_NEAR]]
            reaches.append(
                robot_reach.solve(
                    stance.X_WB, goal, postures, n_random=_N_FEW if postures else None
                )
            )
            if stance.likely:
                likely.append(reaches[-1])
        if reaches[-1].position > stop_at:
            break
    return ReachShortfall(
        best=min(reaches, key=_cost),
        worst=max(reaches, key=_cost),
        likely=max(likely or reaches, key=_cost),
    )


def _suggestion(
    setup: Setup, arm: ArmReach, visit: Visit, goals: Sequence[pin.SE3]
) -> np.ndarray | None:
    """Return the position (3,) [m] of the nearest way point on the line to the goal from which
    everything is reached.
    """
    source = _last_way_point(setup, visit)
    if source is None:
        return None
    phase, task = source
    way_point, _ = evaluate_pose(task.name, task.goal, 0.0)
    direction = (goals[0].translation - way_point.translation) * [1.0, 1.0, 0.0]
    distance = float(np.linalg.norm(direction))
    unit = size(setup.robot.model)
    for step in np.arange(_STEP * unit, min(distance, _FARTHEST * unit), _STEP * unit):
        shifted = pin.SE3(way_point.rotation, way_point.translation + direction * (step / distance))
        phases = list(setup.mission.phases)
        phases[phase] = replace(phases[phase], goals={**phases[phase].goals, task.name: shifted})
        moved = replace(setup, mission=replace(setup.mission, phases=tuple(phases)))
        if _reached_from(moved, arm, visit, goals):
            return np.asarray(shifted.translation)
    return None


def _last_way_point(setup: Setup, visit: Visit) -> tuple[int, VehiclePose] | None:
    """Return the index of the last phase before `visit` with a way point, and its task."""
    latest = None
    for earlier in forecast(setup):
        if earlier.index == visit.index:
            break
        task = earlier.active(VehiclePose)
        if task is not None and not callable(task.goal):
            latest = (earlier.index, task)
    return latest


def _reached_from(setup: Setup, arm: ArmReach, visit: Visit, goals: Sequence[pin.SE3]) -> bool:
    """Check that the arm reaches its goals from all stances of a phase; the farthest is tried
    first.
    """
    stances = next(
        foreseen.stances for foreseen in forecast(setup) if foreseen.index == visit.index
    )
    goal = goals[0].translation
    farthest_first = sorted(
        stances, key=lambda stance: -float(np.linalg.norm(goal - stance.position))
    )
    return distances_missing(arm, farthest_first, goals, stop_at=REACHED).worst.reached
