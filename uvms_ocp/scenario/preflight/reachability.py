"""Check that the tool reaches its goal from wherever the vehicle may stand: inverse kinematics of
the arm from many starts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np
import pinocchio as pin

from uvms_ocp.control.velocity.swing import swinging_axes
from uvms_ocp.robot.limits import from_joint_values
from uvms_ocp.robot.robot import Robot
from uvms_ocp.robot.size import size
from uvms_ocp.robot.static_balance import rotation_at_rest
from uvms_ocp.scenario.preflight.findings import Finding, Severity
from uvms_ocp.scenario.preflight.phase_forecast import Stance, Visit, forecast
from uvms_ocp.scenario.preflight.setup import Setup
from uvms_ocp.tasks.goals import PoseGoal, evaluate_pose
from uvms_ocp.tasks.pose import ToolPose, ToolPosition, VehiclePose
from uvms_ocp.tasks.vehicle_velocity import NullVelocity

REACHED = 1e-3  # [m, rad] what counts as reached: the thresholds at which a tool task ends
_MARGIN = 1e-3  # share of the range by which starts keep away from the limits
_LEAN_STEP = 1e-5  # [rad or m] of the difference quotients of the attitude at rest
_STARTS = 12
_ITERATIONS = 60
_DAMPING = 1e-3
_CONVERGED = 1e-9

CHECK = "reachability"
_N_TIMES = 5  # samples of a goal that moves
_STEP = 0.2  # sizes of the robot between suggested way points
_FARTHEST = 8.0  # sizes of the robot from the way point given
# starts from solved neighbours, and random ones beside them
_N_NEAR = 3
_N_FEW = 4

_cost = attrgetter("cost")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReachResult:
    """The nearest that the tool comes to its goal."""

    joints: np.ndarray
    """(n_joints,) [rad or m] posture."""
    position: float
    """[m] distance of the frame from the goal."""
    orientation: float
    """[rad] angle of the frame from the goal; 0 where the orientation is free."""

    @property
    def reached(self) -> bool:
        return self.position < REACHED and self.orientation < REACHED

    @property
    def cost(self) -> float:
        return self.position**2 + self.orientation**2


class ArmReach:
    """Inverse kinematics of an arm: Levenberg-Marquardt within the joint limits, from many starts.

    The error is that of a tool task: metres and radians count the same. rotation_weight: 0 leaves
    orientation free. leans: the vehicle comes to rest in the roll and pitch that no thruster
    drives, with the arm as it is.
    """

    def __init__(
        self,
        robot: Robot,
        frame: str,
        *,
        seed: int = 0,
        rotation_weight: float = 1.0,
        leans: bool = False,
    ) -> None:
        self._robot = robot
        self._frame = robot.frame_id(frame)
        self._weight = rotation_weight
        self._leans = leans
        self._data = robot.model.createData()
        limits = robot.limits
        self._lower = np.where(np.isfinite(limits.position_lower), limits.position_lower, -np.pi)
        self._upper = np.where(np.isfinite(limits.position_upper), limits.position_upper, np.pi)
        rng = np.random.default_rng(seed)
        self._starts = []
        for _ in range(_STARTS):
            shares = rng.random(robot.n_joints)
            self._starts.append(self._lower + (self._upper - self._lower) * shares)

    @classmethod
    def of_task(
        cls, setup: Setup, task: ToolPose | ToolPosition, *, turned: bool = False
    ) -> ArmReach:
        """Build it for the frame of a task, with its orientation free where the task, or `turned`,
        leaves it.
        """
        leans = setup.with_forces and bool(swinging_axes(setup.robot))
        return cls(
            setup.robot,
            task.frame,
            rotation_weight=float(isinstance(task, ToolPose) and not turned),
            leans=leans,
        )

    def solve(
        self,
        X_WB: pin.SE3,
        goal: pin.SE3,
        near: Sequence[np.ndarray] = (),
        n_random: int | None = None,
    ) -> ReachResult:
        """Return the best posture for the vehicle at X_WB and the goal X_WF.

        `near` are further starts (n_joints,) [rad or m], tried first; `n_random` is how many of its
        own follow, default all.
        """
        best: ReachResult | None = None
        for start in (*near, *self._starts[:n_random]):
            candidate = self._from(X_WB, goal, start)
            if best is None or candidate.cost < best.cost:
                best = candidate
            if self._weight:
                is_reached = best.reached
            else:
                is_reached = best.position < REACHED
            if is_reached:
                break
        if best is None:
            return self._reach(X_WB, goal, 0.5 * (self._lower + self._upper))
        return best

    def _from(self, X_WB: pin.SE3, goal: pin.SE3, start: np.ndarray) -> ReachResult:
        """Search with the rotation weighed lightly first: that finds its way around more obstacles
        than the full error.
        """
        x = start
        if self._weight:
            weights = [0.1 * self._weight, self._weight]
        else:
            weights = [0.0]
        for weight in weights:
            x = self._minimise(X_WB, goal, x, weight)
        return self._reach(X_WB, goal, x)

    def _minimise(
        self, X_WB: pin.SE3, goal: pin.SE3, start: np.ndarray, weight: float
    ) -> np.ndarray:
        """Minimise the error by Levenberg-Marquardt; joints at a limit that a step would push
        beyond it stand still, others stop there.
        """
        weights = np.repeat([1.0, weight], 3)
        damping = _DAMPING
        lower = self._lower
        upper = self._upper
        span = _MARGIN * (upper - lower)
        x = np.clip(start, lower + span, upper - span)
        error, slope = self._error(X_WB, goal, x)
        for _ in range(_ITERATIONS):
            r = weights * error
            J = weights[:, None] * slope
            gradient = J.T @ r
            is_free = ~(((x <= lower) & (gradient > 0.0)) | ((x >= upper) & (gradient < 0.0)))
            if not is_free.any():
                break
            H = J[:, is_free].T @ J[:, is_free]
            step = np.zeros(len(x))
            step[is_free] = np.linalg.solve(H + damping * np.eye(len(H)), -gradient[is_free])
            candidate = np.clip(x + step, lower, upper)
            previous_error = error
            previous_slope = slope
            error, slope = self._error(X_WB, goal, candidate)
            gained = r @ r - (weights * error) @ (weights * error)
            if gained <= 0.0:
                error = previous_error
                slope = previous_slope
                damping = 4.0 * damping
            else:
                x = candidate
                damping = max(0.2 * damping, _CONVERGED)
            if abs(gained) < _CONVERGED * (r @ r) or np.abs(step).max() < _CONVERGED:
                break
        return x

    def _error(
        self, X_WB: pin.SE3, goal: pin.SE3, joints: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the error (6,) of the frame, frame minus goal, and its derivative (6, n_joints)."""
        model = self._robot.model
        data = self._data
        R_WB = X_WB.rotation
        if self._leans:
            lean = self._rest(joints)
        else:
            lean = np.eye(3)
        q = pin.neutral(model)
        if self._robot.n_vehicle:
            q[:7] = pin.SE3ToXYZQUAT(pin.SE3(R_WB @ lean, X_WB.translation))
        pin.computeJointJacobians(model, data, from_joint_values(model, joints, q))
        X_WF = pin.updateFramePlacement(model, data, self._frame)
        slope = pin.getFrameJacobian(model, data, self._frame, pin.LOCAL_WORLD_ALIGNED)
        J = slope[:, self._robot.joint_v]
        if self._leans:
            inwards = np.copysign(_LEAN_STEP, 0.5 * (self._lower + self._upper) - joints)
            turns = []  # [rad] of the vehicle by a step of each joint
            for step in np.diag(inwards):
                moved_lean = self._rest(np.clip(joints + step, self._lower, self._upper))
                turns.append(pin.log3(lean.T @ moved_lean))
            J = J + slope[:, 3:6] @ np.column_stack(turns) / inwards
        R = X_WF.rotation @ goal.rotation.T
        error = np.concatenate([X_WF.translation - goal.translation, pin.log3(R)])
        return error, np.vstack([J[:3], pin.Jlog3(R).T @ J[3:]])

    def _rest(self, joints: np.ndarray) -> np.ndarray:
        return rotation_at_rest(self._robot, self._robot.configuration(joints=joints))

    def _reach(self, X_WB: pin.SE3, goal: pin.SE3, joints: np.ndarray) -> ReachResult:
        error, _ = self._error(X_WB, goal, joints)
        orientation_error = 0.0
        if self._weight:
            orientation_error = float(np.linalg.norm(error[3:]))
        position_error = float(np.linalg.norm(error[:3]))
        return ReachResult(joints=joints, position=position_error, orientation=orientation_error)


