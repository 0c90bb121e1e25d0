"""Check: the tool reaches its goal from wherever the vehicle may stand by then."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.mission.mission import Mission
from uvms_ocp.preflight.arm_reach import REACHED, ArmReach, Reach
from uvms_ocp.preflight.findings import Finding, Severity
from uvms_ocp.preflight.forecast import Stance, Visit, forecast
from uvms_ocp.preflight.setup import Setup
from uvms_ocp.tasks.pose import ToolPose, ToolPosition, VehiclePose
from uvms_ocp.tasks.reference import PoseGoal, evaluate_pose
from uvms_ocp.tasks.velocity import NullVelocity

CHECK = "reachability"
_N_TIMES = 5  # samples of a goal that moves
_STEP = 0.05  # [m] between suggested way points
_FARTHEST = 2.0  # [m] from the way point given
_N_NEAR, _N_FEW = 3, 4  # starts from solved neighbours, and random ones beside them


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Distances:
    """What is missing over all stances, and at worst over those where the vehicle is likely to stand."""

    best: Reach
    worst: Reach
    likely: Reach

    def figures(self) -> dict[str, float]:
        found = {"best": self.best, "worst": self.worst, "likely": self.likely}
        lengths = {f"missing_{name}_m": value.position for name, value in found.items()}
        return lengths | {f"missing_{name}_rad": value.orientation for name, value in found.items()}


def check_tool(setup: Setup, visits: Sequence[Visit]) -> Iterator[Finding]:
    """One finding per tool task that has to be fulfilled while the vehicle stands still.

    A note where the goal is reached from every stance, a warning where it is from the likely ones, else an error.
    """
    for visit in visits:
        task = visit.active(ToolPose) or visit.active(ToolPosition)
        if task is None or visit.active(NullVelocity) is None or not _awaited(visit, task):
            continue
        yield _finding(setup, visit, task)


def distances_missing(
    robot_reach: ArmReach, stances: Sequence[Stance], goals: Sequence[pin.SE3], stop_at: float = np.inf
) -> Distances:
    """The distances missing from every stance; ends early where one exceeds `stop_at` [m]."""
    found: list[Reach] = []
    likely: list[Reach] = []
    for stance in stances:
        for goal in goals:
            near = [reach.joints for reach in sorted(found, key=_cost)[:_N_NEAR]]
            found.append(robot_reach.solve(stance.X_WB, goal, near, n_random=_N_FEW if near else None))
            likely += found[-1:] if stance.likely else []
        if found[-1].position > stop_at:
            break
    return Distances(best=min(found, key=_cost), worst=max(found, key=_cost), likely=max(likely or found, key=_cost))


def _cost(reach: Reach) -> float:
    return reach.cost


def _awaited(visit: Visit, task: ToolPose | ToolPosition) -> bool:
    return any(
        condition.quantity.startswith(f"{task.name}.")
        for transition in visit.phase.transitions
        for condition in transition.when
    )


def _finding(setup: Setup, visit: Visit, task: ToolPose | ToolPosition) -> Finding:
    arm = ArmReach(setup.robot, task.frame, rotation_weight=float(isinstance(task, ToolPose)))
    goals = goals_of(setup, task.name, task.goal)
    distances = distances_missing(arm, visit.stances, goals)
    figures: dict[str, Any] = distances.figures()
    if distances.worst.reached:
        text = f"{task.name}: the goal is reached from all {len(visit.stances)} foreseen vehicle positions"
        return Finding(severity=Severity.NOTE, check=CHECK, phase=visit.phase.name, text=text, figures=figures)
    suggestion = _suggestion(setup, arm, visit, goals)
    figures |= _free_orientation(setup, visit, task, goals)
    if suggestion is not None:
        figures["suggested_way_point"] = [round(float(x), 3) for x in suggestion]
    return Finding(
        severity=Severity.WARNING if distances.likely.reached else Severity.ERROR,
        check=CHECK,
        phase=visit.phase.name,
        text=_text(task.name, distances, suggestion),
        figures=figures,
    )


def _text(name: str, distances: Distances, suggestion: np.ndarray | None) -> str:
    advice = "no way point towards it helps: move the goal or use another arm"
    if suggestion is not None:
        advice = "try the way point ({:.2f}, {:.2f}, {:.2f})".format(*suggestion)
    best, worst = distances.best, distances.worst
    from_likely = ", though it reaches it from the likely ones" if distances.likely.reached else ""
    return (
        f"{name}: the arm misses the goal by {best.position:.3f} m ({best.orientation:.2f} rad) at best and "
        f"{worst.position:.3f} m ({worst.orientation:.2f} rad) at worst over the vehicle positions foreseen"
        f"{from_likely}; {advice}"
    )


def _free_orientation(
    setup: Setup, visit: Visit, task: ToolPose | ToolPosition, goals: Sequence[pin.SE3]
) -> dict[str, float]:
    """How much is missing where the tool may point anywhere."""
    distances = distances_missing(ArmReach(setup.robot, task.frame, rotation_weight=0.0), visit.stances, goals)
    return {
        "missing_best_with_free_orientation_m": distances.best.position,
        "missing_worst_with_free_orientation_m": distances.worst.position,
    }


def goals_of(setup: Setup, name: str, goal: PoseGoal) -> list[pin.SE3]:
    """The goal; where it comes to rest if it moves; samples of it if it never rests."""
    last, rate = evaluate_pose(name, goal, setup.duration)
    if not callable(goal) or not rate.any():
        return [last]
    return [evaluate_pose(name, goal, t)[0] for t in np.linspace(0.0, setup.duration, _N_TIMES)]


def _suggestion(setup: Setup, arm: ArmReach, visit: Visit, goals: Sequence[pin.SE3]) -> np.ndarray | None:
    """Position (3,) of the nearest way point on the line to the goal from which everything is reached."""
    source = _last_way_point(setup, visit)
    if source is None:
        return None
    phase, task = source
    here, _ = evaluate_pose(task.name, task.goal, 0.0)
    direction = (goals[0].translation - here.translation) * [1.0, 1.0, 0.0]
    distance = float(np.linalg.norm(direction))
    for step in np.arange(_STEP, min(distance, _FARTHEST), _STEP):
        shifted = pin.SE3(here.rotation, here.translation + direction * (step / distance))
        moved = replace(setup, mission=_with_goal(setup.mission, phase, task.name, shifted))
        if _reached_from(moved, arm, visit, goals):
            return np.asarray(shifted.translation)
    return None


def _last_way_point(setup: Setup, visit: Visit) -> tuple[int, VehiclePose] | None:
    """Index of the last phase before `visit` with a way point, and its task."""
    found = None
    for earlier in forecast(setup):
        if earlier.index == visit.index:
            break
        task = earlier.active(VehiclePose)
        if task is not None and not callable(task.goal):
            found = (earlier.index, task)
    return found


def _with_goal(mission: Mission, phase: int, name: str, goal: pin.SE3) -> Mission:
    phases = list(mission.phases)
    phases[phase] = replace(phases[phase], goals={**phases[phase].goals, name: goal})
    return replace(mission, phases=tuple(phases))


def _reached_from(setup: Setup, arm: ArmReach, visit: Visit, goals: Sequence[pin.SE3]) -> bool:
    stances = next(later.stances for later in forecast(setup) if later.index == visit.index)
    goal = goals[0].translation
    farthest_first = sorted(stances, key=lambda stance: -float(np.linalg.norm(goal - stance.position)))
    return distances_missing(arm, farthest_first, goals, stop_at=REACHED).worst.reached