# Check: the tool reaches its goal from wherever the vehicle may stand by then.


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReachShortfall:
    """Shortfall over all stances, and at worst over those where the vehicle is likely to stand."""

    best: ReachResult
    worst: ReachResult
    likely: ReachResult

    def figures(self) -> dict[str, float]:
        reaches = {"best": self.best, "worst": self.worst, "likely": self.likely}
        lengths = {f"missing_{name}_m": value.position for name, value in reaches.items()}
        return lengths | {
            f"missing_{name}_rad": value.orientation for name, value in reaches.items()
        }


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


def _finding(setup: Setup, visit: Visit, task: ToolPose | ToolPosition) -> Finding:
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


def goals_of(setup: Setup, name: str, goal: PoseGoal) -> list[pin.SE3]:
    """Return the goal; where it comes to rest if it moves; samples of it if it never rests."""
    last_pose, rate = evaluate_pose(name, goal, setup.duration)
    if not callable(goal) or not rate.any():
        return [last_pose]
    return [evaluate_pose(name, goal, t)[0] for t in np.linspace(0.0, setup.duration, _N_TIMES)]


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
    stances = next(
        foreseen.stances for foreseen in forecast(setup) if foreseen.index == visit.index
    )
    goal = goals[0].translation
    farthest_first = sorted(
        stances, key=lambda stance: -float(np.linalg.norm(goal - stance.position))
    )
    return distances_missing(arm, farthest_first, goals, stop_at=REACHED).worst.reached
